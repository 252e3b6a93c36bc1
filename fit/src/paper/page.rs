//! `facewire-fit paper`: every table and figure of the paper in its order, ours beside its figures, as one HTML page.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use facewire_face::{BLENDSHAPES, COEFFS, Model};
use maud::{Markup, html};
use plotters::style::RGBColor;

use super::material::{Material, Signal, known};
use super::{AGAINST_ARKIT, Fitted, ambiguous, corrective, hardware, model_rows, processes, sine};
use super::{smoothers, transforms, with_papers};
use crate::compare::{self, FitOptions, Split};
use crate::curves::FRAME_US;
use crate::dataset::{self, Sample};
use crate::drawing::{
    Axis, BLUE_INK, Curve, GREEN_INK, GREY_INK, LandmarkMotion, Mark, ORANGE_INK, PURPLE_INK, curves, face,
};
use crate::evaluate::{self, align::Aligned, align::Pair};
use crate::faces::Faces;
use crate::judge::set::Clip;
use crate::output::{self, Table, figures, number};
use crate::report::{cpu, fit_chart, movement_chart, ranked_chart};
use crate::segments::{self, Pictures, Segment, kept_count};
use crate::shapes::index_of;
use crate::statistics::{EventLimits, mean, mse, subsample};
use crate::synth::options::Sources;

#[derive(Debug, Args)]
#[command(after_help = "\
What is not given is rendered into the folder --made, once: 8 minutes of CPU time, less than 1 with --quick.

Examples:
  facewire-fit paper --out paper.html
  facewire-fit paper faces/formulas/faces.npz --clips clips --out paper.html
  facewire-fit paper --rig tests/rig --curves recording.csv --quick")]
pub struct PaperArgs {
    /// Pictures of many people with true coefficients (npz of `synth`) [default: rendered]
    pub dataset: Option<PathBuf>,
    /// Pictures of one person with one expression at a time, with mouthSmileLeft and cheekPuff (npz) [default: rendered]
    #[arg(long, value_name = "FILE.npz")]
    pub avatar: Option<PathBuf>,
    /// Folder of clips with truth, as `film` makes them [default: rendered]
    #[arg(long, value_name = "DIR")]
    pub clips: Option<PathBuf>,
    /// Folder of clips of `film --script sine` [default: rendered]
    #[arg(long, value_name = "DIR")]
    pub sines: Option<PathBuf>,
    /// The page to write
    #[arg(long, value_name = "FILE", default_value = "paper.html")]
    pub out: PathBuf,
    /// Folder for what is rendered. A later run with the same options finds it there
    #[arg(long, value_name = "DIR", default_value = "paper-made")]
    pub made: PathBuf,
    /// Render and fit few pictures, to see the page and not to judge
    #[arg(long)]
    pub quick: bool,
    #[command(flatten)]
    pub sources: Sources,
    /// Solve a video and print CPU, memory and times of every frame, which the command does in a process of its own
    #[arg(long, hide = true)]
    pub measure: Option<PathBuf>,
}

/// The blendshapes of the paper's table of models.
const STANDARD: [&str; 2] = ["mouthSmileLeft", "cheekPuff"];
/// Those of its figures of segmentation, correction and smoothing.
const SEGMENTED: &str = "jawOpen";
const CORRECTED: &str = "eyeBlinkLeft";

impl PaperArgs {
    /// The options of the commands that render people, avatar, clips and sines.
    pub fn scale(&self) -> [String; 4] {
        let (people, avatar, clips, shapes) = if self.quick {
            (192, 96, "--count 2 --seconds 5 --size 320 320", " --size 320 320 --blendshapes jawOpen,eyeBlinkLeft")
        } else {
            (2400, 600, "--count 6 --seconds 14", "")
        };
        let per_subject = if self.quick { 12 } else { 10 };
        [
            format!("--pictures {people} --per-subject {per_subject} --seed 51"),
            format!(
                "--pictures {avatar} --per-subject {avatar} --seed 52 --mix single=1 --shapes {} --turn-deg 0 0 \
                 --like-reference --size 400 600",
                STANDARD.join(",")
            ),
            format!("{clips} --seed 53"),
            format!("--count 1 --script sine --seed 54{shapes}"),
        ]
    }

