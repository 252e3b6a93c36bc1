//! Settings of a link: one kind of link has one table of keys, and all kinds share the keys of the pace.

use std::{fmt, path::Path};

use facewire_packet::FRAME_BYTES;
use toml::de::DeValue;

use super::{
    adjust::AdjustSettings,
    avatar::{IFacialMocapSettings, JsonSettings, JsonTarget, LiveLinkSettings, VmcSettings, VrchatSettings},
    section::{Section, section, write_setting},
    servo::{ChannelSettings, MaestroSettings, Pca9685Board, Pca9685Settings, WithChannels},
    value::{Address, Choice, SerialDevice, Value, quoted},
};

/// Share of a serial line that packets may use, percent. The rest makes up for clocks that differ.
const LINE_SHARE: u64 = 80;
/// Bits of a byte on a serial line: a start bit, 8 data bits and a stop bit.
const BITS_PER_BYTE: u64 = 10;
/// The key of the link's own adjustments.
pub(super) const ADJUST: &str = "adjust";
/// Most packets per second to the microcontroller board: fewer than a line of 115200 baud carries, and more than hobby
/// servos, which read a position 50 times a second, can show.
const BOARD_HZ: u32 = 60;
/// Positions per second to a servo board: hobby servos read a position 50 times a second.
const SERVO_HZ: u32 = 50;

/// One `[[link]]`: a receiver, what is sent to it, and when.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LinkSettings {
    /// What is sent, and how it travels.
    pub kind: LinkKind,
    /// When it is sent.
    pub pace: PaceSettings,
    /// How it is changed for this receiver.
    pub adjust: AdjustSettings,
}

/// Declares the kinds of links: `/// comment`, `Variant(Settings) = "name"` for each. The first is the default.
macro_rules! link_kinds {
    ( $(#[doc = $doc:literal])* $name:ident { $( #[doc = $text:literal] $variant:ident($settings:ident) = $key:literal, )* } ) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, PartialEq)]
        pub enum $name {
            $( #[doc = $text] $variant($settings), )*
        }

        impl $name {
            /// The name of every kind.
            pub const NAMES: &[&str] = &[ $( $key, )* ];
            /// A line about every kind.
            const LINES: &[&str] = &[ $( concat!(" - \"", $key, "\":", $text), )* ];

            /// Returns every kind with its default settings.
            pub(super) fn all() -> [Self; Self::NAMES.len()] {
                [ $( Self::$variant($settings::default()), )* ]
            }

            /// The name of this kind.
            #[must_use]
            pub fn name(&self) -> &'static str {
                match self {
                    $( Self::$variant(_) => $key, )*
                }
            }

            /// The settings that only this kind has.
            pub(super) fn section(&self) -> &dyn Section {
                match self {
                    $( Self::$variant(settings) => settings, )*
                }
            }

            /// The same settings, to be changed.
            pub(super) fn section_mut(&mut self) -> &mut dyn Section {
                match self {
                    $( Self::$variant(settings) => settings, )*
                }
            }
        }
    };
}

link_kinds! {
    /// What a link sends, and how it travels.
    LinkKind {
        /// facewire packets by UDP, each in one datagram of 132 bytes
        Udp(UdpSettings) = "udp",
        /// facewire packets on a serial line, each as one COBS frame of 134 bytes
        Serial(SerialSettings) = "serial",
        /// Live Link Face for Unreal, by UDP
        LiveLink(LiveLinkSettings) = "live-link",
        /// VMC for VTuber applications, by UDP
        Vmc(VmcSettings) = "vmc",
        /// VRChat with avatars for VRCFaceTracking, by UDP
        Vrchat(VrchatSettings) = "vrchat",
        /// positions of servos, to a Pololu Maestro by USB or a serial line; `[[link.channel]]` says which servo does what
        Maestro(MaestroSettings) = "maestro",
        /// positions of servos, to a PCA9685 by I2C; `[[link.channel]]` says which servo does what
        Pca9685(Pca9685Settings) = "pca9685",
        /// iFacialMocap, as the iPhone app of this name sends it to those who ask for it, by UDP
        IFacialMocap(IFacialMocapSettings) = "ifacialmocap",
        /// lines of JSON to standard output, to a Unix socket or by UDP
        Json(JsonSettings) = "json",
    }
}

impl Default for LinkKind {
    fn default() -> Self {
        Self::Udp(UdpSettings::default())
    }
}

section! {
    /// Packets by UDP.
    UdpSettings {
        /// The receiver: a host name or an address, also a broadcast or a multicast address, and a port. The address of
        /// a host name is looked up again every 5 seconds.
        address: Address = Address::default(), (), "";
    }
}

section! {
    /// Packets on a serial line.
    SerialSettings {
        /// The serial port:
        /// - "auto": the microcontroller board that is plugged into USB. It must be of a maker whose devices are such
        ///   boards (Arduino, Teensy, Adafruit, Raspberry Pi Pico, Espressif, SparkFun, Seeed, Pololu), because anything
        ///   may be connected to an adapter of general use (FTDI, CH340, CP210x): give its path
        /// - a path, preferably one that does not change when other devices are plugged in: `facewire devices` lists
        ///   the ports with such paths
        device: SerialDevice = SerialDevice::Auto, (), "";
        /// Baud rate. Packets may use at most 80 % of the line: 115200 baud carries 68 packets per second.
        baud: u32 = 115_200, 19_200..=4_000_000, " (1/s)";
    }
}

section! {
    /// When a link sends.
    PaceSettings {
        /// When the link sends a packet:
        /// - "pose": at once for every new pose and every change of state, `rate_hz` times per second while the face
        ///   holds, decays or returns to live, and 10 times per second otherwise
        /// - "change": when the face has moved visibly since the last packet (a coefficient by 0.5 %, the head by half a
        ///   degree or 2 mm) or its state has changed, at most `rate_hz` times per second; 10 times per second otherwise
        /// - "rate": `rate_hz` times per second, whatever the face does
        pace: PaceKind = PaceKind::Pose, (), "";
        /// The rate that `pace` refers to, at least 10. 0 means the same as `send.rate_hz`.
        rate_hz: u32 = 0, 0..=240, " (1/s)";
        /// What the receiver gets once a lost face has been held for the time that `[failsafe]` gives:
        /// - "neutral": the face on its way to neutral, and then the neutral face
        /// - "hold": the last pose, until the face is back or the service stops
        /// - "silent": the face on its way to neutral, and then nothing, so that the receiver does what it does without a
        ///   sender
        loss: Loss = Loss::Neutral, (), "";
    }
}

/// What a receiver gets while no face is followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Loss {
    /// The neutral face.
    Neutral,
    /// The last pose.
    Hold,
    /// Nothing.
    Silent,
}

