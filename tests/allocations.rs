//! Between a frame and its packet, nothing is allocated on the Rust heap.
//!
//! The tests count every allocation of the thread that processes the frames, and none of other threads. They do not see the
//! allocations of C code: `tests/memory.rs` counts those of the running service.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use allocation_counter::{AllocationInfo, measure};
use common::film::{empty_y4m, read_y4m};
use common::service::Receiver;
use facewire::calibration::Observation;
use facewire::capture::{Clip, Source};
use facewire::config::{self, LinkKind, LinkSettings};
use facewire::link::{Link, Output, Rates, Traffic, announcement};
use facewire::pipeline::Pipeline;
use facewire::service::failsafe::{Failsafe, History, News};
use facewire::watch::Watch;
use facewire_packet::{Pose, Reason, State};

const RATES: Rates = Rates { send_hz: 60, slew_per_s: 4.0 };
const WARM_UP: usize = 20;

struct Way {
    pipeline: Pipeline,
    failsafe: Failsafe,
    history: History,
    link: Link,
    settings: LinkSettings,
    traffic: Arc<Traffic>,
    watch: Watch,
    observations: triple_buffer::Input<Observation>,
    live: usize,
    /// Keeps the receiver's port open.
    _receiver: Receiver,
}

impl Way {
    fn new(toml: &str) -> Self {
        let receiver = Receiver::new();
        let link = format!("{toml}[[link]]\naddress = \"{}\"\n", receiver.address());
        let settings = config::parse("test", &link).unwrap();
        let traffic = Arc::<Traffic>::default();
        Self {
            pipeline: Pipeline::load(&settings, true).unwrap_or_else(|error| panic!("{error}")),
            failsafe: Failsafe::new(&settings.failsafe, 33_333),
            history: History::default(),
            link: Link::open(&settings.links[0], &traffic).unwrap(),
            settings: settings.links[0].clone(),
            traffic,
            watch: Watch::new(3_000_000),
            observations: triple_buffer::triple_buffer(&Observation::nothing(0)).0,
            live: 0,
            _receiver: receiver,
        }
    }

    /// Takes one frame from its source to its packet, with the calls that the service makes.
    fn frame(&mut self, source: &mut dyn Source) {
        let frame = source.next().unwrap().unwrap();
        let (processed, now_us) = (self.pipeline.process(&frame), frame.captured_us + 10_000);
        let news: News = processed.pose().map(|pose| (pose, frame.captured_us));
        let output = self.failsafe.update(&mut self.history, now_us, Some(&news));
        self.link.offer(&self.settings, RATES, now_us, &output);
        self.watch.frame(&frame, processed.face, false);
        // The service observes frames only while a calibration runs.
        self.observations.write(processed.observe(false));
        self.live += usize::from(output.state == State::Live);
    }

    fn allocated(&mut self, source: &mut dyn Source, frames: usize) -> AllocationInfo {
        self.live = 0;
        measure(|| (0..frames).for_each(|_| self.frame(source)))
    }
}

/// The clip has fewer frames than the test plays, so it starts over in between.
#[test]
fn frames_allocate_nothing_whether_the_face_is_followed_found_again_or_away() {
    for method in ["network", "paper"] {
        let mut way = Way::new(&format!("[solver]\nmethod = \"{method}\"\n"));
        let mut clip = Clip::looped().unwrap();
        way.allocated(&mut clip, WARM_UP);
        assert_eq!(way.allocated(&mut clip, 230), AllocationInfo::default(), "{method}");
        // The link sends a neutral packet for the first pose and nothing for the next two. The face is live from the fourth on.
        assert_eq!((way.live, way.traffic.sent.load(Relaxed)), (230, 248));
        for _ in 0..5 {
            way.pipeline.forget_face();
            assert_eq!(way.allocated(&mut clip, 1), AllocationInfo::default(), "the detector finds the face again");
        }
    }
    // The detector runs on each of these frames, and the failsafe sends a neutral face.
    let (mut way, stream) = (Way::new(""), empty_y4m(WARM_UP + 40));
    let mut empty = read_y4m(&stream[..]);
    way.allocated(&mut empty, WARM_UP);
    assert_eq!(way.allocated(&mut empty, 40), AllocationInfo::default());
    let sent = way.traffic.sent.load(Relaxed);
    assert!(way.live == 0 && (15..=20).contains(&sent), "10 packets per second in 2 s: {sent}");
}

