//! What VRChat receives.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::float_cmp)]

use std::collections::BTreeMap;

use super::*;
use crate::config::LinkKind;
use crate::link::head::poses;
use crate::link::osc::received;
use crate::link::output::test_output;
use crate::link::{gaze, output::Pose};

fn settings(keys: &str) -> VrchatSettings {
    let settings = crate::config::parse("test", &format!("[[link]]\nkind = \"vrchat\"\n{keys}")).unwrap();
    let LinkKind::Vrchat(settings) = settings.links[0].kind.clone() else { unreachable!() };
    settings
}

fn output(look: &[(&str, f32)]) -> Output {
    let mut output = test_output(State::Live);
    gaze::set(&mut output.pose.coefficients, look);
    output
}

fn messages(format: &mut Vrchat, now: Instant, output: &Output) -> BTreeMap<String, Vec<OscType>> {
    let mut datagrams = Vec::new();
    format.encode_at(now, output, &mut |bytes| datagrams.push(bytes.to_vec()));
    received::messages(&datagrams).into_iter().map(|message| (message.addr, message.args)).collect()
}

/// Returns what a new link with these settings sends first.
fn first(keys: &str, output: &Output) -> BTreeMap<String, Vec<OscType>> {
    messages(&mut Vrchat::new(&settings(keys)), Instant::now(), output)
}

/// Returns the number of the parameter, rounded to a hundredth.
fn number(messages: &BTreeMap<String, Vec<OscType>>, name: &str) -> f32 {
    let number = messages[&format!("/avatar/parameters/v2/{name}")][0].clone().float().unwrap();
    (100.0 * number).round() / 100.0
}

fn numbers<const N: usize>(look: &[(&str, f32)], names: [&str; N]) -> [f32; N] {
    let messages = first("", &output(look));
    names.map(|name| number(&messages, name))
}

/// The documented bytes of `v2/JawOpen` = 0.5, and of a status that is true.
#[test]
fn messages_have_the_documented_bytes() {
    let mut bytes = Vec::new();
    Vrchat::new(&settings(""))
        .encode(&output(&[("jawOpen", 0.5)]), 0, &mut |datagram| bytes.extend_from_slice(datagram));
    let jaw = b"\0\0\0\x28/avatar/parameters/v2/JawOpen\0\0\0,f\0\0\x3f\0\0\0";
    let status = b"\0\0\0\x2c/avatar/parameters/EyeTrackingActive\0\0\0\0,T\0\0";
    for wanted in [&jaw[..], status] {
        assert_eq!(bytes.windows(wanted.len()).filter(|window| *window == wanted).count(), 1, "{wanted:?}");
    }
}

#[test]
fn a_shape_of_arkit_becomes_one_or_more_parameters() {
    let look = [
        ("mouthFunnel", 0.4),
        ("browInnerUp", 0.6),
        ("mouthSmileLeft", 0.8),
        ("mouthClose", 0.5),
        ("jawOpen", 0.3),
        ("eyeBlinkRight", 0.2),
    ];
    let names = ["LipFunnelUpperLeft", "LipFunnelLowerRight", "BrowInnerUpLeft", "BrowInnerUpRight"];
    assert_eq!(numbers(&look, names), [0.4, 0.4, 0.6, 0.6]);
    let names = ["MouthCornerPullLeft", "MouthCornerSlantLeft", "MouthClosed", "EyeOpenRight", "EyeOpenLeft"];
    assert_eq!(numbers(&look, names), [0.8, 0.8, 0.3, 0.8, 1.0]);
}

#[test]
fn compounds_follow_the_formulas_of_vrcfacetracking() {
    let look = [
        ("mouthSmileLeft", 0.5),
        ("mouthFrownLeft", 0.1),
        ("mouthStretchLeft", 0.3),
        ("browInnerUp", 0.5),
        ("browOuterUpLeft", 1.0),
        ("browDownLeft", 0.2),
        ("eyeBlinkLeft", 0.2),
        ("eyeWideLeft", 0.4),
        ("mouthLeft", 0.3),
        ("jawRight", 0.7),
        ("mouthUpperUpLeft", 0.4),
        ("mouthLowerDownRight", 0.8),
        ("mouthRollUpper", 0.9),
    ];
    assert_eq!(numbers(&look, ["SmileFrownLeft", "SmileSadLeft", "SmileFrown"]), [0.4, 0.2, 0.2]);
    assert_eq!(numbers(&look, ["BrowUpLeft", "BrowExpressionLeft", "EyeLidLeft"]), [0.8, 0.55, 0.7]);
    assert_eq!(numbers(&look, ["MouthX", "JawX", "MouthOpen"]), [-0.3, 0.7, 0.3]);
    // 1 - 0.4^(1/6)
    assert_eq!(numbers(&look, ["LipSuckUpperLeft", "LipSuckUpperRight"]), [0.14, 0.9]);
}

