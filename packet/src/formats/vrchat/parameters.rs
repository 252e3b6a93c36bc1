//! The avatar parameters of VRCFaceTracking v2, and how they follow from ARKit's coefficients.
//!
//! The formulas are those of VRCFaceTracking (`UnifiedExpressionsParameters.cs`, `UnifiedSimpleExpressions.cs`), after its
//! table that translates ARKit to Unified Expressions. Left and right are the person's own. Where ARKit has no
//! counterpart, as for a tongue that curls, there is no parameter.

use std::f32::consts::FRAC_PI_2;
use std::sync::LazyLock;

use super::super::angles::{Angles, FULL_GAZE, Gaze};
use crate::Packet;

/// What a parameter is about.
#[derive(Debug, Clone, Copy)]
pub enum Group {
    /// One movement.
    Shape,
    /// Several movements in one number, or the mean of both sides.
    Compound,
    /// The turn of the head.
    Head,
}

/// Declares [`Face`] and [`Side`] from the places of the coefficients in [`crate::BLENDSHAPES`].
macro_rules! face {
    (sides { $($side:ident $left:literal $right:literal)* } whole { $($whole:ident $place:literal)* }) => {
        pub struct Side {
            $( $side: f32, )*
            /// Direction of the eye as parts of the full angle, to the person's right and upwards.
            look: [f32; 2],
        }

        pub struct Face {
            $( $whole: f32, )*
            left: Side,
            right: Side,
            /// Turn of the head to the right, down and to the left shoulder, as parts of 90 degrees.
            head: [f32; 3],
            pub is_tracked: bool,
        }

        impl Face {
            pub fn new(packet: &Packet, gaze: Gaze) -> Self {
                let from = &packet.coefficients;
                let look = |eye: Angles| [0.0 - eye.yaw / FULL_GAZE, eye.pitch / FULL_GAZE];
                Self {
                    $( $whole: from[$place], )*
                    left: Side { $( $side: from[$left], )* look: look(gaze.left) },
                    right: Side { $( $side: from[$right], )* look: look(gaze.right) },
                    head: Angles::of(packet.rotation).reversed().map(|angle| angle / FRAC_PI_2),
                    is_tracked: packet.state.shows_face(),
                }
            }
        }
    };
}

face! {
    sides {
        blink 0 7  squint 5 12  wide 6 13  jaw 15 16  mouth 21 22  smile 23 24  frown 25 26  dimple 27 28  stretch 29 30
        press 35 36  lower_down 37 38  upper_up 39 40  brow_down 41 42  brow_outer_up 44 45  cheek_squint 47 48  sneer 49 50
    }
    whole {
        jaw_forward 14  jaw_open 17  mouth_close 18  funnel 19  pucker 20  roll_lower 31  roll_upper 32  shrug_lower 33
        shrug_upper 34  brow_inner_up 43  cheek_puff 46  tongue_out 51
    }
}

impl Face {
    /// How far the upper lip is drawn in. A raised lip cannot be drawn in.
    fn suck_upper(&self, side: &Side) -> f32 {
        self.roll_upper.min(1.0 - side.upper_up.max(0.0).powf(1.0 / 6.0))
    }

    pub fn eyes_closed(&self) -> f32 {
        mean(self.left.blink, self.right.blink)
    }

    /// Pitch and yaw of the left and of the right eye, degrees down and to the right.
    pub fn eye_angles_deg(&self) -> [f32; 4] {
        let ([left_x, left_y], [right_x, right_y]) = (self.left.look, self.right.look);
        [-left_y, left_x, -right_y, right_x].map(|part| (part * FULL_GAZE).to_degrees() + 0.0)
    }
}

fn mean(a: f32, b: f32) -> f32 {
    0.5 * (a + b)
}

/// A parameter of an avatar.
#[derive(Debug)]
pub struct Parameter {
    /// Its name after `v2/`.
    pub name: String,
    /// What it is about.
    pub group: Group,
    /// The shares of the left and of the right side.
    shares: [f32; 2],
    formula: fn(&Face, &Side) -> f32,
}

impl Parameter {
    /// Whether it is about lids or gaze.
    pub(super) fn is_of_eyes(&self) -> bool {
        self.name.starts_with("Eye")
    }

    /// The value of the parameter, from -1 to 1.
    pub(super) fn value(&self, face: &Face) -> f32 {
        let [left, right] = self.shares;
        left * (self.formula)(face, &face.left) + right * (self.formula)(face, &face.right)
    }
}

/// All parameters.
pub static PARAMETERS: LazyLock<Vec<Parameter>> = LazyLock::new(|| {
    let mut parameters = Vec::new();
    for (names, (sides, whole), formula) in ROWS {
        for (side, shares, group) in [("Left", [1.0, 0.0], sides), ("Right", [0.0, 1.0], sides), ("", [0.5; 2], whole)]
        {
            let named = |name: &&str| {
                let (begin, end) = name.split_once('*').unwrap_or((name, ""));
                Some(Parameter { name: format!("{begin}{side}{end}"), group: (*group)?, shares, formula: *formula })
            };
            parameters.extend(names.iter().filter_map(named));
        }
    }
    parameters
});

/// The group of the parameters of both sides, and that of the parameter of the whole face.
type Groups = (Option<Group>, Option<Group>);
/// Names, in which `*` stands for the side if it is not at the end.
type Row = (&'static [&'static str], Groups, fn(&Face, &Side) -> f32);