    /// Kinds of model that are fitted to the avatar: with --quick, those that take a moment.
    fn kinds(&self) -> Vec<String> {
        let quick = ["ols", "pca", "pls", "poly", "exp"].map(str::to_owned).to_vec();
        if self.quick { quick } else { Vec::new() }
    }
}

pub fn run(args: &PaperArgs) -> Result<()> {
    if let Some(video) = &args.measure {
        return hardware::measure(video);
    }
    output::check(&args.out)?;
    let material = Material::of(args)?;
    let model = Model::embedded_formulas();
    let samples = dataset::load(&material.people)?;
    let (known, unknown) = (Faces::new(&samples, true)?, Faces::new(&samples, false)?);
    let pictures = Pictures::new(&samples, &known)?;
    eprintln!("features of {} pictures", samples.len());
    let basis = basis_sections(&samples, &pictures, &known, &unknown)?;
    let segmented = segmentation(&pictures, &unknown, args.quick)?;
    let moving = transforms::moving(&pictures)?;
    eprintln!("Gaussian processes of {} blendshapes", moving.len());
    let (bands, coverage) = processes::bands(&pictures, &moving)?;
    let avatar = avatar_sections(args, &material)?;
    let clips = Clip::load_all(&material.clips, false)?;
    let signal = Signal::of(self::known(CORRECTED), &clips, &model);
    let terms = &model.correction.0;
    let other = self::known("mouthSmileLeft");
    let corrected = corrective::section(&signal, &terms[index_of(CORRECTED)], (other, &terms[index_of(other)]))?;
    let smoothed = smoothers::section(&clips, &model, &signal)?;
    let sines = sine::section(&Clip::load_all(&material.sines, true)?, &model)?;
    let compared = comparison(&clips, &model)?;
    let measured = hardware::section(&output::files(&material.clips, &["avi"])?, &cpu())?;
    let mut rows = basis.main_figures;
    rows.extend(main_figures(&avatar, coverage, &corrected, &smoothed, &sines, &compared, &measured));
    let summary = summary(&rows);
    print!("{}", summary.text());
    let sections = [
        ("flow", "Figure 1: the flow", flow()),
        ("basis", "Eq. 3, figure 2: the affine transformation", basis.affine),
        ("segmentation", "Eq. 4, figures 3 and 4: segmentation", segmented),
        ("transformation", "Eq. 5 and 6, figure 5: transformation", html! { (basis.transforms) (avatar.transformed) }),
        (
            "regression",
            "Figures 6 and 7, table 1: regression",
            html! { (avatar.charts) (bands_html(&bands)) (avatar.table) },
        ),
        ("correction", "Eq. 7 and 8, figure 8: corrective terms", corrected.html),
        ("smoothing", "Eq. 9 to 11, figure 9: smoothing", smoothed.html),
        ("sine", "Figure 10 (a): a sine of each coefficient", sines.html),
        ("comparison", "Figure 10 (b), table 2, eq. 12 to 14: against the truth", compared.html),
        ("pictures", "Figure 11: pictures beside avatars", not_shown()),
        ("hardware", "Figure 12: CPU, memory, response time", measured.html),
        ("ambiguous", "What is ambiguous in the paper, and what was chosen", ambiguous::section(&smoothed.excess)),
    ];
    let body = html! {
        p { "The tables and figures of \"Statistical Blendshape Calculation and Analysis for Graphics Applications\" (Li, Wang, Twombly) in its order, made by facewire's implementation of its method. The paper measured other faces: a MetaHuman, and six people recorded by an iPhone, with the curves of ARKit 6 as the truth. Here all faces are rendered, and the truth is known; agreement with ARKit is not measured. So the paper's figures give a scale, and do not tell which is better." }
        @if !material.commands.is_empty() {
            p { "Rendered by:" }
            pre.scroll { @for command in &material.commands { (command) "\n" } }
        }
        h2 id="summary" { "Main figures" }
        (summary.html())
        @for (id, title, content) in &sections { section id=(id) { h2 { (title) } (content) } }
    };
    let contents: Vec<(&str, &str)> =
        [("summary", "Main figures")].into_iter().chain(sections.iter().map(|(id, title, _)| (*id, *title))).collect();
    output::write_page(&args.out, "The paper, figure by figure", &contents, &[], &body)
}

