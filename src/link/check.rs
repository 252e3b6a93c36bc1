//! Links whose settings are valid one by one but cannot work, and what is worth knowing about those that do.

use std::fmt::Display;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use facewire_board::Attached;
use facewire_face::{Adjustment, Adjustments, BLENDSHAPES};
use facewire_packet::FRAME_BYTES;
use facewire_packet::formats::LiveLink;
use facewire_packet::formats::dmx::MOST_HZ;
use facewire_packet::formats::vrchat::{PARAMETERS, Parameters};

use crate::config::{
    ArtNetSettings, Choice as _, Faults, IFacialMocapSettings, JsonSettings, JsonTarget, LinkKind, LinkSettings,
    Listen, Loss, MOST_MAESTRO_BAUD, PaceKind, Pca9685Settings, SLOWEST_LINK_HZ, SacnSettings, SerialDevice, Settings,
    VrchatSettings, quoted,
};
use facewire_servo::ChannelSettings;
use facewire_servo::check::{Capabilities, Fault, faults, limited};
use facewire_servo::maestro::COMMAND_BYTES;

/// Share of a serial line that packets may use, percent. The rest makes up for clocks that differ.
const LINE_SHARE: u64 = 80;
const BITS_PER_BYTE: u64 = 10;
/// Baud rates that every serial port supports. The last one carries the highest rate that a setting allows.
const USUAL_BAUDS: [u32; 6] = [19_200, 38_400, 57_600, 115_200, 230_400, 460_800];

/// Adds the faults of links. `control` are the paths at which the service's control socket may be. Links with a value that is
/// wrong by itself are not judged.
pub fn check_settings(settings: &Settings, control: &[PathBuf], faults: &mut Faults) {
    let links = settings.readable_links(faults);
    for (index, (place, link)) in links.iter().enumerate() {
        let earlier = links.get(..index).unwrap_or_default();
        let mut check = Check { place: *place, link, earlier, links: &links, settings, faults };
        if let Some(line) = link.kind.line() {
            check.port(line);
            check.speed(line);
        }
        match &link.kind {
            LinkKind::Maestro(it) => check.servos(&Capabilities::maestro(it.multiple_targets), &it.channels),
            LinkKind::Pca9685(it) => {
                check.chip(it);
                check.servos(&Capabilities::pca9685(it.period()), &it.channels);
                check.needs_even_steps("PCA9685");
            }
            LinkKind::BusServo(it) => {
                let expected = "the path of the adapter's port, because anything may be connected to such an adapter";
                check.require(it.device != SerialDevice::Auto, "link.device", "\"auto\"", expected);
                check.servos(&Capabilities::bus_servo(it.family, it.unit), &it.channels);
                check.needs_even_steps("bus servo");
            }
            LinkKind::Sacn(SacnSettings { universe, from, channels, .. })
            | LinkKind::ArtNet(ArtNetSettings { universe, from, channels, .. }) => {
                check.universe(*universe, *from, channels);
            }
            LinkKind::IFacialMocap(it) => check.listener(it),
            LinkKind::Json(it) => check.socket(it, control),
            LinkKind::Vrchat(it) => check.parameters(it),
            LinkKind::Udp(_) | LinkKind::Serial(_) | LinkKind::LiveLink(_) | LinkKind::Vmc(_) => {}
        }
    }
}

/// The port of a link, its baud rate, and what "auto" stands for.
type Line<'a> = (&'a SerialDevice, u32, Attached);

struct Check<'a> {
    /// The place of the link among all links.
    place: usize,
    link: &'a LinkSettings,
    earlier: &'a [(usize, &'a LinkSettings)],
    links: &'a [(usize, &'a LinkSettings)],
    settings: &'a Settings,
    faults: &'a mut Faults,
}

impl<'a> Check<'a> {
    fn earlier(&self) -> impl Iterator<Item = &'a LinkSettings> + use<'a> {
        self.earlier.iter().map(|(_, link)| *link)
    }

    fn conflict(&mut self, key: &str, value: impl Display, expected: impl Display) {
        self.faults.conflict(&self.settings.key_of_link(self.place, key), value, expected);
    }

    fn require(&mut self, is_good: bool, key: &str, value: impl Display, expected: impl Display) {
        if !is_good {
            self.conflict(key, value, expected);
        }
    }

