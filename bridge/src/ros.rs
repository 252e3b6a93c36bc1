//! ROS 2, on a thread of its own, by DDS or by Zenoh.
//!
//! The newest packet of each board is published within a few milliseconds, by writers that are reliable, because subscribers of
//! ROS ask for that by default. A writer that cannot take a message counts it and goes on with the next. After a board falls
//! silent its last face moves to neutral, and then the topics rest.

mod messages;
mod node;
#[cfg(any(feature = "zenoh", test))]
mod rmw_zenoh;
#[cfg(feature = "zenoh")]
mod zenoh;

use std::{
    io,
    sync::{Arc, mpsc::Receiver},
    thread::{self, JoinHandle},
    time::{Duration, Instant, SystemTime},
};

use facewire_packet::{BLENDSHAPES, Face, Reason, State};

use self::{
    messages::{
        Bool, DiagnosticArray, DiagnosticStatus, FacialActionUnits, Header, IdsList, JointState, KeyValue, PoseStamped,
        TFMessage, TransformStamped, action_units, pose,
    },
    node::{Node, Writer},
};
use crate::{
    fleet::{Board, Shared},
    say,
    settings::Ros,
};

/// The longest time between two looks, and the pace of a face on its way to neutral.
const LOOK: Duration = Duration::from_millis(50);
/// Packets that come within this time are published together.
const GATHER: Duration = Duration::from_millis(2);
/// The period of diagnostics, and of looks at the network.
const SECOND: Duration = Duration::from_secs(1);
/// Boards that get their writers at a time. RustDDS drops announcements of writers if too many are made at once.
const NEW_BOARDS: usize = 4;
/// Longest time in which the last messages are sent and the node is closed.
const FAREWELL: Duration = Duration::from_secs(2);
/// The name of the node.
const NODE: &str = "facewire_bridge";

type Failed = Box<dyn std::error::Error + Send + Sync>;

/// The type of a topic's messages, and whether a reader that comes later gets the last message.
struct Kind {
    package: &'static str,
    name: &'static str,
    /// The hash of the type's definition.
    #[cfg_attr(not(any(feature = "zenoh", test)), expect(dead_code, reason = "RustDDS announces no user data"))]
    hash: &'static str,
    is_latched: bool,
}

impl Kind {
    const fn new(package: &'static str, name: &'static str, hash: &'static str) -> Self {
        Self { package, name, hash, is_latched: false }
    }

    /// How many past messages are kept for readers that lost some.
    fn depth(&self) -> usize {
        if self.is_latched { 1 } else { 5 }
    }
}

// The hashes of the types' definitions (RIHS01 of REP 2016): SHA-256 of the description as JSON, with the names and types of
// all fields, as rosidl_generator_type_description writes it. They are calculated from the .msg files of Jazzy, which Kilted
// and Lyrical have unchanged, and of hri_msgs 2.0.0, of which 2.3.2 changed other messages alone; the Python package rosbags
// calculates the same, and `ros2 topic info --verbose` prints them for writers of ROS. To calculate one again:
// `rosbags.typesys.get_typestore(Stores.ROS2_JAZZY).hash_rihs01("std_msgs/msg/Bool")`.
const JOINT_STATE: Kind =
    Kind::new("sensor_msgs", "JointState", "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e");
const POSE_STAMPED: Kind = Kind::new(
    "geometry_msgs",
    "PoseStamped",
    "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
);
const BOOL: Kind = Kind {
    is_latched: true,
    ..Kind::new("std_msgs", "Bool", "RIHS01_feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9")
};
const TRANSFORMS: Kind =
    Kind::new("tf2_msgs", "TFMessage", "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087");
const DIAGNOSTICS: Kind = Kind::new(
    "diagnostic_msgs",
    "DiagnosticArray",
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
);
const FACES: Kind =
    Kind::new("hri_msgs", "IdsList", "RIHS01_7e0812d1ac945c98fd3e393568d581ad0ab567f37b24eff633eab778c1bfe62d");
const ACTION_UNITS: Kind = Kind::new(
    "hri_msgs",
    "FacialActionUnits",
    "RIHS01_43f431104624b6ff7f84350f1faa3747efc8a9330dee942b717a08830a267ed3",
);

/// Starts to publish.
pub fn start(settings: &Ros, namespace: &str, shared: Arc<Shared>, rings: Receiver<()>) -> io::Result<JoinHandle<()>> {
    let (settings, namespace) = (settings.clone(), namespace.to_owned());
    thread::Builder::new().name("ros".to_owned()).spawn(move || {
        let mut told = String::new();
        while !shared.is_stopped() {
            let outcome =
                Graph::open(&settings, &namespace, &shared).and_then(|mut graph| graph.publish(&shared, &rings));
            if let Err(error) = outcome
                && told != error.to_string()
                && !shared.is_stopped()
            {
                told = error.to_string();
                say(&format!("ROS 2 cannot be reached ({told}); check the network and --ros-domain. Trying again"));
            }
            thread::sleep(LOOK);
        }
    })
}

