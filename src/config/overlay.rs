//! Lays a TOML file over settings, and collects its faults.

use std::fmt;

use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use super::{
    builtin::{AUTO, Board, board_names, find_board},
    section::{Entry, Section},
    settings::Settings,
    value::one_of,
};

/// Settings of earlier versions, and what to give instead.
const REPLACED: [(&str, &str); 2] =
    [("solver.smoothing_ms", REPLACED_BY_SMOOTHING), ("solver.smoothing_frames", REPLACED_BY_SMOOTHING)];
const REPLACED_BY_SMOOTHING: &str =
    "[smoothing] has a filter and a time for each part of the face, such as mouth_ms = 180";
/// A name that is less similar to an unknown key is not suggested.
const LEAST_SIMILARITY: f64 = 0.6;

/// A fault of the settings. Displays as one line.
#[derive(Debug)]
pub struct Fault {
    /// The position as `file:line`, unless the fault is that of a file or of several settings together.
    pub place: Option<String>,
    key: String,
    /// Whether the value is wrong by itself: of another type, or out of bounds.
    is_invalid_value: bool,
    sentence: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.place {
            Some(place) => write!(f, "{place}: {}", self.sentence),
            None => f.write_str(&self.sentence),
        }
    }
}

/// All faults of the settings, displayed one per line.
#[derive(Debug, Default, thiserror::Error)]
pub struct Faults(Vec<Fault>);

impl Faults {
    /// Adds a fault without a position.
    pub(super) fn push(&mut self, sentence: String) {
        self.0.push(Fault { place: None, key: String::new(), is_invalid_value: false, sentence });
    }

    /// Adds the fault that a value is valid by itself, but not together with other settings.
    pub fn conflict(&mut self, key: &str, value: impl fmt::Display, expected: impl fmt::Display) {
        self.push(format!("{key} = {value}: give {expected}"));
    }

    /// Returns `value` if there are no faults.
    pub fn into_result<T>(self, value: T) -> Result<T, Self> {
        if self.0.is_empty() { Ok(value) } else { Err(self) }
    }

    /// Whether a value in this table is wrong by itself.
    pub fn has_invalid_value(&self, table: &str) -> bool {
        self.0.iter().any(|fault| fault.is_invalid_value && fault.key.split('.').next() == Some(table))
    }

    /// Whether a key in this table is unknown, or its value wrong.
    pub fn has_any_in(&self, table: &str) -> bool {
        self.0.iter().any(|fault| fault.key.strip_prefix(table).is_some_and(|rest| rest.starts_with('.')))
    }

    pub fn iter(&self) -> impl Iterator<Item = &Fault> {
        self.0.iter()
    }
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.0.iter().map(Fault::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

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

/// Lays the text of the file `source` over the settings, after the board that `boards` and the file choose, and adds its
/// faults. The file of a board has no `boards`. After a fault, the settings must not be used. A text that is not TOML has
/// syntax errors only: the parser's guess at its content would give misleading faults.
pub fn lay(source: &str, text: &str, settings: &mut Settings, boards: Option<Boards<'_>>, faults: &mut Faults) {
    let mut file = Overlay { source, text, found: Vec::new() };
    let (document, errors) = DeTable::parse_recoverable(text);
    if errors.is_empty() {
        let document = document.get_ref();
        if let Some((name, text)) = boards.and_then(|boards| file.board(document, boards)) {
            settings.board = name;
            lay(&format!("board {name}"), text, settings, None, faults);
        }
        file.entries(settings, "", document);
    }
    for error in errors {
        let start = error.span().map_or(0, |span| span.start);
        file.fault(start, String::new(), false, format!("not valid TOML: {}", error.message()));
    }
    file.found.sort_by_key(|(start, _)| *start);
    faults.0.extend(file.found.into_iter().map(|(_, fault)| fault));
}

impl Overlay<'_> {
    /// Returns the board to lay the document over. A board that the document names must be known, even if another one is
    /// fixed.
    fn board(&mut self, document: &DeTable<'_>, boards: Boards<'_>) -> Option<Board> {
        let value = document.get("board");
        let name = value.map_or(Some(AUTO), |value| value.get_ref().as_str());
        let found = name.and_then(|name| find_board(name, boards.detected));
        if let (Some(value), None) = (value, found) {
            self.refuse_value("board", value, one_of(board_names()));
        }
        boards.fixed.or(found)
    }

    /// Lays the table of this entry over a section.
    pub fn section(&mut self, section: &mut dyn Section, entry: &Entry<'_>) {
        match entry.value.get_ref().as_table() {
            Some(table) => self.entries(section, &entry.path, table),
            None => self.refuse(entry, "a table".to_owned()),
        }
    }

    fn entries(&mut self, section: &mut dyn Section, path: &str, table: &DeTable<'_>) {
        for (name, value) in table {
            let (key, start) = (name.get_ref().as_ref(), name.span().start);
            let path = if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
            if section.keys().contains(&key) {
                section.set_key(&Entry { key, path, start, value }, self);
                continue;
            }
            let replaced = REPLACED.iter().find(|(old, _)| *old == path);
            let objection = match replaced {
                Some((_, instead)) => format!("no longer a setting: {instead}"),
                None => {
                    section.objection(key).unwrap_or_else(|| format!("not a setting{}", hint(key, &section.keys())))
                }
            };
            let sentence = format!("{} is {objection}", printable(&path));
            self.fault(start, path, false, sentence);
        }
    }

    /// Adds the fault that the value of this entry is not what is expected.
    pub fn refuse(&mut self, entry: &Entry<'_>, expected: String) {
        self.refuse_value(&entry.path, entry.value, expected);
    }

    pub fn refuse_value(&mut self, path: &str, value: &Spanned<DeValue<'_>>, expected: String) {
        let written = self.text.get(value.span()).unwrap_or_default().lines().next().unwrap_or_default();
        let sentence = format!("{path} = {}: give {expected}", printable(written));
        self.fault(value.span().start, path.to_owned(), true, sentence);
    }

    fn fault(&mut self, start: usize, key: String, is_invalid_value: bool, sentence: String) {
        let before = self.text.get(..start).unwrap_or_default();
        let place = Some(format!("{}:{}", self.source, 1 + before.matches('\n').count()));
        self.found.push((start, Fault { place, key, is_invalid_value, sentence }));
    }
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
