//! Recordings: files that `facewire record` writes, and plays through the links.

use std::{
    collections::BTreeMap,
    fs::{self, DirBuilder},
    io,
    os::unix::fs::DirBuilderExt as _,
    path::{Path, PathBuf},
    process::Stdio,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use facewire_packet::{BLENDSHAPES, control::Drive};
use hyper::StatusCode;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use serde::Serialize;
use serde_json::{Map, Value, json};
use tokio::{
    io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader},
    process::Child,
    select,
    sync::{Notify, watch},
    time::{Instant, interval, sleep, sleep_until, timeout},
};

use crate::{
    program::Program,
    servos::Servos,
    status::free_bytes,
    web::{Refusal, Token},
};

const SUFFIX: &str = ".fwrec";
/// A recording needs this much space to begin, and ends before less than half of it is left.
const LEAST_FREE_BYTES: u64 = 200_000_000;
/// An hour takes 190 MB.
const MOST_MB: u64 = 2000;
/// The service takes a while to end a recording.
const END_PATIENCE: Duration = Duration::from_secs(10);
/// The longest time between two movements, so that a pause in a recording does not disarm.
const STILL_THERE: Duration = Duration::from_millis(150);

const BUSY: Refusal = Refusal::fixed(StatusCode::CONFLICT, "A recording is being made or played. End it first.\n");
const NO_SPACE: Refusal =
    Refusal::fixed(StatusCode::INSUFFICIENT_STORAGE, "There is too little free space: delete recordings first.\n");
const NO_NAME: Refusal = Refusal::fixed(StatusCode::NOT_FOUND, "There is no recording of this name.\n");

/// A file.
#[derive(Debug, Serialize)]
pub struct Listed {
    name: String,
    bytes: u64,
    /// When it ended, in seconds since 1970.
    time_s: u64,
}

/// What goes on: a recording, or one that is played.
#[derive(Debug)]
struct Active {
    kind: &'static str,
    name: String,
    since: Instant,
    end: Arc<Notify>,
}

#[derive(Debug, Clone)]
pub struct Recordings {
    folder: PathBuf,
    active: Arc<Mutex<Option<Active>>>,
    publish: watch::Sender<Value>,
}

impl Recordings {
    pub fn new(state: &Path, publish: watch::Sender<Value>) -> Self {
        Self { folder: state.join("recordings"), active: Arc::default(), publish }
    }

    fn active(&self) -> MutexGuard<'_, Option<Active>> {
        self.active.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn free_bytes(&self) -> u64 {
        free_bytes(self.folder.parent().unwrap_or(Path::new("/")))
    }

    /// What goes on, for the status and the event.
    pub fn state(&self) -> Map<String, Value> {
        let mut state = Map::from_iter([("recording".to_owned(), Value::Null), ("playing".to_owned(), Value::Null)]);
        if let Some(Active { kind, name, since, .. }) = &*self.active() {
            let bytes = fs::metadata(self.folder.join(name)).map_or(0, |file| file.len());
            state.insert(
                (*kind).to_owned(),
                json!({"name": name, "seconds": since.elapsed().as_secs(), "bytes": bytes}),
            );
        }
        state
    }

    fn tell(&self, trouble: Option<&str>) {
        let mut state = self.state();
        state.insert("trouble".to_owned(), trouble.into());
        self.publish.send_replace(state.into());
    }

    /// Returns the path of a recording that exists.
    pub fn path(&self, name: &str) -> Result<PathBuf, Refusal> {
        let listed = self.list().map_err(|error| Refusal::failed(&error))?;
        // Only names that the folder lists, so that no name leads out of it.
        if listed.iter().any(|listed| listed.name == name) { Ok(self.folder.join(name)) } else { Err(NO_NAME) }
    }

