use anyhow::Result;
use facewire_fit::recording::*;

fn read(text: &str) -> Result<Recording> {
    Recording::of(&CsvTable::read(text.as_bytes())?, 30.0)
}

fn refusal(text: &str) -> String {
    format!("{:#}", read(text).unwrap_err())
}

#[test]
fn columns_are_found_by_name_in_any_order_and_case_and_files_without_times_use_the_given_rate() {
    let track = read("frame,time_s,state,jawLeft,jawRight\n0,0.0,live,0.1,0.2\n1,0.5,live,0.3,0.4\n").unwrap();
    let live_link = read(
        "Timecode,BlendShapeCount,JawRight,JawLeft,HeadYaw\n01:00:00:00.0,61,0.2,0.1,0\n01:00:00:30.0,61,0.4,0.3,0\n",
    );
    assert_eq!(track.curves["jawLeft"], [0.1, 0.3]);
    assert_eq!(live_link.unwrap(), track);
    assert_eq!(read("frame,jawOpen\n5,0\n8,1\n").unwrap().times_s, [0.0, 3.0 / 30.0]);
    assert_eq!(read("jawOpen\n0\n1\n").unwrap().times_s, [0.0, 1.0 / 30.0]);
    let repeated = read("time_s,jawOpen\n0,0.1\n1,0.2\n1,0.9\n2,0.3\n").unwrap();
    assert_eq!(repeated.curves["jawOpen"], [0.1, 0.2, 0.3], "a row that repeats the previous time is left out");
}

#[test]
fn values_between_rows_are_interpolated_and_there_are_none_outside() {
    let recording = read("time_s,jawOpen\n2.0,0.0\n3.0,0.5\n4.0,0.1\n").unwrap();
    let values = [0.0, 0.5, 1.5, 2.0].map(|time| recording.at("jawOpen", time).unwrap());
    let wanted = [0.0, 0.25, 0.3, 0.1];
    assert!(values.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12), "{values:?}");
    assert_eq!([-0.1, 2.1].map(|time| recording.at("jawOpen", time)), [None, None]);
    assert_eq!(recording.at("jawLeft", 1.0), None);
}

#[test]
fn errors_name_line_and_column() {
    assert!(refusal("time,x\n1,2\n").contains("no column of a blendshape: its first line begins with `time,x`"));
    assert!(refusal("jawOpen,JawOpen\n1,2\n").contains("2 columns called jawOpen"));
    assert!(refusal("time_s,jawOpen\n0,0\n1,high\n").contains("line 3, column jawOpen: `high`"));
    assert!(refusal("time_s,jawOpen\n0,0\n1,NaN\n").contains("line 3"));
    assert!(refusal("time_s,jawOpen\n1,0\n0,0\n").contains("line 3: the time goes back"));
    assert!(refusal("jawOpen\n0.5\n").contains("1 rows"));
    assert!(refusal("jawOpen,jawLeft\n0.5,0.5\n0.5\n").contains("is not a CSV file"));
}

#[test]
fn the_rate_follows_from_the_highest_frame_number_and_a_recording_may_pass_midnight() {
    let last = |highest| timecode_seconds(["00:00:00:00.0", highest, "00:00:03:15.0"].into_iter()).unwrap()[2];
    assert!((last("00:00:01:29.0") - 3.5).abs() < 1e-9);
    assert!((last("00:00:01:58.0") - 3.25).abs() < 1e-9);
    let times = timecode_seconds(["23:59:59:30.0", "00:00:00:30.0"].into_iter()).unwrap();
    assert!((times[1] - times[0] - 1.0).abs() < 1e-9, "a short one is assumed to count 60 frames a second");
}

#[test]
fn an_invalid_timecode_is_refused_with_its_line() {
    for wrong in ["12:00", "1.5", "a:b:c:d", "25:00:00:00", "00:00:00:-1"] {
        let refusal = timecode_seconds(["00:00:00:00.0", wrong].into_iter()).unwrap_err();
        assert!(format!("{refusal:#}").contains("line 3"), "{wrong}");
    }
    assert!(timecode_seconds(["00:00:00:61.0"].into_iter()).is_err());
}