    /// Adds a fault for a serial port that two links share, and for "auto" beside another port. Only the text counts: two
    /// names may mean the same device for a while, and the links then wait for each other.
    fn port(&mut self, (device, _, auto): Line<'_>) {
        let is_auto = *device == SerialDevice::Auto;
        let is_same = |(other, _, other_auto): Line<'_>| other == device && (other_auto == auto || !is_auto);
        let is_taken = self.earlier().filter_map(|link| link.kind.line()).any(is_same);
        let expected = "another port, or remove this link: an earlier link has the same port";
        self.require(!is_taken, "link.device", quoted(&device.to_string()), expected);
        let mut others = self.links.iter().filter_map(|(_, link)| link.kind.line());
        let beside = others.find(|(other, _, other_auto)| *other_auto == auto && **other != SerialDevice::Auto);
        if let (true, Some((other, ..))) = (is_auto, beside) {
            let why = format!("another link has the port {other}, which \"auto\" may find, too");
            let expected = format!("the path of a port, or remove this link: {why}");
            self.conflict("link.device", "\"auto\"", expected);
        }
    }

    /// Adds a fault for a serial line that is too slow for its link. By USB, which is where "auto" finds a Maestro, a baud
    /// rate means nothing.
    fn speed(&mut self, (device, baud, auto): Line<'_>) {
        let is_usb = *device == SerialDevice::Auto && auto == Attached::Maestro;
        if is_usb || ["camera.fps", "send.rate_hz"].iter().any(|key| self.faults.is_invalid(key)) {
            return;
        }
        let rate_hz = self.link.rate_hz(self.settings.send.rate_hz);
        let fps = if self.link.pace.pace == PaceKind::Pose { self.settings.camera.fps } else { 0 };
        let rate_hz = rate_hz.max(fps);
        let (message_bytes, share) = match &self.link.kind {
            // A command for each channel, in the longer of both protocols and with a CRC.
            LinkKind::Maestro(it) => (COMMAND_BYTES * it.channels.len().max(1), LINE_SHARE),
            LinkKind::BusServo(it) => (it.family.line_bytes(it.channels.len()), 100),
            _ => (FRAME_BYTES, LINE_SHARE),
        };
        let most_hz = |baud: u32| {
            let packets = u64::from(baud) * share / 100 / (message_bytes as u64 * BITS_PER_BYTE);
            u32::try_from(packets).unwrap_or(u32::MAX)
        };
        if most_hz(baud) >= rate_hz {
            return;
        }
        let most_baud = if auto == Attached::Maestro { MOST_MAESTRO_BAUD } else { u32::MAX };
        let usual = || USUAL_BAUDS.into_iter().filter(|usual| *usual <= most_baud);
        let slower = |baud| format!("pace = \"rate\" and rate_hz = {}", most_hz(baud));
        let fastest = usual().next_back().unwrap_or(baud);
        let advice = match usual().find(|baud| most_hz(*baud) >= rate_hz) {
            Some(enough) if most_hz(baud) >= SLOWEST_LINK_HZ => format!("{enough} or more, or {}", slower(baud)),
            Some(enough) => format!("{enough} or more"),
            None if fastest > baud => format!("{fastest}, {}", slower(fastest)),
            None => slower(baud),
        };
        let because = format!("{rate_hz} packets a second need more than {share} % of the line at {device}");
        self.conflict("link.baud", baud, format!("{advice}: {because}"));
    }

    fn chip(&mut self, Pca9685Settings { bus, address, .. }: &Pca9685Settings) {
        let is_same = |link: &LinkSettings| matches!(&link.kind, LinkKind::Pca9685(it) if (it.bus, it.address) == (*bus, *address));
        let expected = "another bus or address: an earlier link has the same chip";
        self.require(!self.earlier().any(is_same), "link.address", format!("{address:#04x}"), expected);
    }

    fn servos(&mut self, board: &Capabilities, channels: &[ChannelSettings]) {
        self.require(!channels.is_empty(), "link.channel", "[]", "at least one [[link.channel]]");
        let expected = "\"neutral\" or \"hold\" for a servo board, and loss = \"release\" for channels that are to be switched off";
        self.require(self.link.pace.loss != Loss::Silent, "link.loss", "\"silent\"", expected);
        self.channels(board, channels);
    }