#[test]
fn eyes_and_head_are_positive_to_the_right_and_up_or_down() {
    let look = [("eyeLookOutLeft", 0.5), ("eyeLookInRight", 0.5), ("eyeLookUpLeft", 1.0)];
    assert_eq!(numbers(&look, ["EyeLeftX", "EyeRightX", "EyeLeftY", "EyeY"]), [-0.5, -0.5, 1.0, 0.5]);
    let head = |rotation| {
        let pose = Pose { rotation, ..Pose::NEUTRAL };
        let messages = first("", &Output { pose, ..output(&[]) });
        ["Head/Yaw", "Head/Pitch", "Head/Roll"].map(|name| number(&messages, name))
    };
    assert_eq!(head(poses::LEFT), [-0.33, 0.0, 0.0]);
    assert_eq!(head(poses::DOWN), [0.0, 0.22, 0.0]);
    assert_eq!(head(poses::TILTED), [0.0, 0.0, -0.11]);
}

#[test]
fn native_eyes_are_angles_in_degrees_down_and_to_the_right() {
    let look = [("eyeLookDownLeft", 1.0), ("eyeLookOutRight", 1.0), ("eyeBlinkLeft", 0.5)];
    let messages = first("native_eyes = true\n", &output(&look));
    let angles: Vec<f32> = messages["/tracking/eye/LeftRightPitchYaw"]
        .iter()
        .map(|angle| angle.clone().float().unwrap().round())
        .collect();
    assert_eq!(angles, [35.0, 0.0, 0.0, 35.0]);
    assert_eq!(messages["/tracking/eye/EyesClosedAmount"], [OscType::Float(0.25)]);
    assert!(!first("", &output(&look)).keys().any(|address| address.starts_with("/tracking")));
}

#[test]
fn binary_parameters_have_a_sign_and_bits() {
    let bits = |keys: &str, look: &[(&str, f32)], name: &str| {
        let messages = first(keys, &output(look));
        let flag = |ending: &str| messages[&format!("/avatar/parameters/v2/{name}{ending}")] == [OscType::Bool(true)];
        ["Negative", "1", "2", "4"].map(flag)
    };
    let three = "bits = 3\nfloats = false\n";
    assert_eq!(bits(three, &[("jawOpen", 0.63)], "JawOpen"), [false, true, false, true]);
    assert_eq!(bits(three, &[("jawOpen", 1.0)], "JawOpen"), [false, true, true, true]);
    assert_eq!(bits(three, &[("jawLeft", 0.5)], "JawX"), [true, false, false, true]);
    assert!(!first(three, &output(&[])).contains_key("/avatar/parameters/v2/JawOpen"), "no floats");
    assert!(!first(three, &output(&[])).contains_key("/avatar/parameters/v2/JawOpen8"));
}

#[test]
fn a_list_of_parameters_limits_what_is_sent() {
    let messages = first("parameters = \"JawOpen, SmileFrown:2\"\nprefix = \"FT/\"\n", &output(&[]));
    let addresses: Vec<&str> =
        messages.keys().filter_map(|address| address.strip_prefix("/avatar/parameters/")).collect();
    let status = ["ExpressionTrackingActive", "EyeTrackingActive", "LipTrackingActive"];
    let bits = ["FT/v2/SmileFrown1", "FT/v2/SmileFrown2", "FT/v2/SmileFrownNegative"];
    let mut want = [&status[..], &bits, &["FT/v2/JawOpen"]].concat();
    want.sort_unstable();
    assert_eq!(addresses, want);
}

#[test]
fn only_changes_are_sent_and_everything_once_a_second() {
    let (mut format, begun) = (Vrchat::new(&settings("")), Instant::now());
    let mut at = |ms, look: &[(&str, f32)]| messages(&mut format, begun + Duration::from_millis(ms), &output(look));
    let all = at(0, &[]).len();
    assert_eq!(all, 3 + PARAMETERS.len());
    assert_eq!(at(16, &[]).len(), 0);
    let changed = at(33, &[("jawOpen", 0.1)]);
    assert_eq!(changed.keys().collect::<Vec<_>>(), ["/avatar/parameters/v2/JawOpen"]);
    assert_eq!(at(50, &[("jawOpen", 0.103)]).len(), 0, "less than a step");
    assert_eq!(at(999, &[("jawOpen", 0.103)]).len(), 0);
    assert_eq!(at(1000, &[("jawOpen", 0.103)]).len(), all);
}

#[test]
fn the_status_is_false_without_a_face() {
    let mut format = Vrchat::new(&settings(""));
    let mut status = |state| {
        messages(&mut format, Instant::now(), &test_output(state)).remove("/avatar/parameters/EyeTrackingActive")
    };
    assert_eq!(status(State::Live), Some(vec![OscType::Bool(true)]));
    assert_eq!(status(State::Hold), None, "it is still true");
    assert_eq!(status(State::Decay), Some(vec![OscType::Bool(false)]));
}

#[test]
fn every_value_lies_between_minus_1_and_1() {
    for extreme in [0.0, 1.0] {
        let pose = Pose { coefficients: [extreme; 52], rotation: [0.0, 1.0, 0.0, 0.0], ..Pose::NEUTRAL };
        for (address, arguments) in first("", &Output { pose, ..output(&[]) }) {
            let value = arguments[0].clone().float().unwrap_or_default();
            let most = if address.contains("Head") { 2.0 } else { 1.0 };
            assert!(value.abs() <= most, "{address} {value}");
        }
    }
}