/// The rows of the summary: a name, ours, its decimals, and the paper's.
type Row = (&'static str, f64, usize, &'static str);

fn main_figures(
    avatar: &AvatarSections,
    coverage: f64,
    corrected: &corrective::Corrected,
    smoothed: &smoothers::Smoothed,
    sines: &sine::Sines,
    compared: &Compared,
    measured: &hardware::Hardware,
) -> Vec<Row> {
    let jaw = |figure: fn(&sine::Following) -> f64| sines.jaw.as_ref().map_or(f64::NAN, figure);
    vec![
        ("OLS, SmileLeft of one avatar: R2", avatar.ols[0], 4, "0.9919"),
        ("OLS, CheekPuff of one avatar: R2", avatar.ols[1], 4, "0.9365"),
        ("held-out people in the 95 % band of a Gaussian process, %", 100.0 * coverage, 1, "not stated"),
        ("BlinkLeft, neutral face not known, raw: autocorrelation", corrected.autocorrelations[0], 3, "not stated"),
        ("same, shifted by eq. 8 as printed", corrected.autocorrelations[1], 3, "changes most"),
        ("same, shifted by a baseline that is subtracted", corrected.autocorrelations[2], 3, "changes most"),
        ("BlinkLeft at shut eyes: raw", corrected.closures[0], 2, "the last 15 % missing"),
        ("same, corrected", corrected.closures[1], 2, "full closure"),
        ("BlinkLeft, neutral face known, corrected, no filter: autocorrelation", smoothed.off, 4, "not stated"),
        ("same, gated average, N = 5", smoothed.gated[0][0][0], 4, "above that of N = 10"),
        ("same, gated average, N = 10", smoothed.gated[0][1][0], 4, "below that of N = 5"),
        ("same, eq. 11 as printed, N = 5", smoothed.gated[1][0][0], 4, "above that of N = 10"),
        ("same, eq. 11 as printed, N = 10", smoothed.gated[1][1][0], 4, "below that of N = 5"),
        ("gated average, N = 5: same value after, ms", smoothed.gated[0][0][1], 0, "59"),
        ("eq. 11 as printed, N = 5: same value after, ms", smoothed.gated[1][0][1], 0, "59"),
        ("sine of JawOpen, as sent: r", jaw(|own| own.r), 3, "a figure only"),
        ("same: amplitude", jaw(|own| own.amplitude), 2, "a figure only"),
        ("same: delay, ms", jaw(|own| own.delay_ms), 0, "a figure only"),
        ("sine of each coefficient, as sent: mean r", sines.mean.r, 3, "-"),
        ("same: mean amplitude", sines.mean.amplitude, 2, "-"),
        ("15 shapes: number that move here", compared.counts[1], 0, "15"),
        ("same, with events", compared.counts[0], 0, "15"),
        ("mean F1 of those with events", compared.means[0], 2, "0.83"),
        ("mean r of those that move", compared.means[1], 3, "0.667"),
        ("mean MSD of those that move", compared.means[2], 3, "0.019"),
        ("solver, median, ms", measured.figures[0][0], 3, "0.86"),
        ("solver, 95th percentile, ms", measured.figures[0][1], 3, "2.46"),
        ("CPU of one core, median, %", measured.figures[1][0], 1, "39.1"),
        ("memory, median, MB", measured.figures[2][0], 1, "549"),
    ]
}

