//! The report that an owner can send in: what runs where, in which state, without names, addresses and pictures.

use std::{
    fs, io,
    net::{IpAddr, SocketAddr},
    process::Stdio,
};

use facewire_packet::control::Request;
use serde_json::{Value, json};
use tokio::process::Command;

use crate::{
    console::{Console, sentence},
    program,
    settings::SettingsFile,
};

/// Settings whose value tells who or where somebody is.
const PRIVATE_KEYS: [&str; 6] = ["address", "name", "host", "listen", "folder", "model"];
const LOG_LINES: &str = "200";

pub async fn write(console: &Console) -> String {
    let (mut status, _) = console.look().await;
    let text = console.settings.on_disk(SettingsFile::text).await.unwrap_or_default();
    let faults = console.faults(&text).await.unwrap_or_default();
    let faults: Vec<String> = faults.iter().map(sentence).collect();
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default().trim_matches(['\0', '\n']).to_owned();
    let system = read("/etc/os-release")
        .lines()
        .find_map(|line| line.strip_prefix("PRETTY_NAME="))
        .unwrap_or_default()
        .trim_matches('"')
        .to_owned();
    let mut names: Vec<String> =
        nix::unistd::gethostname().ok().and_then(|name| name.into_string().ok()).into_iter().collect();
    names.extend(status.pointer("/service/wearer").and_then(Value::as_str).map(str::to_owned));
    if let Ok(reply) = console.control.ask(&Request::List {}).await {
        let wearers = reply.pointer("/wearers/wearers").and_then(Value::as_array).into_iter().flatten();
        names.extend(wearers.filter_map(|wearer| wearer.get("wearer")?.as_str().map(str::to_owned)));
    }
    names.extend(hosts(&text));
    if let Some(service) = status.get_mut("service").and_then(Value::as_object_mut) {
        service.remove("wearer");
        service.remove("config");
    }
    let parts = [
        ("versions", format!("facewire-console {}\nfacewire {}", env!("CARGO_PKG_VERSION"), version(console).await)),
        (
            "board",
            format!("{}\n{system}\nLinux {}", read("/proc/device-tree/model"), read("/proc/sys/kernel/osrelease")),
        ),
        ("settings", settings(&text)),
        ("faults", faults.join("\n")),
        ("status", serde_json::to_string_pretty(&status).unwrap_or_default()),
        ("log", log().await),
    ];
    let parts = parts.map(|(head, text)| format!("== {head}\n{}\n", without_names(text.trim(), &names)));
    parts.join("\n")
}

/// The hosts to which links send, which the names of links and the log contain.
fn hosts(text: &str) -> Vec<String> {
    let values = crate::settings::values(text);
    let links = values.get("link").and_then(Value::as_array).into_iter().flatten();
    let addresses = links.filter_map(|link| link.get("address")?.as_str());
    addresses.filter_map(|address| Some(address.rsplit_once(':')?.0.to_owned())).collect()
}

async fn version(console: &Console) -> String {
    let output = console.program.run(&["--version"], "").await;
    output.map_or_else(|error| error.to_string(), |output| output.out.trim().trim_start_matches("facewire ").to_owned())
}

