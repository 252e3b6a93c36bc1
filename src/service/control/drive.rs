//! The task of a client that drives: line by line, it jogs a servo or has a puppet's face shown. One client drives at a time.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use facewire_packet::control::Drive;
use facewire_packet::{BLENDSHAPES, Pose};
use nalgebra::{UnitQuaternion, Vector3};

use super::Peers;
use super::client::{Client, MAX_DRIVE_LINE};
use crate::clock::monotonic_us;

/// Longest silence of a client that drives.
pub(super) const DRIVE_PATIENCE: Duration = Duration::from_millis(400);

/// The servo to jog: the place of its link, its channel, and where it goes.
type Jog = (usize, u16, f32);

pub(super) fn begin(others_follow: bool, peers: &mut Peers) {
    tracing::info!("driving begins");
    // The last driver's jog or puppet must not move anything.
    set_driven(None, None, others_follow, peers);
}

pub(super) fn end(peers: &Peers) {
    peers.counters.traffic.operator.is_driven.store(false, Relaxed);
    drive_until(0, peers);
    tracing::info!("driving has ended");
}

/// Does what the driver's lines say, while servo boards that it does not move stay still unless `others_follow`. Returns why it
/// may not drive any more if a line is bad or none comes.
pub(super) fn step(driver: &mut Client, others_follow: bool, peers: &mut Peers) -> io::Result<Option<String>> {
    let has_ended = driver.receive(MAX_DRIVE_LINE)?;
    while let Some(line) = driver.request(MAX_DRIVE_LINE) {
        if let Err(why) = line.and_then(|drive| obey(drive, others_follow, peers)) {
            return Ok(Some(why));
        }
    }
    if has_ended {
        return Err(ErrorKind::UnexpectedEof.into());
    }
    Ok(driver.has_waited(DRIVE_PATIENCE).then(|| "no line has come for 400 ms".to_owned()))
}

/// Gives the links what the driver wants, until [`DRIVE_PATIENCE`] has passed without another line.
fn obey(drive: Drive, others_follow: bool, peers: &mut Peers) -> Result<(), String> {
    match drive {
        Drive::Alive {} => {}
        Drive::Jog { link, channel, position } => {
            if !peers.counters.panels().get(link).is_some_and(|panel| panel.dials.has(channel)) {
                return Err(format!("link {link} has no servo at channel {channel}"));
            }
            set_driven(Some((link, channel, position)), None, others_follow, peers);
        }
        Drive::Puppet { coefficients, head_deg } => {
            set_driven(None, Some(puppet_pose(&coefficients, head_deg)?), others_follow, peers);
        }
    }
    drive_until(monotonic_us() + DRIVE_PATIENCE.as_micros() as u64, peers);
    Ok(())
}

fn set_driven(jog: Option<Jog>, pose: Option<Pose>, others_follow: bool, peers: &mut Peers) {
    peers.puppet.write(pose);
    // A puppet moves all boards.
    let is_still = pose.is_none() && !others_follow;
    for (index, panel) in peers.counters.panels().iter().enumerate() {
        let of_panel = jog.filter(|(link, ..)| *link == index);
        panel.dials.keep_still(is_still && of_panel.is_none());
        panel.dials.jog(of_panel.map(|(_, channel, position)| (channel, position)));
    }
}

fn drive_until(time_us: u64, peers: &Peers) {
    peers.counters.traffic.operator.driven_until_us.store(time_us, Relaxed);
    peers.sender.unpark();
}

/// A face that looks at the camera but for these angles, which are bounded as the coefficients are.
fn puppet_pose(coefficients: &BTreeMap<String, f32>, head_deg: [f32; 3]) -> Result<Pose, String> {
    let mut pose = Pose::NEUTRAL;
    for (name, value) in coefficients {
        let place = BLENDSHAPES.iter().zip(&mut pose.coefficients).find(|(known, _)| *known == name);
        let (_, coefficient) = place.ok_or_else(|| format!("{name:?} is no coefficient"))?;
        *coefficient = value.clamp(0.0, 1.0);
    }
    let [yaw, pitch, roll] = head_deg.map(|angle_deg| angle_deg.clamp(-90.0, 90.0).to_radians());
    let rolled = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    let pitched = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -pitch);
    let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
    pose.rotation = (rolled * pitched * turned).coords.into();
    Ok(pose)
}
