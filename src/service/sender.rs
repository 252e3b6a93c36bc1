//! The sender: the failsafe and the links, on a thread of their own that no inference can hold up; and a replay, which
//! gives it recorded faces.
//!
//! The thread sleeps until the hot loop wakes it, or until the failsafe or a link is due. It cannot fail, and allocates
//! nothing; it frees memory only when a reload replaces links.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, mpsc};
use std::thread::{self, Builder};
use std::time::{Duration, Instant};

use facewire_packet::{Packet, Pose, Reason, State};
use triple_buffer::Output as Newest;

use super::counters::Counters;
use super::failsafe::{Failsafe, History, News};
use super::observer::{self, Observer};
use super::timing::{FrameTiming, between};
use super::{STACK_BYTES, ServiceError, ends_before};
use crate::capture::FrameRate;
use crate::clock::monotonic_us;
use crate::config::{FailsafeSettings, LinkSettings, Settings};
use crate::link::{Announcement, Link, LinkError, Output, Panel, Rates, Traffic, announcement, packet};
use crate::recording::Recorded;

/// Longest sleep. It bounds how late the sender sees that it is to stop.
const MAX_SLEEP_US: u64 = 100_000;
/// Longest sleep while an operator drives. It bounds how late the sender sees that the operator is silent.
const DRIVEN_PERIOD_US: u64 = 20_000;
/// Longest time that a stopping service takes to move the face to neutral. A face that is still on its way jumps then.
const LONGEST_STOP_US: u64 = 500_000;
/// Time between the last packets. A serial link drops a packet that it has not written when the next one comes, and
/// interference that spoils one datagram often spoils those close to it.
const STOPPING_PERIOD: Duration = Duration::from_millis(25);
const STOPPING_PACKETS: usize = 3;
/// Longest sleep of a replay. It bounds how late a signal is seen.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

pub(super) struct Sender {
    pub(super) links: Links,
    pub(super) changes: mpsc::Receiver<Links>,
    pub(super) news: Newest<News>,
    /// The face that an operator wants in place of the wearer's, as long as the operator drives.
    pub(super) puppet: Newest<Option<Pose>>,
    /// Shows watchers what the links are offered.
    pub(super) shown: Observer<Packet>,
    pub(super) counters: Arc<Counters>,
}

impl Sender {
    /// Sends until the service stops, then moves the face to neutral and closes the links.
    pub(super) fn run(mut self) {
        let mut history = History::default();
        while !self.counters.stop_sending.load(Relaxed) {
            let now_us = monotonic_us();
            self.counters.heartbeats.beat_sender(now_us);
            while let Ok(change) = self.changes.try_recv() {
                let old = std::mem::replace(&mut self.links, change);
                self.links.take_over(old, &history.last());
            }
            let wait_us = self.step(&mut history, now_us);
            thread::park_timeout(Duration::from_micros(wait_us));
        }
        self.stop(&mut history, |time| {
            thread::sleep(time);
            monotonic_us()
        });
        self.links.close();
    }

    /// Moves the face to neutral and sends the last packets. `after` lets a time pass and returns what the clock then shows.
    fn stop(&mut self, history: &mut History, mut after: impl FnMut(Duration) -> u64) {
        self.counters.traffic.operator.is_driven.store(false, Relaxed);
        let failsafe = self.failsafe();
        let pause = Duration::from_secs(1) / self.links.rate_hz.max(1);
        let mut now_us = after(Duration::ZERO);
        let end_us = now_us + LONGEST_STOP_US;
        let mut output = failsafe.stop(history, now_us);
        while (output.state != State::Neutral || self.links.is_held()) && now_us < end_us {
            self.offer(now_us, &output);
            now_us = after(pause);
            output = failsafe.stop(history, now_us);
        }
        self.counters.set_state(State::Neutral);
        for _ in 0..STOPPING_PACKETS {
            self.links.send_last(&history.last());
            let now_us = after(STOPPING_PERIOD);
            failsafe.stop(history, now_us);
        }
    }

