//! The web server: the page, its parts, and a stream of snapshots for each open page.
//!
//! Contract: at most [`MOST_CONNECTIONS`] connections and [`MOST_STREAMS`] streams, each with bounded buffers. A client
//! that sends no request, or does not read, loses its connection.

mod events;
mod guard;
mod page;
mod token;

use std::{convert::Infallible, io, net::SocketAddr, sync::Arc, time::Duration};

use http_body_util::{BodyExt as _, Full, combinators::BoxBody};
use hyper::{
    Request, Response, StatusCode,
    body::{Bytes, Incoming},
    header::{self, HeaderValue},
    server::conn::http1,
    service::service_fn,
};
use hyper_util::rt::{TokioIo, TokioTimer};
use socket2::SockRef;
use tokio::{
    net::{TcpListener, TcpSocket, TcpStream},
    sync::{Semaphore, watch},
    time::sleep,
};

pub use self::token::Token;
use self::{events::Events, guard::Guard};
use crate::{Failure, hint::Hint, snapshot::Snapshot};

/// A page takes one connection for its stream, and a few while it loads.
const MOST_CONNECTIONS: usize = 64;
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

type Body = BoxBody<Bytes, Infallible>;

/// All that is served.
#[derive(Debug)]
pub struct Site {
    guard: Guard,
    events: Events,
}

impl Site {
    /// Makes the site. A page on another machine needs a token.
    pub fn new(token: Option<Token>, hint: &Hint, snapshots: watch::Receiver<Snapshot>) -> Self {
        Self { guard: Guard::new(token), events: Events::new(hint, snapshots, MOST_STREAMS) }
    }

    fn respond(&self, request: &Request<Incoming>) -> Response<Body> {
        let mut response = self.answer(request).unwrap_or_else(Refusal::into_response);
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

    fn answer(&self, request: &Request<Incoming>) -> Result<Response<Body>, Refusal> {
        let path = self.guard.check(request)?;
        if path == "events" {
            return self.events.open();
        }
        let part = page::part(path).ok_or(Refusal::NOT_FOUND)?;
        Ok(response(StatusCode::OK, part.kind, part.bytes))
    }
}

fn response(status: StatusCode, kind: &'static str, bytes: &'static [u8]) -> Response<Body> {
    let mut response = Response::new(Full::new(Bytes::from_static(bytes)).boxed());
    *response.status_mut() = status;
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    response
}

/// Why a request gets nothing, with a sentence for the person at the browser.
#[derive(Debug, PartialEq, Eq)]
struct Refusal(StatusCode, &'static str);

impl Refusal {
    const NOT_FOUND: Self = Self(StatusCode::NOT_FOUND, "There is nothing at this address. Open / instead.\n");

    fn into_response(self) -> Response<Body> {
        response(self.0, "text/plain; charset=utf-8", self.1.as_bytes())
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
        socket.listen(128)
    };
    open().map_err(|error| Failure::Serve { address, error })
}

/// Serves for as long as the program runs.
pub async fn serve(listener: TcpListener, site: Arc<Site>) {
    let places = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            sleep(REFUSED_PAUSE).await;
            continue;
        };
        // If there is no place, the connection is closed at once.
        if let Ok(place) = Arc::clone(&places).try_acquire_owned() {
            let site = Arc::clone(&site);
            tokio::spawn(async move {
                attend(stream, &site, PATIENCE).await;
                drop(place);
            });
        }
    }
}

/// Serves one connection until either side closes it.
async fn attend(stream: TcpStream, site: &Site, patience: Duration) {
    // A client that stops reading keeps its connection for this long. These options have an effect on speed and
    // patience alone, so that their failure does no harm.
    let _ = SockRef::from(&stream).set_tcp_user_timeout(Some(patience));
    let _ = stream.set_nodelay(true);
    let service = service_fn(|request| async move { Ok::<_, Infallible>(site.respond(&request)) });
    let mut server = http1::Builder::new();
    server.timer(TokioTimer::new()).header_read_timeout(patience).max_buf_size(BUFFER_BYTES);
    // Ends with an error if the client goes away, which is no fault.
    let _ = server.serve_connection(TokioIo::new(stream), service).await;
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
            let (stream, _) = listener.accept().await.unwrap();
            let hint = Hint { place: String::new(), links: Vec::new() };
            let site = Site::new(None, &hint, watch::channel(Snapshot::default()).1);
            let patience = Duration::from_millis(200);
            let ended = tokio::time::timeout(Duration::from_mins(1), attend(stream, &site, patience)).await;
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
