//! The settings of the service: their file, its former versions, and changes that keep its comments.

use std::{
    collections::BTreeSet,
    fs::{self, DirBuilder, Permissions},
    hash::{DefaultHasher, Hash as _, Hasher as _},
    io,
    os::unix::fs::{DirBuilderExt as _, PermissionsExt as _},
    path::PathBuf,
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use facewire_board::{WrongEncoding, is_utf16, utf8};
use serde::Serialize;
use serde_json::{Map, Value};
use toml_edit::{ArrayOfTables, DocumentMut, InlineTable, Item, Table, Value as TomlValue};
use toml_parser::{Source, lexer::TokenKind};

use crate::{
    files::{on_another_thread, write_atomically},
    program::Program,
};

/// The former versions that are kept.
const MOST_VERSIONS: usize = 10;
const REFUSED: &str = ".refused";
/// The longest list of links, or of channels, in which those that were removed or added are found.
const MOST_ALIGNED: usize = 64;
/// Settings that are longer are refused. The defaults with all comments have 20 kB.
pub const MOST_BYTES: usize = 128 * 1024;
/// The most levels of a key or a value. Those of facewire have at most six, as in `link.0.channel.2.sources.jawOpen`.
const MOST_LEVELS: usize = 16;
const TOO_DEEP: &str = "the settings have more than 16 levels; mend them, or restore a version";

/// What is wrong with settings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// Counted from 1. A fault between settings has no line.
    pub line: Option<u32>,
    pub key: Option<String>,
    pub text: String,
}

/// A former version of the file.
#[derive(Debug, Serialize)]
pub struct OldVersion {
    pub id: String,
    /// When it was stored, in seconds since 1970.
    pub time_s: f64,
    /// The keys that the next version changed.
    pub summary: String,
    /// Whether the service has refused it.
    pub refused: bool,
}

/// The file of a version. Its name is the time, and `.refused` before `.toml` if the service has refused it.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Version {
    time_us: u64,
    path: PathBuf,
}

impl Version {
    fn of(path: PathBuf) -> Option<Self> {
        let name = path.file_name()?.to_str()?.strip_suffix(".toml")?;
        let time_us = name.strip_suffix(REFUSED).unwrap_or(name).parse().ok()?;
        Some(Self { time_us, path })
    }

    fn is_refused(&self) -> bool {
        self.path.file_stem().is_some_and(|name| name.to_string_lossy().ends_with(REFUSED))
    }
}

/// The file of the settings, and the folder of its former versions.
#[derive(Debug, Clone)]
pub struct SettingsFile {
    pub path: PathBuf,
    versions: PathBuf,
}

impl SettingsFile {
    pub fn new(path: PathBuf, state: &std::path::Path) -> Self {
        Self { path, versions: state.join("settings") }
    }

