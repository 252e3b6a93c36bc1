use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::thread;

use facewire_packet::Reason;
use tempfile::TempDir;

use super::super::observer::{self, Observer};
use super::*;
use crate::calibration::test_wearer::{Wearer, blank_model_file};
use crate::calibration::{Phase, Refusal, Sight, Take};

/// A control thread, and what a hot loop would hold.
struct Rig {
    folder: TempDir,
    control: Control,
    observer: Observer<Observation>,
    recorder: Observer<Recorded>,
    told: mpsc::Receiver<HotChange>,
    settings: Settings,
    reload: mpsc::Sender<Settings>,
}

impl Rig {
    /// The model reads nothing in the landmarks.
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("model.toml"), toml::to_string(&blank_model_file()).unwrap()).unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let mut settings = Settings::default();
        (settings.wearer.folder, settings.solver.model) = (path("profiles"), path("model.toml"));
        let ((observer, observed), (recorder, recorded)) = (observer::channel(), observer::channel());
        let (changes, told) = mpsc::channel();
        let hot = Arc::new(Mailbox { changes, thread: thread::current() });
        let (reload, changes) = mpsc::channel();
        let (in_use, counters) = (InUse::default(), Arc::default());
        let parts = Parts { settings: settings.clone(), changes, in_use, observed, recorded, hot, counters };
        let control = Control::listen_at(Some(folder.path().join("run/control")), parts).unwrap();
        Self { folder, control, observer, recorder, told, settings, reload }
    }

    fn ask(&self, request: &Request) -> Answers {
        let path = self.folder.path().join("run/control");
        let stream = loop {
            // The socket exists as soon as the thread has come to it.
            if let Ok(stream) = UnixStream::connect(&path) {
                break stream;
            }
            thread::yield_now();
        };
        let line = serde_json::to_string(request).unwrap() + "\n";
        (&stream).write_all(line.as_bytes()).unwrap();
        Answers::of(stream)
    }

    fn refused(&self, request: &Request) -> String {
        match self.ask(request).last() {
            Reply::Refused(why) => why,
            reply => panic!("{reply:?}"),
        }
    }

    /// Begins a calibration, and shows it that there is no face.
    fn calibrate(&mut self, name: &str) -> Answers {
        let mut answers = self.ask(&calibrate(name));
        // The thread asks for observations once it has read the request.
        while !self.observer.hand(Observation { time_us: 1, is_dark: false, sight: Sight::NoFace }) {
            thread::yield_now();
        }
        assert!(matches!(answers.next(), Reply::Progress(_)));
        answers
    }
}

fn calibrate(name: &str) -> Request {
    Request::Calibrate { wearer: Some(name.to_owned()) }
}

struct Answers {
    lines: BufReader<UnixStream>,
    lost: Option<u64>,
}

impl Answers {
    fn of(stream: UnixStream) -> Self {
        Self { lines: BufReader::new(stream), lost: None }
    }

    fn next(&mut self) -> Reply {
        let mut line = String::new();
        self.lines.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }

    /// Returns the last answer, after any progress.
    fn last(&mut self) -> Reply {
        std::iter::repeat_with(|| self.next()).find(|reply| !matches!(reply, Reply::Progress(_))).unwrap()
    }

    /// Returns the next entry of a recording, and keeps how many frames were lost. `None` if nothing has come.
    fn entry(&mut self) -> Option<Recorded> {
        self.lines.get_ref().set_read_timeout(Some(Duration::from_millis(200))).unwrap();
        loop {
            let mut line = String::new();
            self.lines.read_line(&mut line).ok().filter(|length| *length > 0)?;
            match serde_json::from_str(&line).unwrap() {
                Reply::Frame(text) => return Recorded::from_bytes(&BASE64_STANDARD.decode(text).unwrap()),
                Reply::Lost(lost) => self.lost = Some(lost),
                reply => panic!("{reply:?}"),
            }
        }
    }
}

