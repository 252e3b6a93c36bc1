//! The settings: a TOML file, over which the arguments take precedence.

use std::{
    collections::HashSet,
    fs,
    net::{IpAddr, Ipv6Addr, SocketAddr},
    path::{Path, PathBuf},
};

use serde::Deserialize;

use crate::args::Args;

/// The environment variable of the broker's password.
pub const PASSWORD: &str = "FACEWIRE_MQTT_PASSWORD";
/// The longest name of a board.
const NAME_BYTES: usize = 32;
/// What the bridge itself is called among the boards.
pub const BRIDGE: &str = "bridge";

/// What is wrong with the settings, and what to do.
#[derive(Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct Fault(pub String);

fn fault<T>(text: impl Into<String>) -> Result<T, Fault> {
    Err(Fault(text.into()))
}

/// All settings.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Address and port to which the boards send.
    pub udp: SocketAddr,
    /// The network interface of a multicast group.
    pub interface: Option<String>,
    /// The most boards, named ones included.
    pub most_boards: usize,
    /// Whether boards that are not named are taken. Without a value they are, unless one is named.
    pub accept_others: Option<bool>,
    /// The boards that have a name.
    pub board: Vec<NamedBoard>,
    pub mqtt: Option<Mqtt>,
    pub ros: Option<Ros>,
}

/// A board by its name.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedBoard {
    pub name: String,
    pub address: IpAddr,
}

/// Where and what to publish by MQTT.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mqtt {
    /// The broker, as in `--mqtt`.
    pub broker: String,
    pub password_file: Option<PathBuf>,
    /// Certificates to trust, in PEM.
    pub ca_file: PathBuf,
    /// The first part of every topic.
    pub prefix: String,
    /// The first part of the topics of Home Assistant's discovery. Empty for none.
    pub discovery: String,
    /// How often a second the whole face is published, at most.
    pub stream_hz: u8,
    pub smile: Thresholds,
    pub mouth_open: Thresholds,
    pub eyes_shut: Thresholds,
}

/// What to publish to ROS 2.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ros {
    pub domain: Option<u16>,
    /// The first part of the topics.
    pub namespace: String,
    /// Whether action units are published as ROS4HRI has them.
    pub action_units: bool,
}

impl Default for Ros {
    fn default() -> Self {
        Self { domain: None, namespace: "facewire".to_owned(), action_units: false }
    }
}

impl Ros {
    fn check(&self) -> Result<(), Fault> {
        check_name(&self.namespace).map_err(|Fault(text)| Fault(format!("ros.namespace: {text}")))?;
        match self.domain() {
            0..=232 => Ok(()),
            domain => fault(format!("there is no domain {domain}: ros.domain is from 0 to 232")),
        }
    }

    /// The domain, by default that of the environment.
    pub fn domain(&self) -> u16 {
        let of_environment = || std::env::var("ROS_DOMAIN_ID").ok()?.parse().ok();
        self.domain.or_else(of_environment).unwrap_or(0)
    }
}

/// Where a trigger goes on and off.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thresholds {
    pub on: f32,
    pub off: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            udp: (Ipv6Addr::UNSPECIFIED, 5252).into(),
            interface: None,
            most_boards: 64,
            accept_others: None,
            board: Vec::new(),
            mqtt: None,
            ros: None,
        }
    }
}

impl Default for Mqtt {
    fn default() -> Self {
        Self {
            broker: "localhost".to_owned(),
            password_file: None,
            ca_file: "/etc/ssl/certs/ca-certificates.crt".into(),
            prefix: "facewire".to_owned(),
            discovery: "homeassistant".to_owned(),
            stream_hz: 0,
            smile: Thresholds { on: 0.5, off: 0.3 },
            mouth_open: Thresholds { on: 0.3, off: 0.15 },
            eyes_shut: Thresholds { on: 0.7, off: 0.4 },
        }
    }
}

