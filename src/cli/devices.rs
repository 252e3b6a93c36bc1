//! `facewire devices`: lists connected devices as the settings name them.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use serialport::{SerialPortInfo, SerialPortType};

use super::failure::{Failure, print};
use crate::capture::v4l2::{Camera, cameras};
use crate::link::is_maestro;

/// Folders of stable links to serial ports: `by-id` names the device, `by-path` the socket it is plugged into.
const PORT_LINKS: [&str; 2] = ["/dev/serial/by-id", "/dev/serial/by-path"];

/// End of the stable path of a device's first port.
const FIRST_PORT: &str = "-if00";

pub fn run() -> Result<(), Failure> {
    let mut text = String::new();
    let found = cameras();
    // Writing to a string cannot fail.
    for camera in &found.cameras {
        text += &camera_lines(camera);
    }
    if found.cameras.is_empty() {
        text += "no camera\n";
    }
    for refused in &found.refused {
        let _ = writeln!(text, "not examined: {refused}");
    }
    let ports = serialport::available_ports().unwrap_or_default();
    text.extend(ports.iter().map(|port| port_lines(port, &PORT_LINKS)));
    if ports.is_empty() {
        text += "no serial port\n";
    }
    print(&text)
}

fn camera_lines(camera: &Camera) -> String {
    let mut text = format!("camera {} \"{}\" ({})\n", camera.node.display(), camera.card, camera.driver);
    for link in &camera.links {
        let _ = writeln!(text, "  stable path {}", link.display());
    }
    for mode in &camera.modes {
        let _ = writeln!(text, "  {mode}");
    }
    if camera.modes.is_empty() {
        text += "  no format that facewire reads (YUYV, NV12, MJPEG, GREY)\n";
    }
    text
}

fn port_lines(port: &SerialPortInfo, link_folders: &[impl AsRef<Path>]) -> String {
    let kind = match &port.port_type {
        SerialPortType::UsbPort(usb) => usb.product.clone().unwrap_or_else(|| "USB".to_owned()),
        SerialPortType::PciPort | SerialPortType::BluetoothPort | SerialPortType::Unknown => "UART".to_owned(),
    };
    let mut text = format!("serial port {} ({kind})\n", port.port_name);
    let links: Vec<_> =
        link_folders.iter().flat_map(|folder| links_to(Path::new(&port.port_name), folder.as_ref())).collect();
    for link in &links {
        let _ = writeln!(text, "  stable path {}", link.display());
    }
    if matches!(&port.port_type, SerialPortType::UsbPort(usb) if is_maestro(usb.vid, usb.pid)) {
        let is_first = links.iter().any(|link| link.to_string_lossy().ends_with(FIRST_PORT));
        text += if is_first {
            "  takes commands: kind = \"maestro\"\n"
        } else {
            "  takes no commands: its first port does\n"
        };
    }
    text
}

fn links_to(port: &Path, folder: &Path) -> Vec<PathBuf> {
    let Ok(port) = fs::canonicalize(port) else { return Vec::new() };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut links: Vec<_> = entries.filter(|link| fs::canonicalize(link).is_ok_and(|end| end == port)).collect();
    links.sort();
    links
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn the_port_of_a_maestro_that_takes_commands_is_told_from_the_other_one() {
        let folder = tempfile::tempdir().unwrap();
        let links = folder.path().join("by-id");
        fs::create_dir(&links).unwrap();
        let listed = |node: &str, link: &str| {
            let node = folder.path().join(node);
            fs::write(&node, "").unwrap();
            symlink(&node, links.join(link)).unwrap();
            let (serial_number, manufacturer, product) = (None, None, None);
            let usb = serialport::UsbPortInfo { vid: 0x1ffb, pid: 0x0089, serial_number, manufacturer, product };
            let port_name = node.display().to_string();
            let info = SerialPortInfo { port_name, port_type: SerialPortType::UsbPort(usb) };
            port_lines(&info, std::slice::from_ref(&links))
        };
        let first = listed("ttyACM0", "usb-Pololu_Micro_Maestro_6-if00");
        assert!(first.ends_with("  takes commands: kind = \"maestro\"\n"), "{first}");
        let second = listed("ttyACM1", "usb-Pololu_Micro_Maestro_6-if02");
        assert!(second.ends_with("  takes no commands: its first port does\n"), "{second}");
    }

    #[test]
    fn a_serial_port_is_listed_with_its_stable_paths() {
        let folder = tempfile::tempdir().unwrap();
        let [port, other, links] = ["ttyACM0", "ttyACM1", "by-id"].map(|name| folder.path().join(name));
        for node in [&port, &other] {
            fs::write(node, "").unwrap();
        }
        fs::create_dir(&links).unwrap();
        symlink("../ttyACM0", links.join("usb-Head_0001")).unwrap();
        symlink("../ttyACM1", links.join("usb-Other_0002")).unwrap();
        let name = port.display().to_string();
        let info = SerialPortInfo { port_name: name.clone(), port_type: SerialPortType::Unknown };
        let stable = links.join("usb-Head_0001");
        let absent = folder.path().join("by-path");
        let want = format!("serial port {name} (UART)\n  stable path {}\n", stable.display());
        assert_eq!(port_lines(&info, &[links, absent]), want);
    }
}
