//! What a client asks the service, and what the service answers: one JSON value a line, in both directions. And where both
//! meet.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::calibration::{KeptProfile, Listed, Progress};

/// Longest line of a client, bytes.
pub(super) const MAX_LINE: usize = 256;
pub(super) const SOCKET: &str = "control";
/// Where the service manager puts the runtime directory of the service.
const SYSTEM_FOLDER: &str = "/run/facewire";

/// What a client asks. A client asks once for each connection.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// Calibrate this wearer, or the one in use. The answer is any number of [`Reply::Progress`] and one other reply. A
    /// client that closes the connection cancels the calibration.
    Calibrate { wearer: Option<String> },
    /// Use the profile of this wearer, or nobody's.
    Use { wearer: Option<String> },
    /// List the wearers who have a profile.
    List {},
    /// Delete the profile of this wearer.
    Delete { wearer: String },
    /// Tell what every frame shows, as [`Reply::Frame`], until the client closes the connection.
    Record {},
}

/// What the service answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reply {
    Progress(Progress),
    /// The calibration has ended, and its profile is in use.
    Calibrated(KeptProfile),
    /// The wearers, and the one in use.
    Wearers {
        wearers: Vec<Listed>,
        in_use: Option<String>,
        folder: String,
    },
    /// The bytes of a [`Recorded`](crate::recording::Recorded) in Base64.
    Frame(String),
    /// How many frames were lost since the recording began. Also sent once a second while no frame comes.
    Lost(u64),
    Done(String),
    /// It cannot be done: one sentence that says why, and what to do.
    Refused(String),
}

/// Where a client looks for the service.
pub fn control_sockets() -> Vec<PathBuf> {
    match std::env::var("RUNTIME_DIRECTORY") {
        Ok(_) => socket_path().into_iter().collect(),
        Err(_) => socket_path().into_iter().chain([Path::new(SYSTEM_FOLDER).join(SOCKET)]).collect(),
    }
}

/// Where the service listens: in the runtime directory of the service manager, or else of the user.
pub(super) fn socket_path() -> Option<PathBuf> {
    let of_service = || std::env::var("RUNTIME_DIRECTORY").ok()?.split(':').next().map(PathBuf::from);
    let of_user = || std::env::var("XDG_RUNTIME_DIR").ok().map(|folder| Path::new(&folder).join("facewire"));
    let folder = of_service().or_else(of_user).filter(|folder| folder.is_absolute())?;
    Some(folder.join(SOCKET))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_lines_that_people_can_type() {
        let read = |line: &str| serde_json::from_str::<Request>(line).ok();
        assert_eq!(read(r#"{"do":"list"}"#), Some(Request::List {}));
        assert_eq!(read(r#"{"do":"use","wearer":null}"#), Some(Request::Use { wearer: None }));
        let calibrate = Request::Calibrate { wearer: Some("anna".to_owned()) };
        assert_eq!(read(r#"{"do":"calibrate","wearer":"anna"}"#), Some(calibrate));
        assert_eq!([r#"{"do":"dance"}"#, r#"{"do":"list","all":true}"#].map(read), [None, None]);
        let longest = Request::Delete { wearer: "a".repeat(32) };
        assert!(serde_json::to_string(&longest).unwrap().len() < MAX_LINE);
    }
}
