//! The filters of all coefficients and of the head, chosen by the part of the face that moves.

use super::{
    BLENDSHAPES, COEFFS, Corrected, HeadPose,
    filter::{Filter, FilterKind, FilterState},
    head_filter::{HeadFilter, HeadState},
    noise_level::NoiseLevel,
};

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
    pub(super) fn noise_size(self) -> f32 {
        match self {
            Self::Gaze => 0.136,
            Self::Brows => 0.096,
            Self::Mouth => 0.056,
            Self::Lids | Self::Jaw => 0.05,
            Self::Cheeks => 0.048,
        }
    }

    /// The filter of this group, by the settings.
    pub fn filter(self, kind: FilterKind, time_s: f32) -> Filter {
        Filter { kind, time_s, noise_size: self.noise_size() }
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
    pub fn new(of: impl Fn(Group) -> Filter, head: HeadFilter) -> Self {
        Self { coefficients: BLENDSHAPES.map(|name| of(Group::of(name))), head }
    }

    /// The same kind and time for every group and the head.
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
        let mut out = corrected.0;
        for (value, (filter, state)) in out.iter_mut().zip(self.coefficients.iter().zip(&mut state.coefficients)) {
            [*value] = filter.at_noise_level(level).step(state, [*value], dt_s);
        }
        (Smoothed(out), self.head.at_noise_level(level).step(&mut state.head, head, dt_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_blendshape_belongs_to_the_part_of_the_face_that_it_moves() {
        let members = |group| BLENDSHAPES.iter().filter(|name| Group::of(name) == group).count();
        assert_eq!(Group::ALL.map(members), [6, 8, 5, 24, 4, 5]);
        let groups = ["eyeBlinkLeft", "eyeLookInRight", "noseSneerLeft", "cheekPuff", "tongueOut"].map(Group::of);
        assert_eq!(groups, [Group::Lids, Group::Gaze, Group::Cheeks, Group::Cheeks, Group::Mouth]);
    }
}
