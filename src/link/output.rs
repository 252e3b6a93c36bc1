//! What links send: the face as the failsafe shows it at one moment.

use facewire_packet::{BLENDSHAPE_COUNT, NeutralFace, Reason, State};

/// A pose of the face. The fields are those of [`facewire_packet::Packet`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Head rotation, unit quaternion x y z w. It is the identity when the head faces the camera.
    pub rotation: [f32; 4],
    /// Head position in the camera's frame, millimetres.
    pub position_mm: [f32; 3],
    /// Blendshape coefficients, 0..=1, in the order of [`facewire_packet::BLENDSHAPES`].
    pub coefficients: [f32; BLENDSHAPE_COUNT],
    /// The neutral face from which the coefficients are measured.
    pub neutral_face: NeutralFace,
}

impl Pose {
    /// No expression, facing the camera.
    pub const NEUTRAL: Self = Self {
        rotation: [0.0, 0.0, 0.0, 1.0],
        position_mm: [0.0; 3],
        coefficients: [0.0; BLENDSHAPE_COUNT],
        neutral_face: NeutralFace::Mean,
    };
}

/// The output of the failsafe.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// How far the pose can be trusted.
    pub state: State,
    /// Why the face is not live; [`Reason::None`] while it is.
    pub reason: Reason,
    /// The pose to show.
    pub pose: Pose,
    /// Time since the capture of the last pose that the output followed; `u64::MAX` if there was none.
    pub age_us: u64,
    /// Capture time of that pose on the monotonic clock; 0 if there was none.
    pub capture_us: u64,
    /// Whether the output follows a pose that has just arrived.
    pub followed: bool,
    /// Whether the output moves on without a new pose, as it does during a decay or a ramp.
    pub moving: bool,
}

/// Returns a neutral output in this state, for tests.
#[cfg(test)]
pub fn test_output(state: State) -> Output {
    let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
    Output { state, reason, pose: Pose::NEUTRAL, age_us: 0, capture_us: 0, followed: true, moving: false }
}
