//! Driving servos: one operator at a time holds a connection to the service, which ends when no line comes for
//! [`WATCHDOG`].

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use facewire_packet::control::{Drive, Request};
use hyper::StatusCode;
use serde_json::{Value, json};
use tokio::{sync::mpsc, time::timeout};

use crate::{
    access::Caller,
    control::{Connection, Control},
    web::{Refusal, Token},
};

/// The page sends a line every 150 ms.
const WATCHDOG: Duration = Duration::from_millis(400);
/// Lines that wait for the service.
const MOST_LINES: usize = 16;

const NOT_ARMED: Refusal =
    Refusal::fixed(StatusCode::CONFLICT, "The servos are not armed by this page any more. Arm them again.\n");
const BEHIND: Refusal =
    Refusal::fixed(StatusCode::SERVICE_UNAVAILABLE, "The service takes no more movements. Look at its log.\n");

#[derive(Debug)]
struct Session {
    id: Token,
    operator: Caller,
    lines: mpsc::Sender<Drive>,
}

/// Who drives, if anybody does.
#[derive(Debug, Clone, Default)]
pub struct Servos {
    drive: Arc<Mutex<Option<Session>>>,
}

impl Servos {
    fn drive(&self) -> MutexGuard<'_, Option<Session>> {
        self.drive.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the operator as this caller sees them.
    pub fn operator(&self, caller: &Caller) -> Value {
        self.drive().as_ref().map_or(
            Value::Null,
            |Session { operator, .. }| json!({"name": operator.address.to_string(), "me": operator.is(caller)}),
        )
    }

    /// Refuses whoever is not the operator, while there is one.
    pub fn must_be_free_for(&self, caller: &Caller) -> Result<(), Refusal> {
        match &*self.drive() {
            Some(Session { operator, .. }) if !operator.is(caller) => {
                Err(occupied(operator, "Until they let go you may look, and press STOP."))
            }
            _ => Ok(()),
        }
    }

    /// Opens a session with the service, and returns its name. The servo boards that it does not move stay still, or follow the
    /// face. Refused while somebody else has one.
    pub async fn arm(&self, control: &Control, caller: &Caller, others_follow: bool) -> Result<Token, Refusal> {
        let id = Token::random().map_err(|error| Refusal::failed(&error))?;
        let (lines, waiting) = mpsc::channel(MOST_LINES);
        match &mut *self.drive() {
            Some(Session { operator, .. }) => {
                return Err(occupied(operator, "Wait until they are let go, or press STOP."));
            }
            // Taken before the service answers, so that two who arm at the same moment do not both ask.
            empty => *empty = Some(Session { id: id.clone(), operator: caller.clone(), lines }),
        }
        let ended = Ended { servos: self.clone(), id: id.clone() };
        let mut connection = control.open(&Request::Drive { others_follow }).await?;
        connection.reply().await?;
        tokio::spawn(async move {
            drive(connection, waiting).await;
            drop(ended);
        });
        Ok(id)
    }

    /// Hands a movement over to the service, which limits it.
    pub fn movement(&self, id: &str, movement: Drive) -> Result<(), Refusal> {
        let drive = self.drive();
        let lines = &drive.as_ref().filter(|drive| drive.id.is(id)).ok_or(NOT_ARMED)?.lines;
        lines.try_send(movement).map_err(|_| BEHIND)
    }

    /// Ends whichever session there is.
    pub fn end(&self) {
        self.drive().take();
    }

    /// Ends the session of this operator.
    pub fn end_of(&self, caller: &Caller) {
        self.drive().take_if(|drive| drive.operator.is(caller));
    }

    /// Ends a session. One that has ended before is no fault.
    pub fn disarm(&self, id: &str) {
        self.drive().take_if(|drive| drive.id.is(id));
    }
}

fn occupied(operator: &Caller, advice: &str) -> Refusal {
    Refusal::new(StatusCode::CONFLICT, format!("{} moves the servos. {advice}\n", operator.address))
}

/// Makes room for the next operator, however a session ends.
struct Ended {
    servos: Servos,
    id: Token,
}

impl Drop for Ended {
    fn drop(&mut self) {
        self.servos.drive().take_if(|drive| drive.id.is(&self.id.to_string()));
    }
}

/// Passes lines on until none comes for too long, the operator disarms, or the service ends.
async fn drive(mut connection: Connection, mut lines: mpsc::Receiver<Drive>) {
    while let Ok(Some(line)) = timeout(WATCHDOG, lines.recv()).await {
        let sent = timeout(WATCHDOG, connection.send(&line)).await;
        if !matches!(sent, Ok(Ok(()))) {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use facewire_packet::control::{Drive, Request};
    use tokio::{
        io::{AsyncBufReadExt as _, BufReader},
        net::UnixListener,
        sync::mpsc,
        time::{Instant, sleep},
    };

    use super::{MOST_LINES, WATCHDOG, drive};
    use crate::control::Control;

    /// The clock goes on only when everybody waits for it.
    #[tokio::test(start_paused = true)]
    async fn a_drive_goes_on_while_lines_come_and_ends_400_ms_after_the_last_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        let listener = UnixListener::bind(&path).unwrap();
        let connection = Control::new(Some(&path)).open(&Request::Drive { others_follow: false }).await.unwrap();
        let (service, _) = listener.accept().await.unwrap();
        let (lines, waiting) = mpsc::channel(MOST_LINES);
        let begun = Instant::now();
        let driving = tokio::spawn(async move {
            drive(connection, waiting).await;
            begun.elapsed()
        });
        let almost = WATCHDOG - Duration::from_millis(1);
        for _ in 0..8 {
            sleep(almost).await;
            lines.send(Drive::Alive {}).await.unwrap();
        }
        assert_eq!(driving.await.unwrap(), 8 * almost + Duration::from_millis(400));
        let mut passed_on = BufReader::new(service).lines();
        let mut count = 0;
        while passed_on.next_line().await.unwrap().is_some() {
            count += 1;
        }
        assert_eq!(count, 1 + 8, "the request and its lines");
    }

    #[tokio::test(start_paused = true)]
    async fn a_drive_ends_at_once_when_its_operator_lets_go() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        let _listener = UnixListener::bind(&path).unwrap();
        let connection = Control::new(Some(&path)).open(&Request::Drive { others_follow: false }).await.unwrap();
        let (lines, waiting) = mpsc::channel(MOST_LINES);
        drop(lines);
        let begun = Instant::now();
        drive(connection, waiting).await;
        assert_eq!(begun.elapsed(), Duration::ZERO);
    }
}
