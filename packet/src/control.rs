//! What goes over the control socket of a service: one JSON value a line in both directions, and one [`Request`] for each
//! connection. [`Connection`] is a client that waits for each line.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io::{self, BufRead as _, BufReader, ErrorKind, Write as _};
use std::ops::Not;
use std::os::unix::fs::MetadataExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};

const SOCKET: &str = "control";
/// The folder of the socket in a runtime directory.
const FOLDER: &str = "facewire";
/// Where the service manager puts the runtime directory of the service.
pub const SYSTEM_FOLDER: &str = "/run/facewire";
/// A service that sends no line for this long does not work.
const PATIENCE: Duration = Duration::from_secs(10);

/// What a client asks, and is answered [`Reply::Refused`] if it cannot be done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// Calibrate this wearer, or the one in use. The answer is any number of [`Reply::Progress`] and one other reply. A
    /// client that closes the connection cancels the calibration.
    Calibrate {
        /// The wearer's name.
        wearer: Option<String>,
    },
    /// Use the profile of this wearer, or nobody's.
    Use {
        /// The wearer's name.
        wearer: Option<String>,
    },
    /// Tell who has a profile, as [`Reply::Wearers`].
    List {},
    /// Delete the profile of this wearer.
    Delete {
        /// The wearer's name.
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
    /// Give servos no pulses, on all links, until a client asks to give them some again. This ends a drive. A drive that
    /// begins later gives pulses to the servo that it jogs, and to no other. The answer comes when every servo board has
    /// acknowledged the release. If some have not after a quarter of a second, it is [`Reply::Refused`], and says which ones
    /// and what to do. They obey as soon as they are reached.
    Release {
        /// Whether servos get no pulses.
        on: bool,
    },
    /// Move servos or the whole face. The first answer is [`Reply::Driving`]; then the client sends a [`Drive`] in a line, at
    /// least every 250 ms. After 400 ms without a line, or when the client closes the connection, the wearer's face is back.
    /// One client at a time can drive. From the first answer on, servo boards that it does not move stay where they are.
    Drive {
        /// Whether they follow the face instead.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        others_follow: bool,
    },
    /// Show the next frame that the camera gives, as [`Reply::Picture`] and the bytes of its rows. Refused unless the setting
    /// `console.picture` allows it.
    Picture {},
    /// Tell where the landmarks of the next frame are, as [`Reply::Picture`] without bytes, whatever the settings say.
    Landmarks {},
}

/// What a client that drives wants from now on. It takes the place of what it wanted before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
pub enum Drive {
    /// The same as before.
    Alive {},
    /// A position of one servo, which goes there within its limits, or at half of its range a second if its speed has none. The
    /// other channels of the link are at rest. Links to anything but servo boards follow the face.
    Jog {
        /// The number of the link, from 0 on in the order of the settings.
        link: usize,
        /// The number of the channel.
        channel: u16,
        /// From 0 to 1.
        position: f32,
    },
    /// A face in place of the wearer's, on all links.
    Puppet {
        /// Coefficients by their names. Those that are missing are 0.
        #[serde(default)]
        coefficients: BTreeMap<String, f32>,
        /// Yaw, pitch and roll of the head.
        #[serde(default)]
        head_deg: [f32; 3],
    },
}

/// An answer of the service.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reply {
    /// How far the calibration is.
    Progress(Progress),
    /// The calibration has ended, and its profile is in use.
    Calibrated(KeptProfile),
    /// Who has a profile.
    Wearers {
        /// In alphabetical order.
        wearers: Vec<Listed>,
        /// Whose profile is in use.
        in_use: Option<String>,
        /// Where the profiles are.
        folder: String,
    },
    /// An entry of a recording in Base64.
    Frame(String),
    /// How many frames were lost since the recording began. Also sent once a second while no frame comes.
    Lost(u64),
    /// The bytes of a [`Packet`](crate::Packet) in Base64.
    Packet(String),
    /// What the service does at present.
    Status(Box<Status>),
    /// The client drives.
    Driving(bool),
    /// A picture of the camera, whose bytes follow the line.
    Picture(PictureHead),
    /// It is done: one sentence about it.
    Done(String),
    /// It cannot be done: one sentence that says why, and what to do.
    Refused(String),
}

