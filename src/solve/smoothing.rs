//! The filters of all coefficients and of the head, chosen by the part of the face that moves.

use super::{
    BLENDSHAPES, COEFFS, Corrected, HeadPose,
    filter::{Filter, FilterKind, FilterState},
    head_filter::{HeadFilter, HeadState},
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

/// The beginnings of the names of blendshapes, with their groups. The first that fits counts.
const PREFIXES: [(&str, Group); 9] = [
    ("eyeLook", Group::Gaze),
    ("eye", Group::Lids),
    ("brow", Group::Brows),
    ("mouth", Group::Mouth),
    ("tongue", Group::Mouth),
    ("jaw", Group::Jaw),
    ("cheek", Group::Cheeks),
    ("nose", Group::Cheeks),
    ("", Group::Mouth),
];

impl Group {
    /// Every group.
    pub const ALL: [Self; 6] = [Self::Lids, Self::Gaze, Self::Brows, Self::Mouth, Self::Jaw, Self::Cheeks];

    /// The group of a blendshape.
    #[must_use]
    pub fn of(blendshape: &str) -> Self {
        let fitting = PREFIXES.into_iter().find(|(prefix, _)| blendshape.starts_with(prefix));
        fitting.map_or(Self::Mouth, |(_, group)| group)
    }

    /// The filter of this group, by the settings.
    #[must_use]
    pub fn filter(self, kind: FilterKind, time_s: f32) -> Filter {
        let small = match self {
            Self::Lids | Self::Gaze => 0.03,
            Self::Brows | Self::Mouth | Self::Jaw | Self::Cheeks => 0.05,
        };
        Filter { kind, time_s, small }
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
    coefficients: [FilterState<1>; COEFFS],
    head: HeadState,
}

impl Default for FiltersState {
    fn default() -> Self {
        Self { coefficients: [const { FilterState::Empty }; COEFFS], head: HeadState::default() }
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

    /// Filters the coefficients of a frame that was captured `dt_s` seconds after the last one.
    pub fn step(&self, state: &mut FiltersState, corrected: &Corrected, dt_s: f32) -> Smoothed {
        let mut out = corrected.0;
        for (value, (filter, state)) in out.iter_mut().zip(self.coefficients.iter().zip(&mut state.coefficients)) {
            [*value] = filter.step(state, [*value], dt_s);
        }
        Smoothed(out)
    }

    /// Filters the pose of the head in the same frame.
    pub fn step_head(&self, state: &mut FiltersState, head: &HeadPose, dt_s: f32) -> HeadPose {
        self.head.step(&mut state.head, head, dt_s)
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
