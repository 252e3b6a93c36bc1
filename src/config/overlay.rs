//! Lays a TOML file over settings.

use toml::{
    Spanned,
    de::{DeString, DeTable, DeValue, Error},
};

use super::{
    Fault, Faults,
    board::{self, Board},
    link::{ADJUST, LinkKind, LinkSettings, expected_kind},
    section::Section,
    settings::Settings,
};

/// Keys and tables that a file may have.
const NAMES: [&str; 16] = [
    "board",
    "camera",
    "networks",
    "solver",
    "smoothing",
    "wearer",
    "plausibility",
    "adjust",
    "failsafe",
    "send",
    "link",
    "realtime",
    "hardware",
    "adaptation",
    "metrics",
    "log",
];
/// Settings of earlier versions, and what to give instead.
const REPLACED: [(&str, &str); 2] =
    [("solver.smoothing_ms", REPLACED_BY_SMOOTHING), ("solver.smoothing_frames", REPLACED_BY_SMOOTHING)];
const REPLACED_BY_SMOOTHING: &str =
    "[smoothing] has a filter and a time for each part of the face, such as mouth_ms = 180";
/// A name that is less similar to an unknown key is not suggested.
const LEAST_SIMILARITY: f64 = 0.6;

/// The boards that a file may be laid over.
#[derive(Debug, Clone, Copy)]
pub struct Boards<'a> {
    /// The board to take whatever the file says.
    pub fixed: Option<Board>,
    /// The board that "auto" stands for, which is also the default.
    pub detected: &'a str,
}

/// A file that is being laid over settings.
pub struct Overlay<'a> {
    source: &'a str,
    text: &'a str,
    /// The faults found so far, each with its byte in the text.
    found: Vec<(usize, Fault)>,
}

impl<'a> Overlay<'a> {
    pub fn new(source: &'a str, text: &'a str) -> Self {
        Self { source, text, found: Vec::new() }
    }

    /// Lays the file over the settings, after the board that `boards` and the file choose, and adds its faults. The file of
    /// a board has no `boards`. After a fault, the settings must not be used. A text that is not TOML has syntax errors
    /// only: the parser's guess at its content would give misleading faults.
    pub fn apply(mut self, settings: &mut Settings, boards: Option<Boards<'_>>, faults: &mut Faults) {
        let (document, errors) = DeTable::parse_recoverable(self.text);
        if errors.is_empty() {
            let document = document.get_ref();
            if let Some((name, text)) = boards.and_then(|boards| self.board(document, boards)) {
                settings.board = name;
                Overlay::new(&format!("board {name}"), text).apply(settings, None, faults);
            }
            self.document(settings, document);
        }
        for error in errors {
            self.syntax(&error);
        }
        self.found.sort_by_key(|(offset, _)| *offset);
        for (_, fault) in self.found {
            faults.push(fault);
        }
    }
}

