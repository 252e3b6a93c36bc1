//! Which face is followed when there are several, and whether the landmarks are still those of the wearer.
//!
//! While a face is followed, its place, its score, its rigid shape and its look in the mesh network's feature map are
//! averaged. Somebody who passes in front of it leaves traces: for some frames the landmarks are a mixture of two faces,
//! whose shape is none and whose score is low, or the face jumps. If it is elsewhere or looks different after that, it is
//! another one. The wearer is then searched for near where they were; a face that is found there has to stay and to look
//! alike for some frames. The longer the wearer is away, the farther away they may come back, until another face is taken in
//! their place.
//!
//! In rendered videos of ten people, a shape that is averaged over a second differs by at most 5 from that of a single frame,
//! and by 10 to 90 while two faces mix. Limits: someone with a similar face who stops for half a second right in front of the
//! wearer, at the same distance from the camera, counts as the wearer.

use super::landmarks::{Face, FaceBox};
use crate::model::APPEARANCE_CHANNELS;
use crate::solve::identity::{SHAPE, shape_of_frontal};
use crate::solve::normalise;

/// Which face is followed when several are in the picture and none of them is followed yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Follow {
    /// The largest one.
    Nearest,
    /// The one nearest to the middle of the picture.
    Centre,
    /// The one that is where the wearer was and looks like the wearer; as long as none is known, a large one near the middle.
    #[default]
    Wearer,
}

/// Standard deviation of each channel of the feature map, averaged over the face, from its mean over a second.
const SKIN_DEVIATION: [f32; APPEARANCE_CHANNELS] = [
    0.16, 0.10, 0.24, 0.14, 0.13, 0.11, 0.12, 0.10, 0.10, 0.18, 0.08, 0.20, 0.14, 0.17, 0.06, 0.15, 0.09, 0.02, 0.08,
    0.05, 0.06, 0.06, 0.06, 0.04, 0.06, 0.05, 0.06, 0.08, 0.06, 0.04, 0.07, 0.11,
];
/// That of the measures of the shape, which are in units of the deviation of longer averages.
const SHAPE_DEVIATION: f32 = 1.8;

/// Times over which the look, the place shortly before and the usual place are averaged, seconds.
const LOOK_S: f32 = 1.0;
const PLACE_S: f32 = 0.15;
const SEAT_S: f32 = 3.0;
/// Time for which a face has to be followed before it is known, seconds.
const KNOWN_S: f32 = 0.5;
/// Longest time that counts from one frame to the next, and the shortest, seconds.
const STEPS_S: [f32; 2] = [1.0 / 30.0, 0.1];

/// A shape that differs by more is a mixture of two faces, or the face is covered. So is one with a lower share of the usual
/// score.
const MIXED: f32 = 10.0;
const COVERED: f32 = 0.65;
/// Smallest score of a face in view.
const IN_VIEW: f32 = 15.0;
/// Fastest movement of heads, sizes of the face a second, and their fastest change of size.
const MOST_SPEED: f32 = 4.0;
const MOST_ZOOM: f32 = 4.0;
/// Time for which a face is in doubt after the last trace of another one, seconds.
const DOUBT_S: f32 = 0.3;
/// Time after which a face that stays in doubt is learned anew, seconds: the wearer has put on a headset or a mask.
const SETTLES_S: f32 = 3.0;
/// Distance from where the face was, in its sizes, and relative change of size from which on a face in doubt is another one.
const ELSEWHERE: f32 = 0.2;
/// Time over which the place of a face in doubt is averaged, seconds. A wearer who drinks moves more slowly than one who
/// passes.
const DOUBT_PLACE_S: f32 = 0.4;

/// What a face that may be the wearer's may differ by: the look, the place in sizes of the face, and the size. The last two
/// grow by the second for each second since the wearer was seen last.
const LOOK: f32 = 12.0;
const NEAR: [f32; 2] = [0.5, 0.4];
const SIZE: [f32; 2] = [0.4, 0.2];
/// Time after which another face is taken in place of the wearer's, and after which one is taken by another rule, seconds.
const PATIENCE_S: f32 = 5.0;
const SHORT_PATIENCE_S: f32 = 1.0;
/// Number of frames in which a face must be like the wearer's. It must not move faster than this meanwhile, sizes a second.
const TRIAL: u32 = 3;
const TRIAL_SPEED: f32 = 1.6;
/// Time after which a face that stays may look twice as different: the wearer may have put on glasses, or be half covered.
const STAY_S: f32 = 0.7;
/// A face that differs by less than this share of what is allowed is the wearer's at once, if no other was in its place.
const SURE: f32 = 0.5;

