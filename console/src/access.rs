//! Who may do what: a password, tokens, sessions, and a limit to wrong tries.
//!
//! A client on this machine needs nothing. Any other one needs a session, which a password or a token begins and which ends
//! after [`SESSION`]. The first password can be set by whoever comes first.

use std::{
    collections::HashMap,
    fs, io,
    net::{IpAddr, Ipv6Addr},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use argon2::{
    Algorithm, Argon2, Params, Version,
    password_hash::{PasswordHash, PasswordHasher as _, PasswordVerifier as _, SaltString},
};
use hyper::{HeaderMap, StatusCode, header::COOKIE};
use serde::{Deserialize, Serialize};
use tokio::{
    sync::{Mutex as AsyncMutex, Semaphore},
    task::spawn_blocking,
};

use crate::{
    files::{on_another_thread, write_atomically},
    web::{Refusal, Token},
};

const COOKIE_NAME: &str = "facewire-console";
/// How long a session lasts.
pub const SESSION: Duration = Duration::from_hours(12);
/// The most sessions at a time. The oldest one makes room for a new one.
const MOST_SESSIONS: usize = 32;
/// Wrong tries from one address that nobody minds, within this time.
const FREE_TRIES: u32 = 5;
const TRY_WINDOW: Duration = Duration::from_mins(1);
/// The longest wait after wrong tries. It doubles with each further one.
const LONGEST_WAIT: Duration = Duration::from_hours(1);
/// The most addresses whose tries are counted.
const MOST_ADDRESSES: usize = 256;
const PASSWORD_LENGTH: std::ops::RangeInclusive<usize> = 8..=128;
/// The memory and the passes of Argon2id. They take 0.1 s on a PC, and fit into the memory of this program.
const HASH_KB: u32 = 4096;
const HASH_PASSES: u32 = 6;

const WRONG: Refusal = Refusal::fixed(StatusCode::FORBIDDEN, "The password or the token is wrong.\n");
const LOG_IN: Refusal = Refusal::fixed(StatusCode::UNAUTHORIZED, "Log in first: POST the password to api/1/login.\n");
const LOOK_ONLY: Refusal = Refusal::fixed(StatusCode::FORBIDDEN, "This session may look and change nothing. Log in.\n");

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    Look,
    Operate,
}

/// Who sends a request.
#[derive(Debug, Clone)]
pub struct Caller {
    pub address: IpAddr,
    pub role: Option<Role>,
    /// The session, or the address if there is none. Tells two operators apart.
    pub identity: String,
}

impl Caller {
    /// Refuses a caller with a lesser role.
    pub fn must(&self, role: Role) -> Result<(), Refusal> {
        match self.role {
            Some(own) if own >= role => Ok(()),
            Some(_) => Err(LOOK_ONLY),
            None => Err(LOG_IN),
        }
    }
}

/// What is kept from one start to the next.
#[derive(Debug, Default, Clone, Serialize, Deserialize)]
struct Kept {
    /// The hash of the password, with its salt and parameters.
    password: Option<String>,
    look_token: Option<Token>,
}

#[derive(Debug)]
struct Session {
    id: Token,
    role: Role,
    ends: Instant,
}

/// The wrong tries from one address.
#[derive(Debug, Clone, Copy)]
struct Tries {
    count: u32,
    last: Instant,
    blocked_until: Instant,
}

#[derive(Debug, Default)]
struct State {
    kept: Kept,
    sessions: Vec<Session>,
    tries: HashMap<IpAddr, Tries>,
}

#[derive(Debug)]
pub struct Access {
    path: PathBuf,
    operate_token: Token,
    state: Mutex<State>,
    /// One hash at a time bounds memory and the load that strangers can cause.
    hashing: Semaphore,
    /// Held while the file is written, so that one change at a time is kept.
    keeping: AsyncMutex<()>,
}

impl Access {
    /// Reads what was kept in the folder.
    pub fn load(folder: &Path, operate_token: Token) -> io::Result<Self> {
        let path = folder.join("access.json");
        let kept = match fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Kept::default(),
            Err(error) => return Err(error),
        };
        let state = Mutex::new(State { kept, ..State::default() });
        Ok(Self { path, operate_token, state, hashing: Semaphore::new(1), keeping: AsyncMutex::default() })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn needs_password(&self) -> bool {
        self.state().kept.password.is_none()
    }

    /// Returns who sends a request from this address with these headers.
    pub fn caller(&self, headers: &HeaderMap, address: IpAddr) -> Caller {
        let address = address.to_canonical();
        let own = address.is_loopback().then_some(Role::Operate);
        let mut state = self.state();
        state.sessions.retain(|session| session.ends > Instant::now());
        let session = cookie(headers).and_then(|id| state.sessions.iter().find(|session| session.id.is(id)));
        let role = own.max(session.map(|session| session.role));
        let identity = session.map_or_else(|| address.to_string(), |session| session.id.to_string());
        Caller { address, role, identity }
    }