fn summary(rows: &[Row]) -> Table {
    let row = |(name, value, decimals, paper): &Row| {
        vec![(*name).to_owned(), number(Some(*value), *decimals), (*paper).to_owned()]
    };
    Table::new(["figure", "facewire", "paper"], rows.iter().map(row))
}

fn flow() -> Markup {
    let stages = [
        ("X", "478 landmarks of a face mesh network", "face/src/track/"),
        ("T_a, eq. 3", "the face in a basis of eyes and nose", "face/src/solve/affine.rs"),
        ("S, eq. 4", "a few landmarks for each blendshape", "face/src/solve/features.rs"),
        (
            "T_d, eq. 5 and 6",
            "displacements and distances; roots and logits of the truth",
            "face/src/solve/formulas.rs",
        ),
        ("R", "a formula for each blendshape", "models/formulas.toml"),
        ("eq. 7 and 8", "corrective terms", "face/src/solve/correction.rs"),
        ("F, eq. 9 to 11", "a filter for each part of the face", "face/src/solve/filter.rs"),
    ];
    let rows = stages.map(|(stage, what, file)| vec![stage, what, file]);
    html! {
        p { "f_b = F(R(T_d(S(T_a(X))))): the stages in order, and where they are here." }
        div.wrapped { (Table::new(["stage", "what it does", "file"], rows).html()) }
    }
}

fn bands_html(bands: &Table) -> Markup {
    html! {
        h3 { "Bands of Gaussian processes for many people" }
        p { "Processes with an RBF kernel on the 8 best features of 300 pictures, judged on pictures of people that they never saw. The band has the noise of a single picture. Fewer than 95 % in the band mean that new people differ by more than the process thinks; more, that it is too careful." }
        (bands.html())
    }
}

fn not_shown() -> Markup {
    html! { p { "The paper shows photographs of its testers beside two avatars. This page shows no photographs of people; figure 10 and table 2 make the same comparison in numbers." } }
}

struct BasisSections {
    affine: Markup,
    transforms: Markup,
    main_figures: Vec<Row>,
}

/// Pictures of one person that figure 2 shows on top of each other.
const SHOWN_FACES: usize = 6;

