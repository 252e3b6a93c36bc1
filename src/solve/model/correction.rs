//! The numbers of the corrective terms (eq. 7).

use super::{BLENDSHAPES, COEFFS, Words};

/// The terms of the eyelids where the model states none: full closure reads 0.7 and becomes 0.97. A lift of 0.25
/// from 0.5 on has a smaller squared error, but then only every third blink of unseen people reaches 0.9.
const EYE_BLINK: CorrectiveTerms = CorrectiveTerms { lift: 0.4, response: [0.35, 0.75], ..CorrectiveTerms::NONE };

/// The corrective terms of one blendshape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CorrectiveTerms {
    /// `beta`: what is added to the result of the regression.
    pub shift: f32,
    /// `1 - gamma`: the factor on small values.
    pub slope: f32,
    /// `1/eta`: what is added to the factor at the top of the range.
    pub lift: f32,
    /// The values at which the response function `g` begins and ends to rise.
    pub response: [f32; 2],
}

impl CorrectiveTerms {
    /// Terms that change nothing.
    pub const NONE: Self = Self { shift: 0.0, slope: 1.0, lift: 0.0, response: [0.5, 0.9] };

    /// Whether the terms are finite and keep the order of values.
    #[must_use]
    pub fn keep_order(&self) -> bool {
        let Self { shift, slope, lift, response: [from, to] } = *self;
        let are_finite = [shift, slope, lift, from, to].iter().all(|number| number.is_finite());
        are_finite && slope > 0.0 && lift >= 0.0 && 0.0 <= from && from < to
    }
}

/// The corrective terms of all blendshapes, in the order of [`BLENDSHAPES`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction(pub [CorrectiveTerms; COEFFS]);

impl Default for Correction {
    /// The terms of a model that states none: only the eyelids are lifted.
    fn default() -> Self {
        Self(BLENDSHAPES.map(|name| if name.starts_with("eyeBlink") { EYE_BLINK } else { CorrectiveTerms::NONE }))
    }
}

impl Correction {
    /// The terms as little-endian words of 4 bytes.
    pub(super) fn to_bytes(self) -> impl Iterator<Item = u8> {
        let words = |CorrectiveTerms { shift, slope, lift, response: [from, to] }| [shift, slope, lift, from, to];
        self.0.into_iter().flat_map(words).flat_map(f32::to_le_bytes)
    }

    /// Reads what [`Correction::to_bytes`] wrote, and returns the bytes after it.
    pub(super) fn from_bytes(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let (own, rest) = bytes.split_at_checked(COEFFS * 5 * size_of::<f32>())?;
        let mut words = Words(own.as_chunks().0);
        let mut terms = [CorrectiveTerms::NONE; COEFFS];
        for slot in &mut terms {
            let [shift, slope, lift, from, to] = words.take()?;
            *slot = CorrectiveTerms { shift, slope, lift, response: [from, to] };
        }
        Some((Self(terms), rest))
    }
}
