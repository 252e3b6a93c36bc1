//! The whole program with serial drivers that set another rate than the one they are asked for, and with networks that go
//! away.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::net::UdpSocket;

use common::board::Board;
use common::hooks::hook;
use common::interface::Interface;
use common::service::{DEMO, NO_CAMERA, Receiver, Service, counted};
use common::{PATIENCE, eventually};
use facewire_packet::formats::ifacialmocap::REQUEST;
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
fn a_rate_that_the_driver_does_not_make_is_reported_with_the_one_that_it_makes() {
    let mut board = Board::plugged_in();
    let port = board.port();
    let service = serve_serial(&board, 2_000_000, 921_600);
    eventually("packets", || !board.packets().is_empty());
    assert_eq!(tcgetattr(&port).unwrap().output_speed(), 921_600);
    let opened = format!("link opened: {} at 921600 baud", board.device.display());
    assert_eq!(service.logged(&opened), 1, "{}", service.log());
    assert_eq!(service.logged("its driver runs at 921600 baud instead of 2000000"), 1, "{}", service.log());
}

#[test]
fn a_receiver_of_ifacialmocap_that_asks_once_gets_the_face_again_after_its_network_was_away() {
    let Some(interface) =
        Interface::inside("a_receiver_of_ifacialmocap_that_asks_once_gets_the_face_again_after_its_network_was_away")
    else {
        return;
    };
    let receiver = UdpSocket::bind("0.0.0.0:0").unwrap();
    receiver.set_nonblocking(true).unwrap();
    let mut bytes = [0; 4096];
    let mut gets_face = || receiver.recv(&mut bytes).is_ok();
    let link = "[[link]]\nkind = \"ifacialmocap\"\nreply_port = 0\n";
    let (_service, near) = Service::with_receiver(&[DEMO, link].concat());
    eventually("the face", || {
        let _ = receiver.send_to(REQUEST, (Interface::ADDRESS, 49983));
        gets_face()
    });
    interface.take_down();
    // Longer than a receiver may be away whose machine refuses datagrams: each packet is a 60th of a second or more.
    near.rest();
    (0..240).for_each(|_| _ = near.packet());
    while gets_face() {}
    interface.bring_up();
    eventually("the face", gets_face);
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