    /// Begins a session if the password or the token is right, and returns its cookie.
    pub async fn log_in(&self, caller: &Caller, secret: &Secret) -> Result<String, Refusal> {
        self.admit_try(caller.address)?;
        let role = match secret {
            Secret::Token(token) if self.operate_token.is(token) => Some(Role::Operate),
            Secret::Token(token) => {
                let state = self.state();
                state.kept.look_token.as_ref().is_some_and(|look| look.is(token)).then_some(Role::Look)
            }
            Secret::Password(password) => self.is_password(password).await?.then_some(Role::Operate),
        };
        let Some(role) = role else {
            self.count_wrong_try(caller.address);
            return Err(WRONG);
        };
        self.state().tries.remove(&network(caller.address));
        self.begin(role)
    }

    /// Begins a session and returns its cookie.
    pub fn begin(&self, role: Role) -> Result<String, Refusal> {
        let id = Token::random().map_err(|error| Refusal::failed(&error))?;
        let cookie = format!("{COOKIE_NAME}={id}; Path=/; HttpOnly; SameSite=Strict; Max-Age={}", SESSION.as_secs());
        let mut state = self.state();
        if state.sessions.len() >= MOST_SESSIONS {
            state.sessions.remove(0);
        }
        state.sessions.push(Session { id, role, ends: Instant::now() + SESSION });
        Ok(cookie)
    }

    /// Ends the session of a request, and returns the cookie that makes the browser forget it.
    pub fn log_out(&self, headers: &HeaderMap) -> String {
        if let Some(id) = cookie(headers) {
            self.state().sessions.retain(|session| !session.id.is(id));
        }
        format!("{COOKIE_NAME}=; Path=/; HttpOnly; SameSite=Strict; Max-Age=0")
    }

    /// Sets the password, which ends all sessions and begins one. Returns its cookie.
    pub async fn set_password(&self, caller: &Caller, new: String) -> Result<String, Refusal> {
        if !self.needs_password() {
            caller.must(Role::Operate)?;
        }
        if !PASSWORD_LENGTH.contains(&new.chars().count()) {
            return Err(Refusal::fixed(StatusCode::BAD_REQUEST, "Give a password of 8 to 128 characters.\n"));
        }
        let _turn = self.hashing.acquire().await;
        // Two may have come at the same time, while there was no password.
        if !self.needs_password() {
            caller.must(Role::Operate)?;
        }
        let mut salt = [0; 16];
        getrandom::fill(&mut salt).map_err(|error| Refusal::failed(&error))?;
        let hash = spawn_blocking(move || {
            let salt = SaltString::encode_b64(&salt)?;
            Ok::<_, argon2::password_hash::Error>(hasher()?.hash_password(new.as_bytes(), &salt)?.to_string())
        });
        let hash = hash.await.map_err(|error| Refusal::failed(&error))?.map_err(|error| Refusal::failed(&error))?;
        self.keep(|kept| kept.password = Some(hash)).await?;
        self.state().sessions.clear();
        self.begin(Role::Operate)
    }

    /// Makes a new token with which others may look, in place of the former one, whose sessions end.
    pub async fn make_look_token(&self) -> Result<Token, Refusal> {
        let token = Token::random().map_err(|error| Refusal::failed(&error))?;
        self.keep(|kept| kept.look_token = Some(token.clone())).await?;
        self.state().sessions.retain(|session| session.role == Role::Operate);
        Ok(token)
    }

    async fn keep(&self, change: impl FnOnce(&mut Kept)) -> Result<(), Refusal> {
        let _turn = self.keeping.lock().await;
        let mut kept = self.state().kept.clone();
        change(&mut kept);
        let bytes = serde_json::to_vec(&kept).map_err(|error| Refusal::failed(&error))?;
        let path = self.path.clone();
        on_another_thread(move || write_atomically(&path, &bytes, 0o600)).await?;
        self.state().kept = kept;
        Ok(())
    }

    async fn is_password(&self, password: &str) -> Result<bool, Refusal> {
        let Some(hash) = self.state().kept.password.clone() else { return Ok(false) };
        let _turn = self.hashing.acquire().await;
        let password = password.to_owned();
        let verify = spawn_blocking(move || {
            let hash = PasswordHash::new(&hash)?;
            hasher()?.verify_password(password.as_bytes(), &hash)
        });
        Ok(verify.await.map_err(|error| Refusal::failed(&error))?.is_ok())
    }

    /// Refuses a try, whether it is right or wrong, while its address has to wait.
    fn admit_try(&self, address: IpAddr) -> Result<(), Refusal> {
        let tries = self.state().tries.get(&network(address)).copied();
        let wait = tries.map(|tries| tries.blocked_until.saturating_duration_since(Instant::now()));
        match wait {
            Some(wait) if !wait.is_zero() => Err(Refusal::new(
                StatusCode::TOO_MANY_REQUESTS,
                format!("There were too many wrong tries. Try again in {} seconds.\n", wait.as_secs() + 1),
            )),
            _ => Ok(()),
        }
    }

