//! The arguments of the program.

use std::{net::SocketAddr, path::PathBuf};

const HELP: &str = "\
Examples:
  facewire-console                              show what comes to UDP port 5252
  facewire-console --listen 0.0.0.0:8080        open the page on a phone
  facewire-console --udp 239.255.52.52:5252     receive from a multicast group
  facewire-console --serial /dev/ttyUSB0        read a serial line
  facewire-console --config facewire.toml       operate the service on this machine

Exit status:
   0  success                       2  invalid arguments
   1  failure                      74  writing failed";

/// Shows the packets of facewire live in a browser, and with --config operates the service: settings, servos, wearers.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "facewire-console", version, after_help = HELP)]
pub struct Args {
    /// Address and port of the page. Other machines need an address of this machine, or `0.0.0.0` or `[::]` for all of
    /// them; the page then has a random token in its address
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:5252")]
    pub listen: SocketAddr,
    /// Address and port to which packets come. `[::]` stands for all addresses of this machine, IPv4 and IPv6
    #[arg(long, value_name = "ADDRESS", default_value = "[::]:5252")]
    pub udp: SocketAddr,
    /// Network interface on which to join the multicast group of `--udp`, such as eth0 [default: the system chooses]
    #[arg(long, value_name = "NAME", conflicts_with = "serial")]
    pub interface: Option<String>,
    /// Serial port to read instead. It may be plugged in later
    #[arg(long, value_name = "DEVICE", conflicts_with = "udp")]
    pub serial: Option<PathBuf>,
    /// Settings file of the service on this machine, to show and operate that service in place of packets that come by
    /// UDP or a serial line
    #[arg(long, value_name = "FILE", conflicts_with_all = ["udp", "serial"])]
    pub config: Option<PathBuf>,
    /// Control socket of the service [default: facewire/control in $XDG_RUNTIME_DIR or /run/user/UID, or else
    /// /run/facewire/control]
    #[arg(long, value_name = "SOCKET", requires = "config")]
    pub control: Option<PathBuf>,
    /// Folder for the password, former settings and recordings [default: $STATE_DIRECTORY, or else facewire-console in
    /// $XDG_STATE_HOME or ~/.local/state]
    #[arg(long, value_name = "FOLDER", requires = "config")]
    pub state: Option<PathBuf>,
    /// Socket of the unit facewire-helper, which starts the service, lists devices and checks them, for which this program
    /// has no rights of its own
    #[arg(long, value_name = "SOCKET", requires = "config")]
    pub helper: Option<PathBuf>,
    /// Baud rate of the serial port
    #[arg(long, value_name = "N", default_value_t = 115_200, requires = "serial",
        value_parser = clap::value_parser!(u32).range(9600..=4_000_000))]
    pub baud: u32,
}