/// What comes before the bytes of a picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PictureHead {
    /// How the bytes are to be read.
    pub format: PictureFormat,
    /// Pixels in a row.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Degrees by which the rows must be turned clockwise to stand upright, a multiple of 90.
    #[serde(default)]
    pub rotation_deg: u32,
    /// Whether black and white are 0 and 255 rather than 16 and 235.
    #[serde(default)]
    pub full_range: bool,
    /// How many bytes follow the line.
    pub bytes: usize,
    /// When the picture was captured, on the monotonic clock.
    pub time_us: u64,
    /// In pixels of the upright picture, if a face was found.
    pub landmarks: Option<Vec<[f32; 2]>>,
}

/// How the bytes of a picture are to be read. A picture that was a JPEG image is NV12.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PictureFormat {
    /// Two pixels in four bytes: luma, Cb, luma, Cr.
    Yuyv,
    /// Luma, then rows of Cb and Cr in turn, with one pair for four pixels.
    Nv12,
    /// Luma alone.
    Grey,
}

/// What a service does at present.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The version of the service.
    pub version: String,
    /// The page of the metrics, in the text format of `OpenMetrics`.
    pub metrics: String,
    /// Whose profile is in use.
    pub wearer: Option<String>,
    /// The file of the settings.
    pub config: Option<String>,
    /// Why the settings that were read last are not in use. The former ones are.
    pub settings_refused: Option<String>,
    /// Whether an operator keeps all servos without pulses.
    pub released: bool,
    /// When an operator released them, seconds since 1970. `None` if they are not released.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub released_unix_s: Option<u64>,
    /// Why the service will not know of that when it starts again, if the disk does not keep it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub release_not_kept: Option<String>,
    /// Whether an operator drives.
    pub driven: bool,
    /// Whether the settings allow [`Request::Picture`].
    pub picture: bool,
    /// In the order of the settings.
    pub links: Vec<LinkStatus>,
}

/// What a link does at present.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinkStatus {
    /// Its kind and its receiver.
    pub name: String,
    /// Its kind in the settings.
    pub kind: String,
    /// Whether its device is open, or its host is known and takes packets.
    pub open: bool,
    /// Number of messages sent.
    pub sent: u64,
    /// Number of messages that were not sent.
    pub dropped: u64,
    /// What went wrong last since the device was opened or the host was found, or else that nobody listens there.
    pub trouble: Option<String>,
    /// Whether the receiver's machine says that nobody listens at the port. Packets are sent all the same.
    #[serde(default, skip_serializing_if = "Not::not")]
    pub unheard: bool,
    /// Seconds since the receiver last sent something back. `None` if it never has, as most do not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub answered_s_ago: Option<u64>,
    /// Whether the board has acknowledged that an operator keeps its servos without pulses. `None` if the link moves no
    /// servos.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub released: Option<bool>,
    /// What happens to its servos while an operator has stopped them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop: Option<String>,
    /// Those of a servo board.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub channels: Vec<ChannelStatus>,
}

/// What a servo does at present.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChannelStatus {
    /// The number of the channel.
    pub number: u16,
    /// Where the servo goes, from 0 to 1.
    pub target: Option<f32>,
    /// Where it is by now if it keeps its limits, from 0 to 1.
    pub position: Option<f32>,
    /// None without pulses. Of a bus servo, its place in steps, and none without torque.
    pub pulse_us: Option<f32>,
    /// What people call the servo, if the settings name it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The position that a bus servo reports: below 0 or above 1 beyond its ends. `None` if it does not answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<f32>,
    /// Supply voltage of a bus servo, volts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volts: Option<f32>,
    /// Temperature of a bus servo, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub celsius: Option<f32>,
    /// Load of a bus servo from 0 to 1, if its family reports it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub load: Option<f32>,
}

