//! `facewire devices`: lists connected devices as the settings name them.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;
use serde_json::{Value, json};
use serialport::{SerialPortInfo, SerialPortType};

use super::failure::{Failure, print, say};
use crate::capture::module_pipe;
use crate::capture::v4l2::{Camera, Found, cameras};
use crate::link::{lost, open_port, serial_ports};
use facewire_board::{Attached, attached, links_to};
use facewire_servo::bus::{Protocol, find};

/// Folders of stable links to serial ports: `by-id` names the device, `by-path` the socket it is plugged into.
const PORT_LINKS: [&str; 2] = ["/dev/serial/by-id", "/dev/serial/by-path"];

const MODULE_NAME: &str = "Camera module of a Raspberry Pi";
const MODULE_UNIT: &str = "facewire-camera.service";

/// The baud rates that servos have, most frequent first.
const SCANNED_BAUDS: [u32; 3] = [1_000_000, 57_600, 115_200];
const SCAN_PATIENCE: Duration = Duration::from_millis(20);

#[derive(Debug, Serialize)]
struct Port {
    path: String,
    name: String,
    stable_paths: Vec<PathBuf>,
    /// Vendor and product.
    usb: Option<[String; 2]>,
    /// The kind of link for which `device = "auto"` would choose it.
    kind: Option<&'static str>,
    #[serde(skip)]
    board: Option<Attached>,
}

pub fn run(as_json: bool) -> Result<(), Failure> {
    let found = cameras();
    let ports = serial_ports();
    let ports: Vec<Port> = ports.iter().map(|port| Port::new(port, &PORT_LINKS)).collect();
    if as_json {
        return print(&format!("{:#}\n", listed(&found, &ports)));
    }
    let mut text: String = found.cameras.iter().map(camera_lines).collect();
    text.extend(module_pipe().map(|path| format!("camera {path} \"{MODULE_NAME}\" ({MODULE_UNIT})\n")));
    if text.is_empty() {
        text += "no camera\n";
    }
    text.extend(found.multi_planar.iter().map(|unread| format!("not read: {unread}\n")));
    text.extend(found.refused.iter().map(|refused| format!("not examined: {refused}\n")));
    text.extend(ports.iter().map(Port::lines));
    if ports.is_empty() {
        text += "no serial port\n";
    }
    print(&text)
}

/// Lists the bus servos at a serial port. Each number that nobody has takes the patience.
pub fn scan(device: &Path) -> Result<(), Failure> {
    for (baud, protocol) in SCANNED_BAUDS.into_iter().flat_map(|baud| [(baud, Protocol::One), (baud, Protocol::Two)]) {
        let mut port = open_port(device, baud, SCAN_PATIENCE)?;
        say(format!("searching at {baud} baud by protocol {}.0", protocol as u8 + 1));
        for id in 0..=252 {
            let Some((model, family)) = find(&mut port, protocol, id).map_err(|error| lost(device, error))? else {
                continue;
            };
            let family = family.map_or("unknown", |family| family.name);
            print(&format!("servo {id} at {baud} baud: model {model}, family = \"{family}\"\n"))?;
        }
    }
    Ok(())
}

fn listed(found: &Found, ports: &[Port]) -> Value {
    let camera = |camera: &Camera| {
        let modes: Vec<String> = camera.modes.iter().map(ToString::to_string).collect();
        json!({
            "path": &camera.node,
            "stable_paths": camera.links,
            "name": &camera.card,
            "driver": &camera.driver,
            "modes": modes,
        })
    };
    let module =
        |path| json!({ "path": path, "stable_paths": [], "name": MODULE_NAME, "driver": MODULE_UNIT, "modes": [] });
    let cameras: Vec<Value> = found.cameras.iter().map(camera).chain(module_pipe().map(module)).collect();
    let not_examined: Vec<String> = found.multi_planar.iter().chain(&found.refused).map(ToString::to_string).collect();
    // What is connected to a bus is not asked: some chips take any question for a command.
    let buses: Vec<u32> = (0..256).filter(|bus| Path::new(&format!("/dev/i2c-{bus}")).exists()).collect();
    json!({ "cameras": cameras, "not_examined": not_examined, "serial_ports": ports, "i2c_buses": buses })
}

