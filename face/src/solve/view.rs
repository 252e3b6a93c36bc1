//! Which parts of the face count. What is covered is not read, and its coefficients lead to rest.
//!
//! A network tells how likely each region is in view (`track/visible.rs`). A region that is in view counts in full, so that a
//! face that nothing covers is solved as if this stage did not exist. The weights of the transform `T_a` (eq. 3) and the
//! displacements of `T_d` (eq. 5) are multiplied by what their landmark counts. Where the eyes are covered, the axes of the
//! head are uncertain, and the mouth is read from its picture alone.

use facewire_packet::Visibility;

use super::correction::smoothstep;
use super::filter::{approach, passed};
use super::plausible::{GAZE, index_of, pick, put};
use super::{COEFFS, Coefficients, Wears};
use crate::model::{COORDINATES, DISTANCES, FeatureId, MEASURES};
use crate::track::{
    InView,
    visible::{BRIDGE, BROWS, CHEEKS, LEFT_EYE, MOUTH, REGIONS, RIGHT_EYE, region_of},
};

/// The probabilities of being in view between which a region begins to count and counts in full.
const COUNTS: [f32; 2] = [0.3, 0.6];
/// Time over which 63 % of a change of these probabilities is followed, seconds.
const FOLLOW_S: f32 = 0.07;
/// Bounds of the coefficients that a network gives.
const PART_VALUES: [f32; 2] = [-0.5, 1.5];
/// The coefficients of the lids of the left eye and of the right.
const LIDS: [[usize; 2]; 3] = [
    [index_of("eyeBlinkLeft"), index_of("eyeBlinkRight")],
    [index_of("eyeSquintLeft"), index_of("eyeSquintRight")],
    [index_of("eyeWideLeft"), index_of("eyeWideRight")],
];
const FIRST_OF_BROWS: usize = index_of("browDownLeft");
/// Puffed cheeks, which the network of the mouth sees.
const CHEEK_PUFF: usize = index_of("cheekPuff");
const LAST_OF_CHEEKS: usize = index_of("noseSneerRight");
const LAST_OF_EYES: usize = index_of("eyeWideRight");

/// How likely each region is in view, averaged over a short time so that noise does not show.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct View {
    likely: Option<[f32; REGIONS]>,
}

impl View {
    /// Nothing was seen yet.
    pub(super) const NONE: Self = Self { likely: None };

    /// Follows what was seen in the next frame, `dt_s` seconds later; without it, the whole face counts.
    pub(super) fn next(self, seen: Option<&InView>, wears: Wears, dt_s: f32) -> Self {
        let Some(seen) = seen else { return Self::NONE };
        let mut now = seen.map(|odds| bounded(1.0 / (1.0 + (-odds).exp()), [0.0, 1.0]));
        for region in wears.covers() {
            if let Some(likely) = now.get_mut(*region) {
                *likely = 0.0;
            }
        }
        let mut likely = self.likely.unwrap_or(now);
        approach(&mut likely, &now, passed(dt_s, FOLLOW_S));
        Self { likely: Some(likely) }
    }

    pub(super) fn visibility(self) -> Visibility {
        let Some([left_eye, right_eye, brows, mouth, cheeks]) = self.likely else { return Visibility::WHOLE };
        let face = (left_eye + right_eye + brows + mouth + cheeks) / REGIONS as f32;
        Visibility { left_eye, right_eye, brows, mouth, cheeks, face }
    }

