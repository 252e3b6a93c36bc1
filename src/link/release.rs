//! Releases the servos of links that no service moves.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::{Duration, Instant};

use super::{Link, Output, Rates, Traffic};
use crate::clock::monotonic_us;
use crate::config::LinkSettings;

/// After this time, boards that have not acknowledged the release are named. Reading 30 bus servos takes a quarter of a second.
const FIRST_PATIENCE: Duration = Duration::from_millis(250);
/// How long the boards have to acknowledge the release.
const PATIENCE: Duration = Duration::from_millis(1500);
/// How long the links have to close their devices.
const CLOSING: Duration = Duration::from_millis(1500);
const PERIOD: Duration = Duration::from_millis(3);
const RATES: Rates = Rates { send_hz: 40, slew_per_s: 1.0 };

/// Takes pulses and torque from the servos of these links, and returns for each link with a servo board whether the board has
/// acknowledged that, or a sentence that says why not. Nodes of DMX hold or drop their servos by themselves when their stream
/// ends. `warn` gets a sentence about each board that has not acknowledged it within a quarter of a second, while it is tried on.
pub fn release_servos(settings: &[LinkSettings], warn: impl Fn(String)) -> Vec<(String, Result<(), String>)> {
    let traffic = Arc::<Traffic>::default();
    traffic.operator.is_released.store(true, Relaxed);
    let boards = settings.iter().filter(|link| link.kind.moves_servos() && link.kind.universe().is_none());
    let mut links: Vec<_> = boards.map(|settings| (settings, Link::open(settings, &traffic))).collect();
    let begun = Instant::now();
    let mut has_warned = false;
    loop {
        let mut is_over = true;
        for (settings, link) in &mut links {
            if let Ok(link) = link {
                link.offer(settings, RATES, monotonic_us(), &Output::NEUTRAL);
                is_over &= link.panel.dials.has_released();
            }
        }
        if is_over || begun.elapsed() >= PATIENCE {
            break;
        }
        if !has_warned && begun.elapsed() >= FIRST_PATIENCE {
            has_warned = true;
            let outcomes = links.iter().map(|(settings, link)| outcome(settings, link.as_ref()));
            outcomes.filter_map(Result::err).for_each(|trouble| warn(format!("still trying: {trouble}")));
        }
        thread::sleep(PERIOD);
    }
    let outcomes =
        links.iter().map(|(settings, link)| (settings.to_string(), outcome(settings, link.as_ref()))).collect();
    close(links.into_iter().filter_map(|(_, link)| link.ok()).collect());
    outcomes
}

fn outcome(settings: &LinkSettings, link: Result<&Link, &super::LinkError>) -> Result<(), String> {
    let trouble = match link {
        Ok(link) if link.panel.dials.has_released() => return Ok(()),
        Ok(link) => link.panel.trouble().unwrap_or_else(|| "it does not answer".to_owned()),
        Err(error) => error.message.clone(),
    };
    // Some troubles begin with the name of the link.
    let name = format!("{settings}: ");
    let trouble = trouble.strip_prefix(&name).unwrap_or(&trouble);
    Err(format!("link {name}{trouble}; switch the supply of its servos off"))
}

fn close(links: Vec<Link>) {
    links.iter().for_each(Link::stop);
    let end = Instant::now() + CLOSING;
    while !links.iter().all(Link::has_ended) && Instant::now() < end {
        thread::sleep(PERIOD);
    }
}
