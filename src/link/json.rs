//! JSON lines: one object a line, for programs that need no more than a parser of JSON, and their carriers on this machine:
//! standard output, and a Unix socket. `docs/receivers.md` describes the fields.
//!
//! Both may block, so each has the thread of a [`Background`](super::Background). A reader of standard output that is slow
//! gets the newest line only. A client of the socket that is slow misses whole lines, and one that takes nothing for
//! [`LONGEST_WAIT`] is disconnected; it delays no other.

use std::io::{self, ErrorKind, Write as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use facewire_face::HeadPose;
use facewire_packet::BLENDSHAPES;
use serde::ser::SerializeMap as _;
use serde::{Serialize, Serializer};

use super::angles::{Angles, Gaze};
use super::background::Device;
use super::{Encoder, LinkError, LinkErrorKind, Output};
use crate::config::Listen;
use crate::listener::Listener;

const LONGEST: usize = 2048;
/// Most clients of a socket at a time. Further ones are disconnected.
const MOST_CLIENTS: usize = 8;
/// Most clients that are accepted or disconnected between two lines, so that a crowd delays no connected client.
const MOST_AT_ONCE: usize = 16;
const LONGEST_WAIT: Duration = Duration::from_secs(5);

pub fn encoder() -> Encoder {
    let mut line = Vec::with_capacity(LONGEST);
    Box::new(move |output, gaze, sequence, send| {
        line.clear();
        if write(&mut line, output, gaze, sequence).is_ok() {
            line.push(b'\n');
            send(&line);
        }
    })
}

#[derive(Serialize)]
struct Head {
    yaw_deg: f64,
    pitch_deg: f64,
    roll_deg: f64,
    rotation_xyzw: [f64; 4],
    position_mm: [f64; 3],
}

fn write(line: &mut Vec<u8>, output: &Output, gaze: Gaze, sequence: u32) -> serde_json::Result<()> {
    let Output { state, reason, pose, age_us, capture_us, .. } = output;
    let head = HeadPose::from_rotation(pose.rotation, pose.position_mm);
    let [yaw_deg, pitch_deg, roll_deg] = head.yaw_pitch_roll_deg().map(|angle| rounded(angle, 1e2));
    let rotation_xyzw = head.rotation_xyzw.map(|part| rounded(part, 1e5));
    let position_mm = head.position_mm.map(|mm| rounded(mm, 1e1));
    let eye = |Angles { yaw, pitch, .. }: Angles| {
        let angles = [("yaw_deg", yaw), ("pitch_deg", pitch)];
        Object(angles.map(|(name, angle)| (name, rounded(angle.to_degrees(), 1e2))).into_iter())
    };
    let mut serializer = serde_json::Serializer::new(line);
    let mut object = serializer.serialize_map(None)?;
    object.serialize_entry("sequence", &sequence)?;
    object.serialize_entry("state", state.name())?;
    object.serialize_entry("reason", reason.name())?;
    object.serialize_entry("neutral_face", pose.neutral_face.name())?;
    object.serialize_entry("age_ms", &(*age_us != u64::MAX).then(|| *age_us as f64 / 1000.0))?;
    object.serialize_entry("capture_us", capture_us)?;
    object.serialize_entry("head", &Head { yaw_deg, pitch_deg, roll_deg, rotation_xyzw, position_mm })?;
    let eyes = [("left", eye(gaze.left)), ("right", eye(gaze.right))];
    object.serialize_entry("gaze", &Object(eyes.into_iter()))?;
    let coefficients = pose.coefficients.map(|value| rounded(value, 1e4));
    object.serialize_entry("coefficients", &Object(BLENDSHAPES.iter().zip(coefficients)))?;
    object.end()
}

#[derive(Clone)]
struct Object<I>(I);

impl<K: Serialize, V: Serialize, I: Iterator<Item = (K, V)> + Clone> Serialize for Object<I> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.clone())
    }
}

/// Returns the number with as many digits as `parts` has zeros, so that a line stays short.
fn rounded(number: f32, parts: f64) -> f64 {
    // Adding 0 turns -0 into 0.
    (f64::from(number) * parts).round() / parts + 0.0
}

pub struct Stdout;

impl Device for Stdout {
    type Open = ();