    /// Sends what is due now. Returns how long to sleep if nothing wakes the thread, microseconds.
    fn step(&mut self, history: &mut History, now_us: u64) -> u64 {
        let failsafe = self.failsafe();
        let operator = &self.counters.traffic.operator;
        let is_driven = now_us < operator.driven_until_us.load(Relaxed);
        operator.is_driven.store(is_driven, Relaxed);
        let is_new = self.news.update();
        let news = is_new.then(|| self.news.peek_output_buffer());
        let puppet = if is_driven { *self.puppet.read() } else { None };
        let position_mm = history.last().pose.position_mm;
        let puppet = puppet.map(|pose| Ok((Pose { position_mm, ..pose }, now_us)));
        history.hears_puppet = puppet.is_some();
        let output = failsafe.update(history, now_us, puppet.as_ref().or(news));
        let wait_us = self.offer(now_us, &output).min(failsafe.wait_us(history));
        if output.followed && puppet.is_none() {
            self.counters.times.age.record(Duration::from_micros(output.age_us));
        }
        wait_us.min(if is_driven { DRIVEN_PERIOD_US } else { MAX_SLEEP_US })
    }

    fn failsafe(&self) -> Failsafe {
        Failsafe::new(&self.links.failsafe, self.counters.frame_period_us.load(Relaxed))
    }

    fn offer(&mut self, now_us: u64, output: &Output) -> u64 {
        self.counters.set_state(output.state);
        let is_released = self.counters.traffic.operator.is_released.load(Relaxed);
        let wait_us = self.links.offer(now_us, output);
        self.counters.traffic.operator.released_at_links.store(is_released, Relaxed);
        self.counters.links_open.store(self.links.each().filter(|(_, link)| link.is_open()).count() as u64, Relaxed);
        self.shown.publish(|| packet(output, 0));
        wait_us
    }
}

/// How long a stopping service waits for its links to send their last packet.
const LAST_PACKET: Duration = Duration::from_millis(1500);

/// Links in the order of their settings, and what all of them need of the other settings. A link whose format and
/// receiver stay the same in a reload is carried over with its open port and its packet numbers.
pub(super) struct Links {
    failsafe: FailsafeSettings,
    rate_hz: u32,
    links: Vec<Linked>,
}

struct Linked {
    settings: LinkSettings,
    panel: Arc<Panel>,
    /// In a change that a reload prepares, a link is `None` if the sender has it.
    link: Option<Link>,
    /// That of the link to the same servo board, with other channels, which this one replaces.
    replaced: Option<Arc<Panel>>,
    announcement: Option<Announcement>,
}

impl Links {
    /// Opens the links in `new` of which `live` has no panel. One whose host or device is away waits for it.
    pub(super) fn change(new: &Settings, mut live: Vec<Arc<Panel>>, traffic: &Arc<Traffic>) -> Result<Self, LinkError> {
        let open = |(number, settings): (usize, &LinkSettings)| {
            let announcement = announcement(&new.links, number);
            let settings = settings.clone();
            if let Some(index) = live.iter().position(|panel| panel.kind == settings.kind) {
                return Ok(Linked { settings, panel: live.remove(index), link: None, replaced: None, announcement });
            }
            let replaced = live.iter().position(|panel| panel.kind.has_same_board(&settings.kind));
            let replaced = replaced.map(|index| live.remove(index));
            let link = Link::open(&settings, traffic)?;
            Ok(Linked { settings, panel: Arc::clone(&link.panel), link: Some(link), replaced, announcement })
        };
        let links = new.links.iter().enumerate().map(open).collect::<Result<_, _>>()?;
        Ok(Self { failsafe: new.failsafe.clone(), rate_hz: new.send.rate_hz, links })
    }

    pub(super) fn panels(&self) -> Vec<Arc<Panel>> {
        self.links.iter().map(|linked| Arc::clone(&linked.panel)).collect()
    }

    /// Takes over those of the old links that the change keeps, and makes all links look up their host names now. A link that
    /// replaces another one to the same servo board goes on where that one is. The other old links send `last`. This neither
    /// allocates nor waits.
    fn take_over(&mut self, mut old: Self, last: &Output) {
        let mut take = |panel: &Arc<Panel>| {
            let same = old.links.iter_mut().find(|linked| Arc::ptr_eq(&linked.panel, panel));
            same.and_then(|linked| linked.link.take())
        };
        for linked in &mut self.links {
            if linked.link.is_none() {
                linked.link = take(&linked.panel);
            } else if let Some(replaced) = linked.replaced.take() {
                linked.panel.dials.begin_at(&replaced.dials);
                let has_all = replaced.dials.channels.iter().all(|dial| linked.panel.dials.has(dial.number));
                // A link that is dropped lets go of its servos.
                take(&replaced).iter().filter(|_| has_all).for_each(Link::hand_over);
            }
        }
        (0..STOPPING_PACKETS).for_each(|_| old.send_last(last));
        self.each().for_each(|(_, link)| link.refresh());
    }