impl Settings {
    /// Reads the file of the arguments, applies the arguments and checks the outcome.
    pub fn load(args: &Args) -> Result<Self, Fault> {
        let mut settings = match &args.config {
            Some(path) => Self::parse(&read(path, "the settings")?).map_err(|Fault(text)| in_file(path, &text))?,
            None => Self::default(),
        };
        settings.apply(args.clone());
        settings.check()?;
        Ok(settings)
    }

    /// Reads settings from their text.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        toml::from_str(text).map_err(|error| Fault(error.to_string().trim_end().to_owned()))
    }

    fn apply(&mut self, args: Args) {
        self.udp = args.udp.unwrap_or(self.udp);
        self.interface = args.interface.or(self.interface.take());
        self.board.extend(args.board.into_iter().map(|(name, address)| NamedBoard { name, address }));
        if let Some(broker) = args.mqtt {
            self.mqtt.get_or_insert_default().broker = broker;
        }
        if let Some(mqtt) = &mut self.mqtt {
            mqtt.password_file = args.mqtt_password_file.or(mqtt.password_file.take());
            mqtt.ca_file = args.mqtt_ca.unwrap_or_else(|| mqtt.ca_file.clone());
            mqtt.stream_hz = args.mqtt_stream.unwrap_or(mqtt.stream_hz);
        }
        if args.ros {
            let ros = self.ros.get_or_insert_default();
            ros.domain = args.ros_domain.or(ros.domain);
        }
    }

    fn check(&self) -> Result<(), Fault> {
        let (mut names, mut addresses) = (HashSet::new(), HashSet::new());
        for NamedBoard { name, address } in &self.board {
            check_name(name)?;
            if !names.insert(name.to_ascii_lowercase()) {
                return fault(format!("two boards are called {name}: give each a name of its own"));
            }
            if !addresses.insert(address.to_canonical()) {
                return fault(format!(
                    "two boards have the address {address}: a board is known by its address, so run a bridge with a port of \
                     its own for each service on one machine"
                ));
            }
        }
        if !(1..=256).contains(&self.most_boards) || self.board.len() > self.most_boards {
            return fault(format!("most_boards must be from {} to 256", self.board.len().max(1)));
        }
        match (&self.mqtt, &self.ros) {
            (None, None) => {
                fault("there is nobody to publish to: give --mqtt BROKER or --ros, or a table [mqtt] or [ros]")
            }
            (mqtt, ros) => {
                ros.as_ref().map_or(Ok(()), Ros::check)?;
                mqtt.as_ref().map_or(Ok(()), Mqtt::check)
            }
        }
    }

    /// Whether packets of boards that are not named are taken.
    pub fn accepts_others(&self) -> bool {
        self.accept_others.unwrap_or(self.board.is_empty())
    }
}

impl Mqtt {
    fn check(&self) -> Result<(), Fault> {
        self.address()?;
        for (key, topic) in [("prefix", &self.prefix), ("discovery", &self.discovery)] {
            let is_free = key == "discovery" && topic.is_empty();
            let is_topic = !topic.is_empty()
                && topic.split('/').all(|level| !level.is_empty())
                && !topic.starts_with('$')
                && !topic.contains(['+', '#', '\0']);
            if !is_free && !is_topic {
                return fault(format!(
                    "mqtt.{key} = {topic:?} cannot begin a topic: write words between single slashes, without +, # and a \
                     leading $"
                ));
            }
        }
        let triggers = [("smile", self.smile), ("mouth_open", self.mouth_open), ("eyes_shut", self.eyes_shut)];
        for (name, Thresholds { on, off }) in triggers {
            if !(0.0 < off && off < on && on <= 1.0) {
                return fault(format!("mqtt.{name}: off must be above 0 and below on, which is at most 1"));
            }
        }
        if self.stream_hz > 60 {
            return fault("mqtt.stream_hz must be from 0 to 60");
        }
        Ok(())
    }