    /// Runs `work` on another thread, because disks can be slow.
    pub async fn on_disk<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Self) -> io::Result<T> + Send + 'static,
    ) -> io::Result<T> {
        let file = self.clone();
        on_another_thread(move || work(&file)).await
    }

    /// Returns the text. A file that does not exist has none.
    pub fn text(&self) -> io::Result<String> {
        self.read().map(|(text, _)| text)
    }

    /// Returns the text, and the fault that the file has another encoding than UTF-8. Keeping the text mends that.
    pub fn read(&self) -> io::Result<(String, Option<Fault>)> {
        let file = match fs::read(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
            file => file?,
        };
        Ok(match utf8(file.clone()) {
            Ok(text) => (text.trim_start_matches('\u{feff}').to_owned(), None),
            Err(WrongEncoding { line, sentence }) => {
                let fault = Fault { line: u32::try_from(line).ok(), key: None, text: sentence.to_owned() };
                (decoded(&file), Some(fault))
            }
        })
    }

    /// Replaces the file by this text, and stores the text as a version, so that it can be restored after somebody has damaged
    /// the file with an editor. What an editor has changed is stored as a version first.
    pub fn keep(&self, text: &str) -> io::Result<()> {
        // Where the file is a link, its target is replaced.
        let path = fs::canonicalize(&self.path).unwrap_or_else(|_| self.path.clone());
        let (former, fault) = self.read()?;
        if text == former && fault.is_none() {
            return Ok(());
        }
        let mode = fs::metadata(&path).map_or(0o644, |file| Permissions::mode(&file.permissions()) & 0o777);
        DirBuilder::new().recursive(true).mode(0o700).create(&self.versions)?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let newest = self.versions()?.pop();
        let newest_us = newest.as_ref().map_or(0, |newest| newest.time_us);
        let time_us = u64::try_from(now.as_micros()).unwrap_or(u64::MAX).max(newest_us + 1);
        let store = |time_us: u64, text: &str| {
            write_atomically(&self.versions.join(format!("{time_us}.toml")), text.as_bytes(), 0o600)
        };
        if newest.is_none_or(|newest| fs::read_to_string(newest.path).ok().as_ref() != Some(&former)) {
            store(time_us, &former)?;
        }
        store(time_us + 1, text)?;
        write_atomically(&path, text.as_bytes(), mode)?;
        let versions = self.versions()?;
        // One of them is the present one.
        for version in versions.iter().take(versions.len().saturating_sub(MOST_VERSIONS + 1)) {
            fs::remove_file(&version.path)?;
        }
        Ok(())
    }

    /// Records whether the service refuses the present version.
    pub fn mark(&self, is_refused: bool) -> io::Result<()> {
        let Some(newest) = self.versions()?.pop() else { return Ok(()) };
        if newest.is_refused() == is_refused || fs::read_to_string(&newest.path)? != self.text()? {
            return Ok(());
        }
        let mark = if is_refused { REFUSED } else { "" };
        fs::rename(newest.path, self.versions.join(format!("{}{mark}.toml", newest.time_us)))
    }

    /// The files of the present version and the former ones, the newest last.
    fn versions(&self) -> io::Result<Vec<Version>> {
        let entries = match fs::read_dir(&self.versions) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries?,
        };
        let mut versions: Vec<_> = entries.filter_map(|entry| Version::of(entry.ok()?.path())).collect();
        versions.sort_unstable();
        Ok(versions)
    }

    /// Returns the former versions, the newest first.
    pub fn old_versions(&self) -> io::Result<Vec<OldVersion>> {
        let (mut next, mut found) = (self.text()?, Vec::new());
        for version in self.versions()?.into_iter().rev() {
            let text = fs::read_to_string(&version.path)?;
            if found.is_empty() && text == next {
                continue;
            }
            found.push(OldVersion {
                id: version.time_us.to_string(),
                time_s: Duration::from_micros(version.time_us).as_secs_f64(),
                summary: changed(&text, &next).join(", "),
                refused: version.is_refused(),
            });
            next = text;
        }
        Ok(found)
    }

    /// Returns the text of a former version, if there is one of this name.
    pub fn old_text(&self, id: &str) -> io::Result<Option<String>> {
        let version = self.versions()?.into_iter().find(|version| version.time_us.to_string() == id);
        version.map(|version| fs::read_to_string(version.path)).transpose()
    }
}

