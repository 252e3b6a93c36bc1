//! Which parts of the face count. The coefficients of what is covered lead to rest.
//!
//! A network tells how likely each region is in view (`track/visible.rs`). What is in view counts in full, so that a face
//! that nothing has covered is solved as if this stage did not exist. The mesh network guesses covered landmarks from those
//! around them: for eyes behind sunglasses or brows behind hair, that guess has less error than rest (docs/figures.md). It
//! fails in two cases. Nothing around a covered mouth tells how it moves. And where eyes and brows are covered together, as
//! by a headset, the axes of the head are wrong, and with them all that the landmarks tell: there the mouth is read from its
//! picture.

use facewire_packet::Visibility;

use super::correction::smoothstep;
use super::filter::{approach, passed};
use super::plausible::{GAZE, LIDS, index_of, pick, put};
use super::{Coefficients, Wears};
use crate::track::{
    InView, MOUTH_VALUES, MouthValues,
    visible::{BROWS, LEFT_EYE, MOUTH, REGIONS, RIGHT_EYE, likely_in_view, upper_half},
};

/// The probabilities of being in view between which a part begins to count and counts in full: for the upper half of the face,
/// the mean of its regions.
const UPPER_HALF_COUNTS: [f32; 2] = [0.1, 0.25];
const MOUTH_COUNTS: [f32; 2] = [0.05, 0.25];
const EYE_COUNTS: [f32; 2] = [0.2, 0.5];
/// Time over which 63 % of a change is followed, seconds.
const FOLLOW_S: f32 = 0.06;
const FIRST_OF_MOUTH: usize = index_of("jawForward");
const LAST_OF_MOUTH: usize = index_of("mouthUpperUpRight");
/// Puffed cheeks, which the network of the mouth sees.
const CHEEK_PUFF: usize = index_of("cheekPuff");
/// The coefficients that the network of the mouth gives: from `jawForward` to `mouthUpperUpRight`, and `cheekPuff`.
#[expect(clippy::indexing_slicing, reason = "the compiler computes it")]
const MOUTH_COEFFICIENTS: [usize; MOUTH_VALUES] = {
    let mut places = [CHEEK_PUFF; MOUTH_VALUES];
    let mut index = 0;
    while FIRST_OF_MOUTH + index <= LAST_OF_MOUTH {
        places[index] = FIRST_OF_MOUTH + index;
        index += 1;
    }
    places
};
/// The log-odds of a region that is certainly in view.
const IN_VIEW: f32 = 8.0;
/// Bounds of the coefficients that the network gives.
const MOUTH_RANGE: [f32; 2] = [-0.5, 1.5];

/// What was seen of the face, averaged over a short time so that noise does not show and nothing jumps.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct View {
    /// How likely each region is in view, and how far the parts count; `None` if nothing was seen yet.
    seen: Option<([f32; REGIONS], Counts)>,
}

impl View {
    /// Follows what was seen in the next frame, `dt_s` seconds later. Without it, the whole face counts.
    pub(super) fn next(self, odds: Option<&InView>, wears: Wears, dt_s: f32) -> Self {
        let Some(odds) = odds else { return Self::default() };
        let mut likely_now = likely_in_view(odds);
        for region in wears.covers() {
            if let Some(likely) = likely_now.get_mut(*region) {
                *likely = 0.0;
            }
        }
        let counts_now = Counts::new(&likely_now);
        let (mut likely, mut counts) = self.seen.unwrap_or((likely_now, counts_now));
        let share = passed(dt_s, FOLLOW_S);
        approach(&mut likely, &likely_now, share);
        approach(&mut counts.0, &counts_now.0, share);
        Self { seen: Some((likely, counts)) }
    }

    pub(super) fn visibility(self) -> Visibility {
        let Some(([left_eye, right_eye, brows, mouth, cheeks], _)) = self.seen else { return Visibility::WHOLE };
        let face = (left_eye + right_eye + brows + mouth + cheeks) / REGIONS as f32;
        Visibility { left_eye, right_eye, brows, mouth, cheeks, face }
    }

    /// How far the parts of the face count.
    pub(super) fn counts(self) -> Counts {
        self.seen.map_or(Counts::WHOLE, |(_, counts)| counts)
    }
}

impl Wears {
    /// The regions that it covers at all times.
    fn covers(self) -> &'static [usize] {
        match self {
            Self::Nothing => &[],
            Self::Headset => &[LEFT_EYE, RIGHT_EYE, BROWS],
            Self::Mask => &[MOUTH],
        }
    }
}

