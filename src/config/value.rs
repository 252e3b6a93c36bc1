//! The types of values: how each is read, checked and described.

use std::{fmt, net::SocketAddr, ops::RangeInclusive, path::PathBuf};

use toml::de::DeValue;

/// A type of value.
pub trait Value: Sized {
    type Bounds;

    /// Reads a value. If it has another type or is out of bounds, returns what to give instead; the text follows "give".
    fn read(value: &DeValue<'_>, bounds: &Self::Bounds) -> Result<Self, String>;
}

/// A type with a few named values.
pub trait Choice: Copy + PartialEq + 'static {
    const ALL: &'static [(&'static str, Self)];

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, value)| *value == self).map_or("", |(name, _)| name)
    }
}

/// Names the values of an enum, which it declares if it is not that of another crate.
macro_rules! choices {
    ($(#[doc = $doc:literal])* pub enum $type:ident: $( $variant:ident = $name:literal ),*) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $type {
            $( $variant, )*
        }

        choices! { $type: $( $variant = $name ),* }
    };
    ($type:ident: $( $variant:ident = $name:literal ),*) => {
        impl $crate::config::value::Choice for $type {
            const ALL: &'static [(&'static str, Self)] = &[ $( ($name, Self::$variant), )* ];
        }
    };
}

pub(super) use choices;

impl<T: Choice> Value for T {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Result<Self, String> {
        let named = value.as_str().and_then(|text| Self::ALL.iter().find(|(name, _)| *name == text));
        named.map(|(_, value)| *value).ok_or_else(|| one_of(Self::ALL.iter().map(|(name, _)| *name)))
    }
}

/// Describes a choice of these names.
pub fn one_of(names: impl Iterator<Item = &'static str>) -> String {
    format!("one of {}", names.map(quoted).collect::<Vec<_>>().join(", "))
}

/// Writes a text as a TOML string.
pub fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// The range of a number, and its unit as it follows the range in a message.
pub type Range<T> = (RangeInclusive<T>, &'static str);

/// Implements [`Value`] for types of whole numbers.
macro_rules! whole_number {
    ($($type:ty),*) => { $(
        impl Value for $type {
            type Bounds = Range<$type>;

            fn read(value: &DeValue<'_>, (range, unit): &Self::Bounds) -> Result<Self, String> {
                let number = |text: &str, radix| Self::from_str_radix(text, radix).ok();
                let number = value.as_integer().and_then(|integer| number(integer.as_str(), integer.radix()));
                let expected = || format!("a whole number from {} to {}{unit}", range.start(), range.end());
                number.filter(|number| range.contains(number)).ok_or_else(expected)
            }
        }
    )* };
}

whole_number!(u32, i32);

impl Value for f32 {
    type Bounds = Range<f32>;

    fn read(value: &DeValue<'_>, (range, unit): &Self::Bounds) -> Result<Self, String> {
        let number = match value {
            DeValue::Float(float) => float.as_str().parse().ok(),
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok(),
            _ => None,
        };
        let expected = || format!("a number from {:?} to {:?}{unit}", range.start(), range.end());
        number.filter(|number| range.contains(number)).ok_or_else(expected)
    }
}

impl Value for bool {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Result<Self, String> {
        value.as_bool().ok_or_else(|| "true or false".to_owned())
    }
}

/// Which texts a setting takes: their description, and whether a text is one of them.
pub type Texts = (&'static str, fn(&str) -> bool);

pub const ANY_TEXT: Texts = ("a text in quotes", |_| true);
pub const UP_TO_64_CHARACTERS: Texts =
    ("1 to 64 printable ASCII characters in quotes", |text| (1..=64).contains(&text.len()) && is_printable(text));
pub const EXACTLY_36_CHARACTERS: Texts =
    ("36 printable ASCII characters in quotes", |text| text.len() == 36 && is_printable(text));
/// The part of an OSC address between `/avatar/parameters/` and `v2/`. OSC gives a meaning to the other characters.
pub const OSC_PREFIX: Texts =
    ("\"\", or up to 64 letters, digits and _ - . / that end with a slash, such as \"FT/\"", |text| {
        let is_good = |byte: u8| byte.is_ascii_alphanumeric() || b"/_-.".contains(&byte);
        let is_prefix = text.is_empty() || text.ends_with('/') && !text.starts_with('/');
        is_prefix && text.len() <= 64 && text.bytes().all(is_good)
    });

fn is_printable(text: &str) -> bool {
    text.bytes().all(|byte| (b' '..=b'~').contains(&byte))
}

impl Value for String {
    type Bounds = Texts;

    fn read(value: &DeValue<'_>, (expected, takes): &Texts) -> Result<Self, String> {
        value.as_str().filter(|text| takes(text)).map(str::to_owned).ok_or_else(|| (*expected).to_owned())
    }
}

/// A value that may be left out, as an empty text.
impl<T: Value<Bounds = ()>> Value for Option<T> {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Result<Self, String> {
        match value.as_str() {
            Some("") => Ok(None),
            _ => T::read(value, &()).map(Some).map_err(|expected| format!("\"\", or {expected}")),
        }
    }
}

/// Implements [`Value`] for types that are read from a text: what is expected, and how the text is read.
macro_rules! read_from_text {
    ($type:ty, $expected:expr, $read:expr) => {
        impl Value for $type {
            type Bounds = ();

            fn read(value: &DeValue<'_>, (): &()) -> Result<Self, String> {
                value.as_str().and_then($read).ok_or_else(|| $expected.to_owned())
            }
        }
    };
}

read_from_text!(
    SocketAddr,
    "an address of this machine in numbers and a port from 1 to 65535, such as \"0.0.0.0:49983\"",
    |text| text.parse().ok().filter(|address: &Self| address.port() != 0)
);

/// A path from the root: a service has no folder that a relative path could start at.
fn absolute(path: &str) -> Option<PathBuf> {
    path.starts_with('/').then(|| path.into())
}

/// The serial port of a link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SerialDevice {
    /// What is plugged into USB.
    Auto,
    Path(PathBuf),
}

impl fmt::Display for SerialDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Path(path) => path.display().fmt(f),
        }
    }
}

