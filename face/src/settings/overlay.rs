//! Lays a TOML file over settings, and collects its faults.

use std::fmt;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::takes::Takes;

/// The most faults of a file that are named. Text that is no file of settings could have one in every line.
const MOST_FAULTS: usize = 100;
/// A name that is less similar to an unknown key is not suggested.
const LEAST_SIMILARITY: f64 = 0.6;

#[derive(Debug)]
struct Fault {
    key: String,
    /// The place of the table that the fault is in, if that table is in an array of tables.
    place: Option<usize>,
    /// Whether the value is wrong by itself: of another type, or out of bounds.
    is_invalid_value: bool,
    /// Begins with `file:line:`, unless the fault concerns a whole file or several settings together.
    sentence: String,
}

/// All faults of the settings, displayed one per line.
#[derive(Debug, Default, thiserror::Error)]
#[error("{}", .0.iter().map(|fault| &*fault.sentence).collect::<Vec<_>>().join("\n"))]
pub struct Faults(Vec<Fault>);

impl Faults {
    /// Adds a fault that concerns a whole file.
    pub fn push(&mut self, sentence: String) {
        self.0.push(Fault { key: String::new(), place: None, is_invalid_value: false, sentence });
    }

    /// Adds the fault that a value is valid by itself, but not together with other settings.
    pub fn conflict(&mut self, key: &str, value: impl fmt::Display, expected: impl fmt::Display) {
        self.push(format!("{key} = {value}: give {expected}"));
    }

    /// Adds a fault unless `is_good`. A table that already has an invalid value is not judged.
    pub fn require(&mut self, is_good: bool, key: &str, value: impl fmt::Display, expected: impl fmt::Display) {
        if !is_good && !self.has_invalid_value(key.split('.').next().unwrap_or(key)) {
            self.conflict(key, value, expected);
        }
    }

    /// Whether a value in this table is wrong by itself.
    pub fn has_invalid_value(&self, table: &str) -> bool {
        self.0.iter().any(|fault| fault.is_invalid_value && fault.key.split('.').next() == Some(table))
    }

    /// Whether the value of this key is invalid.
    pub fn is_invalid(&self, key: &str) -> bool {
        self.0.iter().any(|fault| fault.is_invalid_value && fault.key == key)
    }

    /// Whether there may be more faults than were named.
    pub fn is_full(&self) -> bool {
        self.0.len() >= MOST_FAULTS
    }

    /// Whether the table at this place in an array of tables has a value that is wrong by itself.
    pub fn has_invalid_value_at(&self, place: usize) -> bool {
        self.0.iter().any(|fault| fault.is_invalid_value && fault.place == Some(place))
    }

    /// Whether this table, which is part of the one at `place` in an array of tables, has an unknown key or a wrong value.
    pub fn has_any_in(&self, table: &str, place: usize) -> bool {
        let is_in = |fault: &Fault| fault.key.strip_prefix(table).is_some_and(|rest| rest.starts_with('.'));
        self.0.iter().any(|fault| fault.place == Some(place) && is_in(fault))
    }

    /// The faults, each in one sentence.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|fault| &*fault.sentence)
    }
}

/// A key in a file, and its value.
#[derive(Debug)]
pub struct Entry<'a> {
    /// The key, preceded by those of the tables around it, such as `camera.width`.
    pub path: String,
    /// The value, and where it stands.
    pub value: &'a Spanned<DeValue<'a>>,
}

impl Entry<'_> {
    /// Returns each table of an array of tables, or the only one.
    pub fn each(&self) -> Vec<Self> {
        let tables = self.value.get_ref().as_array().map_or(std::slice::from_ref(self.value), |array| array);
        tables.iter().map(|value| Self { path: self.path.clone(), value }).collect()
    }
}

/// Reads the value of a setting.
pub trait Reader<T> {
    /// What the setting takes.
    fn takes(&self, setting: &mut T) -> Takes;

    /// Takes the value of an entry, or adds a fault to those of the file.
    fn read(&self, setting: &mut T, entry: &Entry<'_>, file: &mut Overlay<'_>);
}

/// Returns what to give in place of a text, if there is something better than what the setting takes.
pub type Objection = fn(&str) -> Option<&'static str>;

/// Takes the value of an entry, or adds a fault to those of the file.
pub type Read<'a> = Box<dyn FnOnce(&Entry<'_>, &mut Overlay<'_>) + 'a>;

/// A key of a section, what it takes, and what reads its value.
pub struct Field<'a> {
    /// The key.
    pub key: &'static str,
    /// What the setting takes.
    pub takes: Takes,
    /// Takes the value of an entry.
    pub read: Read<'a>,
}