impl Choice for Loss {
    const ALL: &'static [(&'static str, Self)] =
        &[("neutral", Self::Neutral), ("hold", Self::Hold), ("silent", Self::Silent)];
}

/// What makes a link send.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PaceKind {
    /// Every new pose.
    Pose,
    /// A visible change.
    Change,
    /// The clock alone.
    Rate,
}

impl Choice for PaceKind {
    const ALL: &'static [(&'static str, Self)] =
        &[("pose", Self::Pose), ("change", Self::Change), ("rate", Self::Rate)];
}

/// How a link reaches its receiver.
#[derive(Debug, Clone, Copy)]
pub enum CarrierSettings<'a> {
    /// Datagrams to an address.
    Udp(&'a Address),
    /// Bytes on a serial line.
    Serial {
        /// The serial port.
        device: &'a SerialDevice,
        /// Its baud rate.
        baud: u32,
        /// What `SerialDevice::Auto` stands for.
        auto: AutoDevice,
    },
    /// A servo controller on an I2C bus.
    I2c(&'a Pca9685Board),
    /// Datagrams to those who ask for them.
    Subscribers(&'a IFacialMocapSettings),
    /// Lines on standard output.
    Stdout,
    /// Lines to the clients of a Unix socket.
    UnixSocket(&'a Path),
}

/// What "auto" stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AutoDevice {
    /// A microcontroller board.
    #[default]
    Microcontroller,
    /// A Pololu Maestro.
    Maestro,
}

impl LinkKind {
    /// The kind with an example of what it cannot do without.
    pub(super) fn with_example(mut self) -> Self {
        if let Self::Maestro(WithChannels { channels, .. }) | Self::Pca9685(WithChannels { channels, .. }) = &mut self {
            channels.push(ChannelSettings::example());
        }
        self
    }

    /// The carrier of this kind.
    #[must_use]
    pub fn carrier(&self) -> CarrierSettings<'_> {
        match self {
            Self::Udp(udp) => CarrierSettings::Udp(&udp.address),
            Self::LiveLink(live_link) => CarrierSettings::Udp(&live_link.address),
            Self::Vmc(vmc) => CarrierSettings::Udp(&vmc.address),
            Self::Vrchat(vrchat) => CarrierSettings::Udp(&vrchat.address),
            Self::Serial(serial) => {
                CarrierSettings::Serial { device: &serial.device, baud: serial.baud, auto: AutoDevice::Microcontroller }
            }
            Self::Maestro(MaestroSettings { board, .. }) => {
                CarrierSettings::Serial { device: &board.device, baud: board.baud, auto: AutoDevice::Maestro }
            }
            Self::Pca9685(pca9685) => CarrierSettings::I2c(&pca9685.board),
            Self::IFacialMocap(settings) => CarrierSettings::Subscribers(settings),
            Self::Json(json) => match &json.to {
                JsonTarget::Stdout => CarrierSettings::Stdout,
                JsonTarget::Udp(address) => CarrierSettings::Udp(address),
                JsonTarget::Unix(path) => CarrierSettings::UnixSocket(path),
            },
        }
    }
}

impl LinkSettings {
    /// A link of this kind with the settings that suit it.
    pub(super) fn of(kind: LinkKind) -> Self {
        let pace = match kind {
            LinkKind::Maestro(_) | LinkKind::Pca9685(_) => {
                PaceSettings { pace: PaceKind::Rate, rate_hz: SERVO_HZ, ..PaceSettings::default() }
            }
            _ => PaceSettings::default(),
        };
        Self { kind, pace, ..Self::default() }
    }

    /// The link to the microcontroller board that is plugged in. Its own rate suits its baud rate, whatever the camera's
    /// rate and that of `[send]` are.
    pub(super) fn to_the_board() -> Self {
        let pace = PaceSettings { pace: PaceKind::Change, rate_hz: BOARD_HZ, ..PaceSettings::default() };
        Self { kind: LinkKind::Serial(SerialSettings::default()), pace, ..Self::default() }
    }

    /// The serial port, the baud rate and what "auto" stands for, if the link uses a serial line.
    pub(super) fn line(&self) -> Option<(&SerialDevice, u32, AutoDevice)> {
        match self.kind.carrier() {
            CarrierSettings::Serial { device, baud, auto } => Some((device, baud, auto)),
            _ => None,
        }
    }

    /// The rate of the link in packets per second; `send_hz` is that of `[send]`.
    #[must_use]
    pub fn rate_hz(&self, send_hz: u32) -> u32 {
        if self.pace.rate_hz == 0 { send_hz } else { self.pace.rate_hz }
    }

    /// The most packets per second that the link sends for a camera of `fps` frames per second.
    pub(super) fn most_hz(&self, fps: u32, send_hz: u32) -> u32 {
        let rate_hz = self.rate_hz(send_hz);
        if self.pace.pace == PaceKind::Pose { rate_hz.max(fps) } else { rate_hz }
    }

    /// Length of a message on a serial line, bytes.
    pub(super) fn message_bytes(&self) -> usize {
        match &self.kind {
            LinkKind::Maestro(maestro) => maestro.message_bytes(),
            _ => FRAME_BYTES,
        }
    }

    /// Returns every key of a link of this kind.
    pub(super) fn keys(&self) -> Vec<&'static str> {
        let section = self.kind.section();
        [&["kind"], section.keys(), self.pace.keys(), &[ADJUST], section.tables()].concat()
    }

    /// Writes the lines of the table in TOML, each setting after its comment.
    pub(super) fn write(&self) -> String {
        let mut text = String::new();
        let lines = [&[" What the link sends, and how it travels:"], LinkKind::LINES].concat();
        write_setting(&mut text, &lines, &expected_kind(), &format!("kind = {}", quoted(self.kind.name())));
        let mut adjust = String::new();
        write_setting(&mut adjust, &ADJUST_LINES, "a table", &format!("{ADJUST} = {}", self.adjust.write_inline()));
        [text, self.kind.section().write(), self.pace.write(), adjust].join("\n")
            + &self.kind.section().write_tables("link")
    }
}

