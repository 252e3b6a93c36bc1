//! The interface below `api/1/`: JSON in both directions. README.md describes it.

use std::{
    sync::{Arc, PoisonError},
    time::Duration,
};

use facewire_packet::control::{Drive, Request as Command};
use http_body_util::{BodyExt as _, Full, Limited, channel::Channel};
use hyper::{
    HeaderMap, Method, Request, Response, StatusCode,
    body::{Bytes, Incoming},
    header::{CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_TYPE, HeaderValue, SET_COOKIE},
};
use serde::{Deserialize, de::DeserializeOwned};
use serde_json::{Map, Value, json};
use tokio::{
    io::AsyncReadExt as _,
    select,
    sync::Notify,
    time::{Instant, sleep_until, timeout},
};

use crate::{
    access::{Caller, Role, Secret},
    console::{Console, sentence},
    control::ControlError,
    files::on_another_thread,
    report,
    settings::{self, Fault, SettingsFile},
    web::{Answer, Body, Refusal},
};

/// Time in which a client must send the body of a request.
const BODY_PATIENCE: Duration = Duration::from_secs(10);
const MOST_BODY_BYTES: usize = 8 * 1024;
/// Texts of settings come in JSON, in which a line break has two bytes.
const MOST_SETTINGS_BODY_BYTES: usize = 2 * settings::MOST_BYTES;
/// Least time between two pictures for all pages together, which keeps the console below a twentieth of a core.
const PICTURE_PERIOD: Duration = Duration::from_millis(150);
const DOWNLOAD_BYTES: usize = 16 * 1024;

const NO_SERVICE: Refusal = Refusal::fixed(
    StatusCode::NOT_FOUND,
    "This program shows packets and operates no service. Start it with --config to operate one.\n",
);
const NOT_JSON: Refusal =
    Refusal::fixed(StatusCode::UNSUPPORTED_MEDIA_TYPE, "Send JSON, with Content-Type: application/json.\n");
const TOO_LONG: Refusal =
    Refusal::fixed(StatusCode::PAYLOAD_TOO_LARGE, "The request is too long, or comes too slowly.\n");
const CHANGED: Refusal = Refusal::fixed(
    StatusCode::CONFLICT,
    "Somebody else has changed the settings meanwhile. Load them again and repeat your changes.\n",
);
const NO_HELPER: Refusal = Refusal::fixed(
    StatusCode::CONFLICT,
    "The console may not start the service here, because its helper is not installed. Start the service in a terminal.\n",
);
const CALIBRATING: Refusal =
    Refusal::fixed(StatusCode::CONFLICT, "A calibration is in progress. Wait until it ends, or cancel it.\n");

/// What is open to all operators while one of them moves servos: to judge and edit a draft, to log in and out, and to press
/// STOP. `servos/drive` and `servos/disarm` need the token that only the driving operator has.
const OPEN_WHILE_ANOTHER_DRIVES: [&str; 7] =
    ["login", "logout", "settings/check", "settings/edit", "servos/release", "servos/drive", "servos/disarm"];

/// A body that must be an empty object.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nothing {}