    fn needs_even_steps(&mut self, board: &str) {
        let expected = format!("\"rate\" for a {board}: its speed limits are kept by even steps");
        self.require(self.link.pace.pace == PaceKind::Rate, "link.pace", "another pace", expected);
    }

    fn channels(&mut self, board: &Capabilities, channels: &[ChannelSettings]) {
        // A source with a typing error counts for nothing.
        let has_sources = !self.faults.has_any_in("link.channel.sources", self.place);
        for Fault { key, value, expected } in faults(board, channels, has_sources) {
            self.conflict(key, value, expected);
        }
    }

    /// Adds the faults of a universe: datagrams of two links in one universe would take turns, and nodes drop what is out of
    /// order.
    fn universe(&mut self, universe: u32, from: Option<SocketAddr>, channels: &[ChannelSettings]) {
        let kind = &self.link.kind;
        let place = |kind: &LinkKind| (kind.name(), kind.universe().map(|(number, _)| number), kind.address());
        let is_taken = self.earlier().any(|earlier| place(&earlier.kind) == place(kind));
        let expected = "another universe or address, or all channels in one link: an earlier link has the same";
        self.require(!is_taken, "link.universe", universe, expected);
        let expected = "1 to 63999: sACN counts universes from 1, where Art-Net has 0";
        self.require(universe > 0 || matches!(kind, LinkKind::ArtNet(_)), "link.universe", universe, expected);
        let pace = self.link.pace.pace;
        let rate_hz = self.link.rate_hz(self.settings.send.rate_hz);
        let expected = "\"rate\" for DMX: unchanged values are sent less often anyway";
        self.require(pace == PaceKind::Rate, "link.pace", quoted(pace.name()), expected);
        let expected = format!("{SLOWEST_LINK_HZ} to {MOST_HZ}: a DMX line carries no more");
        self.require(rate_hz <= MOST_HZ, "link.rate_hz", rate_hz, expected);
        self.channels(&Capabilities::DMX, channels);
        if let Some(from) = from {
            self.sender(from);
        }
    }

    /// Adds the faults of the address of this machine that a link sends from.
    fn sender(&mut self, from: SocketAddr) {
        let from_of = |link: &LinkSettings| link.kind.universe().and_then(|(_, from)| from);
        let is_same = |other| from.port() > 0 && is_same_port(other, from);
        let is_taken = self.earlier().filter_map(from_of).any(is_same);
        let receiver = self.link.kind.address().and_then(|address| address.as_str().parse().ok());
        let is_mixed = receiver.is_some_and(|receiver: SocketAddr| receiver.is_ipv4() != from.is_ipv4());
        for (is_wrong, expected) in [
            (is_taken, "another port, or 0 for any, because an earlier link sends from there"),
            (is_mixed, "an address like that of the receiver: one is of IPv4 and the other of IPv6"),
        ] {
            self.require(!is_wrong, "link.from", quoted(&from.to_string()), expected);
        }
    }

    fn listener(&mut self, it: &IFacialMocapSettings) {
        let Some(listen) = it.listen else {
            let expected = "an address to listen at, or link.address";
            return self.require(it.address.is_some(), "link.listen", "\"\"", expected);
        };
        let is_shared = |link: &LinkSettings| match &link.kind {
            LinkKind::IFacialMocap(it) => it.listen.is_some_and(|other| is_same_port(other, listen)),
            _ => false,
        };
        let expected = "another port, because an earlier link listens there, or \"\" with link.address";
        self.require(!self.earlier().any(is_shared), "link.listen", quoted(&listen.to_string()), expected);
    }

    fn socket(&mut self, it: &JsonSettings, control: &[PathBuf]) {
        let JsonTarget::Unix(path) = &it.to else { return };
        let is_path = |other: &Path| other == path;
        let serves = |link: &LinkSettings| matches!(&link.kind, LinkKind::Json(earlier) if earlier == it);
        let user = if self.earlier().any(serves) {
            "an earlier link"
        } else if matches!(&self.settings.metrics.listen, Listen::Unix(other) if is_path(other)) {
            "metrics.listen"
        } else if control.iter().any(|other| is_path(other)) {
            "the control socket of the service"
        } else {
            return;
        };
        let value = quoted(&format!("unix:{}", path.display()));
        self.conflict("link.to", value, format!("another path: {user} has this one"));
    }