read_from_text!(SerialDevice, "\"auto\", or a path in quotes that begins with /", |text| match text {
    "auto" => Some(Self::Auto),
    path => absolute(path).map(Self::Path),
});

/// A network address as it is written: `host:port`. The host is a name or an address; an IPv6 address has brackets.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Address(String);

impl Address {
    /// Reads an address. Returns `None` unless the text is a host, a colon and a port from 1 to 65535.
    pub fn new(text: &str) -> Option<Self> {
        let (host, port) = text.rsplit_once(':')?;
        let is_bracketed = host.starts_with('[') && host.ends_with(']');
        let is_host = !host.is_empty() && (is_bracketed || !host.contains(':'));
        let is_port = port.parse::<u16>().is_ok_and(|port| port != 0);
        (is_host && is_port).then(|| Self(text.to_owned()))
    }

    /// A port of this machine.
    pub(super) fn local(port: u16) -> Self {
        Self(format!("127.0.0.1:{port}"))
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

read_from_text!(Address, "\"host:port\" with a port from 1 to 65535", Self::new);

/// An address that only programs on this machine can reach.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listen {
    Off,
    /// A loopback address.
    Tcp(SocketAddr),
    Unix(PathBuf),
}

impl fmt::Display for Listen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => Ok(()),
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

read_from_text!(
    Listen,
    "\"\", a loopback address and port such as \"127.0.0.1:9464\" or \"[::1]:9464\", or \"unix:\" and a path that begins \
     with /",
    |text| match text.strip_prefix("unix:") {
        Some(path) => absolute(path).map(Self::Unix),
        None if text.is_empty() => Some(Self::Off),
        None => {
            let address = text.parse().ok().filter(|at: &SocketAddr| at.ip().is_loopback() && at.port() != 0);
            address.map(Self::Tcp)
        }
    }
);

/// Where JSON lines go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JsonTarget {
    Stdout,
    Udp(Address),
    /// A Unix socket.
    Unix(PathBuf),
}

read_from_text!(
    JsonTarget,
    "\"stdout\", \"udp:host:port\" with a port from 1 to 65535, or \"unix:\" and a path that begins with /",
    |text| match text.split_once(':') {
        None => (text == "stdout").then_some(Self::Stdout),
        Some(("udp", address)) => Address::new(address).map(Self::Udp),
        Some(("unix", path)) => absolute(path).map(Self::Unix),
        Some(_) => None,
    }
);

/// A list of parameters and the number of their bits. An empty list stands for all.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Parameters(Vec<(String, u32)>);

/// Most bits of a binary parameter.
pub const MOST_BITS: u32 = 8;

impl Parameters {
    pub const EXPECTED: &'static str = "\"\", or names of parameters of VRCFaceTracking v2 with commas between them, each \
                                        with up to 8 bits, such as \"JawOpen, SmileFrown:4\"";

    pub fn names_any(&self) -> bool {
        !self.0.is_empty()
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|(name, _)| name.as_str())
    }

    /// Returns whether a parameter is sent as a number, and as how many bits; `general` if the list is empty.
    pub fn of(&self, name: &str, general: (bool, u32)) -> Option<(bool, u32)> {
        let named = self.0.iter().find(|(named, _)| *named == name).map(|(_, bits)| (*bits == 0, *bits));
        if self.names_any() { named } else { Some(general) }
    }
}

read_from_text!(Parameters, Self::EXPECTED, |text| {
    let entry = |entry: &str| {
        let (name, bits) = entry.split_once(':').unwrap_or((entry, "0"));
        Some((name.to_owned(), bits.parse().ok().filter(|bits| *bits <= MOST_BITS)?))
    };
    let entries = text.split(',').map(str::trim).filter(|entry| !entry.is_empty());
    entries.map(entry).collect::<Option<_>>().map(Self)
});