/// Declares the bodies of requests.
macro_rules! bodies {
    ($($name:ident { $($field:ident: $kind:ty),* })*) => {
        $(#[derive(Deserialize)] #[serde(deny_unknown_fields)] struct $name { $($field: $kind),* })*
    };
}

bodies! {
    Password { new: String, old: Option<String> }
    Text { text: String }
    Edit { text: String, changes: Map<String, Value> }
    Keep { text: String, base: String }
    Version { id: String }
    Wearer { wearer: Option<String> }
    Name { name: Option<String> }
    File { name: String }
    Release { on: bool }
    Arm { others_follow: Option<bool> }
    Disarm { drive: String }
    Service { r#do: String }
}

/// Answers a request to a console of packets, which has no service.
pub fn answer_of_packets(path: &str) -> Answer {
    let session = json!({"role": Role::Look, "needs_password": false, "secure": false, "local": false});
    if path == "session" { Ok(ok(&session)) } else { Err(NO_SERVICE) }
}

/// Lets go of all servos, or lets them move again. It waits for nothing that other requests hold.
pub async fn release(console: &Arc<Console>, caller: &Caller, request: Request<Incoming>) -> Answer {
    let (parts, body) = request.into_parts();
    let call = Call { console, caller, path: "servos/release", headers: &parts.headers };
    call.may_change()?;
    let Release { on } = Json { call: &call, body, most_bytes: MOST_BODY_BYTES }.read().await?;
    // Whoever lets servos move again does not find them where somebody's slider wants them.
    if on {
        console.servos.end();
    } else {
        console.servos.must_be_free_for(caller)?;
    }
    let done = console.control.release(on).await?;
    console.changed.notify_one();
    Ok(ok(&json!({"done": done})))
}

/// Begins a session. `is_read` is called when the request has come as a whole.
pub async fn log_in(
    console: &Arc<Console>,
    caller: &Caller,
    request: Request<Incoming>,
    is_read: impl Fn() + Send,
) -> Answer {
    let (parts, body) = request.into_parts();
    let call = Call { console, caller, path: "login", headers: &parts.headers };
    let secret = Json { call: &call, body, most_bytes: MOST_BODY_BYTES }.read::<Secret>().await?;
    is_read();
    changed_session(&console.access.log_in(caller, &secret).await?, caller)
}

/// Answers a request of somebody who may send it. `path` is the part below `api/1/`.
pub async fn answer(console: &Arc<Console>, caller: &Caller, path: &str, request: Request<Incoming>) -> Answer {
    let (parts, body) = request.into_parts();
    let call = Call { console, caller, path, headers: &parts.headers };
    if parts.method == Method::POST {
        call.may_change()?;
        call.post(body).await
    } else {
        call.may_look()?;
        let answer = call.get(parts.uri.query()).await;
        // The session may have ended while the answer was made.
        call.may_look()?;
        answer
    }
}

struct Call<'a> {
    console: &'a Arc<Console>,
    caller: &'a Caller,
    /// The part below `api/1/`.
    path: &'a str,
    headers: &'a HeaderMap,
}

impl Call<'_> {
    /// Refuses a GET that the caller may not send now.
    fn may_look(&self) -> Result<(), Refusal> {
        if self.path == "session" { Ok(()) } else { self.console.access.must(self.caller, Role::Look) }
    }

    /// Refuses a POST that the caller may not send now.
    fn may_change(&self) -> Result<(), Refusal> {
        may_change(self.console, self.caller, self.path)
    }

    async fn get(&self, query: Option<&str>) -> Answer {
        let Self { console, caller, path, .. } = *self;
        let _turn = match path {
            "session" => None,
            _ => Some(console.turns.of(console.access.role(caller)).acquire().await),
        };
        Ok(ok(&match path {
            "session" => return self.session(),
            "status" => self.status().await,
            "settings" => match query.and_then(|query| query.strip_prefix("version=")) {
                Some(id) => json!({"text": self.old_text(id.to_owned()).await?}),
                None => self.settings().await?,
            },
            "wearers" => {
                let mut reply = console.control.ask(&Command::List {}).await?;
                reply.get_mut("wearers").map(Value::take).unwrap_or_default()
            }
            "recordings" => {
                let recordings = console.recordings.clone();
                let list = on_another_thread(move || recordings.list()).await?;
                json!({"list": list, "free_bytes": console.recordings.free_bytes()})
            }
            "history" => console.history.lock().unwrap_or_else(PoisonError::into_inner).to_json(),
            "devices" => {
                let text = match console.program.ask_helper("devices").await {
                    Some(text) => text?,
                    None => console.program.run(&["devices", "--json"], "").await?.out,
                };
                serde_json::from_str(&text).map_err(|_| {
                    Refusal::fixed(StatusCode::BAD_GATEWAY, "facewire devices lists nothing: update both programs.\n")
                })?
            }
            "picture" => return self.picture().await,
            "landmarks" => crate::picture::landmarks(&console.control).await?,
            "log" => json!({"lines": report::log_lines().await?}),
            "report" => {
                let text = report::write(console).await;
                return Ok(response("text/plain; charset=utf-8", text.into()));
            }
            _ => {
                let name = path.strip_prefix("recordings/").ok_or(Refusal::NOT_FOUND)?;
                return self.download(name).await;
            }
        }))
    }

    async fn post(&self, body: Incoming) -> Answer {
        let Self { console, caller, path, headers } = *self;
        let (control, recordings) = (&console.control, &console.recordings);
        let most_bytes = if path.starts_with("settings/") { MOST_SETTINGS_BODY_BYTES } else { MOST_BODY_BYTES };
        let body = Json { call: self, body, most_bytes };
        let done = match path {
            "logout" => {
                body.read::<Nothing>().await?;
                console.servos.end_of(caller);
                return changed_session(&[console.access.log_out(headers)], caller);
            }
            "password" => {
                let Password { new, old } = body.read().await?;
                let cookie = console.access.set_password(caller, new, old.as_deref()).await?;
                console.servos.end();
                return changed_session(&[cookie], caller);
            }
            "tokens/look" => {
                body.read::<Nothing>().await?;
                return Ok(ok(&json!({"token": console.access.make_look_token().await?})));
            }
            "settings/check" => {
                let Text { text } = body.read().await?;
                let changed = settings::changed(&console.settings.on_disk(SettingsFile::text).await?, &text);
                let faults = console.faults(&text).await?;
                return Ok(ok(&json!({"faults": faults, "changed": changed, "values": settings::values(&text)})));
            }
            "settings/edit" => {
                let Edit { text, changes } = body.read().await?;
                let text = settings::edit(&text, &changes)
                    .map_err(|sentence| Refusal::new(StatusCode::BAD_REQUEST, sentence + ".\n"))?;
                return Ok(ok(&json!({"text": text, "values": settings::values(&text)})));
            }
            "settings/keep" => {
                let Keep { text, base } = body.read().await?;
                return self.keep(text, Some(base)).await;
            }
            "settings/restore" => {
                let Version { id } = body.read().await?;
                return self.keep(self.old_text(id).await?, None).await;
            }
            "settings/reload" => {
                body.read::<Nothing>().await?;
                console.reload().await?
            }
            "wearers/use" => control.tell(&Command::Use { wearer: body.read::<Name>().await?.name }).await?,
            "wearers/delete" => control.tell(&Command::Delete { wearer: body.read::<File>().await?.name }).await?,
            "calibration/begin" => self.calibrate(body.read::<Wearer>().await?.wearer).await?,
            "calibration/cancel" => {
                body.read::<Nothing>().await?;
                console
                    .calibrating
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .iter()
                    .for_each(|end| end.notify_one());
                "the calibration is cancelled".to_owned()
            }
            "servos/arm" => {
                let Arm { others_follow } = body.read().await?;
                let drive = console.servos.arm(control, caller, others_follow.unwrap_or(false)).await?;
                console.changed.notify_one();
                return Ok(ok(&json!({"drive": drive})));
            }
            "servos/drive" => {
                let mut line = body.read::<Map<String, Value>>().await?;
                let drive = line.remove("drive").unwrap_or_default();
                let movement = Drive::deserialize(Value::Object(line)).map_err(|error| bad(&error))?;
                console.servos.movement(drive.as_str().unwrap_or_default(), movement)?;
                String::new()
            }
            "servos/disarm" => {
                console.servos.disarm(&body.read::<Disarm>().await?.drive);
                "the servos follow the face again".to_owned()
            }
            "recordings/begin" => {
                body.read::<Nothing>().await?;
                return Ok(ok(&json!({"name": recordings.begin(&console.program)?})));
            }
            "recordings/end" => {
                body.read::<Nothing>().await?;
                recordings.end();
                "the recording ends".to_owned()
            }
            "recordings/delete" => {
                let (recordings, name) = (recordings.clone(), body.read::<File>().await?.name);
                on_another_thread(move || Ok(recordings.delete(&name))).await??;
                "the recording is deleted".to_owned()
            }
            "recordings/play" => {
                let File { name } = body.read().await?;
                recordings.path(&name)?;
                let drive = console.servos.arm(control, caller, false).await?;
                let played = recordings.play(
                    &console.program,
                    &console.settings.path,
                    &name,
                    console.servos.clone(),
                    drive.clone(),
                );
                played.inspect_err(|_| console.servos.disarm(&drive.to_string()))?;
                format!("{name} is played")
            }
            "check" => {
                body.read::<Nothing>().await?;
                return Ok(ok(&json!({"lines": self.check().await?})));
            }
            "service" => self.service(&body.read::<Service>().await?.r#do).await?,
            _ => return Err(Refusal::NOT_FOUND),
        };
        if path != "servos/drive" {
            console.changed.notify_one();
        }
        Ok(ok(&json!({"done": done})))
    }

    /// Returns the role, and gives a browser on this machine a cookie, so that several through one tunnel are distinguished.
    fn session(&self) -> Answer {
        let Self { console, caller, .. } = *self;
        let session = ok(&json!({
            "role": console.access.role(caller),
            "needs_password": console.access.needs_password(),
            "secure": caller.is_local || caller.is_encrypted,
            "local": caller.is_local,
        }));
        match caller.name()? {
            Some(cookie) => with_cookies(session, &[cookie], caller),
            None => Ok(session),
        }
    }

    async fn status(&self) -> Value {
        let mut status = self.console.look().await.0;
        if let Some(operator) = status.get_mut("operator") {
            *operator = self.console.servos.operator(self.caller);
        }
        status
    }

    async fn settings(&self) -> Result<Value, Refusal> {
        let console = self.console;
        let ((text, wrong), versions) =
            console.settings.on_disk(|file| Ok((file.read()?, file.old_versions()?))).await?;
        let mut faults = console.faults(&text).await?;
        faults.splice(..0, wrong);
        let schema = console.program.run(&["defaults", "--schema"], "").await?;
        let schema: Value = serde_json::from_str(&schema.out).unwrap_or_default();
        Ok(json!({
            "path": console.settings.path,
            "text": text,
            "hash": settings::hash(&text),
            "values": settings::values(&text),
            "schema": schema,
            "faults": faults,
            "versions": versions,
        }))
    }

    async fn old_text(&self, id: String) -> Result<String, Refusal> {
        let found = self.console.settings.on_disk(move |file| file.old_text(&id)).await?;
        found.ok_or(Refusal::NOT_FOUND)
    }

    /// Keeps settings without a fault, and has the service read them. `base` is the hash of the text that they change.
    async fn keep(&self, text: String, base: Option<String>) -> Answer {
        let (console, caller, path) = (Arc::clone(self.console), self.caller.clone(), self.path.to_owned());
        // Goes on if the page is closed, so that the service reads what is kept.
        let kept = tokio::spawn(async move { keep(&console, &caller, &path, text, base).await });
        kept.await.map_err(|error| Refusal::failed(&error))?
    }

    /// Begins a calibration, whose progress the open pages are told of.
    async fn calibrate(&self, wearer: Option<String>) -> Result<String, Refusal> {
        let console = Arc::clone(self.console);
        let end = Arc::<Notify>::default();
        {
            let mut calibrating = console.calibrating.lock().unwrap_or_else(PoisonError::into_inner);
            if calibrating.is_some() {
                return Err(CALIBRATING);
            }
            *calibrating = Some(Arc::clone(&end));
        }
        let opened = console.control.open(&Command::Calibrate { wearer }).await;
        let free = |console: &Console| *console.calibrating.lock().unwrap_or_else(PoisonError::into_inner) = None;
        let mut connection = opened.inspect_err(|_| free(&console))?;
        tokio::spawn(async move {
            let publish = &console.news.calibration;
            loop {
                let line = select! {
                    line = connection.next() => line,
                    () = end.notified() => Err(ControlError::Refused("the calibration was cancelled".to_owned())),
                };
                match line {
                    Ok(Some(line)) => drop(publish.send_replace(line)),
                    // The last line says how the calibration has ended.
                    Ok(None) => break,
                    Err(error) => {
                        publish.send_replace(json!({"refused": error.to_string()}));
                        break;
                    }
                }
            }
            free(&console);
            console.changed.notify_one();
        });
        Ok("the calibration begins".to_owned())
    }

    async fn picture(&self) -> Answer {
        let mut due = self.console.picturing.lock().await;
        sleep_until(*due).await;
        *due = Instant::now() + PICTURE_PERIOD;
        let picture = crate::picture::newest(&self.console.control).await?;
        Ok(response("application/octet-stream", picture.into()))
    }

    async fn download(&self, name: &str) -> Answer {
        let path = self.console.recordings.path(name)?;
        let file = std::fs::File::open(path)?;
        let length = file.metadata()?.len();
        let (mut sender, body) = Channel::new(1);
        let (console, caller) = (Arc::clone(self.console), self.caller.clone());
        tokio::spawn(async move {
            let mut reader = tokio::fs::File::from_std(file).take(length);
            let mut bytes = vec![0; DOWNLOAD_BYTES];
            while let Ok(count @ 1..) = reader.read(&mut bytes).await {
                if console.access.must(&caller, Role::Look).is_err() {
                    return;
                }
                let part = bytes.get(..count).unwrap_or_default();
                if sender.send_data(Bytes::copy_from_slice(part)).await.is_err() {
                    return;
                }
            }
        });
        let mut response = Response::new(body.boxed());
        let headers = response.headers_mut();
        headers.insert(CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
        headers.insert(CONTENT_LENGTH, length.into());
        let disposition = HeaderValue::try_from(format!("attachment; filename=\"{name}\""));
        headers.insert(CONTENT_DISPOSITION, disposition.map_err(|error| Refusal::failed(&error))?);
        Ok(response)
    }

    async fn check(&self) -> Result<Vec<Value>, Refusal> {
        let console = self.console;
        let text = match console.program.ask_helper("check").await {
            Some(text) => text?,
            None => {
                let output =
                    console.program.run(&["check", "--config", &console.settings.path.to_string_lossy()], "").await?;
                output.out + &output.err
            }
        };
        Ok(text.lines().map(|line| json!({"level": level(line), "text": line})).collect())
    }

    async fn service(&self, what: &str) -> Result<String, Refusal> {
        if !matches!(what, "start" | "stop") {
            return Err(Refusal::fixed(StatusCode::BAD_REQUEST, "Give start or stop.\n"));
        }
        let text = self.console.program.ask_helper(what).await.ok_or(NO_HELPER)??;
        let text = text.trim();
        text.strip_prefix("done: ").map(str::to_owned).ok_or_else(|| Refusal::failed(&text))
    }
}

/// Refuses a change that the caller may not make now. It is asked again whenever time has passed, because sessions end, and
/// somebody else may have begun to move servos.
fn may_change(console: &Console, caller: &Caller, path: &str) -> Result<(), Refusal> {
    let is_open = matches!(path, "login" | "logout" | "password");
    if !is_open {
        console.access.must(caller, Role::Operate)?;
    }
    // Whoever has no session yet may only begin one, and does not learn who drives.
    if console.access.role(caller).is_some() && !OPEN_WHILE_ANOTHER_DRIVES.contains(&path) {
        console.servos.must_be_free_for(caller)?;
    }
    Ok(())
}

async fn keep(console: &Console, caller: &Caller, path: &str, text: String, base: Option<String>) -> Answer {
    if text.len() > settings::MOST_BYTES {
        return Err(TOO_LONG);
    }
    let faults = console.faults(&text).await?;
    if let Some(first) = faults.first() {
        return Ok(refused(first, &faults));
    }
    let _turn = console.keeping.lock().await;
    may_change(console, caller, path)?;
    let former = console.settings.on_disk(SettingsFile::text).await.unwrap_or_default();
    if base.is_some_and(|base| base != settings::hash(&former)) {
        return Err(CHANGED);
    }
    if let Some(key) = settings::changed_code(&former, &text) {
        let sentence = format!(
            "{key} says which library the service loads, so the console does not change it: edit {} on the board.\n",
            console.settings.path.display()
        );
        return Err(Refusal::new(StatusCode::FORBIDDEN, sentence));
    }
    // As soon as a new servo gets pulses, it moves to a position that nobody has tried.
    let mut about_new_servo = "";
    if settings::adds_a_servo(&former, &text) {
        about_new_servo = match console.control.release(true).await {
            Ok(_) => ". A servo is new: all servos are released until you let them move again",
            // A service that is away moves nothing.
            Err(ControlError::Away) => ". A servo is new: it moves as soon as the service starts",
            // A board that was not reached obeys as soon as it is reached.
            Err(ControlError::Refused(_)) if console.is_released().await => {
                ". A servo is new: all servos that are reached are released until you let them move again"
            }
            Err(error) => {
                let sentence = format!(
                    "A servo is new, but the service did not release the servos, so nothing is kept: {error}.\n"
                );
                return Err(Refusal::new(StatusCode::CONFLICT, sentence));
            }
        };
    }
    let new = text.clone();
    console.settings.on_disk(move |file| file.keep(&new)).await?;
    let done = match console.reload().await {
        Ok(done) => done,
        Err(ControlError::Away) => "the settings are kept for the next start of the service".to_owned(),
        Err(error) => format!("the settings are kept, but the service goes on with the former ones: {error}"),
    };
    let done = done + about_new_servo;
    console.changed.notify_one();
    Ok(ok(&json!({"done": done, "text": text, "hash": settings::hash(&text), "values": settings::values(&text)})))
}

/// The level of a line of `facewire check`.
fn level(line: &str) -> &'static str {
    match line.split_once(' ').map_or("", |(_, rest)| rest.trim_start()) {
        rest if rest.starts_with("ok") => "ok",
        rest if rest.starts_with("POOR:") || rest.starts_with("NOTE:") => "warning",
        _ => "failure",
    }
}

/// The body of a request that has not been read yet.
struct Json<'a> {
    call: &'a Call<'a>,
    body: Incoming,
    most_bytes: usize,
}

