use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::UnixStream;
use std::thread;

use facewire_packet::Reason;
use tempfile::TempDir;

use super::super::observer::{self, Observer};
use super::socket::SOCKET;
use super::*;
use crate::calibration::test_wearer::{Wearer, blank_model_file};
use crate::calibration::{Observation, Phase, Progress, Sight, Take};

/// A control thread, and what a hot loop would hold.
struct Rig {
    folder: TempDir,
    control: Control,
    observer: Observer<Observation>,
    recorder: Observer<Recorded>,
    told: mpsc::Receiver<HotNews>,
}

impl Rig {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.toml");
        fs::write(&model, toml::to_string(&blank_model_file()).unwrap()).unwrap();
        let mut settings = Settings::default();
        settings.wearer.folder = folder.path().join("profiles").to_str().unwrap().to_owned();
        settings.solver.model = model.to_str().unwrap().to_owned();
        let (observer, sights) = observer::channel(&Observation::nothing(0));
        let (recorder, frames) = observer::channel(&Recorded::nothing(0, Reason::None));
        let (changes, told) = mpsc::channel();
        let hot = Mailbox { changes, thread: thread::current() };
        let in_use = WearerName::new(&settings.wearer.name);
        let parts = Parts { settings, changes: mpsc::channel().1, in_use, observed: sights, recorded: frames, hot };
        let control = Control::listen_at(folder.path().join("run").join(SOCKET), parts).unwrap();
        Self { folder, control, observer, recorder, told }
    }

    fn ask(&self, request: &Request) -> Answers {
        let path = self.folder.path().join("run").join(SOCKET);
        let stream = loop {
            // The socket exists as soon as the thread has come to it.
            if let Ok(stream) = UnixStream::connect(&path) {
                break stream;
            }
            thread::yield_now();
        };
        let line = serde_json::to_string(request).unwrap() + "\n";
        (&stream).write_all(line.as_bytes()).unwrap();
        Answers(BufReader::new(stream))
    }
}

struct Answers(BufReader<UnixStream>);

impl Answers {
    fn next(&mut self) -> Reply {
        let mut line = String::new();
        self.0.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }

    /// Returns the last answer, after any progress.
    fn last(&mut self) -> Reply {
        loop {
            match self.next() {
                Reply::Progress(_) => {}
                reply => return reply,
            }
        }
    }
}

fn calibrate(name: &str) -> Request {
    Request::Calibrate { wearer: Some(name.to_owned()) }
}

/// Performs every take that the guide asks for, until it has enough. Returns the last answer.
fn perform(rig: &mut Rig, answers: &mut Answers) -> Reply {
    let wearer = Wearer::new();
    let mut take = Take::Neutral;
    let mut time_us = 0;
    loop {
        time_us += 200_000;
        let sight = wearer.pose(take, 0.8);
        if !rig.observer.hand(Observation { time_us, is_dark: false, sight }) {
            return answers.last();
        }
        // A step that changes more than measures is told at once, and each take is one.
        answers.0.get_ref().set_nonblocking(true).unwrap();
        let mut line = String::new();
        while answers.0.read_line(&mut line).is_ok_and(|length| length > 0) {
            match serde_json::from_str(&line).unwrap() {
                Reply::Progress(Progress { take: wanted, phase, .. }) if phase != Phase::Ended => take = wanted,
                Reply::Progress(_) => {}
                reply => return reply,
            }
            line.clear();
        }
        answers.0.get_ref().set_nonblocking(false).unwrap();
    }
}

#[test]
fn wearer_who_follows_has_a_profile_that_the_hot_loop_uses() {
    let mut rig = Rig::new();
    let mut answers = rig.ask(&calibrate("anna"));
    assert!(matches!(rig_first(&mut rig, &mut answers), Reply::Progress(_)));
    let reply = perform(&mut rig, &mut answers);
    let Reply::Calibrated(report) = &reply else { panic!("{reply:?}") };
    assert_eq!((report.wearer.as_str(), report.taken.len()), ("anna", Take::ALL.len()), "{report:?}");
    let HotNews::Wearer(profile) = rig.told.recv().unwrap() else { panic!("no profile") };
    assert!(profile.neutral.is_some() && fs::read_to_string(&report.path).unwrap().contains("jawOpen"));
    let Reply::Wearers { wearers, in_use, .. } = rig.ask(&Request::List {}).last() else { panic!("no list") };
    assert_eq!((wearers.len(), in_use.as_deref()), (1, Some("anna")));
}

