use std::fs::{self, Permissions};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::UnixStream;
use std::thread;
use std::time::Instant;

use base64::{Engine as _, prelude::BASE64_STANDARD};
use facewire_face::{Landmarks, Picture, Pixels, Profile, Wears};
use facewire_packet::control::{ChannelStatus, Drive, Phase, PictureFormat, PictureHead, Progress, Refusal};
use facewire_packet::{Reason, State, yaw_pitch_roll_deg};
use tempfile::TempDir;
use triple_buffer::{Output as Newest, triple_buffer};

use super::super::observer::{self, Observer};
use super::super::picture;
use super::calibrate::Guiding;
use super::*;
use crate::calibration::test_wearer::{blank_model_file, pose};
use crate::calibration::{Guide, Seen, Take, model_hash};
use crate::capture::{Content, Frame};
use crate::config;
use crate::link::{Panel, test_output, testing::eventually};
use crate::pipeline::load_model;
use crate::service::sender::Links;
use facewire_servo::Board;

/// What the control thread works with, and what a hot loop and a supervisor would hold.
struct Rig {
    folder: TempDir,
    server: Server,
    stop: PipeWriter,
    observer: Observer<Observation>,
    recorder: Observer<Recorded>,
    told: mpsc::Receiver<HotChange>,
    adopt: mpsc::Sender<(Settings, Option<u32>)>,
    shown: Observer<Packet>,
    reloads: mpsc::Receiver<mpsc::Sender<Reply>>,
    played: Newest<Option<Pose>>,
    copier: picture::Copier,
}

impl Rig {
    /// The model reads nothing in the landmarks.
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("model.toml"), toml::to_string(&blank_model_file()).unwrap()).unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let mut settings = Settings::default();
        settings.wearer.folder = path("profiles");
        settings.solver.model = path("model.toml");
        let (observer, observed) = observer::channel();
        let (recorder, recorded) = observer::channel();
        let (to_hot, told) = mpsc::channel();
        let (adopt, changes) = mpsc::channel();
        let (shown, watched) = observer::channel();
        let (reload, reloads) = mpsc::channel();
        let hot = Arc::new(Mailbox { changes: to_hot, thread: thread::current() });
        let path = folder.path().join("run/control");
        let (pictures, copier) = picture::channel();
        let (puppet, played) = triple_buffer(&None);
        let sender = thread::current();
        let counters = Arc::default();
        let loader = Loader::start("fw-load").unwrap();
        let keeper = Loader::start("fw-keep").unwrap();
        let kept = Kept::inside(folder.path().join("state"), None);
        let peers = Peers {
            changes,
            observed,
            recorded,
            watched,
            hot,
            sender,
            puppet,
            reload,
            pictures,
            loader,
            keeper,
            counters,
            // No disk and no other load ends it. Tests of its end set none.
            release_patience: Duration::from_mins(1),
        };
        let (server, stop) = Server::new(Some(path), settings, None, kept, peers).unwrap();
        Self { folder, server, stop, observer, recorder, told, adopt, shown, reloads, played, copier }
    }

    /// Asks, and lets the disk do what is asked of it.
    fn ask(&mut self, request: Request) -> Answers {
        let answers = self.begin(request);
        self.settle();
        answers
    }

    fn begin(&mut self, request: Request) -> Answers {
        let (client, mut far) = client();
        writeln!(far, "{}", serde_json::to_string(&request).unwrap()).unwrap();
        self.server.clients.push_back((client, Task::Ask));
        self.server.serve();
        Answers::of(far)
    }

    /// Releases all servos, and waits for the answer, while the disk may do nothing.
    fn release(&mut self) -> Option<Reply> {
        let mut answers = self.begin(Request::Release { on: true });
        let mut answer = None;
        eventually("an answer", || {
            self.server.serve();
            answer = answers.next();
            answer.is_some()
        });
        answer
    }

    fn settle(&mut self) {
        let Peers { loader, keeper, .. } = &self.server.peers;
        [loader, keeper].iter().for_each(|disk| disk.load(|| ()).unwrap());
        self.server.serve();
    }

    fn refused(&mut self, request: Request) -> String {
        match self.ask(request).next() {
            Some(Reply::Refused(why)) => why,
            reply => panic!("{reply:?}"),
        }
    }

    fn show(&mut self, time_us: u64, sight: Result<Seen, Refusal>) {
        self.observer.publish(|| Observation { time_us, sight });
        self.server.serve();
    }

    /// Begins a calibration, and shows it that there is no face.
    fn calibrate(&mut self, name: &str) -> Answers {
        let mut answers = self.ask(calibrate(name));
        self.show(1, Err(Refusal::NoFace));
        assert!(matches!(answers.next(), Some(Reply::Progress(_))));
        answers
    }

    fn reload(&mut self, change: impl Fn(&mut Settings)) {
        let mut settings = self.server.settings.clone();
        change(&mut settings);
        let model = model_hash(&load_model(&settings.solver).unwrap());
        self.adopt.send((settings, Some(model))).unwrap();
        self.server.adopt();
        self.server.serve();
    }
}

fn calibrate(name: &str) -> Request {
    Request::Calibrate { wearer: Some(name.to_owned()) }
}