    fn open(&mut self) -> Result<(), LinkError> {
        Ok(())
    }

    fn write(&mut self, (): &mut (), message: &[u8]) -> Result<bool, LinkError> {
        let mut out = io::stdout().lock();
        let written = out.write_all(message).and_then(|()| out.flush());
        written.map(|()| true).map_err(|error| {
            let sentence = format!("it takes no lines ({error}); start a program that reads them");
            LinkError::new(LinkErrorKind::Output, "standard output", sentence)
        })
    }
}

pub struct Server {
    path: PathBuf,
    clients: Vec<Client>,
}

impl Server {
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), clients: Vec::with_capacity(MOST_CLIENTS) }
    }
}

impl Device for Server {
    type Open = Listener;

    fn open(&mut self) -> Result<Listener, LinkError> {
        let listener = Listener::bind(&Listen::Unix(self.path.clone()));
        listener.map_err(|error| LinkError::no_listener(self.path.display(), error))
    }

    fn write(&mut self, listener: &mut Listener, message: &[u8]) -> Result<bool, LinkError> {
        self.attend(listener)?;
        self.clients.retain_mut(|client| client.write(message).is_ok());
        Ok(true)
    }

    /// Accepts clients that wait, and disconnects those for whom there is no room. If the system cannot accept a client
    /// now, for example because this process has too many open files, a later call tries again.
    fn attend(&mut self, listener: &mut Listener) -> Result<(), LinkError> {
        for _ in 0..MOST_AT_ONCE {
            let Ok(stream) = listener.accept().map(UnixStream::from) else { break };
            if self.clients.len() < MOST_CLIENTS {
                self.clients.push(Client { stream, rest: Vec::new(), took: Instant::now() });
            }
        }
        Ok(())
    }
}

struct Client {
    stream: UnixStream,
    /// The part of a line that the client has not taken yet.
    rest: Vec<u8>,
    took: Instant,
}

impl Client {
    /// Writes the line, unless the client is still behind with an earlier one. Fails if the client has left, or takes
    /// nothing for too long.
    fn write(&mut self, line: &[u8]) -> io::Result<()> {
        let is_behind = !self.rest.is_empty();
        if !is_behind {
            self.rest.extend_from_slice(line);
        }
        match self.stream.write(&self.rest) {
            Ok(count) => {
                self.took = Instant::now();
                self.rest.drain(..count);
            }
            Err(error) if error.kind() != ErrorKind::WouldBlock || self.took.elapsed() > LONGEST_WAIT => {
                return Err(error);
            }
            // The client misses a line of which it took nothing.
            Err(_) if !is_behind => self.rest.clear(),
            Err(_) => {}
        }
        if is_behind && self.rest.is_empty() { self.write(line) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader, Read as _};

    use facewire_packet::State;
    use serde_json::{Value, json};

    use super::*;
    use crate::link::test_output;
    use crate::link::testing::{LEFT, PATIENCE, encoded, face};

    #[test]
    fn a_line_names_everything_and_the_age_is_null_before_the_first_pose() {
        let mut output = face(&[("jawOpen", 0.123_456), ("eyeLookUpLeft", 1.0)]);
        output = Output { pose: output.pose, age_us: 23_400, capture_us: 5_000_000, ..test_output(State::Hold) };
        (output.pose.rotation, output.pose.position_mm) = (LEFT, [10.04, -20.0, 600.0]);
        let line = |output: &Output| encoded(&mut encoder(), output).concat();
        let value = |output: &Output| serde_json::from_slice::<Value>(&line(output)).unwrap();
        let mut found = value(&output);
        let coefficients = found["coefficients"].take();
        assert_eq!((coefficients.as_object().unwrap().len(), &coefficients["jawOpen"]), (52, &json!(0.1235)));
        let want = json!({
            "sequence": 7, "state": "hold", "reason": "no face", "neutral_face": "mean", "age_ms": 23.4,
            "capture_us": 5_000_000, "coefficients": null,
            "head": {
                "yaw_deg": 30.0, "pitch_deg": 0.0, "roll_deg": 0.0,
                "rotation_xyzw": [0.0, 0.25882, 0.0, 0.96593], "position_mm": [10.0, -20.0, 600.0],
            },
            "gaze": { "left": { "yaw_deg": 0.0, "pitch_deg": 35.0 }, "right": { "yaw_deg": 0.0, "pitch_deg": 0.0 } },
        });
        assert_eq!(found, want);
        (output.pose.coefficients, output.pose.rotation) = ([0.123_456; 52], [-0.5, -0.5, -0.5, 0.5]);
        (output.pose.position_mm, output.age_us, output.capture_us) = ([-30_000.12; 3], u64::MAX - 1, u64::MAX);
        let longest = line(&output);
        assert!(longest.ends_with(b"}\n") && longest.len() < LONGEST);
        output.age_us = u64::MAX;
        assert!(value(&output)["age_ms"].is_null());
    }

    /// A socket that is served only when the test calls it.
    struct Served {
        server: Server,
        listener: Listener,
        _folder: tempfile::TempDir,
    }

    impl Served {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let mut server = Server::new(&folder.path().join("lines"));
            Self { listener: server.open().unwrap(), server, _folder: folder }
        }

        fn write(&mut self, number: u32, padding: usize) {
            assert!(self.server.write(&mut self.listener, format!("{number:0padding$}\n").as_bytes()).unwrap());
        }

        fn connected(&self) -> BufReader<UnixStream> {
            let stream = UnixStream::connect(&self.server.path).unwrap();
            stream.set_read_timeout(Some(PATIENCE)).unwrap();
            BufReader::new(stream)
        }
    }