impl Overlay<'_> {
    /// Returns the board to lay the document over. A board that the document names must be known, even if another one is
    /// fixed.
    fn board(&mut self, document: &DeTable<'_>, boards: Boards<'_>) -> Option<Board> {
        let value = document.get("board");
        let name = value.map_or(Some(board::AUTO), |value| value.get_ref().as_str());
        let found = name.and_then(|name| board::find(name, boards.detected));
        if let (Some(value), None) = (value, found) {
            self.value("board", value, board::expected());
        }
        boards.fixed.or(found)
    }

    /// Lays the tables of the document over the settings.
    fn document(&mut self, settings: &mut Settings, document: &DeTable<'_>) {
        for (name, value) in document {
            match name.get_ref().as_ref() {
                "board" => {}
                "camera" => self.section(&mut settings.camera, "camera", value),
                "networks" => self.section(&mut settings.networks, "networks", value),
                "solver" => self.section(&mut settings.solver, "solver", value),
                "smoothing" => self.section(&mut settings.smoothing, "smoothing", value),
                "wearer" => self.section(&mut settings.wearer, "wearer", value),
                "plausibility" => self.section(&mut settings.plausibility, "plausibility", value),
                "adjust" => self.section(&mut settings.adjust, "adjust", value),
                "failsafe" => self.section(&mut settings.failsafe, "failsafe", value),
                "send" => self.section(&mut settings.send, "send", value),
                "link" => settings.links = self.links(value),
                "realtime" => self.section(&mut settings.realtime, "realtime", value),
                "hardware" => self.section(&mut settings.hardware, "hardware", value),
                "adaptation" => self.section(&mut settings.adaptation, "adaptation", value),
                "metrics" => self.section(&mut settings.metrics, "metrics", value),
                "log" => self.section(&mut settings.log, "log", value),
                unknown => self.unknown(unknown, unknown, &NAMES, name.span().start),
            }
        }
    }

    fn section(&mut self, section: &mut dyn Section, name: &str, value: &Spanned<DeValue<'_>>) {
        let Some(table) = value.get_ref().as_table() else {
            return self.value(name, value, "a table".to_owned());
        };
        for (key, value) in table {
            let path = format!("{name}.{}", key.get_ref());
            if let Some((_, instead)) = REPLACED.iter().find(|(old, _)| *old == path) {
                let fault = Fault::Replaced { place: self.place(key.span().start), key: path, instead };
                self.found.push((key.span().start, fault));
            } else if section.tables().contains(&key.get_ref().as_ref()) {
                self.tables(section, key.get_ref(), &path, value);
            } else if !section.keys().contains(&key.get_ref().as_ref()) {
                let known = [section.keys(), section.tables()].concat();
                self.unknown(&path, key.get_ref(), &known, key.span().start);
            } else if let Err(expected) = section.set(key.get_ref(), value.get_ref()) {
                self.value(&path, value, expected);
            }
        }
    }

    /// Lays the table, or each table of an array, over that of the section.
    fn tables(&mut self, section: &mut dyn Section, key: &str, path: &str, value: &Spanned<DeValue<'_>>) {
        let one = std::slice::from_ref(value);
        for value in value.get_ref().as_array().map_or(one, |array| array) {
            if let Some(table) = section.table(key) {
                self.section(table, path, value);
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
        let Some(table) = value.get_ref().as_table() else {
            self.value("link", value, "a table".to_owned());
            return link;
        };
        if let Some(name) = table.get("kind") {
            let Some(kind) = named_kind(name.get_ref()) else {
                // The other keys cannot be judged without the kind.
                self.value("link.kind", name, expected_kind());
                return link;
            };
            link = LinkSettings::of(kind);
        }
        for (key, value) in table.iter().filter(|(key, _)| key.get_ref() != "kind") {
            self.link_key(&mut link, key, value);
        }
        link
    }

    /// Sets a key that is one of the link's kind, or one that all links share.
    fn link_key(&mut self, link: &mut LinkSettings, key: &Spanned<DeString<'_>>, value: &Spanned<DeValue<'_>>) {
        let (name, offset) = (key.get_ref().as_ref(), key.span().start);
        let path = format!("link.{name}");
        if name == ADJUST {
            return self.section(&mut link.adjust, &path, value);
        }
        if link.kind.section().tables().contains(&name) {
            return self.tables(link.kind.section_mut(), name, &path, value);
        }
        let section: &mut dyn Section =
            if link.pace.keys().contains(&name) { &mut link.pace } else { link.kind.section_mut() };
        if section.keys().contains(&name) {
            if let Err(expected) = section.set(name, value.get_ref()) {
                self.value(&path, value, expected);
            }
        } else if LinkKind::all()
            .iter()
            .any(|kind| kind.section().keys().contains(&name) || kind.section().tables().contains(&name))
        {
            let (kind, known) = (link.kind.name(), link.keys().join(", "));
            let fault = Fault::OtherKind { place: self.place(offset), key: path, kind, known };
            self.found.push((offset, fault));
        } else {
            self.unknown(&path, name, &link.keys(), offset);
        }
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

    /// Returns `file:line` of a byte of the text.
    fn place(&self, offset: usize) -> String {
        let before = self.text.get(..offset).unwrap_or_default();
        let line = 1 + before.matches('\n').count();
        format!("{}:{line}", self.source)
    }
}

fn named_kind(name: &DeValue<'_>) -> Option<LinkKind> {
    LinkKind::all().into_iter().find(|kind| name.as_str() == Some(kind.name()))
}

/// Escapes control characters: a quoted key may contain line breaks, or sequences that a terminal obeys.
fn printable(text: &str) -> String {
    let one = |c: char| if c.is_control() { c.escape_default().collect() } else { c.to_string() };
    text.chars().map(one).collect()
}

/// Returns the end of a sentence that names the known name most similar to `key`, or all known names if none is similar.
fn hint(key: &str, known: &[&str]) -> String {
    let similarity = |name: &str| strsim::jaro_winkler(key, name);
    let nearest = known.iter().max_by(|a, b| similarity(a).total_cmp(&similarity(b)));
    match nearest {
        Some(name) if similarity(name) >= LEAST_SIMILARITY => format!("; did you mean {name}?"),
        _ => format!("; there are {}", known.join(", ")),
    }
}
