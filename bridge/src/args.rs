//! The arguments of the program.

use std::{
    net::{IpAddr, SocketAddr},
    path::PathBuf,
};

const HELP: &str = "\
Examples:
  facewire-bridge --mqtt broker.local       every board that sends here, to a broker
  facewire-bridge --ros                     every board, to ROS 2 in this network
  facewire-bridge --board left=192.168.1.21 --board right=192.168.1.22 --ros
  facewire-bridge --mqtt mqtts://me@broker.local --mqtt-password-file password
  facewire-bridge --config bridge.toml      settings from a file

The password of the broker may also be in the environment, as FACEWIRE_MQTT_PASSWORD.

Exit status:
   0  success                       2  invalid arguments
   1  failure                      78  faulty settings";

/// Publishes the faces of any number of facewire boards by MQTT and to ROS 2.
#[derive(Debug, Clone, Default, clap::Parser)]
#[command(name = "facewire-bridge", version, after_help = HELP)]
pub struct Args {
    /// Settings file. Arguments take precedence over it, and each --board adds a board
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Address and port to which the boards send, such as a multicast group [default: port 5252 at all addresses of this
    /// machine]
    #[arg(long, value_name = "ADDRESS")]
    pub udp: Option<SocketAddr>,
    /// Network interface on which to join the multicast group of `--udp`, such as eth0 [default: the system chooses]
    #[arg(long, value_name = "NAME")]
    pub interface: Option<String>,
    /// Names the board with this IP address. Once a board is named, packets from other addresses are refused
    #[arg(long, value_name = "NAME=ADDRESS", value_parser = board)]
    pub board: Vec<(String, IpAddr)>,
    /// Publish by MQTT to this broker: HOST, HOST:PORT, or mqtt:// or mqtts:// (TLS) with USER@HOST:PORT
    #[arg(long, value_name = "BROKER")]
    pub mqtt: Option<String>,
    /// File with the broker's password
    #[arg(long, value_name = "FILE")]
    pub mqtt_password_file: Option<PathBuf>,
    /// Certificates to trust with mqtts://, in PEM [default: those of the system]
    #[arg(long, value_name = "FILE")]
    pub mqtt_ca: Option<PathBuf>,
    /// Publish the whole face as JSON, too, at most so many times a second [default: 0, which is never]
    #[arg(long, value_name = "HZ", value_parser = clap::value_parser!(u8).range(0..=60))]
    pub mqtt_stream: Option<u8>,
    /// Publish to ROS 2, by DDS
    #[arg(long)]
    pub ros: bool,
    /// Publish to ROS 2 by Zenoh, for nodes with rmw_zenoh, through the router at HOST or HOST:PORT [default: localhost:7447].
    /// Needs a program that was built with `--features zenoh`
    #[arg(long, value_name = "ROUTER", num_args = 0..=1, default_missing_value = "localhost")]
    pub ros_zenoh: Option<String>,
    /// Domain of ROS 2 [default: $ROS_DOMAIN_ID, or else 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub ros_domain: Option<u16>,
}

fn board(text: &str) -> Result<(String, IpAddr), String> {
    let (name, address) = text.split_once('=').ok_or("write NAME=ADDRESS, such as left=192.168.1.21")?;
    let address = address.parse().map_err(|_| format!("{address} is no IP address, such as 192.168.1.21"))?;
    Ok((name.to_owned(), address))
}
