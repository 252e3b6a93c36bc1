//! The settings as JSON Schema, for programs that show them in forms.
//!
//! Keys, types, bounds, units and choices are asked of the reader of the settings itself: it names the keys of a table
//! beside an unknown one, and what a key takes beside a wrong value. Comments and defaults are those of `facewire.toml` and
//! `links.toml`.

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{DEFAULTS, LinkKind, board_names, default_link, parse};

/// The sentence of the only fault that has this text in it, from there on.
fn fault(toml: &str, text: &str) -> Option<String> {
    let faults = parse("", toml).err()?;
    faults.iter().find_map(|fault| fault.split_once(text)).map(|(_, rest)| rest.to_owned())
}

/// The keys of the table under these headings.
pub(super) fn keys(headings: &str) -> Vec<String> {
    let keys = fault(&format!("{headings}\"?\" = 1\n"), "; there are ").unwrap_or_default();
    keys.split(", ").map(str::to_owned).collect()
}

/// What a key of this table takes. `None` for an array of tables.
pub(super) fn expected(headings: &str, key: &str) -> Option<String> {
    fault(&format!("{headings}{key} = []\n"), &format!("{key} = []: give "))
}

/// Returns all settings. Besides what JSON Schema defines, `order` is the place of a key in its table, `takes` the end of the
/// sentence that refuses another value, and `unit` that of a number.
pub fn schema() -> Value {
    let mut properties = Map::new();
    for (order, key) in keys("").into_iter().enumerate() {
        let section = DEFAULTS.split_once(&format!("\n[{key}]\n")).map_or(DEFAULTS, |(_, rest)| rest);
        let section = section.split("\n[").next().unwrap_or_default();
        let mut property = match key.as_str() {
            "board" => {
                described(json!({ "type": "string", "enum": board_names().collect::<Vec<_>>() }), "board", section)
            }
            "link" => {
                let kinds: Vec<Value> = LinkKind::NAMES.iter().map(|kind| link(kind)).collect();
                json!({ "type": "array", "items": { "oneOf": kinds } })
            }
            "adjust" => json!({ "$ref": "#/$defs/adjust" }),
            _ => table(&format!("[{key}]\n"), &key, section),
        };
        add(&mut property, "order", order);
        properties.insert(key, property);
    }
    let servos = "[[link]]\nkind = \"maestro\"\n[[link.channel]]\n";
    let text = default_link("maestro").unwrap_or_default();
    let (_, of_channel) = text.split_once("\n[[link.channel]]\n").unwrap_or_default();
    let (_, of_adjust) = DEFAULTS.split_once("\n[adjust]\n").unwrap_or_default();
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "facewire",
        "type": "object",
        "additionalProperties": false,
        "properties": properties,
        "$defs": {
            "adjust": table("[adjust]\n", "adjust", of_adjust.split("\n[").next().unwrap_or_default()),
            "coefficient": table("[adjust.jawOpen]\n", "adjust.jawOpen", ""),
            "channel": table(servos, "link.channel", of_channel),
        },
    })
}

fn add(schema: &mut Value, keyword: &str, value: impl Serialize) {
    if let Value::Object(keywords) = schema {
        keywords.insert(keyword.to_owned(), json!(value));
    }
}

fn link(kind: &str) -> Value {
    let text = default_link(kind).unwrap_or_default();
    let own = text.split("\n[[link.channel]]\n").next().unwrap_or_default();
    let mut link = table(&format!("[[link]]\nkind = \"{kind}\"\n"), "link", own);
    let about = text.lines().find_map(|line| line.strip_prefix(&format!("# - \"{kind}\": ")));
    add(&mut link, "title", kind);
    add(&mut link, "description", about);
    if kind != LinkKind::default().name() {
        add(&mut link, "required", ["kind"]);
    }
    link
}

/// The table under these headings, which this text explains.
fn table(headings: &str, path: &str, text: &str) -> Value {
    let property = |(order, key): (usize, String)| {
        let property = match (path, key.as_str(), expected(headings, &key).as_deref()) {
            ("link", "kind", _) => json!({ "const": headings.split('"').nth(1) }),
            ("link", "adjust", _) => json!({ "$ref": "#/$defs/adjust" }),
            ("adjust", _, Some("a table")) => json!({ "$ref": "#/$defs/coefficient" }),
            (_, _, None) => json!({ "type": "array", "items": { "$ref": "#/$defs/channel" } }),
            (_, _, Some("a table")) => table(&format!("{headings}[{path}.{key}]\n"), &format!("{path}.{key}"), ""),
            (_, _, Some(takes)) => typed(takes),
        };
        let mut property = described(property, &key, text);
        add(&mut property, "order", order);
        (key, property)
    };
    let properties: Map<String, Value> = keys(headings).into_iter().enumerate().map(property).collect();
    json!({ "type": "object", "additionalProperties": false, "properties": properties })
}

fn typed(takes: &str) -> Value {
    let range = |text: &str, as_number: fn(&str) -> Value| {
        let (range, unit) = text.split_once(" (").unwrap_or((text, ""));
        let (least, most) = range.split_once(" to ").unwrap_or_default();
        (as_number(least), as_number(most), unit.strip_suffix(')').map(str::to_owned))
    };
    let of_type = |name, (minimum, maximum, unit)| json!({ "type": name, "minimum": minimum, "maximum": maximum, "unit": unit, "takes": takes });
    if let Some(text) = takes.strip_prefix("a whole number from ") {
        of_type("integer", range(text, |text| json!(text.parse::<i64>().ok())))
    } else if let Some(text) = takes.strip_prefix("a number from ") {
        of_type("number", range(text, |text| json!(text.parse::<f64>().ok())))
    } else if takes == "true or false" {
        json!({ "type": "boolean" })
    } else if let Some(choices) = takes.strip_prefix("one of ") {
        let choices: Vec<&str> = choices.split(", ").map(|choice| choice.trim_matches('"')).collect();
        json!({ "type": "string", "enum": choices })
    } else {
        json!({ "type": "string", "takes": takes })
    }
}

/// Adds the comment and the default of a key, which this text may have commented out.
fn described(mut property: Value, key: &str, text: &str) -> Value {
    let assigns = |line: &str| line.strip_prefix(key)?.strip_prefix(" = ").map(str::to_owned);
    let value = |paragraph: &str| paragraph.lines().find_map(|line| assigns(line.strip_prefix("# ").unwrap_or(line)));
    let found = text.split("\n\n").find_map(|paragraph| Some((paragraph, value(paragraph)?)));
    if let Some((paragraph, value)) = found {
        let comment = paragraph.lines().filter_map(|line| line.strip_prefix("# "));
        let comment: Vec<&str> =
            comment.take_while(|line| !line.starts_with("Takes ") && assigns(line).is_none()).collect();
        add(&mut property, "description", comment.join("\n"));
        let default = toml::from_str::<toml::Table>(&format!("value = {value}")).unwrap_or_default();
        add(&mut property, "default", default.get("value"));
    }
    property
}
