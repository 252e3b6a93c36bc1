//! Settings of a link: each kind of link has a table of keys of its own, and all kinds share the keys of the pace.

use std::fmt;
use std::net::{Ipv4Addr, SocketAddr};

use facewire_board::Attached;
use facewire_face::settings::{
    Entry, Field, Fields, Overlay, Reader, Section, Table, TableOf, Takes, field, flag, number, section, whole,
};
use facewire_face::{Adjustments, Wears};
use facewire_packet::formats::dmx::{USUAL_HZ, group};
use facewire_packet::formats::vrchat::{MOST_BITS, Parameters};
use facewire_servo::bus::{FAMILIES, Family, Unit};
use facewire_servo::maestro::Protocol;
use facewire_servo::pca9685::Period;
use facewire_servo::{AtLoss, ChannelSettings, SOURCE_NAMES, Sources, dmx::AtStop, dmx::Encoding};

use super::value::{
    Address, Choice, EXACTLY_36_CHARACTERS, JsonTarget, NAME, OSC_PREFIX, SerialDevice, UP_TO_64_CHARACTERS, address,
    choice, choices, json_target, local_address, optional_address, parameters, serial_device, socket_address, text,
};

/// Most packets per second to the microcontroller board: fewer than a line of 115200 baud carries, and more than hobby
/// servos, which read a position 50 times a second, can show.
const BOARD_HZ: u32 = 60;
/// Positions per second to a servo board: hobby servos read a position 50 times a second.
const SERVO_HZ: u32 = 50;
pub const MOST_MAESTRO_BAUD: u32 = 200_000;

/// One `[[link]]`: a receiver, what is sent to it, and when.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LinkSettings {
    pub kind: LinkKind,
    pub pace: PaceSettings,
    pub adjust: Adjustments,
}

/// Declares the kinds of links, each with its name and the table of its own keys.
macro_rules! link_kinds {
    ($( $variant:ident = $key:literal, $settings:ident $keys:tt )*) => {
        section! { $( $settings $keys )* }

        #[derive(Debug, Clone, PartialEq)]
        pub enum LinkKind {
            $( $variant($settings), )*
        }

        impl LinkKind {
            pub const NAMES: &[&str] = &[ $( $key, )* ];

            pub(super) fn named(name: &str) -> Option<Self> {
                match name {
                    $( $key => Some(Self::$variant($settings::default())), )*
                    _ => None,
                }
            }

            pub fn name(&self) -> &'static str {
                match self {
                    $( Self::$variant(_) => $key, )*
                }
            }

            fn section(&mut self) -> &mut dyn Section {
                match self {
                    $( Self::$variant(settings) => settings, )*
                }
            }
        }
    };
}

impl Default for LinkKind {
    fn default() -> Self {
        Self::Udp(UdpSettings::default())
    }
}