/// Keeps only the coefficients that `wears` leaves in view, as the solver does: under a headset, the mouth is read from its
/// picture, and what is covered becomes 0.
pub fn keep_in_view(wears: Wears, raw: &mut Coefficients, mouth: Option<&MouthValues>) {
    let counts = View::default().next(Some(&[IN_VIEW; REGIONS]), wears, 0.0).counts();
    if let Some(mouth) = mouth {
        counts.look_at_mouth(raw, mouth);
    }
    counts.rest(raw);
}

/// How far the upper half of the face, the mouth, the left eye and the right eye count, from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Counts([f32; 4]);

impl Counts {
    /// The whole face counts.
    pub(super) const WHOLE: Self = Self([1.0; 4]);

    fn new(likely: &[f32; REGIONS]) -> Self {
        let [left_eye, right_eye, _, mouth, _] = likely;
        Self([
            smoothstep(upper_half(likely), UPPER_HALF_COUNTS),
            smoothstep(*mouth, MOUTH_COUNTS),
            smoothstep(*left_eye, EYE_COUNTS),
            smoothstep(*right_eye, EYE_COUNTS),
        ])
    }

    /// Whether all parts count in full.
    pub(super) fn are_whole(&self) -> bool {
        self.0.iter().all(|count| *count > 0.999)
    }

    /// Puts what the picture of the mouth shows in the place of what the landmarks do, as far as the upper half is covered.
    pub(super) fn look_at_mouth(&self, raw: &mut Coefficients, mouth: &MouthValues) {
        let share = self.share_of_mouth_from_picture();
        if share <= 0.0 {
            return;
        }
        for (place, seen) in MOUTH_COEFFICIENTS.into_iter().zip(mouth) {
            if let Some(value) = raw.0.get_mut(place) {
                *value += share * (bounded(*seen, MOUTH_RANGE) - *value);
            }
        }
    }

    /// The share of the mouth that is read from its picture, from 0 to 1: as far as the upper half is covered.
    pub(super) fn share_of_mouth_from_picture(&self) -> f32 {
        let [upper_half, ..] = self.0;
        1.0 - upper_half
    }

    /// Undoes what the profile of a bare face has corrected of the mouth, as far as the mouth is read from its picture: there,
    /// `without_profile` replaces it. The profile's rest and gain were learned from landmarks, and not from the picture.
    pub(super) fn leave_mouth_from_picture_to(&self, without_profile: &Coefficients, corrected: &mut Coefficients) {
        let share = self.share_of_mouth_from_picture();
        for place in MOUTH_COEFFICIENTS {
            if let (Some(value), Some(without_profile)) = (corrected.0.get_mut(place), without_profile.0.get(place)) {
                *value += share * (without_profile - *value);
            }
        }
    }

    /// Leads the coefficients of what is covered to rest. The lids of a covered eye follow those of the other one.
    pub(super) fn rest(&self, coefficients: &mut Coefficients) {
        if self.0 == Self::WHOLE.0 {
            return;
        }
        let [upper_half, mouth, left_eye, right_eye] = self.0;
        let values = &mut coefficients.0;
        for lids in LIDS {
            let [left, right] = pick(values, lids);
            // If both eyes are covered, each keeps its own lids.
            let left_share = (right_eye - left_eye).max(0.0);
            let right_share = (left_eye - right_eye).max(0.0);
            put(values, lids, [left + left_share * (right - left), right + right_share * (left - right)]);
        }
        let one_eye = 1.0 - (left_eye - right_eye).abs();
        for places in GAZE {
            let turned = pick(values, places);
            put(values, places, turned.map(|value| one_eye * value));
        }
        for (place, value) in values.iter_mut().enumerate() {
            let is_mouth = (FIRST_OF_MOUTH..=LAST_OF_MOUTH).contains(&place) || place == CHEEK_PUFF;
            *value *= if is_mouth { mouth } else { upper_half };
        }
    }
}

