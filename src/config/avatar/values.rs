//! Types of the settings of links to head-mounted displays and avatars.

use std::{
    fmt,
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
};

use toml::de::DeValue;

use crate::config::value::{Address, Value, quoted};

/// A text of printable ASCII characters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Text(String);

impl Text {
    /// The text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<&str> for Text {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl Value for Text {
    /// The least and the greatest number of characters.
    type Bounds = std::ops::RangeInclusive<usize>;

    fn read(value: &DeValue<'_>, bounds: &Self::Bounds) -> Option<Self> {
        let text = value.as_str().filter(|text| text.bytes().all(|byte| (b' '..=b'~').contains(&byte)))?;
        bounds.contains(&text.len()).then(|| text.into())
    }

    fn expected(bounds: &Self::Bounds) -> String {
        let (least, most) = (bounds.start(), bounds.end());
        let count = if least == most { most.to_string() } else { format!("{least} to {most}") };
        format!("{count} printable ASCII characters in quotes")
    }

    fn write(&self) -> String {
        quoted(&self.0)
    }
}

/// The part of an OSC address between `/avatar/parameters/` and `v2/`: empty, or ending with a slash.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OscPrefix(String);

/// Most characters of a prefix.
const LONGEST_PREFIX: usize = 64;

impl OscPrefix {
    /// The text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl Value for OscPrefix {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        let text = value.as_str()?;
        // OSC gives a meaning to the other characters.
        let is_good = |byte: u8| byte.is_ascii_alphanumeric() || b"/_-.".contains(&byte);
        let is_prefix = text.is_empty() || text.ends_with('/') && !text.starts_with('/');
        let is_read = is_prefix && text.len() <= LONGEST_PREFIX && text.bytes().all(is_good);
        is_read.then(|| Self(text.to_owned()))
    }

    fn expected((): &()) -> String {
        format!("\"\", or up to {LONGEST_PREFIX} letters, digits and _ - . / that end with a slash, such as \"FT/\"")
    }

    fn write(&self) -> String {
        quoted(&self.0)
    }
}

/// How a parameter is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ParameterChoice {
    /// Whether it is sent as a number.
    pub number: bool,
    /// As how many bits it is sent; 0 for none.
    pub bits: u32,
}

/// A list of parameters. An empty list stands for all.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Parameters(Vec<(&'static str, u32)>);

impl Parameters {
    /// Whether the list names the parameters to send.
    #[must_use]
    pub fn names_any(&self) -> bool {
        !self.0.is_empty()
    }

    /// Returns how a parameter is sent, and `general` for all if the list is empty.
    #[must_use]
    pub fn of(&self, name: &str, general: ParameterChoice) -> Option<ParameterChoice> {
        if !self.names_any() {
            return Some(general);
        }
        let (_, bits) = self.0.iter().find(|(named, _)| *named == name)?;
        Some(ParameterChoice { number: *bits == 0, bits: *bits })
    }
}

impl Value for Parameters {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        let entries = value.as_str()?.split(',').map(str::trim).filter(|entry| !entry.is_empty());
        let entry = |entry: &str| {
            let (name, bits) = entry.split_once(':').unwrap_or((entry, "0"));
            let bits = bits.parse().ok().filter(|bits| *bits <= MOST_BITS)?;
            crate::link::vrchat_parameters().find(|known| *known == name).map(|known| (known, bits))
        };
        entries.map(entry).collect::<Option<_>>().map(Self)
    }

    fn expected((): &()) -> String {
        format!(
            "\"\", or names of parameters of VRCFaceTracking v2 with commas between them, each with up to {MOST_BITS} bits, \
             such as \"JawOpen, SmileFrown:4\""
        )
    }

    fn write(&self) -> String {
        let entry = |(name, bits): &(&str, u32)| if *bits == 0 { (*name).to_owned() } else { format!("{name}:{bits}") };
        quoted(&self.0.iter().map(entry).collect::<Vec<_>>().join(", "))
    }
}

/// Most bits of a binary parameter.
pub(in crate::config) const MOST_BITS: u32 = 8;

/// An address of this machine at which a link listens, or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ListenAddress(pub Option<SocketAddr>);

impl ListenAddress {
    /// All IPv4 addresses of this machine.
    pub(super) fn any(port: u16) -> Self {
        Self(Some((Ipv4Addr::UNSPECIFIED, port).into()))
    }
}

impl Value for ListenAddress {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        match value.as_str()? {
            "" => Some(Self(None)),
            text => {
                text.parse().ok().filter(|address: &SocketAddr| address.port() != 0).map(|address| Self(Some(address)))
            }
        }
    }

    fn expected((): &()) -> String {
        "\"\", or an address of this machine in numbers and a port from 1 to 65535, such as \"0.0.0.0:49983\""
            .to_owned()
    }

    fn write(&self) -> String {
        quoted(&self.0.map_or_else(String::new, |address| address.to_string()))
    }
}

/// The address of a receiver, or none.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct MaybeAddress(pub Option<Address>);

impl Value for MaybeAddress {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        match value.as_str()? {
            "" => Some(Self(None)),
            text => Address::new(text).map(|address| Self(Some(address))),
        }
    }

    fn expected((): &()) -> String {
        format!("\"\", or {}", Address::expected(&()))
    }

    fn write(&self) -> String {
        quoted(self.0.as_ref().map_or("", Address::as_str))
    }
}

/// Where JSON lines go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JsonTarget {
    /// Standard output.
    Stdout,
    /// An address.
    Udp(Address),
    /// A Unix socket, by its path.
    Unix(PathBuf),
}

impl fmt::Display for JsonTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stdout => f.write_str("stdout"),
            Self::Udp(address) => write!(f, "udp:{address}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

impl Value for JsonTarget {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        let text = value.as_str()?;
        if text == "stdout" {
            Some(Self::Stdout)
        } else if let Some(address) = text.strip_prefix("udp:") {
            Address::new(address).map(Self::Udp)
        } else {
            text.strip_prefix("unix:").filter(|path| path.starts_with('/')).map(|path| Self::Unix(path.into()))
        }
    }

    fn expected((): &()) -> String {
        "\"stdout\", \"udp:host:port\" with a port from 1 to 65535, or \"unix:\" and a path that begins with /"
            .to_owned()
    }

    fn write(&self) -> String {
        quoted(&self.to_string())
    }
}