#[test]
fn frames_of_a_covered_face_allocate_nothing() {
    for wears in ["headset", "mask"] {
        let mut way = Way::new(&format!("[wearer]\nwears = \"{wears}\"\n"));
        let mut clip = Clip::looped().unwrap();
        way.allocated(&mut clip, WARM_UP);
        assert_eq!(way.allocated(&mut clip, 60), AllocationInfo::default(), "{wears}");
        assert_eq!(way.live, 60, "{wears}");
    }
}

/// The settings of a link of this kind that sends all that it can, and whose receiver is away. What is sent to it is
/// encoded all the same.
fn link_to_nobody(kind: &str) -> LinkSettings {
    let default = config::default_link(kind).unwrap();
    let keys = match kind {
        "live-link" => "swap_mouth = true\n",
        "vrchat" => "bits = 8\nnative_eyes = true\n",
        "ifacialmocap" => "listen = \"\"\naddress = \"127.0.0.1:9\"\n",
        "sacn" => "address = \"127.0.0.1:9\"\n",
        "json" => "to = \"udp:127.0.0.1:9\"\n",
        _ if default.contains("\ndevice = ") => "device = \"/dev/away\"\n",
        _ => "",
    };
    let channel =
        if default.contains("\n[[link.channel]]") { "[[link.channel]]\nsources = { jawOpen = 1.0 }\n" } else { "" };
    let link = format!("[[link]]\nkind = \"{kind}\"\npace = \"rate\"\nrate_hz = 60\n{keys}{channel}");
    config::parse(kind, &link).unwrap_or_else(|faults| panic!("{faults}")).links.remove(0)
}

fn moving_face(number: u16) -> Output {
    let mut pose = Pose::NEUTRAL;
    let phase = f32::from(number) * 0.1;
    for (index, value) in (0_u8..).zip(&mut pose.coefficients) {
        *value = 0.5 + 0.5 * (phase + f32::from(index)).sin();
    }
    let (sin, cos) = (0.3 * phase.sin()).sin_cos();
    pose.rotation = [0.0, sin, 0.0, cos];
    let (state, reason) = match number % 40 {
        0..20 => (State::Live, Reason::None),
        20..25 => (State::Hold, Reason::NoFace),
        25..30 => (State::Decay, Reason::NoFace),
        _ => (State::Neutral, Reason::NoFace),
    };
    let (age_us, capture_us) = (20_000, u64::from(number) * 16_667);
    Output {
        state,
        reason,
        pose,
        age_us,
        capture_us,
        followed: state == State::Live,
        moving: state == State::Decay,
        is_puppet: false,
    }
}

#[test]
fn links_of_every_kind_allocate_nothing_on_the_senders_thread() {
    for kind in LinkKind::NAMES {
        let (settings, traffic) = (link_to_nobody(kind), Arc::<Traffic>::default());
        let mut link = Link::open(&settings, &traffic).unwrap();
        let mut announcement = announcement(std::slice::from_ref(&settings), 0);
        let mut send = |numbers: std::ops::Range<u16>| {
            for number in numbers {
                let now_us = u64::from(number) * 16_667;
                link.offer(&settings, RATES, now_us, &moving_face(number));
                // The first one is measured, too.
                for announcement in announcement.iter_mut().filter(|_| number >= 40) {
                    link.announce(announcement, now_us);
                }
            }
        };
        send(0..40);
        let allocated = measure(|| send(40..240));
        assert_eq!(allocated, AllocationInfo::default(), "{kind}");
        assert!(traffic.packets.load(Relaxed) >= 200, "{kind}: {traffic:?}");
    }
}