/// Returns the first answer to a calibration, after one observation.
fn rig_first(rig: &mut Rig, answers: &mut Answers) -> Reply {
    // The thread asks for observations once it has read the request.
    while !rig.observer.hand(Observation { time_us: 1, is_dark: false, sight: Sight::NoFace }) {
        thread::yield_now();
    }
    answers.next()
}

#[test]
fn second_calibration_is_refused_and_a_client_that_vanishes_cancels_its_own() {
    let mut rig = Rig::new();
    let mut answers = rig.ask(&calibrate("anna"));
    rig_first(&mut rig, &mut answers);
    assert!(matches!(rig.ask(&calibrate("bert")).last(), Reply::Refused(why) if why.contains("in progress")));
    drop(answers);
    while rig.observer.hand(Observation { time_us: 2, is_dark: false, sight: Sight::NoFace }) {
        thread::yield_now();
    }
    let mut answers = rig.ask(&calibrate("bert"));
    assert!(matches!(rig_first(&mut rig, &mut answers), Reply::Progress(_)));
}

#[test]
fn stop_ends_a_calibration_at_once_and_removes_the_socket() {
    let mut rig = Rig::new();
    let mut answers = rig.ask(&calibrate("anna"));
    rig_first(&mut rig, &mut answers);
    drop(rig.control);
    assert!(!rig.observer.hand(Observation::nothing(3)), "nobody wants observations any more");
    assert!(!rig.folder.path().join("run").join(SOCKET).exists());
    assert!(!rig.folder.path().join("profiles").exists(), "nothing was kept");
}

#[test]
fn client_that_records_gets_every_frame_beside_a_calibration_and_a_second_one_is_refused() {
    let mut rig = Rig::new();
    let mut recording = rig.ask(&Request::Record {});
    let mut calibration = rig.ask(&calibrate("anna"));
    rig_first(&mut rig, &mut calibration);
    // The thread asks for frames once it has read the request.
    while !rig.recorder.hand(Recorded::nothing(0, Reason::NoFace)) {
        thread::yield_now();
    }
    for time_us in 1..=3 {
        assert!(rig.recorder.hand(Recorded::nothing(time_us, Reason::NoCamera)));
    }
    let mut frame = || match recording.next() {
        Reply::Frame(text) => Recorded::from_bytes(&BASE64_STANDARD.decode(text).unwrap()).unwrap(),
        reply => panic!("{reply:?}"),
    };
    let mut last = frame();
    while last.time_us == 0 {
        last = frame();
    }
    assert_eq!((last.time_us, last.pose()), (1, Err(Reason::NoCamera)));
    assert_eq!([frame().time_us, frame().time_us], [2, 3]);
    assert_eq!(frame().pose(), Err(Reason::NoCamera), "after a second without a frame");
    assert!(matches!(rig.ask(&Request::Record {}).last(), Reply::Refused(why) if why.contains("in progress")));
    drop(recording);
    while rig.recorder.hand(Recorded::nothing(4, Reason::NoFace)) {
        thread::yield_now();
    }
    assert!(rig.observer.hand(Observation::nothing(5)), "the calibration goes on");
}

#[test]
fn wearers_that_are_not_there_or_named_wrongly_are_refused_with_the_remedy() {
    let rig = Rig::new();
    let refused = |request: Request| match rig.ask(&request).last() {
        Reply::Refused(why) => why,
        reply => panic!("{reply:?}"),
    };
    let anna = || Some("anna".to_owned());
    assert!(refused(Request::Use { wearer: anna() }).contains("facewire calibrate --wearer anna"));
    assert!(refused(Request::Delete { wearer: "../x".to_owned() }).contains("letters"));
    assert!(refused(Request::Calibrate { wearer: Some("a b".to_owned()) }).contains("letters"));
    assert!(matches!(rig.ask(&Request::Use { wearer: None }).last(), Reply::Done(_)));
    assert!(matches!(rig.told.recv().unwrap(), HotNews::Wearer(profile) if *profile == Profile::default()));
}

#[test]
fn socket_belongs_to_its_user_alone() {
    let rig = Rig::new();
    rig.ask(&Request::List {}).last();
    let mode = |path: &str| fs::metadata(rig.folder.path().join(path)).unwrap().permissions().mode() & 0o777;
    assert_eq!([mode("run"), mode("run/control")], [0o700, 0o600]);
}