    /// Offers the output to every link. Returns how long the links can wait for the next output, in microseconds.
    fn offer(&mut self, now_us: u64, output: &Output) -> u64 {
        let rates = Rates { send_hz: self.rate_hz, slew_per_s: self.failsafe.slew_per_s };
        let mut wait_us = u64::MAX;
        for Linked { settings, link, announcement, .. } in &mut self.links {
            let Some(link) = link else { continue };
            wait_us = wait_us.min(link.offer(settings, rates, now_us, output));
            if let Some(announcement) = announcement {
                link.announce(announcement, now_us);
            }
        }
        wait_us
    }

    /// Whether a link is still on its way from a pose that it has held.
    fn is_held(&mut self) -> bool {
        self.each().any(|(_, link)| link.is_held())
    }

    pub(super) fn send_last(&mut self, output: &Output) {
        self.each().for_each(|(settings, link)| link.send_last(settings, output));
    }

    fn close(mut self) {
        self.each().for_each(|(_, link)| link.stop());
        ends_before(Instant::now() + LAST_PACKET, || self.each().all(|(_, link)| link.has_ended()));
    }

    fn each(&mut self) -> impl Iterator<Item = (&LinkSettings, &mut Link)> {
        self.links.iter_mut().filter_map(|linked| Some((&linked.settings, linked.link.as_mut()?)))
    }
}

