//! Readers of values.

use std::ops::RangeInclusive;

use toml::de::DeValue;

use super::{Entry, Field, Fields, Objection, Overlay, Reader, Section, Takes};

/// The keys of a section, and what they take.
pub fn keys(section: &mut dyn Section) -> Vec<(&'static str, Takes)> {
    section.fields().into_iter().map(|field| (field.key, field.takes)).collect()
}

/// Reads a table of settings.
#[derive(Debug)]
pub struct Table;

impl<T: Section> Reader<T> for Table {
    fn takes(&self, section: &mut T) -> Takes {
        Takes::Table(keys(section))
    }

    fn read(&self, section: &mut T, entry: &Entry<'_>, file: &mut Overlay<'_>) {
        file.section(section, entry);
    }
}

/// Reads a table whose fields a function names.
#[allow(missing_debug_implementations, reason = "it is made for one call")]
pub struct TableOf<T>(pub fn(&mut T) -> Vec<Field<'_>>);

impl<T> Reader<T> for TableOf<T> {
    fn takes(&self, table: &mut T) -> Takes {
        Takes::Table(keys(&mut Fields(table, self.0)))
    }

    fn read(&self, table: &mut T, entry: &Entry<'_>, file: &mut Overlay<'_>) {
        file.section(&mut Fields(table, self.0), entry);
    }
}

/// Reads a value by `read`, which returns `None` for all but what the setting takes.
#[derive(Debug)]
pub struct Value<F> {
    takes: Takes,
    read: F,
    objection: Objection,
}

impl<F> Value<F> {
    /// Creates a reader that has no objection.
    pub fn new(takes: Takes, read: F) -> Self {
        Self { takes, read, objection: |_| None }
    }

    /// Adds an objection, which may suggest a better value than the general list of what the setting takes.
    pub fn but(self, objection: Objection) -> Self {
        Self { objection, ..self }
    }
}

impl<T, F: Fn(&DeValue<'_>) -> Option<T>> Reader<T> for Value<F> {
    fn takes(&self, _: &mut T) -> Takes {
        self.takes.clone()
    }

    fn read(&self, setting: &mut T, entry: &Entry<'_>, file: &mut Overlay<'_>) {
        match (self.read)(entry.value.get_ref()) {
            Some(value) => *setting = value,
            None => file.refuse_value(entry, &self.takes, self.objection),
        }
    }
}

/// Reads one of these names.
pub fn one_of<T: Copy>(all: &'static [(&'static str, T)]) -> impl Reader<T> {
    let named = |text: &str| all.iter().find(|(name, _)| *name == text).map(|(_, value)| *value);
    let takes = Takes::OneOf(all.iter().map(|(name, _)| *name).collect());
    Value::new(takes, move |value: &DeValue<'_>| named(value.as_str()?))
}

/// The text as TOML writes it.
pub fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// Reads a whole number in this range.
pub fn whole<T: TryFrom<i64> + Into<i64> + Copy + PartialOrd>(
    range: RangeInclusive<T>,
    unit: &'static str,
) -> impl Reader<T> {
    let takes = Takes::Whole { least: (*range.start()).into(), most: (*range.end()).into(), unit };
    let read = move |value: &DeValue<'_>| {
        let integer = value.as_integer()?;
        let number = T::try_from(i64::from_str_radix(integer.as_str(), integer.radix()).ok()?).ok()?;
        range.contains(&number).then_some(number)
    };
    Value::new(takes, read)
}

/// Reads a number in this range.
pub fn number(range: RangeInclusive<f32>, unit: &'static str) -> impl Reader<f32> {
    let takes = Takes::Number { least: *range.start(), most: *range.end(), unit };
    let read = move |value: &DeValue<'_>| {
        let number = match value {
            DeValue::Float(float) => float.as_str().parse().ok()?,
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok()?,
            _ => return None,
        };
        range.contains(&number).then_some(number)
    };
    Value::new(takes, read)
}

/// Reads a switch.
pub fn flag() -> impl Reader<bool> {
    Value::new(Takes::Flag, |value: &DeValue<'_>| value.as_bool())
}
