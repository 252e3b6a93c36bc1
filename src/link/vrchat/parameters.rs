//! The avatar parameters of VRCFaceTracking v2, and how they follow from ARKit's coefficients.
//!
//! The formulas are those of VRCFaceTracking (`UnifiedExpressionsParameters.cs`, `UnifiedSimpleExpressions.cs`), after its
//! table that translates ARKit to Unified Expressions. Left and right are the person's own. Where ARKit has no
//! counterpart, as for a tongue that curls, there is no parameter.

use facewire_packet::BLENDSHAPE_COUNT;

use super::super::{gaze::Gaze, head::Angles, output::Pose};

/// What a parameter is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// One movement.
    Shape,
    /// Several movements in one number.
    Compound,
    /// The turn of the head.
    Head,
}

/// A parameter.
pub struct Parameter {
    /// Its name after `v2/`.
    pub name: &'static str,
    pub group: Group,
    /// Its value, from -1 to 1.
    pub value: fn(&Face) -> f32,
}

/// Declares [`Face`] with a field for each coefficient, in the order of [`facewire_packet::BLENDSHAPES`].
macro_rules! face {
    ($($name:ident)*) => {
        /// A face as the formulas need it.
        pub struct Face {
            $( $name: f32, )*
            /// Directions of the left and of the right eye, as parts of the full angle to the person's right and upwards.
            left_eye: [f32; 2],
            right_eye: [f32; 2],
            /// Turn of the head to the right, down and to the left shoulder, as parts of 90 degrees.
            head: [f32; 3],
        }

        impl Face {
            pub fn new(pose: &Pose, gaze: &Gaze) -> Self {
                let [$($name),*]: [f32; BLENDSHAPE_COUNT] = pose.coefficients;
                let [left_eye, right_eye] = gaze.parts().map(|[left, up]| [0.0 - left, up]);
                let head = Angles::of(pose.rotation).reversed().map(|angle| angle / std::f32::consts::FRAC_PI_2);
                Self { $($name,)* left_eye, right_eye, head }
            }
        }
    };
}

face! {
    blink_l _look_down_l _look_in_l _look_out_l _look_up_l squint_l wide_l
    blink_r _look_down_r _look_in_r _look_out_r _look_up_r squint_r wide_r
    jaw_forward jaw_left jaw_right jaw_open mouth_close funnel pucker mouth_left mouth_right
    smile_l smile_r frown_l frown_r dimple_l dimple_r stretch_l stretch_r roll_lower roll_upper shrug_lower shrug_upper
    press_l press_r lower_down_l lower_down_r upper_up_l upper_up_r
    brow_down_l brow_down_r brow_inner_up brow_outer_up_l brow_outer_up_r
    cheek_puff cheek_squint_l cheek_squint_r sneer_l sneer_r tongue_out
}

impl Face {
    /// How far the upper lip is drawn in. A raised lip cannot be.
    fn suck_upper(&self, upper_up: f32) -> f32 {
        self.roll_upper.min(1.0 - upper_up.max(0.0).powf(1.0 / 6.0))
    }

    fn suck_uppers(&self) -> f32 {
        mean(self.suck_upper(self.upper_up_l), self.suck_upper(self.upper_up_r))
    }

    fn brow_up(&self, outer: f32) -> f32 {
        0.6 * outer + 0.4 * self.brow_inner_up
    }

    fn brow_expression(&self, outer: f32, down: f32) -> f32 {
        mean(self.brow_inner_up, outer).min(1.0) - down
    }

    fn mouth_x(&self) -> f32 {
        self.mouth_right - self.mouth_left
    }
}

fn lid(blink: f32, wide: f32) -> f32 {
    0.75 * (1.0 - blink) + 0.25 * wide
}

fn mean(a: f32, b: f32) -> f32 {
    0.5 * (a + b)
}

/// Declares a list of parameters of one group.
macro_rules! parameters {
    ($($group:ident { $($name:literal = |$face:ident| $value:expr;)* })*) => {
        /// Every parameter.
        pub const PARAMETERS: &[Parameter] = &[
            $($( Parameter { name: $name, group: Group::$group, value: |$face| $value }, )*)*
        ];
    };
}

