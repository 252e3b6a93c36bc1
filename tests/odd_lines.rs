//! The whole program with serial drivers that set another rate than the one they are asked for, and with networks that go
//! away.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::net::UdpSocket;

use common::board::Board;
use common::hooks::hook;
use common::interface::Interface;
use common::service::{NO_CAMERA, Receiver, Service, counted};
use common::{PATIENCE, eventually};
use rustix::termios::tcgetattr;

/// Starts a service with a serial link at this rate. The UART of the link's driver divides the rate `base`.
fn serve_serial(board: &Board, baud: u32, base: u32) -> Service {
    let link = format!("[[link]]\nkind = \"serial\"\ndevice = \"{}\"\nbaud = {baud}\n", board.device.display());
    let toml = [NO_CAMERA, &link].concat();
    Service::start_with(&toml, &[], |command| {
        command.env("LD_PRELOAD", hook("serial")).env("SERIAL_BASE_BAUD", base.to_string())
    })
}

#[test]
fn a_serial_link_runs_at_two_million_baud_if_the_driver_makes_this_rate() {
    let mut board = Board::plugged_in();
    let port = board.port();
    let service = serve_serial(&board, 2_000_000, 24_000_000);
    eventually("packets", || !board.packets().is_empty());
    let modes = tcgetattr(&port).unwrap();
    assert_eq!((modes.input_speed(), modes.output_speed()), (2_000_000, 2_000_000));
    assert_eq!(service.logged("at 2000000 baud"), 1, "{}", service.log());
    assert_eq!(service.logged("WARN link"), 0, "{}", service.log());
}

#[test]
fn packets_come_again_when_the_interface_is_back_and_its_loss_is_reported_once() {
    let Some(interface) =
        Interface::inside("packets_come_again_when_the_interface_is_back_and_its_loss_is_reported_once")
    else {
        return;
    };
    let [far, near] = [Receiver(UdpSocket::bind("0.0.0.0:0").unwrap()), Receiver::new()];
    far.0.set_read_timeout(Some(PATIENCE)).unwrap();
    let service = Service::start(NO_CAMERA, &[format!("{}:{}", Interface::ADDRESS, far.port()), near.address()]);
    far.packet();
    for times in 1..=2 {
        interface.take_down();
        near.packet();
        // The log reports it with the next status line.
        eventually("a word about the network", || {
            service.status();
            service.logged("the network takes no packets") == times
        });
        assert_eq!(counted(&service.status(), "links_open"), 1, "{}", service.log());
        far.rest();
        (0..5).for_each(|_| _ = near.packet());
        assert!(far.rest().is_empty());
        interface.bring_up();
        far.packet();
        eventually("the link", || counted(&service.status(), "links_open") == 2);
    }
}
