//! The pose of a face, which is the part of a packet that moves.

use crate::{BLENDSHAPE_COUNT, NeutralFace, Packet, Visibility};

/// The angle of an eye whose `eyeLook` coefficient is 1, degrees.
///
/// This is what `ARKit` means by it: in a public recording of 180 packets from the iPhone app Live Link Face
/// (`dao.gesichter` of the project LLV), which has coefficients and rotations of the eyes side by side, the angle is 0.61
/// radians times the difference of the opposed coefficients, with a correlation of 1.000 in all four directions.
pub const FULL_GAZE_DEG: f32 = 35.0;

/// A pose of the face. The fields are those of [`Packet`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Head rotation as a unit quaternion x y z w, identity when the head faces the camera.
    pub rotation: [f32; 4],
    /// Head position in camera coordinates, in millimetres.
    pub position_mm: [f32; 3],
    /// The blendshape coefficients, from 0 to 1, in the order of [`crate::BLENDSHAPES`].
    pub coefficients: [f32; BLENDSHAPE_COUNT],
    /// The neutral face from which the coefficients are measured.
    pub neutral_face: NeutralFace,
    /// How much of each part of the face is in view.
    pub visibility: Visibility,
}

impl Pose {
    /// No expression, facing the camera.
    pub const NEUTRAL: Self = Packet::NEUTRAL.pose();

    /// Returns the neutral face at the position of this pose: a head has no neutral position. Nothing of it is covered.
    #[must_use]
    pub const fn neutral_here(&self) -> Self {
        Self { position_mm: self.position_mm, neutral_face: self.neutral_face, ..Self::NEUTRAL }
    }
}

impl Packet {
    /// Returns the pose of the packet.
    #[must_use]
    pub const fn pose(&self) -> Pose {
        let Self { rotation, position_mm, coefficients, neutral_face, visibility, .. } = *self;
        Pose { rotation, position_mm, coefficients, neutral_face, visibility }
    }

    /// Returns this packet with another pose.
    #[must_use]
    pub const fn with_pose(self, pose: &Pose) -> Self {
        let Pose { rotation, position_mm, coefficients, neutral_face, visibility } = *pose;
        Self { neutral_face, visibility, rotation, position_mm, coefficients, ..self }
    }
}

/// Returns the turn to the person's left, the nod upwards and the tilt to the person's right shoulder of a quaternion
/// x y z w, in degrees. They belong to `Rz(roll) Rx(-pitch) Ry(yaw)`: the head turns first, nods next and tilts last.
#[cfg(feature = "std")]
#[must_use]
pub fn yaw_pitch_roll_deg([x, y, z, w]: [f32; 4]) -> [f32; 3] {
    let length = ((x * x + z * z) + (y * y + w * w)).sqrt();
    let [x, y, z, w] = [x, y, z, w].map(|part| part / length);
    let (xx, yy, zz, ww) = (x * x, y * y, z * z, w * w);
    // The columns of the rotation matrix are the axes of the head: left, up and forward, which is out of the face.
    let (left_z, forward_z) = (x * z * 2.0 - w * y * 2.0, ww - xx - yy + zz);
    let (up_x, up_y, up_z) = (x * y * 2.0 - w * z * 2.0, ww - xx + yy - zz, w * x * 2.0 + y * z * 2.0);
    let (yaw, pitch, roll) = ((-left_z).atan2(forward_z), -up_z.clamp(-1.0, 1.0).asin(), (-up_x).atan2(up_y));
    // Adding 0 turns -0 into 0.
    [yaw, pitch, roll].map(|radians| radians.to_degrees() + 0.0)
}
