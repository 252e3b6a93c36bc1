//! `facewire monitor`: receives packets and shows them.
//!
//! On a terminal it draws bars; otherwise it writes one line per second, or with `--json` one object per packet. It only
//! listens, and ends with a summary after Ctrl-C, SIGTERM, a closed output, or its limits. A serial port that disappears
//! ends it, too. If several senders use one port, the newest packet is shown.

mod receiver;
mod screen;

use std::io::{self, IsTerminal as _, Write as _};
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use clap::Args;
use facewire_packet::{BLENDSHAPES, Newest, Packet, Reason, State, Visibility, yaw_pitch_roll_deg};
use serde::{Serialize, Serializer};
use signal_hook::consts::{SIGINT, SIGTERM};

use self::receiver::Receive;
use crate::stopped_by;
use facewire::cli::{Failure, STANDARD_OUTPUT, print};
use facewire::service::Histogram;

/// Time between two pictures. 30 pictures per second look smooth, and more would only load the board.
const SCREEN_PERIOD: Duration = Duration::from_millis(33);
const LINE_PERIOD: Duration = Duration::from_secs(1);
/// The values of `--seconds`, up to a year.
const SECONDS: RangeInclusive<f64> = 0.001..=31_536_000.0;
/// The number of coefficients that a line names, and the least value of one that is worth it.
const NAMED: usize = 4;
const NOTEWORTHY: f32 = 0.05;

const EXAMPLES: &str = "\
Examples:
  facewire monitor
  facewire monitor --listen 0.0.0.0:6000 --seconds 10
  facewire monitor --serial /dev/ttyUSB0
  facewire monitor --json --packets 100 > packets.jsonl";

#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct MonitorArgs {
    /// Address and port to listen to
    #[arg(long, value_name = "ADDRESS", default_value = "0.0.0.0:5252")]
    listen: SocketAddr,
    /// Serial port to read instead
    #[arg(long, value_name = "DEVICE", conflicts_with = "listen")]
    serial: Option<PathBuf>,
    /// Baud rate of the serial port
    #[arg(long, value_name = "N", default_value_t = 115_200, requires = "serial",
        value_parser = clap::value_parser!(u32).range(9600..=4_000_000))]
    baud: u32,
    /// Write each packet as one line of JSON
    #[arg(long)]
    json: bool,
    /// End after this number of valid packets
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    packets: Option<u64>,
    /// End after this number of seconds
    #[arg(long, value_name = "S", value_parser = seconds)]
    seconds: Option<Duration>,
}

impl MonitorArgs {
    fn input(&self) -> String {
        self.serial.as_ref().map_or_else(|| self.listen.to_string(), |device| device.display().to_string())
    }
}

fn seconds(text: &str) -> Result<Duration, String> {
    let number = text.parse().ok().filter(|number| SECONDS.contains(number));
    let wanted = || format!("write a number from {} to {}", SECONDS.start(), SECONDS.end());
    number.map(Duration::from_secs_f64).ok_or_else(wanted)
}

pub fn run(args: &MonitorArgs) -> Result<(), Failure> {
    let mut receive = receiver::open(args)?;
    let stop = stopped_by(&[SIGINT, SIGTERM])?;
    let mut tally = Tally::default();
    match watch(args, &mut receive, &stop, &mut tally) {
        // The reader of the output has gone.
        Err(failure) if failure.message.is_empty() => {}
        watched => watched?,
    }
    if tally.packets.packets == 0 {
        let (way, remedy) = match args.serial {
            Some(_) => ("by", "check the wires, and that both sides have the same baud rate"),
            None => ("to", "check [[link]] address in the sender's configuration, and the firewall"),
        };
        return Err(Failure::failed(format!("no packet came {way} {}; {remedy}", args.input())));
    }
    let summary = tally.summary();
    if !args.json {
        return print(&(summary + "\n"));
    }
    // Standard output carries JSON.
    let _ = writeln!(io::stderr(), "{summary}");
    Ok(())
}