/// Time for which it is watched whether the wearer appears beside the face that is followed: after a doubt, after a first
/// face was found, and after another one was taken, seconds.
const AFTER_DOUBT_S: f32 = 3.0;
const AFTER_FIRST_S: f32 = 5.0;
const AFTER_OTHER_S: f32 = 30.0;
/// How much larger or nearer to the middle a face must be to be a better choice than the one found first.
const CLEARLY: f32 = 0.3;
/// How much nearer to the middle, as a share of the longer side of the picture, makes up for a face that is 2.7 times as small.
const MIDDLE: f32 = 2.0;

/// What is known of the face that is followed, and what is in doubt.
#[derive(Debug, Default)]
pub struct Wearer {
    pub(super) follow: Follow,
    look: Look,
    score: f32,
    place: Place,
    seat: Place,
    last: Option<Place>,
    doubt_s: f32,
    /// For how long the face has been in doubt without a break.
    doubted_s: f32,
    /// For how long the wearer has not been seen.
    pub(super) away_s: f32,
    /// Frames of the trial that are left, and for how long it has lasted.
    trial: u32,
    stay_s: f32,
    /// Whether a face that was followed turned out to be another one.
    pub(super) is_wary: bool,
    watch: Watch,
    watch_s: f32,
}

/// Why it is watched whether the wearer appears.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Watch {
    #[default]
    Doubt,
    /// The face is the first one.
    First,
    /// The face is not the wearer's.
    Other,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    Wearer,
    /// It is not decided yet.
    Open,
    Other,
}

/// The middle and the size of a face in the picture, pixels.
#[derive(Debug, Clone, Copy, Default)]
struct Place {
    centre: [f32; 2],
    size: f32,
}

impl From<&FaceBox> for Place {
    fn from(&FaceBox { centre, size, .. }: &FaceBox) -> Self {
        // That of the face, without the margin of the region.
        Self { centre, size: size / super::landmarks::MARGIN }
    }
}

impl Place {
    /// The distance in sizes of this face.
    fn distance(&self, other: &Self) -> f32 {
        let [x, y] = self.centre;
        let [other_x, other_y] = other.centre;
        length([other_x - x, other_y - y]) / self.size.max(1.0)
    }

    /// The natural logarithm of the ratio of the sizes, without its sign.
    fn zoom(&self, other: &Self) -> f32 {
        (other.size.max(1.0) / self.size.max(1.0)).ln().abs()
    }

    fn approach(&mut self, to: &Self, passed: f32) {
        approach(&mut self.centre, &to.centre, passed);
        self.size += passed * (to.size - self.size);
    }
}

/// How a face looks: the mean of the feature map over the landmarks, and the shape, in units of their deviations. The shape is
/// known of frames in which the face faces the camera.
#[derive(Debug, Default)]
struct Look {
    skin: [f32; APPEARANCE_CHANNELS],
    known_s: f32,
    shape: [f32; SHAPE],
    shape_s: f32,
}

/// The look in one frame.
struct Seen {
    skin: [f32; APPEARANCE_CHANNELS],
    shape: Option<[f32; SHAPE]>,
}

/// How the look of a frame differs, each as a mean square.
#[derive(Clone, Copy)]
struct Difference {
    skin: f32,
    shape: Option<f32>,
}

impl Seen {
    fn new(face: &Face) -> Self {
        let mut skin = [0.0; APPEARANCE_CHANNELS];
        if let Some(appearance) = face.appearance {
            let share = 1.0 / appearance.skin.len().max(1) as f32;
            for row in &appearance.skin {
                skin.iter_mut().zip(row).for_each(|(sum, value)| *sum += share * value);
            }
        }
        skin.iter_mut().zip(SKIN_DEVIATION).for_each(|(value, deviation)| *value /= deviation);
        let shape = normalise(face.landmarks).ok().and_then(|face| shape_of_frontal(&face));
        Self { skin, shape: shape.map(|shape| shape.map(|value| value / SHAPE_DEVIATION)) }
    }
}

