//! The console of a service: everything below `api/1/` but the stream of events.

use std::{
    env, io,
    os::unix::fs::DirBuilderExt as _,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use facewire_packet::{Packet, control::Request};
use serde_json::{Value, json};
use tokio::{
    select,
    sync::{Mutex as AsyncMutex, Notify, Semaphore, watch},
    time::sleep,
};

use crate::{
    access::{Access, Role},
    args::Args,
    control::{Control, ControlError},
    program::Program,
    recordings::Recordings,
    servos::Servos,
    settings::{self, Fault, SettingsFile},
    snapshot::Sender,
    source::PacketCounter,
    status::{self, History, ROW_PERIOD_S},
    vrchat::Vrchat,
    web::Token,
};

/// Time between two looks at the service while a page is open. Without one the history decides.
const LOOK_PERIOD: Duration = Duration::from_secs(1);
/// Time between two attempts to reach a service that is away.
const RETRY: Duration = Duration::from_millis(500);

/// The most requests of one role that are answered at a time. The others wait, so that they take neither the processors nor the
/// service's attention away from a release.
const MOST_ANSWERS: usize = 4;

/// Limits how many requests of each role are answered at a time. Those who may only look delay no operator.
#[derive(Debug)]
pub struct Turns {
    look: Semaphore,
    operate: Semaphore,
}

impl Default for Turns {
    fn default() -> Self {
        Self { look: Semaphore::new(MOST_ANSWERS), operate: Semaphore::new(MOST_ANSWERS) }
    }
}

impl Turns {
    pub fn of(&self, role: Option<Role>) -> &Semaphore {
        if role == Some(Role::Operate) { &self.operate } else { &self.look }
    }
}

/// Values that the open pages are told of.
#[derive(Debug, Clone)]
pub struct News {
    pub status: watch::Sender<Value>,
    pub calibration: watch::Sender<Value>,
    pub recording: watch::Sender<Value>,
}

impl Default for News {
    fn default() -> Self {
        let [status, calibration, recording] = [(); 3].map(|()| watch::Sender::new(Value::Null));
        Self { status, calibration, recording }
    }
}

/// What a console works with.
#[derive(Debug)]
pub struct Console {
    pub access: Access,
    pub turns: Turns,
    pub control: Control,
    pub program: Program,
    pub settings: SettingsFile,
    /// Held while settings are compared and kept.
    pub keeping: AsyncMutex<()>,
    pub servos: Servos,
    pub recordings: Recordings,
    pub news: News,
    vrchat: Vrchat,
    pub history: Mutex<History>,
    /// When the next picture may be requested. Holding the lock limits scaling to one picture at a time.
    pub picturing: AsyncMutex<tokio::time::Instant>,
    /// Tells the calibration that goes on to end.
    pub calibrating: Mutex<Option<Arc<Notify>>>,
    /// The names of this machine in the settings.
    names: Mutex<Arc<[String]>>,
    /// The text of the settings that was judged last, and its faults.
    judged: AsyncMutex<Option<(String, Vec<Fault>)>>,
    /// The number of open pages.
    pub pages: watch::Sender<usize>,
    /// Something has changed that the status shows.
    pub changed: Notify,
}

impl Console {
    pub fn new(args: &Args, config: &Path, operate_token: Token) -> io::Result<Self> {
        let state = args.state.clone().unwrap_or_else(state_folder);
        std::fs::DirBuilder::new().recursive(true).mode(0o700).create(&state)?;
        let news = News::default();
        let settings = SettingsFile::new(std::path::absolute(config)?, &state);
        let names = Mutex::new(settings::names(&settings.text().unwrap_or_default()));
        Ok(Self {
            access: Access::load(&state, operate_token)?,
            turns: Turns::default(),
            control: Control::new(args.control.as_deref()),
            program: Program::new(args.helper.clone()),
            settings,
            keeping: AsyncMutex::default(),
            servos: Servos::default(),
            recordings: Recordings::new(&state, news.recording.clone()),
            news,
            vrchat: Vrchat::default(),
            history: Mutex::default(),
            picturing: AsyncMutex::new(tokio::time::Instant::now()),
            calibrating: Mutex::default(),
            names,
            judged: AsyncMutex::default(),
            pages: watch::Sender::new(0),
            changed: Notify::new(),
        })
    }

    /// The names of this machine in the settings, in lower case.
    pub fn names(&self) -> Arc<[String]> {
        Arc::clone(&self.names.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether the service keeps all servos released.
    pub async fn is_released(&self) -> bool {
        let status = self.control.status().await.unwrap_or_default();
        status.get("released").and_then(serde_json::Value::as_bool) == Some(true)
    }

    /// Has the service read the settings.
    pub async fn reload(&self) -> Result<String, ControlError> {
        let reloaded = self.control.tell(&Request::Reload {}).await;
        let is_refused = match &reloaded {
            Ok(_) => false,
            Err(ControlError::Refused(_)) => true,
            // A service that is away, or does not answer, has not judged them.
            Err(_) => return reloaded,
        };
        // Where the mark cannot be written, as on a full disk, these settings are offered again.
        let _ = self.settings.on_disk(move |file| file.mark(is_refused)).await;
        reloaded
    }

    /// Asks for the state of the service as long as the program runs, and publishes it.
    pub async fn watch_status(&self) {
        let period = Duration::from_secs(ROW_PERIOD_S);
        let mut row_due = Instant::now();
        let mut pages = self.pages.subscribe();
        loop {
            let (status, metrics) = self.look().await;
            if Instant::now() >= row_due {
                row_due = (row_due + period).max(Instant::now() + period / 2);
                let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                let mut history = self.history.lock().unwrap_or_else(PoisonError::into_inner);
                history.add(metrics.as_deref(), now.as_secs_f64(), status.get("board").unwrap_or(&Value::Null));
            }
            self.news.status.send_replace(status);
            let until_row = row_due.saturating_duration_since(Instant::now());
            let is_watched = *pages.borrow_and_update() > 0;
            select! {
                () = sleep(if is_watched { LOOK_PERIOD.min(until_row) } else { until_row }) => {}
                _ = pages.changed(), if !is_watched => {}
                () = self.changed.notified() => {}
            }
        }
    }

    /// Returns the status for the pages, and the metrics of the service if it runs.
    pub async fn look(&self) -> (Value, Option<String>) {
        let read = self.settings.on_disk(SettingsFile::read).await;
        let refused = match &read {
            Ok((_, Some(wrong))) => Ok(sentence(wrong)),
            Ok((text, None)) => {
                self.faults(text).await.map(|faults| faults.iter().map(sentence).collect::<Vec<_>>().join("\n"))
            }
            Err(error) => Err(io::Error::other(error.to_string())),
        };
        let text = read.map(|(text, _)| text);
        if let Ok(text) = &text {
            *self.names.lock().unwrap_or_else(PoisonError::into_inner) = settings::names(text);
        }
        let values = text.map_or(Value::Null, |text| settings::values(&text));
        let (service, away) = match self.control.status().await {
            Ok(service) => (service, None),
            Err(ControlError::Away) => {
                let why = self.control.why_away(&facewire_board::root(), &self.settings.path);
                (Value::Null, Some(why.to_string()))
            }
            Err(error) => (Value::Null, Some(error.to_string())),
        };
        let trouble = away.or_else(|| refused.as_ref().err().map(ToString::to_string));
        let mut status = json!({
            "running": service.is_object(),
            "trouble": trouble,
            "refused": refused.ok().filter(|faults| !faults.is_empty()),
            "picture": values.pointer("/console/picture") == Some(&true.into()),
            "operator": null,
            "service": service,
            "board": status::board(&facewire_board::root(), &values),
            "free_bytes": self.recordings.free_bytes(),
            "recording": self.recordings.state(),
        });
        let mut metrics = None;
        if let Some(service) = status.get_mut("service").and_then(Value::as_object_mut) {
            let text = service.get("metrics").and_then(Value::as_str).unwrap_or_default().to_owned();
            service.insert("metrics".to_owned(), status::samples(&text).into());
            metrics = Some(text);
            self.vrchat.add_to(service);
        }
        (status, metrics)
    }

    /// Returns the faults of settings, which are judged once.
    pub async fn faults(&self, text: &str) -> io::Result<Vec<Fault>> {
        let mut judged = self.judged.lock().await;
        if let Some((known, faults)) = &*judged
            && known == text
        {
            return Ok(faults.clone());
        }
        let faults = settings::faults(&self.program, text).await?;
        *judged = Some((text.to_owned(), faults.clone()));
        Ok(faults)
    }

    /// Looks for VRChat while a page is open and a link sends to it.
    pub async fn watch_vrchat(&self) {
        self.vrchat.watch(self.pages.subscribe(), self.news.status.subscribe()).await;
    }

    /// Passes the packets of the service on while a page is open.
    pub async fn watch_face(&self, mut counter: PacketCounter) {
        let mut pages = self.pages.subscribe();
        loop {
            // The sender lives as long as this.
            let _ = pages.wait_for(|pages| *pages > 0).await;
            let trouble = select! {
                error = self.follow(&mut counter) => Some(error.to_string()),
                _ = pages.wait_for(|pages| *pages == 0) => None,
            };
            if let Some(trouble) = trouble {
                counter.tell(Some(&trouble));
                sleep(RETRY).await;
            }
        }
    }

    async fn follow(&self, counter: &mut PacketCounter) -> ControlError {
        let mut connection = match self.control.open(&Request::Watch {}).await {
            Ok(connection) => connection,
            Err(error) => return error,
        };
        counter.tell(None);
        loop {
            let line = match connection.next().await {
                Ok(Some(line)) => line,
                Ok(None) => return ControlError::Away,
                Err(error) => return error,
            };
            let bytes = line.get("packet").and_then(Value::as_str).and_then(|text| BASE64_STANDARD.decode(text).ok());
            counter.take(Packet::decode(&bytes.unwrap_or_default()), Sender::Service);
        }
    }
}

/// Says what is wrong and where.
pub fn sentence(fault: &Fault) -> String {
    fault.line.map_or_else(|| fault.text.clone(), |line| format!("line {line}: {}", fault.text))
}

fn state_folder() -> PathBuf {
    let of_unit = env::var_os("STATE_DIRECTORY").map(PathBuf::from);
    let of_user = || env::var_os("XDG_STATE_HOME").map(|folder| Path::new(&folder).join("facewire-console"));
    let of_home = || env::var_os("HOME").map(|folder| Path::new(&folder).join(".local/state/facewire-console"));
    of_unit.or_else(of_user).or_else(of_home).unwrap_or_else(|| PathBuf::from("facewire-console"))
}
