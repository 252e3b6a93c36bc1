//! The types of values, and their readers.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::{fmt, path::PathBuf};

use facewire_face::Rotation;
use facewire_face::settings::{Reader, Takes, Value, one_of};
use facewire_packet::formats::vrchat::Parameters;
use toml::de::DeValue;

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

pub fn choice<T: Choice>() -> impl Reader<T> {
    one_of(T::ALL)
}

/// Reads the angle of a turn in degrees.
pub fn rotation() -> impl Reader<Rotation> {
    let read = |value: &DeValue<'_>| {
        let text = value.as_integer()?.as_str();
        Rotation::ALL.into_iter().find(|rotation| rotation.degrees().to_string() == text)
    };
    Value::new(Takes::OneOfNumbers(Rotation::ALL.map(Rotation::degrees)), read)
}

/// Reads a text from which `parse` makes a value.
fn parsed<T>(expected: impl Into<String>, parse: impl Fn(&str) -> Option<T>) -> impl Reader<T> {
    Value::new(Takes::Text(expected.into()), move |value: &DeValue<'_>| parse(value.as_str()?))
}

/// As [`parsed`], for a text with an address in it.
fn parsed_address<T>(expected: impl Into<String>, parse: impl Fn(&str) -> Option<T>) -> impl Reader<T> {
    let read = move |value: &DeValue<'_>| parse(value.as_str()?);
    Value::new(Takes::Text(expected.into()), read).but(objection_to_address)
}

/// As [`parsed_address`], or an empty text for nothing.
fn optional<T>(expected: &str, parse: impl Fn(&str) -> Option<T>) -> impl Reader<Option<T>> {
    let read = move |text: &str| if text.is_empty() { Some(None) } else { parse(text).map(Some) };
    parsed_address(format!("\"\", or {expected}"), read)
}

/// Which texts a setting takes: their description, and whether a text is one of them.
type Texts = (&'static str, fn(&str) -> bool);

pub const ANY_TEXT: Texts = ("a text in quotes", |_| true);
pub const UP_TO_64_CHARACTERS: Texts =
    ("1 to 64 printable ASCII characters in quotes", |text| (1..=64).contains(&text.len()) && is_printable(text));
/// A control character would forge lines of the log.
pub const NAME: Texts = ("\"\", or a name of up to 64 characters in quotes", |text| {
    text.chars().count() <= 64 && !text.contains(|character: char| character.is_control())
});
pub const EXACTLY_36_CHARACTERS: Texts =
    ("36 printable ASCII characters in quotes", |text| text.len() == 36 && is_printable(text));
pub const HOST_NAMES: Texts =
    ("\"\", or names with spaces between them, such as \"head.lan head.fritz.box\"", |text| {
        let is_part = |byte: u8| byte.is_ascii_alphanumeric() || b"-.".contains(&byte);
        text.len() <= 1000 && text.split_whitespace().all(|name| name.bytes().all(is_part))
    });
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

pub fn text((expected, takes): Texts) -> impl Reader<String> {
    parsed(expected, move |text| takes(text).then(|| text.to_owned()))
}

pub fn socket_address() -> impl Reader<Option<SocketAddr>> {
    optional("an address of this machine in numbers and a port from 1 to 65535, such as \"0.0.0.0:49983\"", |text| {
        text.parse().ok().filter(|address: &SocketAddr| address.port() != 0)
    })
}

/// A path from the root: a service has no folder that a relative path could start at.
fn absolute(path: &str) -> Option<PathBuf> {
    path.starts_with('/').then(|| path.into())
}

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

pub fn serial_device() -> impl Reader<SerialDevice> {
    parsed("\"auto\", or a path in quotes that begins with /", |text| match text {
        "auto" => Some(SerialDevice::Auto),
        path => absolute(path).map(SerialDevice::Path),
    })
}

/// A network address as it is written: `host:port`. The host is a name or an address; an IPv6 address has brackets, and may
/// name the interface that leads there, as in `[fe80::1%eth0]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Address(String);

impl Address {
    /// Returns `None` unless the text is a host, a colon and a port from 1 to 65535.
    pub fn new(text: &str) -> Option<Self> {
        let address = Self(text.to_owned());
        let (host, port) = address.parts()?;
        (!host.is_empty() && port != 0 && objection_to_address(text).is_none()).then_some(address)
    }

    pub(super) fn local(port: u16) -> Self {
        Self(format!("127.0.0.1:{port}"))
    }

    /// The host without its brackets, and the port.
    pub fn parts(&self) -> Option<(&str, u16)> {
        let (host, port) = self.0.rsplit_once(':')?;
        let bracketed = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
        Some((bracketed.unwrap_or(host), port.parse().ok()?))
    }

    /// The interface that leads to an IPv6 address, if it is named.
    pub fn interface(&self) -> Option<&str> {
        self.parts()?.0.split_once('%').map(|(_, interface)| interface)
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

/// Returns what to give in place of an address that cannot be meant as it is written.
fn objection_to_address(text: &str) -> Option<&'static str> {
    // `getaddrinfo` takes numbers of fewer parts, of base 8 and of base 16 for addresses, which nobody means.
    let is_number = |part: &[u8]| match part {
        [b'0', b'x' | b'X', digits @ ..] => digits.iter().all(u8::is_ascii_hexdigit),
        digits => digits.iter().all(u8::is_ascii_digit),
    };
    let is_v6 = |host: &str| {
        let (address, interface) = host.split_once('%').unwrap_or((host, "eth0"));
        address.parse::<Ipv6Addr>().is_ok() && !interface.is_empty()
    };
    let is_of_name = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte) || !byte.is_ascii();
    let has = |text: &str, byte: u8| text.as_bytes().contains(&byte);
    let text = text.strip_prefix("udp:").unwrap_or(text);
    let (host, _) = text.rsplit_once(':').filter(|_| !text.starts_with("unix:"))?;
    let v6 = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    if text.chars().any(char::is_whitespace) {
        Some("\"host:port\" without blanks")
    } else if has(host, b'*') {
        Some(
            "a host in place of the star: 0.0.0.0 to listen at all addresses of this machine, or 255.255.255.255 to send to all \
             machines of a network",
        )
    } else if let Some(v6) = v6 {
        (!is_v6(v6)).then_some(V6)
    } else if has(host, b':') && !has(host, b'/') {
        Some(V6)
    } else if host.as_bytes().split(|byte| *byte == b'.').all(is_number) {
        let expected = "\"host:port\" with a name, or with an IPv4 address of four decimal numbers from 0 to 255 without leading \
                        zeros, such as \"127.0.0.10:5252\"";
        (!host.is_empty() && host.parse::<Ipv4Addr>().is_err()).then_some(expected)
    } else {
        (!host.bytes().all(is_of_name)).then_some("\"host:port\": a name has letters, digits and - _ . only")
    }
}

const V6: &str =
    "\"host:port\" with an IPv6 address in brackets, such as \"[2001:db8::1]:5252\" or \"[fe80::1%eth0]:5252\"";

/// Reads the address to send from, which cannot be a multicast group. The port may be 0.
pub fn local_address() -> impl Reader<Option<SocketAddr>> {
    optional("an address of this machine in numbers and a port, or 0 for any, such as \"192.168.1.5:0\"", |text| {
        text.parse().ok().filter(|from: &SocketAddr| !from.ip().is_multicast())
    })
}

const ADDRESS: &str = "\"host:port\" with a port from 1 to 65535";

pub fn address() -> impl Reader<Address> {
    parsed_address(ADDRESS, Address::new)
}

pub fn optional_address() -> impl Reader<Option<Address>> {
    optional(ADDRESS, Address::new)
}

/// An address that only programs on this machine can reach.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listen {
    Off,
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

pub fn listen() -> impl Reader<Listen> {
    let expected = "\"\", a loopback address and port such as \"127.0.0.1:9464\" or \"[::1]:9464\", or \"unix:\" and a path \
                    that begins with /";
    parsed_address(expected, |text| match text.strip_prefix("unix:") {
        Some(path) => absolute(path).map(Listen::Unix),
        None if text.is_empty() => Some(Listen::Off),
        None => {
            let address = text.parse().ok().filter(|at: &SocketAddr| at.ip().is_loopback() && at.port() != 0);
            address.map(Listen::Tcp)
        }
    })
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JsonTarget {
    Stdout,
    Udp(Address),
    Unix(PathBuf),
}

pub fn json_target() -> impl Reader<JsonTarget> {
    let expected =
        "\"stdout\", \"udp:host:port\" with a port from 1 to 65535, or \"unix:\" and a path that begins with /";
    parsed_address(expected, |text| match text.split_once(':') {
        None => (text == "stdout").then_some(JsonTarget::Stdout),
        Some(("udp", address)) => Address::new(address).map(JsonTarget::Udp),
        Some(("unix", path)) => absolute(path).map(JsonTarget::Unix),
        Some(_) => None,
    })
}

pub fn parameters() -> impl Reader<Parameters> {
    parsed(Parameters::EXPECTED, Parameters::parse)
}

const LONGEST_SCENE_S: f64 = 86_400.0;

choices! {
    /// What the camera does for a while: it shows a grey picture, damaged, dark or cut-off pictures; delivers no frame
    /// (silent), neither a frame nor an error (hung) or every other frame, like a camera that exposes longer; loses every
    /// eighth frame; or plays the clip on a board that takes so many frame periods to decode a frame. A slow JPEG decoder
    /// takes two, and half of one for half the width and height.
    pub enum Scene: Live = "live", NoFace = "no-face", Damaged = "damaged", Silent = "silent", Hung = "hung",
    Gone = "gone", Dark = "dark", CutOff = "cut-off", HalfRate = "half-rate", Lossy = "lossy", Slow2 = "slow-2",
    Slow4 = "slow-4", Slow8 = "slow-8", SlowJpeg = "slow-jpeg", Hot = "hot", Undervoltage = "undervoltage"
}

impl Scene {
    /// The scenes of a random rehearsal: each tells by itself what receivers then see.
    pub const RANDOM: [Self; 6] = [Self::Live, Self::NoFace, Self::Damaged, Self::Silent, Self::Hung, Self::Gone];
}

/// The script of a camera that plays the built-in clip with faults, over and over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Script {
    /// Scenes and their lengths in microseconds.
    Scenes(Vec<(Scene, u64)>),
    Random(u64),
}

impl Script {
    const EXPECTED: &'static str = "a rehearsal such as \"rehearsal: live 5, gone 2.5\" of the scenes live, no-face, \
         damaged, silent, hung, gone, dark, cut-off, half-rate, lossy, slow-2, slow-4, slow-8, slow-jpeg, hot and \
         undervoltage with their seconds, or \"rehearsal: random 7\"";

    /// Reads the script in the camera setting `device`, or says what to give instead. Returns `None` if the setting names no
    /// rehearsal.
    pub fn of(device: &str) -> Option<Result<Self, &'static str>> {
        device.strip_prefix("rehearsal:").map(|script| Self::parse(script).ok_or(Self::EXPECTED))
    }

    fn parse(script: &str) -> Option<Self> {
        if let Some(seed) = script.trim().strip_prefix("random ") {
            return seed.trim().parse().ok().map(Self::Random);
        }
        let scene = |text: &str| {
            let (name, length) = text.trim().split_once(' ')?;
            let (_, scene) = Scene::ALL.iter().find(|(known, _)| *known == name)?;
            let length_s: f64 = length.trim().parse().ok()?;
            (0.001..=LONGEST_SCENE_S).contains(&length_s).then(|| (*scene, (length_s * 1e6).round() as u64))
        };
        script.split(',').map(scene).collect::<Option<_>>().map(Self::Scenes)
    }
}