impl Seen {
    fn is_finite(&self) -> bool {
        self.skin.iter().chain(self.shape.iter().flatten()).all(|value| value.is_finite())
    }
}

impl Look {
    fn difference(&self, seen: &Seen) -> Difference {
        let shape = seen.shape.filter(|_| self.shape_s > 0.0);
        Difference {
            skin: mean_square(&self.skin, &seen.skin),
            shape: shape.map(|seen| mean_square(&self.shape, &seen)),
        }
    }

    fn learn(&mut self, seen: &Seen, step_s: f32) {
        approach(&mut self.skin, &seen.skin, share(step_s, self.known_s.min(LOOK_S)));
        self.known_s = (self.known_s + step_s).min(SEAT_S);
        if let Some(shape) = &seen.shape {
            approach(&mut self.shape, shape, share(step_s, self.shape_s));
            self.shape_s = (self.shape_s + step_s).min(LOOK_S);
        }
    }
}

impl Difference {
    /// The look of a face that does not face the camera is known by half.
    fn sum(self) -> f32 {
        self.skin + self.shape.unwrap_or(self.skin)
    }

    fn is_mixed(self) -> bool {
        self.shape.is_some_and(|shape| shape > MIXED)
    }
}

impl Wearer {
    /// Lets time pass in which the wearer is not seen.
    pub(super) fn miss(&mut self, step_s: f32) {
        self.away_s += step_s;
    }

    /// Learns from the next frame of a face that is the wearer's beyond doubt, `step_s` after the last one, if it is in view.
    pub fn learn_from(&mut self, face: &Face, region: &FaceBox, step_s: f32) {
        let seen = Seen::new(face);
        let score = face.appearance.map_or(0.0, |appearance| appearance.score);
        let is_mixed = self.is_known() && self.look.difference(&seen).is_mixed();
        if score >= IN_VIEW && !is_mixed && seen.is_finite() {
            self.learn(&region.into(), &seen, score, step_s.min(STEPS_S[1]));
        }
    }

    /// How little a face that has just been found is like the wearer's, who has been away for `away_s`: up to 1 it is theirs,
    /// because it looks the same or, for some seconds, because it looks alike and is where theirs was. `None` if the wearer is
    /// not known yet.
    pub fn strangeness(&self, face: &Face, region: &FaceBox, away_s: f32) -> Option<f32> {
        let of_look = self.look.difference(&Seen::new(face)).sum() / LOOK;
        let of_place = self.strangeness_of_place(&region.into(), away_s);
        let here = if away_s < PATIENCE_S { of_place + of_look } else { f32::INFINITY };
        let strangeness = here.min(of_look / SURE);
        (self.is_known() && !strangeness.is_nan()).then_some(strangeness)
    }

    /// Forgets all but the rule.
    pub fn forget(&mut self) {
        *self = Self { follow: self.follow, ..Self::default() };
    }

    /// Whether the face was seen for long enough to be known again.
    pub fn is_known(&self) -> bool {
        self.look.known_s >= KNOWN_S
    }

    fn is_patient(&self) -> bool {
        let patience_s = if self.follow == Follow::Wearer { PATIENCE_S } else { SHORT_PATIENCE_S };
        self.is_known() && self.away_s < patience_s
    }

    /// The face to follow of those that the detector has found in a picture of this size.
    pub(super) fn choose(&mut self, faces: &[FaceBox], size_px: [f32; 2]) -> Option<FaceBox> {
        self.last = None;
        let place = |face: &FaceBox| self.strangeness_of_place(&Place::from(face), self.away_s);
        let merit = |face: &FaceBox| self.merit(face, size_px);
        if self.is_patient() {
            let nearest = faces.iter().min_by(|one, other| place(one).total_cmp(&place(other)));
            let chosen = *nearest.filter(|face| place(face) < 1.0)?;
            (self.trial, self.stay_s) = (TRIAL, 0.0);
            return Some(chosen);
        }
        let best = *faces.iter().max_by(|one, other| merit(one).total_cmp(&merit(other)))?;
        self.trial = 0;
        (self.watch, self.watch_s) =
            if self.is_known() { (Watch::Other, AFTER_OTHER_S) } else { (Watch::First, AFTER_FIRST_S) };
        if self.watch == Watch::First {
            self.forget_look();
        }
        Some(best)
    }

