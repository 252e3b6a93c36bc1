//! `facewire devices`: what can be plugged in, and what to write into the settings for it.

use std::fmt::Write as _;

use serialport::{SerialPortInfo, SerialPortType};

use super::failure::{Failure, print};
use crate::capture::v4l2::{Camera, cameras};

pub(super) fn run() -> Result<(), Failure> {
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
        let _ = writeln!(text, "not looked at: {refused}");
    }
    let ports = serialport::available_ports().unwrap_or_default();
    text.extend(ports.iter().map(port_line));
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

fn port_line(port: &SerialPortInfo) -> String {
    let kind = match &port.port_type {
        SerialPortType::UsbPort(usb) => usb.product.clone().unwrap_or_else(|| "USB".to_owned()),
        SerialPortType::PciPort | SerialPortType::BluetoothPort | SerialPortType::Unknown => "UART".to_owned(),
    };
    format!("serial port {} ({kind})\n", port.port_name)
}
