//! The web server: the page, its parts, and a stream of snapshots for each open page.
//!
//! Contract: at most [`MOST_CONNECTIONS`] connections and [`MOST_STREAMS`] streams, each with bounded buffers. A client
//! that sends no request, or does not read, loses its connection. Where there are too many, one makes room ([`Places`]).
//!
//! A thread of its own serves the connections, releases servos and begins sessions, and does nothing else. The runtime in which
//! the [`Site`] was made does all that takes longer (its workshop), so that a release waits for no other request.

mod events;
mod guard;
mod page;
mod places;
mod token;

use std::{
    borrow::Cow,
    convert::Infallible,
    fmt, io,
    net::{IpAddr, SocketAddr},
    sync::Arc,
    thread,
    time::Duration,
};

use http_body_util::{BodyExt as _, Full, combinators::BoxBody};
use hyper::{
    Method, Request, Response, StatusCode,
    body::{Bytes, Incoming},
    header::{self, HeaderValue},
    server::conn::http1,
    service::service_fn,
};
use hyper_util::rt::{TokioIo, TokioTimer};
use socket2::SockRef;
use tokio::{
    net::{TcpListener, TcpSocket, TcpStream},
    runtime::{self, Handle},
    select,
    sync::{oneshot, watch},
    task::{JoinSet, yield_now},
    time::sleep,
};

use self::{
    events::Events,
    guard::Guard,
    places::{Place, Places, Standing},
};
pub use self::{guard::Route, token::Token};
use crate::{
    Failure,
    access::{Caller, Role},
    api,
    console::Console,
    hint::Hint,
    snapshot::Snapshot,
};

/// A page takes one connection for its stream, and a few while it loads.
const MOST_CONNECTIONS: usize = 64;
/// The most connections that the system takes before this program does.
const MOST_WAITING: u32 = 1024;
/// The most pages that are open at the same time.
const MOST_STREAMS: usize = 16;
/// A client must send each request, and acknowledge what it is sent, within this time.
const PATIENCE: Duration = Duration::from_secs(15);
/// Size of each of the two buffers for a client, in this program and in the system. They are small, so that a slow client
/// sees recent snapshots.
const BUFFER_BYTES: usize = 16 * 1024;
/// Pause after the system refused a connection, as it does when there are no file descriptors left.
const REFUSED_PAUSE: Duration = Duration::from_millis(100);

/// What the page may load, run and connect to: only what comes from here.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

pub type Body = BoxBody<Bytes, Infallible>;
pub type Answer = Result<Response<Body>, Refusal>;

/// All that is served.
#[derive(Debug)]
pub struct Site {
    guard: Guard,
    events: Events,
    console: Option<Arc<Console>>,
    /// The runtime that does what would delay the connections.
    workshop: Handle,
}

impl Site {
    /// Makes the site of packets that come to this program. A page on another machine needs a token.
    pub fn of_packets(token: Option<Token>, hint: &Hint, snapshots: watch::Receiver<Snapshot>) -> Self {
        Self {
            guard: Guard::new(token, false),
            events: Events::new(Some(hint), snapshots, MOST_STREAMS),
            console: None,
            workshop: Handle::current(),
        }
    }

    /// Makes the site of a service.
    pub fn of_service(console: Arc<Console>, snapshots: watch::Receiver<Snapshot>) -> Self {
        let events = Events::new(None, snapshots, MOST_STREAMS);
        Self { guard: Guard::new(None, true), events, console: Some(console), workshop: Handle::current() }
    }