/// Waits at most [`FAREWELL`] for the thread, which has been told to end. Zenoh would wait longer for a router that hangs,
/// which is not needed: the router withdraws the program's declarations when the program ends.
pub fn finish(thread: &JoinHandle<()>) {
    let end = Instant::now() + FAREWELL;
    while !thread.is_finished() && Instant::now() < end {
        thread::sleep(LOOK);
    }
}

/// The writers of a board, and what it showed last.
struct Writers {
    blendshapes: Writer<JointState>,
    head_pose: Writer<PoseStamped>,
    face: Writer<Bool>,
    action_units: Option<Writer<FacialActionUnits>>,
    /// The packets that were seen.
    seen: u64,
    shown: Option<Face>,
    has_face: Option<bool>,
}

/// What is published.
struct Graph {
    namespace: String,
    node: Node,
    boards: Vec<Writers>,
    transforms: Writer<TFMessage>,
    diagnostics: Writer<DiagnosticArray>,
    faces: Option<Writer<IdsList>>,
    /// Packets that were replaced by newer ones before they were published.
    skipped: u64,
    /// Messages that a writer could not take.
    refused: u64,
}

impl Graph {
    fn open(settings: &Ros, namespace: &str, shared: &Shared) -> Result<Self, Failed> {
        let mut node = Node::open(settings, shared)?;
        let transforms = node.writer("/tf", &TRANSFORMS)?;
        let diagnostics = node.writer("/diagnostics", &DIAGNOSTICS)?;
        let faces = settings.action_units.then(|| node.writer("/humans/faces/tracked", &FACES)).transpose()?;
        let namespace = namespace.to_owned();
        Ok(Self { namespace, node, boards: Vec::new(), transforms, diagnostics, faces, skipped: 0, refused: 0 })
    }

    /// Publishes until the program stops or the node is lost.
    fn publish(&mut self, shared: &Shared, rings: &Receiver<()>) -> Result<(), Failed> {
        let mut due = Instant::now();
        while !shared.is_stopped() {
            let _ = rings.recv_timeout(LOOK);
            self.add_boards(shared)?;
            self.publish_faces(shared);
            let now = Instant::now();
            if now >= due {
                due = now + SECOND;
                self.publish_diagnostics(shared, now);
                if self.node.is_lost() {
                    return Ok(());
                }
            }
            thread::sleep(GATHER);
        }
        // Who waits for a face learns that there is none, before the writers go.
        for writers in &mut self.boards {
            writers.face.publish(Bool { data: false });
        }
        thread::sleep(LOOK);
        Ok(())
    }

    fn add_boards(&mut self, shared: &Shared) -> Result<(), Failed> {
        let first = self.boards.len();
        let fleet = shared.lock();
        let new = fleet.boards.iter().skip(first).take(NEW_BOARDS).map(|board| (board.name.clone(), board.taken));
        let new: Vec<(String, u64)> = new.collect();
        drop(fleet);
        for ((name, taken), at) in new.into_iter().zip(first..) {
            let (node, topic) = (&mut self.node, |part: &str| format!("/{}/{name}/{part}", self.namespace));
            let units = format!("/humans/faces/{}/facs", face_id(at));
            self.boards.push(Writers {
                blendshapes: node.writer(&topic("blendshapes"), &JOINT_STATE)?,
                head_pose: node.writer(&topic("head_pose"), &POSE_STAMPED)?,
                face: node.writer(&topic("face"), &BOOL)?,
                action_units: self.faces.is_some().then(|| node.writer(&units, &ACTION_UNITS)).transpose()?,
                // The newest packet is still to be published.
                seen: taken.saturating_sub(1),
                shown: None,
                has_face: None,
            });
        }
        Ok(())
    }

