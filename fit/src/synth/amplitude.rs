//! How far the rig's shapes move against ARKit's: the largest displacement over the distance of the eyes differs
//! between rig and ARKit by the factor in
//! `RATIOS`; weights are divided by it, so that a truth of 1 means ARKit's motion. Three shapes mean contact rather
//! than distance and keep it: a lid is shut at `eyeBlink` 1, lips meet where `mouthClose` equals `jawOpen`.

/// Largest displacement in the rig over that in ARKit, both over the distance of the eyes. `eyeLookIn` and
/// `eyeLookOut` are of the lids. `eyeBlink` shuts the lid at 1. `mouthClose` is set so that lips meet over an open jaw.
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
/// The same for shapes named by the side they move to.
const SIDEWAYS: [(&str, f32); 3] = [("mouthLeft", 1.57), ("mouthRight", 1.57), ("mouthUpperUp", 0.94)];
/// Amplitude of the rig over ARKit's for a blendshape.
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