fn client() -> (Client, UnixStream) {
    let (near, far) = UnixStream::pair().unwrap();
    [&near, &far].into_iter().for_each(|end| end.set_nonblocking(true).unwrap());
    (Client::new(OwnedFd::from(near).into(), Speaks::Requests), far)
}

struct Answers {
    lines: BufReader<UnixStream>,
    /// What has come of the next line.
    line: String,
    lost: Option<u64>,
}

impl Answers {
    fn of(stream: UnixStream) -> Self {
        Self { lines: BufReader::new(stream), line: String::new(), lost: None }
    }

    /// Returns the next answer, if one has come.
    fn next(&mut self) -> Option<Reply> {
        self.lines.read_line(&mut self.line).ok().filter(|length| *length > 0)?;
        Some(serde_json::from_str(&std::mem::take(&mut self.line)).unwrap())
    }

    /// Returns the next entry of a recording, and keeps how many frames were lost.
    fn entry(&mut self) -> Option<Recorded> {
        match self.next()? {
            Reply::Frame(text) => Recorded::from_bytes(&BASE64_STANDARD.decode(text).unwrap()),
            Reply::Lost(lost) => {
                self.lost = Some(lost);
                self.entry()
            }
            reply => panic!("{reply:?}"),
        }
    }
}

/// Shows the poses that are asked for, until the guide has seen enough.
fn follow(rig: &mut Rig, answers: &mut Answers) {
    let mut take = Take::Neutral;
    for time_us in (1..1000).map(|number| number * 200_000) {
        rig.show(time_us, pose(take, 0.8));
        // Progress that changes more than the bars, as each new take does, is sent at once.
        while let Some(reply) = answers.next() {
            match reply {
                Reply::Progress(Progress { phase: Phase::Ended, .. }) => return,
                Reply::Progress(progress) => take = progress.take,
                reply => panic!("{reply:?}"),
            }
        }
    }
}

#[test]
fn wearer_who_follows_has_a_profile_that_the_hot_loop_uses() {
    let mut rig = Rig::new();
    let mut answers = rig.calibrate("anna");
    follow(&mut rig, &mut answers);
    rig.server.serve();
    rig.settle();
    let Some(Reply::Calibrated(kept)) = answers.next() else { panic!("no profile") };
    assert_eq!((kept.wearer.as_str(), kept.taken.len()), ("anna", Take::ALL.len()), "{kept:?}");
    let profile = rig.told.recv().unwrap().profile.unwrap();
    assert!(profile.neutral.is_some() && fs::read_to_string(&kept.path).unwrap().contains("jawOpen"));
    let Some(Reply::Wearers { wearers, in_use, .. }) = rig.ask(Request::List {}).next() else { panic!("no list") };
    assert_eq!((wearers.len(), in_use.as_deref()), (1, Some("anna")));

    let warns = |rig: &mut Rig| match rig.ask(Request::Use { wearer: Some("anna".to_owned()) }).next() {
        Some(Reply::Done(text)) => text.contains("another blendshape model"),
        reply => panic!("{reply:?}"),
    };
    assert!(!warns(&mut rig));
    rig.reload(|settings| settings.solver.model = String::new());
    assert!(warns(&mut rig));
}

#[test]
fn a_disk_that_takes_a_profile_slowly_holds_up_no_release() {
    let mut rig = Rig::new();
    let mut answers = rig.calibrate("anna");
    let (disk, waits) = mpsc::channel::<()>();
    rig.server.peers.loader.begin(move || waits.recv());
    follow(&mut rig, &mut answers);
    let mut list = rig.begin(Request::List {});
    let mut release = rig.begin(Request::Release { on: true });
    rig.server.peers.counters.traffic.operator.released_at_links.store(true, Relaxed);
    rig.server.peers.keeper.load(|| ()).unwrap();
    rig.server.serve();
    assert!(matches!(release.next(), Some(Reply::Done(_))) && answers.next().is_none() && list.next().is_none());
    assert!(rig.begin(calibrate("bert")).next().is_some_and(|reply| matches!(reply, Reply::Refused(_))));
    drop(disk);
    rig.settle();
    assert!(matches!(answers.next(), Some(Reply::Calibrated(_))));
    assert!(matches!(list.next(), Some(Reply::Wearers { wearers, .. }) if wearers.len() == 1));
}

#[test]
fn a_release_names_boards_that_have_not_acknowledged_it_and_those_that_cannot() {
    let mut rig = Rig::new();
    let jaw = "[[link.channel]]\nchannel = 1\nsources = { jawOpen = 1 }\n";
    let links = ["kind = \"maestro\"\ndevice = \"/dev/away\"", "kind = \"artnet\"\naddress = \"127.0.0.1:9\""];
    let toml: String = links.iter().map(|link| format!("[[link]]\n{link}\n{jaw}")).collect();
    let settings = config::parse("test", &toml).unwrap();
    let links = Links::change(&settings, Vec::new(), &rig.server.peers.counters.traffic).unwrap();
    let [away, node] = links.panels().try_into().unwrap();
    rig.server.peers.counters.set_panels(links.panels());
    rig.server.peers.release_patience = Duration::ZERO;
    let Some(Reply::Refused(stuck)) = rig.release() else { panic!("nobody has told the links") };
    assert!(stuck.contains("stuck"), "{stuck}");
    rig.server.peers.counters.traffic.operator.released_at_links.store(true, Relaxed);
    node.dials.note_released(true);
    let Some(Reply::Refused(missed)) = rig.release() else { panic!("a board is away") };
    assert!(
        missed.contains("maestro /dev/away") && missed.contains("supply") && !missed.contains("artnet"),
        "{missed}"
    );
    rig.server.peers.release_patience = Duration::from_secs(1);
    eventually("a release that both have acknowledged", || {
        // The thread of its link finds no device now and then, and takes this back.
        away.dials.note_released(true);
        let Some(Reply::Done(done)) = rig.release() else { return false };
        done.starts_with("servos get no pulses. artnet 127.0.0.1:9, universe 0")
            && done.ends_with(": they hold their last values, with power; the board cannot confirm it")
    });
}