/// One movement of the whole face, of each side, or of each side with the mean of both as a compound.
const WHOLE: Groups = (None, Some(Group::Shape));
const SIDES: Groups = (Some(Group::Shape), None);
const EACH: Groups = (Some(Group::Shape), Some(Group::Compound));
/// Several movements in one number: for both sides, for each side, or all three.
const BOTH: Groups = (None, Some(Group::Compound));
const BOTH_SIDES: Groups = (Some(Group::Compound), None);
const ALL: Groups = (Some(Group::Compound), Some(Group::Compound));
const HEAD: Groups = (None, Some(Group::Head));

const ROWS: &[Row] = &[
    (&["Eye*X"], EACH, |_, s| s.look[0]),
    (&["Eye*Y"], EACH, |_, s| s.look[1]),
    (&["EyeOpen"], EACH, |_, s| 1.0 - s.blink),
    (&["EyeClosed"], EACH, |_, s| s.blink),
    (&["EyeWide"], SIDES, |_, s| s.wide),
    (&["EyeWide"], BOTH, |f, _| f.left.wide.max(f.right.wide)),
    (&["EyeLid"], ALL, |_, s| 0.75 * (1.0 - s.blink) + 0.25 * s.wide),
    (&["EyeSquint"], SIDES, |_, s| s.squint),
    (&["EyeSquint", "EyesSquint"], BOTH, |f, _| f.left.squint.max(f.right.squint)),
    (&["BrowPinch", "BrowLowerer"], SIDES, |_, s| s.brow_down),
    (&["BrowDown"], ALL, |_, s| s.brow_down),
    (&["BrowInnerUp"], EACH, |f, _| f.brow_inner_up),
    (&["BrowOuterUp"], EACH, |_, s| s.brow_outer_up),
    (&["BrowUp"], ALL, |f, s| 0.6 * s.brow_outer_up + 0.4 * f.brow_inner_up),
    (&["BrowExpression"], ALL, |f, s| mean(f.brow_inner_up, s.brow_outer_up).min(1.0) - s.brow_down),
    (&["NoseSneer"], EACH, |_, s| s.sneer),
    (&["CheekSquint"], EACH, |_, s| s.cheek_squint),
    (&["CheekPuff"], SIDES, |f, _| f.cheek_puff),
    (&["CheekPuffSuck"], ALL, |f, _| f.cheek_puff),
    (&["JawOpen"], WHOLE, |f, _| f.jaw_open),
    (&["Jaw"], SIDES, |_, s| s.jaw),
    (&["JawX"], BOTH, |f, _| f.right.jaw - f.left.jaw),
    (&["JawForward"], WHOLE, |f, _| f.jaw_forward),
    (&["JawZ"], BOTH, |f, _| f.jaw_forward),
    (&["MouthClosed"], WHOLE, |f, _| f.mouth_close.min(f.jaw_open)),
    (&["MouthUpper", "MouthLower"], SIDES, |_, s| s.mouth),
    (&["MouthUpperX", "MouthLowerX", "MouthX"], BOTH, |f, _| f.right.mouth - f.left.mouth),
    (&["LipSuckUpper"], EACH, |f, s| f.suck_upper(s)),
    (&["LipSuckLower"], EACH, |f, _| f.roll_lower),
    (&["LipSuck"], BOTH, |f, s| mean(f.suck_upper(s), f.roll_lower)),
    (&["LipFunnelUpper", "LipFunnelLower"], EACH, |f, _| f.funnel),
    (&["LipFunnel"], BOTH, |f, _| f.funnel),
    (&["LipPuckerUpper", "LipPuckerLower"], EACH, |f, _| f.pucker),
    (&["LipPucker"], ALL, |f, _| f.pucker),
    (&["LipSuckFunnelUpper"], ALL, |f, s| f.suck_upper(s) - f.funnel),
    (&["LipSuckFunnelLower"], ALL, |f, _| f.roll_lower - f.funnel),
    (&["MouthUpperUp"], EACH, |_, s| s.upper_up),
    (&["MouthUpperDeepen"], SIDES, |_, s| s.upper_up),
    (&["MouthLowerDown"], EACH, |_, s| s.lower_down),
    (&["MouthOpen"], BOTH, |_, s| mean(s.upper_up, s.lower_down)),
    (&["MouthCornerPull", "MouthCornerSlant"], SIDES, |_, s| s.smile),
    (&["MouthFrown"], SIDES, |_, s| s.frown),
    (&["MouthCornerY", "SmileFrown"], ALL, |_, s| s.smile - s.frown),
    (&["MouthSmile"], BOTH_SIDES, |_, s| s.smile),
    (&["MouthSad"], BOTH_SIDES, |_, s| s.frown.max(s.stretch)),
    (&["SmileSad"], ALL, |_, s| s.smile - s.frown.max(s.stretch)),
    (&["MouthStretch"], EACH, |_, s| s.stretch),
    (&["MouthTightenerStretch"], ALL, |_, s| 0.0 - s.stretch),
    (&["MouthDimple"], EACH, |_, s| s.dimple),
    (&["MouthPress"], EACH, |_, s| s.press),
    (&["MouthRaiserUpper"], WHOLE, |f, _| f.shrug_upper),
    (&["MouthRaiserLower"], WHOLE, |f, _| f.shrug_lower),
    (&["TongueOut"], WHOLE, |f, _| f.tongue_out),
    (&["Head/Yaw"], HEAD, |f, _| f.head[0]),
    (&["Head/Pitch"], HEAD, |f, _| f.head[1]),
    (&["Head/Roll"], HEAD, |f, _| f.head[2]),
];