/// Sends frames through the links, each at its own time after the first one, until `next` returns `None`, or until
/// SIGTERM or SIGINT; then moves the face to neutral. Returns how many packets were sent and dropped.
pub fn replay<E: From<ServiceError>>(
    settings: &Settings,
    mut next: impl FnMut() -> Result<Option<Recorded>, E>,
) -> Result<[u64; 2], E> {
    let counters = Arc::new(Counters::default());
    counters.catch_signals().map_err(ServiceError::from)?;
    let links = Links::change(settings, Vec::new(), &counters.traffic).map_err(ServiceError::from)?;
    let (mut newest, news) = triple_buffer::triple_buffer(&Err(Reason::NoCamera));
    let changes = mpsc::channel().1;
    let shown = observer::channel().0;
    let puppet = triple_buffer::triple_buffer(&None).1;
    let sender = Sender { links, changes, news, puppet, shown, counters: Arc::clone(&counters) };
    let sender = Builder::new().name("fw-sender".to_owned()).stack_size(STACK_BYTES).spawn(|| sender.run());
    let sender = sender.map_err(ServiceError::from)?;
    let mut clock = Clock::default();
    let mut timing = FrameTiming::new(Arc::clone(&counters));
    let outcome = loop {
        match next() {
            Ok(Some(frame)) if clock.wait_for(frame.time_us, &counters) => {
                timing.captured(frame.time_us);
                newest.write(frame.pose.map(|pose| (pose, monotonic_us())));
                sender.thread().unpark();
            }
            Ok(_) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    counters.stop();
    sender.thread().unpark();
    sender.join().map_err(|_| ServiceError::Panicked("sender"))?;
    outcome.map(|()| [&counters.traffic.sent, &counters.traffic.dropped].map(|count| count.load(Relaxed)))
}

/// Turns the times of a recording into times of the monotonic clock: the last frame's time in the recording, and when it
/// was due, microseconds.
#[derive(Debug, Default)]
struct Clock(Option<(u64, u64)>);

impl Clock {
    /// When a frame of this time is due. One that is not later than the frame before, because the recording begins anew
    /// or states no times, follows that one after a frame period: otherwise it could keep a processor busy.
    fn due_us(&mut self, time_us: u64, now_us: u64) -> u64 {
        let due_us = match self.0 {
            None => now_us,
            Some((last_us, due_us)) if time_us > last_us => due_us.saturating_add(time_us - last_us),
            Some((_, due_us)) => now_us.max(due_us.saturating_add(FrameRate::FPS_30.period_us())),
        };
        self.0 = Some((time_us, due_us));
        due_us
    }

    fn wait_for(&mut self, time_us: u64, counters: &Counters) -> bool {
        let due_us = self.due_us(time_us, monotonic_us());
        while !counters.stopping() {
            let left = between(monotonic_us(), due_us);
            if left.is_zero() {
                return true;
            }
            thread::park_timeout(left.min(LONGEST_SLEEP));
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use std::net::UdpSocket;

    use super::*;
    use crate::config;
    use crate::link::{test_output, testing::eventually};
    use crate::service::{DISK_PATIENCE, HOT_PATIENCE};

    #[test]
    fn recorded_frames_are_due_at_their_own_distances_or_a_frame_period_apart_without_times_of_their_own() {
        let mut clock = Clock::default();
        let due =
            [(70, 1000), (103, 1040), (170, 1050), (70, 1101), (100, 1110)].map(|(at, now)| clock.due_us(at, now));
        assert_eq!(due, [1000, 1033, 1100, 1100 + 33_333, 1130 + 33_333], "a late frame delays no later one");
        let mut clock = Clock::default();
        let due: Vec<_> = (0..4).map(|_| clock.due_us(0, 1000)).collect();
        assert_eq!(due, [1000, 34_333, 67_666, 100_999]);
        assert_eq!(clock.due_us(0, 5_000_000), 5_000_000, "a program that was stopped does not catch up");
    }

    fn settings(receivers: [&UdpSocket; 2]) -> Settings {
        let link = |socket: &UdpSocket| format!("[[link]]\naddress = \"{}\"\n", socket.local_addr().unwrap());
        config::parse("test", &receivers.map(link).concat()).unwrap()
    }

    /// The packets that have come and were not taken yet.
    fn packets(socket: &UdpSocket) -> Vec<Packet> {
        socket.set_nonblocking(true).unwrap();
        let mut datagram = [0; 256];
        let lengths = std::iter::from_fn(|| Some((socket.recv(&mut datagram).ok()?, datagram)));
        lengths.map(|(length, datagram)| Packet::decode(&datagram[..length]).unwrap()).collect()
    }

    fn seen(socket: &UdpSocket) -> Vec<(State, Reason)> {
        packets(socket).iter().map(|packet| (packet.state, packet.reason)).collect()
    }

    /// A sender on the clock of the test, and where the test leaves its news.
    struct Clocked {
        sender: Sender,
        news: triple_buffer::Input<News>,
        history: History,
        now_us: u64,
    }

    impl Clocked {
        fn new(settings: &Settings) -> Self {
            let counters = Arc::<Counters>::default();
            let links = Links::change(settings, Vec::new(), &counters.traffic).unwrap();
            let (news, heard) = triple_buffer::triple_buffer(&Err(Reason::NoCamera));
            let changes = mpsc::channel().1;
            let puppet = triple_buffer::triple_buffer(&None).1;
            let shown = observer::channel().0;
            let sender = Sender { links, changes, news: heard, puppet, shown, counters };
            Self { sender, news, history: History::default(), now_us: 1_000_000 }
        }

        /// Lets time pass, in which the sender sleeps as long as it wants to.
        fn pass(&mut self, time_us: u64) {
            let end_us = self.now_us + time_us;
            while self.now_us < end_us {
                let wait_us = self.sender.step(&mut self.history, self.now_us);
                self.now_us = end_us.min(self.now_us + wait_us);
            }
        }

        /// Shows a face whose jaw is open for a second.
        fn live(&mut self) {
            (0..30).for_each(|_| self.frame(1.0));
        }

        fn frame(&mut self, jaw: f32) {
            let mut pose = Pose::NEUTRAL;
            pose.coefficients[17] = jaw;
            self.news.write(Ok((pose, self.now_us)));
            self.pass(33_333);
        }
    }

    #[test]
    fn without_a_camera_each_receiver_gets_10_neutral_faces_a_second() {
        let receivers = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        let mut clocked = Clocked::new(&settings([&receivers[0], &receivers[1]]));
        clocked.pass(2_000_000);
        for receiver in &receivers {
            assert_eq!(seen(receiver), [(State::Neutral, Reason::NoCamera); 20]);
        }
    }

    #[test]
    fn the_longest_stop_is_shorter_than_systemd_waits() {
        let unit = include_str!("../../systemd/facewire.service");
        let seconds = unit.lines().find_map(|line| line.strip_prefix("TimeoutStopSec=")?.strip_suffix('s')).unwrap();
        let patience = Duration::from_secs(seconds.parse().unwrap());
        let to_neutral = Duration::from_micros(LONGEST_STOP_US) + Duration::from_secs(1) / 10;
        let sender = to_neutral + 3 * STOPPING_PERIOD + LAST_PACKET;
        // The patience with the hot loop begins with that of the sender.
        assert!(sender.max(HOT_PATIENCE) + DISK_PATIENCE < patience, "{sender:?}");
    }

    #[test]
    fn a_sender_that_stops_takes_half_a_second_at_most_for_the_way_to_neutral_and_sends_neutral_three_times() {
        // The jaw is closed after 250 ms, and after 10 s, if it has the time. A frame period of that has passed already.
        for (slew_per_s, want_us) in [(4.0, 210_000..270_000), (0.1, 500_000..520_000)] {
            let receivers = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
            let mut settings = settings([&receivers[0], &receivers[1]]);
            settings.failsafe.slew_per_s = slew_per_s;
            let mut clocked = Clocked::new(&settings);
            clocked.live();
            assert_eq!(packets(&receivers[0]).last().unwrap().state, State::Live);
            let begun_us = clocked.now_us;
            let after = |time: Duration| {
                clocked.now_us += u64::try_from(time.as_micros()).unwrap();
                clocked.now_us
            };
            clocked.sender.stop(&mut clocked.history, after);
            let took_us = clocked.now_us - begun_us - 3 * 25_000;
            assert!(want_us.contains(&took_us), "{took_us}");
            let stopped = packets(&receivers[0]);
            assert!(stopped.iter().all(|packet| packet.reason == Reason::Stopping), "{stopped:?}");
            let (way, last) = stopped.split_at(stopped.len() - 3);
            assert!(way.iter().all(|packet| packet.state == State::Decay), "{way:?}");
            assert!(last.iter().all(|packet| packet.state == State::Neutral && packet.coefficients == [0.0; 52]));
            assert!(
                last.windows(2).all(|pair| pair[1].age_us == pair[0].age_us + 25_000),
                "ages of their own: {last:?}"
            );
        }
    }

    /// A sender of servos whose board is away, and whose hot loop is stuck.
    #[test]
    fn servos_are_released_within_100_ms_and_a_puppet_that_falls_silent_gives_the_face_back() {
        let link =
            "[[link]]\nkind = \"maestro\"\ndevice = \"/dev/away\"\n[[link.channel]]\nsources = { jawOpen = 1.0 }\n";
        let settings = config::parse("test", link).unwrap();
        let counters = Arc::<Counters>::default();
        let links = Links::change(&settings, Vec::new(), &counters.traffic).unwrap();
        let panel = links.panels().remove(0);
        let operator = Arc::clone(&counters.traffic.operator);
        let (_stuck, news) = triple_buffer::triple_buffer(&Err(Reason::NoCamera));
        let (mut played, puppet) = triple_buffer::triple_buffer(&None);
        let (reload, changes) = mpsc::channel();
        let (shown, mut watched) = observer::channel();
        let mut sender = Sender { links, changes, news, puppet, shown, counters: Arc::clone(&counters) };
        let mut history = History::default();
        for is_released in [true, false].into_iter().cycle().take(21) {
            operator.is_released.store(is_released, Relaxed);
            sender.step(&mut history, monotonic_us());
            assert_eq!(operator.released_at_links.load(Relaxed), is_released, "the next round obeys");
            eventually("the servo obeys", || panel.dials.channels[0].place.get().is_none() == is_released);
        }
        const { assert!(MAX_SLEEP_US <= 100_000, "even if nothing wakes the sender, the next round begins in time") };
        let sender = thread::spawn(|| sender.run());

        watched.ask(true);
        let mut pose = Pose::NEUTRAL;
        pose.coefficients[17] = 0.5;
        played.write(Some(pose));
        let mut until = |want: (State, f32), keeps_on: bool| {
            while !watched.newest().is_some_and(|packet| (packet.state, packet.coefficients[17]) == want) {
                let until_us = if keeps_on { monotonic_us() + 400_000 } else { operator.driven_until_us.load(Relaxed) };
                operator.driven_until_us.store(until_us, Relaxed);
                thread::yield_now();
            }
        };
        until((State::Live, 0.5), true);
        assert_eq!(panel.dials.channels[0].place.get(), None, "nothing wins over a release");
        let other = config::parse("test", &link.replace("away", "gone")).unwrap();
        let links = Links::change(&other, Vec::new(), &counters.traffic).unwrap();
        let reloaded = links.panels().remove(0);
        reload.send(links).unwrap();
        eventually("three dropped packets of the new link", || reloaded.dropped.load(Relaxed) >= 3);
        assert_eq!(reloaded.dials.channels[0].place.get(), None, "nor does a reload");
        until((State::Neutral, 0.0), false);
        assert!(!operator.is_driven.load(Relaxed));
        operator.is_released.store(false, Relaxed);
        eventually("the servo gets pulses", || reloaded.dials.channels[0].place.get().is_some());
        counters.stop();
        sender.join().unwrap();
    }

    #[test]
    fn servos_go_on_where_they_are_when_a_reload_changes_their_ends() {
        let node = UdpSocket::bind("127.0.0.1:0").unwrap();
        node.set_nonblocking(true).unwrap();
        let settings = |pulse_at_1_us| {
            let address = node.local_addr().unwrap();
            let toml = format!(
                "[[link]]\nkind = \"artnet\"\naddress = \"{address}\"\n[[link.channel]]\nchannel = 1\nspeed_per_s = 100\n\
                 sources = {{ jawOpen = 1 }}\npulse_at_1_us = {pulse_at_1_us}\n"
            );
            config::parse("test", &toml).unwrap()
        };
        let values = || {
            let mut datagram = [0; 600];
            std::iter::from_fn(|| node.recv(&mut datagram).ok().map(|_| datagram[18])).collect::<Vec<_>>()
        };
        let mut clocked = Clocked::new(&settings(2000));
        eventually("an open jaw", || {
            clocked.live();
            values().last() == Some(&255)
        });
        let change =
            Links::change(&settings(1900), clocked.sender.links.panels(), &clocked.sender.counters.traffic).unwrap();
        let old = std::mem::replace(&mut clocked.sender.links, change);
        clocked.sender.links.take_over(old, &clocked.history.last());
        clocked.live();
        let shown = values();
        assert!(shown.iter().all(|value| (229..=230).contains(value)), "neither at rest nor beyond its end: {shown:?}");
    }

    #[test]
    fn a_source_of_sacn_is_announced_every_ten_seconds_also_after_a_reload_that_keeps_it_until_its_stream_ends() {
        let node = UdpSocket::bind("127.0.0.1:0").unwrap();
        node.set_nonblocking(true).unwrap();
        let address = node.local_addr().unwrap();
        let link = format!("[[link]]\nkind = \"sacn\"\naddress = \"{address}\"\nstop = \"end\"\n");
        let other = "[[link]]\nkind = \"sacn\"\naddress = \"127.0.0.1:9\"\n";
        let settings = config::parse("test", &link).unwrap();
        let mut clocked = Clocked::new(&settings);
        // Returns how many values the node gets while the face moves for these seconds, and how many announcements of one universe.
        let seconds = |clocked: &mut Clocked, count: u64| {
            let mut datagram = [0; 1024];
            let mut got = [0; 2];
            for _ in 0..count {
                (0..30_u8).for_each(|frame| clocked.frame(f32::from(frame % 2)));
                let lengths = std::iter::from_fn(|| node.recv(&mut datagram).ok());
                lengths.for_each(|length| got[usize::from(length == 122)] += 1);
            }
            (got[0] > 0, got[1])
        };
        assert_eq!([1, 8, 2, 10].map(|count| seconds(&mut clocked, count).1), [1, 0, 1, 1]);
        let reloaded = config::parse("test", &(other.to_owned() + &link)).unwrap();
        let counters = &clocked.sender.counters;
        let change = Links::change(&reloaded, clocked.sender.links.panels(), &counters.traffic).unwrap();
        let old = std::mem::replace(&mut clocked.sender.links, change);
        clocked.sender.links.take_over(old, &Output::NEUTRAL);
        assert_eq!(seconds(&mut clocked, 25), (true, 3), "also at once after a reload");
        clocked.sender.counters.traffic.operator.is_released.store(true, Relaxed);
        seconds(&mut clocked, 1);
        assert_eq!(seconds(&mut clocked, 20), (false, 0));
    }

    #[test]
    fn the_receiver_of_a_link_that_a_reload_removes_is_shown_the_neutral_face_last_and_no_other_is() {
        let [old, kept, new] = [(); 3].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        let before = settings([&old, &kept]);
        let after = settings([&kept, &new]);
        let mut links = Links::change(&before, Vec::new(), &Arc::default()).unwrap();
        links.send_last(&test_output(State::Live));
        let mut change = Links::change(&after, links.panels(), &Arc::default()).unwrap();
        change.take_over(links, &Output { reason: Reason::Stopping, ..test_output(State::Neutral) });
        change.send_last(&test_output(State::Hold));
        let live = (State::Live, Reason::None);
        let hold = (State::Hold, Reason::NoFace);
        let neutral = (State::Neutral, Reason::Stopping);
        assert_eq!(seen(&old), [live, neutral, neutral, neutral]);
        assert_eq!((seen(&kept), seen(&new)), (vec![live, hold], vec![hold]));
    }
}