#[test]
fn a_release_that_the_disk_does_not_keep_is_done_and_says_so() {
    let mut rig = Rig::new();
    fs::write(rig.folder.path().join("state"), "no folder").unwrap();
    rig.server.peers.counters.traffic.operator.released_at_links.store(true, Relaxed);
    let mut answers = rig.ask(Request::Release { on: true });
    let Some(Reply::Done(done)) = answers.next() else { panic!("nothing moves") };
    assert!(done.starts_with("servos get no pulses. After a restart the service will not know"), "{done}");
    let mut not_kept = || match rig.ask(Request::Status {}).next() {
        Some(Reply::Status(status)) => status.release_not_kept,
        _ => panic!("no state"),
    };
    assert!(not_kept().is_some_and(|trouble| done.ends_with(&trouble)));
    let (disk, waits) = mpsc::channel::<()>();
    rig.server.peers.keeper.begin(move || waits.recv());
    rig.server.peers.release_patience = Duration::ZERO;
    let answer = rig.release();
    assert!(matches!(answer, Some(Reply::Done(done)) if done.contains("not kept this yet")));
    drop(disk);
}

#[test]
fn of_two_who_release_servos_and_let_them_move_at_once_the_first_is_told_of_the_second() {
    for on in [true, false] {
        let mut rig = Rig::new();
        rig.server.peers.counters.traffic.operator.released_at_links.store(!on, Relaxed);
        let mut first = rig.begin(Request::Release { on });
        let _second = rig.begin(Request::Release { on: !on });
        rig.server.serve();
        let answer = first.next();
        assert!(matches!(&answer, Some(Reply::Refused(why)) if why.contains("meanwhile")), "{on}: {answer:?}");
    }
}

#[test]
fn a_client_finds_a_place_beside_any_number_of_those_who_ask_nothing_but_none_beside_those_who_wait() {
    let mut rig = Rig::new();
    let far: Vec<_> = (0..MAX_CLIENTS)
        .map(|_| client())
        .map(|(client, far)| {
            rig.server.clients.push_back((client, Task::Ask));
            far
        })
        .collect();
    rig.server.make_room(Speaks::Requests);
    assert_eq!(rig.server.clients.len(), MAX_CLIENTS - 1);
    assert_eq!((&far[0]).read(&mut [0]).unwrap(), 0, "the first one makes room");
    rig.server.clients.iter_mut().for_each(|(_, task)| *task = Task::Watch);
    let (client, _far) = client();
    rig.server.clients.push_back((client, Task::Watch));
    rig.server.make_room(Speaks::Requests);
    assert_eq!(rig.server.clients.len(), MAX_CLIENTS);
}

#[test]
fn stop_ends_a_calibration_at_once_and_removes_the_socket() {
    for (folder_mode, mode) in [(None, 0o600), (Some(0o710), 0o660), (Some(0o755), 0o600)] {
        let mut rig = Rig::new();
        let run = rig.folder.path().join("run");
        let made = |mode| fs::create_dir(&run).and_then(|()| fs::set_permissions(&run, Permissions::from_mode(mode)));
        folder_mode.iter().for_each(|mode| made(*mode).unwrap());
        let _answers = rig.calibrate("anna");
        let socket = run.join("control");
        let control = rig.server.start().unwrap();
        let mode_of = |path: &std::path::Path| fs::metadata(path).map(|file| file.permissions().mode() & 0o777).ok();
        eventually("the mode of the socket", || mode_of(&socket) == Some(mode));
        let of_folder = folder_mode.or(Some(0o700));
        assert_eq!(mode_of(&run), of_folder, "it belongs to its user, and to a group if that is set up");
        drop(rig.stop);
        control.join().unwrap();
        rig.observer.publish(|| panic!("nobody wants observations any more"));
        assert!(!socket.exists() && !rig.folder.path().join("profiles").exists(), "nothing was kept");
    }
}

#[test]
fn second_calibration_is_refused_and_a_client_that_vanishes_cancels_its_own() {
    let mut rig = Rig::new();
    let answers = rig.calibrate("anna");
    assert!(rig.refused(calibrate("bert")).contains("in progress"));
    drop(answers);
    rig.server.serve();
    rig.calibrate("bert");
}