/// Performs every take that the guide asks for, until it has enough. Returns the last answer.
fn perform(rig: &mut Rig, answers: &mut Answers) -> Reply {
    let (wearer, mut take) = (Wearer::new(), Take::Neutral);
    for time_us in (1..).map(|number| number * 200_000) {
        if !rig.observer.hand(Observation { time_us, is_dark: false, sight: wearer.pose(take, 0.8) }) {
            break;
        }
        // A step that changes more than measures is told at once, and each take is one.
        answers.lines.get_ref().set_nonblocking(true).unwrap();
        let mut line = String::new();
        while answers.lines.read_line(&mut line).is_ok_and(|length| length > 0) {
            match serde_json::from_str(&line).unwrap() {
                Reply::Progress(Progress { take: wanted, phase, .. }) if phase != Phase::Ended => take = wanted,
                Reply::Progress(_) => {}
                reply => return reply,
            }
            line.clear();
        }
        answers.lines.get_ref().set_nonblocking(false).unwrap();
    }
    answers.last()
}

#[test]
fn wearer_who_follows_has_a_profile_that_the_hot_loop_uses() {
    let mut rig = Rig::new();
    let mut answers = rig.calibrate("anna");
    let reply = perform(&mut rig, &mut answers);
    let Reply::Calibrated(report) = &reply else { panic!("{reply:?}") };
    assert_eq!((report.wearer.as_str(), report.taken.len()), ("anna", Take::ALL.len()), "{report:?}");
    let profile = rig.told.recv().unwrap().profile.unwrap();
    assert!(profile.neutral.is_some() && fs::read_to_string(&report.path).unwrap().contains("jawOpen"));
    let Reply::Wearers { wearers, in_use, .. } = rig.ask(&Request::List {}).last() else { panic!("no list") };
    assert_eq!((wearers.len(), in_use.as_deref()), (1, Some("anna")));

    let warns = |rig: &Rig| match rig.ask(&Request::Use { wearer: Some("anna".to_owned()) }).last() {
        Reply::Done(text) => text.contains("another blendshape model"),
        reply => panic!("{reply:?}"),
    };
    assert!(!warns(&rig));
    rig.settings.solver.model = String::new();
    rig.reload.send(rig.settings.clone()).unwrap();
    assert!(warns(&rig));
}

#[test]
fn second_calibration_is_refused_and_a_client_that_vanishes_cancels_its_own() {
    let mut rig = Rig::new();
    let answers = rig.calibrate("anna");
    assert!(rig.refused(&calibrate("bert")).contains("in progress"));
    drop(answers);
    while rig.observer.hand(Observation { time_us: 2, is_dark: false, sight: Sight::NoFace }) {
        thread::yield_now();
    }
    rig.calibrate("bert");
}

#[test]
fn stop_ends_a_calibration_at_once_and_removes_the_socket() {
    let mut rig = Rig::new();
    let _answers = rig.calibrate("anna");
    let mode = |path: &str| fs::metadata(rig.folder.path().join(path)).unwrap().permissions().mode() & 0o777;
    assert_eq!([mode("run"), mode("run/control")], [0o700, 0o600], "it belongs to its user alone");
    drop(rig.control);
    assert!(!rig.observer.hand(Observation::nothing(3)), "nobody wants observations any more");
    let exists = |name: &str| rig.folder.path().join(name).exists();
    assert!(!exists("run/control") && !exists("profiles"), "nothing was kept");
}

#[test]
fn calibration_ends_when_the_model_changes_and_not_at_any_other_reload() {
    let mut rig = Rig::new();
    let mut answers = rig.calibrate("anna");
    rig.settings.camera.fps = 60;
    rig.reload.send(rig.settings.clone()).unwrap();
    assert!(rig.observer.hand(Observation::nothing(2)) && matches!(answers.next(), Reply::Progress(_)));
    rig.settings.solver.model = String::new();
    rig.reload.send(rig.settings.clone()).unwrap();
    assert!(matches!(answers.last(), Reply::Refused(why) if why.contains("model has changed")));
    assert!(!rig.folder.path().join("profiles").exists(), "nothing was kept");
}

