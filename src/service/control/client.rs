//! A client of the control thread, and what it is told: by the control socket, one JSON value a line in both directions,
//! or by HTTP.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::calibration::{KeptProfile, Listed, Progress};
use crate::link::Panel;
use crate::service::metrics::MAX_REQUEST_BYTES;
use facewire_servo::{Dial, Number};

pub(super) const MAX_LINE: usize = 256;
/// Longest line of one who drives. All coefficients by their names take half of it.
pub(super) const MAX_DRIVE_LINE: usize = 4096;
const SOCKET: &str = "control";
/// Where the service manager puts the runtime directory of the service.
const SYSTEM_FOLDER: &str = "/run/facewire";

/// What a client asks. A client asks once for each connection, and is answered [`Reply::Refused`] if it cannot be done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// Calibrate this wearer, or the one in use. The answer is any number of [`Reply::Progress`] and one other reply. A
    /// client that closes the connection cancels the calibration.
    Calibrate {
        wearer: Option<String>,
    },
    Use {
        wearer: Option<String>,
    },
    List {},
    Delete {
        wearer: String,
    },
    /// Tell what every frame shows, as [`Reply::Frame`], until the client closes the connection.
    Record {},
    /// Show what the links are offered, as [`Reply::Packet`], until the client closes the connection: at most 60 packets a
    /// second. A client that reads slowly misses some.
    Watch {},
    /// Tell what the service does at present, as [`Reply::Status`].
    Status {},
    /// Read the settings again, as SIGHUP does. The answer comes when the new settings are in force, and says what has
    /// changed, or names every fault in a line of its own.
    Reload {},
    /// Give servos no pulses, on all links, whatever else happens, until a client asks to give them some again. The answer
    /// comes when the links have been told.
    Release {
        on: bool,
    },
    /// Move servos or the whole face. The first answer is [`Reply::Driving`]; then the client sends a [`Drive`] in a line, at
    /// least every 250 ms. After 400 ms without a line, or when the client closes the connection, the wearer's face is back.
    /// One client at a time can drive.
    Drive {},
    /// Show the next frame that the camera gives, as [`Reply::Picture`] and the bytes of its rows. Refused unless the setting
    /// `console.picture` allows it.
    Picture {},
}