#[test]
fn calibration_ends_when_the_model_or_what_the_wearer_has_on_changes_and_not_at_any_other_reload() {
    let changes: [(fn(&mut Settings), _); 2] = [
        (|settings| settings.solver.model = String::new(), "model has changed"),
        (|settings| settings.wearer.wears = Wears::Headset, "wearer.wears has changed"),
    ];
    for (change, reason) in changes {
        let mut rig = Rig::new();
        let mut answers = rig.calibrate("anna");
        rig.reload(|settings| settings.camera.fps = 60);
        assert!(rig.server.is_any(|task| matches!(task, Task::Calibrate(..))));
        rig.reload(change);
        assert!(matches!(answers.next(), Some(Reply::Refused(why)) if why.contains(reason)));
        assert!(rig.server.clients.is_empty() && !rig.folder.path().join("profiles").exists(), "nothing was kept");
    }
}

#[test]
fn client_that_records_gets_every_frame_beside_a_calibration_and_a_second_one_is_refused() {
    let mut rig = Rig::new();
    let mut recording = rig.ask(Request::Record {});
    let _answers = rig.calibrate("anna");
    (1..=3).for_each(|time_us| rig.recorder.publish(|| Recorded::nothing(time_us, Reason::NoFace)));
    rig.server.serve();
    assert!(std::iter::from_fn(|| recording.entry()).map(|entry| entry.time_us).eq([1, 2, 3]));
    assert!(rig.refused(Request::Record {}).contains("in progress"));
    drop(recording);
    rig.server.serve();
    let tasks: Vec<_> = rig.server.clients.iter().map(|(_, task)| task).collect();
    assert!(matches!(*tasks, [Task::Calibrate(..)]), "the calibration goes on");
}

/// A recording, its client, the ring of its frames, and the far end of its client.
fn recording() -> (Recording, Client, Observer<Recorded>, Observed<Recorded>, Answers) {
    let (client, far) = client();
    let (observer, mut observed) = observer::channel();
    observed.ask(true);
    (Recording::default(), client, observer, observed, Answers::of(far))
}

#[test]
fn frames_that_nobody_fetched_in_time_or_that_a_client_does_not_read_are_lost_and_told_and_hold_no_memory() {
    let (mut recording, mut client, mut observer, mut observed, mut answers) = recording();
    let mut publish = || (0..40).for_each(|time_us| observer.publish(|| Recorded::nothing(time_us, Reason::NoFace)));
    assert_eq!(allocation_counter::measure(&mut publish), allocation_counter::AllocationInfo::default());
    recording.step(&mut client, &mut observed, true, 1).unwrap();
    let mut entries = std::iter::from_fn(|| answers.entry()).count() as u64;
    assert_eq!((answers.lost.take(), entries), (Some(8), 32));
    for time_us in 40..10_000 {
        observer.publish(|| Recorded::nothing(time_us, Reason::NoFace));
        recording.step(&mut client, &mut observed, true, time_us).unwrap();
    }
    assert!(recording.refused > 0);
    while answers.lost.is_none() {
        entries += u64::from(answers.entry().is_some());
        client.flush().unwrap();
        recording.step(&mut client, &mut observed, true, 10_000).unwrap();
    }
    assert_eq!(answers.lost, Some(10_000 - entries));
}

#[test]
fn entries_without_a_camera_have_the_clock_of_the_frames_and_none_lies_between_those_of_a_slow_camera() {
    let (mut recording, mut client, mut observer, mut observed, mut answers) = recording();
    let second = 1_000_000;
    for (captured_us, is_camera_open, now_us) in [
        // A camera with one frame a second, each of which comes 0.2 s after its capture.
        (Some(second), true, 1_200_000),
        (None, true, 2_199_000),
        (Some(2 * second), true, 2_250_000),
        (None, true, 3_300_000),
        // It is unplugged, and later a frame comes that was captured before the last entry was made.
        (None, false, 4_300_000),
        (Some(4_040_000), true, 4_310_000),
    ] {
        captured_us.iter().for_each(|us| observer.publish(|| Recorded::nothing(*us, Reason::NoFace)));
        recording.step(&mut client, &mut observed, is_camera_open, now_us).unwrap();
    }
    let entries = std::iter::from_fn(|| answers.entry()).map(|entry| (entry.time_us, entry.pose.unwrap_err()));
    let face = Reason::NoFace;
    let camera = Reason::NoCamera;
    let want = [(second, face), (2 * second, face), (2 * second + 2_050_000, camera), (2 * second + 2_050_001, face)];
    assert_eq!(entries.collect::<Vec<_>>(), want);
    assert_eq!(answers.lost, Some(0), "the client hears from the service");
}

#[test]
fn watchers_are_shown_the_newest_packet_and_one_that_does_not_read_holds_up_no_other() {
    let mut rig = Rig::new();
    rig.shown.publish(|| panic!("nobody watches"));
    let mut first = rig.ask(Request::Watch {});
    let slow = rig.ask(Request::Watch {});
    let mut seen = Vec::new();
    for sequence in 0..4000 {
        rig.shown.publish(|| Packet { sequence: 1, ..Packet::NEUTRAL });
        rig.shown.publish(|| Packet { sequence, ..Packet::NEUTRAL });
        rig.server.shown = Shown::default();
        rig.server.serve();
        let Some(Reply::Packet(bytes)) = first.next() else { panic!("{sequence}: no packet") };
        seen.push(Packet::decode(&BASE64_STANDARD.decode(bytes).unwrap()).unwrap().sequence);
    }
    assert!(seen.into_iter().eq(0..4000) && rig.server.clients.iter().any(|(client, _)| client.is_behind()));
    drop((first, slow));
    rig.server.serve();
    rig.shown.publish(|| panic!("nobody watches any more"));
    assert!(rig.server.clients.is_empty());
}