    fn count_wrong_try(&self, address: IpAddr) {
        let (now, mut state) = (Instant::now(), self.state());
        let address = network(address);
        if state.tries.len() >= MOST_ADDRESSES && !state.tries.contains_key(&address) {
            let oldest = state.tries.iter().min_by_key(|(_, tries)| tries.last).map(|(address, _)| *address);
            oldest.map(|oldest| state.tries.remove(&oldest));
        }
        let fresh = Tries { count: 0, last: now, blocked_until: now };
        let tries = state.tries.entry(address).or_insert(fresh);
        *tries = tries.after_wrong(now);
    }
}

impl Tries {
    /// Counts one more. Tries are forgotten a while after the last wait has ended.
    fn after_wrong(self, now: Instant) -> Self {
        let is_old = now.saturating_duration_since(self.last.max(self.blocked_until)) > TRY_WINDOW;
        let count = if is_old { 1 } else { self.count.saturating_add(1) };
        let doublings = count.checked_sub(FREE_TRIES);
        let wait = doublings.map_or(Duration::ZERO, |doublings| {
            TRY_WINDOW.saturating_mul(2_u32.saturating_pow(doublings)).min(LONGEST_WAIT)
        });
        Self { count, last: now, blocked_until: now + wait }
    }
}

/// A password or a token that somebody gives.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Secret {
    Password(String),
    Token(String),
}

fn hasher() -> Result<Argon2<'static>, argon2::password_hash::Error> {
    Ok(Argon2::new(Algorithm::Argon2id, Version::V0x13, Params::new(HASH_KB, HASH_PASSES, 1, None)?))
}

/// Returns the address that stands for its owner: an owner of IPv6 addresses has 2^64 of them.
fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(v6) => Ipv6Addr::from_bits(v6.to_bits() >> 64 << 64).into(),
    }
}

/// Returns the session that the request names.
fn cookie(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|cookies| cookies.split("; ")).filter_map(|pair| pair.split_once('='));
    pairs.find(|(name, _)| *name == COOKIE_NAME).map(|(_, id)| id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wait_begins_with_the_fifth_wrong_try_and_doubles_up_to_an_hour() {
        let mut now = Instant::now();
        let mut tries = Tries { count: 0, last: now, blocked_until: now };
        let waits: Vec<u64> = (0..12)
            .map(|_| {
                tries = tries.after_wrong(now);
                let wait = tries.blocked_until - now;
                now = tries.blocked_until + Duration::from_secs(1);
                wait.as_secs()
            })
            .collect();
        assert_eq!(waits, [0, 0, 0, 0, 60, 120, 240, 480, 960, 1920, 3600, 3600]);
        // `now` is a second after the end of the last wait.
        assert_eq!([59, 60].map(|s| tries.after_wrong(now + Duration::from_secs(s)).count), [13, 1]);
    }

    /// A caller in the network who sends this cookie, or none.
    fn from_afar(access: &Access, cookie: &str) -> Caller {
        let mut headers = HeaderMap::new();
        headers.insert(COOKIE, cookie.split(';').next().unwrap().parse().unwrap());
        access.caller(&headers, "192.168.1.5".parse().unwrap())
    }

    #[tokio::test]
    async fn who_comes_with_the_token_to_look_may_look_and_operate_nothing_and_ends_with_the_token() {
        let folder = tempfile::tempdir().unwrap();
        let access = Access::load(folder.path(), Token::random().unwrap()).unwrap();
        let stranger = from_afar(&access, "facewire-console=guessed");
        assert_eq!([Role::Look, Role::Operate].map(|role| stranger.must(role)), [Err(LOG_IN), Err(LOG_IN)]);
        let look = access.make_look_token().await.unwrap();
        let cookie = access.log_in(&stranger, &Secret::Token(look.to_string())).await.unwrap();
        let viewer = from_afar(&access, &cookie);
        assert_eq!([Role::Look, Role::Operate].map(|role| viewer.must(role)), [Ok(()), Err(LOOK_ONLY)]);
        access.make_look_token().await.unwrap();
        assert_eq!(from_afar(&access, &cookie).must(Role::Look), Err(LOG_IN), "the token has been replaced");
        let operator = from_afar(&access, &access.begin(Role::Operate).unwrap());
        assert_eq!([Role::Look, Role::Operate].map(|role| operator.must(role)), [Ok(()), Ok(())]);
    }

    #[test]
    fn the_addresses_of_one_ipv6_network_share_their_tries() {
        let [a, b, c]: [IpAddr; 3] =
            ["2001:db8::1", "2001:db8::2:3", "2001:db8:0:1::1"].map(|text| text.parse().unwrap());
        assert_eq!(network(a), network(b));
        assert_ne!(network(a), network(c));
    }
}
