//! `facewire devices`: lists connected devices as the settings name them.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use serialport::{SerialPortInfo, SerialPortType};

use super::failure::{Failure, print};
use crate::capture::v4l2::{Camera, cameras};
use crate::link::is_maestro;

/// Folders of stable links to serial ports: `by-id` names the device, `by-path` the socket it is plugged into.
const PORT_LINKS: [&str; 2] = ["/dev/serial/by-id", "/dev/serial/by-path"];

pub fn run() -> Result<(), Failure> {
    let found = cameras();
    let mut text: String = found.cameras.iter().map(camera_lines).collect();
    if found.cameras.is_empty() {
        text += "no camera\n";
    }
    text.extend(found.refused.iter().map(|refused| format!("not examined: {refused}\n")));
    let ports = serialport::available_ports().unwrap_or_default();
    text.extend(ports.iter().map(|port| port_lines(port, &PORT_LINKS)));
    if ports.is_empty() {
        text += "no serial port\n";
    }
    print(&text)
}

fn camera_lines(camera: &Camera) -> String {
    let mut text = format!("camera {} \"{}\" ({})\n", camera.node.display(), camera.card, camera.driver);
    text.extend(camera.links.iter().map(|link| format!("  stable path {}\n", link.display())));
    text.extend(camera.modes.iter().map(|mode| format!("  {mode}\n")));
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
    text.extend(links.iter().map(|link| format!("  stable path {}\n", link.display())));
    if matches!(&port.port_type, SerialPortType::UsbPort(usb) if is_maestro(usb.vid, usb.pid)) {
        text += match links.iter().any(|link| link.to_string_lossy().ends_with("-if00")) {
            true => "  takes commands: kind = \"maestro\"\n",
            false => "  takes no commands: its first port does\n",
        };
    }
    text
}

fn links_to(port: &Path, folder: &Path) -> BTreeSet<PathBuf> {
    let Ok(port) = fs::canonicalize(port) else { return BTreeSet::new() };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    entries.filter(|link| fs::canonicalize(link).is_ok_and(|end| end == port)).collect()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn ports_are_listed_with_their_stable_paths_and_the_one_of_a_maestro_that_takes_commands_is_marked() {
        let folder = tempfile::tempdir().unwrap();
        let [links, absent] = ["by-id", "by-path"].map(|name| folder.path().join(name));
        fs::create_dir(&links).unwrap();
        let (serial_number, manufacturer, product) = (None, None, None);
        let maestro = serialport::UsbPortInfo { vid: 0x1ffb, pid: 0x0089, serial_number, manufacturer, product };
        let maestro = SerialPortType::UsbPort(maestro);
        let cases = [
            ("usb-Head_0001", SerialPortType::Unknown, "UART", ""),
            ("usb-Pololu-if00", maestro.clone(), "USB", "  takes commands: kind = \"maestro\"\n"),
            ("usb-Pololu-if02", maestro, "USB", "  takes no commands: its first port does\n"),
        ];
        for (link, port_type, kind, last) in cases {
            let (port_name, link) = (folder.path().join(link).display().to_string(), links.join(link));
            fs::write(&port_name, "").unwrap();
            symlink(&port_name, &link).unwrap();
            let want = format!("serial port {port_name} ({kind})\n  stable path {}\n{last}", link.display());
            assert_eq!(port_lines(&SerialPortInfo { port_name, port_type }, &[&links, &absent]), want);
        }
    }
}
