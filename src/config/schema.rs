//! The settings as JSON Schema, for programs that show them in forms.
//!
//! Keys, types, bounds, units and choices are those of the tables of settings. Comments and defaults are those of
//! `facewire.toml` and `links.toml`.

use facewire_face::settings::{Fields, Takes, keys};
use facewire_face::{Adjustment, Adjustments};
use facewire_servo::ChannelSettings;
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::explanation::{Explanation, explanations};
use super::link::channel_fields;
use super::{CHANNEL_HEADING, DEFAULTS, LINK_HEADING, LinkKind, LinkSettings, Settings, default_link};
const ADJUST_HEADING: &str = "[adjust]";

/// Returns all settings. Besides what JSON Schema defines, `order` is the place of a key in its table, `takes` the end of the
/// sentence that refuses another value, and `unit` that of a number.
pub fn schema() -> Value {
    let explained = explanations(DEFAULTS);
    let of_channel = default_link("maestro").unwrap_or_default();
    let of_channel = table(
        keys(&mut Fields(&mut ChannelSettings::default(), channel_fields)),
        CHANNEL_HEADING,
        &explanations(&of_channel),
    );
    let mut schema = table(keys(&mut Settings::default()), "", &explained);
    add(&mut schema, "$schema", "https://json-schema.org/draft/2020-12/schema");
    add(&mut schema, "title", "facewire");
    let definitions = json!({
        "adjust": table(keys(&mut Adjustments::default()), ADJUST_HEADING, &explained),
        "coefficient": table(keys(&mut Adjustment::default()), "", &[]),
        "channel": of_channel,
    });
    add(&mut schema, "$defs", definitions);
    schema
}

/// The table with these keys, which are explained under this heading.
fn table(keys: Vec<(&str, Takes)>, heading: &str, explained: &[Explanation<'_>]) -> Value {
    let properties: Map<String, Value> = keys
        .into_iter()
        .enumerate()
        .map(|(order, (key, takes))| {
            let explanation = explained.iter().find(|explained| explained.heading == heading && explained.key == key);
            let mut property = property(key, takes, heading, explained);
            // A table has one kind of link.
            if let (LINK_HEADING, "kind", Some(explanation)) = (heading, key, explanation) {
                property = json!({ "const": default(explanation) });
            }
            if let Some(explanation) = explanation {
                add(&mut property, "description", description(explanation));
                add(&mut property, "default", default(explanation));
            }
            add(&mut property, "order", order);
            (key.to_owned(), property)
        })
        .collect();
    json!({ "type": "object", "additionalProperties": false, "properties": properties })
}

fn property(key: &str, takes: Takes, heading: &str, explained: &[Explanation<'_>]) -> Value {
    let sentence = takes.to_string();
    match takes {
        Takes::Flag => json!({ "type": "boolean" }),
        Takes::Whole { least, most, unit } => {
            json!({ "type": "integer", "minimum": least, "maximum": most, "unit": unit_of(unit), "takes": sentence })
        }
        Takes::Number { least, most, unit } => {
            let [least, most] = [least, most].map(decimal);
            json!({ "type": "number", "minimum": least, "maximum": most, "unit": unit_of(unit), "takes": sentence })
        }
        Takes::OneOf(choices) => json!({ "type": "string", "enum": choices }),
        Takes::OneOfNumbers(choices) => json!({ "type": "integer", "enum": choices, "takes": sentence }),
        Takes::Text(_) => json!({ "type": "string", "takes": sentence }),
        Takes::Table(_) if key == "adjust" => json!({ "$ref": "#/$defs/adjust" }),
        Takes::Table(_) if heading == ADJUST_HEADING => json!({ "$ref": "#/$defs/coefficient" }),
        Takes::Table(keys) => table(keys, &format!("[{key}]"), explained),
        Takes::Channels => json!({ "type": "array", "items": { "$ref": "#/$defs/channel" } }),
        Takes::Links => {
            let kinds: Vec<Value> = LinkKind::NAMES.iter().filter_map(|name| link(name)).collect();
            json!({ "type": "array", "items": { "oneOf": kinds } })
        }
    }
}

fn link(name: &str) -> Option<Value> {
    let text = default_link(name)?;
    let explained = explanations(&text);
    let mut link = table(keys(&mut LinkSettings::of(LinkKind::named(name)?)), LINK_HEADING, &explained);
    let about_kinds = explained.iter().find(|explained| explained.key == "kind")?.comment;
    let about = about_kinds.lines().find_map(|line| line.strip_prefix(&format!("# - \"{name}\": ")));
    add(&mut link, "title", name);
    add(&mut link, "description", about);
    if name != LinkKind::default().name() {
        add(&mut link, "required", ["kind"]);
    }
    Some(link)
}

/// The comment without the sentence that says what the setting takes.
fn description(explanation: &Explanation<'_>) -> String {
    let lines = explanation.comment.lines().filter_map(|line| line.strip_prefix("# "));
    lines.take_while(|line| !line.starts_with("Takes ")).collect::<Vec<_>>().join("\n")
}

fn default(explanation: &Explanation<'_>) -> Option<toml::Value> {
    let mut table: toml::Table = toml::from_str(&format!("value = {}", explanation.value)).ok()?;
    table.remove("value")
}

fn unit_of(unit: &str) -> Option<&str> {
    (!unit.is_empty()).then_some(unit)
}

/// The number as it is written: 0.1 for the 32-bit number nearest to it.
fn decimal(number: f32) -> Option<f64> {
    number.to_string().parse().ok()
}

fn add(schema: &mut Value, keyword: &str, value: impl Serialize) {
    if let Value::Object(keywords) = schema {
        keywords.insert(keyword.to_owned(), json!(value));
    }
}
