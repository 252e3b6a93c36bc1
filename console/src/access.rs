//! Who may do what: a password, tokens, sessions, and a limit to wrong tries.
//!
//! A client on this machine needs nothing. Any other one needs a session, which a password or a token begins and which ends
//! [`SESSION`] after its last use. The first password can be set by whoever comes first.

use std::{
    collections::{HashMap, VecDeque},
    fs, io,
    net::{IpAddr, Ipv6Addr},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
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
    time::Instant,
};

use crate::{
    files::{on_another_thread, write_atomically},
    web::{Refusal, Route, Token},
};

const SESSION_COOKIE: &str = "facewire-console";
/// Names a browser from which somebody has logged in before.
const BROWSER_COOKIE: &str = "facewire-console-browser";
/// How long a session lasts after its last use. An open page uses it all the time.
const SESSION: Duration = Duration::from_hours(12);
/// How long a browser keeps the cookie, which is as long as browsers allow. When the session ends, this program decides alone.
const COOKIE_LIFE: Duration = Duration::from_hours(400 * 24);
/// The most sessions of one role at a time, so that those who may only look end no session of an operator.
const MOST_SESSIONS: usize = 32;
/// How many wrong tries within [`TRY_WINDOW`] make nobody wait: from one browser or address, and from one network of IPv6.
const FREE_TRIES: u32 = 5;
const FREE_TRIES_OF_NETWORK: u32 = 50;
const TRY_WINDOW: Duration = Duration::from_mins(1);
/// The longest wait after wrong tries. It doubles with each further one.
const LONGEST_WAIT: Duration = Duration::from_hours(1);
/// The most browsers, addresses and networks whose tries are counted.
const MOST_SOURCES: usize = 256;
/// The most browsers that are known. The one that has been known longest makes room for a new one.
const MOST_BROWSERS: usize = 64;
const PASSWORD_LENGTH: std::ops::RangeInclusive<usize> = 8..=128;
/// The memory and the passes of Argon2id. They take 0.1 s on a PC, and fit into the memory of this program.
const HASH_KB: u32 = 4096;
const HASH_PASSES: u32 = 6;

const WRONG: Refusal = Refusal::fixed(StatusCode::FORBIDDEN, "The password or the token is wrong.\n");
const LOG_IN: Refusal = Refusal::fixed(StatusCode::UNAUTHORIZED, "Log in first: POST the password to api/1/login.\n");
const GIVE_OLD: Refusal = Refusal::fixed(
    StatusCode::FORBIDDEN,
    "Give the old password too. On the board itself a new one needs no old one.\n",
);
const LOOK_ONLY: Refusal = Refusal::fixed(StatusCode::FORBIDDEN, "This session may look and change nothing. Log in.\n");

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    Look,
    Operate,
}

/// Who sends a request. Ask [`Access`] each time what the caller may do, because sessions end.
#[derive(Debug, Clone)]
pub struct Caller {
    pub address: IpAddr,
    /// Whether the caller is on this machine, where nobody has to log in.
    pub is_local: bool,
    pub is_encrypted: bool,
    /// What the cookie names: a session, or on this machine, where nobody has to log in, just the browser.
    cookie: Option<String>,
    /// What its other cookie names: a browser from which somebody has logged in, if that is known.
    browser: Option<String>,
}

impl Caller {
    /// Returns who sends a request with these headers on this route.
    pub fn new(headers: &HeaderMap, Route { client, is_local, is_encrypted }: Route) -> Self {
        let [session, browser] = [SESSION_COOKIE, BROWSER_COOKIE].map(|name| cookie(headers, name).map(str::to_owned));
        Self { address: client, is_local, is_encrypted, cookie: session, browser }
    }

    /// Whether both are the same operator. A caller without a cookie is the same as nobody.
    pub fn is(&self, other: &Self) -> bool {
        self.cookie.is_some() && self.cookie == other.cookie
    }