    /// Returns all recordings, the newest first.
    pub fn list(&self) -> io::Result<Vec<Listed>> {
        let entries = match fs::read_dir(&self.folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries?,
        };
        let listed = entries.filter_map(|entry| {
            let entry = entry.ok()?;
            let (name, file) = (entry.file_name().into_string().ok()?, entry.metadata().ok()?);
            let time_s = file.modified().ok()?.duration_since(UNIX_EPOCH).ok()?.as_secs();
            (file.is_file() && name.ends_with(SUFFIX)).then_some(Listed { name, bytes: file.len(), time_s })
        });
        let mut listed: Vec<Listed> = listed.collect();
        listed.sort_by(|a, b| b.time_s.cmp(&a.time_s).then_with(|| b.name.cmp(&a.name)));
        Ok(listed)
    }

    pub fn delete(&self, name: &str) -> Result<(), Refusal> {
        let path = self.path(name)?;
        if self.active().as_ref().is_some_and(|active| active.name == name) {
            return Err(BUSY);
        }
        fs::remove_file(path).map_err(|error| Refusal::failed(&error))
    }

    fn enter(&self, kind: &'static str, name: String) -> Result<Arc<Notify>, Refusal> {
        let (mut active, end) = (self.active(), Arc::<Notify>::default());
        if active.is_some() {
            return Err(BUSY);
        }
        *active = Some(Active { kind, name, since: Instant::now(), end: Arc::clone(&end) });
        Ok(end)
    }

    /// Begins a recording and returns its name.
    pub fn begin(&self, program: &Program) -> Result<String, Refusal> {
        let free_bytes = self.free_bytes();
        let most_mb = (free_bytes.saturating_sub(LEAST_FREE_BYTES / 2) / 1_000_000).min(MOST_MB).to_string();
        if free_bytes < LEAST_FREE_BYTES {
            return Err(NO_SPACE);
        }
        DirBuilder::new().recursive(true).mode(0o700).create(&self.folder).map_err(|error| Refusal::failed(&error))?;
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let name = format!("{}{SUFFIX}", since.as_millis());
        let end = self.enter("recording", name.clone())?;
        let path = self.folder.join(&name);
        let child =
            program.command(&["record", &path.to_string_lossy(), "--max-mb", &most_mb]).stdout(Stdio::null()).spawn();
        let child = match child {
            Ok(child) => child,
            Err(error) => {
                *self.active() = None;
                return Err(Refusal::failed(&error));
            }
        };
        let recordings = self.clone();
        tokio::spawn(async move {
            let trouble = recordings.record(child, &end).await.err();
            *recordings.active() = None;
            recordings.tell(trouble.as_ref().map(ToString::to_string).as_deref());
        });
        Ok(name)
    }

    async fn record(&self, mut child: Child, end: &Notify) -> io::Result<()> {
        let mut errors = child.stderr.take();
        let mut seconds = interval(Duration::from_secs(1));
        let mut is_ending = false;
        let status = loop {
            select! {
                status = child.wait() => break status?,
                () = end.notified() => is_ending = true,
                _ = seconds.tick() => {
                    self.tell(None);
                    is_ending |= self.free_bytes() < LEAST_FREE_BYTES / 2;
                }
            }
            if is_ending {
                interrupt(&child);
                let ended = timeout(END_PATIENCE, child.wait()).await;
                break ended.map_err(|_| {
                    io::Error::other("facewire record does not end; the recording may be incomplete")
                })??;
            }
        };
        let mut text = String::new();
        if let Some(errors) = &mut errors {
            errors.take(4096).read_to_string(&mut text).await?;
        }
        let last = text.lines().last().unwrap_or_default();
        if status.success() { Ok(()) } else { Err(io::Error::other(last.trim_start_matches("facewire: ").to_owned())) }
    }

    /// Plays a recording through the links: its rows become movements of a drive.
    pub fn play(
        &self,
        program: &Program,
        settings: &Path,
        name: &str,
        servos: Servos,
        drive: Token,
    ) -> Result<(), Refusal> {
        let path = self.path(name)?;
        let end = self.enter("playing", name.to_owned())?;
        let child = program
            .command(&["track", &path.to_string_lossy(), "--config", &settings.to_string_lossy()])
            .stderr(Stdio::null())
            .spawn();
        let recordings = self.clone();
        tokio::spawn(async move {
            let drive = drive.to_string();
            let trouble = match child {
                Ok(child) => {
                    recordings.tell(None);
                    select! {
                        played = play(child, &servos, &drive) => played.err(),
                        () = end.notified() => None,
                    }
                }
                Err(error) => Some(error),
            };
            servos.disarm(&drive);
            *recordings.active() = None;
            recordings.tell(trouble.as_ref().map(ToString::to_string).as_deref());
        });
        Ok(())
    }