/// How far a calibration is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// What the wearer is asked to do.
    pub take: Take,
    /// Takes that are done or left out.
    pub done: usize,
    /// Takes in all.
    pub of: usize,
    /// What the guide does with the take.
    pub phase: Phase,
    /// How much of the take is measured, 0 to 1.
    pub measured: f32,
    /// How strongly the pose is seen, 1 being enough; 0 in the neutral take.
    pub seen: f32,
    /// Why the guide waits or, at the end, why it has made no profile.
    pub waits_for: Option<Refusal>,
    /// Number of refused takes.
    pub refused: u32,
    /// Why the last one was refused.
    pub last_refusal: Option<Refusal>,
}

impl Progress {
    /// Whether another progress differs only in the bars.
    #[must_use]
    pub fn says_the_same(&self, other: &Self) -> bool {
        let key = |of: &Self| (of.take, of.phase, of.waits_for, of.refused, of.last_refusal);
        key(self) == key(other)
    }
}

/// What the guide of a calibration does with a take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// The wearer reads what to do.
    GetReady,
    /// The conditions of the take do not hold, or its pose is not seen yet.
    Wait,
    /// The wearer holds the pose.
    Measure,
    /// The calibration has ended.
    Ended,
}

/// A profile that a calibration made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeptProfile {
    /// Whose it is.
    pub wearer: String,
    /// Its file.
    pub path: String,
    /// The takes that it holds.
    pub taken: Vec<Take>,
    /// The poses that were left out, and why.
    pub left_out: Vec<(Take, Refusal)>,
    /// Number of refused takes.
    pub refused: u32,
    /// What is not as it should be, although the profile is in place.
    #[serde(default)]
    pub warning: Option<String>,
}

/// A wearer who has a profile.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Listed {
    /// The wearer's name.
    pub wearer: String,
    /// When the profile was made, seconds since 1970, and how many takes it holds; or why it cannot be used.
    pub profile: Result<(u64, usize), String>,
}

/// Declares what the wearer is told: a name, and the sentence as which it is displayed.
macro_rules! told {
    ($( #[doc = $doc:literal] $type:ident: $( $variant:ident $name:literal = $sentence:literal; )* )*) => { $(
        #[doc = $doc]
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum $type {
            $( #[doc = $sentence] $variant, )*
        }

        impl $type {
            /// All of them in their order.
            pub const ALL: [Self; [ $( $name ),* ].len()] = [ $( Self::$variant, )* ];

            /// The name in files and over the socket.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $( Self::$variant => $name, )* }
            }
        }

        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self { $( Self::$variant => $sentence, )* })
            }
        }
    )* };
}

told! {
    /// One thing that a calibration asks of the wearer, in the order of asking. Left and right are the wearer's.
    Take:
        Neutral "neutral" = "Look into the camera with your face at rest and your mouth closed";
        EyesShut "eyes-shut" = "Shut both eyes, count to three, and open them again";
        JawOpen "jaw-open" = "Open your mouth wide";
        BrowsUp "brows-up" = "Raise your eyebrows";
        BrowsDown "brows-down" = "Draw your eyebrows down, as if in anger";
        Smile "smile" = "Smile as widely as you can";
        Pucker "pucker" = "Pucker your lips, as if for a kiss";
        LookLeft "look-left" = "Look to your left with your eyes alone";
        LookRight "look-right" = "Look to your right with your eyes alone";
        LookUp "look-up" = "Look up with your eyes alone";
        LookDown "look-down" = "Look down with your eyes alone";

    /// Why the guide of a calibration waits, or refuses a take.
    Refusal:
        NoPicture "no-picture" = "No picture comes from the camera: check its cable";
        NoFace "no-face" = "No face is in the picture: sit in front of the camera";
        TooDark "too-dark" = "The face is too dark: turn on a light in front of you";
        HeadTurned "head-turned" = "The head is turned: face the camera";
        HeadMoves "head-moves" = "The head moves: keep it still";
        FaceMoves "face-moves" = "The face moves: hold it still";
        EyesShut "eyes-shut" = "The eyes are shut or half shut: open them as you usually do";
        Smiling "smiling" = "The mouth smiles: let your face rest";
        MouthOpen "mouth-open" = "The mouth is open: close it";
        BrowsMoved "brows-moved" = "The eyebrows are raised or drawn down: let your face rest";
        NotSeen "not-seen" = "No such movement is seen: make it stronger";
        TooShort "too-short" = "The movement ended too early: hold it a little longer";
}