fn basis_sections(samples: &[Sample], pictures: &Pictures, known: &Faces, unknown: &Faces) -> Result<BasisSections> {
    let basis = transforms::Basis::new(samples)?;
    let shapes = transforms::moving(pictures)?;
    let steps = (0..5).map(|step| basis.displacements(samples, step)).collect::<Result<Vec<_>>>()?;
    let sets: Vec<_> = transforms::STEPS.iter().zip(&steps).map(|(name, moved)| (*name, moved, false)).collect();
    let results = transforms::compared(&sets, pictures, &shapes)?;
    let mut heads = transforms::heads("after", &shapes);
    heads.insert(1, "spread".to_owned());
    let mut rows = Vec::new();
    for (step, (name, own)) in transforms::STEPS.iter().zip(&results).enumerate() {
        let mut row = result_row(name, own);
        row.insert(1, number(Some(basis.spread(samples, step)?), 3));
        rows.push(row);
    }
    let subject = samples.first().context("there are no pictures")?.subject;
    let shown: Vec<usize> =
        (0..samples.len()).filter(|row| samples[*row].subject == subject).take(SHOWN_FACES).collect();
    let drawn = (0..4).map(|step| Ok((basis_chart(&basis, &shown, step)?, BASIS_CAPTIONS[step])));
    let drawn = drawn.collect::<Result<Vec<_>>>()?;
    let mean_r = |own: &[[f64; 2]]| mean(own.iter().map(|own| own[0]));
    let mut main_figures = vec![
        ("8 features of raw landmarks: mean r", mean_r(&results[0]), 3, "a figure only"),
        ("same, after R1, R2 and R3", mean_r(&results[3]), 3, "a figure only"),
        ("8 displacements in facewire's basis: mean r", mean_r(&results[4]), 3, "not stated"),
    ];
    let affine = html! {
        (figures(&drawn, "Figure 2"))
        p { "Below, what each matrix is worth: the spread is the root mean square distance of a landmark from its place in the person's neutral face, in eye distances, over all expressions and turns of the head; r and MSE are those of a linear fit to the " (transforms::FEATURES) " displacements that correlate best, on people that the fit never saw. The paper shows the pictures and no figure." }
        (Table::new(heads, rows).html())
    };
    let moved = &steps[4];
    let sets = [
        ("landmark displacements", moved.clone(), false),
        ("distances of anchor points", transforms::anchor_distances(known), false),
        ("aspect ratios of anchor points", transforms::aspect_ratios(known, unknown), false),
        ("principal components of all landmarks", transforms::components(moved, &pictures.seen)?, true),
        ("signed logarithm of displacements", moved.map(|value| value.signum() * (value.abs() * 100.0).ln_1p()), false),
        ("squares of displacements", moved.map(|value| value * value), false),
    ];
    let sets: Vec<_> = sets.iter().map(|(name, features, is_ordered)| (*name, features, *is_ordered)).collect();
    let results = transforms::compared(&sets, pictures, &shapes)?;
    main_figures.push(("8 aspect ratios: mean r", mean_r(&results[2]), 3, "not stated"));
    main_figures.push(("8 principal components: mean r", mean_r(&results[3]), 3, "not stated"));
    let rows = sets.iter().zip(&results).map(|((name, ..), own)| result_row(name, own));
    let transforms = html! {
        p { "Eq. 5: the same linear fit to " (transforms::FEATURES) " features of each kind, the best by correlation, or the first principal components, on people that the fit never saw. Eq. 6, which transforms the truth, is in the table of kinds: \"of sqrt\" and \"of logit\". The paper names these transformations and compares them for CheekPuff alone." }
        (Table::new(transforms::heads("features", &shapes), rows).html())
    };
    Ok(BasisSections { affine, transforms, main_figures })
}

const BASIS_CAPTIONS: [&str; 4] = [
    "(a) Raw landmarks of several pictures of one person",
    "(b) After R1: the origin lies between the eyes, and their distance is 1",
    "(c) After R2: the eyes lie on the x axis, without roll and yaw",
    "(d) After R3: the nose lies in the plane of the screen, without pitch",
];

fn basis_chart(basis: &transforms::Basis, rows: &[usize], step: usize) -> Result<String> {
    let inks = [BLUE_INK, ORANGE_INK, GREY_INK];
    let points = |row: usize| -> Vec<(f64, f64)> {
        subsample(&basis.faces[row][step], 160).iter().map(|point| (point.x, point.y)).collect()
    };
    let clouds: Vec<Curve> =
        rows.iter().enumerate().map(|(at, row)| Curve::new(Mark::Dots, inks[at % inks.len()], points(*row))).collect();
    let all = || clouds.iter().flat_map(|cloud| &cloud.points);
    let range =
        |of: fn(&(f64, f64)) -> f64| [all().map(of).fold(f64::MAX, f64::min), all().map(of).fold(f64::MIN, f64::max)];
    curves(&clouds, &[Axis::linear("x", range(|p| p.0)), Axis::linear("y", range(|p| p.1))])
}

fn result_row(name: &str, results: &[[f64; 2]]) -> Vec<String> {
    let of = |at: usize| mean(results.iter().map(|own| own[at]));
    let all = [[of(0), of(1)]].into_iter().chain(results.iter().copied());
    let cells = all.flat_map(|[r, mse]| [number(Some(r), 3), number(Some(mse), 4)]);
    [name.to_owned()].into_iter().chain(cells).collect()
}

