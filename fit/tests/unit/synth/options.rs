use clap::{CommandFactory, Parser};
use facewire_face::BLENDSHAPES;
use facewire_face::COEFFS;
use facewire_fit::synth::acting::{Kind, Moments};
use facewire_fit::synth::options::*;

#[derive(Debug, Parser)]
struct Cli {
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    scenes: SceneOptions,
}

fn parsed(arguments: &[&str]) -> Cli {
    Cli::parse_from([&["synth"], arguments].concat())
}

fn rig(counts: [usize; 3]) -> [Vec<String>; 3] {
    counts.map(|count| (0..count).map(|number| format!("texture {number}")).collect())
}

#[test]
fn the_judging_set_shares_no_texture_with_the_training_set_and_has_other_people() {
    let sources = parsed(&[]).sources;
    let [train, judge] =
        [Set::Train, Set::Judge].map(|set| sources.textures(set, &rig([4, 9, 30])).expect("enough of each"));
    for ((train, judge), count) in train.into_iter().zip(judge).zip([4, 9, 30]) {
        assert!(!train.is_empty() && !judge.is_empty() && train.iter().all(|number| !judge.contains(number)));
        assert_eq!(train.len() + judge.len(), count);
    }
    assert!(Set::Train.seed(1) != Set::Judge.seed(1) && Set::Judge.seed(1) != Set::All.seed(1));
}

#[test]
fn a_set_without_a_texture_and_unknown_names_are_refused() {
    for (counts, kind) in [([3, 4, 4], "skins"), ([4, 3, 4], "brows"), ([4, 4, 3], "eyes")] {
        let error = parsed(&[]).sources.textures(Set::Judge, &rig(counts)).expect_err("refused").to_string();
        assert!(error.contains(&format!("rig's 3 {kind}")) && error.contains("--set judge"), "{error}");
    }
    let named = |name: &str| parsed(&["--skins", name]).sources.textures(Set::Judge, &rig([3, 4, 4]));
    assert_eq!(named("texture 1").expect("known")[0], [1]);
    assert!(named("other").expect_err("unknown").to_string().contains("texture 0, texture 1"));
    assert_eq!(picture_size(&[128, 2048]).expect("allowed"), [128, 2048]);
    assert!(picture_size(&[127, 400]).is_err() && picture_size(&[400, 2049]).is_err());
}

#[test]
fn columns_of_a_recording_are_matched_by_name_and_what_is_not_a_number_is_refused_with_file_and_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("spec.csv");
    let mut names = BLENDSHAPES.map(|name| name[..1].to_uppercase() + &name[1..]);
    names.reverse();
    let values: Vec<String> = (0..COEFFS).map(|index| format!("{:.2}", index as f32 / 100.0)).collect();
    std::fs::write(&path, format!("Timecode,{}\n10:00,{}\n", names.join(","), values.join(","))).expect("written");
    let frames = recording(&path).expect("a recording");
    assert!((frames[0][0] - 0.51).abs() < 1e-6, "the first blendshape is in the last column");
    for wrong in ["NaN", "inf", "high"] {
        let (good, mut bad) = (["0.5"; COEFFS], ["0.5"; COEFFS]);
        bad[7] = wrong;
        std::fs::write(&path, [BLENDSHAPES, good, bad].map(|row| row.join(",")).join("\n")).expect("written");
        let error = format!("{:#}", recording(&path).expect_err("refused"));
        assert!(error.contains("spec.csv") && error.contains("line 3") && error.contains(wrong), "{error}");
    }
}

#[test]
fn training_and_judging_share_no_recording_of_a_folder_and_named_recordings_are_all_used() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("README.md"), "no recording").expect("written");
    let path = folder.path().to_str().expect("a path");
    let recordings = |curves: &str, set: Set| parsed(&["--curves", curves]).sources.curves.recordings(set);
    let values = |curves: &str, set: Set| -> Vec<f32> {
        recordings(curves, set).expect("recordings").iter().map(|frames| frames[0][0]).collect()
    };
    for number in 0..5 {
        let text = format!("{}\n{}\n", BLENDSHAPES.join(","), vec![format!("0.{number}"); COEFFS].join(","));
        std::fs::write(folder.path().join(format!("take_{number}.csv")), text).expect("written");
        if number == 0 {
            let error = recordings(path, Set::Judge).expect_err("refused").to_string();
            assert!(error.contains("none of the 1 recordings") && error.contains("--set judge"), "{error}");
        }
    }
    assert_eq!(values(path, Set::Train), [0.0, 0.2, 0.3]);
    assert_eq!(values(path, Set::Judge), [0.1, 0.4]);
    assert_eq!(values(path, Set::All).len(), 5);
    assert_eq!(values(&format!("{path}/take_3.csv"), Set::Judge), [0.3]);
}

#[test]
fn kinds_of_expressions_are_named_with_their_shares_and_the_help_shows_the_default_mixtures() {
    let given = parsed(&["--mix", "recorded=3,rest=0.5"]).scenes.mix;
    assert_eq!(given.mix(Set::Judge), [(Kind::Recorded, 3.0), (Kind::Rest, 0.5)]);
    assert_eq!(mix_text(given.mix(Set::Judge)), "recorded=3,rest=0.5");
    let wrong =
        [("5,3", "KIND=SHARE"), ("smile=1", "called smile"), ("rest=-1", "at least 0"), ("rest=NaN", "at least 0")];
    for (wrong, reason) in wrong {
        let error = Cli::try_parse_from(["synth", "--mix", wrong]).expect_err("refused").to_string();
        assert!(error.contains(reason), "{error}");
    }
    let none = parsed(&["--mix", "rest=0"]).scenes.mix.expressions(Set::Train, Moments::new(&[]));
    assert!(none.err().is_some_and(|error| error.to_string().contains("above 0")));
    let help = Cli::command().render_help().to_string().replace(['\n', ' '], "");
    assert!(help.contains(&mix_text(&TRAIN_MIX)) && help.contains(&mix_text(&JUDGE_MIX)), "{help}");
}