/// Bounds what a network gives for an absurd picture. What is not a number becomes the lower bound.
fn bounded(value: f32, [least, most]: [f32; 2]) -> f32 {
    value.max(least).min(most)
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::solve::COEFFS;
    use crate::solve::filter::FRAME_S;
    use crate::solve::plausible::JAW_OPEN;

    const COVERED: f32 = -8.0;

    fn covered(regions: &[usize]) -> InView {
        let mut odds = [IN_VIEW; REGIONS];
        for region in regions {
            odds[*region] = COVERED;
        }
        odds
    }

    fn counts(odds: &InView, wears: Wears) -> Counts {
        View::default().next(Some(odds), wears, 0.0).counts()
    }

    #[test]
    fn a_face_in_view_counts_in_full_and_its_coefficients_stay() {
        let values = Coefficients(core::array::from_fn(|index| index as f32 / 60.0));
        for counts in
            [View::default().next(None, Wears::Nothing, 0.0).counts(), counts(&[IN_VIEW; REGIONS], Wears::Nothing)]
        {
            let mut shown = values;
            counts.rest(&mut shown);
            assert_eq!((counts, shown), (Counts::WHOLE, values));
        }
    }

    #[test]
    fn what_becomes_covered_rests_within_a_fifth_of_a_second_and_comes_back_without_a_jump() {
        let headset = covered(&[LEFT_EYE, RIGHT_EYE, BROWS]);
        let mut view = View::default().next(Some(&[IN_VIEW; REGIONS]), Wears::Nothing, 0.0);
        let mut last = 1.0;
        for (odds, wanted) in [(headset, 0.0), ([IN_VIEW; REGIONS], 1.0)] {
            for _ in 0..6 {
                view = view.next(Some(&odds), Wears::Nothing, FRAME_S);
                let mut shown = Coefficients([1.0; COEFFS]);
                view.counts().rest(&mut shown);
                let brow = shown.0[index_of("browDownLeft")];
                assert!((brow - last).abs() < 0.5, "{last} to {brow}");
                assert_eq!(shown.0[JAW_OPEN], 1.0, "the mouth is in view");
                last = brow;
            }
            assert!((last - wanted).abs() < 0.05, "{last}");
        }
    }

    #[test]
    fn lids_of_a_covered_eye_follow_the_other_one_and_the_gaze_rests() {
        let mut shown = Coefficients([0.0; COEFFS]);
        shown.0[index_of("eyeBlinkLeft")] = 0.2;
        shown.0[index_of("eyeBlinkRight")] = 0.9;
        shown.0[index_of("eyeLookUpRight")] = 0.7;
        counts(&covered(&[LEFT_EYE]), Wears::Nothing).rest(&mut shown);
        let blinks = [index_of("eyeBlinkLeft"), index_of("eyeBlinkRight")].map(|place| shown.0[place]);
        assert!(blinks.iter().all(|blink| (blink - 0.9).abs() < 0.01), "{blinks:?}");
        assert_eq!(shown.0[index_of("eyeLookUpRight")], 0.0);
    }

    #[test]
    fn mouth_is_read_from_its_picture_alone_where_a_headset_covers_the_eyes() {
        let mut mouth = [0.1; MOUTH_VALUES];
        mouth[JAW_OPEN - FIRST_OF_MOUTH] = 0.8;
        mouth[MOUTH_VALUES - 1] = f32::NAN;
        let show = |odds: &InView| {
            let mut raw = Coefficients([0.3; COEFFS]);
            counts(odds, Wears::Nothing).look_at_mouth(&mut raw, &mouth);
            raw
        };
        for landmarks_do in [&[][..], &[LEFT_EYE, RIGHT_EYE], &[BROWS]] {
            assert_eq!(show(&covered(landmarks_do)).0, [0.3; COEFFS], "{landmarks_do:?}");
        }
        let shown = show(&covered(&[LEFT_EYE, RIGHT_EYE, BROWS])).0;
        let of = |name: &str| shown[crate::BLENDSHAPES.iter().position(|known| *known == name).expect("known")];
        let wanted = [("jawOpen", 0.8), ("jawForward", 0.1), ("mouthUpperUpRight", 0.1), ("browDownLeft", 0.3)];
        for (name, wanted) in wanted {
            assert!((of(name) - wanted).abs() < 1e-4, "{name}: {}", of(name));
        }
        assert!(of("cheekPuff").is_finite(), "an absurd picture gives no absurd value");
    }

    #[test]
    fn what_the_wearer_has_on_covers_its_regions_whatever_is_seen() {
        for (wears, regions) in [(Wears::Headset, &[LEFT_EYE, RIGHT_EYE, BROWS][..]), (Wears::Mask, &[MOUTH])] {
            assert_eq!(counts(&[IN_VIEW; REGIONS], wears), counts(&covered(regions), Wears::Nothing), "{wears:?}");
        }
    }
}