fn segmentation(pictures: &Pictures, unknown: &Faces, quick: bool) -> Result<Markup> {
    let shape = index_of(SEGMENTED);
    let segment = segments::segments(pictures, &[shape], kept_count(2.0), if quick { 40 } else { 200 })?;
    let segment: &Segment = segment.first().context("the jaw does not move")?;
    let motion = LandmarkMotion::new(pictures.known, unknown, &pictures.seen)?;
    let truth = pictures.known.truth(shape, &pictures.seen);
    let found = motion.correlations(&truth);
    let chosen = segments::tables::landmarks(segment.kept());
    let by_value = |a: &(usize, &f64), b: &(usize, &f64)| a.1.total_cmp(b.1);
    let (least, _) = found.iter().enumerate().min_by(by_value).context("there are no landmarks")?;
    let (most, highest) = found.iter().enumerate().max_by(by_value).context("there are no landmarks")?;
    let heat = format!("Figure 3 (a): correlation of each landmark, black 0, yellow {highest:.2}; rings: kept");
    let drawn = [
        (face(&motion.positions, &found, &chosen)?, heat.as_str()),
        (
            movement_chart(&motion.movement(most, &truth), &motion.movement(least, &truth))?,
            "Figure 3 (b): the landmark that correlates most (blue) and least (orange)",
        ),
        (segments::tables::order(segment)?, "Figure 4 (a): features by rank; those up to the line are kept"),
        (segments::tables::ranks(segment, (0, 1))?, "Figure 4 (b): ranks by correlation and by partial F"),
        (segments::tables::ranks(segment, (0, 2))?, "Figure 4 (c): ranks by correlation and by support vectors"),
        (segments::tables::ranks(segment, (1, 2))?, "Figure 4 (d): ranks by partial F and by support vectors"),
    ];
    Ok(html! {
        p { (SEGMENTED) ": " (segment.count) " of " (segment.r.len()) " features are kept, the top 2 percent by correlation. The paper discards 95 to 99 %. It finds good agreement between the rankings; the table says how far ours agree." }
        (figures(&drawn, "Figures 3 and 4"))
        (segments::tables::summary(std::slice::from_ref(segment)).html())
    })
}

struct AvatarSections {
    transformed: Markup,
    /// Figures 6 and 7.
    charts: Markup,
    table: Markup,
    /// R2 of OLS for [`STANDARD`].
    ols: [f64; 2],
}

/// Fits every kind to each of [`STANDARD`], on pictures of one person that show it or the neutral face.
fn avatar_sections(args: &PaperArgs, material: &Material) -> Result<AvatarSections> {
    let samples = dataset::load(&material.avatar)?;
    let mut tables = Vec::new();
    let (mut transformed, mut charts, mut ols) = (Vec::new(), Vec::new(), [f64::NAN; 2]);
    for (at, name) in STANDARD.into_iter().enumerate() {
        let shape = index_of(name);
        let shows = |sample: &&Sample| sample.neutral || sample.truth[shape] > 0.0;
        let own: Vec<Sample> = samples.iter().filter(shows).cloned().collect();
        let faces = Faces::new(&own, true)?;
        let split = Split::new(&own, if args.quick { 2 } else { 3 }, true)?;
        let options = FitOptions { blendshapes: vec![shape], ..FitOptions::to_kinds(args.kinds()) };
        eprintln!("{name}: kinds of model on {} pictures of one person", own.len());
        let fitted: Vec<Fitted> =
            compare::fitted(&own, &faces, &options, &split)?.into_iter().map(|(_, fitted)| fitted).collect();
        let truth = faces.truth(shape, &split.held_out);
        ols[at] = fitted.iter().find(|own| own.kind == "ols").and_then(|own| own.values[0]).unwrap_or(f64::NAN);
        let described = format!("{name}: {}", split.described().replace("; r and mse are those of", ", judged on"));
        tables.push((described, with_papers(&fitted.iter().collect::<Vec<_>>(), model_rows(name))));
        let pictures = Pictures::of_split(&own, &faces, &split);
        if at == 0 {
            charts.push(processes::simple_charts(&pictures, shape)?);
        } else {
            charts.push(processes::other_charts(&pictures, shape, errors_chart(&fitted, &truth)?)?);
            transformed = transformed_charts(&fitted, &truth)?;
        }
    }
    let captions: Vec<(String, &str)> =
        transformed.iter().map(|(svg, caption)| (svg.clone(), caption.as_str())).collect();
    Ok(AvatarSections {
        transformed: html! {
            h3 { "Figure 5: cheekPuff of one avatar" }
            (figures(&captions, "Figure 5"))
            p { "Its table is the one of " a href="#regression" { "regression" } "; the paper's MSE: exponential 0.0119, log-exponential 0.0160, polynomial 0.0134, linear 0.0163, PLS 0.0196." }
        },
        charts: html! { @for chart in &charts { (chart) } },
        table: html! {
            @for (title, table) in &tables { h3 { "Table 1, " (title) } (table.html()) }
            p { "The last rows are the paper's. DW orders the residuals by the estimate; the paper names no order. Bytes count the numbers that a board stores, the paper's those of Python objects." }
        },
        ols,
    })
}

