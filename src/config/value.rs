//! The types of values: how each is read, checked and described.

use std::{fmt, net::SocketAddr, ops::RangeInclusive, path::PathBuf};

use toml::de::DeValue;

/// A type of value.
pub trait Value: Sized {
    type Bounds;

    /// Reads a value. Returns `None` if it has another type or is out of bounds.
    fn read(value: &DeValue<'_>, bounds: &Self::Bounds) -> Option<Self>;

    /// Describes the values that [`Value::read`] takes; the text follows "give".
    fn expected(bounds: &Self::Bounds) -> String;
}

/// A type with a few named values.
pub trait Choice: Copy + PartialEq + 'static {
    const ALL: &'static [(&'static str, Self)];

    fn name(self) -> &'static str {
        let named = Self::ALL.iter().find(|(_, value)| *value == self);
        named.map_or("", |(name, _)| name)
    }
}

/// Names the values of an enum, which it declares if it is not that of another module.
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

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        let text = value.as_str()?;
        let named = Self::ALL.iter().find(|(name, _)| *name == text);
        named.map(|(_, value)| *value)
    }

    fn expected((): &()) -> String {
        one_of(Self::ALL.iter().map(|(name, _)| *name))
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

/// Implements [`Value`] for types of whole numbers.
macro_rules! whole_number {
    ($($type:ty),*) => { $(
        impl Value for $type {
            type Bounds = RangeInclusive<$type>;

            fn read(value: &DeValue<'_>, bounds: &Self::Bounds) -> Option<Self> {
                let integer = value.as_integer()?;
                let number = Self::from_str_radix(integer.as_str(), integer.radix()).ok()?;
                bounds.contains(&number).then_some(number)
            }

            fn expected(bounds: &Self::Bounds) -> String {
                format!("a whole number from {} to {}", bounds.start(), bounds.end())
            }
        }
    )* };
}

whole_number!(u32, i32);

impl Value for f32 {
    type Bounds = RangeInclusive<f32>;

    fn read(value: &DeValue<'_>, bounds: &Self::Bounds) -> Option<Self> {
        let number: Self = match value {
            DeValue::Float(float) => float.as_str().parse().ok()?,
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok()?,
            _ => return None,
        };
        bounds.contains(&number).then_some(number)
    }

    fn expected(bounds: &Self::Bounds) -> String {
        format!("a number from {:?} to {:?}", bounds.start(), bounds.end())
    }
}

/// Implements [`Value`] for types without bounds: how a value is read, and what is expected.
macro_rules! value {
    ($type:ty, $expected:expr, |$value:ident| $read:expr) => {
        impl Value for $type {
            type Bounds = ();

            fn read($value: &DeValue<'_>, (): &()) -> Option<Self> {
                $read
            }

            fn expected((): &()) -> String {
                $expected.to_owned()
            }
        }
    };
}

value!(bool, "true or false", |value| value.as_bool());

/// Which texts a setting takes: their description, and whether a text is one of them.
pub struct Texts(&'static str, fn(&str) -> bool);

pub const ANY_TEXT: Texts = Texts("a text in quotes", |_| true);
pub const UP_TO_64_CHARACTERS: Texts = Texts("1 to 64 printable ASCII characters in quotes", |text| {
    (1..=64).contains(&text.len()) && text.bytes().all(is_printable)
});
pub const EXACTLY_36_CHARACTERS: Texts =
    Texts("36 printable ASCII characters in quotes", |text| text.len() == 36 && text.bytes().all(is_printable));
/// The part of an OSC address between `/avatar/parameters/` and `v2/`. OSC gives a meaning to the other characters.
pub const OSC_PREFIX: Texts =
    Texts("\"\", or up to 64 letters, digits and _ - . / that end with a slash, such as \"FT/\"", |text| {
        let is_good = |byte: u8| byte.is_ascii_alphanumeric() || b"/_-.".contains(&byte);
        let is_prefix = text.is_empty() || text.ends_with('/') && !text.starts_with('/');
        is_prefix && text.len() <= 64 && text.bytes().all(is_good)
    });

fn is_printable(byte: u8) -> bool {
    (b' '..=b'~').contains(&byte)
}

impl Value for String {
    type Bounds = Texts;

    fn read(value: &DeValue<'_>, Texts(_, takes): &Texts) -> Option<Self> {
        value.as_str().filter(|text| takes(text)).map(str::to_owned)
    }

    fn expected(Texts(expected, _): &Texts) -> String {
        (*expected).to_owned()
    }
}

/// A value that may be left out, as an empty text.
impl<T: Value<Bounds = ()>> Value for Option<T> {
    type Bounds = ();

    fn read(value: &DeValue<'_>, (): &()) -> Option<Self> {
        if value.as_str() == Some("") { Some(None) } else { T::read(value, &()).map(Some) }
    }

    fn expected((): &()) -> String {
        format!("\"\", or {}", T::expected(&()))
    }
}

value!(
    SocketAddr,
    "an address of this machine in numbers and a port from 1 to 65535, such as \"0.0.0.0:49983\"",
    |value| value.as_str()?.parse().ok().filter(|address: &Self| address.port() != 0)
);

/// The serial port of a link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SerialDevice {
    /// What is plugged into USB.
    Auto,
    /// A path from the root: a service has no folder that a relative path could start at.
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

value!(SerialDevice, "\"auto\", or a path in quotes that begins with /", |value| match value.as_str()? {
    "auto" => Some(Self::Auto),
    path => path.starts_with('/').then(|| Self::Path(path.into())),
});

/// A network address as it is written: `host:port`. The host is a name or an address; an IPv6 address has brackets.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Address(String);

impl Address {
    /// Reads an address. Returns `None` unless the text is a host, a colon and a port from 1 to 65535.
    pub fn new(text: &str) -> Option<Self> {
        let (host, port) = text.rsplit_once(':')?;
        let bracketed = host.starts_with('[') && host.ends_with(']');
        let host_good = !host.is_empty() && (bracketed || !host.contains(':'));
        let port_good = port.parse::<u16>().is_ok_and(|port| port != 0);
        (host_good && port_good).then(|| Self(text.to_owned()))
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

value!(Address, "\"host:port\" with a port from 1 to 65535", |value| Self::new(value.as_str()?));

/// An address that only programs on this machine can reach.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listen {
    Off,
    /// A loopback address.
    Tcp(SocketAddr),
    /// A Unix socket.
    Unix(PathBuf),
}

impl Listen {
    /// Reads an address. Returns `None` for an address that other machines can reach, for port 0, and for a path that
    /// is not absolute.
    pub fn new(text: &str) -> Option<Self> {
        if text.is_empty() {
            return Some(Self::Off);
        }
        if let Some(path) = text.strip_prefix("unix:") {
            return path.starts_with('/').then(|| Self::Unix(path.into()));
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
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

value!(
    Listen,
    "\"\", a loopback address and port such as \"127.0.0.1:9464\" or \"[::1]:9464\", or \"unix:\" and a path that begins \
     with /",
    |value| Self::new(value.as_str()?)
);

/// Where JSON lines go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JsonTarget {
    Stdout,
    Udp(Address),
    /// A Unix socket, by its path.
    Unix(PathBuf),
}

value!(
    JsonTarget,
    "\"stdout\", \"udp:host:port\" with a port from 1 to 65535, or \"unix:\" and a path that begins with /",
    |value| match value.as_str()? {
        "stdout" => Some(Self::Stdout),
        text => match text.split_once(':')? {
            ("udp", address) => Address::new(address).map(Self::Udp),
            ("unix", path) => path.starts_with('/').then(|| Self::Unix(path.into())),
            _ => None,
        },
    }
);

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

    /// Returns how a parameter is sent, and `general` for all if the list is empty.
    pub fn of(&self, name: &str, general: ParameterChoice) -> Option<ParameterChoice> {
        if !self.names_any() {
            return Some(general);
        }
        let (_, bits) = self.0.iter().find(|(named, _)| *named == name)?;
        Some(ParameterChoice { number: *bits == 0, bits: *bits })
    }
}

value!(Parameters, Self::EXPECTED, |value| {
    let entries = value.as_str()?.split(',').map(str::trim).filter(|entry| !entry.is_empty());
    let entry = |entry: &str| {
        let (name, bits) = entry.split_once(':').unwrap_or((entry, "0"));
        let bits = bits.parse().ok().filter(|bits| *bits <= MOST_BITS)?;
        Some((name.to_owned(), bits))
    };
    entries.map(entry).collect::<Option<_>>().map(Self)
});