    /// Returns a cookie by which a caller on this machine is known from now on, unless there is one.
    pub fn name(&self) -> Result<Option<String>, Refusal> {
        if self.cookie.is_some() || !self.is_local {
            return Ok(None);
        }
        let id = Token::random().map_err(|error| Refusal::failed(&error))?;
        Ok(Some(cookie_of(SESSION_COOKIE, &id)))
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
    used: Instant,
}

/// Whose wrong tries are counted.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Source {
    /// A known browser, which nobody else can make wait.
    Browser(String),
    Address(IpAddr),
    /// A network of IPv6, whose owner has 2^64 addresses.
    Network(IpAddr),
}

impl Source {
    fn free_tries(&self) -> u32 {
        match self {
            Self::Network(_) => FREE_TRIES_OF_NETWORK,
            Self::Browser(_) | Self::Address(_) => FREE_TRIES,
        }
    }
}

/// The wrong tries of one source.
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
    browsers: VecDeque<Token>,
    tries: HashMap<Source, Tries>,
}

impl State {
    /// Returns the session of this name, and records that it is used now.
    fn session(&mut self, id: &str) -> Option<&Session> {
        let now = Instant::now();
        self.sessions.retain(|session| session.used + SESSION > now);
        let session = self.sessions.iter_mut().find(|session| session.id.is(id))?;
        session.used = now;
        Some(session)
    }

    fn is_known(&self, caller: &Caller) -> bool {
        caller.browser.as_ref().is_some_and(|id| self.browsers.iter().any(|browser| browser.is(id)))
    }

    fn sources(&self, caller: &Caller) -> Vec<Source> {
        match (caller.address, &caller.browser) {
            (_, Some(id)) if self.is_known(caller) => vec![Source::Browser(id.clone())],
            (IpAddr::V4(_), _) => vec![Source::Address(caller.address)],
            (IpAddr::V6(_), _) => vec![Source::Address(caller.address), Source::Network(network(caller.address))],
        }
    }

    fn count_wrong_try(&mut self, source: &Source, now: Instant) {
        if self.tries.len() >= MOST_SOURCES && !self.tries.contains_key(source) {
            let oldest = self.tries.iter().min_by_key(|(_, tries)| tries.last).map(|(oldest, _)| oldest.clone());
            oldest.map(|oldest| self.tries.remove(&oldest));
        }
        let fresh = Tries { count: 0, last: now, blocked_until: now };
        let tries = self.tries.entry(source.clone()).or_insert(fresh);
        *tries = tries.after_wrong(now, source.free_tries());
    }

    /// Ends the session of this role that was used least recently, if there is no room for one more.
    fn make_room(&mut self, role: Role) {
        let of_role = || self.sessions.iter().enumerate().filter(|(_, session)| session.role == role);
        if of_role().count() < MOST_SESSIONS {
            return;
        }
        if let Some((oldest, _)) = of_role().min_by_key(|(_, session)| session.used) {
            self.sessions.remove(oldest);
        }
    }
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

    /// Returns what the caller may do now. This counts as a use of the session.
    pub fn role(&self, caller: &Caller) -> Option<Role> {
        let own = caller.is_local.then_some(Role::Operate);
        let mut state = self.state();
        let session = caller.cookie.as_ref().and_then(|id| state.session(id));
        own.max(session.map(|session| session.role))
    }

    /// Refuses a caller who has a lesser role now.
    pub fn must(&self, caller: &Caller, role: Role) -> Result<(), Refusal> {
        match self.role(caller) {
            Some(own) if own >= role => Ok(()),
            Some(_) => Err(LOOK_ONLY),
            None => Err(LOG_IN),
        }
    }

    /// Begins a session if the password or the token is right, and returns the cookies for the browser to keep.
    pub async fn log_in(&self, caller: &Caller, secret: &Secret) -> Result<Vec<String>, Refusal> {
        match secret {
            // Nobody guesses a token, so that tries need no limit.
            Secret::Token(token) => Ok(vec![self.begin(self.role_of(token).ok_or(WRONG)?)?]),
            Secret::Password(password) => {
                self.must_know_password(caller, password).await?;
                let mut cookies = vec![self.begin(Role::Operate)?];
                cookies.extend(self.remember(caller)?);
                Ok(cookies)
            }
        }
    }

