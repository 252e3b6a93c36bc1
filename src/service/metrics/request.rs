//! HTTP, as much as a reader of metrics needs: one request, one answer, and the connection is closed.

use std::io::{self, Read};

use httparse::{EMPTY_HEADER, Request, Status};

/// Longest request. Prometheus' own has about 300 bytes.
const MOST_BYTES: usize = 4096;
/// Most headers.
const MOST_HEADERS: usize = 32;
/// The only thing there is.
const PATH: &str = "/metrics";

/// Why a request is not answered with the metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Refusal {
    /// No request, or the connection ended in the middle.
    Bad,
    /// Another path.
    Unknown,
    /// Not GET.
    Method,
    /// More than is read.
    TooLong,
}

impl Refusal {
    /// The whole answer.
    pub(super) fn answer(self) -> String {
        let (status, text) = match self {
            Self::Bad => ("400 Bad Request", "this is no HTTP request\n"),
            Self::Unknown => ("404 Not Found", "there is /metrics only\n"),
            Self::Method => ("405 Method Not Allowed\r\nAllow: GET", "metrics can be read only\n"),
            Self::TooLong => ("431 Request Header Fields Too Large", "this request is too long\n"),
        };
        answer(status, "text/plain; charset=utf-8", text)
    }
}

/// The answer that has the page.
pub(super) fn found(content_type: &str, page: &str) -> String {
    answer("200 OK", content_type, page)
}

fn answer(status: &str, content_type: &str, body: &str) -> String {
    let length = body.len();
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )
}

/// Reads a request; whether it asks for the metrics.
///
/// # Errors
/// The connection fails, or its time is over.
pub(super) fn read(peer: &mut impl Read) -> io::Result<Result<(), Refusal>> {
    let (mut bytes, mut filled) = ([0; MOST_BYTES], 0);
    loop {
        let Some(free) = bytes.get_mut(filled..).filter(|free| !free.is_empty()) else {
            return Ok(Err(Refusal::TooLong));
        };
        let read = peer.read(free)?;
        filled += read;
        match judge(bytes.get(..filled).unwrap_or_default()) {
            Some(judged) => return Ok(judged),
            None if read == 0 => return Ok(Err(Refusal::Bad)),
            None => {}
        }
    }
}

/// What the bytes ask for; `None` if there must be more of them.
fn judge(bytes: &[u8]) -> Option<Result<(), Refusal>> {
    let mut headers = [EMPTY_HEADER; MOST_HEADERS];
    let mut request = Request::new(&mut headers);
    Some(match request.parse(bytes) {
        Ok(Status::Partial) => return None,
        Ok(Status::Complete(_)) if request.method != Some("GET") => Err(Refusal::Method),
        Ok(Status::Complete(_)) if request.path.and_then(|path| path.split('?').next()) != Some(PATH) => {
            Err(Refusal::Unknown)
        }
        Ok(Status::Complete(_)) => Ok(()),
        Err(httparse::Error::TooManyHeaders) => Err(Refusal::TooLong),
        Err(_) => Err(Refusal::Bad),
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn judged(request: &str) -> Result<(), Refusal> {
        read(&mut request.as_bytes()).unwrap()
    }

    #[test]
    fn metrics_can_be_read_at_their_path_and_nothing_else() {
        assert_eq!(judged("GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n"), Ok(()));
        assert_eq!(judged("GET /metrics?name=x HTTP/1.0\r\n\r\n"), Ok(()));
        assert_eq!(judged("GET / HTTP/1.1\r\n\r\n"), Err(Refusal::Unknown));
        assert_eq!(judged("POST /metrics HTTP/1.1\r\n\r\n"), Err(Refusal::Method));
    }

    #[test]
    fn what_is_no_request_or_too_long_is_refused() {
        assert_eq!(judged(""), Err(Refusal::Bad));
        assert_eq!(judged("GET /metrics HTTP/1.1\r\nHost"), Err(Refusal::Bad), "cut short");
        assert_eq!(judged("\u{1}\u{2}\r\n\r\n"), Err(Refusal::Bad));
        let long = format!("GET /metrics HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(MOST_BYTES));
        assert_eq!(judged(&long), Err(Refusal::TooLong));
        let many = format!("GET /metrics HTTP/1.1\r\n{}\r\n", "X: x\r\n".repeat(MOST_HEADERS + 1));
        assert_eq!(judged(&many), Err(Refusal::TooLong));
    }

    #[test]
    fn a_request_that_comes_byte_by_byte_is_whole_at_its_end() {
        struct Slow<'a>(&'a [u8]);
        impl Read for Slow<'_> {
            fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
                let one = bytes.len().min(1);
                self.0.read(bytes.get_mut(..one).unwrap())
            }
        }
        let mut slow = Slow(b"GET /metrics HTTP/1.1\r\n\r\nmore");
        assert_eq!(read(&mut slow).unwrap(), Ok(()));
        assert_eq!(slow.0, b"more", "what follows is left alone");
    }

    #[test]
    fn an_answer_states_its_length_and_closes_the_connection() {
        let text = Refusal::Method.answer();
        assert!(text.starts_with("HTTP/1.1 405 Method Not Allowed\r\nAllow: GET\r\n"), "{text}");
        assert!(text.contains("\r\nContent-Length: 25\r\nConnection: close\r\n\r\nmetrics can"), "{text}");
    }
}