    /// How far each region counts.
    pub(super) fn counts(self) -> Counts {
        self.likely.map_or(Counts::WHOLE, |likely| Counts::new(likely.map(|likely| smoothstep(likely, COUNTS))))
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

/// How far each region counts, from 0 to 1, and as the last number how far what lies between the eyes does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Counts([f32; REGIONS + 1]);

impl Counts {
    /// The whole face counts.
    pub(super) const WHOLE: Self = Self([1.0; REGIONS + 1]);

    fn new(regions: [f32; REGIONS]) -> Self {
        let [left_eye, right_eye, brows, mouth, cheeks] = regions;
        Self([left_eye, right_eye, brows, mouth, cheeks, left_eye.min(right_eye)])
    }

    fn of(&self, region: usize) -> f32 {
        self.0.get(region).copied().unwrap_or(1.0)
    }

    /// How far both eyes count, which carry the axes of the head.
    fn eyes(&self) -> f32 {
        self.of(BRIDGE)
    }

    /// How far the region that counts least does.
    pub(super) fn least(&self) -> f32 {
        self.0.iter().copied().fold(1.0, f32::min)
    }

    /// How far a landmark counts.
    pub(super) fn landmark(&self, landmark: usize) -> f32 {
        self.of(region_of(landmark))
    }

    /// How far a feature counts: a distance as far as the lesser of its landmarks, the turns of the head in full.
    pub(super) fn feature(&self, id: FeatureId) -> f32 {
        let index = id.index();
        if index < COORDINATES {
            return self.landmark(index / 3);
        }
        let pair = index.checked_sub(COORDINATES).filter(|_| index < MEASURES).and_then(|pair| DISTANCES.get(pair));
        pair.map_or(1.0, |(one, other)| self.landmark(*one).min(self.landmark(*other)))
    }

    /// Blends into `raw` what the networks of the parts give: by the model's shares, and the mouth in full where the eyes are
    /// covered.
    pub(super) fn blend(&self, raw: &mut Coefficients, parts: &[f32; COEFFS], shares: &[f32; COEFFS]) {
        let uncertain = 1.0 - self.eyes();
        for (place, ((value, part), share)) in raw.0.iter_mut().zip(parts).zip(shares).enumerate() {
            let is_mouth = region_of_coefficient(place) == MOUTH || place == CHEEK_PUFF;
            let share = if is_mouth { share + (1.0 - share) * uncertain } else { *share };
            *value += share * (bounded(*part, PART_VALUES) - *value);
        }
    }

    /// Leads the coefficients of covered regions to rest. The lids of a covered eye follow those of the other one.
    pub(super) fn rest(&self, coefficients: &mut Coefficients) {
        if self.least() >= 1.0 {
            return;
        }
        let [left, right] = [LEFT_EYE, RIGHT_EYE].map(|region| self.of(region));
        let values = &mut coefficients.0;
        for lids in LIDS {
            let [left_lid, right_lid] = pick(values, lids);
            let either = left.max(right);
            let left_mixed = left_lid + (1.0 - left) * (right_lid - left_lid);
            let right_mixed = right_lid + (1.0 - right) * (left_lid - right_lid);
            put(values, lids, [either * left_mixed, either * right_mixed]);
        }
        for places in GAZE {
            let turned = pick(values, places);
            put(values, places, turned.map(|value| self.eyes() * value));
        }
        // Squinting cheeks and a sneer need the axes of the head, which need the eyes.
        for (place, value) in values.iter_mut().enumerate() {
            match region_of_coefficient(place) {
                region @ (BROWS | MOUTH) => *value *= self.of(region),
                CHEEKS if place == CHEEK_PUFF => *value *= self.of(CHEEKS),
                CHEEKS => *value *= self.of(CHEEKS).min(self.eyes()),
                _ => {}
            }
        }
    }
}

/// Bounds what a network gives for an absurd picture. What is not a number becomes the lower bound.
#[expect(clippy::manual_clamp, reason = "unlike `clamp`, it turns what is not a number into one")]
fn bounded(value: f32, [least, most]: [f32; 2]) -> f32 {
    value.max(least).min(most)
}

/// The region that a coefficient moves. Both eyes count as the left one.
fn region_of_coefficient(place: usize) -> usize {
    match place {
        0..=LAST_OF_EYES => LEFT_EYE,
        FIRST_OF_BROWS..CHEEK_PUFF => BROWS,
        CHEEK_PUFF..=LAST_OF_CHEEKS => CHEEKS,
        _ => MOUTH,
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::solve::filter::FRAME_S;
    use crate::solve::plausible::JAW_OPEN;

    const IN_VIEW: f32 = 8.0;
    const COVERED: f32 = -8.0;

    fn covered(regions: &[usize]) -> InView {
        let mut odds = [IN_VIEW; REGIONS];
        for region in regions {
            odds[*region] = COVERED;
        }
        odds
    }

    fn counts(odds: &InView, wears: Wears) -> Counts {
        View::NONE.next(Some(odds), wears, 0.0).counts()
    }

    #[test]
    fn a_face_in_view_counts_in_full_and_its_coefficients_stay() {
        let values = Coefficients(core::array::from_fn(|index| index as f32 / 60.0));
        for counts in [View::NONE.next(None, Wears::Nothing, 0.0).counts(), counts(&[IN_VIEW; REGIONS], Wears::Nothing)]
        {
            let mut shown = values;
            counts.rest(&mut shown);
            assert_eq!((counts, shown), (Counts::WHOLE, values));
        }
    }

    #[test]
    fn what_becomes_covered_rests_within_a_fifth_of_a_second_and_comes_back_without_a_jump() {
        let headset = covered(&[LEFT_EYE, RIGHT_EYE, BROWS]);
        let mut view = View::NONE.next(Some(&[IN_VIEW; REGIONS]), Wears::Nothing, 0.0);
        let mut last = 1.0;
        for (odds, wanted) in [(headset, 0.0), ([IN_VIEW; REGIONS], 1.0)] {
            for _ in 0..6 {
                view = view.next(Some(&odds), Wears::Nothing, FRAME_S);
                let mut shown = Coefficients([1.0; COEFFS]);
                view.counts().rest(&mut shown);
                let brow = shown.0[FIRST_OF_BROWS];
                assert!((brow - last).abs() < 0.9, "{last} to {brow}");
                assert_eq!(shown.0[JAW_OPEN], 1.0, "the mouth is in view");
                last = brow;
            }
            assert!((last - wanted).abs() < 0.01, "{last}");
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
        let mut parts = [0.0; COEFFS];
        parts[JAW_OPEN] = 0.8;
        let mut shares = [0.0; COEFFS];
        shares[JAW_OPEN] = 0.25;
        for (odds, wanted) in [([IN_VIEW; REGIONS], 0.2), (covered(&[LEFT_EYE, RIGHT_EYE, BROWS]), 0.8)] {
            let mut raw = Coefficients([0.0; COEFFS]);
            counts(&odds, Wears::Nothing).blend(&mut raw, &parts, &shares);
            assert!((raw.0[JAW_OPEN] - wanted).abs() < 1e-3, "{}", raw.0[JAW_OPEN]);
        }
    }

    #[test]
    fn what_the_wearer_has_on_covers_its_regions_whatever_is_seen() {
        for (wears, regions) in [(Wears::Headset, &[LEFT_EYE, RIGHT_EYE, BROWS][..]), (Wears::Mask, &[MOUTH])] {
            assert_eq!(counts(&[IN_VIEW; REGIONS], wears), counts(&covered(regions), Wears::Nothing), "{wears:?}");
        }
    }

    #[test]
    fn features_count_as_far_as_the_least_of_their_landmarks() {
        let counts = counts(&covered(&[LEFT_EYE]), Wears::Nothing);
        let of = |name: &str| counts.feature(FeatureId::from_name(name).expect("known"));
        // Landmark 386 is on the lid of the left eye, 159 on that of the right, 61 at the mouth, 168 between the eyes.
        assert_eq!(["x386", "z386", "d385-380", "d334-386", "y168"].map(of), [0.0; 5]);
        assert_eq!(["x159", "y61", "d13-14", "d105-159", "yaw"].map(of), [1.0; 5]);
    }
}
