//! The part of HTTP that clients of the metrics need: one request and one response per connection.

use std::io::{self, Read};

use httparse::{EMPTY_HEADER, Request, Status};

/// Size limit of a request. The requests of Prometheus have about 300 bytes.
const MAX_REQUEST_BYTES: usize = 4096;
const MAX_HEADERS: usize = 32;
/// The only path that is served.
const PATH: &str = "/metrics";

/// Why a request is answered with an error instead of the metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Refusal {
    /// The bytes are no HTTP request, or the connection ended before the request was complete.
    BadRequest,
    /// The path is not [`PATH`].
    NotFound,
    /// The method is not GET.
    MethodNotAllowed,
    /// The request exceeds [`MAX_REQUEST_BYTES`] or [`MAX_HEADERS`].
    TooLong,
}

impl Refusal {
    /// Returns the complete HTTP response.
    pub(super) fn response(self) -> String {
        let (status, text) = match self {
            Self::BadRequest => ("400 Bad Request", "this is not an HTTP request\n"),
            Self::NotFound => ("404 Not Found", "the only page is /metrics\n"),
            Self::MethodNotAllowed => ("405 Method Not Allowed\r\nAllow: GET", "use GET\n"),
            Self::TooLong => ("431 Request Header Fields Too Large", "the request is too long\n"),
        };
        response(status, "text/plain; charset=utf-8", text)
    }
}

/// Returns the complete HTTP response that delivers `page`.
pub(super) fn ok(content_type: &str, page: &str) -> String {
    response("200 OK", content_type, page)
}

fn response(status: &str, content_type: &str, body: &str) -> String {
    let length = body.len();
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )
}

/// Reads a request and checks that it asks for the metrics.
///
/// # Errors
/// The connection failed or reached its deadline.
pub(super) fn read(connection: &mut impl Read) -> io::Result<Result<(), Refusal>> {
    let (mut bytes, mut filled) = ([0; MAX_REQUEST_BYTES], 0);
    loop {
        let Some(free) = bytes.get_mut(filled..).filter(|free| !free.is_empty()) else {
            return Ok(Err(Refusal::TooLong));
        };
        let read = connection.read(free)?;
        filled += read;
        match parse(bytes.get(..filled).unwrap_or_default()) {
            Some(outcome) => return Ok(outcome),
            None if read == 0 => return Ok(Err(Refusal::BadRequest)),
            None => {}
        }
    }
}

/// Parses the bytes received so far. Returns `None` while the request is incomplete.
fn parse(bytes: &[u8]) -> Option<Result<(), Refusal>> {
    let mut headers = [EMPTY_HEADER; MAX_HEADERS];
    let mut request = Request::new(&mut headers);
    Some(match request.parse(bytes) {
        Ok(Status::Partial) => return None,
        Ok(Status::Complete(_)) if request.method != Some("GET") => Err(Refusal::MethodNotAllowed),
        Ok(Status::Complete(_)) if request.path.and_then(|path| path.split('?').next()) != Some(PATH) => {
            Err(Refusal::NotFound)
        }
        Ok(Status::Complete(_)) => Ok(()),
        Err(httparse::Error::TooManyHeaders) => Err(Refusal::TooLong),
        Err(_) => Err(Refusal::BadRequest),
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn outcome(request: &str) -> Result<(), Refusal> {
        read(&mut request.as_bytes()).unwrap()
    }

    #[test]
    fn only_get_requests_for_the_path_of_the_metrics_are_accepted() {
        assert_eq!(outcome("GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n"), Ok(()));
        assert_eq!(outcome("GET /metrics?name=x HTTP/1.0\r\n\r\n"), Ok(()));
        assert_eq!(outcome("GET / HTTP/1.1\r\n\r\n"), Err(Refusal::NotFound));
        assert_eq!(outcome("POST /metrics HTTP/1.1\r\n\r\n"), Err(Refusal::MethodNotAllowed));
    }

    #[test]
    fn malformed_incomplete_and_too_long_requests_are_refused() {
        assert_eq!(outcome(""), Err(Refusal::BadRequest));
        assert_eq!(outcome("GET /metrics HTTP/1.1\r\nHost"), Err(Refusal::BadRequest), "cut short");
        assert_eq!(outcome("\u{1}\u{2}\r\n\r\n"), Err(Refusal::BadRequest));
        let long = format!("GET /metrics HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(MAX_REQUEST_BYTES));
        assert_eq!(outcome(&long), Err(Refusal::TooLong));
        let many = format!("GET /metrics HTTP/1.1\r\n{}\r\n", "X: x\r\n".repeat(MAX_HEADERS + 1));
        assert_eq!(outcome(&many), Err(Refusal::TooLong));
    }

    #[test]
    fn a_request_that_arrives_byte_by_byte_is_accepted_once_complete() {
        struct Slow<'a>(&'a [u8]);
        impl Read for Slow<'_> {
            fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
                let one = bytes.len().min(1);
                self.0.read(bytes.get_mut(..one).unwrap())
            }
        }
        let mut slow = Slow(b"GET /metrics HTTP/1.1\r\n\r\nmore");
        assert_eq!(read(&mut slow).unwrap(), Ok(()));
        assert_eq!(slow.0, b"more", "bytes after the request are not read");
    }

    #[test]
    fn a_response_states_its_length_and_that_the_connection_closes() {
        let text = Refusal::MethodNotAllowed.response();
        assert!(text.starts_with("HTTP/1.1 405 Method Not Allowed\r\nAllow: GET\r\n"), "{text}");
        assert!(text.contains("\r\nContent-Length: 8\r\nConnection: close\r\n\r\nuse GET"), "{text}");
    }
}