link_kinds! {
    Udp = "udp", UdpSettings { address: Address = Address::local(5252), address(); }

    Serial = "serial", SerialSettings {
        device: SerialDevice = SerialDevice::Auto, serial_device();
        baud: u32 = 115_200, whole(19_200..=4_000_000, "1/s");
    }

    LiveLink = "live-link", LiveLinkSettings {
        address: Address = Address::local(11_111), address();
        subject: String = "webcam".to_owned(), text(UP_TO_64_CHARACTERS);
        device_id: String = "facewire-0000-0000-0000-000000000000".to_owned(), text(EXACTLY_36_CHARACTERS);
        swap_mouth: bool = false, flag();
    }

    Vmc = "vmc", VmcSettings {
        address: Address = Address::local(39_540), address();
        bones: bool = true, flag();
        bundles: bool = true, flag();
    }

    Vrchat = "vrchat", VrchatSettings {
        address: Address = Address::local(9000), address();
        prefix: String = String::new(), text(OSC_PREFIX);
        floats: bool = true, flag();
        bits: u32 = 0, whole(0..=MOST_BITS, "");
        shapes: bool = true, flag();
        compounds: bool = true, flag();
        head: bool = true, flag();
        native_eyes: bool = false, flag();
        parameters: Parameters = Parameters::default(), parameters();
        .. wears: Wears;
    }

    Maestro = "maestro", MaestroSettings {
        device: SerialDevice = SerialDevice::Auto, serial_device();
        baud: u32 = 115_200, whole(9_600..=MOST_MAESTRO_BAUD, "1/s");
        protocol: MaestroProtocol = MaestroProtocol::Compact, choice();
        device_number: u32 = 12, whole(0..=127, "");
        crc: bool = false, flag();
        multiple_targets: bool = false, flag();
        read_errors: bool = true, flag();
        channels "channel": Vec<ChannelSettings> = Vec::new(), Channels;
    }

    Pca9685 = "pca9685", Pca9685Settings {
        bus: u32 = 1, whole(0..=255, "");
        address: u32 = 0x40, whole(0x40..=0x7f, "");
        pulses_hz: u32 = 50, whole(40..=400, "1/s");
        oscillator_hz: u32 = 25_000_000, whole(20_000_000..=30_000_000, "Hz");
        channels "channel": Vec<ChannelSettings> = Vec::new(), Channels;
    }

    BusServo = "bus-servo", BusServoSettings {
        device: SerialDevice = SerialDevice::Auto, serial_device();
        baud: u32 = 1_000_000, whole(9_600..=4_500_000, "1/s");
        family: &'static Family = Family::DYNAMIXEL_X, choice();
        unit: Unit = Unit::Steps, choice();
        channels "channel": Vec<ChannelSettings> = Vec::new(), Channels;
    }

    Sacn = "sacn", SacnSettings {
        universe: u32 = 1, whole(0..=63_999, "");
        address: Option<Address> = None, optional_address();
        from: Option<SocketAddr> = None, local_address();
        priority: u32 = 100, whole(0..=200, "");
        source: String = "facewire".to_owned(), text(UP_TO_64_CHARACTERS);
        whole_face: Encoding = Encoding::Bits8, choice();
        stop: AtStop = AtStop::Hold, choice();
        channels "channel": Vec<ChannelSettings> = Vec::new(), Channels;
    }

    ArtNet = "artnet", ArtNetSettings {
        address: Address = Address::local(6454), address();
        universe: u32 = 0, whole(0..=32_767, "");
        from: Option<SocketAddr> = None, local_address();
        whole_face: Encoding = Encoding::Bits8, choice();
        stop: AtStop = AtStop::Hold, choice();
        channels "channel": Vec<ChannelSettings> = Vec::new(), Channels;
    }

    IFacialMocap = "ifacialmocap", IFacialMocapSettings {
        listen: Option<SocketAddr> = Some((Ipv4Addr::UNSPECIFIED, 49_983).into()), socket_address();
        reply_port: u32 = 49_983, whole(0..=65_535, "");
        address: Option<Address> = None, optional_address();
        version: u32 = 2, whole(1..=2, "");
    }

    Json = "json", JsonSettings { to: JsonTarget = JsonTarget::Stdout, json_target(); }
}

section! {
    PaceSettings {
        pace: PaceKind = PaceKind::Pose, choice();
        rate_hz: u32 = 0, whole(0..=240, "1/s");
        loss: Loss = Loss::Neutral, choice();
    }
}

choices! {
    /// What a receiver gets while no face is followed.
    pub enum Loss: Neutral = "neutral", Hold = "hold", Silent = "silent"
}
choices! {
    /// What makes a link send.
    pub enum PaceKind: Pose = "pose", Change = "change", Rate = "rate"
}
choices! {
    /// How commands to a Maestro begin: with the command byte, or with 0xAA and the device number.
    pub enum MaestroProtocol: Compact = "compact", Pololu = "pololu"
}
choices! { AtLoss: Neutral = "neutral", Release = "release" }
choices! { Unit: Steps = "steps", Degrees = "degrees" }
impl Choice for &'static Family {
    const ALL: &'static [(&'static str, Self)] = FAMILIES;
}
choices! { AtStop: Hold = "hold", Value = "value", End = "end" }
choices! { Encoding: Bits8 = "8-bit", Bits16 = "16-bit", Microseconds = "microseconds" }

