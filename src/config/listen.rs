//! The address at which the service offers its metrics.

use std::{
    fmt,
    net::SocketAddr,
    path::{Path, PathBuf},
};

use toml::de::DeValue;

use super::value::{Value, quoted};

/// Prefix of the path of a Unix socket.
const UNIX: &str = "unix:";

/// An address that only programs on this machine can reach.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Listen {
    /// No address: there are no metrics.
    #[default]
    Off,
    /// A loopback address.
    Tcp(SocketAddr),
    /// A Unix socket.
    Unix(PathBuf),
}

impl Listen {
    /// Reads an address. Returns `None` for an address that other machines can reach, for port 0, and for a path that
    /// is not absolute.
    #[must_use]
    pub fn new(text: &str) -> Option<Self> {
        if text.is_empty() {
            return Some(Self::Off);
        }
        if let Some(path) = text.strip_prefix(UNIX) {
            return Path::new(path).is_absolute().then(|| Self::Unix(path.into()));
        }
        let address: SocketAddr = text.parse().ok()?;
        (address.ip().is_loopback() && address.port() != 0).then_some(Self::Tcp(address))
    }
}

impl fmt::Display for Listen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => Ok(()),
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "{UNIX}{}", path.display()),
        }
    }
}

impl Value for Listen {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        value.as_str().and_then(Self::new)
    }

    fn expected((): &()) -> String {
        "\"\", a loopback address and port such as \"127.0.0.1:9464\" or \"[::1]:9464\", or \"unix:\" and a path that begins \
         with /"
            .to_owned()
    }

    fn write(&self) -> String {
        quoted(&self.to_string())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_can_reach_it() {
        for good in ["127.0.0.1:9464", "127.0.0.2:1", "[::1]:9464", "unix:/run/facewire/metrics.sock", ""] {
            assert_eq!(Listen::new(good).unwrap().to_string(), good);
        }
        for bad in ["0.0.0.0:9464", "[::]:9464", "192.168.1.5:9464", "localhost:9464", "127.0.0.1", "127.0.0.1:0"] {
            assert_eq!(Listen::new(bad), None, "{bad}");
        }
        for bad in ["unix:", "unix:metrics.sock", "9464", ":9464", "/run/facewire/metrics.sock"] {
            assert_eq!(Listen::new(bad), None, "{bad}");
        }
    }
}