#[test]
fn state_shows_every_link_with_its_counts_its_trouble_and_its_channels() {
    let mut rig = Rig::new();
    let channels =
        "[[link.channel]]\nchannel = 3\nname = \"left brow\"\noffset = 0.25\n[[link.channel]]\nchannel = 1\n";
    let toml = format!("[[link]]\naddress = \"127.0.0.1:9\"\n[[link]]\nkind = \"pca9685\"\nbus = 255\n{channels}");
    let counters = &rig.server.peers.counters;
    let settings = config::parse("test", &toml).unwrap();
    let mut links = Links::change(&settings, Vec::new(), &counters.traffic).unwrap();
    counters.set_panels(links.panels());
    links.send_last(&test_output(State::Live));
    let packets = &counters.traffic.packets;
    let panels = links.panels();
    eventually("two packets, and a trouble of the servos", || {
        packets.load(Relaxed) == 2 && panels[1].trouble().is_some()
    });
    let Some(Reply::Status(status)) = rig.ask(Request::Status {}).next() else { panic!("no state") };
    let [udp, servos] = &*status.links else { panic!("{status:?}") };
    let counted = (udp.kind.as_str(), udp.sent, udp.trouble.as_deref(), udp.channels.len());
    assert_eq!((counted, udp.name.as_str()), (("udp", 1, None, 0), "udp 127.0.0.1:9"));
    assert!(servos.trouble.as_ref().unwrap().contains("no /dev/i2c bus") && !servos.open, "{servos:?}");
    let shown = |channel: &ChannelStatus| (channel.number, channel.target, channel.position, channel.pulse_us);
    assert!(servos.channels.iter().map(shown).eq([(1, Some(0.0), Some(0.0), None), (3, Some(0.25), Some(0.25), None)]));
    assert!(servos.channels.iter().map(|channel| channel.name.as_deref()).eq([None, Some("left brow")]));
    assert!(status.metrics.ends_with("# EOF\n") && !status.released && !status.driven);
}

/// A rig with a servo of no link, and a board of servos at the second link.
fn rig_with_servos() -> (Rig, Board, Vec<Arc<Panel>>) {
    let channels = "[[link.channel]]\nchannel = 3\nspeed_per_s = 2.0\nacceleration_per_s2 = 20.0\nsources = { jawOpen = 1.0 }\n\
                    [[link.channel]]\nchannel = 1\nspeed_per_s = 1.0\n";
    let links = format!("[[link]]\naddress = \"127.0.0.1:9\"\n[[link]]\nkind = \"pca9685\"\nbus = 255\n{channels}");
    let rig = Rig::new();
    let settings = config::parse("test", &links).unwrap();
    let counters = &rig.server.peers.counters;
    let panels = Links::change(&settings, Vec::new(), &counters.traffic).unwrap().panels();
    counters.set_panels(panels.clone());
    let board = Board::new(settings.links[1].kind.channels().unwrap(), &panels[1].dials);
    (rig, board, panels)
}

impl Rig {
    /// Begins to drive, and returns the connection.
    fn driver(&mut self) -> UnixStream {
        self.driver_with(false)
    }

    fn driver_with(&mut self, others_follow: bool) -> UnixStream {
        let mut answers = self.ask(Request::Drive { others_follow });
        assert_eq!(answers.next(), Some(Reply::Driving(true)));
        answers.lines.into_inner()
    }

    /// Does what lines say, and notes whether somebody drives, as the sender does.
    fn drive(&mut self, far: &mut UnixStream, lines: &str) -> bool {
        let _ = far.write_all(lines.as_bytes());
        self.server.serve();
        let operator = &self.server.peers.counters.traffic.operator;
        operator.is_driven.store(monotonic_us() < operator.driven_until_us.load(Relaxed), Relaxed);
        operator.is_driven.load(Relaxed)
    }
}

