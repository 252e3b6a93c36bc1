//! `facewire-fit synth`: renders many subjects on all cores to one archive. An interrupted run can be resumed.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use clap::Args;
use rayon::ThreadPoolBuilder;

use super::archive::{self, Shards};
use super::assets::Assets;
use super::options::{SceneOptions, Set, Sources, picture_size};
use super::sample::Distribution;
use super::worker::{ROW, Times, Worker};
use crate::dataset::provenance;

/// Increases when the same settings give other pictures.
pub const EDITION: u32 = 13;

#[derive(Debug, Args)]
pub struct Options {
    /// The archive to write (npz); names.json and a text file with the settings are written beside it
    pub out: PathBuf,
    /// Number of pictures
    #[arg(long, default_value_t = 50_000)]
    pub pictures: usize,
    /// Pictures of each subject, the first of them neutral
    #[arg(long, default_value_t = 25)]
    pub per_subject: usize,
    /// Seed of the random numbers; another seed gives other people
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Set of textures and recordings to use
    #[arg(long, value_enum, default_value = "train")]
    pub set: Set,
    /// Width and height of the pictures
    #[arg(long, num_args = 2, default_values_t = [320, 320], value_names = ["WIDTH", "HEIGHT"])]
    pub size: Vec<usize>,
    /// Number of threads [default: one per core]
    #[arg(long)]
    pub threads: Option<usize>,
    /// Folder for the first N pictures; pictures of an earlier run are not saved
    #[arg(long, num_args = 2, value_names = ["DIR", "N"])]
    pub save_pictures: Vec<String>,
    #[command(flatten)]
    pub sources: Sources,
    #[command(flatten)]
    pub scenes: SceneOptions,
}

struct Job<'a> {
    assets: &'a Assets,
    distribution: &'a Distribution,
    shards: &'a Shards,
    size: [usize; 2],
    options: &'a Options,
    saved: Option<(&'a Path, usize)>,
    next: AtomicU64,
    progress: Mutex<Progress>,
}

pub fn run(options: &Options) -> Result<()> {
    run_until(options, true)
}

