//! Settings of links to head-mounted displays and avatars.

use std::{
    fmt,
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
};

use toml::de::DeValue;

use super::{
    section::{Section, section, write_setting},
    value::{Address, Value, quoted},
};

section! {
    /// Live Link Face.
    LiveLinkSettings {
        /// The machine that runs Unreal, and the port of its plugin.
        address: Address = Address::local(11_111), (), "";
        /// The name of the subject in Unreal. Give each face a name of its own.
        subject: Text = Text::from("facewire"), 1..=64, "";
        /// The name of the device. Some receivers read exactly 36 characters.
        device_id: Text = Text::from("facewire-0000-0000-0000-000000000000"), 36..=36, "";
        /// Exchanges `mouthLeft` and `mouthRight`, as Apple's app does by mistake: for receivers that exchange them again.
        swap_mouth: bool = false, (), "";
    }
}

section! {
    /// VMC.
    VmcSettings {
        /// The machine that runs the application, and its port: 39540 for most, such as VSeeFace and VMagicMirror; 39539
        /// for Warudo and others that expect a whole body.
        address: Address = Address::local(39_540), (), "";
        /// Whether the head and the eyes turn, too. Without it, only blendshapes are sent.
        bones: bool = true, (), "";
    }
}

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

impl fmt::Display for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
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

section! {
    /// VRChat and VRCFaceTracking.
    VrchatSettings {
        /// The machine that runs VRChat, and its port for incoming OSC.
        address: Address = Address::local(9000), (), "";
        /// What the avatar puts before `v2/` in the names of its parameters, such as "FT/".
        prefix: OscPrefix = OscPrefix::default(), (), "";
        /// Whether parameters are sent as one number each.
        floats: bool = true, (), "";
        /// Number of bits of binary parameters, which avatars use to save memory: 0 for none.
        bits: u32 = 0, 0..=8, "";
        /// Whether to send parameters of single movements, such as `v2/JawOpen`.
        shapes: bool = true, (), "";
        /// Whether to send parameters that stand for several movements, such as `v2/SmileFrown`.
        compounds: bool = true, (), "";
        /// Whether to send the turn of the head as `v2/Head/Yaw`, `v2/Head/Pitch` and `v2/Head/Roll`.
        head: bool = true, (), "";
        /// Whether to send the eyes to VRChat's own addresses (`/tracking/eye/`), too: for avatars without parameters for
        /// eyes.
        native_eyes: bool = false, (), "";
        /// The parameters to send, if not all: their names after `v2/`, each with the number of its bits if it is binary,
        /// such as "JawOpen, SmileFrown:4". `floats`, `bits`, `shapes`, `compounds` and `head` then do not count.
        parameters: Parameters = Parameters::default(), (), "";
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
const MOST_BITS: u32 = 8;

section! {
    /// iFacialMocap.
    IFacialMocapSettings {
        /// Where receivers ask for the face, as they ask the iPhone: an address of this machine in numbers and a port, or ""
        /// not to listen.
        listen: ListenAddress = ListenAddress::any(49_983), (), "";
        /// The port at which receivers that asked get the face; 0 for the port that they asked from.
        reply_port: u32 = 49_983, 0..=65_535, "";
        /// A receiver that gets the face without asking, or "".
        address: MaybeAddress = MaybeAddress::default(), (), "";
        /// The version of the text for `address`. Those who ask choose it themselves.
        version: u32 = 2, 1..=2, "";
    }
}

/// Shows where receivers ask, and who gets the face without asking.
impl fmt::Display for IFacialMocapSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.listen.0, &self.address.0) {
            (Some(listen), Some(address)) => write!(f, "those who ask at {listen}, and {address}"),
            (Some(listen), None) => write!(f, "those who ask at {listen}"),
            (None, Some(address)) => address.fmt(f),
            (None, None) => f.write_str("nobody"),
        }
    }
}

section! {
    /// JSON lines.
    JsonSettings {
        /// Where the lines go:
        /// - "stdout": standard output. The log goes to standard error
        /// - "udp:HOST:PORT": one datagram for each line
        /// - "unix:PATH": a Unix socket at which up to 8 programs read
        to: JsonTarget = JsonTarget::Stdout, (), "";
    }
}

/// An address of this machine at which a link listens, or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ListenAddress(pub Option<SocketAddr>);

impl ListenAddress {
    /// All IPv4 addresses of this machine.
    fn any(port: u16) -> Self {
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

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use crate::config::{defaults, parse, written};

    fn fault(keys: &str) -> String {
        parse("file", &format!("[[link]]\n{keys}\n")).unwrap_err().to_string()
    }

    #[test]
    fn settings_of_receivers_load_back_from_their_written_form() {
        for keys in [
            "kind = \"live-link\"\nsubject = \"my face\"\ndevice_id = \"0123456789abcdef0123456789abcdef0123\"\n",
            "kind = \"vmc\"\nbones = false\n",
            "kind = \"ifacialmocap\"\nlisten = \"[::1]:49983\"\nreply_port = 0\naddress = \"pc.local:49983\"\nversion = 1\n",
            "kind = \"json\"\nto = \"udp:pc.local:5000\"\n",
            "kind = \"json\"\nto = \"unix:/run/facewire/lines\"\n",
            "kind = \"vrchat\"\nprefix = \"FT/\"\nbits = 4\nparameters = \"JawOpen, EyeLidLeft:3\"\n",
        ] {
            let settings = parse("file", &format!("[[link]]\n{keys}")).unwrap();
            assert_eq!(parse("written", &written(&settings)).unwrap(), settings);
        }
        assert!(defaults().contains(" - \"live-link\": Live Link Face for Unreal"));
    }

    #[test]
    fn values_that_receivers_would_not_understand_are_refused() {
        assert!(
            fault("kind = \"live-link\"\nsubject = \"\"")
                .ends_with("give 1 to 64 printable ASCII characters in quotes")
        );
        assert!(
            fault("kind = \"live-link\"\ndevice_id = \"short\"")
                .ends_with("give 36 printable ASCII characters in quotes")
        );
        for to in ["file", "unix:lines", "udp:5000"] {
            assert!(fault(&format!("kind = \"json\"\nto = \"{to}\"")).contains("give \"stdout\""), "{to}");
        }
        for listen in ["localhost:49983", "0.0.0.0:0", "49983"] {
            let fault = fault(&format!("kind = \"ifacialmocap\"\nlisten = \"{listen}\""));
            assert!(fault.contains("an address of this machine in numbers"), "{fault}");
        }
        for prefix in ["FT", "/FT/", "F T/", "FT*/"] {
            assert!(
                fault(&format!("kind = \"vrchat\"\nprefix = \"{prefix}\"")).contains("end with a slash"),
                "{prefix}"
            );
        }
        for parameters in ["JawOpn", "JawOpen:9", "JawOpen SmileFrown"] {
            let fault = fault(&format!("kind = \"vrchat\"\nparameters = \"{parameters}\""));
            assert!(fault.contains("names of parameters of VRCFaceTracking v2"), "{fault}");
        }
    }
}