/// What a client that drives wants from now on. It takes the place of what it wanted before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
pub enum Drive {
    /// The same as before.
    Alive {},
    /// This position, from 0 to 1, of a channel of the link with this number, from 0 on in the order of the settings. The
    /// other channels of the link are at rest, and all other links follow the face.
    Jog { link: usize, channel: u8, position: f32 },
    /// A face in place of the wearer's, on all links: the coefficients by their names, 0 for those that are missing, and
    /// yaw, pitch and roll of the head.
    Puppet {
        #[serde(default)]
        coefficients: BTreeMap<String, f32>,
        #[serde(default)]
        head_deg: [f32; 3],
    },
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reply {
    Progress(Progress),
    /// The calibration has ended, and its profile is in use.
    Calibrated(KeptProfile),
    Wearers {
        wearers: Vec<Listed>,
        in_use: Option<String>,
        folder: String,
    },
    /// The bytes of a [`Recorded`](crate::recording::Recorded) in Base64.
    Frame(String),
    /// How many frames were lost since the recording began. Also sent once a second while no frame comes.
    Lost(u64),
    /// The bytes of a [`Packet`](facewire_packet::Packet) in Base64.
    Packet(String),
    Status(Box<Status>),
    Driving(bool),
    Picture(PictureHead),
    Done(String),
    /// It cannot be done: one sentence that says why, and what to do.
    Refused(String),
}

/// What comes before the bytes of a picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PictureHead {
    /// `yuyv`, `nv12` or `grey`. A picture that was a JPEG image is NV12.
    pub format: String,
    pub width: usize,
    pub height: usize,
    /// Whether black and white are 0 and 255 rather than 16 and 235.
    pub full_range: bool,
    /// How many bytes follow the line.
    pub bytes: usize,
    /// When the picture was captured, on the monotonic clock.
    pub time_us: u64,
    /// In pixels, if a face was found.
    pub landmarks: Option<Vec<[f32; 2]>>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Status {
    pub version: String,
    /// The page of the metrics, in the text format of `OpenMetrics`.
    pub metrics: String,
    pub wearer: Option<String>,
    /// The file of the settings.
    pub config: Option<String>,
    /// Whether an operator keeps all servos without pulses, and whether one drives.
    pub released: bool,
    pub driven: bool,
    /// Whether the settings allow [`Request::Picture`].
    pub picture: bool,
    /// In the order of the settings.
    pub links: Vec<LinkStatus>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinkStatus {
    pub name: String,
    pub kind: String,
    pub open: bool,
    pub sent: u64,
    pub dropped: u64,
    /// What went wrong last since the device was opened or the host was found.
    pub trouble: Option<String>,
    /// Those of a servo board.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub channels: Vec<ChannelStatus>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChannelStatus {
    pub number: u8,
    /// Where the channel goes, and where it is by now if it keeps its limits, from 0 to 1.
    pub target: Option<f32>,
    pub position: Option<f32>,
    /// None without pulses.
    pub pulse_us: Option<f32>,
}

impl LinkStatus {
    pub(super) fn of(panel: &Panel) -> Self {
        let kind = panel.kind.name();
        let channel = |dial: &Dial| {
            let [target, position, pulse_us] = [&dial.target, &dial.position, &dial.pulse_us].map(Number::get);
            ChannelStatus { number: dial.number, target, position, pulse_us }
        };
        Self {
            name: format!("{kind} {}", panel.receiver),
            kind: kind.to_owned(),
            open: panel.is_open.load(Relaxed),
            sent: panel.sent.load(Relaxed),
            dropped: panel.dropped.load(Relaxed),
            trouble: panel.trouble(),
            channels: panel.dials.channels.iter().map(channel).collect(),
        }
    }
}

/// Where a client looks for the service: where one started like this process listens, then the system's service.
pub fn control_sockets() -> Vec<PathBuf> {
    let of_system = std::env::var("RUNTIME_DIRECTORY").is_err().then(|| Path::new(SYSTEM_FOLDER).join(SOCKET));
    socket_path().into_iter().chain(of_system).collect()
}

/// Where the service listens: in the runtime directory of the service manager, or else of the user.
pub(in crate::service) fn socket_path() -> Option<PathBuf> {
    let of_service = || std::env::var("RUNTIME_DIRECTORY").ok()?.split(':').next().map(PathBuf::from);
    let of_user = || std::env::var("XDG_RUNTIME_DIR").ok().map(|folder| Path::new(&folder).join("facewire"));
    let folder = of_service().or_else(of_user).filter(|folder| folder.is_absolute())?;
    Some(folder.join(SOCKET))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Speaks {
    Requests,
    Http,
}

/// A reply, and bytes that follow it.
pub(super) type Answer = (Reply, Vec<u8>);

/// What the service does with a client next.
pub(super) enum Role {
    /// Hears its request, or waits until it has taken the answer.
    Asks,
    /// Hears one line after another.
    Drives,
    Watches,
    /// Gives it the answer as soon as there is one.
    Awaits(Box<dyn FnMut() -> Option<Answer> + Send>),
}

/// A connection that never blocks. What the client does not take at once waits in `output`.
pub(super) struct Client {
    stream: File,
    pub(super) speaks: Speaks,
    pub(super) role: Role,
    pub(super) input: Vec<u8>,
    output: Vec<u8>,
    /// Since when the service waits for the client: for its request, or until it takes what it was sent.
    pub(super) since: Instant,
}

impl Client {
    pub(super) fn new(stream: File, speaks: Speaks) -> Self {
        Self { stream, speaks, role: Role::Asks, input: Vec::new(), output: Vec::new(), since: Instant::now() }
    }

    /// Reads what has come of a request. Returns whether the client has ended its side.
    pub(super) fn receive(&mut self) -> io::Result<bool> {
        let left = self.most_bytes().saturating_sub(self.input.len());
        match (&self.stream).take(left as u64).read_to_end(&mut self.input) {
            Ok(count) => Ok(count < left),
            Err(error) if is_later(&error) => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn most_bytes(&self) -> usize {
        match (self.speaks, &self.role) {
            (Speaks::Http, _) => MAX_REQUEST_BYTES,
            (Speaks::Requests, Role::Drives) => MAX_DRIVE_LINE,
            (Speaks::Requests, _) => MAX_LINE,
        }
    }

    /// What the client asks in the next line that has come, or why it cannot be understood. `None` if no line is complete.
    pub(super) fn request<T: DeserializeOwned>(&mut self) -> Option<Result<T, String>> {
        if let Some(end) = self.input.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.input.drain(..=end).collect();
            self.since = Instant::now();
            let read = serde_json::from_slice(&line);
            return Some(read.map_err(|error| format!("the request is not understood: {error}")));
        }
        let most = self.most_bytes();
        (self.input.len() >= most).then(|| Err(format!("the request has more than {most} bytes")))
    }

    /// Whether the client has closed the connection, or has not taken what it was sent for this time. What it sends is
    /// ignored.
    pub(super) fn has_gone(&mut self, patience: Duration) -> bool {
        let is_closed = match self.stream.read(&mut [0; MAX_LINE]) {
            Ok(count) => count == 0,
            Err(error) => !is_later(&error),
        };
        is_closed || (self.is_behind() && self.has_waited(patience))
    }

    pub(super) fn has_waited(&self, time: Duration) -> bool {
        self.since.elapsed() > time
    }

    pub(super) fn is_behind(&self) -> bool {
        !self.output.is_empty()
    }

    pub(super) fn send(&mut self, reply: &Reply) -> io::Result<()> {
        let mut line = serde_json::to_vec(reply)?;
        line.push(b'\n');
        self.send_bytes(&line)
    }

    pub(super) fn send_bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        if !self.is_behind() {
            self.since = Instant::now();
        }
        self.output.extend_from_slice(bytes);
        self.flush()
    }

    pub(super) fn flush(&mut self) -> io::Result<()> {
        while self.is_behind() {
            match self.stream.write(&self.output) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => drop(self.output.drain(..count)),
                Err(error) if is_later(&error) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

fn is_later(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