/// Kinds whose squared errors figure 7 (d) compares, and the largest error that it shows.
const ERRORS: [(&str, RGBColor); 4] =
    [("ols", BLUE_INK), ("exp", ORANGE_INK), ("gp-rbf", PURPLE_INK), ("gb", GREEN_INK)];
const LARGEST_ERROR: f64 = 0.1;

fn errors_chart(fitted: &[Fitted], truth: &[f64]) -> Result<String> {
    let curve = |(kind, ink): &(&str, RGBColor)| {
        let own = fitted.iter().find(|own| own.kind == *kind)?;
        let mut errors: Vec<f64> = own.predictions.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).collect();
        errors.sort_by(f64::total_cmp);
        let percent = |rank: usize| 100.0 * rank as f64 / errors.len() as f64;
        let points = errors.iter().enumerate().map(|(rank, error)| (percent(rank), error.min(LARGEST_ERROR)));
        Some(Curve::new(Mark::Line, *ink, points.collect()))
    };
    let shown: Vec<Curve> = ERRORS.iter().filter_map(curve).collect();
    let axes =
        [Axis::linear("% of pictures, by error", [0.0, 100.0]), Axis::linear("squared error", [0.0, LARGEST_ERROR])];
    curves(&shown, &axes)
}

const TRANSFORMED: [&str; 5] = ["exp", "log-exp", "poly", "ols", "pls"];

fn transformed_charts(fitted: &[Fitted], truth: &[f64]) -> Result<Vec<(String, String)>> {
    let mut drawn = Vec::new();
    for name in TRANSFORMED {
        let Some(own) = fitted.iter().find(|own| own.kind == name) else { continue };
        let pairs: Vec<(f64, f64)> = own.predictions.iter().copied().zip(truth.iter().copied()).collect();
        let r2 = number(own.values[0], 3);
        drawn.push((fit_chart(&pairs)?, format!("{name}: estimate against truth, R2 = {r2}")));
        drawn.push((
            ranked_chart(&pairs)?,
            format!("{name}: estimates (dots) and truth (line) in the order of the truth"),
        ));
    }
    Ok(drawn)
}

struct Compared {
    html: Markup,
    /// Means of F1, r and MSD over the paper's shapes that move, and the numbers of those that have an F1 and an r.
    means: [f64; 3],
    counts: [f64; 2],
}

/// Seconds between clips that follow each other on one time axis.
const GAP_S: f64 = 10.0;
/// Seconds from frame to frame.
const STEP_S: f64 = FRAME_US as f64 / 1e6;
/// Frames of figure 10 (b).
const SHOWN_FRAMES: usize = 420;

/// What is sent, what it was before the filters, and the truth, of one coefficient in all clips.
type Curves = [Vec<f64>; 3];