    /// Publishes the face of each board that has a new one or goes to neutral.
    fn publish_faces(&mut self, shared: &Shared) {
        let (now, mut transforms) = (Instant::now(), Vec::new());
        for (at, writers) in self.boards.iter_mut().enumerate() {
            let mut fleet = shared.lock();
            let (Some(face), Some(board)) = (fleet.face(at, now), fleet.boards.get(at)) else { continue };
            let (has_face, missed) = (board.has_face(now), board.missed_since(&mut writers.seen));
            let (name, packet) = (board.name.clone(), *board.packet());
            drop(fleet);
            let mut refused = 0;
            if writers.has_face.replace(has_face) != Some(has_face) {
                refused += writers.face.publish(Bool { data: has_face });
            }
            self.skipped += missed.unwrap_or(0);
            let moves = face.is_silent && writers.shown.is_some_and(|shown| shown != face);
            if missed.is_none() && !moves {
                self.refused += refused;
                continue;
            }
            writers.shown = Some(face);
            let age = if missed.is_some() { Duration::from_micros(packet.age_us.into()) } else { Duration::ZERO };
            let stamp = SystemTime::now().checked_sub(age).unwrap_or(SystemTime::UNIX_EPOCH).into();
            let header = Header { stamp, frame_id: format!("{name}_camera_optical_frame") };
            let pose = pose(face.rotation, packet.position_mm);
            let joints = JointState {
                header: header.clone(),
                name: &BLENDSHAPES,
                position: face.coefficients.map(f64::from).into(),
                velocity: &[],
                effort: &[],
            };
            refused += writers.blendshapes.publish(joints);
            refused += writers.head_pose.publish(PoseStamped { header: header.clone(), pose });
            if let (Some(writer), true) = (&mut writers.action_units, has_face) {
                let [intensity, confidence] = action_units(&face.coefficients);
                let units = FacialActionUnits { header: header.clone(), intensity, confidence };
                refused += writer.publish(units);
            }
            // Where no face is followed, there is no head to look for.
            let frames = [format!("{name}_head"), format!("face_{}", face_id(at))];
            let count = if !has_face { 0 } else { 1 + usize::from(self.faces.is_some()) };
            transforms.extend(frames.into_iter().take(count).map(|child_frame_id| TransformStamped {
                header: header.clone(),
                child_frame_id,
                transform: pose,
            }));
            self.refused += refused;
        }
        if !transforms.is_empty() {
            self.refused += self.transforms.publish(TFMessage { transforms });
        }
    }

    fn publish_diagnostics(&mut self, shared: &Shared, now: Instant) {
        let fleet = shared.lock();
        let mut status: Vec<DiagnosticStatus> = fleet.boards.iter().map(|board| board_status(board, now)).collect();
        let ids = fleet.boards.iter().zip(0..).filter(|(board, _)| board.has_face(now)).map(|(_, at)| face_id(at));
        let (ids, counts) = (ids.collect(), fleet.counts);
        drop(fleet);
        let is_whole = counts.strangers + counts.surplus + counts.damaged == 0;
        status.push(DiagnosticStatus {
            level: u8::from(!is_whole),
            name: "facewire bridge".to_owned(),
            message: if is_whole { "runs" } else { "packets were refused" }.to_owned(),
            hardware_id: String::new(),
            values: values([
                ("strangers", counts.strangers),
                ("surplus", counts.surplus),
                ("damaged", counts.damaged),
                ("skipped", self.skipped),
                ("refused", self.refused),
            ]),
        });
        let header = Header { stamp: SystemTime::now().into(), frame_id: String::new() };
        if let Some(faces) = &mut self.faces {
            self.refused += faces.publish(IdsList { header: header.clone(), ids });
        }
        self.refused += self.diagnostics.publish(DiagnosticArray { header, status });
    }
}

/// The name of a face for ROS4HRI: five characters that say nothing of the person.
fn face_id(at: usize) -> String {
    format!("f{at:04}")
}

fn values<const N: usize>(numbers: [(&'static str, u64); N]) -> Vec<KeyValue> {
    numbers.map(|(key, number)| KeyValue { key, value: number.to_string() }).into()
}

fn board_status(board: &Board, now: Instant) -> DiagnosticStatus {
    let (packet, tally) = (board.packet(), &board.tally);
    let (level, message) = match (packet.state, packet.reason) {
        _ if !board.is_here(now) => (3, "silent".to_owned()),
        (State::Live, Reason::None) => (0, "live".to_owned()),
        (state, reason @ (Reason::NoCamera | Reason::BadResult)) => (2, format!("{}: {}", state.name(), reason.name())),
        (state, reason @ Reason::Late) => (1, format!("{}: {}", state.name(), reason.name())),
        (state, reason) => (0, format!("{}: {}", state.name(), reason.name())),
    };
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a rate is small and positive")]
    let rate_hz = tally.rate_hz(now).round() as u64;
    let covered: Vec<_> = packet.visibility.covered().collect();
    let mut values = values([
        ("packets_per_s", rate_hz),
        ("packets", tally.packets),
        ("lost", tally.lost),
        ("damaged", tally.refused),
    ]);
    values.push(KeyValue { key: "covered", value: covered.join(", ") });
    DiagnosticStatus {
        level,
        name: format!("facewire {}", board.name),
        message,
        hardware_id: board.address.to_string(),
        values,
    }
}