/// Shows packets until a signal or a limit ends it. The screen is restored on return.
fn watch(args: &MonitorArgs, receive: &mut Receive, stop: &AtomicBool, tally: &mut Tally) -> Result<(), Failure> {
    let unwritten = |error: io::Error| Failure::unwritable(Path::new(STANDARD_OUTPUT), &error);
    let listen = args.input();
    let is_screen = !args.json && io::stdout().is_terminal();
    let _restore = is_screen.then(screen::enter).transpose().map_err(unwritten)?;
    let begin = Instant::now();
    let end = args.seconds.map(|seconds| begin + seconds);
    let mut shown = begin;
    while !stop.load(Relaxed)
        && args.packets.is_none_or(|packets| tally.packets.packets < packets)
        && end.is_none_or(|end| Instant::now() < end)
    {
        let left = end.map_or(SCREEN_PERIOD, |end| end.saturating_duration_since(Instant::now()));
        // A socket takes no time-out of zero.
        match receive(left.clamp(Duration::from_millis(1), SCREEN_PERIOD))? {
            Some(Ok((packet, from))) => {
                tally.count(&packet, from, Instant::now());
                if args.json {
                    io::stdout().write_all(json(tally).as_bytes()).map_err(unwritten)?;
                }
            }
            Some(Err(fault)) => tally.packets.refuse(fault),
            None => {}
        }
        if !args.json && shown.elapsed() >= if is_screen { SCREEN_PERIOD } else { LINE_PERIOD } {
            shown = Instant::now();
            let written = if is_screen {
                screen::draw(&listen, tally, shown)
            } else {
                writeln!(io::stdout(), "{}", line(&listen, tally, shown))
            };
            written.map_err(unwritten)?;
        }
    }
    Ok(())
}

/// The tally of all packets, by the names of their senders, and what the summary shows.
#[derive(Default)]
struct Tally {
    packets: facewire_packet::Tally<String>,
    first: Option<Instant>,
    /// `None` before the first live packet.
    ages: Option<Histogram>,
}

impl Tally {
    fn count(&mut self, packet: &Packet, from: String, at: Instant) {
        self.packets.count(packet, from, at);
        self.first.get_or_insert(at);
        if packet.state == State::Live {
            self.ages.get_or_insert_default().record(Duration::from_micros(packet.age_us.into()));
        }
    }

    fn summary(&self) -> String {
        let (Some(first), Some(newest)) = (self.first, &self.packets.newest) else { return String::new() };
        let facewire_packet::Tally { packets, lost, refused, .. } = self.packets;
        let span_s = newest.at.duration_since(first).as_secs_f64();
        let rate_hz = if span_s > 0.0 { packets.saturating_sub(1) as f64 / span_s } else { 0.0 };
        let ages = self.ages.as_ref().map_or_else(String::new, |ages| {
            let [p50, p95] = ages.quantiles_ms([0.5, 0.95]);
            format!("; age of live packets p50 {p50:.1} ms, p95 {p95:.1} ms")
        });
        format!("{packets} packets in {span_s:.1} s ({rate_hz:.1} a second), {lost} lost, {refused} refused{ages}")
    }
}

#[derive(Serialize)]
struct Json<'a> {
    from: &'a str,
    state: &'static str,
    reason: &'static str,
    neutral_face: &'static str,
    #[serde(serialize_with = "with_parts")]
    visibility: Visibility,
    sequence: u16,
    lost_before: u16,
    age_ms: f64,
    capture_us: u32,
    head_yaw_deg: f64,
    head_pitch_deg: f64,
    head_roll_deg: f64,
    head_mm: [f32; 3],
    #[serde(serialize_with = "with_names")]
    coefficients: [f32; BLENDSHAPES.len()],
}

fn with_names<S: Serializer>(values: &[f32; BLENDSHAPES.len()], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(BLENDSHAPES.iter().zip(values.map(|value| rounded(value, 1e5))))
}

fn with_parts<S: Serializer>(visibility: &Visibility, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(visibility.parts().map(|(part, value)| (part, rounded(value, 1e2))))
}

/// Returns the newest packet as a line of JSON.
fn json(tally: &Tally) -> String {
    let Some(Newest { packet, from, lost_before, .. }) = &tally.packets.newest else { return String::new() };
    let [head_yaw_deg, head_pitch_deg, head_roll_deg] =
        yaw_pitch_roll_deg(packet.rotation).map(|deg| rounded(deg, 1e3));
    let json = Json {
        from,
        state: packet.state.name(),
        reason: packet.reason.name(),
        neutral_face: packet.neutral_face.name(),
        visibility: packet.visibility,
        sequence: packet.sequence,
        lost_before: *lost_before,
        age_ms: f64::from(packet.age_us) / 1000.0,
        capture_us: packet.capture_us,
        head_yaw_deg,
        head_pitch_deg,
        head_roll_deg,
        head_mm: packet.position_mm,
        coefficients: packet.coefficients,
    };
    // Numbers and strings always have a JSON form.
    serde_json::to_string(&json).unwrap_or_default() + "\n"
}

/// Rounds to the accuracy of the packet, and turns -0 into 0.
fn rounded(value: f32, steps: f64) -> f64 {
    (f64::from(value) * steps).round() / steps + 0.0
}