impl Refusal {
    /// The sentence with which a calibration ends that came to nothing.
    #[must_use]
    pub fn end(self) -> String {
        format!("no profile was made, and any former one stays. {self}, and try again")
    }
}

/// Where a client looks for the service: where one started like this process listens, then the system's service.
#[must_use]
pub fn sockets() -> Vec<PathBuf> {
    let of_system = std::env::var("RUNTIME_DIRECTORY").is_err().then(|| Path::new(SYSTEM_FOLDER).join(SOCKET));
    socket().into_iter().chain(of_system).collect()
}

/// Where a service listens: in the runtime directory of the service manager, or else of the user. Where neither is named, as after
/// `su` or in a job of cron, in the folder of the user below `/run/user`, or else in [`SYSTEM_FOLDER`] for root.
#[must_use]
pub fn socket() -> Option<PathBuf> {
    let of_service = || std::env::var("RUNTIME_DIRECTORY").ok()?.split(':').next().map(PathBuf::from);
    let of_user = || std::env::var("XDG_RUNTIME_DIR").ok().map(|folder| Path::new(&folder).join(FOLDER));
    // The files of a process in /proc belong to its user.
    let unnamed = || unnamed_folder(Path::new("/run"), fs::metadata("/proc/self").ok()?.uid());
    let folder = of_service().or_else(of_user).or_else(unnamed).filter(|folder| folder.is_absolute())?;
    Some(folder.join(SOCKET))
}

/// The folder of this user below `run` for the socket of a service, if nobody else can put anything there.
fn unnamed_folder(run: &Path, user: u32) -> Option<PathBuf> {
    let of_user = run.join("user").join(user.to_string());
    let is_private = |folder: &fs::Metadata| folder.is_dir() && folder.uid() == user && folder.mode() & 0o777 == 0o700;
    if fs::symlink_metadata(&of_user).is_ok_and(|folder| is_private(&folder)) {
        return Some(of_user.join(FOLDER));
    }
    let of_system = run.join(FOLDER);
    let is_free = match fs::symlink_metadata(&of_system) {
        Ok(folder) => is_private(&folder),
        Err(error) => error.kind() == ErrorKind::NotFound,
    };
    (user == 0 && is_free).then_some(of_system)
}

/// A client of a service, which waits for what the service does.
#[derive(Debug)]
pub struct Connection {
    path: PathBuf,
    stream: BufReader<UnixStream>,
}

impl Connection {
    /// Connects to the service that runs on this machine. `None` if there is none.
    ///
    /// # Errors
    ///
    /// A sentence that says why the service does not answer, and what to do.
    pub fn open() -> Result<Option<Self>, String> {
        for path in sockets() {
            match UnixStream::connect(&path) {
                Ok(stream) => {
                    let timeouts = stream.set_read_timeout(Some(PATIENCE));
                    timeouts.and_then(|()| stream.set_write_timeout(Some(PATIENCE))).map_err(|e| lost(&path, &e))?;
                    return Ok(Some(Self { path, stream: BufReader::new(stream) }));
                }
                Err(error) if error.kind() == ErrorKind::PermissionDenied => {
                    let path = path.display();
                    return Err(format!("the service at {path} belongs to another user: try again with sudo"));
                }
                Err(_) => {}
            }
        }
        Ok(None)
    }

