//! Lays a file over settings.

use toml::{
    Spanned,
    de::{DeTable, DeValue, Error},
};

use super::{
    Fault, Faults, board,
    rehearsal::Script,
    section::Section,
    settings::{LinkKind, LinkSettings, Settings, most_packets_hz},
    value::Choice as _,
};
use crate::link::device_number;

/// Keys and tables a file may have.
const NAMES: [&str; 10] =
    ["board", "camera", "networks", "solver", "failsafe", "send", "link", "realtime", "metrics", "log"];
/// Baud rates that every serial port knows. The last carries the highest rate a setting can give.
const USUAL_BAUDS: [u32; 6] = [19_200, 38_400, 57_600, 115_200, 230_400, 460_800];
/// Farther names are no help.
const LEAST_SIMILARITY: f64 = 0.6;

/// A file that is being laid over settings.
struct Overlay<'a> {
    source: &'a str,
    text: &'a str,
    /// Whether the board that the file names is taken.
    takes_board: bool,
    /// Byte of the text and what is wrong there.
    found: Vec<(usize, Fault)>,
}

/// Lays a board over the settings.
pub fn apply_board(settings: &mut Settings, (name, text): (&str, &str), faults: &mut Faults) {
    apply(settings, Overlay { source: &format!("board {name}"), text, takes_board: false, found: Vec::new() }, faults);
}

/// Lays a file over the settings, with the board it names under it if `takes_board`.
pub fn apply_file(settings: &mut Settings, source: &str, text: &str, takes_board: bool, faults: &mut Faults) {
    apply(settings, Overlay { source, text, takes_board, found: Vec::new() }, faults);
}

/// Lays the text over the settings and adds its faults. With a fault, the settings are not to be used. Of a text that is
/// not TOML nothing else is judged: what the parser guesses of it would give faults that are none.
fn apply(settings: &mut Settings, mut overlay: Overlay<'_>, faults: &mut Faults) {
    let (document, errors) = DeTable::parse_recoverable(overlay.text);
    if errors.is_empty() {
        overlay.document(settings, document.get_ref(), faults);
    }
    for error in errors {
        overlay.syntax(&error);
    }
    overlay.found.sort_by_key(|(offset, _)| *offset);
    for (_, fault) in overlay.found {
        faults.push(fault);
    }
}

/// Adds the faults of settings that do not go together; those that are faulty by themselves are not judged.
pub fn check_together(settings: &Settings, faults: &mut Faults) {
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
    let anything = "\"auto\", the path of a camera, part of its name, \"demo\" or a rehearsal";
    need(!device.trim().is_empty(), "camera.device", format!("{device:?}"), anything.to_owned());
    need(is_readable, "camera.device", format!("{device:?}"), Script::EXPECTED.to_owned());
    for (key, path) in [("networks.folder", &settings.networks.folder), ("solver.model", &settings.solver.model)] {
        let expected = "a path from / on: no shell replaces the ~ of a setting".to_owned();
        need(!path.starts_with('~'), key, format!("{path:?}"), expected);
    }
    need(!settings.links.is_empty(), "link", "[]".to_owned(), "at least one [[link]]".to_owned());
}

/// Adds the faults of serial links at a port that an earlier one has. Two names of one port are known only while it is
/// plugged in.
pub fn check_ports(settings: &Settings, faults: &mut Faults) {
    let devices = serial_links(settings).map(|link| &link.device).filter(|device| device.is_absolute());
    let ports: Vec<_> = devices.map(|device| (device, device_number(device))).collect();
    for (place, (device, number)) in ports.iter().enumerate() {
        let is_same = |other: &&(_, _)| other.0 == *device || (number.is_some() && other.1 == *number);
        if let Some((first, _)) = ports.iter().take(place).find(is_same) {
            faults.push(Fault::SamePort { first: (*first).clone(), device: (*device).clone() });
        }
    }
}

fn serial_links(settings: &Settings) -> impl Iterator<Item = &LinkSettings> {
    settings.links.iter().filter(|link| link.kind == LinkKind::Serial)
}

/// Adds the faults of serial lines that are too slow for what is sent.
pub fn check_lines(settings: &Settings, faults: &mut Faults) {
    if ["camera", "send", "link"].iter().any(|table| faults.concern(table)) {
        return;
    }
    let rate_hz = settings.camera.fps.max(settings.send.rate_hz);
    for link in serial_links(settings).filter(|link| most_packets_hz(link.baud) < rate_hz) {
        faults.push(Fault::SlowLine {
            device: link.device.clone(),
            baud: link.baud,
            rate_hz,
            most_hz: most_packets_hz(link.baud),
            enough: USUAL_BAUDS.into_iter().find(|baud| most_packets_hz(*baud) >= rate_hz).unwrap_or(u32::MAX),
        });
    }
}