/// Returns the text of a file in another encoding than UTF-8, as well as it can be read.
fn decoded(file: &[u8]) -> String {
    if !is_utf16(file) {
        return file.iter().map(|byte| char::from(*byte)).collect();
    }
    let is_big = matches!(file, [0xFE, 0xFF, ..] | [0, ..]);
    let (pairs, _) = file.as_chunks();
    let units = pairs.iter().map(|pair| if is_big { u16::from_be_bytes(*pair) } else { u16::from_le_bytes(*pair) });
    let text: String = char::decode_utf16(units).map(|letter| letter.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
    text.trim_start_matches('\u{feff}').to_owned()
}

/// Tells two texts apart, so that nobody overwrites what somebody else has changed meanwhile.
pub fn hash(text: &str) -> String {
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}

/// Has facewire judge settings by their text alone. No device is touched.
pub async fn faults(program: &Program, text: &str) -> io::Result<Vec<Fault>> {
    if is_too_deep(text) {
        return Ok(vec![Fault { line: None, key: None, text: TOO_DEEP.to_owned() }]);
    }
    let output = program.run(&["check", "--settings-only", "--config", "/dev/stdin"], text).await?;
    match output.status {
        Some(0) => Ok(Vec::new()),
        // Bad settings, as in sysexits.h.
        Some(78) => Ok(output.err.lines().map(fault).collect()),
        _ => Err(io::Error::other(format!("facewire check failed: {}", output.err.trim()))),
    }
}

/// Reads a line of `facewire check`, such as `facewire: /dev/stdin:2: camera.fps = 1000: give ...`. A key of the second of several
/// links becomes `link.1.KEY`.
fn fault(line: &str) -> Fault {
    let text = line.strip_prefix("facewire: ").unwrap_or(line);
    let placed = text.strip_prefix("/dev/stdin:").and_then(|rest| rest.split_once(": "));
    let (line, text) = match placed.and_then(|(line, text)| Some((line.parse().ok()?, text))) {
        Some((line, text)) => (Some(line), text),
        None => (None, text),
    };
    // Of several links, the fault names the number.
    let numbered = text.strip_prefix("link ").and_then(|rest| rest.split_once(": "));
    let (link, sentence) = match numbered.and_then(|(number, rest)| Some((number.parse::<usize>().ok()?, rest))) {
        Some((number, rest)) => (number.checked_sub(1), rest),
        None => (None, text),
    };
    let word = sentence.split([' ', ':']).next().unwrap_or_default();
    let is_key = sentence[word.len()..].starts_with(" = ") || sentence[word.len()..].starts_with(" is not a ");
    let key = is_key.then(|| match (link, word.strip_prefix("link.")) {
        (Some(link), Some(name)) => format!("link.{link}.{name}"),
        _ => word.to_owned(),
    });
    Fault { line, key, text: text.to_owned() }
}

/// Whether a text has more levels than settings can have. Code that recurses through so many of them could overflow the stack.
/// Each dot and each bracket counts as a level, so that a text is refused before it is parsed.
fn is_too_deep(text: &str) -> bool {
    // The dots since the last comma, in each bracket that is open and outside of all.
    let mut open = vec![0];
    let mut levels = 0;
    for token in Source::new(text).lex() {
        let is_outside = open.len() == 1;
        match token.kind() {
            TokenKind::LeftSquareBracket | TokenKind::LeftCurlyBracket => {
                levels += 1;
                open.push(0);
            }
            TokenKind::RightSquareBracket | TokenKind::RightCurlyBracket if !is_outside => {
                levels -= 1 + open.pop().unwrap_or_default();
            }
            TokenKind::Dot => {
                levels += 1;
                open.iter_mut().last().into_iter().for_each(|dots| *dots += 1);
            }
            TokenKind::Comma | TokenKind::Newline if is_outside || token.kind() == TokenKind::Comma => {
                levels -= open.iter_mut().last().map(std::mem::take).unwrap_or_default();
            }
            _ => {}
        }
        if levels > MOST_LEVELS {
            return true;
        }
    }
    false
}

/// Returns what is set, or an empty table if the text is no TOML.
pub fn values(text: &str) -> Value {
    let values = if is_too_deep(text) { None } else { toml_edit::de::from_str(text).ok() };
    values.unwrap_or_else(|| Value::Object(Map::new()))
}

/// The names of this machine in the settings (`console.names`), in lower case.
pub fn names(text: &str) -> Arc<[String]> {
    let values = values(text);
    let names = values.pointer("/console/names").and_then(Value::as_str).unwrap_or_default();
    names.split_whitespace().map(str::to_lowercase).collect()
}

/// The keys that differ between two texts.
pub fn changed(old: &str, new: &str) -> Vec<String> {
    let mut keys = BTreeSet::new();
    differences("", &values(old), &values(new), &mut keys);
    if keys.is_empty() && old != new {
        keys.insert("comments".to_owned());
    }
    keys.into_iter().collect()
}

/// The first key that differs between two texts and says which library the service loads.
pub fn changed_code(old: &str, new: &str) -> Option<String> {
    let [old, new] = [old, new].map(values);
    let mut keys = ["engine", "folder"].into_iter();
    let of = |values: &Value, key: &str| values.get("networks").and_then(|networks| networks.get(key)).cloned();
    keys.find(|key| of(&old, key) != of(&new, key)).map(|key| format!("networks.{key}"))
}

fn differences(path: &str, old: &Value, new: &Value, keys: &mut BTreeSet<String>) {
    let below = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match (old, new) {
        (Value::Object(old), Value::Object(new)) => {
            for key in old.keys().chain(new.keys()) {
                let of = |values: &Map<String, Value>| values.get(key).cloned().unwrap_or_default();
                differences(&below(key), &of(old), &of(new), keys);
            }
        }
        _ if tables(old).or(tables(new)).is_some() => {
            // Where there is no list yet, or no longer, all its tables are added or removed.
            let [old, new] = [old, new].map(|list| tables(list).unwrap_or_default());
            for pair in aligned(old, new) {
                match pair {
                    (Some(was), Some(is)) => {
                        let [was, now] = [old.get(was), new.get(is)].map(|table| table.unwrap_or(&Value::Null));
                        differences(&below(&is.to_string()), was, now, keys);
                    }
                    (Some(only), None) | (None, Some(only)) => drop(keys.insert(below(&only.to_string()))),
                    (None, None) => {}
                }
            }
        }
        _ if old != new => drop(keys.insert(path.to_owned())),
        _ => {}
    }
}

/// The tables of a list of tables.
fn tables(value: &Value) -> Option<&[Value]> {
    value.as_array().filter(|list| !list.is_empty() && list.iter().all(Value::is_object)).map(Vec::as_slice)
}

/// The place of a table in the old list and in the new one. A table that was removed or added has one of them.
type Pair = (Option<usize>, Option<usize>);

/// A way to make one list from the beginning of another.
#[derive(Debug, Default, Clone)]
struct Way {
    cost: usize,
    pairs: Vec<Pair>,
}

impl Way {
    fn with(&self, cost: usize, pair: Pair) -> Self {
        Self { cost: self.cost + cost, pairs: [&*self.pairs, &[pair]].concat() }
    }
}

/// Pairs the tables of a list with those that they have become, in order, so that fewest values differ. Longer lists than any
/// head has are compared place by place.
fn aligned(old: &[Value], new: &[Value]) -> Vec<Pair> {
    if old.len().max(new.len()) > MOST_ALIGNED {
        let of = |place: usize, list: &[Value]| (place < list.len()).then_some(place);
        return (0..old.len().max(new.len())).map(|place| (of(place, old), of(place, new))).collect();
    }
    // The best ways from the old tables so far to no table of the new list, to its first one, to its first two, and so on.
    let mut ways = vec![Way::default()];
    for (is, table) in new.iter().enumerate() {
        let next = ways.last().map(|way| way.with(size(table), (None, Some(is))));
        ways.extend(next);
    }
    for (was, before) in old.iter().enumerate() {
        let mut next: Vec<Way> = Vec::new();
        for (count, way) in ways.iter().enumerate() {
            let mut best = way.with(size(before), (Some(was), None));
            let is = count.wrapping_sub(1);
            if let (Some(table), Some(fewer), Some(both)) = (new.get(is), next.last(), ways.get(is)) {
                let added = fewer.with(size(table), (None, Some(is)));
                let same = both.with(distance(before, table), (Some(was), Some(is)));
                best = [same, added].into_iter().chain([best.clone()]).min_by_key(|way| way.cost).unwrap_or(best);
            }
            next.push(best);
        }
        ways = next;
    }
    ways.pop().map(|way| way.pairs).unwrap_or_default()
}

/// How many values a table has, at all levels.
fn size(value: &Value) -> usize {
    match value {
        Value::Object(table) => table.values().map(size).sum::<usize>() + 1,
        Value::Array(list) => list.iter().map(size).sum::<usize>() + 1,
        _ => 1,
    }
}

/// How much two tables differ. Two links of different kinds are never the same one.
fn distance(old: &Value, new: &Value) -> usize {
    let [was, is] = [old, new].map(|link| link.get("kind").and_then(Value::as_str).unwrap_or("udp"));
    if was != is {
        return size(old) + size(new) + 1;
    }
    let keys = |one: &Value| one.as_object().map(|table| table.keys().cloned().collect()).unwrap_or_default();
    let all: BTreeSet<String> = BTreeSet::union(&keys(old), &keys(new)).cloned().collect();
    let differing = all.iter().filter(|key| old.get(key.as_str()) != new.get(key.as_str()));
    let larger = |key: &String| [old, new].map(|one| one.get(key.as_str()).map_or(0, size)).into_iter().max();
    differing.filter_map(larger).sum()
}

/// Whether a channel of a servo board is set that was not.
pub fn adds_a_servo(old: &str, new: &str) -> bool {
    let channels = |text: &str| {
        let (values, mut found) = (values(text), BTreeSet::new());
        let links = values.get("link").and_then(Value::as_array).into_iter().flatten();
        for link in links {
            let board =
                ["kind", "device", "bus", "address", "universe"].map(|key| link.get(key).map(ToString::to_string));
            let channels = link.get("channel").and_then(Value::as_array).into_iter().flatten();
            let number = |channel: &Value| channel.get("channel").and_then(Value::as_i64).unwrap_or_default();
            found.extend(channels.map(|channel| (board.clone(), number(channel))));
        }
        found
    };
    !channels(new).is_subset(&channels(old))
}

/// Changes settings in a text and keeps everything else in it. A key is a path such as `link.0.channel.2.neutral`, and
/// null removes what is there.
pub fn edit(text: &str, changes: &Map<String, Value>) -> Result<String, String> {
    if is_too_deep(text) {
        return Err(TOO_DEEP.to_owned());
    }
    let mut document: DocumentMut =
        text.parse().map_err(|error| format!("the text is not valid TOML: {error}; mend it, or restore a version"))?;
    for (key, value) in changes {
        let path: Vec<&str> = key.split('.').take(MOST_LEVELS + 1).collect();
        if path.len() > MOST_LEVELS {
            return Err(format!("{}: no setting has so many parts; load the page again", path.join(".")));
        }
        let value = match value {
            Value::Null => None,
            value => Some(toml(value).ok_or_else(|| format!("{key}: {value} cannot be written as TOML"))?),
        };
        set(document.as_item_mut(), &path, value)
            .ok_or_else(|| format!("{key}: there is no such place; load the page again"))?;
    }
    let text = document.to_string();
    if is_too_deep(&text) { Err(TOO_DEEP.to_owned()) } else { Ok(text) }
}

fn toml(value: &Value) -> Option<TomlValue> {
    value.serialize(toml_edit::ser::ValueSerializer::new()).ok()
}

/// Returns `None` if the path leads nowhere.
fn set(item: &mut Item, path: &[&str], value: Option<TomlValue>) -> Option<()> {
    let (first, rest) = path.split_first()?;
    if let Ok(index) = first.parse::<usize>() {
        return set_in_list(item, index, rest, value);
    }
    let table = item.as_table_like_mut()?;
    if rest.is_empty() {
        match (value, table.get_mut(first)) {
            (None, _) => drop(table.remove(first)),
            (Some(mut new), Some(Item::Value(old))) => {
                // The comment behind a value stays.
                *new.decor_mut() = old.decor().clone();
                *old = new;
            }
            (Some(new), _) => drop(table.insert(first, Item::Value(new))),
        }
        return Some(());
    }
    if table.get(first).is_none_or(Item::is_none) {
        if value.is_none() {
            return Some(());
        }
        let is_list = rest.first().is_some_and(|next| next.parse::<usize>().is_ok());
        let new = if is_list { Item::ArrayOfTables(ArrayOfTables::new()) } else { Item::Table(Table::new()) };
        table.insert(first, new);
    }
    set(table.get_mut(first)?, rest, value)
}

/// Changes a table of a list. The index after the last one adds a table.
fn set_in_list(item: &mut Item, index: usize, rest: &[&str], value: Option<TomlValue>) -> Option<()> {
    match item {
        Item::ArrayOfTables(tables) => {
            if rest.is_empty() {
                (value.is_none() && index < tables.len()).then(|| tables.remove(index))?;
                return Some(());
            }
            if index == tables.len() && value.is_some() {
                tables.push(Table::new());
            }
            // A table is only reached as an item, so that it changes its place for a moment.
            let table = tables.get_mut(index)?;
            let mut item = Item::Table(std::mem::take(table));
            let done = set(&mut item, rest, value);
            *table = item.into_table().ok()?;
            done
        }
        Item::Value(TomlValue::Array(values)) => {
            if rest.is_empty() {
                match value {
                    Some(value) if index < values.len() => drop(values.replace(index, value)),
                    Some(value) if index == values.len() => values.push(value),
                    None if index < values.len() => drop(values.remove(index)),
                    _ => return None,
                }
                return Some(());
            }
            if index == values.len() && value.is_some() {
                values.push(InlineTable::new());
            }
            let old = values.get_mut(index)?;
            let mut item = Item::Value(old.clone());
            set(&mut item, rest, value)?;
            *old = item.into_value().ok()?;
            Some(())
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const TEXT: &str = "# The head in the hall.\nboard = \"pi4\" # new\n\n[camera]\n# fps = 30\ndevice = 'demo'   # for now\n\n\
                        # To the head.\n[[link]]\nkind = \"maestro\"\n\n[[link.channel]]\nnumber = 3\n\n[[link.channel]]\nnumber = 4 # jaw\n";

    fn edited(text: &str, changes: Value) -> Result<String, String> {
        edit(text, changes.as_object().unwrap())
    }

    #[test]
    fn a_change_keeps_comments_order_and_everything_else() {
        let new = edited(
            TEXT,
            json!({"camera.device": "/dev/video2", "camera.fps": 60, "link.0.channel.1.neutral": 0.4, "adjust.mirror": true}),
        );
        let new = new.unwrap();
        for kept in [
            "# The head in the hall.",
            "board = \"pi4\" # new",
            "# fps = 30",
            "# for now",
            "# To the head.",
            "number = 4 # jaw\nneutral = 0.4",
        ] {
            assert!(new.contains(kept), "{kept}: {new}");
        }
        assert_eq!(changed(TEXT, &new), ["adjust", "camera.device", "camera.fps", "link.0.channel.1.neutral"]);
        let old = edited(
            &new,
            json!({"camera.device": "demo", "camera.fps": null, "link.0.channel.1.neutral": null, "adjust": null}),
        );
        assert_eq!(values(&old.unwrap()), values(TEXT));
    }

    #[test]
    fn a_link_that_is_removed_or_added_is_one_change_wherever_it_stands() {
        let board = |device: &str| {
            format!(
                "[[link]]\nkind = \"maestro\"\ndevice = \"{device}\"\n[[link.channel]]\nchannel = 1\n[[link.channel]]\nchannel = 2\n"
            )
        };
        let (udp, vmc) = ("[[link]]\naddress = \"10.0.0.1:5252\"\n", "[[link]]\nkind = \"vmc\"\n");
        let [first, second] = ["/dev/a", "/dev/b"].map(board);
        let all = [udp, &first, &second].concat();
        for (old, new, keys) in [
            (&all, [&*first, &second].concat(), vec!["link.0"]),
            (&all, [udp, &second].concat(), vec!["link.1"]),
            (&all, [vmc, &all].concat(), vec!["link.0"]),
            (&all, [&*first, &second, vmc].concat(), vec!["link.0", "link.2"]),
            (&all, [vmc, &first, &second].concat(), vec!["link.0"]),
            (
                &all,
                all.replace("channel = 2", "channel = 3"),
                vec!["link.1.channel.1.channel", "link.2.channel.1.channel"],
            ),
            (&all, all.replace("[[link.channel]]\nchannel = 1\n", ""), vec!["link.1.channel.0", "link.2.channel.0"]),
            (&all, all.replace("/dev/a", "/dev/c"), vec!["link.1.device"]),
            (&all, String::new(), vec!["link.0", "link.1", "link.2"]),
            (&String::new(), [udp, vmc].concat(), vec!["link.0", "link.1"]),
        ] {
            assert_eq!(changed(old, &new), keys, "{new}");
        }
    }

    #[test]
    fn a_file_in_another_encoding_is_read_with_the_fault_and_keeping_its_text_makes_it_utf8() {
        let folder = tempfile::tempdir().unwrap();
        let text = "# höher\n[camera]\nfps = 20\n";
        let utf16 = |mark: &str, bytes_of: fn(u16) -> [u8; 2]| -> Vec<u8> {
            format!("{mark}{text}").encode_utf16().flat_map(bytes_of).collect()
        };
        let latin1: Vec<u8> = text.chars().map(|letter| letter as u8).collect();
        let files = [
            utf16("\u{feff}", u16::to_le_bytes),
            utf16("\u{feff}", u16::to_be_bytes),
            utf16("", u16::to_le_bytes),
            utf16("", u16::to_be_bytes),
            latin1,
        ];
        for file in files {
            let settings = SettingsFile::new(folder.path().join("facewire.toml"), folder.path());
            fs::write(&settings.path, file).unwrap();
            let (read, fault) = settings.read().unwrap();
            let fault = fault.unwrap();
            assert_eq!((&*read, fault.line, fault.text.contains("save ")), (text, Some(1), true), "{fault:?}");
            settings.keep(text).unwrap();
            assert_eq!(fs::read_to_string(&settings.path).unwrap(), text);
            assert_eq!(settings.read().unwrap(), (text.to_owned(), None));
        }
    }

    #[test]
    fn tables_of_a_list_are_added_and_removed() {
        let new =
            edited(TEXT, json!({"link.1.kind": "vmc", "link.1.address": "10.0.0.2:39539", "link.0.channel.0": null}));
        let new = new.unwrap();
        let links = &values(&new)["link"];
        assert_eq!(links[0]["channel"], json!([{"number": 4}]));
        assert_eq!(links[1], json!({"kind": "vmc", "address": "10.0.0.2:39539"}));
        let inline =
            edited("link = [{ kind = \"udp\" }]", json!({"link.0.kind": "vmc", "link.1.kind": "json"})).unwrap();
        assert_eq!(values(&inline)["link"], json!([{"kind": "vmc"}, {"kind": "json"}]));
        let first = edited("", json!({"link.0.kind": "udp"})).unwrap();
        assert_eq!(first, "[[link]]\nkind = \"udp\"\n");
    }

    #[test]
    fn a_change_that_leads_nowhere_is_refused() {
        for (key, value) in [
            ("link.7.kind", json!("vmc")),
            ("board.name", json!(1)),
            ("link.kind", json!("x")),
            ("", json!({"a": null})),
        ] {
            assert!(edited(TEXT, json!({ key: value })).is_err(), "{key}");
        }
        assert!(edited("[camera", json!({})).unwrap_err().contains("not valid TOML"));
    }

    #[test]
    fn whatever_is_too_deep_is_refused_and_nothing_else() {
        let deep = |n: usize, open: &str, close: &str| format!("a = {}1{}\n", open.repeat(n), close.repeat(n));
        // The parser takes each of them.
        for text in [
            format!("[{}]\n", vec!["a"; 60].join(".")),
            format!("{} = 1\n", vec!["a"; 60].join(" . ")),
            deep(60, "[", "]"),
            deep(60, "[\n", "\n]"),
            deep(60, "{ b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b.b = ", "}"),
            deep(35, "[{\"b.#\".b.'b\"'.b = ", "}]"),
        ] {
            assert!(text.parse::<DocumentMut>().is_ok() && is_too_deep(&text), "{text}");
            assert_eq!(
                (values(&text), edited(&text, json!({"b": 1}))),
                (json!({}), Err(TOO_DEEP.to_owned())),
                "{text}"
            );
        }
        for key in ["a.".repeat(20_000), "0.".repeat(20_000), "a.0.".repeat(9) + "b", ".".repeat(100_000)] {
            assert!(edited(TEXT, json!({key: 1})).unwrap_err().contains("so many parts"));
        }
        let deep = (0..100).fold(json!(1), |value, _| json!([value]));
        assert_eq!(edited(TEXT, json!({"a": deep})), Err(TOO_DEEP.to_owned()));
        let flat =
            "# a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t\nnumbers = [1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 8.5, 9.5]\n\
                    text = \"[[[[[[[[[[[[[[[[[[[[\"\nmore = \"\"\"\n....................\"\"\"\n"
                .to_owned()
                + &"[[link]]\nsources = { jawOpen = 1.0, eyeBlinkLeft = 0.5 }\n".repeat(50);
        assert!(flat.parse::<DocumentMut>().is_ok() && !is_too_deep(&flat));
        assert!(!is_too_deep("]]]]}}}}..,,"), "no text ends the search");
    }

    #[test]
    fn a_fault_names_its_line_and_key() {
        let placed = fault("facewire: /dev/stdin:2: camera.fps = 1000: give a whole number from 1 to 240 (1/s)");
        let text = "camera.fps = 1000: give a whole number from 1 to 240 (1/s)";
        assert_eq!(placed, Fault { line: Some(2), key: Some("camera.fps".into()), text: text.into() });
        let unknown = fault("facewire: /dev/stdin:3: camera.foo is not a setting; did you mean format?");
        assert_eq!((unknown.line, unknown.key.as_deref()), (Some(3), Some("camera.foo")));
        let conflict = fault("facewire: link.channel.sources = {}: give at least one source");
        assert_eq!((conflict.line, conflict.key.as_deref()), (None, Some("link.channel.sources")));
        let of_one = fault("facewire: link 2: link.universe = 1: give another universe or address");
        assert_eq!((of_one.line, of_one.key.as_deref()), (None, Some("link.1.universe")));
        let broken = fault("facewire: /dev/stdin:1: not valid TOML: unclosed table, expected `]`");
        assert_eq!((broken.line, broken.key), (Some(1), None));
    }

    #[test]
    fn ten_former_versions_are_kept_and_say_what_changed() {
        let folder = tempfile::tempdir().unwrap();
        let file = SettingsFile::new(folder.path().join("facewire.toml"), folder.path());
        for fps in 0..12 {
            file.keep(&format!("[camera]\nfps = {fps}\n")).unwrap();
        }
        let versions = file.old_versions().unwrap();
        assert_eq!(versions.len(), 10);
        assert!(versions.iter().all(|version| version.summary == "camera.fps"), "{versions:?}");
        assert_eq!(file.old_text(&versions[0].id).unwrap().unwrap(), "[camera]\nfps = 10\n");
        assert_eq!(file.old_text("../facewire").unwrap(), None);
        // What was kept last comes back after an editor has spoilt the file, and so does what it has left.
        fs::write(&file.path, "spoilt = true\n").unwrap();
        assert_eq!(file.old_text(&file.old_versions().unwrap()[0].id).unwrap().unwrap(), "[camera]\nfps = 11\n");
        file.keep("[camera]\nfps = 12\n").unwrap();
        let [first, second, ..] = &file.old_versions().unwrap()[..] else { panic!() };
        let texts = [first, second].map(|version| file.old_text(&version.id).unwrap().unwrap());
        assert_eq!(texts, ["spoilt = true\n", "[camera]\nfps = 11\n"]);
    }

    #[test]
    fn a_servo_is_new_if_its_board_had_no_channel_of_this_number() {
        let with = |channels: &str| format!("[[link]]\nkind = \"maestro\"\n{channels}");
        let channel = |number: u32| format!("[[link.channel]]\nchannel = {number}\nneutral = 0.5\n");
        let (none, one, both) = (with(""), with(&channel(3)), with(&(channel(7) + &channel(3))));
        for (old, new, is_new) in [
            (&none, &one, true),
            (&one, &both, true),
            (&both, &one, false),
            (&both, &both.replace("0.5", "0.7"), false),
            (&one, &one.replace("3", "4"), true),
            (&one, &one.replace("maestro", "pca9685"), true),
            (&one, &one.replace("[[link.channel]]", "universe = 2\n[[link.channel]]"), true),
            (&one, &format!("[[link]]\nkind = \"udp\"\n{one}"), false),
        ] {
            assert_eq!(adds_a_servo(old, new), is_new, "{old} {new}");
        }
    }
}
