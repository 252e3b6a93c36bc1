//! Decides which requests are answered.
//!
//! A page of somebody else in the same browser must not read this one. It could try with requests to the loopback
//! address, which `Origin` and `Sec-Fetch-Site` betray, or by DNS rebinding: its own name then has the address of this
//! machine, which `Host` betrays. An address in place of a name cannot be rebound. A change needs POST with JSON, which
//! a page of somebody else cannot send without being asked first.
//!
//! A proxy on this machine passes requests on for others, who must not count as being here.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use hyper::{
    HeaderMap, Method, Request, StatusCode, Version,
    header::{FORWARDED, HOST, ORIGIN, VIA},
    http::uri::Authority,
};

use super::{Refusal, token::Token};

const METHOD: Refusal = Refusal::fixed(StatusCode::METHOD_NOT_ALLOWED, "Nothing here is changed this way: use GET.\n");
const OTHER_HOST: Refusal = Refusal::fixed(
    StatusCode::MISDIRECTED_REQUEST,
    "This machine is not known by this name. Open the address that facewire-console printed. If it operates a service, you can \
     then add this name to names in the section [console] of the settings.\n",
);
const OTHER_PAGE: Refusal =
    Refusal::fixed(StatusCode::FORBIDDEN, "Only the page of facewire-console itself may read this.\n");
const NO_TOKEN: Refusal = Refusal::fixed(
    StatusCode::FORBIDDEN,
    "The address lacks the token. Open the whole address that facewire-console printed when it started.\n",
);

const FORWARDED_FOR: &str = "x-forwarded-for";
const FORWARDED_PROTO: &str = "x-forwarded-proto";

/// How a request has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Route {
    /// Who has sent it. If a proxy on this machine passed it on, this is the client that the proxy names.
    pub client: IpAddr,
    /// Whether the client is on this machine, and no sign of a proxy shows.
    pub is_local: bool,
    /// Whether a proxy says that the request came to it encrypted.
    pub is_encrypted: bool,
}

impl Route {
    pub fn of<B>(request: &Request<B>, peer: IpAddr) -> Self {
        let (headers, peer) = (request.headers(), peer.to_canonical());
        let proxies =
            [FORWARDED.as_str(), VIA.as_str(), FORWARDED_FOR, FORWARDED_PROTO, "x-forwarded-host", "x-real-ip"];
        let is_forwarded = proxies.iter().any(|name| headers.contains_key(*name));
        // A proxy that adds no header may keep the name, or speak HTTP/1.0, as nginx does by default.
        let host = text(headers, HOST.as_str()).and_then(|host| host.parse::<Authority>().ok());
        let is_direct = request.version() == Version::HTTP_11 && host.is_some_and(|host| is_loopback(host.host()));
        // The last proxy, which is ours, adds the address that it sees at the end.
        let named = headers.get_all(FORWARDED_FOR).iter().next_back().and_then(|value| value.to_str().ok());
        let named = named.and_then(|names| names.rsplit(',').next()?.trim().parse::<IpAddr>().ok());
        Self {
            client: named.filter(|_| peer.is_loopback()).unwrap_or(peer).to_canonical(),
            is_local: peer.is_loopback() && is_direct && !is_forwarded,
            is_encrypted: text(headers, FORWARDED_PROTO) == Some("https"),
        }
    }
}

fn is_loopback(host: &str) -> bool {
    host.eq_ignore_ascii_case("localhost") || address(host).is_some_and(|address| address.is_loopback())
}

