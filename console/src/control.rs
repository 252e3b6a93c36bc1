//! The client of the service's control socket: one JSON value a line in both directions, and one request for each
//! connection.
//!
//! Nothing here trusts the service to answer in time or briefly: a connection, a request and a plain answer have
//! [`PATIENCE`] each, a release [`RELEASE_PATIENCE`], and a line has at most [`MOST_LINE_BYTES`].

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::Duration,
};

use facewire_packet::control::{Request, sockets};
use serde::Serialize;
use serde_json::Value;
use tokio::{
    io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader},
    net::{
        UnixStream,
        unix::{OwnedReadHalf, OwnedWriteHalf},
    },
    time::timeout,
};

/// Time in which the service must take a request, and answer it.
const PATIENCE: Duration = Duration::from_secs(3);
/// Time in which it must answer a release, for which it waits up to a quarter of a second for boards. Without an answer, nobody
/// knows what the servos do.
const RELEASE_PATIENCE: Duration = Duration::from_millis(500);
/// A status with the metrics of all stages has some 40 kB.
const MOST_LINE_BYTES: u64 = 512 * 1024;

/// Why a request to the service came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// Nobody listens at the socket.
    #[error("the service does not run: start it on the page Start")]
    Away,
    /// The service runs, but nobody listens at the socket.
    #[error(
        "the service runs as process {process}, but this console does not reach it: it has no control socket at {socket}. \
         Set XDG_RUNTIME_DIR for both to the same folder, which only their user can enter, and start both again"
    )]
    Unreached { process: u32, socket: String },
    /// The socket exists, and this user may not use it.
    #[error("this program may not speak with the service: run it as the unit facewire-console does, or as root")]
    Forbidden,
    #[error("the service does not answer ({0}); look at its log, and restart it")]
    Silent(io::Error),
    /// The service's own sentence.
    #[error("{0}")]
    Refused(String),
}

impl From<io::Error> for ControlError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => Self::Away,
            io::ErrorKind::PermissionDenied => Self::Forbidden,
            _ => Self::Silent(error),
        }
    }
}

/// Where the service listens.
#[derive(Debug, Clone)]
pub struct Control {
    paths: Vec<PathBuf>,
}

impl Control {
    /// Without a path, looks where the service of this user listens, and then where the system's does.
    pub fn new(path: Option<&Path>) -> Self {
        Self { paths: path.map_or_else(sockets, |path| vec![path.to_owned()]) }
    }

    /// Says why nobody listens at the socket: whether the service of these settings runs on the machine whose `/proc` lies below
    /// `root`.
    pub fn why_away(&self, root: &Path, settings: &Path) -> ControlError {
        let socket = self.paths.first().map_or_else(String::new, |path| path.display().to_string());
        match process_of(root, settings) {
            Some(process) => ControlError::Unreached { process, socket },
            None => ControlError::Away,
        }
    }

    /// Connects and sends a request. The connection stays open for the answer.
    pub async fn open(&self, request: &Request) -> Result<Connection, ControlError> {
        let mut last = ControlError::Away;
        for path in &self.paths {
            match within(UnixStream::connect(path)).await {
                Ok(stream) => {
                    let (read, write) = stream.into_split();
                    let mut connection = Connection { read: BufReader::new(read), write };
                    connection.send(request).await?;
                    return Ok(connection);
                }
                Err(error) => last = error.into(),
            }
        }
        Err(last)
    }

    /// Sends a request and returns the only line of its answer.
    pub async fn ask(&self, request: &Request) -> Result<Value, ControlError> {
        self.open(request).await?.reply().await
    }

    /// Sends a request that something be done, and returns the service's sentence about it.
    pub async fn tell(&self, request: &Request) -> Result<String, ControlError> {
        let reply = self.ask(request).await?;
        Ok(reply.get("done").and_then(Value::as_str).unwrap_or_default().to_owned())
    }

    /// Has all servos released, or lets them move again.
    pub async fn release(&self, on: bool) -> Result<String, ControlError> {
        let told = timeout(RELEASE_PATIENCE, self.tell(&Request::Release { on })).await;
        told.unwrap_or_else(|_| Err(ControlError::Silent(io::ErrorKind::TimedOut.into())))
    }

    pub async fn status(&self) -> Result<Value, ControlError> {
        let mut reply = self.ask(&Request::Status {}).await?;
        Ok(reply.get_mut("status").map(Value::take).unwrap_or_default())
    }
}