    async fn respond(&self, request: Request<Incoming>, client: IpAddr, place: &Place) -> Response<Body> {
        let mut response = self.answer(request, client, place).await.unwrap_or_else(Refusal::into_response);
        let headers = response.headers_mut();
        for (name, value) in [
            (header::CONTENT_SECURITY_POLICY, POLICY),
            (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
            (header::REFERRER_POLICY, "no-referrer"),
            (header::CACHE_CONTROL, "no-store"),
            (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
            (header::HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        ] {
            headers.insert(name, HeaderValue::from_static(value));
        }
        response
    }

    async fn answer(&self, request: Request<Incoming>, client: IpAddr, place: &Place) -> Answer {
        let own_names = self.console.as_ref().map(|console| console.names()).unwrap_or_default();
        let path = self.guard.check(&request, &own_names)?.to_owned();
        if let Some(path) = path.strip_prefix("api/1/") {
            return match &self.console {
                Some(console) => self.answer_of_service(console, path, request, client, place).await,
                None => {
                    place.set(Standing { role: Some(Role::Look), is_urgent: false });
                    match path {
                        "events" => self.events.open(None, &self.workshop),
                        _ => api::answer_of_packets(path),
                    }
                }
            };
        }
        if request.method() == Method::POST {
            return Err(Refusal::NOT_FOUND);
        }
        let part = page::part(&path).ok_or(Refusal::NOT_FOUND)?;
        Ok(response(StatusCode::OK, part.kind, Bytes::from_static(part.bytes)))
    }

    async fn answer_of_service(
        &self,
        console: &Arc<Console>,
        path: &str,
        request: Request<Incoming>,
        client: IpAddr,
        place: &Place,
    ) -> Answer {
        let caller = Caller::new(request.headers(), Route::of(&request, client));
        let is_change = request.method() == Method::POST;
        let is_urgent = matches!((path, is_change), ("servos/release", true) | ("events", false));
        let role = console.access.role(&caller);
        place.set(Standing { role, is_urgent });
        match (path, is_change) {
            ("servos/release", true) => api::release(console, &caller, request).await,
            // A flood of connections cuts off no login that is being judged, of which there are few.
            ("login", true) => {
                api::log_in(console, &caller, request, || place.set(Standing { role, is_urgent: true })).await
            }
            ("events", false) => {
                console.access.must(&caller, Role::Look)?;
                self.events.open(Some((console, caller)), &self.workshop)
            }
            _ => self.work(Arc::clone(console), caller, path.to_owned(), request).await,
        }
    }

    /// Has a request answered in the workshop, and gives it up if the client goes away.
    async fn work(&self, console: Arc<Console>, caller: Caller, path: String, request: Request<Incoming>) -> Answer {
        let mut work = JoinSet::new();
        work.spawn_on(async move { api::answer(&console, &caller, &path, request).await }, &self.workshop);
        let done = work.join_next().await.unwrap_or_else(|| Ok(Err(Refusal::NOT_FOUND)));
        done.map_err(|error| Refusal::failed(&error))?
    }
}

pub fn response(status: StatusCode, kind: &'static str, bytes: Bytes) -> Response<Body> {
    let mut response = Response::new(Full::new(bytes).boxed());
    *response.status_mut() = status;
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

/// Why a request gets nothing, with a sentence for the person at the browser.
#[derive(Debug, PartialEq, Eq)]
pub struct Refusal(StatusCode, Cow<'static, str>);

impl Refusal {
    pub const NOT_FOUND: Self =
        Self(StatusCode::NOT_FOUND, Cow::Borrowed("There is nothing at this address. Open / instead.\n"));

    pub const fn fixed(status: StatusCode, sentence: &'static str) -> Self {
        Self(status, Cow::Borrowed(sentence))
    }

    pub fn new(status: StatusCode, sentence: String) -> Self {
        Self(status, Cow::Owned(sentence))
    }

    /// A failure of this program or of its machine.
    pub fn failed(error: &impl fmt::Display) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, format!("It failed: {error}.\n"))
    }

    pub fn sentence(&self) -> &str {
        self.1.trim()
    }

    fn into_response(self) -> Response<Body> {
        let bytes = match self.1 {
            Cow::Borrowed(sentence) => Bytes::from_static(sentence.as_bytes()),
            Cow::Owned(sentence) => sentence.into(),
        };
        response(self.0, "text/plain; charset=utf-8", bytes)
    }
}

/// Opens the port of the page. Its connections inherit the size of the send buffer.
pub fn listen(address: SocketAddr) -> Result<TcpListener, Failure> {
    let open = || -> io::Result<TcpListener> {
        let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
        // A port that was closed a moment ago can be opened again at once.
        socket.set_reuseaddr(true)?;
        socket.set_send_buffer_size(u32::try_from(BUFFER_BYTES).unwrap_or(u32::MAX))?;
        socket.bind(address)?;
        socket.listen(MOST_WAITING)
    };
    open().map_err(|error| Failure::Serve { address, error })
}

/// Serves on a thread of its own for as long as the program runs. The receiver ends if that thread does.
pub fn serve(listener: TcpListener, site: Site) -> io::Result<oneshot::Receiver<Infallible>> {
    let listener = listener.into_std()?;
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    let (alive, ended) = oneshot::channel();
    thread::Builder::new().name("web".to_owned()).spawn(move || {
        let _alive = alive;
        runtime.block_on(async {
            if let Ok(listener) = TcpListener::from_std(listener) {
                accept(listener, Arc::new(site)).await;
            }
        });
    })?;
    Ok(ended)
}

async fn accept(listener: TcpListener, site: Arc<Site>) {
    let places = Places::default();
    loop {
        let Ok((stream, client)) = listener.accept().await else {
            sleep(REFUSED_PAUSE).await;
            continue;
        };
        let place = places.enter(MOST_CONNECTIONS, client.ip());
        let site = Arc::clone(&site);
        tokio::spawn(async move { attend(stream, client.ip(), &site, PATIENCE, &place).await });
        // Whoever has sent a request with the connection is heard before others can take its place.
        yield_now().await;
    }
}

/// Serves one connection until either side closes it.
async fn attend(stream: TcpStream, client: IpAddr, site: &Site, patience: Duration, place: &Place) {
    // A client that stops reading keeps its connection for this long. These options have an effect on speed and
    // patience alone, so that their failure does no harm.
    let _ = SockRef::from(&stream).set_tcp_user_timeout(Some(patience));
    let _ = stream.set_nodelay(true);
    let service = service_fn(|request| async move { Ok::<_, Infallible>(site.respond(request, client, place).await) });
    let mut server = http1::Builder::new();
    server.timer(TokioTimer::new()).header_read_timeout(patience).max_buf_size(BUFFER_BYTES);
    select! {
        // Ends with an error if the client goes away, which is no fault.
        _ = server.serve_connection(TokioIo::new(stream), service) => {}
        () = place.lost() => {}
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use socket2::{Domain, Socket, Type};

    use super::*;

    /// Serves one connection over which these bytes came, and returns when it has ended. The client reads nothing.
    fn serve_once(bytes: &[u8]) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = listen(([127, 0, 0, 1], 0).into()).unwrap();
            let mut client = Socket::new(Domain::IPV4, Type::STREAM, None).unwrap();
            client.set_recv_buffer_size(4096).unwrap();
            client.connect(&listener.local_addr().unwrap().into()).unwrap();
            client.write_all(bytes).unwrap();
            let (stream, address) = listener.accept().await.unwrap();
            let hint = Hint { place: String::new(), links: Vec::new() };
            let site = Site::of_packets(None, &hint, watch::channel(Snapshot::default()).1);
            let (patience, place) = (Duration::from_millis(200), Places::default().enter(1, address.ip()));
            let ended =
                tokio::time::timeout(Duration::from_mins(1), attend(stream, address.ip(), &site, patience, &place))
                    .await;
            assert!(ended.is_ok(), "the connection goes on");
            drop(client);
        });
    }

    #[test]
    fn a_client_that_asks_for_much_and_reads_nothing_is_disconnected() {
        serve_once(&b"GET /face/head.js HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(100));
    }

    #[test]
    fn a_client_that_does_not_finish_its_request_is_disconnected() {
        serve_once(b"");
        serve_once(b"GET / HTTP/1.1\r\nHost: local");
    }

    #[test]
    fn a_client_that_asks_for_nothing_more_is_disconnected() {
        serve_once(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
    }
}