    /// The parts of the broker's address.
    pub fn address(&self) -> Result<Broker, Fault> {
        let (scheme, rest) = self.broker.split_once("://").unwrap_or(("mqtt", &self.broker));
        let is_tls = match scheme {
            "mqtt" | "tcp" => false,
            "mqtts" | "ssl" => true,
            _ => return fault(format!("{scheme}:// is unknown: write mqtt:// or, for TLS, mqtts://")),
        };
        let (user, place) = rest.rsplit_once('@').map_or((None, rest), |(user, place)| (Some(user), place));
        if user.is_some_and(|user| user.contains(':')) {
            return fault(format!(
                "a password in an argument or in these settings can be read by others: put it into a file for \
                 --mqtt-password-file, or into the environment as {PASSWORD}"
            ));
        }
        let place = place.trim_end_matches('/');
        let (host, port) = match place.rsplit_once(':') {
            Some((host, port)) if !port.contains(']') => (host, port.parse().ok()),
            _ => (place, Some(if is_tls { 8883 } else { 1883 })),
        };
        match port {
            Some(port) if !host.is_empty() && !host.contains('/') => {
                Ok(Broker { is_tls, user: user.map(str::to_owned), host: host.to_owned(), port })
            }
            _ => fault(format!("{place:?} is no HOST or HOST:PORT, such as broker.local:1883")),
        }
    }

    /// The password, from the file or the environment.
    pub fn password(&self) -> Result<Option<String>, Fault> {
        match &self.password_file {
            Some(path) => Ok(Some(read(path, "the password")?.trim_end_matches(['\r', '\n']).to_owned())),
            None => Ok(std::env::var(PASSWORD).ok().filter(|password| !password.is_empty())),
        }
    }
}

/// The parts of a broker's address.
#[derive(Debug, PartialEq)]
pub struct Broker {
    pub is_tls: bool,
    pub user: Option<String>,
    pub host: String,
    pub port: u16,
}

/// Reads a file of the user.
pub fn read(path: &Path, what: &str) -> Result<String, Fault> {
    fs::read_to_string(path)
        .map_err(|error| Fault(format!("cannot read {what} in {} ({error}); check path and rights", path.display())))
}

fn in_file(path: &Path, text: &str) -> Fault {
    Fault(format!("{}: {text}", path.display()))
}

