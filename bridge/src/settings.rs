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
    /// The first part of all topics.
    pub namespace: String,
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
    /// Whether Home Assistant is told of the boards.
    pub home_assistant: bool,
    /// How often a second the whole face is published, at most.
    pub stream_hz: u8,
}

/// What to publish to ROS 2.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ros {
    pub domain: Option<u16>,
    /// The router of Zenoh, as in `--ros-zenoh`. Without it, messages go by DDS.
    pub zenoh: Option<String>,
    /// Whether action units are published as ROS4HRI has them.
    pub action_units: bool,
}

impl Ros {
    /// The domain, by default that of the environment.
    pub fn domain(&self) -> u16 {
        let of_environment = || std::env::var("ROS_DOMAIN_ID").ok()?.parse().ok();
        self.domain.or_else(of_environment).unwrap_or(0)
    }

    /// The address of the Zenoh router, in the notation of Zenoh.
    pub fn endpoint(&self) -> Option<Result<String, Fault>> {
        let router = self.zenoh.as_deref()?.trim_start_matches("tcp/");
        Some(place(router, 7447).map(|(host, port)| format!("tcp/{host}:{port}")))
    }

    fn check(&self) -> Result<(), Fault> {
        if let domain @ 233.. = self.domain() {
            return fault(format!("there is no domain {domain} in ROS 2: it is from 0 to 232"));
        }
        if self.zenoh.is_some() && !cfg!(feature = "zenoh") {
            return fault("this facewire-bridge was built without Zenoh; build it with `--features zenoh`");
        }
        self.endpoint().transpose().map(drop)
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            udp: (Ipv6Addr::UNSPECIFIED, 5252).into(),
            interface: None,
            namespace: "facewire".to_owned(),
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
            home_assistant: true,
            stream_hz: 0,
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
        settings.apply(args.clone())?;
        settings.check()?;
        Ok(settings)
    }