struct Channels;

impl Reader<Vec<ChannelSettings>> for Channels {
    fn takes(&self, _: &mut Vec<ChannelSettings>) -> Takes {
        Takes::Channels
    }

    fn read(&self, channels: &mut Vec<ChannelSettings>, entry: &Entry<'_>, file: &mut Overlay<'_>) {
        channels.extend(entry.each().iter().map(|entry| {
            let mut channel = ChannelSettings::default();
            file.section(&mut Fields(&mut channel, channel_fields), entry);
            channel
        }));
    }
}

pub(super) fn channel_fields(channel: &mut ChannelSettings) -> Vec<Field<'_>> {
    vec![
        field("channel", &mut channel.channel, whole(0..=512, "")),
        field("name", &mut channel.name, text(NAME)),
        field("sources", &mut channel.sources, TableOf(source_fields)),
        field("offset", &mut channel.offset, number(-10.0..=10.0, "")),
        field("pulse_at_0_us", &mut channel.pulse_at_0_us, whole(64..=4080, "microseconds")),
        field("pulse_at_1_us", &mut channel.pulse_at_1_us, whole(64..=4080, "microseconds")),
        field("position_at_0", &mut channel.position_at_0, number(0.0..=4095.0, "")),
        field("position_at_1", &mut channel.position_at_1, number(0.0..=4095.0, "")),
        field("neutral", &mut channel.neutral, number(-1.0..=1.0, "")),
        field("speed_per_s", &mut channel.speed_per_s, number(0.0..=100.0, "1/s")),
        field("acceleration_per_s2", &mut channel.acceleration_per_s2, number(0.0..=1000.0, "1/s²")),
        field("dead_zone", &mut channel.dead_zone, number(0.0..=0.2, "")),
        field("loss", &mut channel.loss, choice()),
        field("dmx", &mut channel.dmx, choice()),
        field("stop_value", &mut channel.stop_value, whole(0..=65_535, "")),
    ]
}

fn source_fields(sources: &mut Sources) -> Vec<Field<'_>> {
    SOURCE_NAMES.into_iter().zip(sources).map(|(name, gain)| field(name, gain, number(-10.0..=10.0, ""))).collect()
}

/// The channels of a kind of link, as a reference like that to the kind.
macro_rules! channels_of {
    ($kind:expr) => {
        match $kind {
            LinkKind::Maestro(MaestroSettings { channels, .. })
            | LinkKind::BusServo(BusServoSettings { channels, .. })
            | LinkKind::Pca9685(Pca9685Settings { channels, .. })
            | LinkKind::Sacn(SacnSettings { channels, .. })
            | LinkKind::ArtNet(ArtNetSettings { channels, .. }) => Some(channels),
            _ => None,
        }
    };
}

impl LinkKind {
    fn takes() -> Takes {
        Takes::OneOf(Self::NAMES.to_vec())
    }

    /// The address to which all datagrams go.
    pub fn address(&self) -> Option<Address> {
        match self {
            Self::Udp(UdpSettings { address })
            | Self::LiveLink(LiveLinkSettings { address, .. })
            | Self::Vmc(VmcSettings { address, .. })
            | Self::Vrchat(VrchatSettings { address, .. })
            | Self::ArtNet(ArtNetSettings { address, .. })
            | Self::Json(JsonSettings { to: JsonTarget::Udp(address) }) => Some(address.clone()),
            Self::Sacn(SacnSettings { universe, address, .. }) => {
                address.clone().or_else(|| Address::new(&group(*universe as u16).to_string()))
            }
            _ => None,
        }
    }

    /// Tells the link what the wearer has on the face. A headset sends the eyes to VRChat itself.
    pub(super) fn set_wears(&mut self, wears: Wears) {
        if let Self::Vrchat(it) = self {
            it.wears = wears;
        }
    }