#[test]
fn client_that_records_gets_every_frame_beside_a_calibration_and_a_second_one_is_refused() {
    let mut rig = Rig::new();
    let mut recording = rig.ask(&Request::Record {});
    let _answers = rig.calibrate("anna");
    // The thread asks for frames once it has read the request.
    while !rig.recorder.hand(Recorded::nothing(0, Reason::NoFace)) {
        thread::yield_now();
    }
    (1..=3).for_each(|time_us| rig.recorder.publish(|| Recorded::nothing(time_us, Reason::NoFace)));
    let times = std::iter::from_fn(|| recording.entry()).map(|entry| entry.time_us).filter(|time_us| *time_us > 0);
    assert!(times.take(3).eq([1, 2, 3]));
    assert!(rig.refused(&Request::Record {}).contains("in progress"));
    drop(recording);
    while rig.recorder.hand(Recorded::nothing(4, Reason::NoFace)) {
        thread::yield_now();
    }
    assert!(rig.observer.hand(Observation::nothing(5)), "the calibration goes on");
}

/// A recording, the ring of its frames, and the far end of its client.
fn recording() -> (Recording, Observer<Recorded>, Observed<Recorded>, Answers) {
    let (client, far) = client();
    let (observer, mut observed) = observer::channel();
    observed.ask(true);
    (Recording::new(client, 0), observer, observed, Answers::of(far))
}

fn client() -> (Client, UnixStream) {
    let (near, far) = UnixStream::pair().unwrap();
    near.set_nonblocking(true).unwrap();
    (Client::new(OwnedFd::from(near).into(), Speaks::Requests), far)
}

#[test]
fn frames_of_a_recording_that_nobody_fetched_in_time_are_counted_and_told() {
    let (mut recording, mut observer, mut observed, mut answers) = recording();
    (0..40).for_each(|time_us| observer.publish(|| Recorded::nothing(time_us, Reason::NoFace)));
    recording.step(&mut observed, true, 1).unwrap();
    let entries = std::iter::from_fn(|| answers.entry()).count();
    assert_eq!((answers.lost, entries), (Some(40 - entries as u64), 32));
}

#[test]
fn client_that_does_not_read_loses_frames_and_holds_no_memory() {
    let (mut recording, mut observer, mut observed, mut answers) = recording();
    for time_us in 0..10_000 {
        observer.publish(|| Recorded::nothing(time_us, Reason::NoFace));
        recording.step(&mut observed, true, time_us).unwrap();
    }
    assert!(recording.refused > 0);
    let mut entries = 0;
    while answers.lost.is_none() {
        entries += u64::from(answers.entry().is_some());
        recording.step(&mut observed, true, 10_000).unwrap();
    }
    assert_eq!(answers.lost, Some(10_000 - entries));
}

#[test]
fn entries_without_a_camera_have_the_clock_of_the_frames_and_none_lies_between_those_of_a_slow_camera() {
    let (mut recording, mut observer, mut observed, mut answers) = recording();
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
        recording.step(&mut observed, is_camera_open, now_us).unwrap();
    }
    let entries = std::iter::from_fn(|| answers.entry()).map(|entry| (entry.time_us, entry.packet.reason));
    let (face, camera) = (Reason::NoFace, Reason::NoCamera);
    let want = [(second, face), (2 * second, face), (2 * second + 2_050_000, camera), (2 * second + 2_050_001, face)];
    assert_eq!(entries.collect::<Vec<_>>(), want);
    assert_eq!(answers.lost, Some(0), "the client hears from the service");
}

#[test]
fn camera_with_two_frames_a_second_is_not_taken_for_a_silent_one() {
    let guide = Guide::new(Wearer::new().model);
    let mut calibrating = Calibrating::new(client().0, named("anna").unwrap(), guide, 0);
    let mut waits_for = |now_us| {
        calibrating.step(None, 1_500_000, now_us);
        calibrating.guide.progress().waits_for
    };
    assert_eq!([1_400_000, 1_600_000].map(&mut waits_for), [None, Some(Refusal::NoPicture)]);
}

#[test]
fn wearers_that_are_not_there_or_named_wrongly_are_refused_with_the_remedy() {
    let rig = Rig::new();
    let wearer = Some("anna".to_owned());
    assert!(rig.refused(&Request::Use { wearer }).contains("facewire calibrate --wearer anna"));
    assert!(rig.refused(&Request::Delete { wearer: "../x".to_owned() }).contains("letters"));
    assert!(rig.refused(&calibrate("a b")).contains("letters"));
    assert!(matches!(rig.ask(&Request::Use { wearer: None }).last(), Reply::Done(_)));
    assert_eq!(rig.told.recv().unwrap().profile, Some(Profile::default()));
}