/// Describes the state, and names the parts of the face that are covered.
fn state(packet: &Packet) -> String {
    let state = match packet.reason {
        Reason::None => packet.state.name().to_owned(),
        reason => format!("{}: {}", packet.state.name(), reason.name()),
    };
    let covered: Vec<_> = packet.visibility.covered().collect();
    if covered.is_empty() { state } else { format!("{state}  covered: {}", covered.join(", ")) }
}

fn line(listen: &str, tally: &Tally, now: Instant) -> String {
    let Some(Newest { packet, .. }) = &tally.packets.newest else {
        return format!("waiting for packets at {listen}");
    };
    let counts = format!("lost {}  refused {}", tally.packets.lost, tally.packets.refused);
    if let Some(silence) = tally.packets.silence(now) {
        return format!("silent for {:.1} s  {counts}", silence.as_secs_f64());
    }
    let mut strongest: Vec<_> = BLENDSHAPES.iter().zip(packet.coefficients).collect();
    strongest.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    let noteworthy = strongest.iter().take(NAMED).filter(|(_, value)| *value >= NOTEWORTHY);
    let [yaw, pitch, roll] = yaw_pitch_roll_deg(packet.rotation);
    format!(
        "{}  {:.1} packets/s  {counts}  age {:.1} ms  neutral {}  yaw {yaw:.1} pitch {pitch:.1} roll {roll:.1}{}",
        state(packet),
        tally.packets.rate_hz(now),
        f64::from(packet.age_us) / 1000.0,
        packet.neutral_face.name(),
        noteworthy.map(|(name, value)| format!("  {name} {value:.2}")).collect::<String>()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_that_make_no_sense_are_refused_and_the_longest_fits_the_clock() {
        for wrong in ["0", "-1", "1e19", "1e308", "inf", "NaN", "1e-320", "31536001", "ten"] {
            assert!(seconds(wrong).is_err(), "{wrong}");
        }
        assert!(Instant::now().checked_add(seconds("31536000").unwrap()).is_some());
    }

    #[test]
    fn json_names_every_coefficient_in_the_order_of_the_packet() {
        let mut tally = Tally::default();
        let visibility = Visibility { mouth: 0.4, ..Visibility::WHOLE };
        let held = Packet { state: State::Hold, reason: Reason::Late, ..Packet::NEUTRAL };
        let packet = Packet { visibility, coefficients: [0.25; 52], ..held };
        assert_eq!(state(&packet), "hold: late  covered: mouth");
        tally.count(&packet, "127.0.0.1:7".to_owned(), Instant::now());
        let text = json(&tally);
        let begin = r#"{"from":"127.0.0.1:7","state":"hold","reason":"late","neutral_face":"mean","#;
        let visibility =
            r#""visibility":{"left_eye":1.0,"right_eye":1.0,"brows":1.0,"mouth":0.4,"cheeks":1.0,"face":1.0},"#;
        assert!(text.starts_with(&format!("{begin}{visibility}\"sequence\":0,")), "{text}");
        assert!(text.ends_with("\"noseSneerRight\":0.25,\"tongueOut\":0.25}}\n"), "{text}");
        assert_eq!(text.matches(":0.25").count(), 52);
    }

    #[test]
    fn the_line_shows_waiting_state_and_silence_and_the_summary_counts_rate_and_ages() {
        let listen = "0.0.0.0:5252";
        let now = Instant::now();
        let mut tally = Tally::default();
        assert_eq!(line(listen, &tally, now), "waiting for packets at 0.0.0.0:5252");
        for sequence in 0..31_u16 {
            let mut packet = Packet { state: State::Live, sequence, age_us: 20_000, ..Packet::NEUTRAL };
            packet.coefficients[17] = 0.5;
            tally.count(&packet, listen.to_owned(), now + Duration::from_millis(100) * sequence.into());
        }
        tally.packets.refuse(facewire_packet::DecodeError::Checksum);
        let last = now + Duration::from_secs(3);
        let want = "live  10.0 packets/s  lost 0  refused 1  age 20.0 ms  neutral mean  yaw 0.0 pitch 0.0 roll 0.0  \
                    jawOpen 0.50";
        assert_eq!(line(listen, &tally, last), want);
        let later = last + Duration::from_millis(1500);
        assert_eq!(line(listen, &tally, later), "silent for 1.5 s  lost 0  refused 1");
        // Reported ages are up to 3.2 % too long.
        let want = "31 packets in 3.0 s (10.0 a second), 0 lost, 1 refused; \
                    age of live packets p50 20.4 ms, p95 20.4 ms";
        assert_eq!(tally.summary(), want);
    }
}
