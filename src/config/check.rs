//! Faults of settings that are valid one by one but do not fit together.

use super::{
    AutoDevice, CarrierSettings, Fault, Faults, LinkKind, LinkSettings, SerialDevice, link::most_messages_hz,
    receiver_check, rehearsal::Script, servo::MOST_MAESTRO_BAUD, servo_check, settings::Settings,
};
use crate::calibration::WearerName;
use crate::service::control_sockets;

/// Slowest rate of a link, packets per second: receivers go neutral after 500 ms without one.
const SLOWEST_LINK_HZ: u32 = 10;
/// Baud rates that every serial port supports. The last one carries the highest rate that a setting allows.
const USUAL_BAUDS: [u32; 6] = [19_200, 38_400, 57_600, 115_200, 230_400, 460_800];

/// Adds the faults of settings that do not fit together. Tables with faults of their own are not judged.
pub fn check(settings: &Settings, faults: &mut Faults) {
    check_tables(settings, faults);
    check_ports(settings, faults);
    check_lines(settings, faults);
    if !faults.concern("link") {
        receiver_check::check(settings, &control_sockets(), faults);
        settings.links.iter().for_each(|link| servo_check::check(link, faults));
    }
}

fn check_tables(settings: &Settings, faults: &mut Faults) {
    let failsafe = &settings.failsafe;
    let mut need = |good: bool, key: &'static str, value: String, expected: String| {
        let table = key.split('.').next().unwrap_or(key);
        if !good && !faults.concern(table) {
            faults.push(Fault::Together { key, value, expected });
        }
    };
    let [live, hold, neutral] = [failsafe.live_ms, failsafe.hold_ms, failsafe.neutral_ms];
    need(live < hold, "failsafe.hold_ms", hold.to_string(), format!("more than failsafe.live_ms, which is {live}"));
    need(
        hold < neutral,
        "failsafe.neutral_ms",
        neutral.to_string(),
        format!("more than failsafe.hold_ms, which is {hold}"),
    );
    let device = &settings.camera.device;
    let is_readable = Script::of(device).is_none_or(|script| script.is_ok());
    let cameras = "\"auto\", the path of a camera, part of its name, \"demo\" or a rehearsal";
    need(!device.trim().is_empty(), "camera.device", format!("{device:?}"), cameras.to_owned());
    need(is_readable, "camera.device", format!("{device:?}"), Script::EXPECTED.to_owned());
    let paths = [
        ("networks.folder", &settings.networks.folder),
        ("solver.model", &settings.solver.model),
        ("wearer.folder", &settings.wearer.folder),
    ];
    for (key, path) in paths {
        let expected = "a path from / on: no shell replaces the ~ of a setting".to_owned();
        need(!path.starts_with('~'), key, format!("{path:?}"), expected);
    }
    let name = &settings.wearer.name;
    let is_name = name.is_empty() || WearerName::new(name).is_some();
    need(is_name, "wearer.name", format!("{name:?}"), format!("{}, or \"\"", WearerName::EXPECTED));
    need(!settings.links.is_empty(), "link", "[]".to_owned(), "at least one [[link]]".to_owned());
    let sends_to_nobody = |link: &LinkSettings| matches!(&link.kind, LinkKind::IFacialMocap(it) if it.listen.0.is_none() && it.address.0.is_none());
    let is_wanted = !settings.links.iter().any(sends_to_nobody);
    need(is_wanted, "link.listen", "\"\"".to_owned(), "an address to listen at, or link.address".to_owned());
    for rate_hz in settings.links.iter().map(|link| link.pace.rate_hz).filter(|rate_hz| *rate_hz > 0) {
        let expected = format!("0 or at least {SLOWEST_LINK_HZ}: receivers go neutral when packets come more rarely");
        need(rate_hz >= SLOWEST_LINK_HZ, "link.rate_hz", rate_hz.to_string(), expected);
    }
}

/// Adds a fault for every serial port or chip that two links share, and for "auto" beside another port. Only the text
/// counts: two names may mean the same device for a while, and the links then wait for each other.
fn check_ports(settings: &Settings, faults: &mut Faults) {
    if faults.concern("link") {
        return;
    }
    let ports: Vec<_> =
        settings.links.iter().filter_map(|link| link.line()).map(|(port, _, auto)| (port, auto)).collect();
    for (index, (device, auto)) in ports.iter().enumerate() {
        let is_same = |(earlier, other): &(&SerialDevice, AutoDevice)| {
            earlier == device && (auto == other || **device != SerialDevice::Auto)
        };
        if ports.iter().take(index).any(is_same) {
            faults.push(Fault::SamePort { device: (*device).clone() });
        }
        let is_beside = |(other, kind): &&(&SerialDevice, AutoDevice)| kind == auto && **other != SerialDevice::Auto;
        if let (SerialDevice::Auto, Some((other, _))) = (device, ports.iter().find(is_beside)) {
            faults.push(Fault::AutoBeside { other: (*other).clone() });
        }
    }
    check_chips(settings, faults);
}

fn check_chips(settings: &Settings, faults: &mut Faults) {
    let mut chips = Vec::new();
    for link in &settings.links {
        let CarrierSettings::I2c(board) = link.kind.carrier() else { continue };
        if chips.contains(&board.place()) {
            let expected = "another bus or address: an earlier link has the same chip".to_owned();
            faults.push(Fault::Together { key: "link.address", value: format!("{:#04x}", board.address), expected });
        }
        chips.push(board.place());
    }
}

/// Adds a fault for every serial line that is too slow for its link. By USB, which is where "auto" finds a Maestro, a baud
/// rate means nothing.
fn check_lines(settings: &Settings, faults: &mut Faults) {
    if ["camera", "send", "link"].iter().any(|table| faults.concern(table)) {
        return;
    }
    for link in &settings.links {
        let Some((device, baud, auto)) = link.line() else { continue };
        let rate_hz = link.most_hz(settings.camera.fps, settings.send.rate_hz);
        let most_hz = |baud| most_messages_hz(baud, link.message_bytes());
        let is_usb = (device, auto) == (&SerialDevice::Auto, AutoDevice::Maestro);
        if !is_usb && most_hz(baud) < rate_hz {
            let most_baud = if auto == AutoDevice::Maestro { MOST_MAESTRO_BAUD } else { u32::MAX };
            let advice = line_advice(baud, most_baud, rate_hz, most_hz);
            faults.push(Fault::SlowLine { device: device.clone(), baud, rate_hz, advice });
        }
    }
}

/// Says what to give so that a line carries its messages. `most_hz` is how many a line of a baud rate carries.
fn line_advice(baud: u32, most_baud: u32, rate_hz: u32, most_hz: impl Fn(u32) -> u32) -> String {
    let usual = || USUAL_BAUDS.into_iter().filter(|usual| *usual <= most_baud);
    let slower = |baud| format!("pace = \"rate\" and rate_hz = {}", most_hz(baud));
    let fastest = usual().next_back().unwrap_or(baud);
    match usual().find(|baud| most_hz(*baud) >= rate_hz) {
        Some(enough) if most_hz(baud) >= SLOWEST_LINK_HZ => format!("{enough} or more, or {}", slower(baud)),
        Some(enough) => format!("{enough} or more"),
        None if fastest > baud => format!("{fastest}, {}", slower(fastest)),
        None => slower(baud),
    }
}