pub fn run_until(options: &Options, whole: bool) -> Result<()> {
    let [width, height] = picture_size(&options.size)?;
    ensure!(options.per_subject > 0 && options.pictures >= options.per_subject, "too few pictures for one subject");
    archive::check(&options.out)?;
    let moments = options.sources.curves.moments(options.set)?;
    let assets = Assets::load(&options.sources.rig)?;
    let textures = options.sources.textures(options.set, &assets.names)?;
    let distribution = options.scenes.distribution(options.set, textures, moments)?;
    let Options { seed, per_subject, .. } = options;
    let settings = format!(
        "synth edition {EDITION}, seed {seed}, set {:?}, {per_subject} pictures a subject of {width} x {height}\n{}",
        options.set,
        options.scenes.describe(options.set, &options.sources, &distribution)
    );
    let shards = Shards::open(&options.out, &settings)?;
    let folder = PathBuf::from(options.save_pictures.first().map_or("", String::as_str));
    let saved = options.save_pictures.get(1).map(|count| count.parse().context("--save-pictures specs a number"));
    let saved = saved.transpose()?.map(|count| (folder.as_path(), count));
    if saved.is_some() {
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    let job = Job {
        assets: &assets,
        distribution: &distribution,
        shards: &shards,
        size: [width, height],
        options,
        saved,
        next: AtomicU64::new(0),
        progress: Mutex::new(Progress {
            started: Instant::now(),
            said: Instant::now(),
            wanted: options.pictures.next_multiple_of(options.per_subject),
            made: 0,
            done: 0,
        }),
    };
    job.warn_unsaved();
    job.report(job.run_threads()?);
    if whole {
        finish(options, &shards, job.subjects())?;
        let text = provenance(&options.out);
        std::fs::write(&text, &settings).with_context(|| format!("cannot write {}", text.display()))?;
        shards.remove()?;
    }
    Ok(())
}

fn finish(options: &Options, shards: &Shards, subjects: u64) -> Result<()> {
    let rows = (0..subjects).map(|number| shards.numbers(number)).collect::<Result<Vec<_>>>()?;
    archive::write(&options.out, &rows, |subject| shards.appearance(subject))?;
    let pictures: usize = rows.iter().map(|rows| rows.len() / ROW).sum();
    let tries: f32 = rows.iter().flat_map(|rows| rows.chunks_exact(ROW)).filter_map(|row| row.last()).sum();
    let people = rows.iter().filter(|rows| !rows.is_empty()).count();
    let left_out = rows.len() * options.per_subject - pictures;
    eprintln!("{}: {pictures} pictures of {people} people", options.out.display());
    eprintln!("no face found: {} pictures drawn again, {left_out} left out", tries - pictures as f32);
    Ok(())
}

impl Job<'_> {
    fn subjects(&self) -> u64 {
        self.options.pictures.div_ceil(self.options.per_subject) as u64
    }

    fn run_threads(&self) -> Result<Times> {
        let threads = ThreadPoolBuilder::new().num_threads(self.options.threads.unwrap_or(0)).build()?;
        threads.broadcast(|_| self.run_worker()).into_iter().sum()
    }

    fn run_worker(&self) -> Result<Times> {
        let mut worker = None;
        loop {
            let number = self.next.fetch_add(1, Ordering::Relaxed);
            if number >= self.subjects() {
                return Ok(worker.map_or(Times::zeros(), |worker: Worker| worker.times()));
            }
            if self.shards.has(number) {
                self.count(self.shards.numbers(number)?.len() / ROW, true);
                continue;
            }
            let seed = self.options.set.seed(self.options.seed);
            let worker = match &mut worker {
                Some(worker) => worker,
                none => none.insert(Worker::new(self.assets, self.distribution, self.size, seed)?),
            };
            let rows = worker.subject(number, self.options.per_subject, self.saved_of(number))?;
            self.shards.write(number, &rows)?;
            self.count(rows.numbers.len() / ROW, false);
        }
    }

    fn saved_of(&self, number: u64) -> Option<(&Path, usize)> {
        let (folder, count) = self.saved?;
        let before = usize::try_from(number).unwrap_or(usize::MAX).saturating_mul(self.options.per_subject);
        (before < count).then(|| (folder, count - before))
    }

    fn warn_unsaved(&self) {
        let is_saved = |number: &u64| self.saved_of(*number).is_some();
        let done = (0..self.subjects()).take_while(is_saved).filter(|number| self.shards.has(*number)).count();
        if done > 0 {
            let hint = "to save them too, remove the .parts folder and start again";
            eprintln!("the pictures of {done} subjects were rendered by an earlier run and are not saved: {hint}");
        }
    }

    /// Counts pictures and prints the progress at intervals.
    fn count(&self, pictures: usize, resumed: bool) {
        let Ok(mut progress) = self.progress.lock() else { return };
        progress.done += pictures;
        progress.made += if resumed { 0 } else { pictures };
        if progress.said.elapsed().as_secs_f64() > PROGRESS_S {
            progress.said = Instant::now();
            eprintln!("{}", progress.line());
        }
    }

    fn report(&self, times: Times) {
        let Ok(progress) = self.progress.lock() else { return };
        eprintln!("{}", progress.line());
        let made = progress.made.max(1) as f64;
        let [render, camera, tracking] = times.data.0[0].map(|time| time / made * 1e3);
        eprintln!(
            "CPU milliseconds a picture: render {render:.1}, camera and JPEG {camera:.1}, tracking {tracking:.1}"
        );
    }
}

const PROGRESS_S: f64 = 5.0;

struct Progress {
    started: Instant,
    said: Instant,
    wanted: usize,
    /// Pictures that this run made, and those that are done.
    made: usize,
    done: usize,
}

impl Progress {
    fn line(&self) -> String {
        let rate = self.made as f64 / self.started.elapsed().as_secs_f64();
        let left = self.wanted.saturating_sub(self.done) as f64 / rate.max(1e-9);
        let left =
            if rate > 0.0 { format!("{:.0} min left", left / 60.0) } else { "remaining time unknown".to_owned() };
        format!("{} of {} pictures, {rate:.1} a second, {left}", self.done, self.wanted)
    }
}
