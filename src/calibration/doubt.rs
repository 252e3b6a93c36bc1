//! Compares the neutral take with the poses. A pose moves one part of the face while the others rest, so that most poses
//! show what the other parts look like at rest.

use super::hold::LIDS;
use super::learn::Takes;
use super::refusal::Refusal;
use super::take::{Take, mean_of};
use crate::solve::Model;

/// The neutral take is in doubt if the median reading of a part of the face, in the poses that leave that part at rest,
/// lies this far or farther from the neutral take.
const BELOW: f32 = -0.2;
/// Least number of such poses.
const LEAST_POSES: usize = 3;

/// Parts of the face: the coefficients that tell how far they are moved, the poses that leave them at rest, and what the
/// wearer did in a neutral take in which they were not at rest.
const PARTS: [(&[&str], &[Take], Refusal); 4] = [
    (
        &["mouthSmileLeft", "mouthSmileRight"],
        &[Take::EyesShut, Take::BrowsUp, Take::LookLeft, Take::LookRight, Take::LookUp, Take::LookDown],
        Refusal::Smiling,
    ),
    (
        &["jawOpen"],
        &[Take::EyesShut, Take::BrowsUp, Take::BrowsDown, Take::LookLeft, Take::LookRight, Take::LookUp],
        Refusal::MouthOpen,
    ),
    (&LIDS, &[Take::JawOpen, Take::BrowsUp, Take::Pucker, Take::LookLeft, Take::LookRight], Refusal::EyesShut),
    (
        &["browInnerUp", "browOuterUpLeft", "browOuterUpRight"],
        &[Take::EyesShut, Take::Smile, Take::Pucker, Take::LookLeft, Take::LookRight, Take::LookDown],
        Refusal::BrowsMoved,
    ),
];

/// Why the poses contradict the neutral take, if they do.
pub(super) fn doubt(model: &Model, takes: &Takes) -> Option<Refusal> {
    let known = takes.neutral()?;
    PARTS.into_iter().find_map(|(names, poses, refusal)| {
        let raw = poses.iter().filter_map(|pose| takes.raw(model, *pose));
        let mut moved: Vec<f32> = raw.map(|raw| mean_of(names, &raw) - mean_of(names, &known.raw)).collect();
        moved.sort_by(f32::total_cmp);
        let median = moved.get(moved.len() / 2).filter(|_| moved.len() >= LEAST_POSES)?;
        (*median < BELOW).then_some(refusal)
    })
}