    /// Sends a request, or what one who drives wants.
    ///
    /// # Errors
    ///
    /// A sentence that says why the service does not answer, and what to do.
    pub fn ask(&mut self, request: &impl Serialize) -> Result<(), String> {
        let line = serde_json::to_string(request).map_err(|error| error.to_string())?;
        writeln!(self.stream.get_mut(), "{line}").map_err(|error| lost(&self.path, &error))
    }

    /// Waits for the next line of the answer.
    ///
    /// # Errors
    ///
    /// A sentence that says why the service does not answer, and what to do.
    pub fn reply(&mut self) -> Result<Reply, String> {
        let mut line = String::new();
        let count = self.stream.read_line(&mut line).map_err(|error| lost(&self.path, &error))?;
        if count == 0 {
            return Err(lost(&self.path, &ErrorKind::ConnectionReset.into()));
        }
        let other = |_| format!("the service at {} is of another version: restart it", self.path.display());
        serde_json::from_str(&line).map_err(other)
    }
}

fn lost(path: &Path, error: &io::Error) -> String {
    format!("the service at {} does not answer ({error}): see its log, and try again", path.display())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_the_wearer_is_told_has_the_same_name_in_files_and_over_the_socket() {
        let json = |name: &str| format!("{name:?}");
        assert!(Take::ALL.iter().all(|take| serde_json::to_string(take).unwrap() == json(take.name())));
        assert!(Refusal::ALL.iter().all(|why| serde_json::to_string(why).unwrap() == json(why.name())));
    }

    #[test]
    fn a_service_without_a_named_runtime_directory_listens_where_nobody_else_can_put_anything() {
        use std::os::unix::fs::PermissionsExt as _;

        let run = std::env::temp_dir().join(format!("facewire-run-{}", std::process::id()));
        let mine = fs::metadata("/proc/self").unwrap().uid();
        let of_user = run.join("user").join(mine.to_string());
        fs::create_dir_all(&of_user).unwrap();
        let found = |mode| {
            fs::set_permissions(&of_user, fs::Permissions::from_mode(mode)).unwrap();
            unnamed_folder(&run, mine)
        };
        assert_eq!(found(0o700), Some(of_user.join("facewire")));
        // Others can enter it, so only root has another place.
        let of_root = (mine == 0).then(|| run.join("facewire"));
        assert_eq!(found(0o755), of_root);
        fs::create_dir(run.join("facewire")).unwrap();
        fs::set_permissions(run.join("facewire"), fs::Permissions::from_mode(0o710)).unwrap();
        assert_eq!(found(0o755), None, "the folder of the service manager is its own");
        assert_eq!(unnamed_folder(&run, mine + 1), None);
        fs::remove_dir_all(run).unwrap();
    }

    #[test]
    fn the_documents_name_every_request_of_the_control_socket() {
        let rows = include_str!("../../docs/reference.md").lines().filter_map(|line| line.strip_prefix("| `"));
        let requests = rows.filter_map(|row| serde_json::from_str(&row[..=row.find('}')?]).ok());
        let (anna, wearer) = ("anna".to_owned(), || Some("anna".to_owned()));
        let [calibrate, choose] = [Request::Calibrate { wearer: wearer() }, Request::Use { wearer: wearer() }];
        let first = [calibrate, choose, Request::Delete { wearer: anna }, Request::List {}];
        let second = [Request::Record {}, Request::Watch {}, Request::Status {}, Request::Reload {}];
        let third = [
            Request::Release { on: true },
            Request::Drive { others_follow: false },
            Request::Picture {},
            Request::Landmarks {},
        ];
        assert_eq!(requests.collect::<Vec<Request>>(), [first, second, third].concat());
    }
}