/// A table of settings.
pub trait Section {
    /// Its keys.
    fn fields(&mut self) -> Vec<Field<'_>>;

    /// The names of its keys.
    fn keys(&mut self) -> Vec<&'static str> {
        self.fields().iter().map(|field| field.key).collect()
    }

    /// Returns the end of the sentence that a key is not a setting, if there is a better one than which key is similar.
    fn objection(&mut self, _key: &str) -> Option<String> {
        None
    }
}

/// A table whose fields a function names.
#[allow(missing_debug_implementations, reason = "it is made for one call")]
pub struct Fields<'a, T>(pub &'a mut T, pub fn(&mut T) -> Vec<Field<'_>>);

impl<T> Section for Fields<'_, T> {
    fn fields(&mut self) -> Vec<Field<'_>> {
        (self.1)(self.0)
    }
}

/// Makes a field of a key, its setting, and the reader of its value.
pub fn field<'a, T>(key: &'static str, setting: &'a mut T, reader: impl Reader<T> + 'a) -> Field<'a> {
    let takes = reader.takes(setting);
    Field { key, takes, read: Box::new(move |entry, file| reader.read(setting, entry, file)) }
}

/// Declares tables of settings: `field: Type = default, reader;` for each key, or `field "key": ...` if their names differ.
/// What follows as `.. field: Type;` has no key: it follows from other settings once all are read.
/// Makes the struct of each table, its defaults, the reader of its keys, and the comparison of two.
#[doc(hidden)]
#[macro_export]
macro_rules! section {
    ($(
        $(#[doc = $doc:literal])*
        $name:ident {
            $( $field:ident $($key:literal)?: $type:ty = $default:expr, $read:expr; )*
            $( .. $derived:ident: $derived_type:ty; )*
        }
    )*) => { $(
        $(#[doc = $doc])*
        #[derive(Debug, Clone, PartialEq)]
        #[allow(missing_docs, reason = "the comments of the settings say it")]
        pub struct $name {
            $( pub $field: $type, )*
            $( pub $derived: $derived_type, )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $default, )* $( $derived: Default::default(), )* }
            }
        }

        impl $name {
            /// The keys whose settings differ from the others.
            pub fn changed_keys(&self, other: &Self) -> Vec<&'static str> {
                let keys = [ $( ([$($key,)? stringify!($field)][0], self.$field != other.$field), )* ];
                keys.into_iter().filter(|(_, is_changed)| *is_changed).map(|(key, _)| key).collect()
            }
        }

        impl $crate::settings::Section for $name {
            fn fields(&mut self) -> Vec<$crate::settings::Field<'_>> {
                vec![ $( $crate::settings::field([$($key,)? stringify!($field)][0], &mut self.$field, $read), )* ]
            }
        }
    )* };
}

/// A file that is being laid over settings.
#[derive(Debug)]
pub struct Overlay<'a> {
    source: &'a str,
    text: &'a str,
    /// The place of the table that is being read, if it is in an array of tables.
    place: Option<usize>,
    /// The faults found so far, each with its byte offset in the text.
    found: Vec<(usize, Fault)>,
}

impl<'a> Overlay<'a> {
    /// Parses the text of the file `source`. A text that is not TOML has syntax errors only: the parser's guess at its
    /// content would give misleading faults.
    pub fn parse(source: &'a str, text: &'a str) -> (Self, DeTable<'a>) {
        let mut file = Self { source, text, place: None, found: Vec::new() };
        let (document, errors) = DeTable::parse_recoverable(text);
        for error in errors.iter().take(MOST_FAULTS) {
            let start = error.span().map_or(0, |span| span.start);
            file.fault(start, String::new(), false, &format!("not valid TOML: {}", error.message()));
        }
        (file, if errors.is_empty() { document.into_inner() } else { DeTable::new() })
    }

    /// Lays the document over a section, which must not be used if there are faults. Adds them in the order of the lines.
    pub fn lay(mut self, document: &DeTable<'_>, section: &mut dyn Section, faults: &mut Faults) {
        self.entries(section, "", document);
        let is_full = self.is_full();
        self.found.sort_by_key(|(start, _)| *start);
        faults.0.extend(self.found.into_iter().map(|(_, fault)| fault));
        if is_full {
            faults.push(format!("{} may have more faults: correct these first", self.source));
        }
    }

    fn is_full(&self) -> bool {
        self.found.len() >= MOST_FAULTS
    }

