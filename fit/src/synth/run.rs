//! `facewire-fit synth`: renders many subjects on all cores to one archive. An interrupted run can be resumed.

use std::{
    path::{Path, PathBuf},
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;

use super::{
    archive,
    assets::Assets,
    imager::Times,
    options::{SceneOptions, Sources, picture_size},
    progress::Progress,
    set::Set,
    shards::Shards,
    worker::{ROW, Setup, Worker},
};

/// Increases when the same settings give other pictures.
const EDITION: u32 = 8;

/// Arguments of `synth`.
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

/// A run of `synth`, shared by all threads.
struct Job<'a> {
    setup: &'a Setup<'a>,
    shards: &'a Shards,
    options: &'a Options,
    saved: Option<(&'a Path, usize)>,
    next: AtomicU64,
    progress: Mutex<Progress>,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<()> {
    run_until(options, true)
}

/// Renders all subjects, and writes the archive if `whole`.
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
        options.scenes.describe(options.set, &options.sources, &distribution)?
    );
    let shards = Shards::open(&options.out, &settings)?;
    let setup =
        Setup { assets: &assets, distribution: &distribution, size: [width, height], seed: options.set.seed(*seed) };
    let folder = PathBuf::from(options.save_pictures.first().map_or("", String::as_str));
    let saved = options.save_pictures.get(1).map(|count| count.parse().context("--save-pictures specs a number"));
    let saved = saved.transpose()?.map(|count| (folder.as_path(), count));
    if saved.is_some() {
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    let job = Job {
        setup: &setup,
        shards: &shards,
        options,
        saved,
        next: AtomicU64::new(0),
        progress: Mutex::new(Progress::new(options.pictures.next_multiple_of(options.per_subject))),
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

/// Joins the shards to the archive and prints a summary.
fn finish(options: &Options, shards: &Shards, subjects: u64) -> Result<()> {
    let rows = (0..subjects).map(|number| shards.numbers(number)).collect::<Result<Vec<_>>>()?;
    archive::write(&options.out, &rows, |subject| shards.appearance(subject as u64))?;
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

    /// Renders all subjects and returns the total CPU times.
    fn run_threads(&self) -> Result<Times> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = self.options.threads.unwrap_or(cores).max(1);
        std::thread::scope(|scope| {
            let running: Vec<_> = (0..threads).map(|_| scope.spawn(|| self.run_worker())).collect();
            let mut total = Times::default();
            for thread in running {
                let Ok(times) = thread.join() else { bail!("a thread panicked") };
                total += times?;
            }
            Ok(total)
        })
    }

    /// Renders one subject after another until all are done.
    fn run_worker(&self) -> Result<Times> {
        let mut worker = None;
        loop {
            let number = self.next.fetch_add(1, Ordering::Relaxed);
            if number >= self.subjects() {
                return Ok(worker.map_or(Times::default(), |worker: Worker| worker.times()));
            }
            if self.shards.has(number) {
                self.count(self.shards.numbers(number)?.len() / ROW, true);
                continue;
            }
            let ready = match worker.take() {
                Some(ready) => ready,
                None => Worker::new(self.setup)?,
            };
            let worker = worker.insert(ready);
            let rows = worker.subject(number, self.options.per_subject, self.saved_of(number))?;
            self.shards.write(number, &rows)?;
            self.count(rows.numbers.len() / ROW, false);
        }
    }

    /// Returns the folder for a subject's pictures and how many of them to save.
    fn saved_of(&self, number: u64) -> Option<(&Path, usize)> {
        let (folder, count) = self.saved?;
        let before = usize::try_from(number).unwrap_or(usize::MAX).saturating_mul(self.options.per_subject);
        (before < count).then(|| (folder, count - before))
    }

    /// Prints a warning if subjects whose pictures should be saved were rendered by an earlier run.
    fn warn_unsaved(&self) {
        let is_saved = |number: &u64| self.saved_of(*number).is_some();
        let done = (0..self.subjects()).take_while(is_saved).filter(|number| self.shards.has(*number)).count();
        if done > 0 {
            let hint = "to save them too, remove the .parts folder and start again";
            eprintln!("the pictures of {done} subjects were rendered by an earlier run and are not saved: {hint}");
        }
    }

    fn count(&self, pictures: usize, resumed: bool) {
        if let Ok(mut progress) = self.progress.lock() {
            progress.count(pictures, resumed);
        }
    }

    fn report(&self, times: Times) {
        let Ok(progress) = self.progress.lock() else { return };
        eprintln!("{}", progress.line());
        let made = progress.made().max(1) as f64;
        let [render, camera, tracking] = [times.render, times.camera, times.tracking].map(|time| time / made * 1e3);
        eprintln!(
            "CPU milliseconds a picture: render {render:.1}, camera and JPEG {camera:.1}, tracking {tracking:.1}"
        );
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use facewire::infer::NetworkFolder;

    use super::*;
    use crate::{dataset, judge, reference};

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        options: Options,
    }

    /// Returns options for a small archive in a folder called `name`, or `None` if rig or networks are missing.
    fn options(name: &str, threads: &str) -> Option<Options> {
        let shared = reference::folder();
        let (rig, curves) = (shared.join("rig"), shared.join("curves"));
        if !rig.exists() || NetworkFolder::find("").is_err() {
            reference::say_skipped("rig/, or no networks");
            return None;
        }
        let folder = std::env::temp_dir().join(format!("facewire-fit-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let [out, rig, curves] = [folder.join("faces.npz"), rig, curves].map(|path| path.display().to_string());
        let fixed = ["synth", "--pictures", "6", "--per-subject", "2", "--size", "256", "256", "--seed", "7"];
        let given = [out.as_str(), "--rig", &rig, "--curves", &curves, "--threads", threads];
        Some(Cli::parse_from(fixed.iter().chain(&given)).options)
    }

    fn made(options: &Options) -> Vec<u8> {
        run(options).expect("an archive");
        std::fs::read(&options.out).expect("the archive")
    }

    #[test]
    fn the_same_seed_gives_the_same_file_on_any_number_of_threads_and_after_an_interruption() {
        let (Some(one), Some(two), Some(cut)) = (options("one", "1"), options("two", "2"), options("cut", "1")) else {
            return;
        };
        let whole = made(&one);
        assert_eq!(whole, made(&two), "the number of threads has no influence");
        let fewer = Options { pictures: 2, ..options("cut", "1").expect("as before") };
        run_until(&fewer, false).expect("the first subject");
        assert_eq!(whole, made(&cut), "a resumed run gives the same file");
    }

    #[test]
    fn as_many_pictures_are_saved_as_requested() {
        for (wanted, name) in [(1, "one-saved"), (3, "three-saved")] {
            let Some(options) = options(name, "2") else { return };
            let folder = options.out.with_file_name("pictures");
            run(&Options { save_pictures: vec![folder.display().to_string(), wanted.to_string()], ..options })
                .expect("an archive");
            assert_eq!(std::fs::read_dir(folder).expect("a folder").count(), wanted);
        }
    }

    #[test]
    fn the_solver_finds_the_true_pose_in_rendered_faces() {
        let Some(few) = options("pose", "2") else { return };
        let options = Options { pictures: 24, per_subject: 8, size: vec![400, 400], ..few };
        run(&options).expect("an archive");
        let samples = dataset::load(&options.out).expect("a dataset");
        assert_eq!(samples.len(), 24);
        let [yaw, pitch, roll] = judge::pose_error_deg(&samples).expect("poses");
        assert!(yaw < 3.0 && pitch < 6.0 && roll < 2.0, "{yaw} {pitch} {roll}");
        let mean_turn = samples.iter().map(|sample| sample.pose_deg[0].abs()).sum::<f64>() / 24.0;
        assert!(mean_turn > 6.0, "heads must turn, or a wrong sign would go unnoticed: {mean_turn}");
    }
}