    /// Adds the faults of a link to VRChat that names an unknown parameter, or sends none.
    fn parameters(&mut self, it: &VrchatSettings) {
        for name in it.parameters.names().filter(|name| PARAMETERS.iter().all(|known| known.name != *name)) {
            self.conflict("link.parameters", quoted(name), Parameters::EXPECTED);
        }
        let has_form = it.floats || it.bits > 0;
        let has_group = it.shapes || it.compounds || it.head;
        if it.parameters.names_any() || it.native_eyes || has_form && has_group {
            return;
        }
        let (key, others) = if has_form {
            ("link.shapes", "link.compounds or link.head")
        } else {
            ("link.floats", "link.bits or link.parameters")
        };
        let expected = format!("true, or {others}, because no parameter is sent otherwise");
        self.conflict(key, false, expected);
    }
}

/// Whether the system lets only one of two sockets have its address.
fn is_same_port(one: SocketAddr, other: SocketAddr) -> bool {
    // A socket for all IPv6 addresses takes those of IPv4, too.
    let covers = |one: SocketAddr, other: SocketAddr| one.ip().is_unspecified() && (one.is_ipv6() || other.is_ipv4());
    one.port() == other.port() && (one.ip() == other.ip() || covers(one, other) || covers(other, one))
}

/// Says where a sum can leave its range and is limited, which names not every receiver reads, and which receiver gets the same
/// twice. All may be meant.
pub fn notes(settings: &Settings) -> Vec<String> {
    let mut notes = notes_of_adjustments("adjust", &settings.adjust);
    for (index, link) in settings.links.iter().enumerate() {
        if settings.links.iter().take(index).any(|earlier| earlier.kind == link.kind) {
            notes.push(format!(
                "{link}: an earlier link sends the same there; remove one, because faces of two links mix"
            ));
        }
        notes.extend(notes_of_adjustments("link.adjust", &link.adjust));
        if let LinkKind::LiveLink(it) = &link.kind {
            notes.extend(LiveLink::note_of_names(&it.device_id, &it.subject).map(|note| format!("{link}: {note}")));
        }
        let channels = link.kind.channels().into_iter().flatten();
        notes.extend(channels.filter_map(|channel| {
            limited(channel).map(|note| format!("channel {} of {link}: {note}", channel.label()))
        }));
    }
    notes
}