    /// Reads settings from their text.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        toml::from_str(text).map_err(|error| Fault(error.to_string().trim_end().to_owned()))
    }

    fn apply(&mut self, args: Args) -> Result<(), Fault> {
        self.udp = args.udp.unwrap_or(self.udp);
        self.interface = args.interface.or(self.interface.take());
        self.board.extend(args.board.into_iter().map(|(name, address)| NamedBoard { name, address }));
        if let Some(broker) = args.mqtt {
            self.mqtt.get_or_insert_default().broker = broker;
        }
        let is_for_mqtt = args.mqtt_password_file.is_some() || args.mqtt_ca.is_some() || args.mqtt_stream.is_some();
        if let Some(mqtt) = &mut self.mqtt {
            mqtt.password_file = args.mqtt_password_file.or(mqtt.password_file.take());
            mqtt.ca_file = args.mqtt_ca.unwrap_or_else(|| mqtt.ca_file.clone());
            mqtt.stream_hz = args.mqtt_stream.unwrap_or(mqtt.stream_hz);
        } else if is_for_mqtt {
            return fault("an argument that begins with --mqtt- needs a broker: give --mqtt BROKER, or a table [mqtt]");
        }
        if args.ros || args.ros_zenoh.is_some() {
            self.ros.get_or_insert_default();
        }
        if let Some(ros) = &mut self.ros {
            ros.domain = args.ros_domain.or(ros.domain);
            ros.zenoh = args.ros_zenoh.or(ros.zenoh.take());
        } else if args.ros_domain.is_some() {
            return fault("--ros-domain is for ROS 2: give --ros, or a table [ros]");
        }
        Ok(())
    }

    fn check(&self) -> Result<(), Fault> {
        let (mut names, mut addresses) = (HashSet::new(), HashSet::new());
        for NamedBoard { name, address } in &self.board {
            if name.eq_ignore_ascii_case(BRIDGE) {
                return fault(format!(
                    "no board can be called {name}, because the bridge itself is: choose another name"
                ));
            }
            check_name("a board", name)?;
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
        check_name("the namespace", &self.namespace)?;
        self.ros.as_ref().map_or(Ok(()), Ros::check)?;
        match &self.mqtt {
            Some(mqtt) => mqtt.check(),
            None if self.ros.is_some() => Ok(()),
            None => fault("there is nobody to publish to: give --mqtt BROKER or --ros, or a table [mqtt] or [ros]"),
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
        let (user, address) = rest.rsplit_once('@').map_or((None, rest), |(user, address)| (Some(user), address));
        if user.is_some_and(|user| user.contains(':')) {
            return fault(format!(
                "a password in an argument or in these settings can be read by others: put it into a file for \
                 --mqtt-password-file, or into the environment as {PASSWORD}"
            ));
        }
        let (host, port) = place(address, if is_tls { 8883 } else { 1883 })?;
        Ok(Broker { is_tls, user: user.map(str::to_owned), host, port })
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

/// A host and its port.
fn place(text: &str, default_port: u16) -> Result<(String, u16), Fault> {
    let text = text.trim_end_matches('/');
    let (host, port) = match text.rsplit_once(':') {
        Some((host, port)) if !port.contains(']') => (host, port.parse().ok()),
        _ => (text, Some(default_port)),
    };
    match port {
        Some(port) if !host.is_empty() && !host.contains('/') => Ok((host.to_owned(), port)),
        _ => fault(format!("{text:?} is no HOST or HOST:PORT, such as server.local:{default_port}")),
    }
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
fn check_name(owner: &str, name: &str) -> Result<(), Fault> {
    let is_valid = name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.chars().all(|character| character.is_ascii_alphanumeric() || character == '_')
        && !name.contains("__")
        && !name.ends_with('_')
        && name.len() <= NAME_BYTES;
    if !is_valid {
        return fault(format!(
            "{name:?} cannot name {owner}: begin with a letter and go on with letters, digits and single underscores, \
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
            ("a=10.0.0.1 A=10.0.0.2", "give each a name"),
            ("a=10.0.0.1 b=::ffff:10.0.0.1", "run a bridge with a port of its own"),
            ("bridge=10.0.0.1", "choose another name"),
            ("a/b=10.0.0.1", "begin with a letter"),
            ("7up=10.0.0.1", "begin with a letter"),
            ("a__b=10.0.0.1", "single underscores"),
            ("a=head.local", "is no IP address"),
        ] {
            let boards: Vec<&str> = boards.split(' ').flat_map(|board| ["--board", board]).collect();
            let error = loaded(&[&boards[..], &["--ros"]].concat()).unwrap_err();
            assert!(error.contains(want), "{boards:?}: {error}");
        }
        assert!(loaded(&["--ros", "--board", "Left_1=10.0.0.1"]).is_ok());
    }

    #[test]
    fn brokers_are_read_as_users_write_them_but_never_with_a_password() {
        let read = |broker: &str| Mqtt { broker: broker.to_owned(), ..Mqtt::default() }.address();
        for (broker, is_tls, user, host, port) in [
            ("broker.local", false, None, "broker.local", 1883),
            ("10.0.0.1:1884", false, None, "10.0.0.1", 1884),
            ("mqtts://me@broker.local/", true, Some("me"), "broker.local", 8883),
            ("mqtt://[::1]:1885", false, None, "[::1]", 1885),
            ("[::1]", false, None, "[::1]", 1883),
        ] {
            let want = Broker { is_tls, user: user.map(str::to_owned), host: host.to_owned(), port };
            assert_eq!(read(broker), Ok(want));
        }
        for (broker, want) in
            [("http://a", "mqtt://"), ("a:b:c@d", "--mqtt-password-file"), ("", "HOST"), ("a:x", "HOST")]
        {
            let Fault(text) = read(broker).unwrap_err();
            assert!(text.contains(want), "{broker}: {text}");
        }
    }

    #[cfg(feature = "zenoh")]
    #[test]
    fn routers_are_read_as_users_and_zenoh_write_them_and_stand_for_ros_2() {
        for (router, endpoint) in [
            (&["--ros-zenoh"][..], "tcp/localhost:7447"),
            (&["--ros-zenoh", "robot.local"], "tcp/robot.local:7447"),
            (&["--ros-zenoh", "tcp/[::1]:7448"], "tcp/[::1]:7448"),
        ] {
            assert_eq!(loaded(router).unwrap().ros.unwrap().endpoint(), Some(Ok(endpoint.to_owned())));
        }
        for router in ["udp/localhost", "", "a:x"] {
            assert!(loaded(&["--ros-zenoh", router]).unwrap_err().contains("is no HOST"), "{router}");
        }
    }

    #[cfg(not(feature = "zenoh"))]
    #[test]
    fn a_program_that_was_built_without_zenoh_says_how_to_build_it() {
        let error = loaded(&["--ros-zenoh", "robot.local"]).unwrap_err();
        assert!(error.contains("built without Zenoh; build it with `--features zenoh`"), "{error}");
    }

    #[test]
    fn a_file_names_its_faults_with_the_line_and_arguments_take_precedence() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let load = |text: &str, arguments: &[&str]| {
            fs::write(file.path(), text).unwrap();
            loaded(&[&["--config", file.path().to_str().unwrap()], arguments].concat())
        };
        let settings = load("[mqtt]\nbroker = \"one\"\nstream_hz = 9\n", &["--mqtt", "two"]).unwrap();
        assert_eq!(settings.mqtt, Some(Mqtt { broker: "two".to_owned(), stream_hz: 9, ..Mqtt::default() }));
        let ros = load("namespace = \"bridge\"\n[ros]\ndomain = 1\n", &["--ros-domain", "2"]).unwrap().ros;
        assert_eq!(ros.unwrap().domain, Some(2));
        for argument in [["--mqtt-stream", "9"], ["--mqtt-ca", "a"], ["--mqtt-password-file", "a"]] {
            assert!(load("[ros]\n", &argument).unwrap_err().contains("give --mqtt BROKER"), "{argument:?}");
        }
        assert!(load("[mqtt]\n", &["--ros-domain", "2"]).unwrap_err().contains("give --ros"));
        for (text, want) in [
            ("", "give --mqtt BROKER or --ros"),
            ("[mqtt]\nbrocker = \"a\"\n", "line 2"),
            ("namespace = \"a/#\"\n[mqtt]\n", "cannot name the namespace"),
            ("[mqtt]\nstream_hz = 61\n", "from 0 to 60"),
            ("[ros]\ndomain = 233\n", "from 0 to 232"),
            ("most_boards = 0\n[mqtt]\n", "most_boards must be from 1"),
        ] {
            let error = load(text, &[]).unwrap_err();
            assert!(error.contains(want), "{text}: {error}");
        }
    }

    /// Other tests take blocks marked `toml` alone for settings of facewire.
    #[test]
    fn every_block_of_the_bridges_settings_in_a_document_loads() {
        let of_this_folder = |file| Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
        let texts = ["README.md", "../docs/code.md"].map(|file| fs::read_to_string(of_this_folder(file)).unwrap());
        let blocks = texts.iter().flat_map(|text| text.split("```toml bridge\n").skip(1));
        let mut blocks: Vec<&str> = blocks.map(|rest| rest.split("```").next().unwrap()).collect();
        assert!(blocks.len() > 1);
        blocks.push(include_str!("../../packaging/bridge/bridge.toml"));
        blocks.iter().for_each(|block| Settings::parse(block).unwrap().check().unwrap());
    }
}
