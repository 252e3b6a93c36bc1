//! The amplitude of the rig's shapes relative to ARKit's.
//!
//! A shape's amplitude is its largest displacement divided by the distance of the eyes. It differs between rig and
//! ARKit by the factor in `RATIOS`. Weights are divided by this factor, so that a coefficient of 1 means ARKit's
//! motion.

/// Amplitude in the rig divided by the amplitude in ARKit. `eyeLookIn` and `eyeLookOut` refer to the lids. Two shapes
/// are defined by contact instead: `eyeBlink` shuts the lid at 1, and lips meet where `mouthClose` equals `jawOpen`.
const RATIOS: [(&str, f32); 30] = [
    ("browDown", 0.74),
    ("browInnerUp", 0.56),
    ("browOuterUp", 0.74),
    ("cheekPuff", 1.51),
    ("cheekSquint", 0.82),
    ("eyeBlink", 1.0),
    ("eyeLookDown", 1.75),
    ("eyeLookIn", 0.67),
    ("eyeLookOut", 0.71),
    ("eyeLookUp", 1.0),
    ("eyeSquint", 0.75),
    ("eyeWide", 1.03),
    ("jawForward", 1.23),
    ("jawLeft", 1.02),
    ("jawRight", 1.02),
    ("jawOpen", 1.05),
    ("mouthClose", 1.25),
    ("mouthDimple", 0.88),
    ("mouthFrown", 0.88),
    ("mouthFunnel", 0.87),
    ("mouthLowerDown", 0.65),
    ("mouthPress", 0.42),
    ("mouthPucker", 1.09),
    ("mouthRollLower", 1.57),
    ("mouthRollUpper", 1.14),
    ("mouthShrugLower", 1.55),
    ("mouthShrugUpper", 1.32),
    ("mouthSmile", 0.86),
    ("mouthStretch", 0.75),
    ("noseSneer", 2.14),
];
/// The same for shapes whose name ends with a direction of motion instead of a side of the face.
const SIDEWAYS: [(&str, f32); 3] = [("mouthLeft", 1.57), ("mouthRight", 1.57), ("mouthUpperUp", 0.94)];

/// Returns the amplitude of a blendshape in the rig divided by its amplitude in ARKit.
pub fn ratio(name: &str) -> Option<f32> {
    let stem = name.strip_suffix("Left").or_else(|| name.strip_suffix("Right")).unwrap_or(name);
    let all = || SIDEWAYS.iter().chain(&RATIOS);
    let of = |wanted: &str| all().find(|(known, _)| *known == wanted).map(|(_, ratio)| *ratio);
    of(name).or_else(|| of(stem))
}

#[cfg(test)]
mod tests {
    use facewire::solve::BLENDSHAPES;

    use super::*;

    #[test]
    fn every_blendshape_but_the_tongue_has_an_amplitude() {
        assert!(BLENDSHAPES.iter().filter(|name| **name != "tongueOut").all(|name| ratio(name).is_some()));
        assert_eq!(
            [ratio("mouthSmileLeft"), ratio("mouthLeft"), ratio("jawRight")],
            [Some(0.86), Some(1.57), Some(1.02)]
        );
    }
}