    /// Another face that is to be followed instead of the one in `region`, if there is one.
    pub(super) fn better(&mut self, region: &FaceBox, faces: &[FaceBox], size_px: [f32; 2]) -> Option<FaceBox> {
        let mine = Place::from(region);
        let others = faces.iter().filter(|face| !region.is_same(face));
        let away = |face: &FaceBox| self.seat.distance(&Place::from(face));
        if self.watch == Watch::First {
            let merit = |face: &FaceBox| self.merit(face, size_px);
            let best = *others.max_by(|one, other| merit(one).total_cmp(&merit(other)))?;
            if merit(&best) < merit(region) + CLEARLY {
                return None;
            }
            self.forget_look();
            return Some(best);
        }
        let best = *others.min_by(|one, other| away(one).total_cmp(&away(other)))?;
        let is_back = self.strangeness_of_place(&Place::from(&best), self.away_s) < 1.0
            && away(&best) + ELSEWHERE < self.seat.distance(&mine);
        is_back.then(|| {
            (self.trial, self.stay_s) = (TRIAL, 0.0);
            self.last = None;
            best
        })
    }

    pub(super) fn is_watched(&self) -> bool {
        self.watch_s > 0.0 && self.trial == 0
    }

    /// Judges a face that was found `step_s` after the last frame, and learns from it.
    pub(super) fn judge(&mut self, face: &Face, region: &FaceBox, step_s: f32) -> Verdict {
        let place = Place::from(region);
        let seen = Seen::new(face);
        let score = face.appearance.map_or(0.0, |appearance| appearance.score);
        if !seen.is_finite() || !score.is_finite() {
            return Verdict::Other;
        }
        let difference = self.look.difference(&seen);
        let last = self.last.replace(place).unwrap_or(place);
        let speed = last.distance(&place) / step_s.max(STEPS_S[0]);
        let zoom = last.zoom(&place) / step_s.max(STEPS_S[0]);
        self.watch_s -= step_s;
        if self.trial > 0 {
            return self.try_face(&place, difference, speed, step_s);
        }
        self.away_s = 0.0;
        if self.watch == Watch::Other {
            if self.watch_s > 0.0 {
                return Verdict::Wearer;
            }
            // The wearer has not come back: this face is now the one that is known.
            self.forget_look();
            self.watch = Watch::Doubt;
        }
        if self.is_known() {
            let is_covered = score < COVERED * self.score;
            let is_traced = is_covered || difference.is_mixed() || speed > MOST_SPEED || zoom > MOST_ZOOM;
            self.doubt_s = if is_traced { DOUBT_S } else { self.doubt_s - step_s };
            self.doubted_s = if self.doubt_s > 0.0 { self.doubted_s + step_s } else { 0.0 };
            if self.doubted_s > SETTLES_S {
                // Who stays there and looks different has something on.
                self.forget_look();
            } else if self.doubt_s > 0.0 {
                return self.doubt(&place, step_s);
            }
        }
        self.learn(&place, &seen, score, step_s.min(STEPS_S[1]));
        Verdict::Wearer
    }

    /// Judges a face while it is in doubt.
    fn doubt(&mut self, place: &Place, step_s: f32) -> Verdict {
        (self.watch, self.watch_s) = (Watch::Doubt, AFTER_DOUBT_S);
        if self.place.distance(place) > ELSEWHERE || self.place.zoom(place) > ELSEWHERE {
            self.is_wary = true;
            self.doubt_s = 0.0;
            return Verdict::Other;
        }
        self.place.approach(place, share(step_s, DOUBT_PLACE_S));
        Verdict::Wearer
    }