impl Overlay<'_> {
    /// Sets what the document says, after what its board says.
    fn document(&mut self, settings: &mut Settings, document: &DeTable<'_>, faults: &mut Faults) {
        if let Some(value) = document.get("board") {
            self.board(settings, value, faults);
        }
        for (name, value) in document {
            match name.get_ref().as_ref() {
                "board" => {}
                "camera" => self.section(&mut settings.camera, "camera", value),
                "networks" => self.section(&mut settings.networks, "networks", value),
                "solver" => self.section(&mut settings.solver, "solver", value),
                "failsafe" => self.section(&mut settings.failsafe, "failsafe", value),
                "send" => self.section(&mut settings.send, "send", value),
                "link" => settings.links = self.links(value),
                "realtime" => self.section(&mut settings.realtime, "realtime", value),
                "metrics" => self.section(&mut settings.metrics, "metrics", value),
                "log" => self.section(&mut settings.log, "log", value),
                unknown => self.unknown(unknown, unknown, &NAMES, name.span().start),
            }
        }
    }

    fn board(&mut self, settings: &mut Settings, value: &Spanned<DeValue<'_>>, faults: &mut Faults) {
        match value.get_ref().as_str().and_then(board::find) {
            Some(board) if self.takes_board => apply_board(settings, board, faults),
            Some(_) => {}
            None => self.value("board", value, board::expected()),
        }
    }

    fn section<S: Section>(&mut self, section: &mut S, name: &str, value: &Spanned<DeValue<'_>>) {
        let Some(table) = value.get_ref().as_table() else {
            return self.value(name, value, "a table".to_owned());
        };
        for (key, value) in table {
            let path = format!("{name}.{}", key.get_ref());
            if !S::KEYS.contains(&key.get_ref().as_ref()) {
                self.unknown(&path, key.get_ref(), S::KEYS, key.span().start);
            } else if let Err(expected) = section.set(key.get_ref(), value.get_ref()) {
                self.value(&path, value, expected);
            }
        }
    }

    fn links(&mut self, value: &Spanned<DeValue<'_>>) -> Vec<LinkSettings> {
        let Some(tables) = value.get_ref().as_array() else {
            self.value("link", value, "each link under its own [[link]]".to_owned());
            return Vec::new();
        };
        tables.iter().map(|table| self.link(table)).collect()
    }

    fn link(&mut self, value: &Spanned<DeValue<'_>>) -> LinkSettings {
        let mut link = LinkSettings::default();
        self.section(&mut link, "link", value);
        let table = value.get_ref().as_table();
        let keys = table.into_iter().flat_map(DeTable::keys);
        let known = |key: &str| !LinkSettings::KEYS.contains(&key) || link.kind.keys().contains(&key);
        for key in keys.filter(|key| !known(key.get_ref())) {
            self.other_kind(key.get_ref(), link.kind, key.span().start);
        }
        if link.kind == LinkKind::Serial && !table.is_some_and(|table| table.contains_key("device")) {
            self.no_device(value.span().start);
        }
        link
    }

    fn other_kind(&mut self, key: &str, kind: LinkKind, offset: usize) {
        let fault = Fault::OtherKind {
            place: self.place(offset),
            key: format!("link.{key}"),
            kind: kind.name(),
            known: kind.keys().join(", "),
        };
        self.found.push((offset, fault));
    }

    fn no_device(&mut self, offset: usize) {
        self.found.push((offset, Fault::NoDevice { place: self.place(offset) }));
    }

    fn syntax(&mut self, error: &Error) {
        let offset = error.span().map_or(0, |span| span.start);
        let place = self.place(offset);
        let message = error.message().to_owned();
        self.found.push((offset, Fault::Syntax { place, message }));
    }

    fn unknown(&mut self, path: &str, key: &str, known: &[&str], offset: usize) {
        let fault = Fault::Unknown { place: self.place(offset), key: printable(path), hint: hint(key, known) };
        self.found.push((offset, fault));
    }

    fn value(&mut self, path: &str, value: &Spanned<DeValue<'_>>, expected: String) {
        let offset = value.span().start;
        let written = self.text.get(value.span()).unwrap_or_default();
        let fault = Fault::Value {
            place: self.place(offset),
            key: path.to_owned(),
            value: printable(written.lines().next().unwrap_or_default()),
            expected,
        };
        self.found.push((offset, fault));
    }

    /// `file:line` of a byte of the text.
    fn place(&self, offset: usize) -> String {
        let before = self.text.get(..offset).unwrap_or_default();
        let line = 1 + before.matches('\n').count();
        format!("{}:{line}", self.source)
    }
}

/// The text with its control characters escaped: a quoted key may hold line ends and what a terminal takes for orders.
fn printable(text: &str) -> String {
    let one = |c: char| if c.is_control() { c.escape_default().collect() } else { c.to_string() };
    text.chars().map(one).collect()
}

/// The nearest known name as the end of a sentence; all of them when none is near.
fn hint(key: &str, known: &[&str]) -> String {
    let similarity = |name: &str| strsim::jaro_winkler(key, name);
    let nearest = known.iter().max_by(|a, b| similarity(a).total_cmp(&similarity(b)));
    match nearest {
        Some(name) if similarity(name) >= LEAST_SIMILARITY => format!("; did you mean {name}?"),
        _ => format!("; there are {}", known.join(", ")),
    }
}
