//! Faults of links to applications that are valid one by one but cannot work.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
};

use super::{Fault, Faults, JsonTarget, LinkKind, Listen, VrchatSettings, settings::Settings, value::quoted};

/// Adds the faults of links to applications. `control` are the paths at which the service's control socket may be.
pub(super) fn check(settings: &Settings, control: &[PathBuf], faults: &mut Faults) {
    let mut together = |key, value, expected: &str| {
        faults.push(Fault::Together { key, value, expected: expected.to_owned() });
    };
    let (mut addresses, mut sockets) = (Vec::new(), Vec::new());
    for link in &settings.links {
        match &link.kind {
            LinkKind::IFacialMocap(it) => {
                let Some(listen) = it.listen.0 else { continue };
                if addresses.iter().any(|earlier| is_shared(*earlier, listen)) {
                    let expected = "another port, because an earlier link listens there, or \"\" with link.address";
                    together("link.listen", quoted(&listen.to_string()), expected);
                }
                addresses.push(listen);
            }
            LinkKind::Json(it) => {
                let JsonTarget::Unix(path) = &it.to else { continue };
                if let Some(user) = user(path, &sockets, settings, control) {
                    together("link.to", quoted(&it.to.to_string()), &format!("another path: {user} has this one"));
                }
                sockets.push(path);
            }
            LinkKind::Vrchat(it) if !sends_a_parameter(it) => {
                let (key, expected) = if !it.floats && it.bits == 0 {
                    ("link.floats", "true, or link.bits or link.parameters, because no parameter is sent otherwise")
                } else {
                    ("link.shapes", "true, or link.compounds or link.head, because no parameter is sent otherwise")
                };
                together(key, "false".to_owned(), expected);
            }
            _ => {}
        }
    }
}

/// Whether the system lets only one of two sockets have its address.
fn is_shared(one: SocketAddr, other: SocketAddr) -> bool {
    // A socket for all IPv6 addresses takes those of IPv4, too.
    let covers = |one: SocketAddr, other: SocketAddr| one.ip().is_unspecified() && (one.is_ipv6() || other.is_ipv4());
    one.port() == other.port() && (one.ip() == other.ip() || covers(one, other) || covers(other, one))
}

/// Returns what else has the path of a socket.
fn user(path: &Path, earlier: &[&PathBuf], settings: &Settings, control: &[PathBuf]) -> Option<&'static str> {
    let is_path = |other: &Path| other == path;
    if earlier.iter().any(|other| is_path(other)) {
        Some("an earlier link")
    } else if matches!(&settings.metrics.listen, Listen::Unix(other) if is_path(other)) {
        Some("metrics.listen")
    } else if control.iter().any(|other| is_path(other)) {
        Some("the control socket of the service")
    } else {
        None
    }
}

/// Whether a link to VRChat sends more than the status of the tracking.
fn sends_a_parameter(it: &VrchatSettings) -> bool {
    let sends_all = (it.floats || it.bits > 0) && (it.shapes || it.compounds || it.head);
    it.parameters.names_any() || it.native_eyes || sends_all
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::config::parse;

    fn faults(text: &str) -> String {
        parse("file", text).err().map_or_else(String::new, |faults| faults.to_string())
    }

    #[test]
    fn two_links_that_listen_at_one_port_are_refused() {
        let both = |one: &str, other: &str| {
            let link = |listen: &str| format!("[[link]]\nkind = \"ifacialmocap\"\nlisten = \"{listen}\"\n");
            faults(&(link(one) + &link(other)))
        };
        let want = "link.listen = \"127.0.0.1:5000\": give another port, because an earlier link listens there, or \"\" with \
                    link.address";
        for earlier in ["127.0.0.1:5000", "0.0.0.0:5000", "[::]:5000"] {
            assert_eq!(both(earlier, "127.0.0.1:5000"), want);
        }
        for earlier in ["127.0.0.1:5001", "127.0.0.2:5000", "[::1]:5000"] {
            assert_eq!(both(earlier, "127.0.0.1:5000"), "");
        }
    }

    #[test]
    fn a_socket_that_something_else_has_is_refused() {
        let link = "[[link]]\nkind = \"json\"\nto = \"unix:/run/x\"\n";
        let want = |user: &str| format!("link.to = \"unix:/run/x\": give another path: {user} has this one");
        assert_eq!(faults(link), "");
        assert_eq!(faults(&link.repeat(2)), want("an earlier link"));
        assert_eq!(faults(&format!("[metrics]\nlisten = \"unix:/run/x\"\n{link}")), want("metrics.listen"));
        let mut found = Faults::default();
        check(&parse("file", link).unwrap(), &["/run/x".into()], &mut found);
        assert_eq!(found.to_string(), want("the control socket of the service"));
    }

    #[test]
    fn a_link_to_vrchat_that_sends_nothing_is_refused() {
        let vrchat = |keys: &str| faults(&format!("[[link]]\nkind = \"vrchat\"\n{keys}\n"));
        let [no_form, no_group] = ["floats = false\n", "shapes = false\ncompounds = false\nhead = false\n"];
        assert!(vrchat(no_form).starts_with("link.floats = false: give true, or link.bits or"), "{}", vrchat(no_form));
        assert!(vrchat(no_group).starts_with("link.shapes = false: give true, or link.compounds or"));
        for enough in ["bits = 1", "native_eyes = true", "parameters = \"JawOpen\""] {
            assert_eq!(vrchat(&(no_form.to_owned() + enough)), "", "{enough}");
        }
        assert_eq!(vrchat("shapes = false\ncompounds = false\n"), "");
    }
}