    fn role_of(&self, token: &str) -> Option<Role> {
        if self.operate_token.is(token) {
            return Some(Role::Operate);
        }
        self.state().kept.look_token.as_ref().is_some_and(|look| look.is(token)).then_some(Role::Look)
    }

    /// Refuses a wrong password, and each one while its source has to wait.
    async fn must_know_password(&self, caller: &Caller, password: &str) -> Result<(), Refusal> {
        let sources = self.admit_try(caller)?;
        if !self.is_password(password).await? {
            return Err(WRONG);
        }
        self.forgive(&sources);
        Ok(())
    }

    /// Makes the browser a known one, and returns its cookie unless it has one.
    fn remember(&self, caller: &Caller) -> Result<Option<String>, Refusal> {
        let mut state = self.state();
        if state.is_known(caller) {
            return Ok(None);
        }
        let id = Token::random().map_err(|error| Refusal::failed(&error))?;
        let cookie = cookie_of(BROWSER_COOKIE, &id);
        state.browsers.push_back(id);
        if state.browsers.len() > MOST_BROWSERS {
            state.browsers.pop_front();
        }
        Ok(Some(cookie))
    }

    /// Begins a session and returns its cookie. If there are too many of this role, the one that was used least recently ends.
    pub fn begin(&self, role: Role) -> Result<String, Refusal> {
        let id = Token::random().map_err(|error| Refusal::failed(&error))?;
        let cookie = cookie_of(SESSION_COOKIE, &id);
        let mut state = self.state();
        state.make_room(role);
        state.sessions.push(Session { id, role, used: Instant::now() });
        Ok(cookie)
    }

    /// Ends the session of a request, and returns the cookie that makes the browser forget it.
    pub fn log_out(&self, headers: &HeaderMap) -> String {
        if let Some(id) = cookie(headers, SESSION_COOKIE) {
            self.state().sessions.retain(|session| !session.id.is(id));
        }
        format!("{SESSION_COOKIE}=; Path=/; HttpOnly; SameSite=Strict; Max-Age=0")
    }