/// Returns the lines of the settings, without comments, which may tell anything.
fn settings(text: &str) -> String {
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let lines = lines.map(|line| match line.split_once('=') {
        Some((key, _)) if PRIVATE_KEYS.contains(&key.trim()) => format!("{} = ...", key.trim()),
        Some((key, value)) => format!("{} = {}", key.trim(), value.split(" #").next().unwrap_or_default().trim()),
        None => line.to_owned(),
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// The last lines of the log of the service.
async fn log() -> String {
    let lines = journal(&["--output", "short-iso", "--no-hostname"]).await;
    lines.unwrap_or_else(|error| error.to_string())
}

async fn journal(format: &[&str]) -> io::Result<String> {
    let mut command = Command::new("journalctl");
    command.args(["--unit", "facewire", "--lines", LOG_LINES, "--no-pager", "--quiet"]).args(format);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let output = program::run(&mut command, "").await;
    match output {
        Ok(output) if output.status == Some(0) => Ok(output.out),
        Ok(output) => Err(io::Error::other(format!("the journal cannot be read: {}", output.err.trim()))),
        Err(error) => Err(io::Error::other(format!("there is no journal on this machine ({error})"))),
    }
}

/// The same lines with their times and levels, the newest first.
pub async fn log_lines() -> io::Result<Vec<Value>> {
    let lines = journal(&["--output", "json", "--output-fields", "MESSAGE,PRIORITY"]).await?;
    Ok(lines.lines().rev().filter_map(entry).collect())
}

/// Reads an entry of the journal. A line of the service begins with its level, and others have a priority as in syslog.
fn entry(line: &str) -> Option<Value> {
    let entry: Value = serde_json::from_str(line).ok()?;
    let text = |key: &str| entry.get(key).and_then(Value::as_str);
    let message = text("MESSAGE")?.trim();
    let time_s = text("__REALTIME_TIMESTAMP")?.parse::<u64>().ok()? / 1_000_000;
    let (word, rest) = message.split_once(' ').unwrap_or((message, ""));
    let (level, message) = match word {
        "ERROR" => ("error", rest),
        "WARN" => ("warning", rest),
        "INFO" => ("info", rest),
        "DEBUG" | "TRACE" => ("debug", rest),
        _ => match text("PRIORITY").and_then(|priority| priority.parse::<u8>().ok()) {
            Some(..=3) => ("error", message),
            Some(4) => ("warning", message),
            _ => ("info", message),
        },
    };
    Some(json!({"time_s": time_s, "level": level, "text": message}))
}

/// Replaces network addresses and these names.
fn without_names(text: &str, names: &[String]) -> String {
    // A host may have its port behind it.
    let is_name = |word: &str| {
        names
            .iter()
            .any(|name| word.strip_prefix(name.as_str()).is_some_and(|rest| rest.is_empty() || rest.starts_with(':')))
    };
    let is_address = |word: &str| word.parse::<IpAddr>().is_ok() || word.parse::<SocketAddr>().is_ok();
    let is_part = |c: char| c.is_alphanumeric() || "._-:[]%".contains(c);
    let mut result = String::new();
    let mut rest = text;
    while let Some(start) = rest.find(is_part) {
        let (before, word) = rest.split_at(start);
        let (word, after) = word.split_at(word.find(|c| !is_part(c)).unwrap_or(word.len()));
        let bare = word.trim_end_matches(['.', ':']).trim_matches(['[', ']']);
        result += before;
        result += if is_name(bare) {
            "NAME"
        } else if is_address(bare) || is_address(word) {
            "ADDRESS"
        } else {
            word
        };
        rest = after;
    }
    result + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_addresses_are_left_out() {
        let text =
            "wearer anna: link to 192.168.1.20:5252 and [2001:db8::1]:80, host desk. fe80::1 at 12:30:05 jawOpen=0.5";
        let names = ["anna".to_owned(), "desk".to_owned()];
        let want = "wearer NAME link to ADDRESS and ADDRESS, host NAME ADDRESS at 12:30:05 jawOpen=0.5";
        assert_eq!(without_names(text, &names), want);
    }

    #[test]
    fn entries_of_the_journal_have_levels() {
        for (message, priority, level, text) in [
            (" WARN no face", "6", "warning", "no face"),
            ("ERROR no camera", "6", "error", "no camera"),
            ("Started facewire", "6", "info", "Started facewire"),
            ("facewire failed", "3", "error", "facewire failed"),
        ] {
            let line = json!({"__REALTIME_TIMESTAMP": "1700000000999999", "PRIORITY": priority, "MESSAGE": message});
            let want = json!({"time_s": 1_700_000_000, "level": level, "text": text});
            assert_eq!(entry(&line.to_string()), Some(want));
        }
        assert_eq!(entry("no JSON"), None);
    }

    #[test]
    fn hosts_of_links_are_names() {
        let text = "[[link]]\nkind = \"udp\"\naddress = \"studio.example:5252\"\n[[link]]\nkind = \"maestro\"\n";
        assert_eq!(hosts(text), ["studio.example"]);
        assert_eq!(without_names("cannot resolve studio.example:5252: gone", &hosts(text)), "cannot resolve NAME gone");
    }

    #[test]
    fn settings_keep_their_keys_but_no_addresses_and_comments() {
        let text =
            "# For Anna.\n[[link]]\nkind = \"udp\" # to Anna\naddress = \"10.0.0.2:5\"\n[wearer]\nname = \"anna\"\n";
        assert_eq!(settings(text), "[[link]]\nkind = \"udp\"\naddress = ...\n[wearer]\nname = ...");
    }
}