    /// Judges a face that may be the wearer's.
    fn try_face(&mut self, place: &Place, difference: Difference, speed: f32, step_s: f32) -> Verdict {
        // In the region of the detector, the landmarks are not exact yet.
        let is_first = self.trial == TRIAL && self.stay_s <= 0.0;
        self.stay_s += step_s;
        let of_place = self.strangeness_of_place(place, self.away_s);
        let of_look = difference.sum() / (LOOK * (1.0 + (self.stay_s / STAY_S).powi(2)));
        if of_place > (if is_first { 2.0 } else { 1.0 }) || (!is_first && speed > TRIAL_SPEED) {
            self.is_wary = true;
            return Verdict::Other;
        }
        let strangeness = of_place + of_look;
        if strangeness <= 1.0 {
            self.trial -= 1;
        }
        if strangeness < SURE && !self.is_wary {
            self.trial = 0;
        }
        if self.trial > 0 {
            return Verdict::Open;
        }
        if of_place > SURE && difference.sum() > LOOK {
            // Nothing speaks for the wearer but that it has stayed.
            (self.watch, self.watch_s) = (Watch::Other, AFTER_OTHER_S);
        } else {
            self.place = *place;
            (self.watch, self.watch_s) = (Watch::Doubt, AFTER_DOUBT_S);
        }
        self.is_wary = false;
        self.away_s = 0.0;
        Verdict::Wearer
    }

    fn learn(&mut self, place: &Place, seen: &Seen, score: f32, step_s: f32) {
        let known_s = self.look.known_s;
        self.look.learn(seen, step_s);
        self.score += share(step_s, known_s.min(LOOK_S)) * (score - self.score);
        self.place.approach(place, share(step_s, known_s.min(PLACE_S)));
        self.seat.approach(place, share(step_s, known_s.min(SEAT_S)));
    }

    fn forget_look(&mut self) {
        (self.look, self.last, self.is_wary) = (Look::default(), None, false);
        (self.doubt_s, self.doubted_s, self.away_s) = (0.0, 0.0, 0.0);
    }

    /// How little a place suits the wearer: up to 1 it may be theirs.
    fn strangeness_of_place(&self, place: &Place, away_s: f32) -> f32 {
        let [near, size] = [NEAR, SIZE].map(|[at_once, per_s]| at_once + per_s * away_s);
        let strangeness = |from: &Place| from.distance(place) / near + from.zoom(place) / size;
        strangeness(&self.place).min(strangeness(&self.seat))
    }

    fn merit(&self, face: &FaceBox, [width, height]: [f32; 2]) -> f32 {
        let Place { centre: [x, y], size } = face.into();
        let longer = width.max(height);
        let near = (size / longer).max(f32::EPSILON).ln();
        let middle = -length([x - 0.5 * width, y - 0.5 * height]) / longer;
        match self.follow {
            Follow::Nearest => near,
            Follow::Centre => MIDDLE * middle,
            Follow::Wearer => near + MIDDLE * middle,
        }
    }
}

/// Not by `hypot`, which needs a C library that is newer than those of the systems that packages are for.
fn length([x, y]: [f32; 2]) -> f32 {
    (x * x + y * y).sqrt()
}

/// Share of a new value in an average over `average_s`.
fn share(step_s: f32, average_s: f32) -> f32 {
    if average_s > 0.0 { (step_s / (average_s + step_s)).min(1.0) } else { 1.0 }
}

fn approach(values: &mut [f32], to: &[f32], share: f32) {
    values.iter_mut().zip(to).for_each(|(value, to)| *value += share * (to - *value));
}