fn camera_lines(camera: &Camera) -> String {
    let mut text = format!("camera {} \"{}\" ({})\n", camera.node.display(), camera.card, camera.driver);
    text.extend(camera.links.iter().map(|link| format!("  stable path {}\n", link.display())));
    text.extend(camera.modes.iter().map(|mode| format!("  {mode}\n")));
    if camera.modes.is_empty() {
        text += &format!("  {}\n", camera.unread());
    }
    text
}

impl Port {
    fn new(port: &SerialPortInfo, link_folders: &[impl AsRef<Path>]) -> Self {
        let usb = if let SerialPortType::UsbPort(usb) = &port.port_type { Some(usb) } else { None };
        let path = port.port_name.clone();
        let node = Path::new(&port.port_name);
        let stable_paths: Vec<_> = link_folders.iter().flat_map(|folder| links_to(node, folder.as_ref())).collect();
        let name = usb.map_or("UART", |usb| usb.product.as_deref().unwrap_or("USB")).to_owned();
        let board = usb.and_then(|usb| attached((usb.vid, usb.pid)));
        let is_first = stable_paths.iter().any(|link| link.to_string_lossy().ends_with("-if00"));
        let kind = match board {
            Some(Attached::Maestro) => is_first.then_some("maestro"),
            Some(Attached::Microcontroller) => Some("serial"),
            Some(Attached::BusServos) | None => None,
        };
        let usb = usb.map(|usb| [usb.vid, usb.pid].map(|number| format!("{number:04x}")));
        Self { path, name, stable_paths, usb, kind, board }
    }

    fn lines(&self) -> String {
        let mut text = format!("serial port {} ({})\n", self.path, self.name);
        text.extend(self.stable_paths.iter().map(|link| format!("  stable path {}\n", link.display())));
        text += match (self.board, self.kind) {
            (Some(Attached::Maestro), Some(_)) => "  takes commands: kind = \"maestro\"\n",
            (Some(Attached::Maestro), None) => "  takes no commands: its first port does\n",
            (Some(Attached::BusServos), _) => "  may lead to bus servos: kind = \"bus-servo\"\n",
            _ => "",
        };
        text
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::symlink};

    use super::*;

    #[test]
    fn ports_are_listed_with_their_stable_paths_and_the_one_of_a_maestro_that_takes_commands_is_marked() {
        let folder = tempfile::tempdir().unwrap();
        let [links, absent] = ["by-id", "by-path"].map(|name| folder.path().join(name));
        fs::create_dir(&links).unwrap();
        let serial_number = None;
        let manufacturer = None;
        let product = None;
        let maestro = serialport::UsbPortInfo { vid: 0x1ffb, pid: 0x0089, serial_number, manufacturer, product };
        let maestro = SerialPortType::UsbPort(maestro);
        let usb = ["1ffb", "0089"];
        let takes = "  takes commands: kind = \"maestro\"\n";
        let cases = [
            ("usb-Head_0001", SerialPortType::Unknown, "UART", "", json!([null, null])),
            ("usb-Pololu-if00", maestro.clone(), "USB", takes, json!(["maestro", usb])),
            ("usb-Pololu-if02", maestro, "USB", "  takes no commands: its first port does\n", json!([null, usb])),
        ];
        for (link, port_type, kind, last, in_json) in cases {
            let port_name = folder.path().join(link).display().to_string();
            let link = links.join(link);
            fs::write(&port_name, "").unwrap();
            symlink(&port_name, &link).unwrap();
            let want = format!("serial port {port_name} ({kind})\n  stable path {}\n{last}", link.display());
            let port = Port::new(&SerialPortInfo { port_name, port_type }, &[&links, &absent]);
            assert_eq!(port.lines(), want);
            let listed = listed(&Found::default(), &[port]);
            let listed = &listed["serial_ports"][0];
            assert_eq!(json!([listed["kind"], listed["usb"]]), in_json);
            assert_eq!(listed["stable_paths"], json!([link]));
        }
    }
}
