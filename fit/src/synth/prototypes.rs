//! The combinations of facial actions that anatomy and emotions give, as the Facial Action Coding System (Ekman and Friesen, 1978)
//! numbers them, in ARKit's blendshapes.
//!
//! Recordings of one person show that person's habits: if the person never raises the inner brows alone, a model learns that
//! they always move with the outer ones. Here every combination is as frequent as any other.

use super::acting::Shapes;

/// What brows and lids do together.
pub const UPPER: [Shapes; 14] = [
    // 1: the inner brows alone, oblique.
    &[("browInnerUp", 0.8)],
    // 1+4: grief.
    &[("browInnerUp", 0.75), ("browDown", 0.3)],
    &[("browInnerUp", 0.5), ("browDown", 0.6)],
    // 1+4+7.
    &[("browInnerUp", 0.6), ("browDown", 0.3), ("eyeSquint", 0.5)],
    // 2: the outer brows alone.
    &[("browOuterUp", 0.8)],
    // 1+2: both.
    &[("browInnerUp", 0.8), ("browOuterUp", 0.7)],
    // 1+2+5: surprise.
    &[("browInnerUp", 0.7), ("browOuterUp", 0.7), ("eyeWide", 0.7)],
    // 1+2+4+5: fear.
    &[("browInnerUp", 0.7), ("browOuterUp", 0.3), ("browDown", 0.3), ("eyeWide", 0.6)],
    // 4: a frown of the brows.
    &[("browDown", 0.8)],
    // 4+5: anger that stares.
    &[("browDown", 0.7), ("eyeWide", 0.5)],
    // 4+7: effort, or light that dazzles.
    &[("browDown", 0.6), ("eyeSquint", 0.7)],
    // 5: wide eyes alone.
    &[("eyeWide", 0.8)],
    // 7, and 6 without a smile.
    &[("eyeSquint", 0.8)],
    &[("eyeSquint", 0.4), ("cheekSquint", 0.6)],
];

/// What mouth, jaw, cheeks and nose do together.
pub const LOWER: [Shapes; 36] = [
    // 6+12, 6+12+25, 6+12+26: smiles that reach the eyes, from closed to laughing.
    &[("mouthSmile", 0.7), ("cheekSquint", 0.6)],
    &[("mouthSmile", 0.8), ("cheekSquint", 0.6), ("mouthUpperUp", 0.4), ("mouthLowerDown", 0.3)],
    &[("mouthSmile", 0.8), ("cheekSquint", 0.5), ("jawOpen", 0.5), ("mouthUpperUp", 0.4), ("mouthLowerDown", 0.4)],
    // 12, 12+25: polite ones.
    &[("mouthSmile", 0.6)],
    &[("mouthSmile", 0.5), ("mouthUpperUp", 0.3), ("jawOpen", 0.1)],
    // 12+15, 12+24: smiles that are held back.
    &[("mouthSmile", 0.4), ("mouthPress", 0.5), ("mouthShrugLower", 0.3)],
    // 14: dimples.
    &[("mouthDimple", 0.7)],
    &[("mouthDimple", 0.6), ("mouthPress", 0.4)],
    // 9, 9+10, 9+16+25: disgust.
    &[("noseSneer", 0.7)],
    &[("noseSneer", 0.6), ("mouthUpperUp", 0.5)],
    &[("noseSneer", 0.6), ("mouthLowerDown", 0.5), ("jawOpen", 0.15)],
    // 10, 10+25: the upper lip alone.
    &[("mouthUpperUp", 0.7), ("jawOpen", 0.05)],
    // 15, 15+17: sadness.
    &[("mouthFrown", 0.7)],
    &[("mouthFrown", 0.6), ("mouthShrugLower", 0.6)],
    // 17, 17 with the upper lip.
    &[("mouthShrugLower", 0.8)],
    &[("mouthShrugLower", 0.6), ("mouthShrugUpper", 0.6)],
    // 16+25: the lower lip alone.
    &[("mouthLowerDown", 0.7), ("jawOpen", 0.1)],
    // 18, 22, 18+22+25: pursed lips and funnels.
    &[("mouthPucker", 0.8)],
    &[("mouthFunnel", 0.8), ("jawOpen", 0.15)],
    &[("mouthPucker", 0.5), ("mouthFunnel", 0.5), ("jawOpen", 0.2)],
    // 20, 20+25, 20+26: fear.
    &[("mouthStretch", 0.7)],
    &[("mouthStretch", 0.7), ("mouthLowerDown", 0.4), ("jawOpen", 0.15)],
    &[("mouthStretch", 0.6), ("jawOpen", 0.5)],
    // 23, 24: lips pressed together.
    &[("mouthPress", 0.8)],
    &[("mouthPress", 0.6), ("mouthRollLower", 0.3), ("mouthRollUpper", 0.3)],
    // 28: lips rolled in, both, the lower one under the teeth, the upper one.
    &[("mouthRollLower", 0.8), ("mouthRollUpper", 0.8)],
    &[("mouthRollLower", 0.8)],
    &[("mouthRollUpper", 0.8)],
    &[("mouthRollLower", 0.6), ("mouthRollUpper", 0.5), ("jawOpen", 0.2), ("mouthClose", 0.2)],
    // 26, 27: the jaw drops with closed and with open lips.
    &[("jawOpen", 0.4)],
    &[("jawOpen", 0.9)],
    &[("jawOpen", 0.3), ("mouthClose", 0.3)],
    // 29, 30: the jaw goes forward and to the sides, and the mouth to one side.
    &[("jawForward", 0.8)],
    &[("jawLeft", 0.8)],
    &[("mouthLeft", 0.8)],
    // 34: puffed cheeks.
    &[("cheekPuff", 0.8), ("mouthPress", 0.2)],
];