/// Returns the address that stands in place of a name.
fn address(host: &str) -> Option<IpAddr> {
    let v6 = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
    let v6 = v6.and_then(|v6| v6.parse::<Ipv6Addr>().ok()).map(IpAddr::from);
    v6.or_else(|| host.parse::<Ipv4Addr>().ok().map(IpAddr::from))
}

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

    /// Returns the path of the part that is asked for, without the token. `own_names` are names of this machine, too.
    pub fn check<'a, B>(&self, request: &'a Request<B>, own_names: &[String]) -> Result<&'a str, Refusal> {
        let is_change = *request.method() == Method::POST && self.takes_changes;
        if !is_change && !matches!(*request.method(), Method::GET | Method::HEAD) {
            return Err(METHOD);
        }
        let host = text(request.headers(), HOST.as_str()).unwrap_or_default();
        if !self.is_this_machine(host, own_names) {
            return Err(OTHER_HOST);
        }
        // No page of somebody else can send this header without being asked first.
        let is_encrypted = text(request.headers(), FORWARDED_PROTO) == Some("https");
        let scheme = if is_encrypted { "https://" } else { "http://" };
        let origin = request.headers().contains_key(ORIGIN).then(|| text(request.headers(), ORIGIN.as_str()));
        if origin.is_some_and(|origin| origin.and_then(|origin| origin.strip_prefix(scheme)) != Some(host)) {
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
    fn is_this_machine(&self, host: &str, own_names: &[String]) -> bool {
        let Ok(authority) = host.parse::<Authority>() else { return false };
        if authority.as_str().contains('@') {
            return false;
        }
        let (is_address, host) = (address(authority.host()).is_some(), authority.host().to_lowercase());
        is_address || self.names.contains(&host) || own_names.contains(&host)
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
        guard.check(&request.body(()).unwrap(), &["head.fritz.box".to_owned()]).map(str::to_owned)
    }

    #[test]
    fn only_who_comes_without_a_proxy_and_by_a_name_of_loopback_is_on_this_machine() {
        let route = |version, peer: &str, headers: &[(&str, &str)]| {
            let mut request = Request::builder().version(version);
            for (name, value) in headers {
                request = request.header(*name, *value);
            }
            Route::of(&request.body(()).unwrap(), peer.parse().unwrap())
        };
        let own = ("host", "localhost:5252");
        for (peer, host) in [("127.0.0.1", "localhost:5252"), ("::1", "[::1]"), ("::ffff:127.0.0.1", "127.0.0.1:80")] {
            assert!(route(Version::HTTP_11, peer, &[("host", host)]).is_local, "{peer} {host}");
        }
        for header in ["x-forwarded-for", "x-forwarded-proto", "x-real-ip", "forwarded", "via"] {
            assert!(!route(Version::HTTP_11, "127.0.0.1", &[own, (header, "127.0.0.1")]).is_local, "{header}");
        }
        for host in ["head.lan", "192.168.1.5", "localhost.evil.example", ""] {
            assert!(!route(Version::HTTP_11, "127.0.0.1", &[("host", host)]).is_local, "{host}");
        }
        assert!(!route(Version::HTTP_10, "127.0.0.1", &[own]).is_local);
        assert!(!route(Version::HTTP_11, "192.168.1.5", &[own]).is_local);
        // Whoever is tried by a proxy here is named by it, and nobody else can name somebody else.
        let chain = ("x-forwarded-for", "127.0.0.1, 10.0.0.9, 2001:db8::1");
        let client = |peer| route(Version::HTTP_11, peer, &[own, chain]).client.to_string();
        assert_eq!(["127.0.0.1", "192.168.1.5"].map(client), ["2001:db8::1", "192.168.1.5"]);
    }

    #[test]
    fn a_page_behind_a_proxy_that_encrypts_may_read_and_change_by_an_own_name() {
        let (guard, host) = (Guard::new(None, true), ("host", "head.fritz.box"));
        let https = ("x-forwarded-proto", "https");
        assert!(check(&guard, "/a", &[host, https, ("origin", "https://head.fritz.box")]).is_ok());
        assert!(check(&guard, "/a", &[host, ("origin", "http://head.fritz.box")]).is_ok());
        for headers in
            [[host, https, ("origin", "http://head.fritz.box")], [host, https, ("origin", "https://fritz.box")]]
        {
            assert_eq!(check(&guard, "/a", &headers), Err(OTHER_PAGE));
        }
        assert_eq!(check(&guard, "/a", &[host, ("origin", "https://head.fritz.box")]), Err(OTHER_PAGE));
        assert_eq!(check(&guard, "/a", &[("host", "fritz.box"), https]), Err(OTHER_HOST));
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