#[test]
fn one_client_at_a_time_drives_until_it_is_silent_or_goes_or_sends_nonsense() {
    let (mut rig, ..) = rig_with_servos();
    let mut far = rig.driver();
    assert!(rig.drive(&mut far, "{\"coefficients\":{\"jawOpen\":2},\"head_deg\":[10,-20,30]}\n"));
    let pose = rig.played.read().unwrap();
    let angles_deg = yaw_pitch_roll_deg(pose.rotation).map(f32::round);
    assert_eq!((angles_deg, pose.coefficients[17]), ([10.0, -20.0, 30.0], 1.0));
    drop(far);
    rig.server.serve();
    far = rig.driver();
    assert!(!rig.drive(&mut far, "") && rig.played.read().is_none(), "the next one begins with the wearer's face");
    drop(far);
    rig.server.serve();
    let jog = "{\"link\":1,\"channel\":3,\"position\":0.5}\n";
    for (last, why) in [
        ("{\"link\":0,\"channel\":3,\"position\":0.5}\n", Some("no servo")),
        ("{\"link\":1,\"channel\":2,\"position\":0.5}\n", Some("no servo")),
        ("{\"coefficients\":{\"jawOpened\":1}}\n", Some("no coefficient")),
        ("{\"link\":1,\"channel\":3,\"position\":0.5,\"speed\":9}\n", Some("not understood")),
        (&"x".repeat(5000), Some("4096 bytes")),
        ("{}\n", Some("400 ms")),
        ("{}\n", None),
    ] {
        let mut far = rig.driver();
        assert!(rig.refused(Request::Drive { others_follow: false }).contains("somebody else"));
        assert!(rig.drive(&mut far, jog) && rig.drive(&mut far, "{}\n"));
        if why.is_none() {
            far.shutdown(std::net::Shutdown::Both).unwrap();
        } else if last == "{}\n" {
            rig.server.clients.back_mut().unwrap().0.since -= Duration::from_millis(401);
            assert!(!rig.drive(&mut far, ""));
        }
        let told = (!rig.drive(&mut far, last)).then(|| Answers::of(far).next()).unwrap();
        assert!(!rig.server.is_any(|task| matches!(task, Task::Drive { .. })), "{last}");
        assert!(why.is_none_or(|why| matches!(told, Some(Reply::Refused(told)) if told.contains(why))), "{last}");
    }
}

#[test]
fn no_lines_of_one_who_drives_take_a_servo_beyond_its_limits_and_released_ones_get_pulses_only_while_they_are_jogged() {
    let (mut rig, mut board, panels) = rig_with_servos();
    let mut random = fastrand::Rng::with_seed(1);
    let step = Duration::from_millis(20);
    let limits = [(1.0, f32::INFINITY), (2.0, 20.0)];
    let mut now = Instant::now();
    let mut far = rig.driver_with(true);
    let mut before = [(0.0, 0.0); 2];
    let mut driven = 0;
    let mut pulses = 0;
    let mut jogged = None;
    for _ in 0..10_000 {
        let number = ["0", "1", "-1", "0.5", "1e30", "-1e30", "1e999", "null", "[]", "\"1\""][random.usize(..10)];
        let line = match random.u32(..8) {
            0 => "{}".to_owned(),
            1 => format!("{{\"coefficients\":{{\"jawOpen\":{number}}},\"head_deg\":[{number},0,0]}}"),
            2 => format!("{{\"head_deg\":[0,{number}]}}"),
            3 => (0..random.usize(..40)).map(|_| random.char(..)).collect(),
            _ => format!("{{\"link\":{},\"channel\":{},\"position\":{number}}}", random.u8(..3), random.u8(..5)),
        };
        let is_driven = rig.drive(&mut far, &format!("{line}\n"));
        driven += u32::from(is_driven);
        // A line that is obeyed takes the place of the one before, unless it is empty.
        if let Ok(line) = serde_json::from_str::<Drive>(&line)
            && is_driven
            && line != (Drive::Alive {})
        {
            jogged = if let Drive::Jog { channel, .. } = line { Some(channel) } else { None };
        }
        // The next one who drives begins without a jog.
        jogged = jogged.filter(|_| is_driven);
        if rig.server.clients.is_empty() {
            far = rig.driver_with(true);
        }
        let is_released = random.u32(..10) == 0;
        panels[1].dials.operator.is_released.store(is_released, Relaxed);
        let live = Packet { state: State::Live, ..Packet::NEUTRAL };
        let puppet = rig.played.read().as_ref().map_or(Packet::NEUTRAL, |pose| live.with_pose(pose));
        now += step;
        board.follow(&puppet, now);
        let dials = panels[1].dials.channels.iter().zip(&mut before);
        for ((dial, before), (speed_per_s, acceleration_per_s2)) in dials.zip(limits) {
            let position = dial.position.get().unwrap();
            let speed = (position - before.0) / step.as_secs_f32();
            let change_per_s = (speed - before.1).abs() / step.as_secs_f32();
            assert!((0.0..=1.0).contains(&position) && speed.abs() <= speed_per_s * 1.01, "{speed} {line:?}");
            let is_off = is_released && jogged != Some(dial.number);
            assert!(is_off || change_per_s <= acceleration_per_s2 * 1.2, "{change_per_s}");
            *before = (position, if is_off { 0.0 } else { speed });
            assert_eq!(dial.place.get().is_none(), is_off);
            pulses += u32::from(speed != 0.0);
        }
    }
    assert!(driven > 2000 && pulses > 1000, "{driven} {pulses}");
}

#[test]
fn a_release_ends_a_drive_and_one_that_begins_after_it_gives_pulses_to_the_servo_that_it_jogs_alone() {
    let (mut rig, mut board, panels) = rig_with_servos();
    let jog = "{\"link\":1,\"channel\":3,\"position\":0.5}\n";
    let mut now = Instant::now();
    let mut pulses = || {
        now += Duration::from_millis(20);
        board.follow(&Packet::NEUTRAL, now);
        panels[1].dials.channels.iter().map(|dial| dial.place.get().is_some()).collect::<Vec<_>>()
    };
    for _ in 0..2 {
        let mut driver = rig.driver();
        assert!(rig.drive(&mut driver, jog));
        assert!(pulses()[1], "channel 3");
        let _release = rig.ask(Request::Release { on: true });
        assert!(!rig.drive(&mut driver, jog), "whoever drove moves nothing any more");
        assert_eq!(pulses(), [false; 2]);
        let told = Answers::of(driver).next();
        assert!(matches!(&told, Some(Reply::Refused(why)) if why.contains("released")), "{told:?}");
        let mut next = rig.driver();
        assert!(rig.drive(&mut next, "{}\n"));
        assert_eq!(pulses(), [false; 2]);
        assert!(rig.drive(&mut next, jog));
        assert_eq!(pulses(), [false, true]);
        next.shutdown(std::net::Shutdown::Both).unwrap();
        assert!(!rig.drive(&mut next, ""));
        assert_eq!(pulses(), [false; 2]);
    }
}