/// Checks that a name fits topics of MQTT, identifiers of Home Assistant and names of ROS.
fn check_name(name: &str) -> Result<(), Fault> {
    let is_valid = name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.chars().all(|character| character.is_ascii_alphanumeric() || character == '_')
        && !name.contains("__")
        && !name.ends_with('_')
        && name.len() <= NAME_BYTES;
    if name.eq_ignore_ascii_case(BRIDGE) {
        return fault(format!("no board can be called {name}, because the bridge itself is: choose another name"));
    }
    if !is_valid {
        return fault(format!(
            "{name:?} cannot name a board: begin with a letter and go on with letters, digits and single underscores, \
             {NAME_BYTES} characters at most"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    fn loaded(arguments: &[&str]) -> Result<Settings, String> {
        let args =
            Args::try_parse_from([&["facewire-bridge"], arguments].concat()).map_err(|error| error.to_string())?;
        Settings::load(&args).map_err(|Fault(text)| text)
    }

    #[test]
    fn names_that_clash_or_fit_no_topic_are_refused_with_what_to_do() {
        for (boards, want) in [
            (vec!["a=10.0.0.1", "A=10.0.0.2"], "give each a name"),
            (vec!["a=10.0.0.1", "b=::ffff:10.0.0.1"], "run a bridge with a port of its own"),
            (vec!["bridge=10.0.0.1"], "choose another name"),
            (vec!["head left=10.0.0.1"], "begin with a letter"),
            (vec!["a/b=10.0.0.1"], "begin with a letter"),
            (vec!["7up=10.0.0.1"], "begin with a letter"),
            (vec!["a__b=10.0.0.1"], "single underscores"),
            (vec!["a=head.local"], "is no IP address"),
        ] {
            let arguments: Vec<&str> = boards.iter().flat_map(|board| ["--board", board]).collect();
            let error = loaded(&[&arguments[..], &["--mqtt", "localhost"]].concat()).unwrap_err();
            assert!(error.contains(want), "{boards:?}: {error}");
        }
        assert!(loaded(&["--mqtt", "b", "--board", "Left_1=10.0.0.1"]).is_ok());
        assert!(loaded(&[]).unwrap_err().contains("give --mqtt BROKER"));
    }

    #[test]
    fn brokers_are_read_as_users_write_them_but_never_with_a_password() {
        let address = |broker: &str| Mqtt { broker: broker.to_owned(), ..Mqtt::default() }.address();
        let broker = |is_tls, user: Option<&str>, host: &str, port| {
            Ok(Broker { is_tls, user: user.map(str::to_owned), host: host.to_owned(), port })
        };
        assert_eq!(address("broker.local"), broker(false, None, "broker.local", 1883));
        assert_eq!(address("10.0.0.1:1884"), broker(false, None, "10.0.0.1", 1884));
        assert_eq!(address("mqtts://me@broker.local/"), broker(true, Some("me"), "broker.local", 8883));
        assert_eq!(address("mqtt://[::1]:1885"), broker(false, None, "[::1]", 1885));
        assert_eq!(address("[::1]"), broker(false, None, "[::1]", 1883));
        for (wrong, want) in
            [("http://a", "mqtt://"), ("a:b:c@d", "--mqtt-password-file"), ("", "HOST"), ("a:x", "HOST")]
        {
            let Fault(text) = address(wrong).unwrap_err();
            assert!(text.contains(want), "{wrong}: {text}");
        }
    }

    #[test]
    fn a_file_names_its_faults_with_the_line_and_arguments_take_precedence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bridge.toml");
        let file = path.to_str().unwrap();
        fs::write(&path, "[mqtt]\nbroker = \"one\"\nsmile = { on = 0.6, off = 0.4 }\n[[board]]\nname = \"a\"\naddress = \"10.0.0.1\"\n")
            .unwrap();
        let settings = loaded(&["--config", file, "--mqtt", "two", "--mqtt-stream", "5"]).unwrap();
        let mqtt = settings.mqtt.as_ref().unwrap();
        assert_eq!((mqtt.broker.as_str(), mqtt.stream_hz, mqtt.smile.on), ("two", 5, 0.6));
        assert!(!settings.accepts_others() && Settings::default().accepts_others());
        for (text, want) in [
            ("[mqtt]\nbrocker = \"a\"\n", "line 2"),
            ("[mqtt]\nprefix = \"a/#\"\n", "mqtt.prefix"),
            ("[mqtt]\nsmile = { on = 0.4, off = 0.5 }\n", "mqtt.smile: off must be"),
            ("most_boards = 0\n[mqtt]\n", "most_boards must be from 1"),
        ] {
            fs::write(&path, text).unwrap();
            let error = loaded(&["--config", file]).unwrap_err();
            assert!(error.contains(want), "{text}: {error}");
        }
        assert!(loaded(&["--config", "/nowhere"]).unwrap_err().contains("check path and rights"));
    }
    /// Other tests take blocks marked `toml` alone for settings of facewire.
    #[test]
    fn every_block_of_the_bridges_settings_in_a_document_loads() {
        let mut count = 0;
        for document in ["bridge/README.md", "docs/receivers.md"] {
            let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(document)).unwrap();
            for block in text.split("```toml bridge\n").skip(1) {
                let settings = Settings::parse(block.split("```").next().unwrap()).unwrap();
                settings.check().unwrap();
                count += 1;
            }
        }
        assert!(count > 0);
    }
}