    fn next(reader: &mut BufReader<UnixStream>) -> u32 {
        let mut line = String::new();
        reader.read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "{line:?}");
        line.trim().parse().unwrap()
    }

    #[test]
    fn a_client_that_reads_nothing_delays_no_other_and_later_reads_whole_lines() {
        let mut served = Served::new();
        let [mut slow, mut quick, _idle] = [(); 3].map(|()| served.connected());
        // Far more than the buffer of a socket holds.
        for number in 0..1000 {
            served.write(number, 2000);
            assert_eq!(next(&mut quick), number);
        }
        let (mut gaps, mut before) = (0, next(&mut slow));
        for number in 1000..1400 {
            served.write(number, 2000);
            let number = next(&mut slow);
            assert!(number > before);
            gaps += u32::from(number > before + 100);
            before = number;
        }
        assert_eq!(gaps, 1, "the slow client missed lines");
        let long_ago = Instant::now().checked_sub(2 * LONGEST_WAIT).unwrap();
        served.server.clients.iter_mut().for_each(|client| client.took = long_ago);
        served.write(1400, 2000);
        assert_eq!(served.server.clients.len(), 1, "a client that takes nothing for too long is disconnected");
    }

    #[test]
    fn a_crowd_is_disconnected_in_parts_so_that_it_delays_no_line_and_leaving_makes_room() {
        let mut served = Served::new();
        let mut crowd: Vec<_> =
            (0..2 * MOST_AT_ONCE).map(|_| UnixStream::connect(&served.server.path).unwrap()).collect();
        let is_disconnected = |client: &mut UnixStream| {
            client.set_nonblocking(true).unwrap();
            client.read(&mut [0; 1]).is_ok_and(|length| length == 0)
        };
        for most in [MOST_AT_ONCE, 2 * MOST_AT_ONCE] {
            served.server.attend(&mut served.listener).unwrap();
            let disconnected = crowd.iter_mut().map(is_disconnected).filter(|is_gone| *is_gone).count();
            assert_eq!((served.server.clients.len(), disconnected), (MOST_CLIENTS, most - MOST_CLIENTS));
        }
        drop(crowd);
        served.write(1, 0);
        let mut client = served.connected();
        served.write(2, 0);
        assert_eq!((served.server.clients.len(), next(&mut client)), (1, 2));
        // A TCP socket that is shut down accepts nobody, which stands for any error of the system.
        served.listener = Listener::bind(&Listen::Tcp(([127, 0, 0, 1], 0).into())).unwrap();
        rustix::net::shutdown(&served.listener, rustix::net::Shutdown::Both).unwrap();
        assert_ne!(served.listener.accept().unwrap_err().kind(), ErrorKind::WouldBlock);
        served.write(3, 0);
        assert_eq!(next(&mut client), 3, "a client keeps its place while the system accepts no others");
    }
}
