//! Runs the program `facewire`, which knows settings and devices.

use std::{env, ffi::OsString, io, path::PathBuf, process::Stdio, time::Duration};

use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::UnixStream,
    process::Command,
    time::timeout,
};

/// The most that is read of what a program writes.
const MOST_BYTES: u64 = 512 * 1024;
/// `check` watches the camera for 3 s, and a board needs some more to load the networks.
const PATIENCE: Duration = Duration::from_secs(60);

/// What a program wrote, and how it ended.
#[derive(Debug)]
pub struct Output {
    pub status: Option<i32>,
    pub out: String,
    pub err: String,
}

/// How to run `facewire`, and how to have done what needs more rights.
#[derive(Debug, Clone)]
pub struct Program {
    path: PathBuf,
    helper: Option<PathBuf>,
}

impl Program {
    /// Uses the program beside this one. FACEWIRE_PROGRAM names another one.
    pub fn new(helper: Option<PathBuf>) -> Self {
        let beside = || env::current_exe().unwrap_or_default().with_file_name("facewire").into_os_string();
        Self { path: env::var_os("FACEWIRE_PROGRAM").unwrap_or_else(beside).into(), helper }
    }

    /// A command that ends with this program.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.path);
        command.args(arguments.iter().map(OsString::from));
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
        command
    }

    /// Runs `facewire` with this input to its end.
    pub async fn run(&self, arguments: &[&str], input: &str) -> io::Result<Output> {
        let mut command = self.command(arguments);
        run(command.stdin(Stdio::piped()), input).await.map_err(|error| {
            let path = self.path.display();
            io::Error::other(format!("{path} does not run ({error}); install facewire beside this program"))
        })
    }

    /// Asks the helper of this system for something, which has rights that this program does not have, and returns what
    /// it prints. `None` if there is no helper.
    pub async fn ask_helper(&self, what: &str) -> Option<io::Result<String>> {
        let path = self.helper.as_ref()?;
        let work = async {
            let mut stream = UnixStream::connect(path).await?;
            stream.write_all(format!("{what}\n").as_bytes()).await?;
            let mut text = Vec::new();
            stream.take(MOST_BYTES).read_to_end(&mut text).await?;
            Ok(String::from_utf8_lossy(&text).into_owned())
        };
        Some(timeout(PATIENCE, work).await.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into())))
    }
}

/// Runs a command to its end, and reads a bounded part of what it writes.
pub async fn run(command: &mut Command, input: &str) -> io::Result<Output> {
    let work = async {
        let mut child = command.kill_on_drop(true).spawn()?;
        let (mut stdin, out, err) = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let write = async {
            if let Some(stdin) = &mut stdin {
                // A program that does not want all of its input is no fault.
                let _ = stdin.write_all(input.as_bytes()).await;
            }
            drop(stdin);
        };
        let ((), out, err) = tokio::join!(write, text(out), text(err));
        let status = child.wait().await?.code();
        Ok(Output { status, out: out?, err: err? })
    };
    timeout(PATIENCE, work).await.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
}

async fn text(pipe: Option<impl tokio::io::AsyncRead + Unpin>) -> io::Result<String> {
    let mut bytes = Vec::new();
    if let Some(pipe) = pipe {
        pipe.take(MOST_BYTES).read_to_end(&mut bytes).await?;
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