const ADJUST_LINES: [&str; 3] = [
    " Changes for this receiver alone, after those of [adjust] and with the same keys: mirror, and a table for each",
    " coefficient. They hold for the neutral face, too. For example:",
    "   adjust = { mirror = true, jawOpen = { gain = 1.2, max = 0.8 } }",
];

/// Describes the values of the key `kind`.
pub(super) fn expected_kind() -> String {
    let names: Vec<String> = LinkKind::NAMES.iter().map(|name| quoted(name)).collect();
    format!("one of {}", names.join(", "))
}

/// Shows where the link leads: an address, a path, or a serial port.
impl fmt::Display for LinkSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind.carrier() {
            CarrierSettings::Udp(address) => address.fmt(f),
            CarrierSettings::Serial { device, .. } => device.fmt(f),
            CarrierSettings::I2c(board) => board.place().fmt(f),
            CarrierSettings::Subscribers(settings) => settings.fmt(f),
            CarrierSettings::Stdout => f.write_str("standard output"),
            CarrierSettings::UnixSocket(path) => path.display().fmt(f),
        }
    }
}

/// Returns how many messages of this length a serial line of this baud rate may carry per second.
pub(super) fn most_messages_hz(baud: u32, bytes: usize) -> u32 {
    let packets = u64::from(baud) * LINE_SHARE / 100 / (bytes as u64 * BITS_PER_BYTE);
    u32::try_from(packets).unwrap_or(u32::MAX)
}