#[test]
fn other_boards_than_the_one_that_is_jogged_stay_where_they_are_unless_whoever_drives_lets_them_follow_the_face() {
    let mut rig = Rig::new();
    let jaw = "[[link.channel]]\nchannel = 1\nneutral = 0.25\nsources = { jawOpen = 1 }\n";
    let boards = [254, 255].map(|bus| format!("[[link]]\nkind = \"pca9685\"\nbus = {bus}\n{jaw}"));
    let settings = config::parse("test", &boards.concat()).unwrap();
    let counters = Arc::clone(&rig.server.peers.counters);
    let panels = Links::change(&settings, Vec::new(), &counters.traffic).unwrap().panels();
    counters.set_panels(panels.clone());
    let mut moved =
        [0, 1].map(|link: usize| Board::new(settings.links[link].kind.channels().unwrap(), &panels[link].dials));
    let mut now = Instant::now();
    let mut positions = |jaw_open| {
        let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
        packet.coefficients[17] = jaw_open;
        for _ in 0..100 {
            now += Duration::from_millis(20);
            for board in &mut moved {
                board.follow(&packet, now);
            }
        }
        panels.iter().map(|panel| panel.dials.channels[0].position.get().unwrap()).collect::<Vec<_>>()
    };
    for (others_follow, armed, jogged) in [(false, [0.5, 0.5], [1.0, 0.5]), (true, [0.75, 0.75], [1.0, 0.25])] {
        assert_eq!(positions(0.5), [0.5, 0.5]);
        let mut driver = rig.driver_with(others_follow);
        assert!(rig.drive(&mut driver, "{}\n"));
        assert_eq!(positions(0.75), armed, "it moves nothing yet");
        assert!(rig.drive(&mut driver, "{\"link\":0,\"channel\":1,\"position\":1}\n"));
        assert_eq!(positions(0.25), jogged);
        assert!(rig.drive(&mut driver, "{\"coefficients\":{\"jawOpen\":0.5}}\n"));
        assert_eq!(positions(0.5), [0.5, 0.5], "the puppet's face");
        driver.shutdown(std::net::Shutdown::Both).unwrap();
        assert!(!rig.drive(&mut driver, ""));
    }
}

#[test]
fn camera_picture_is_shown_with_its_landmarks_only_if_the_settings_allow_it() {
    let mut rig = Rig::new();
    assert!(rig.refused(Request::Picture {}).contains("[console]"));
    let mut asks_landmarks = rig.ask(Request::Landmarks {});
    rig.reload(|settings| settings.console.picture = true);
    let mut asks = rig.ask(Request::Picture {});
    let data = vec![7; 1000 * 1000];
    let mut landmarks = Landmarks::zero();
    landmarks.0[1] = [30.0, 40.0, 5.0];
    let picture = Picture::new(1000, 1000, Pixels::Grey { data: &data, stride: 1000 }, true).unwrap();
    let frame = Frame { content: Content::Picture(picture), captured_us: 5, number: 0 };
    let head = loop {
        rig.copier.copy(&frame, Some(&landmarks));
        rig.server.serve();
        if let Some(head) = asks.next() {
            break head;
        }
    };
    let Some(Reply::Picture(without)) = asks_landmarks.next() else { panic!("no landmarks") };
    assert_eq!((without.bytes, without.width, without.landmarks.unwrap()[1]), (0, 1000, [30.0, 40.0]));
    let Reply::Picture(PictureHead { format, width, bytes, time_us, landmarks, .. }) = head else { panic!("{head:?}") };
    let want = (PictureFormat::Grey, 1000, 1_000_000, 5, [30.0, 40.0]);
    assert_eq!((format, width, bytes, time_us, landmarks.unwrap()[1]), want);
    let mut shown = Vec::new();
    while shown.len() < bytes {
        let _ = asks.lines.read_to_end(&mut shown);
        rig.server.serve();
    }
    assert!(shown == data && rig.server.clients.is_empty());
    let mut late = rig.ask(Request::Picture {});
    rig.copier.copy(&frame, None);
    let _others = [(); 4].map(|()| rig.server.peers.pictures.ask([6, 4]).unwrap());
    rig.server.serve();
    assert!(matches!(late.next(), Some(Reply::Refused(_))), "others took the place for the picture in its size");
}