    /// Reads each table of an array of tables. Their faults have the tables' places, from 0.
    pub fn each<T>(&mut self, entry: &Entry<'_>, mut read: impl FnMut(&Entry<'_>, &mut Self) -> T) -> Vec<T> {
        let tables = entry.each();
        let read = tables.iter().enumerate().map(|(place, entry)| {
            self.place = Some(place);
            read(entry, self)
        });
        let read = read.collect();
        self.place = None;
        read
    }

    /// Lays the table that is the value of an entry over a section.
    pub fn section(&mut self, section: &mut dyn Section, entry: &Entry<'_>) {
        match entry.value.get_ref().as_table() {
            Some(table) => self.entries(section, &entry.path, table),
            None => self.refuse(entry, &Takes::Table(Vec::new()).to_string()),
        }
    }

    fn entries(&mut self, section: &mut dyn Section, path: &str, table: &DeTable<'_>) {
        for (name, value) in table {
            if self.is_full() {
                return;
            }
            let key = name.get_ref().as_ref();
            let path = if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
            if let Some(field) = section.fields().into_iter().find(|field| field.key == key) {
                (field.read)(&Entry { path, value }, self);
                continue;
            }
            let objection = section.objection(key).unwrap_or_else(|| hint(key, &section.keys()));
            let sentence = format!("{} is not a setting{objection}", printable(&path));
            self.fault(name.span().start, path, false, &sentence);
        }
    }

    /// Adds the fault that the value of this entry is not what the setting takes, with the choice that may be meant.
    pub fn refuse_value(&mut self, entry: &Entry<'_>, takes: &Takes, objection: Objection) {
        let text = entry.value.get_ref().as_str().unwrap_or_default();
        let expected = match (objection(text), takes) {
            (Some(better), _) => better.to_owned(),
            (None, Takes::OneOf(names)) => takes.to_string() + &suggestion(&text.to_ascii_lowercase(), names),
            (None, takes) => takes.to_string(),
        };
        self.refuse(entry, &expected);
    }

    /// Adds the fault that the value of this entry is not what is expected.
    pub fn refuse(&mut self, Entry { path, value }: &Entry<'_>, expected: &str) {
        let written = self.text.get(value.span()).unwrap_or_default().lines().next().unwrap_or_default();
        let sentence = format!("{path} = {}: give {expected}", printable(written));
        self.fault(value.span().start, path.clone(), true, &sentence);
    }

    fn fault(&mut self, start: usize, key: String, is_invalid_value: bool, sentence: &str) {
        let before = self.text.get(..start).unwrap_or_default();
        let line = 1 + before.matches('\n').count();
        let sentence = format!("{}:{line}: {sentence}", self.source);
        self.found.push((start, Fault { key, place: self.place, is_invalid_value, sentence }));
    }
}

/// Escapes control characters: a quoted key may contain line breaks, or sequences that a terminal obeys.
fn printable(text: &str) -> String {
    let one = |c: char| if c.is_control() { c.escape_default().collect() } else { c.to_string() };
    text.chars().map(one).collect()
}

/// Returns the end of a sentence that names the known name most similar to `key`, or all known names if none is similar.
fn hint(key: &str, known: &[&str]) -> String {
    let suggestion = suggestion(key, known);
    if suggestion.is_empty() { format!("; there are {}", known.join(", ")) } else { suggestion }
}

/// Returns the end of a sentence that names the known name most similar to `key`, or nothing if none is similar.
fn suggestion(key: &str, known: &[&str]) -> String {
    let similarity = |name: &&str| strsim::jaro_winkler(key, name);
    let nearest = known.iter().max_by(|a, b| similarity(a).total_cmp(&similarity(b)));
    let nearest = nearest.filter(|name| similarity(name) >= LEAST_SIMILARITY);
    nearest.map(|name| format!("; did you mean {name}?")).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::ShapingSettings;

    fn faults(text: &str) -> Faults {
        let mut faults = Faults::default();
        let (file, document) = Overlay::parse("file", text);
        file.lay(&document, &mut ShapingSettings::default(), &mut faults);
        faults
    }

    /// A file with many faults takes as long as one with [`MOST_FAULTS`].
    #[test]
    fn of_many_faults_the_first_are_named_and_that_there_may_be_more() {
        let keys = (0..5000).map(|key| format!("key{key} = 1\n")).collect::<Vec<_>>().concat();
        for text in ["x\n".repeat(5000), keys.clone(), format!("[adjust]\n{keys}")] {
            let faults = faults(&text);
            let sentences: Vec<&str> = faults.iter().collect();
            assert_eq!(sentences.len(), MOST_FAULTS + 1);
            assert_eq!(sentences.last(), Some(&"file may have more faults: correct these first"));
        }
        assert_eq!(faults("x = 1\ny = 2\n").iter().count(), 2);
    }
}
