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

/// Increases when the same settings give other pictures.
const EDITION: u32 = 11;

#[derive(Debug, Args)]
pub struct Options {
    /// The archive to write (npz); names.json and a text file with the settings are written beside it
    out: PathBuf,
    /// Number of pictures
    #[arg(long, default_value_t = 50_000)]
    pictures: usize,
    /// Pictures of each subject, the first of them neutral
    #[arg(long, default_value_t = 25)]
    per_subject: usize,
    /// Seed of the random numbers; another seed gives other people
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Set of textures and recordings to use
    #[arg(long, value_enum, default_value = "train")]
    set: Set,
    /// Width and height of the pictures
    #[arg(long, num_args = 2, default_values_t = [320, 320], value_names = ["WIDTH", "HEIGHT"])]
    size: Vec<usize>,
    /// Number of threads [default: one per core]
    #[arg(long)]
    threads: Option<usize>,
    /// Folder for the first N pictures; pictures of an earlier run are not saved
    #[arg(long, num_args = 2, value_names = ["DIR", "N"])]
    save_pictures: Vec<String>,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    scenes: SceneOptions,
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

fn run_until(options: &Options, whole: bool) -> Result<()> {
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

/// Returns the text file beside an archive with the settings of its pictures. Its first line is a summary.
pub fn provenance(archive: &Path) -> PathBuf {
    archive.with_extension("txt")
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

#[cfg(test)]
mod tests {
    use clap::Parser;
    use facewire_face::BLENDSHAPES;
    use tempfile::TempDir;

    use crate::{dataset, faces, reference};

    use super::*;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        options: Options,
    }

    fn options(folder: &Path, threads: &str) -> Options {
        let [out, curves] = ["faces.npz", "curves.csv"].map(|name| folder.join(name));
        let wave = |frame: usize, shape: usize| (0.07 * (frame * (1 + shape % 5) + 14 * shape) as f64).sin();
        let row = |frame| (0..BLENDSHAPES.len()).map(move |shape| format!("{:.3}", wave(frame, shape).max(0.0) / 2.0));
        let rows = (0..200).map(|frame| row(frame).collect::<Vec<_>>().join(",")).collect::<Vec<_>>();
        std::fs::write(&curves, format!("{}\n{}\n", BLENDSHAPES.join(","), rows.join("\n"))).expect("written");
        let [out, curves] = [out, curves].map(|path| path.display().to_string());
        let fixed = ["synth", "--pictures", "6", "--per-subject", "2", "--size", "256", "256", "--seed", "7"];
        let given = [out.as_str(), "--rig", reference::RIG, "--curves", &curves, "--threads", threads];
        Cli::parse_from(fixed.iter().chain(&given)).options
    }

    fn made(options: &Options) -> Vec<u8> {
        run(options).expect("an archive");
        std::fs::read(&options.out).expect("the archive")
    }

    #[test]
    fn the_same_seed_gives_the_same_file_on_any_number_of_threads_and_after_an_interruption() {
        let folders = [(); 3].map(|()| tempfile::tempdir().expect("a folder"));
        let [one, two, cut] = folders.each_ref().map(TempDir::path);
        let whole = made(&options(one, "1"));
        let saved = two.join("pictures");
        let save_pictures = vec![saved.display().to_string(), "3".to_owned()];
        assert_eq!(whole, made(&Options { save_pictures, ..options(two, "2") }), "threads have no influence");
        assert_eq!(std::fs::read_dir(saved).expect("a folder").count(), 3, "as many are saved as requested");
        run_until(&Options { pictures: 2, ..options(cut, "1") }, false).expect("the first subject");
        assert_eq!(whole, made(&options(cut, "1")), "a resumed run gives the same file");
    }

    #[test]
    fn the_solver_finds_the_true_pose_in_rendered_faces() {
        let folder = tempfile::tempdir().expect("a folder");
        let few = options(folder.path(), "2");
        let options = Options { pictures: 24, per_subject: 8, size: vec![400, 400], ..few };
        run(&options).expect("an archive");
        let samples = dataset::load(&options.out).expect("a dataset");
        assert_eq!(samples.len(), 24);
        let [yaw, pitch, roll] = faces::pose_error_deg(&samples).expect("poses");
        assert!(yaw < 3.0 && pitch < 6.0 && roll < 2.0, "{yaw} {pitch} {roll}");
        let mean_turn = samples.iter().map(|sample| sample.pose_deg[0].abs()).sum::<f64>() / 24.0;
        assert!(mean_turn > 6.0, "heads must turn, or a wrong sign would go unnoticed: {mean_turn}");
    }
}