    /// The universe of a link by DMX, and the address of this machine that it sends from.
    pub fn universe(&self) -> Option<(u32, Option<SocketAddr>)> {
        match self {
            Self::Sacn(SacnSettings { universe, from, .. }) | Self::ArtNet(ArtNetSettings { universe, from, .. }) => {
                Some((*universe, *from))
            }
            _ => None,
        }
    }

    /// The serial port, its baud rate, and what `device = "auto"` stands for.
    pub fn line(&self) -> Option<(&SerialDevice, u32, Attached)> {
        match self {
            Self::Serial(SerialSettings { device, baud }) => Some((device, *baud, Attached::Microcontroller)),
            Self::Maestro(MaestroSettings { device, baud, .. }) => Some((device, *baud, Attached::Maestro)),
            Self::BusServo(BusServoSettings { device, baud, .. }) => Some((device, *baud, Attached::BusServos)),
            _ => None,
        }
    }

    /// Whether the servo board at this link can acknowledge anything.
    pub fn acknowledges(&self) -> bool {
        match self {
            Self::Maestro(MaestroSettings { read_errors, .. }) => *read_errors,
            Self::BusServo(_) | Self::Pca9685(_) => true,
            _ => false,
        }
    }

    /// What happens to the servos at this link while an operator has stopped them. `None` if it moves none.
    pub fn at_stop(&self) -> Option<&'static str> {
        match self {
            Self::Maestro(_) | Self::Pca9685(_) => Some("no pulses"),
            Self::BusServo(_) => Some("no torque"),
            Self::Sacn(SacnSettings { stop, .. }) | Self::ArtNet(ArtNetSettings { stop, .. }) => Some(match stop {
                AtStop::Hold => "they hold their last values, with power",
                AtStop::Value => "they get their stop values",
                AtStop::End => "the stream has ended, and the node does what its settings say",
            }),
            _ => None,
        }
    }

    /// Whether a link of this kind moves the servos of the same board, whatever moves each of its channels.
    pub fn has_same_board(&self, other: &Self) -> bool {
        let without_channels = |kind: &Self| {
            let mut kind = kind.clone();
            kind.channels_mut().map(Vec::clear)?;
            Some(kind)
        };
        without_channels(self).is_some_and(|kind| Some(kind) == without_channels(other))
    }

    fn channels_mut(&mut self) -> Option<&mut Vec<ChannelSettings>> {
        channels_of!(self)
    }

    /// The channels of a link that moves servos. `None` for any other kind.
    pub fn channels(&self) -> Option<&Vec<ChannelSettings>> {
        channels_of!(self)
    }

    /// Whether a link of this kind moves servos by channels of its own.
    pub fn moves_servos(&self) -> bool {
        self.channels().is_some()
    }
}

impl MaestroSettings {
    pub fn commands(&self) -> Protocol {
        let pololu = self.pololu_commands();
        if self.protocol == MaestroProtocol::Pololu { pololu } else { Protocol { device_number: None, ..pololu } }
    }

    /// The Pololu protocol to this device, whatever the protocol of the link is.
    pub fn pololu_commands(&self) -> Protocol {
        Protocol { device_number: u8::try_from(self.device_number).ok(), crc: self.crc }
    }
}

impl Pca9685Settings {
    pub fn period(&self) -> Period {
        Period::new(self.pulses_hz, self.oscillator_hz)
    }
}

impl LinkSettings {
    /// A link of this kind with the settings that suit it.
    pub(super) fn of(kind: LinkKind) -> Self {
        let mut link = Self { kind, ..Self::default() };
        if link.kind.moves_servos() {
            let rate_hz = if link.kind.universe().is_some() { USUAL_HZ } else { SERVO_HZ };
            link.pace.pace = PaceKind::Rate;
            link.pace.rate_hz = rate_hz;
        }
        link
    }

