//! The regions of a face whose visibility is measured in a picture: left eye, right eye, brows, mouth and jaw, cheeks and nose.

use glam::Vec3;

use super::rig::{Rig, vertices_of};

/// Number of regions.
pub const REGIONS: usize = 5;

/// The first of the landmarks of each region and the one after the last, of the 68 usual ones, and the distance within which vertices belong to them, centimetres.
const AROUND: [(&[[usize; 2]], f32); REGIONS] = [
    (&[[42, 48]], 0.7),
    (&[[36, 42]], 0.7),
    (&[[17, 27]], 0.9),
    (&[[6, 11], [48, 60]], 1.1),
    (&[[27, 36], [2, 4], [13, 15]], 1.3),
];

/// Returns the vertices of the skin in each region.
pub fn regions(rig: &Rig) -> [Vec<usize>; REGIONS] {
    let skin = vertices_of(&rig.parts.skin[..rig.parts.face]);
    AROUND.map(|(landmarks, distance)| {
        let places: Vec<Vec3> = landmarks
            .iter()
            .flat_map(|[first, end]| *first..*end)
            .map(|landmark| rig.neutral[rig.landmarks[landmark]])
            .collect();
        let is_near = |vertex: &usize| places.iter().any(|place| place.distance(rig.neutral[*vertex]) < distance);
        skin.iter().map(|vertex| *vertex as usize).filter(is_near).collect()
    })
}
