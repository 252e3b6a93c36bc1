//! `facewire replay`: sends a recording through the links of the settings, with its original timing.

use std::{path::PathBuf, time::Instant};

use clap::Args;

use crate::bench::cpu_time;
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
    let open = || Reader::open(&args.file).map_err(refuse);
    let mut reader = open()?;
    let mut frames: u64 = 0;
    let begun = Instant::now();
    let cpu_before = cpu_time();
    log::start(settings.log.level);
    let [sent, dropped] = service::replay(&settings, || {
        let mut frame = reader.next_frame().map_err(refuse)?;
        if frame.is_none() && args.repeat && frames > 0 {
            reader = open()?;
            frame = reader.next_frame().map_err(refuse)?;
        }
        frames += u64::from(frame.is_some());
        Ok::<_, Failure>(frame)
    })?;
    let cpu_percent = 100.0 * cpu_time().saturating_sub(cpu_before).div_duration_f64(begun.elapsed());
    say(format_args!(
        "{frames} frames, {sent} packets sent, {dropped} dropped, {cpu_percent:.2} % of a processor core"
    ));
    Ok(())
}