fn mean_square(one: &[f32], other: &[f32]) -> f32 {
    one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f32>() / one.len().max(1) as f32
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::testing::face;
    use crate::track::{Appearance, LANDMARKS, Landmarks};

    const FRAME_S: f32 = 1.0 / 30.0;
    const SIZE_PX: [f32; 2] = [640.0, 480.0];

    /// A face in a picture of [`SIZE_PX`], as the mesh shows it.
    #[derive(Clone)]
    struct Person {
        at_px: [f32; 2],
        size_px: f32,
        /// Which is the same for the same person.
        skin: f32,
        score: f32,
    }

    const WEARER: Person = Person { at_px: [320.0, 240.0], size_px: 150.0, skin: 0.0, score: 25.0 };

    impl Person {
        fn at(&self, x_px: f32) -> Self {
            Self { at_px: [x_px, self.at_px[1]], ..self.clone() }
        }

        fn region(&self) -> FaceBox {
            FaceBox { centre: self.at_px, size: 1.5 * self.size_px, angle_rad: 0.0 }
        }

        fn judged(&self, wearer: &mut Wearer) -> Verdict {
            let landmarks = face([0.0; 3], self.size_px / 3.0, self.at_px);
            let mut appearance = Appearance::zero();
            appearance.skin.iter_mut().for_each(|row| *row = SKIN_DEVIATION.map(|deviation| self.skin * deviation));
            appearance.score = self.score;
            let face = Face { landmarks: &landmarks, appearance: Some(&appearance) };
            let verdict = wearer.judge(&face, &self.region(), FRAME_S);
            if verdict != Verdict::Wearer {
                wearer.miss(FRAME_S);
            }
            verdict
        }
    }

    /// What is known of the wearer after two seconds.
    fn known() -> Wearer {
        let mut wearer = Wearer::default();
        wearer.choose(&[WEARER.region()], SIZE_PX);
        assert!((0..60).all(|_| WEARER.judged(&mut wearer) == Verdict::Wearer));
        wearer
    }

    /// The number of frames after which the face that the detector finds alone is followed, if it is within 10 s.
    fn frames_until_followed(wearer: &mut Wearer, person: &Person) -> Option<usize> {
        (0..300).find(|_| {
            let is_chosen = wearer.trial > 0 || wearer.choose(&[person.region()], SIZE_PX).is_some();
            if !is_chosen {
                wearer.miss(FRAME_S);
                return false;
            }
            let verdict = person.judged(wearer);
            if verdict == Verdict::Other {
                wearer.trial = 0;
            }
            verdict == Verdict::Wearer
        })
    }

    #[test]
    fn of_several_faces_the_rule_chooses_the_largest_the_one_in_the_middle_or_a_large_one_near_it() {
        let [large, middle, both] = [(100.0, 170.0), (320.0, 90.0), (380.0, 150.0)]
            .map(|(x_px, size_px)| Person { size_px, ..WEARER.at(x_px) }.region());
        for (follow, want) in [(Follow::Nearest, large), (Follow::Centre, middle), (Follow::Wearer, both)] {
            let mut wearer = Wearer { follow, ..Wearer::default() };
            assert_eq!(wearer.choose(&[large, middle, both], SIZE_PX), Some(want), "{follow:?}");
        }
    }

    #[test]
    fn a_face_that_jumps_or_is_covered_and_then_elsewhere_is_another_one() {
        assert_eq!(WEARER.at(360.0).judged(&mut known()), Verdict::Other, "a jump");
        let mut wearer = known();
        assert_eq!(Person { score: 5.0, ..WEARER }.judged(&mut wearer), Verdict::Wearer, "covered");
        let drifts = (1..10).map(|frame| WEARER.at(320.0 + 8.0 * frame as f32).judged(&mut wearer));
        assert_eq!(drifts.filter(|verdict| *verdict == Verdict::Other).count(), 1);
    }

    #[test]
    fn a_wearer_who_moves_as_heads_do_or_covers_the_face_and_stays_is_followed_all_the_time() {
        let mut wearer = known();
        let sways = |frame: usize| WEARER.at(320.0 + 100.0 * (0.15 * frame as f32).sin());
        assert!((0..90).all(|frame| sways(frame).judged(&mut wearer) == Verdict::Wearer));
        let mut wearer = known();
        let covered = Person { score: 3.0, skin: 5.0, ..WEARER };
        assert!((0..90).all(|_| covered.judged(&mut wearer) == Verdict::Wearer));
        let uncovered = Person { skin: 5.0, ..WEARER };
        assert!((0..30).all(|_| uncovered.judged(&mut wearer) == Verdict::Wearer));
    }

    #[test]
    fn the_wearer_is_followed_again_at_once_and_another_face_elsewhere_after_five_seconds_or_one_by_another_rule() {
        assert_eq!(frames_until_followed(&mut known(), &WEARER), Some(0));
        let other = Person { skin: 5.0, ..WEARER.at(560.0) };
        let frames = frames_until_followed(&mut known(), &other);
        assert!(frames.is_some_and(|frames| (120..=160).contains(&frames)), "{frames:?}");
        let mut nearest = Wearer { follow: Follow::Nearest, ..known() };
        let frames = frames_until_followed(&mut nearest, &other);
        assert!(frames.is_some_and(|frames| (25..=35).contains(&frames)), "{frames:?}");
    }

    #[test]
    fn after_another_face_one_must_stay_for_some_frames_and_longer_if_it_looks_different() {
        let wary = || Wearer { is_wary: true, ..known() };
        assert_eq!(frames_until_followed(&mut wary(), &WEARER), Some(2));
        let glasses = Person { skin: 4.0, ..WEARER };
        let frames = frames_until_followed(&mut wary(), &glasses);
        assert!(frames.is_some_and(|frames| (8..=30).contains(&frames)), "{frames:?}");
        let mut wearer = wary();
        let passes = |frame: usize| Person { skin: 0.5, ..WEARER.at(320.0 + 12.0 * frame as f32) };
        wearer.choose(&[passes(0).region()], SIZE_PX);
        assert_eq!([0, 1].map(|frame| passes(frame).judged(&mut wearer)), [Verdict::Open, Verdict::Other]);
    }

    #[test]
    fn a_wearer_who_comes_back_takes_the_place_of_another_face_and_one_who_has_it_keeps_it_from_equals() {
        let mut wearer = known();
        let other = Person { skin: 5.0, ..WEARER.at(560.0) };
        assert!(frames_until_followed(&mut wearer, &other).is_some());
        assert!(wearer.is_watched());
        let better = wearer.better(&other.region(), &[other.region(), WEARER.region()], SIZE_PX);
        assert_eq!(better, Some(WEARER.region()));

        let mut wearer = Wearer::default();
        let [first, second] = [280.0, 400.0].map(|x_px| WEARER.at(x_px).region());
        assert_eq!(wearer.choose(&[first], SIZE_PX), Some(first));
        assert_eq!(wearer.better(&first, &[first, second], SIZE_PX), None);
        let larger = Person { size_px: 260.0, ..WEARER.at(440.0) }.region();
        assert_eq!(wearer.better(&first, &[first, larger], SIZE_PX), Some(larger), "in the first seconds");
    }

    #[test]
    fn another_face_is_the_one_that_is_known_once_the_wearer_has_not_come_back_for_half_a_minute() {
        let mut wearer = known();
        let other = Person { skin: 5.0, score: 12.0, ..WEARER.at(560.0) };
        assert!(frames_until_followed(&mut wearer, &other).is_some());
        let sways = |frame: usize| other.at(480.0 + 80.0 * (0.1 * frame as f32).cos());
        assert!((0..1800).all(|frame| sways(frame).judged(&mut wearer) == Verdict::Wearer));
        assert!(!wearer.is_watched() && (wearer.score - other.score).abs() < 1.0);
    }

    #[test]
    fn a_wearer_who_comes_back_is_known_at_once_and_guarded_against_a_jump() {
        let mut wearer = known();
        let other = Person { skin: 5.0, ..WEARER.at(560.0) };
        assert!(frames_until_followed(&mut wearer, &other).is_some());
        assert!(wearer.better(&other.region(), &[other.region(), WEARER.region()], SIZE_PX).is_some());
        assert!((0..10).any(|_| WEARER.judged(&mut wearer) == Verdict::Wearer));
        assert_eq!(WEARER.judged(&mut wearer), Verdict::Wearer);
        assert_eq!(WEARER.at(400.0).judged(&mut wearer), Verdict::Other);
    }

    #[test]
    fn a_wearer_who_has_put_on_a_headset_may_move_again_after_three_seconds() {
        let mut wearer = known();
        let covered = Person { score: 10.0, skin: 5.0, ..WEARER };
        assert!((0..100).all(|_| covered.judged(&mut wearer) == Verdict::Wearer));
        let sways = |frame: usize| covered.at(320.0 + 100.0 * (0.15 * frame as f32).sin());
        assert!((0..90).all(|frame| sways(frame).judged(&mut wearer) == Verdict::Wearer));
    }

    #[test]
    fn look_or_score_that_is_not_finite_is_not_learned() {
        for wrong in [Person { skin: f32::NAN, ..WEARER }, Person { score: f32::INFINITY, ..WEARER }] {
            let mut wearer = known();
            assert_eq!(wrong.judged(&mut wearer), Verdict::Other);
            assert_eq!(frames_until_followed(&mut wearer, &WEARER), Some(0));
        }
    }

    #[test]
    fn landmarks_that_are_not_finite_or_form_no_face_are_judged_without_a_panic() {
        for value in [f32::NAN, f32::INFINITY, 0.0] {
            let landmarks = Landmarks([[value; 3]; LANDMARKS]);
            let mut wearer = known();
            wearer.judge(&Face::from(&landmarks), &WEARER.region(), FRAME_S);
            assert_eq!(frames_until_followed(&mut wearer, &WEARER), Some(0));
        }
    }
}