#[test]
fn who_asks_for_a_reload_or_a_release_waits_for_its_outcome_and_a_release_finds_a_place_beside_many_watchers() {
    let mut rig = Rig::new();
    let mut asks = rig.ask(Request::Reload {});
    let gone = rig.ask(Request::Reload {});
    drop(gone);
    rig.server.serve();
    let _others: Vec<_> = (0..7).map(|_| rig.ask(Request::Watch {})).collect();
    assert!(asks.next().is_none() && rig.refused(Request::Watch {}).contains("too many"));
    let mut release = rig.ask(Request::Release { on: true });
    rig.server.serve();
    assert!(release.next().is_none(), "the links have not been told");
    let kept = rig.server.kept.clone();
    assert!(kept.released_since().is_some(), "a restarted service would give servos pulses");
    rig.server.peers.counters.traffic.operator.released_at_links.store(true, Relaxed);
    rig.server.serve();
    assert!(matches!(release.next(), Some(Reply::Done(_))));
    rig.ask(Request::Release { on: false });
    assert!(kept.released_since().is_none(), "a restarted service would give servos no pulses");
    let outcome = Reply::Refused("test:1: not valid TOML".to_owned());
    rig.reloads.try_iter().for_each(|asker| drop(asker.send(outcome.clone())));
    rig.server.serve();
    assert!(asks.next() == Some(outcome) && rig.server.clients.len() == 7);
}

#[test]
fn a_camera_with_a_frame_in_two_seconds_is_soon_known_to_be_slow_and_a_silent_one_is_told_all_the_same() {
    let guide = Guide::new(blank_model_file().to_model().unwrap(), Wears::Nothing);
    let (mut client, _far) = client();
    let mut guiding = Guiding { guide, observed_us: 0, told: None };
    // Asks as the service does, several times between two frames. Returns the seconds in which a picture was missed.
    let mut missed = |period_s, seconds: std::ops::Range<u64>| -> Vec<u64> {
        let is_missed = |second: &u64| {
            let is_frame = period_s > 0 && second.is_multiple_of(period_s);
            let frame = Observation { time_us: second * 1_000_000, sight: Err(Refusal::NoFace) };
            let now_us = second * 1_000_000 + 1000;
            guiding.step(&mut client, is_frame.then_some(&frame), now_us).unwrap();
            guiding.step(&mut client, None, now_us + 999_000).unwrap();
            guiding.guide.progress().waits_for == Some(Refusal::NoPicture)
        };
        seconds.filter(is_missed).collect()
    };
    assert!(missed(2, 0..20).iter().all(|second| *second < 6));
    assert!(missed(0, 20..29).contains(&28));
}

#[test]
fn wearers_that_are_not_there_or_named_wrongly_are_refused_with_the_remedy() {
    let mut rig = Rig::new();
    let wearer = Some("anna".to_owned());
    assert!(rig.refused(Request::Use { wearer }).contains("facewire calibrate --wearer anna"));
    assert!(rig.refused(Request::Delete { wearer: "../x".to_owned() }).contains("letters"));
    assert!(rig.refused(calibrate("a b")).contains("letters"));
    assert!(matches!(rig.ask(Request::Use { wearer: None }).next(), Some(Reply::Done(_))));
    assert_eq!(rig.told.recv().unwrap().profile, Some(Profile::default()));
}

#[test]
fn requests_are_lines_that_people_can_type_in_pieces_and_nonsense_and_endless_lines_are_refused() {
    let wearer = Some("anna".to_owned());
    let longest = Request::Delete { wearer: "a".repeat(32) };
    for (line, want) in [
        (r#"{"do":"use","wearer":null}"#, Ok(Request::Use { wearer: None })),
        (r#"{"do":"calibrate","wearer":"anna"}"#, Ok(Request::Calibrate { wearer })),
        (&serde_json::to_string(&longest).unwrap(), Ok(longest)),
        (r#"{"do":"dance"}"#, Err("not understood")),
        (r#"{"do":"list","all":true}"#, Err("not understood")),
        ("hello", Err("not understood")),
        (&"x".repeat(4 * MAX_LINE), Err("bytes")),
    ] {
        let (mut client, mut far) = client();
        let (first, last) = line.split_at(4);
        far.write_all(first.as_bytes()).unwrap();
        assert!(!client.receive(MAX_LINE).unwrap() && client.request::<Request>(MAX_LINE).is_none());
        far.write_all(format!("{last}\n").as_bytes()).unwrap();
        client.receive(MAX_LINE).unwrap();
        match (client.request(MAX_LINE).unwrap(), want) {
            (Err(refusal), Err(why)) => assert!(refusal.contains(why), "{line}: {refusal}"),
            (request, want) => assert_eq!(request, want.map_err(str::to_owned), "{line}"),
        }
    }
}

#[test]
fn client_that_does_not_read_is_behind_until_it_does_and_one_that_has_gone_is_told_from_it() {
    let (mut client, mut far) = client();
    let [patience, none] = [Duration::from_secs(60), Duration::ZERO];
    assert!(!client.has_gone(none), "there is nothing to read");
    client.send(&Reply::Done("x".repeat(1 << 20))).unwrap();
    assert!(client.is_behind() && !client.has_gone(patience) && client.has_gone(none));
    let mut read = Vec::new();
    while client.is_behind() || !read.ends_with(b"\"}\n") {
        let _ = far.read_to_end(&mut read);
        client.flush().unwrap();
    }
    drop(far);
    assert!(client.has_gone(patience) && client.receive(MAX_LINE).unwrap());
}
