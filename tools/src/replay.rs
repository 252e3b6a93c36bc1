//! `facewire replay`: sends a recording through the links of the settings, with its original timing.

use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;
use std::time::Instant;

use clap::Args;

use crate::bench::cpu_time;
use crate::progress::{ProgressLine, ShareRead, clock};
use facewire::cli::{Failure, SettingsArgs, log, say};
use facewire::recording::{Reader, RecordingError};
use facewire::service;

const EXAMPLES: &str = "\
Examples:
  facewire replay talk.fwrec
  facewire replay talk.fwrec --repeat --config facewire.toml

The links of the settings get the recorded outputs with the original timing. [failsafe] and the links \
have their current settings, not those of the time of the recording. Stop the service first if both would \
send to the same receiver.";

#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ReplayArgs {
    /// A recording made by `facewire record`.
    file: PathBuf,
    /// Start again at the end, until Ctrl-C.
    #[arg(long)]
    repeat: bool,
    #[command(flatten)]
    settings: SettingsArgs,
}

pub fn run(args: &ReplayArgs) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    let refuse = |error: RecordingError| Failure::recording(&args.file, &error);
    let open = || {
        let file = File::open(&args.file).map_err(|error| refuse(error.into()))?;
        let read = ShareRead::of(file.metadata().map_or(0, |metadata| metadata.len()));
        let reader = Reader::new(BufReader::new(read.count(file))).map_err(refuse)?;
        Ok::<_, Failure>((reader, read))
    };
    let (mut reader, mut read) = open()?;
    let mut frames: u64 = 0;
    let begun = Instant::now();
    let cpu_before = cpu_time();
    log::start(settings.log.level);
    let mut progress = ProgressLine::new();
    let [sent, dropped] = service::replay(&settings, || {
        let mut frame = reader.next_frame().map_err(refuse)?;
        if frame.is_none() && args.repeat && frames > 0 {
            (reader, read) = open()?;
            frame = reader.next_frame().map_err(refuse)?;
        }
        frames += u64::from(frame.is_some());
        // What is repeated has no end.
        let share = read.share().filter(|_| !args.repeat);
        progress.draw(share, format_args!("{frames} frames, {} since the start", clock(begun.elapsed().as_secs())));
        Ok::<_, Failure>(frame)
    })?;
    drop(progress);
    let cpu_percent = 100.0 * cpu_time().saturating_sub(cpu_before).div_duration_f64(begun.elapsed());
    say(format_args!(
        "{frames} frames, {sent} packets sent, {dropped} dropped, {cpu_percent:.2} % of a processor core"
    ));
    Ok(())
}