/// Returns the times of the frames of all clips, one after the other, with the curves of every coefficient.
fn joined(clips: &[Clip], model: &Model) -> Result<(Vec<f64>, Vec<Curves>)> {
    let mut times_s = Vec::new();
    let mut all: Vec<Curves> = vec![Curves::default(); COEFFS];
    for clip in clips {
        let neutral = clip.neutral(super::material::REST_FRAMES as u64)?;
        let start_s = times_s.last().map_or(0.0, |last| last + GAP_S);
        for (frame, shown) in clip.shown(model, Some(&neutral)).iter().enumerate() {
            times_s.push(start_s + frame as f64 * STEP_S);
            for (shape, curves) in all.iter_mut().enumerate() {
                let sent = f64::from(shown.pose.coefficients[shape]);
                let corrected = shown.solution.map_or(sent, |solved| f64::from(solved.corrected.0[shape]));
                let values = [sent, corrected, clip.truth.coefficients[frame][shape]];
                curves.iter_mut().zip(values).for_each(|(curve, value)| curve.push(value));
            }
        }
    }
    Ok((times_s, all))
}

fn jaw_chart([sent, corrected, truth]: &Curves) -> Result<String> {
    let count = truth.len().min(SHOWN_FRAMES);
    let curve = |mark, ink, values: &[f64]| {
        let timed = values[..count].iter().enumerate().map(|(frame, value)| (frame as f64 * STEP_S, *value));
        Curve::new(mark, ink, timed.collect())
    };
    let shown = [
        curve(Mark::Dots, GREY_INK, corrected),
        curve(Mark::Line, BLUE_INK, sent),
        curve(Mark::Dashes, ORANGE_INK, truth),
    ];
    curves(&shown, &[Axis::linear("s", [0.0, count as f64 * STEP_S]), Axis::linear("jawOpen", [0.0, 1.0])])
}

fn comparison(clips: &[Clip], model: &Model) -> Result<Compared> {
    let (times_s, all) = joined(clips, model)?;
    let pair = |(blendshape, [sent, _, truth]): (&'static str, &Curves)| Pair {
        blendshape,
        estimate: sent.clone(),
        truth: truth.clone(),
    };
    let pairs = BLENDSHAPES.into_iter().zip(&all).map(pair).collect();
    let aligned = Aligned { times_s, shift_frames: 0, steps_s: [STEP_S; 2], pairs, unmatched: Default::default() };
    let mut scores = evaluate::all(&aligned, None, EventLimits { f_min: 0.3, tolerance_s: 0.5 });
    scores.retain(|own| AGAINST_ARKIT.iter().any(|row| row.blendshape == own.blendshape));
    let means = evaluate::means(scores.iter().filter(|own| own.moves));
    let count = |has: fn(&evaluate::Score) -> bool| scores.iter().filter(|own| own.moves && has(own)).count();
    let (with_events, moving) = (count(|own| own.metrics[evaluate::F1].is_some()), count(|_| true));
    let jaw = &all[index_of("jawOpen")];
    let deviation = mean(jaw[0].iter().zip(&jaw[2]).map(|(sent, truth)| sent - truth));
    let html = html! {
        (figures(&[(jaw_chart(jaw)?, "Figure 10 (b): jawOpen before the filters (dots), as sent (blue), and the truth (dashes)")], "Figure 10 (b)"))
        p { "jawOpen over all clips: mean deviation " (number(Some(deviation), 4)) ", mean squared deviation " (number(Some(mse(&jaw[0], &jaw[2])), 4)) ". The paper against ARKit: -0.0005, and 0.007 in the text and 0.001 in its table." }
        p { "Below, " (aligned.times_s.len()) " frames of " (clips.len()) " rendered people with a known neutral face. The truth is that of the renderer, and an event is a rise of the truth to 0.3; the paper's events are annotated by eye, and its curves of reference are those of ARKit 6. Of its " (AGAINST_ARKIT.len()) " blendshapes, " (moving) " move in these clips, and " (with_events) " have events: averages are of those." }
        (evaluate::table(&scores).html())
    };
    let [pearson, .., msd, _, _, _, _, f1, _] = means.map(|value| value.unwrap_or(f64::NAN));
    Ok(Compared { html, means: [f1, pearson, msd], counts: [with_events, moving].map(|count| count as f64) })
}
