//! The filters of all coefficients and of the head, chosen by the part of the face that moves.

use super::{
    BLENDSHAPES, COEFFS, Corrected, HeadPose,
    filter::{Filter, FilterKind, FilterState},
    head_filter::{HeadFilter, HeadState},
    noise_level::NoiseLevel,
};

/// Level of noise beyond which the filters of coefficients do not follow it. A higher one leaves less jitter in the dark, and
/// takes more of fast expressions in noisy pictures. The head follows it further, because its movements are larger than its noise.
const MOST_NOISE: f32 = 2.0;

/// Coefficients ready to be sent, each within `0..=1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothed(pub [f32; COEFFS]);

/// Coefficients that share a filter, because they belong to a part of the face that moves in its own way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// `eyeBlink`, `eyeSquint`, `eyeWide`.
    Lids,
    /// `eyeLook`.
    Gaze,
    /// `brow`.
    Brows,
    /// `mouth` and `tongueOut`.
    Mouth,
    /// `jaw`.
    Jaw,
    /// `cheek` and `nose`.
    Cheeks,
}

impl Group {
    /// Every group.
    pub const ALL: [Self; 6] = [Self::Lids, Self::Gaze, Self::Brows, Self::Mouth, Self::Jaw, Self::Cheeks];

    /// The group of a blendshape.
    #[must_use]
    pub fn of(blendshape: &str) -> Self {
        let starts = [
            ("eyeLook", Self::Gaze),
            ("eye", Self::Lids),
            ("brow", Self::Brows),
            ("jaw", Self::Jaw),
            ("cheek", Self::Cheeks),
            ("nose", Self::Cheeks),
        ];
        // `mouth` and `tongueOut` are left.
        starts.into_iter().find(|(start, _)| blendshape.starts_with(start)).map_or(Self::Mouth, |(_, group)| group)
    }

    /// The size of a change that is no longer small, in good light; found by `facewire-fit tune smoothing`.
    pub(super) fn small(self) -> f32 {
        match self {
            Self::Gaze => 0.136,
            Self::Brows => 0.096,
            Self::Mouth => 0.056,
            Self::Lids | Self::Jaw => 0.05,
            Self::Cheeks => 0.048,
        }
    }

    /// The filter of this group, by the settings.
    #[must_use]
    pub fn filter(self, kind: FilterKind, time_s: f32) -> Filter {
        Filter { kind, time_s, small: self.small() }
    }
}

/// The filters of all coefficients, in the order of [`BLENDSHAPES`], and of the head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filters {
    /// The filters of the coefficients.
    pub coefficients: [Filter; COEFFS],
    /// The filter of the head's rotation and position.
    pub head: HeadFilter,
}

/// The states of all filters.
#[derive(Debug, Clone, PartialEq)]
pub struct FiltersState {
    noise: NoiseLevel,
    coefficients: [FilterState<1>; COEFFS],
    head: HeadState,
}

impl Default for FiltersState {
    fn default() -> Self {
        Self {
            noise: NoiseLevel::default(),
            coefficients: [const { FilterState::Empty }; COEFFS],
            head: HeadState::default(),
        }
    }
}

impl Filters {
    /// No smoothing.
    pub const OFF: Self = Self { coefficients: [Filter::OFF; COEFFS], head: HeadFilter::OFF };

    /// One filter for each group, and one for the head.
    #[must_use]
    pub fn new(of: impl Fn(Group) -> Filter, head: HeadFilter) -> Self {
        Self { coefficients: BLENDSHAPES.map(|name| of(Group::of(name))), head }
    }

    /// The same kind and time for every group and the head.
    #[must_use]
    pub fn uniform(kind: FilterKind, time_s: f32) -> Self {
        Self::new(|group| group.filter(kind, time_s), HeadFilter::new(kind, time_s))
    }

    /// Filters the coefficients and the pose of the head of a frame that was captured `dt_s` seconds after the last one.
    pub fn step(
        &self,
        state: &mut FiltersState,
        corrected: &Corrected,
        head: &HeadPose,
        dt_s: f32,
    ) -> (Smoothed, HeadPose) {
        let level = state.noise.step(&corrected.0, dt_s);
        let for_coefficients = level.min(MOST_NOISE);
        let mut out = corrected.0;
        for (value, (filter, state)) in out.iter_mut().zip(self.coefficients.iter().zip(&mut state.coefficients)) {
            [*value] = filter.in_noise(for_coefficients).step(state, [*value], dt_s);
        }
        (Smoothed(out), self.head.in_noise(level).step(&mut state.head, head, dt_s))
    }
}

#[cfg(test)]
#[allow(clippy::indexing_slicing)]
mod tests {
    use super::*;

    /// A coefficient that no other test moves.
    const JAW_OPEN: usize = 17;

    #[test]
    fn strong_noise_doubles_what_is_small_for_coefficients_and_more_than_doubles_it_for_the_head() {
        let filters = Filters::uniform(FilterKind::GatedAverage, 0.3);
        let mut state = FiltersState::default();
        let mut step = |frame: u16, jaw_open: f32, roll_deg: f32| {
            // Everything but the jaw is thrown back and forth.
            let mut values = [if frame.is_multiple_of(2) { 0.3 } else { 0.7 }; COEFFS];
            values[JAW_OPEN] = jaw_open;
            let half = (0.5 * roll_deg).to_radians();
            let head = HeadPose::from_rotation([0.0, 0.0, half.sin(), half.cos()], [0.0; 3]);
            filters.step(&mut state, &Corrected(values), &head, 1.0 / 30.0)
        };
        (0..90).for_each(|frame| _ = step(frame, 0.5, 0.0));
        let small = Group::Jaw.small();
        let (near, _) = step(90, 0.5 + 1.5 * small, 0.0);
        assert!(near.0[JAW_OPEN] < 0.5 + small, "{}", near.0[JAW_OPEN]);
        let (far, head) = step(91, 0.5 + 2.5 * small, 4.0);
        assert!((far.0[JAW_OPEN] - 0.5 - 2.5 * small).abs() < 1e-6, "{}", far.0[JAW_OPEN]);
        assert!(head.roll_deg < 1.0, "{}", head.roll_deg);
    }

    #[test]
    fn every_blendshape_belongs_to_the_part_of_the_face_that_it_moves() {
        let members = |group| BLENDSHAPES.iter().filter(|name| Group::of(name) == group).count();
        assert_eq!(Group::ALL.map(members), [6, 8, 5, 24, 4, 5]);
        let groups = ["eyeBlinkLeft", "eyeLookInRight", "noseSneerLeft", "cheekPuff", "tongueOut"].map(Group::of);
        assert_eq!(groups, [Group::Lids, Group::Gaze, Group::Cheeks, Group::Cheeks, Group::Mouth]);
    }
}