fn notes_of_adjustments(table: &str, adjust: &Adjustments) -> Vec<String> {
    let note = |(name, Adjustment { gain, offset, min, max }): (&&str, &Adjustment)| {
        let least = *offset;
        let most = gain + offset;
        let sum = format!("{table}.{name}: gain * value + offset goes from {least} to {most}");
        (least < 0.0 || most > 1.0).then(|| format!("{sum} and is limited to {min} to {max}"))
    };
    BLENDSHAPES.iter().zip(&adjust.coefficients).filter_map(note).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{parse, parse_and_check};

    const MAESTRO: &str = "[[link]]\nkind = \"maestro\"\n";
    const PCA9685: &str = "[[link]]\nkind = \"pca9685\"\n";
    const BUS: &str = "[[link]]\nkind = \"bus-servo\"\ndevice = \"/dev/ttyUSB0\"\n";
    const SERVO: &str = "[[link.channel]]\nchannel = 3\nsources = { jawOpen = 1.0 }\nposition_at_1 = 1000\n";
    const SACN: &str = "[[link]]\nkind = \"sacn\"\n";
    const ARTNET: &str = "[[link]]\nkind = \"artnet\"\n";
    const JAW: &str = "[[link.channel]]\nchannel = 3\nsources = { jawOpen = 1.0 }\n";
    const JSON: &str = "[[link]]\nkind = \"json\"\nto = \"unix:/run/x\"\n";
    const SERIAL: &str = "[[link]]\nkind = \"serial\"\n";
    const IFACIALMOCAP: &str = "[[link]]\nkind = \"ifacialmocap\"\n";
    const VRCHAT: &str = "[[link]]\nkind = \"vrchat\"\n";

    fn faults(text: &[&str]) -> String {
        let check =
            |settings: &Settings, faults: &mut Faults| check_settings(settings, &["/run/control".into()], faults);
        parse_and_check("file", &text.concat(), check).err().unwrap_or_default().to_string()
    }

    #[test]
    fn links_that_cannot_work_are_refused_with_key_value_and_remedy_and_others_are_accepted() {
        let channel_16 = JAW.replace('3', "16");
        let jaw_at_512 = JAW.replace('3', "512") + "dmx = \"16-bit\"\n";
        let acm0 = "device = \"/dev/ttyACM0\"\n";
        let by_id = "device = \"/dev/serial/by-id/x\"\n";
        let artnet_port = "from = \"0.0.0.0:6454\"\n";
        let any_port = "from = \"192.168.1.5:0\"\n";
        let silent = "loss = \"silent\"\n";
        let elsewhere = "address = \"10.0.0.1:6454\"\n";
        let cases: [(&[&str], &str); 34] = [
            (&[MAESTRO], "link.channel = []: give at least one [[link.channel]]"),
            (&[PCA9685, &channel_16], "link.channel.channel = 16: give 0 to 15: these are the channels of a PCA9685"),
            (&[MAESTRO, &channel_16], ""),
            (&[MAESTRO, "multiple_targets = true\n", JAW, "pulse_at_1_us = 4080\n"], ""),
            (&[PCA9685, "pulses_hz = 400\n", JAW, "pulse_at_0_us = 2600\n"], "link.channel.pulse_at_0_us = 2600: give"),
            (&[PCA9685, "pace = \"change\"\n", JAW], "link.pace = another pace: give \"rate\" for a PCA9685"),
            (&[MAESTRO, "loss = \"silent\"\n", JAW], "link.loss = \"silent\": give \"neutral\" or \"hold\" for a"),
            (&[BUS, SERVO], ""),
            (
                &[BUS, "baud = 9600\n", SERVO],
                "link.baud = 9600: give 57600 or more, or pace = \"rate\" and rate_hz = 11:",
            ),
            (&[BUS, "pace = \"pose\"\n", SERVO], "link.pace = another pace: give \"rate\" for a bus servo:"),
            (&[&BUS.replace("/dev/ttyUSB0", "auto"), SERVO], "link.device = \"auto\": give the path of the ad"),
            (
                &[PCA9685, JAW, PCA9685, JAW],
                "link 2: link.address = 0x40: give another bus or address: an earlier link has",
            ),
            (&[MAESTRO, JAW, MAESTRO, JAW], "link 2: link.device = \"auto\": give another port, or remove this link"),
            (&[SERIAL, acm0, SERIAL], "link 2: link.device = \"auto\": give the path of a port, or remove this link"),
            (&[MAESTRO, JAW, SERIAL], ""),
            // Two names may mean one port at present, and two others later.
            (&[SERIAL, acm0, SERIAL, by_id], ""),
            (&[SACN, any_port, SACN, silent, "universe = 2\n", ARTNET, any_port, ARTNET, elsewhere], ""),
            (&[SACN, SACN], "link 2: link.universe = 1: give another universe or address, or all channels in one link"),
            (&[SACN, "universe = 0\n"], "link.universe = 0: give 1 to 63999: sACN counts universes from 1, where Art-"),
            (&[ARTNET, "rate_hz = 45\n"], "link.rate_hz = 45: give 10 to 44: a DMX line carries no more"),
            (&[SACN, artnet_port, ARTNET, artnet_port], "link 2: link.from = \"0.0.0.0:6454\": give another port"),
            (&[SACN, "from = \"[::1]:0\"\n"], "link.from = \"[::1]:0\": give an address like that of the receiver"),
            (&[ARTNET, "pace = \"pose\"\n"], "link.pace = \"pose\": give \"rate\" for DMX"),
            (&[SACN, &jaw_at_512], "link.channel.channel = 512: give 1 to 511: these are the channels of a universe"),
            (&[JSON], ""),
            (&[JSON, JSON], "link 2: link.to = \"unix:/run/x\": give another path: an earlier link has this one"),
            (&["[metrics]\nlisten = \"unix:/run/x\"\n", JSON], "link.to = \"unix:/run/x\": give another path: metr"),
            (&[&JSON.replace("/x", "/control")], "link.to = \"unix:/run/control\": give another path: the control"),
            (&[IFACIALMOCAP, "listen = \"\"\n"], "link.listen = \"\": give an address to listen at, or link.address"),
            (&[VRCHAT, "floats = false\n"], "link.floats = false: give true, or link.bits or link.parameters"),
            (&[VRCHAT, "shapes = false\ncompounds = false\nhead = false\n"], "link.shapes = false: give true, or"),
            (&[VRCHAT, "parameters = \"JawOpen, JawOpn\"\n"], "link.parameters = \"JawOpn\": give \"\", or names"),
            (&[VRCHAT, "floats = false\nparameters = \"JawOpen\"\n"], ""),
            // The link to the board that is plugged in suits any rate.
            (&["[camera]\nfps = 240\n[send]\nrate_hz = 240\n"], ""),
        ];
        for (text, want) in cases {
            let faults = faults(text);
            assert!(faults.starts_with(want) && faults.is_empty() == want.is_empty(), "{want}: {faults}");
            assert!(!faults.contains('\n'), "{faults}");
        }
    }

    #[test]
    fn a_wrong_value_hides_no_fault_of_another_link_and_each_fault_names_its_link() {
        let misspelt = JAW.replace("jawOpen", "jawOpn");
        let sourceless = JAW.replace("jawOpen = 1.0", "");
        let found = faults(&[
            SACN,
            "priority = 201\n",
            SACN,
            SACN,
            MAESTRO,
            &misspelt,
            PCA9685,
            &sourceless,
            SERIAL,
            "rate_hz = 9\n",
        ]);
        let wanted = [
            "file:3: link.priority = 201: give",
            "file:12: link.channel.sources.jawOpn is not a setting",
            "link 6: link.rate_hz = 9: give 0 or at least 10",
            "link 3: link.universe = 1: give another universe",
            "link 5: link.channel.sources = {}: give",
        ];
        assert_eq!(found.lines().count(), wanted.len(), "{found}");
        assert!(found.lines().zip(wanted).all(|(fault, want)| fault.starts_with(want)), "{found}");
        // Nothing is known of the port of the first link.
        assert_eq!(faults(&[SERIAL, "device = 5\n", SERIAL]).lines().count(), 1);
    }

    #[test]
    fn two_links_that_listen_at_one_port_are_refused() {
        let taken = ["127.0.0.1:5000", "0.0.0.0:5000", "[::]:5000"].map(|at| (at, true));
        let free = ["127.0.0.1:5001", "127.0.0.2:5000", "[::1]:5000"].map(|at| (at, false));
        for (earlier, is_refused) in taken.into_iter().chain(free) {
            let [one, other] = [earlier, "127.0.0.1:5000"].map(|listen| format!("listen = \"{listen}\"\n"));
            let faults = faults(&[IFACIALMOCAP, &one, IFACIALMOCAP, &other]);
            let want =
                "link 2: link.listen = \"127.0.0.1:5000\": give another port, because an earlier link listens there";
            assert_eq!((faults.starts_with(want), faults.is_empty()), (is_refused, !is_refused), "{faults}");
        }
    }

    #[test]
    fn a_rate_above_80_percent_of_a_serial_line_is_refused_with_the_rates_that_fit() {
        // 134 bytes of 10 bits: 115200 baud carry 85.97 a second, of which 68.8 are 80 %. Exactly 80 % for 60 packets are
        // 100500 baud.
        let slower = |rate_hz: u32| format!("pace = \"rate\" and rate_hz = {rate_hz}");
        for (baud, fps, rate_hz, pace, advice) in [
            (115_200, 30, 69, "pose", format!("230400 or more, or {}: 69", slower(68))),
            (115_200, 69, 30, "pose", format!("230400 or more, or {}: 69", slower(68))),
            (115_200, 30, 68, "pose", String::new()),
            (115_200, 69, 30, "change", String::new()),
            (100_499, 60, 60, "pose", format!("115200 or more, or {}: 60", slower(59))),
            (100_500, 60, 60, "pose", String::new()),
            (19_200, 240, 240, "pose", format!("460800 or more, or {}: 240", slower(11))),
            (460_800, 240, 240, "pose", String::new()),
            (19_200, 60, 60, "rate", format!("115200 or more, or {}: 60", slower(11))),
            (19_200, 60, 11, "rate", String::new()),
        ] {
            let rates = format!("[camera]\nfps = {fps}\n[send]\nrate_hz = {rate_hz}\n");
            let keys = format!("device = \"/dev/ttyS0\"\nbaud = {baud}\npace = \"{pace}\"\n");
            assert_eq!(faults(&[&rates, SERIAL, &keys]), too_slow(baud, &advice, "/dev/ttyS0"));
        }
        let faults = faults(&["[camera]\nfps = 0\n", SERIAL, "device = \"/dev/ttyS0\"\nbaud = 19200\n"]);
        assert!(faults.starts_with("file:2: camera.fps = 0") && !faults.contains("link.baud"), "{faults}");
        let slow = ["[camera]\nwidth = 10\n", SERIAL, "device = \"/dev/ttyS0\"\nbaud = 19200\n"];
        let faults = self::faults(&slow);
        assert!(faults.contains("camera.width = 10") && faults.contains("link.baud = 19200"), "{faults}");
    }

    /// The fault of a serial line, or none if there is no advice.
    fn too_slow(baud: u32, advice: &str, device: &str) -> String {
        let because = format!("packets a second need more than 80 % of the line at {device}");
        if advice.is_empty() { String::new() } else { format!("link.baud = {baud}: give {advice} {because}") }
    }

    #[test]
    fn the_advice_about_a_baud_rate_is_one_that_a_maestro_can_follow_and_by_usb_there_is_none() {
        let channels = |count: u32| (0..count).map(|number| JAW.replace('3', &number.to_string())).collect::<String>();
        assert_eq!(faults(&[MAESTRO, "rate_hz = 240\nbaud = 9600\n", &channels(24)]), "");
        for (baud, rate_hz, count, advice) in [
            (115_200, 60, 24, "pace = \"rate\" and rate_hz = 54: 60"),
            (9600, 60, 24, "115200, pace = \"rate\" and rate_hz = 54: 60"),
            (9600, 50, 6, "38400 or more, or pace = \"rate\" and rate_hz = 18: 50"),
        ] {
            let keys = format!("device = \"/dev/ttyS1\"\nbaud = {baud}\nrate_hz = {rate_hz}\n");
            assert_eq!(faults(&[MAESTRO, &keys, &channels(count)]), too_slow(baud, advice, "/dev/ttyS1"));
        }
    }

    #[test]
    fn sums_that_can_leave_their_range_and_names_that_not_every_receiver_reads_are_noted_and_others_are_not() {
        let noted = |text: &[&str]| notes(&parse("file", &text.concat()).unwrap());
        assert!(noted(&[MAESTRO, JAW, "[link.adjust]\njawOpen = { gain = 0.5, offset = 0.5 }\n"]).is_empty());
        let adjust = "adjust = { jawOpen = { gain = 2.0, max = 0.8 } }\n";
        let limited = "and is limited to 0 to 1; with smaller numbers it would use its whole range";
        let want = [
            "adjust.jawLeft: gain * value + offset goes from -0.5 to 0.5 and is limited to 0 to 1",
            "link.adjust.jawOpen: gain * value + offset goes from 0 to 2 and is limited to 0 to 0.8",
            &format!("channel 3 of auto: the sum of its sources goes from 0.25 to 1.25 {limited}"),
        ];
        assert_eq!(noted(&["[adjust]\njawLeft = { offset = -0.5 }\n", MAESTRO, adjust, JAW, "offset = 0.25\n"]), want);
        let to = |kind: &str, keys: &str| format!("[[link]]\nkind = \"{kind}\"\n{keys}\n");
        for (one, other, is_doubled) in [
            (to("udp", ""), to("udp", "pace = \"rate\""), true),
            (to("udp", ""), to("udp", "address = \"127.0.0.1:5253\""), false),
            (to("udp", "address = \"pc:9000\""), to("vmc", "address = \"pc:9000\""), false),
            (to("live-link", "subject = \"left__\""), to("live-link", "subject = \"right_\""), false),
            (to("json", ""), to("json", ""), true),
        ] {
            let notes = noted(&[&one, &other]);
            let want = "an earlier link sends the same there; remove one";
            assert_eq!(notes.iter().any(|note| note.contains(want)), is_doubled, "{one}{other}{notes:?}");
        }
        let live_link = "[[link]]\nkind = \"live-link\"\n";
        assert!(noted(&[live_link]).is_empty(), "its datagrams have 312 bytes");
        let notes = noted(&[live_link, "subject = \"facewire\"\n"]).concat();
        assert!(notes.contains("the datagrams have 314 bytes") && notes.contains("6 characters"), "{notes}");
    }
}