parameters! {
    Shape {
        "EyeLeftX" = |f| f.left_eye[0];
        "EyeLeftY" = |f| f.left_eye[1];
        "EyeRightX" = |f| f.right_eye[0];
        "EyeRightY" = |f| f.right_eye[1];
        "EyeOpenLeft" = |f| 1.0 - f.blink_l;
        "EyeOpenRight" = |f| 1.0 - f.blink_r;
        "EyeClosedLeft" = |f| f.blink_l;
        "EyeClosedRight" = |f| f.blink_r;
        "EyeWideLeft" = |f| f.wide_l;
        "EyeWideRight" = |f| f.wide_r;
        "EyeSquintLeft" = |f| f.squint_l;
        "EyeSquintRight" = |f| f.squint_r;
        "BrowPinchLeft" = |f| f.brow_down_l;
        "BrowPinchRight" = |f| f.brow_down_r;
        "BrowLowererLeft" = |f| f.brow_down_l;
        "BrowLowererRight" = |f| f.brow_down_r;
        "BrowInnerUpLeft" = |f| f.brow_inner_up;
        "BrowInnerUpRight" = |f| f.brow_inner_up;
        "BrowOuterUpLeft" = |f| f.brow_outer_up_l;
        "BrowOuterUpRight" = |f| f.brow_outer_up_r;
        "NoseSneerLeft" = |f| f.sneer_l;
        "NoseSneerRight" = |f| f.sneer_r;
        "CheekSquintLeft" = |f| f.cheek_squint_l;
        "CheekSquintRight" = |f| f.cheek_squint_r;
        "CheekPuffLeft" = |f| f.cheek_puff;
        "CheekPuffRight" = |f| f.cheek_puff;
        "JawOpen" = |f| f.jaw_open;
        "JawLeft" = |f| f.jaw_left;
        "JawRight" = |f| f.jaw_right;
        "JawForward" = |f| f.jaw_forward;
        "MouthClosed" = |f| f.mouth_close.min(f.jaw_open);
        "LipSuckUpperLeft" = |f| f.suck_upper(f.upper_up_l);
        "LipSuckUpperRight" = |f| f.suck_upper(f.upper_up_r);
        "LipSuckLowerLeft" = |f| f.roll_lower;
        "LipSuckLowerRight" = |f| f.roll_lower;
        "LipFunnelUpperLeft" = |f| f.funnel;
        "LipFunnelUpperRight" = |f| f.funnel;
        "LipFunnelLowerLeft" = |f| f.funnel;
        "LipFunnelLowerRight" = |f| f.funnel;
        "LipPuckerUpperLeft" = |f| f.pucker;
        "LipPuckerUpperRight" = |f| f.pucker;
        "LipPuckerLowerLeft" = |f| f.pucker;
        "LipPuckerLowerRight" = |f| f.pucker;
        "MouthUpperLeft" = |f| f.mouth_left;
        "MouthUpperRight" = |f| f.mouth_right;
        "MouthLowerLeft" = |f| f.mouth_left;
        "MouthLowerRight" = |f| f.mouth_right;
        "MouthUpperUpLeft" = |f| f.upper_up_l;
        "MouthUpperUpRight" = |f| f.upper_up_r;
        "MouthUpperDeepenLeft" = |f| f.upper_up_l;
        "MouthUpperDeepenRight" = |f| f.upper_up_r;
        "MouthLowerDownLeft" = |f| f.lower_down_l;
        "MouthLowerDownRight" = |f| f.lower_down_r;
        "MouthCornerPullLeft" = |f| f.smile_l;
        "MouthCornerPullRight" = |f| f.smile_r;
        "MouthCornerSlantLeft" = |f| f.smile_l;
        "MouthCornerSlantRight" = |f| f.smile_r;
        "MouthFrownLeft" = |f| f.frown_l;
        "MouthFrownRight" = |f| f.frown_r;
        "MouthStretchLeft" = |f| f.stretch_l;
        "MouthStretchRight" = |f| f.stretch_r;
        "MouthDimpleLeft" = |f| f.dimple_l;
        "MouthDimpleRight" = |f| f.dimple_r;
        "MouthRaiserUpper" = |f| f.shrug_upper;
        "MouthRaiserLower" = |f| f.shrug_lower;
        "MouthPressLeft" = |f| f.press_l;
        "MouthPressRight" = |f| f.press_r;
        "TongueOut" = |f| f.tongue_out;
    }
    Compound {
        "EyeX" = |f| mean(f.left_eye[0], f.right_eye[0]);
        "EyeY" = |f| mean(f.left_eye[1], f.right_eye[1]);
        "EyeOpen" = |f| 1.0 - mean(f.blink_l, f.blink_r);
        "EyeClosed" = |f| mean(f.blink_l, f.blink_r);
        "EyeWide" = |f| f.wide_l.max(f.wide_r);
        "EyeLidLeft" = |f| lid(f.blink_l, f.wide_l);
        "EyeLidRight" = |f| lid(f.blink_r, f.wide_r);
        "EyeLid" = |f| mean(lid(f.blink_l, f.wide_l), lid(f.blink_r, f.wide_r));
        "EyeSquint" = |f| f.squint_l.max(f.squint_r);
        "EyesSquint" = |f| f.squint_l.max(f.squint_r);
        "BrowUpLeft" = |f| f.brow_up(f.brow_outer_up_l);
        "BrowUpRight" = |f| f.brow_up(f.brow_outer_up_r);
        "BrowUp" = |f| mean(f.brow_up(f.brow_outer_up_l), f.brow_up(f.brow_outer_up_r));
        "BrowDownLeft" = |f| f.brow_down_l;
        "BrowDownRight" = |f| f.brow_down_r;
        "BrowDown" = |f| mean(f.brow_down_l, f.brow_down_r);
        "BrowInnerUp" = |f| f.brow_inner_up;
        "BrowOuterUp" = |f| mean(f.brow_outer_up_l, f.brow_outer_up_r);
        "BrowExpressionLeft" = |f| f.brow_expression(f.brow_outer_up_l, f.brow_down_l);
        "BrowExpressionRight" = |f| f.brow_expression(f.brow_outer_up_r, f.brow_down_r);
        "BrowExpression" = |f| mean(
            f.brow_expression(f.brow_outer_up_l, f.brow_down_l),
            f.brow_expression(f.brow_outer_up_r, f.brow_down_r),
        );
        "JawX" = |f| f.jaw_right - f.jaw_left;
        "JawZ" = |f| f.jaw_forward;
        "CheekSquint" = |f| mean(f.cheek_squint_l, f.cheek_squint_r);
        "CheekPuffSuckLeft" = |f| f.cheek_puff;
        "CheekPuffSuckRight" = |f| f.cheek_puff;
        "CheekPuffSuck" = |f| f.cheek_puff;
        "MouthUpperX" = |f| f.mouth_x();
        "MouthLowerX" = |f| f.mouth_x();
        "MouthX" = |f| f.mouth_x();
        "LipSuckUpper" = |f| f.suck_uppers();
        "LipSuckLower" = |f| f.roll_lower;
        "LipSuck" = |f| mean(f.suck_uppers(), f.roll_lower);
        "LipFunnelUpper" = |f| f.funnel;
        "LipFunnelLower" = |f| f.funnel;
        "LipFunnel" = |f| f.funnel;
        "LipPuckerUpper" = |f| f.pucker;
        "LipPuckerLower" = |f| f.pucker;
        "LipPuckerLeft" = |f| f.pucker;
        "LipPuckerRight" = |f| f.pucker;
        "LipPucker" = |f| f.pucker;
        "LipSuckFunnelUpper" = |f| f.suck_uppers() - f.funnel;
        "LipSuckFunnelLower" = |f| f.roll_lower - f.funnel;
        "LipSuckFunnelUpperLeft" = |f| f.suck_upper(f.upper_up_l) - f.funnel;
        "LipSuckFunnelUpperRight" = |f| f.suck_upper(f.upper_up_r) - f.funnel;
        "LipSuckFunnelLowerLeft" = |f| f.roll_lower - f.funnel;
        "LipSuckFunnelLowerRight" = |f| f.roll_lower - f.funnel;
        "MouthUpperUp" = |f| mean(f.upper_up_l, f.upper_up_r);
        "MouthLowerDown" = |f| mean(f.lower_down_l, f.lower_down_r);
        "MouthOpen" = |f| mean(mean(f.upper_up_l, f.upper_up_r), mean(f.lower_down_l, f.lower_down_r));
        "MouthStretch" = |f| mean(f.stretch_l, f.stretch_r);
        "MouthPress" = |f| mean(f.press_l, f.press_r);
        "MouthDimple" = |f| mean(f.dimple_l, f.dimple_r);
        "MouthTightenerStretch" = |f| 0.0 - mean(f.stretch_l, f.stretch_r);
        "MouthTightenerStretchLeft" = |f| 0.0 - f.stretch_l;
        "MouthTightenerStretchRight" = |f| 0.0 - f.stretch_r;
        "NoseSneer" = |f| mean(f.sneer_l, f.sneer_r);
        "MouthCornerYLeft" = |f| f.smile_l - f.frown_l;
        "MouthCornerYRight" = |f| f.smile_r - f.frown_r;
        "MouthCornerY" = |f| mean(f.smile_l - f.frown_l, f.smile_r - f.frown_r);
        "MouthSmileLeft" = |f| f.smile_l;
        "MouthSmileRight" = |f| f.smile_r;
        "MouthSadLeft" = |f| f.frown_l.max(f.stretch_l);
        "MouthSadRight" = |f| f.frown_r.max(f.stretch_r);
        "SmileFrownLeft" = |f| f.smile_l - f.frown_l;
        "SmileFrownRight" = |f| f.smile_r - f.frown_r;
        "SmileFrown" = |f| mean(f.smile_l - f.frown_l, f.smile_r - f.frown_r);
        "SmileSadLeft" = |f| f.smile_l - f.frown_l.max(f.stretch_l);
        "SmileSadRight" = |f| f.smile_r - f.frown_r.max(f.stretch_r);
        "SmileSad" = |f| mean(f.smile_l - f.frown_l.max(f.stretch_l), f.smile_r - f.frown_r.max(f.stretch_r));
    }
    Head {
        "Head/Yaw" = |f| f.head[0];
        "Head/Pitch" = |f| f.head[1];
        "Head/Roll" = |f| f.head[2];
    }
}
