//! Which scene a script plays at which time.

use crate::config::{Scene, Script};

/// Length of a random scene, and of the live scene after it.
const RANDOM_SCENE_US: u64 = 2_000_000;
/// Shortest random fault.
const SHORTEST_FAULT_US: u64 = 100_000;

impl Script {
    /// Returns the scene at a time since the start, and how long it lasts from then on, both in microseconds.
    pub(super) fn at(&self, elapsed_us: u64) -> (Scene, u64) {
        match self {
            Self::Scenes(scenes) => at(scenes, elapsed_us),
            Self::Random(seed) => random_at(*seed, elapsed_us),
        }
    }
}

fn at(scenes: &[(Scene, u64)], elapsed_us: u64) -> (Scene, u64) {
    let total_us: u64 = scenes.iter().map(|(_, length_us)| length_us).sum();
    let mut left_us = elapsed_us.checked_rem(total_us).unwrap_or(0);
    for (scene, length_us) in scenes {
        if left_us < *length_us {
            return (*scene, length_us - left_us);
        }
        left_us -= length_us;
    }
    (Scene::Live, 0)
}

/// Odd scenes are live. Even scenes begin with a fault, and are live afterwards.
fn random_at(seed: u64, elapsed_us: u64) -> (Scene, u64) {
    let (number, begun_us) = (elapsed_us / RANDOM_SCENE_US, elapsed_us % RANDOM_SCENE_US);
    let mut random = fastrand::Rng::with_seed(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ number);
    let fault = random.choice(Scene::RANDOM).unwrap_or(Scene::Live);
    let fault_us = random.u64(SHORTEST_FAULT_US..RANDOM_SCENE_US);
    if number % 2 == 0 && begun_us < fault_us {
        (fault, fault_us - begun_us)
    } else {
        (Scene::Live, RANDOM_SCENE_US - begun_us)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    fn script(device: &str) -> Script {
        Script::of(device).unwrap().unwrap()
    }

    #[test]
    fn scenes_follow_each_other_and_repeat() {
        let script = script("rehearsal: live 5, gone 2.5,no-face 1");
        assert_eq!(script.at(0), (Scene::Live, 5 * S));
        assert_eq!(script.at(5 * S - 1), (Scene::Live, 1));
        assert_eq!(script.at(5 * S), (Scene::Gone, 5 * S / 2));
        assert_eq!(script.at(8 * S), (Scene::NoFace, S / 2));
        assert_eq!(script.at(17 * S / 2), (Scene::Live, 5 * S));
    }

    #[test]
    fn a_random_rehearsal_has_every_fault_and_depends_on_its_seed() {
        let scenes = |seed| -> Vec<Scene> {
            let script = script(&format!("rehearsal: random {seed}"));
            (0..200).map(|number| script.at(number * RANDOM_SCENE_US).0).collect()
        };
        for scene in Scene::RANDOM {
            assert!(scenes(7).contains(&scene), "{scene:?}");
        }
        assert_eq!(scenes(7), scenes(7));
        assert_ne!(scenes(7), scenes(8));
        assert!(scenes(7).into_iter().skip(1).step_by(2).all(|scene| scene == Scene::Live));
    }
}