    /// Sets the password, which ends all sessions and begins one. Returns its cookie. Whoever comes from elsewhere has to know the
    /// old password, so that a stolen session cannot lock its owner out.
    pub async fn set_password(&self, caller: &Caller, new: String, old: Option<&str>) -> Result<String, Refusal> {
        let is_first = self.needs_password();
        if !is_first {
            self.must(caller, Role::Operate)?;
        }
        if !is_first && !caller.is_local {
            self.must_know_password(caller, old.ok_or(GIVE_OLD)?).await?;
        }
        if !PASSWORD_LENGTH.contains(&new.chars().count()) {
            return Err(Refusal::fixed(StatusCode::BAD_REQUEST, "Give a password of 8 to 128 characters.\n"));
        }
        let _turn = self.hashing.acquire().await;
        // Two may have come at the same time, while there was no password.
        if is_first && !self.needs_password() {
            return Err(LOG_IN);
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
        let (password, judged) = (password.to_owned(), hash.clone());
        let verify = spawn_blocking(move || {
            let hash = PasswordHash::new(&judged)?;
            hasher()?.verify_password(password.as_bytes(), &hash)
        });
        let is_right = verify.await.map_err(|error| Refusal::failed(&error))?.is_ok();
        // Somebody may have set another one meanwhile.
        Ok(is_right && self.state().kept.password.as_ref() == Some(&hash))
    }

    /// Counts a try as wrong until it turns out to be right, so that many at the same moment count, too. Refuses it while one of
    /// its sources has to wait.
    fn admit_try(&self, caller: &Caller) -> Result<Vec<Source>, Refusal> {
        let now = Instant::now();
        let mut state = self.state();
        let sources = state.sources(caller);
        let tries = sources.iter().filter_map(|source| state.tries.get(source));
        let wait = tries.map(|tries| tries.blocked_until.saturating_duration_since(now)).max().unwrap_or_default();
        if !wait.is_zero() {
            let sentence = format!("There were too many wrong tries. Try again in {} seconds.\n", wait.as_secs() + 1);
            return Err(Refusal::new(StatusCode::TOO_MANY_REQUESTS, sentence));
        }
        sources.iter().for_each(|source| state.count_wrong_try(source, now));
        Ok(sources)
    }

    /// Forgets the tries of somebody who has given the right password, but not those of the neighbours.
    fn forgive(&self, sources: &[Source]) {
        let now = Instant::now();
        let mut state = self.state();
        for source in sources {
            match (source, state.tries.get_mut(source)) {
                (Source::Network(_), Some(tries)) => {
                    tries.count = tries.count.saturating_sub(1);
                    tries.blocked_until = now;
                }
                _ => drop(state.tries.remove(source)),
            }
        }
    }
}

impl Tries {
    /// Counts one more. Tries are forgotten a while after the last wait has ended.
    fn after_wrong(self, now: Instant, free: u32) -> Self {
        let is_old = now.saturating_duration_since(self.last.max(self.blocked_until)) > TRY_WINDOW;
        let count = if is_old { 1 } else { self.count.saturating_add(1) };
        let doublings = count.checked_sub(free);
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
pub fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(v6) => Ipv6Addr::from_bits(v6.to_bits() >> 64 << 64).into(),
    }
}

/// Returns the cookie of this name, for the browser to keep.
fn cookie_of(name: &str, id: &Token) -> String {
    format!("{name}={id}; Path=/; HttpOnly; SameSite=Strict; Max-Age={}", COOKIE_LIFE.as_secs())
}

/// Returns what the cookie of this name holds.
fn cookie<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|cookies| cookies.split("; ")).filter_map(|pair| pair.split_once('='));
    pairs.find(|(other, _)| *other == name).map(|(_, id)| id)
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
                tries = tries.after_wrong(now, FREE_TRIES);
                let wait = tries.blocked_until - now;
                now = tries.blocked_until + Duration::from_secs(1);
                wait.as_secs()
            })
            .collect();
        assert_eq!(waits, [0, 0, 0, 0, 60, 120, 240, 480, 960, 1920, 3600, 3600]);
        // `now` is a second after the end of the last wait.
        assert_eq!([59, 60].map(|s| tries.after_wrong(now + Duration::from_secs(s), FREE_TRIES).count), [13, 1]);
    }

    /// A caller in the network who sends this cookie, or none.
    fn from_afar(cookie: &str) -> Caller {
        let mut headers = HeaderMap::new();
        headers.insert(COOKIE, cookie.split(';').next().unwrap().parse().unwrap());
        let client = [192, 168, 1, 5].into();
        Caller::new(&headers, Route { client, is_local: false, is_encrypted: false })
    }

    #[tokio::test]
    async fn who_comes_with_the_token_to_look_may_look_and_operate_nothing_and_ends_with_the_token() {
        let folder = tempfile::tempdir().unwrap();
        let access = Access::load(folder.path(), Token::random().unwrap()).unwrap();
        let stranger = from_afar("facewire-console=guessed");
        let may = |caller: &Caller| [Role::Look, Role::Operate].map(|role| access.must(caller, role));
        assert_eq!(may(&stranger), [Err(LOG_IN), Err(LOG_IN)]);
        let look = access.make_look_token().await.unwrap();
        let cookies = access.log_in(&stranger, &Secret::Token(look.to_string())).await.unwrap();
        let viewer = from_afar(&cookies[0]);
        assert_eq!(may(&viewer), [Ok(()), Err(LOOK_ONLY)]);
        let operator = from_afar(&access.begin(Role::Operate).unwrap());
        access.make_look_token().await.unwrap();
        assert_eq!(may(&viewer), [Err(LOG_IN), Err(LOG_IN)], "the token has been replaced");
        assert_eq!(may(&operator), [Ok(()), Ok(())]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_session_lasts_while_it_is_used_and_twelve_hours_more() {
        let folder = tempfile::tempdir().unwrap();
        let access = Access::load(folder.path(), Token::random().unwrap()).unwrap();
        let cookie = access.begin(Role::Operate).unwrap();
        for _ in 0..5 {
            tokio::time::advance(SESSION - Duration::from_secs(1)).await;
            assert_eq!(access.must(&from_afar(&cookie), Role::Operate), Ok(()));
        }
        tokio::time::advance(SESSION).await;
        assert_eq!(access.must(&from_afar(&cookie), Role::Look), Err(LOG_IN));
    }

    #[tokio::test(start_paused = true)]
    async fn a_new_session_ends_none_of_the_other_role_and_none_that_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let access = Access::load(folder.path(), Token::random().unwrap()).unwrap();
        let [used, idle] = [(); 2].map(|()| access.begin(Role::Operate).unwrap());
        for role in [Role::Look, Role::Operate] {
            for _ in 1..MOST_SESSIONS {
                tokio::time::advance(Duration::from_secs(1)).await;
                access.begin(role).unwrap();
                assert_eq!(access.must(&from_afar(&used), Role::Operate), Ok(()));
            }
            let idle_may = access.role(&from_afar(&idle));
            assert_eq!(idle_may, (role == Role::Look).then_some(Role::Operate), "after sessions to {role:?}");
        }
    }

    /// A caller at this address, with this cookie of a browser.
    fn at(address: &str, browser: Option<&str>) -> Caller {
        let browser = browser.map(|cookie| cookie.split(['=', ';']).nth(1).unwrap().to_owned());
        Caller { address: address.parse().unwrap(), is_local: false, is_encrypted: false, cookie: None, browser }
    }

    #[tokio::test]
    async fn whoever_guesses_makes_neither_neighbours_nor_known_browsers_wait() {
        let folder = tempfile::tempdir().unwrap();
        let access = Access::load(folder.path(), Token::random().unwrap()).unwrap();
        for guesser in ["192.168.1.5", "2001:db8::1"] {
            let cookie = access.remember(&at(guesser, None)).unwrap().unwrap();
            let owner = at(guesser, Some(&cookie));
            let admitted = (0..20).filter(|_| access.admit_try(&at(guesser, None)).is_ok()).count();
            assert_eq!(admitted, 5, "{guesser}, all at the same moment");
            assert!(access.admit_try(&owner).is_ok(), "{guesser}");
            assert!(access.admit_try(&at(guesser, Some("a=0;"))).is_err(), "{guesser}, with a cookie of nobody");
        }
        for neighbour in ["192.168.1.6", "2001:db8::2:3", "2001:db8:0:1::1"] {
            assert!(access.admit_try(&at(neighbour, None)).is_ok(), "{neighbour}");
        }
        // The owner of a network has many addresses, and not as many tries.
        let tries = (0..1000).filter(|n| access.admit_try(&at(&format!("2001:db8:7::{n:x}"), None)).is_ok());
        assert_eq!(tries.count(), 50);
    }

    #[tokio::test]
    async fn a_link_to_look_buys_no_further_tries() {
        let folder = tempfile::tempdir().unwrap();
        let access = Access::load(folder.path(), Token::random().unwrap()).unwrap();
        let look = Secret::Token(access.make_look_token().await.unwrap().to_string());
        let guesser = at("192.168.1.5", None);
        for _ in 0..5 {
            access.admit_try(&guesser).unwrap();
            access.log_in(&guesser, &look).await.unwrap();
        }
        assert!(access.admit_try(&guesser).is_err());
        access.log_in(&guesser, &look).await.unwrap();
    }
}