/// An open connection.
#[derive(Debug)]
pub struct Connection {
    read: BufReader<OwnedReadHalf>,
    write: OwnedWriteHalf,
}

impl Connection {
    pub async fn send(&mut self, line: &impl Serialize) -> io::Result<()> {
        within(self.write.write_all(format!("{}\n", serde_json::to_string(line)?).as_bytes())).await
    }

    /// Waits for the next line for as long as it takes. `None` if the service has closed the connection.
    pub async fn next(&mut self) -> Result<Option<Value>, ControlError> {
        let mut line = Vec::new();
        (&mut self.read).take(MOST_LINE_BYTES).read_until(b'\n', &mut line).await?;
        if line.is_empty() {
            return Ok(None);
        }
        let mut value: Value = serde_json::from_slice(&line).map_err(io::Error::from)?;
        match value.get_mut("refused").map(Value::take) {
            Some(Value::String(sentence)) => Err(ControlError::Refused(sentence)),
            _ => Ok(Some(value)),
        }
    }

    /// Returns the answer to a request that is answered at once.
    pub async fn reply(&mut self) -> Result<Value, ControlError> {
        let ended = || ControlError::Silent(io::ErrorKind::UnexpectedEof.into());
        let next = timeout(PATIENCE, self.next()).await;
        next.unwrap_or_else(|_| Err(ControlError::Silent(io::ErrorKind::TimedOut.into())))?.ok_or_else(ended)
    }

    /// Reads bytes that follow a line.
    pub async fn read_exact(&mut self, bytes: &mut [u8]) -> io::Result<()> {
        within(self.read.read_exact(bytes)).await.map(drop)
    }
}

/// Returns the process that runs the service with these settings, or with none.
fn process_of(root: &Path, settings: &Path) -> Option<u32> {
    let processes = fs::read_dir(root.join("proc")).ok()?;
    processes.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok()).find(|process: &u32| {
        let folder = root.join("proc").join(process.to_string());
        let arguments = fs::read_to_string(folder.join("cmdline")).unwrap_or_default();
        let mut arguments = arguments.split('\0');
        let is_program = arguments.next().is_some_and(|program| Path::new(program).ends_with("facewire"));
        let is_service = is_program && arguments.next() == Some("run");
        let config = arguments.skip_while(|argument| *argument != "--config").nth(1);
        let is_same = |config| fs::read_link(folder.join("cwd")).unwrap_or_default().join(config) == settings;
        is_service && config.is_none_or(is_same)
    })
}

async fn within<T>(work: impl Future<Output = io::Result<T>>) -> io::Result<T> {
    timeout(PATIENCE, work).await.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
}

#[cfg(test)]
mod tests {
    use tokio::{net::UnixListener, time::Instant};

    use super::*;

    #[test]
    fn a_service_that_runs_and_does_not_listen_is_told_with_its_process_and_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let (root, settings) = (folder.path(), Path::new("/etc/facewire.toml"));
        let control = Control::new(Some(Path::new("/run/here/control")));
        let run = |process: u32, arguments: &str| {
            let of_process = root.join("proc").join(process.to_string());
            fs::create_dir_all(&of_process).unwrap();
            fs::write(of_process.join("cmdline"), arguments).unwrap();
        };
        for (process, arguments) in
            [(5, "/usr/bin/facewire\0run\0--config\0/etc/other.toml\0"), (6, "/usr/bin/facewire\0check\0"), (7, "")]
        {
            run(process, arguments);
        }
        assert!(matches!(control.why_away(root, settings), ControlError::Away));
        run(8, "/usr/bin/facewire\0run\0--config\0/etc/facewire.toml\0");
        let told = control.why_away(root, settings).to_string();
        for part in ["runs as process 8", "/run/here/control", "Set XDG_RUNTIME_DIR"] {
            assert!(told.contains(part), "{told}");
        }
    }

    /// The clock goes on only when everybody waits for it.
    #[tokio::test(start_paused = true)]
    async fn a_service_that_hangs_is_told_to_whoever_presses_stop_after_half_a_second() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        let _hangs = UnixListener::bind(&path).unwrap();
        let begun = Instant::now();
        let released = Control::new(Some(&path)).release(true).await;
        assert!(matches!(released, Err(ControlError::Silent(_))), "{released:?}");
        assert_eq!(begun.elapsed(), Duration::from_millis(500));
    }
}
