//! Decides which requests are answered.
//!
//! A page of somebody else in the same browser must not read this one. It could try with requests to the loopback
//! address, which `Origin` and `Sec-Fetch-Site` betray, or by DNS rebinding: its own name then has the address of this
//! machine, which `Host` betrays. An address in place of a name cannot be rebound. A change needs POST with JSON, which
//! a page of somebody else cannot send without being asked first.

use std::net::{Ipv4Addr, Ipv6Addr};

use hyper::{
    HeaderMap, Method, Request, StatusCode,
    header::{HOST, ORIGIN},
    http::uri::Authority,
};

use super::{Refusal, token::Token};

const METHOD: Refusal = Refusal::fixed(StatusCode::METHOD_NOT_ALLOWED, "Nothing here is changed this way: use GET.\n");
const OTHER_HOST: Refusal = Refusal::fixed(
    StatusCode::MISDIRECTED_REQUEST,
    "This machine has another name. Open the address that facewire-console printed.\n",
);
const OTHER_PAGE: Refusal =
    Refusal::fixed(StatusCode::FORBIDDEN, "Only the page of facewire-console itself may read this.\n");
const NO_TOKEN: Refusal = Refusal::fixed(
    StatusCode::FORBIDDEN,
    "The address lacks the token. Open the whole address that facewire-console printed when it started.\n",
);

/// The rules for requests.
#[derive(Debug)]
pub struct Guard {
    /// Whether requests may change something.
    takes_changes: bool,
    token: Option<Token>,
    /// The names under which this machine may be addressed, in lower case.
    names: Vec<String>,
}

impl Guard {
    pub fn new(token: Option<Token>, takes_changes: bool) -> Self {
        let mut names = vec!["localhost".to_owned()];
        if let Some(name) = nix::unistd::gethostname().ok().and_then(|name| name.into_string().ok()) {
            let name = name.to_lowercase();
            names.extend([format!("{name}.local"), name]);
        }
        Self { takes_changes, token, names }
    }

    /// Returns the path of the part that is asked for, without the token.
    pub fn check<'a, B>(&self, request: &'a Request<B>) -> Result<&'a str, Refusal> {
        let is_change = *request.method() == Method::POST && self.takes_changes;
        if !is_change && !matches!(*request.method(), Method::GET | Method::HEAD) {
            return Err(METHOD);
        }
        let host = text(request.headers(), HOST.as_str()).unwrap_or_default();
        if !self.is_this_machine(host) {
            return Err(OTHER_HOST);
        }
        let origin = request.headers().contains_key(ORIGIN).then(|| text(request.headers(), ORIGIN.as_str()));
        if origin.is_some_and(|origin| origin.and_then(|origin| origin.strip_prefix("http://")) != Some(host)) {
            return Err(OTHER_PAGE);
        }
        let path = self.below_token(request.uri().path())?;
        let is_linked = |site: &str| matches!(site, "same-origin" | "none");
        let site = text(request.headers(), "sec-fetch-site");
        // Other pages may link to the page itself.
        if (is_change || !path.is_empty()) && site.is_some_and(|site| !is_linked(site)) {
            Err(OTHER_PAGE)
        } else {
            Ok(path)
        }
    }

    /// Whether the header `Host` names this machine. Any port is accepted, because it may be forwarded.
    fn is_this_machine(&self, host: &str) -> bool {
        let Ok(authority) = host.parse::<Authority>() else { return false };
        if authority.as_str().contains('@') {
            return false;
        }
        let host = authority.host();
        let v6 = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        let is_address = host.parse::<Ipv4Addr>().is_ok() || v6.is_some_and(|v6| v6.parse::<Ipv6Addr>().is_ok());
        is_address || self.names.contains(&host.to_lowercase())
    }

    fn below_token<'a>(&self, path: &'a str) -> Result<&'a str, Refusal> {
        let path = path.strip_prefix('/').unwrap_or(path);
        let Some(token) = &self.token else { return Ok(path) };
        let (given, rest) = path.split_once('/').ok_or(NO_TOKEN)?;
        if token.is(given) { Ok(rest) } else { Err(NO_TOKEN) }
    }
}

/// Returns the header if there is exactly one, and it is text.
fn text<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(guard: &Guard, path: &str, headers: &[(&str, &str)]) -> Result<String, Refusal> {
        let mut request = Request::builder().uri(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        guard.check(&request.body(()).unwrap()).map(str::to_owned)
    }

    #[test]
    fn addresses_and_names_of_this_machine_are_answered_and_others_are_not() {
        let guard = Guard {
            takes_changes: false,
            token: None,
            names: vec!["localhost".into(), "desk".into(), "desk.local".into()],
        };
        for host in ["127.0.0.1:5252", "localhost:9", "LocalHost", "[::1]:5252", "192.168.1.5", "desk", "desk.local:80"]
        {
            assert_eq!(check(&guard, "/app.js", &[("host", host)]), Ok("app.js".into()), "{host}");
        }
        for host in
            ["", "evil.example", "127.0.0.1.evil.example", "localhost.evil.example", "a@127.0.0.1", "[::1", "1.2.3"]
        {
            assert_eq!(check(&guard, "/", &[("host", host)]), Err(OTHER_HOST), "{host}");
        }
        assert_eq!(check(&guard, "/", &[]), Err(OTHER_HOST));
        assert_eq!(check(&guard, "/", &[("host", "localhost"), ("host", "evil.example")]), Err(OTHER_HOST));
    }

    #[test]
    fn other_pages_may_link_here_and_nothing_else() {
        let (guard, host) = (Guard::new(None, false), ("host", "127.0.0.1:5252"));
        for origin in ["http://evil.example", "http://127.0.0.1:80", "https://127.0.0.1:5252", "null", ""] {
            assert_eq!(check(&guard, "/events", &[host, ("origin", origin)]), Err(OTHER_PAGE), "{origin}");
        }
        assert!(check(&guard, "/events", &[host, ("origin", "http://127.0.0.1:5252")]).is_ok());
        for site in ["cross-site", "same-site"] {
            assert_eq!(check(&guard, "/events", &[host, ("sec-fetch-site", site)]), Err(OTHER_PAGE), "{site}");
            assert!(check(&guard, "/", &[host, ("sec-fetch-site", site)]).is_ok(), "{site}");
        }
        assert!(check(&guard, "/events", &[host, ("sec-fetch-site", "same-origin")]).is_ok());
    }

    #[test]
    fn with_a_token_nothing_is_answered_without_it() {
        let token = Token::random().unwrap();
        let (guard, host) = (Guard::new(Some(token.clone()), false), ("host", "192.168.1.5:8080"));
        assert_eq!(check(&guard, &format!("/{token}/"), &[host]), Ok(String::new()));
        assert_eq!(check(&guard, &format!("/{token}/events"), &[host]), Ok("events".into()));
        for path in ["/", "/events", "//events", "/0/", &format!("/{token}"), &format!("/{token}0/")] {
            assert_eq!(check(&guard, path, &[host]), Err(NO_TOKEN), "{path}");
        }
    }
}
