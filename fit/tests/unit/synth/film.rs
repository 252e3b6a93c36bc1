use clap::Parser;
use facewire::capture::{AviSource, FrameRate, Source};
use facewire_fit::synth::film::*;

#[derive(Debug, Parser)]
struct Cli {
    #[command(flatten)]
    options: Options,
}

#[test]
fn with_a_count_the_clips_have_numbers_and_options_that_have_no_effect_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("clips").display().to_string();
    let options = Cli::try_parse_from(["film", &out, "--count", "11"]).expect("no --truth needed").options;
    let files = files(&options).expect("a folder");
    assert_eq!(files.len(), 11);
    assert!(files[0][0].ends_with("clips/01.avi") && files[10][1].ends_with("clips/11.csv"));
    assert!(Cli::try_parse_from(["film", "a.avi"]).is_err_and(|error| error.to_string().contains("--truth")));
    let parsed = |option: &[&str]| Cli::try_parse_from([&["film", "a.avi", "--truth", "a.csv"], option].concat());
    parsed(&["--seconds", "10", "--skins", "one"]).expect("allowed");
    for option in ["--count=3", "--mix=rest=1", "--shapes=jawOpen", "--turn-deg=1"] {
        let error = parsed(&[option]).expect_err("refused").to_string();
        assert!(error.contains("unexpected argument") || error.contains("cannot be used with"), "{error}");
    }
}

#[test]
fn facewire_reads_size_rate_and_every_frame() {
    let (pixels, format) = (vec![90_u8; 64 * 48 * 3], turbojpeg::PixelFormat::RGB);
    let image = turbojpeg::Image { pixels, width: 64, pitch: 192, height: 48, format };
    let jpeg = turbojpeg::compress(image.as_deref(), 80, turbojpeg::Subsamp::Sub2x1).expect("a JPEG").to_vec();
    let film = avi(&[jpeg.clone(), jpeg.clone(), jpeg], [64, 48], 30);
    let mut source = AviSource::open(film.as_slice(), "film", FrameRate::FPS_30).expect("an AVI file");
    assert_eq!(source.frame_period_us(), Some(33_333));
    let mut count = 0;
    while let Some(frame) = source.next().expect("a frame") {
        assert_eq!(frame.picture().map(|picture| [picture.width(), picture.height()]), Some([64, 48]));
        count += 1;
    }
    assert_eq!(count, 3);
}