    /// Ends what goes on.
    pub fn end(&self) {
        if let Some(active) = &*self.active() {
            active.end.notify_one();
        }
    }
}

/// Asks a program to end, as Ctrl-C does.
fn interrupt(child: &Child) {
    if let Some(pid) = child.id().and_then(|pid| i32::try_from(pid).ok()) {
        let _ = kill(Pid::from_raw(pid), Signal::SIGINT);
    }
}

/// Reads the table of `facewire track`, and sends each row when it is due.
async fn play(mut child: Child, servos: &Servos, drive: &str) -> io::Result<()> {
    let damaged =
        || io::Error::other("the recording cannot be played: facewire track does not write the expected table");
    let mut lines = BufReader::new(child.stdout.take().ok_or_else(damaged)?).lines();
    let head = lines.next_line().await?.ok_or_else(damaged)?;
    let columns: Vec<&str> = head.split(',').collect();
    let begun = Instant::now();
    let mut first_s = None;
    while let Some(line) = lines.next_line().await? {
        let (time_s, movement) = movement(&columns, &line).ok_or_else(damaged)?;
        let due = begun + Duration::from_secs_f64((time_s - *first_s.get_or_insert(time_s)).clamp(0.0, 1e6));
        while due.saturating_duration_since(Instant::now()) > STILL_THERE {
            sleep(STILL_THERE).await;
            send(servos, drive, Drive::Alive {})?;
        }
        sleep_until(due).await;
        send(servos, drive, movement)?;
    }
    Ok(())
}

fn send(servos: &Servos, drive: &str, movement: Drive) -> io::Result<()> {
    servos.movement(drive, movement).map_err(|refusal| io::Error::other(refusal.sentence().to_owned()))
}

/// Reads a row: its time, and the face that it shows.
fn movement(columns: &[&str], line: &str) -> Option<(f64, Drive)> {
    let number = |name: &str| {
        let column = columns.iter().position(|column| *column == name)?;
        line.split(',').nth(column)?.parse::<f32>().ok()
    };
    let time_s = line.split(',').nth(1)?.parse().ok()?;
    let coefficients =
        BLENDSHAPES.iter().map(|name| Some(((*name).to_owned(), number(name)?))).collect::<Option<BTreeMap<_, _>>>();
    let angle = |name: &str| number(&format!("head_{name}_deg"));
    let head_deg = angle("yaw").zip(angle("pitch")).zip(angle("roll")).map(|((yaw, pitch), roll)| [yaw, pitch, roll]);
    let face = coefficients.zip(head_deg).map(|(coefficients, head_deg)| Drive::Puppet { coefficients, head_deg });
    Some((time_s, face.unwrap_or(Drive::Alive {})))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_of_track_becomes_a_movement() {
        let mut columns = vec!["frame", "time_s", "state"];
        columns.extend(BLENDSHAPES);
        columns.extend(["head_yaw_deg", "head_pitch_deg", "head_roll_deg", "head_x_mm"]);
        let cells = |value: &str| vec![value; columns.len() - 3].join(",");
        let (time_s, face) = movement(&columns, &format!("7,0.25,live,{}", cells("0.5"))).unwrap();
        let face = serde_json::to_value(face).unwrap();
        assert_eq!(
            (time_s, &face["coefficients"]["tongueOut"], &face["head_deg"]),
            (0.25, &json!(0.5), &json!([0.5, 0.5, 0.5]))
        );
        assert_eq!(face["coefficients"].as_object().unwrap().len(), 52);
        // A row without numbers keeps the drive alive and moves nothing.
        let (_, nothing) = movement(&columns, &format!("8,0.3,neutral,{}", cells(""))).unwrap();
        assert_eq!(serde_json::to_value(nothing).unwrap(), json!({}));
        assert!(movement(&columns, "no table").is_none());
    }
}