    /// The link to the microcontroller board that is plugged in. It has a rate of its own that suits its baud rate,
    /// whatever the rates of the camera and of `[send]` are.
    pub(super) fn to_the_board() -> Self {
        let pace = PaceSettings { pace: PaceKind::Change, rate_hz: BOARD_HZ, ..PaceSettings::default() };
        Self { kind: LinkKind::Serial(SerialSettings::default()), pace, ..Self::default() }
    }

    /// The rate of the link in packets per second; `send_hz` is that of `[send]`.
    pub fn rate_hz(&self, send_hz: u32) -> u32 {
        if self.pace.rate_hz == 0 { send_hz } else { self.pace.rate_hz }
    }

    /// Reads a link. Its kind chooses its other keys, which cannot be judged without it.
    fn read(entry: &Entry<'_>, file: &mut Overlay<'_>) -> Self {
        let mut link = Self::default();
        if let Some(value) = entry.value.get_ref().as_table().and_then(|table| table.get("kind")) {
            let Some(kind) = value.get_ref().as_str().and_then(LinkKind::named) else {
                file.refuse_value(&Entry { path: "link.kind".to_owned(), value }, &LinkKind::takes(), |_| None);
                return link;
            };
            link = Self::of(kind);
        }
        file.section(&mut link, entry);
        link
    }
}

impl Section for LinkSettings {
    fn fields(&mut self) -> Vec<Field<'_>> {
        // `LinkSettings::read` has read it before.
        let mut fields = vec![Field { key: "kind", takes: LinkKind::takes(), read: Box::new(|_, _| {}) }];
        fields.extend(self.kind.section().fields());
        fields.extend(self.pace.fields());
        fields.push(field("adjust", &mut self.adjust, Table));
        fields
    }

    fn objection(&mut self, key: &str) -> Option<String> {
        let mut others = LinkKind::NAMES.iter().filter_map(|name| LinkKind::named(name));
        let is_of_another = others.any(|mut kind| kind.section().keys().contains(&key));
        let kind = self.kind.name();
        let keys = self.keys().join(", ");
        is_of_another.then(|| format!(" of a link with kind = \"{kind}\"; that has {keys}"))
    }
}

/// Reads the links of a file, which replace the default ones.
pub(super) struct Links;

impl Reader<Vec<LinkSettings>> for Links {
    fn takes(&self, _: &mut Vec<LinkSettings>) -> Takes {
        Takes::Links
    }

    fn read(&self, links: &mut Vec<LinkSettings>, entry: &Entry<'_>, file: &mut Overlay<'_>) {
        if entry.value.get_ref().as_array().is_none() {
            return file.refuse(entry, &Takes::Links.to_string());
        }
        *links = file.each(entry, LinkSettings::read);
    }
}

impl fmt::Display for Pca9685Settings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "I2C bus {}, address {:#04x}", self.bus, self.address)
    }
}

impl fmt::Display for LinkSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            LinkKind::Pca9685(settings) => settings.fmt(f),
            LinkKind::IFacialMocap(IFacialMocapSettings { listen, address, .. }) => match (listen, address) {
                (Some(listen), Some(address)) => write!(f, "those who ask at {listen}, and {address}"),
                (Some(listen), None) => write!(f, "those who ask at {listen}"),
                (None, Some(address)) => address.fmt(f),
                (None, None) => f.write_str("nobody"),
            },
            LinkKind::Json(JsonSettings { to: JsonTarget::Stdout }) => f.write_str("standard output"),
            LinkKind::Json(JsonSettings { to: JsonTarget::Unix(path) }) => path.display().fmt(f),
            kind => {
                kind.address().iter().try_for_each(|address| address.fmt(f))?;
                kind.line().iter().try_for_each(|(device, ..)| device.fmt(f))?;
                // sACN counts universes from 1, Art-Net from 0.
                match kind {
                    LinkKind::Sacn(it) => {
                        write!(f, ", universe {} ({} by Art-Net)", it.universe, it.universe.max(1) - 1)
                    }
                    LinkKind::ArtNet(it) => write!(f, ", universe {} ({} by sACN)", it.universe, it.universe + 1),
                    _ => Ok(()),
                }
            }
        }
    }
}