impl Json<'_> {
    async fn read<T: DeserializeOwned + Sized>(self) -> Result<T, Refusal> {
        // A page of somebody else cannot send this type without being asked first whether it may.
        let kind = self.call.headers.get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
        if kind.split(';').next().map(str::trim) != Some("application/json") {
            return Err(NOT_JSON);
        }
        let body = Limited::new(self.body, self.most_bytes).collect();
        let body = timeout(BODY_PATIENCE, body).await.map_err(|_| TOO_LONG)?.map_err(|_| TOO_LONG)?;
        self.call.may_change()?;
        serde_json::from_slice(&body.to_bytes()).map_err(|error| bad(&error))
    }
}

fn bad(error: &serde_json::Error) -> Refusal {
    Refusal::new(StatusCode::BAD_REQUEST, format!("The request is not understood: {error}.\n"))
}

fn response(kind: &'static str, bytes: Bytes) -> Response<Body> {
    let mut response = Response::new(Full::new(bytes).boxed());
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

fn ok(value: &Value) -> Response<Body> {
    response("application/json", value.to_string().into())
}

fn refused(first: &Fault, faults: &[Fault]) -> Response<Body> {
    let mut response = ok(&json!({"error": sentence(first), "faults": faults}));
    *response.status_mut() = StatusCode::UNPROCESSABLE_ENTITY;
    response
}

fn changed_session(cookies: &[String], caller: &Caller) -> Answer {
    with_cookies(ok(&json!({"done": "the session is changed"})), cookies, caller)
}

/// Has the browser keep cookies, and send those that came encrypted in no other way.
fn with_cookies(mut response: Response<Body>, cookies: &[String], caller: &Caller) -> Answer {
    for cookie in cookies {
        let cookie = format!("{cookie}{}", if caller.is_encrypted { "; Secure" } else { "" });
        let cookie = HeaderValue::try_from(cookie).map_err(|error| Refusal::failed(&error))?;
        response.headers_mut().append(SET_COOKIE, cookie);
    }
    Ok(response)
}

impl From<ControlError> for Refusal {
    fn from(error: ControlError) -> Self {
        let status = match error {
            ControlError::Refused(_) => StatusCode::CONFLICT,
            ControlError::Away | ControlError::Unreached { .. } | ControlError::Forbidden => {
                StatusCode::SERVICE_UNAVAILABLE
            }
            ControlError::Silent(_) => StatusCode::GATEWAY_TIMEOUT,
        };
        Self::new(status, format!("{error}\n"))
    }
}

impl From<std::io::Error> for Refusal {
    fn from(error: std::io::Error) -> Self {
        Self::failed(&error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lines_of_check_have_levels() {
        for (line, want) in [
            ("settings  ok", "ok"),
            ("camera    ok: demo", "ok"),
            ("camera    POOR: too dark", "warning"),
            ("settings  NOTE: channel 3 can leave its range", "warning"),
            ("link      FAILED: no port", "failure"),
            ("facewire: settings are bad", "failure"),
        ] {
            assert_eq!(level(line), want, "{line}");
        }
    }
}
