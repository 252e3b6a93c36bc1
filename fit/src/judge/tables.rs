//! What a judgement prints and writes: tables as text, a page that compares two models, JSON with the intervals of all
//! figures, and CSV with the figures of each person and blendshape.

use anyhow::{Context, Result};
use facewire_face::BLENDSHAPES;
use maud::{Markup, html};
use serde_json::{Map, Value, json};

use super::figures::{Figure, Figures, Judged, Judgement, NEUTRAL, Person, Phase, Rivals, Row};
use super::gaze;
use crate::drawing::{Axis, BLUE_INK, scatter};
use crate::output::{Cell, Table, figure, guide, number};
use crate::statistics::Interval;

const LISTED_PEOPLE: usize = 50;
/// The figures that tables show of every phase, and those that are compared for every row.
const MAIN: [Figure; 5] = [Figure::R, Figure::Mse, Figure::Bias, Figure::Gain, Figure::Slope];
const COMPARED: [Figure; 2] = [Figure::R, Figure::Mse];
const MEANS: [Row; 2] = [Row::Blendshapes, Row::People];
const BAR_PX: f64 = 80.0;
const MARGIN_PX: f64 = 6.0;

pub fn text(judged: &Judged) -> Result<String> {
    let mut text = String::new();
    for (Rivals { model, against }, neutral) in judged.neutral.iter().zip(NEUTRAL) {
        let mut add = |title: &str, table: Table| text += &format!("{neutral}: {title}\n{}\n", table.text());
        add("all pictures of all people together", blendshapes(model));
        if model.people.len() <= LISTED_PEOPLE {
            add("each person, mean of the blendshapes that move", people(model));
        }
        let [directions, sizes] = gaze::tables(model);
        add("direction of both eyes together, where they are open", directions);
        add("size of movements, by the size of the true one", sizes);
        if let Some(other) = against {
            let pair = Pair { model, other };
            let rows = Row::all().map(|row| (name(row, model), pair, row, Phase::All, COMPARED));
            add("compared with the other model", comparison("blendshape", &["r", "MSE"], rows));
        }
    }
    let model = &judged.neutral[0].model;
    let moving = (0..BLENDSHAPES.len()).filter(|shape| model.moves(Row::Blendshape(*shape))).count();
    let (people, pictures) = (model.people.len(), model.pictures());
    text += &format!("{}: {people} people, {pictures} pictures; {moving} blendshapes move\n\n", judged.set);
    text += &summary(judged).text();
    for (rivals, neutral) in judged.neutral.iter().zip(NEUTRAL) {
        text += &resting(&rivals.model, neutral)?;
    }
    Ok(text + &judged.notes + "\n")
}

fn name(row: Row, judgement: &Judgement) -> String {
    match row {
        Row::Blendshape(index) => BLENDSHAPES[index].to_owned(),
        Row::Blendshapes => "mean of 51".to_owned(),
        Row::People => format!("mean of {} people", judgement.people.len()),
    }
}

fn blendshapes(judgement: &Judgement) -> Table {
    let heads = ["blendshape", "r", "+-", "MSE", "+-", "bias", "+-", "gain", "slope", "at rest: bias", "MSE"];
    let heads = heads.into_iter().chain(["moving: r", "MSE", "bias", "gain", "slope"]);
    let row = |row: Row| {
        let value = |phase, figure: Figure| figure.format(judgement.get(row, phase, figure));
        let mut cells = vec![name(row, judgement)];
        for figure in [Figure::R, Figure::Mse, Figure::Bias] {
            let half_width = judgement.interval(row, Phase::All, figure).half_width();
            cells.extend([value(Phase::All, figure), number(Some(half_width), figure.decimals())]);
        }
        cells.extend([Figure::Gain, Figure::Slope].map(|figure| value(Phase::All, figure)));
        cells.extend([Figure::Bias, Figure::Mse].map(|figure| value(Phase::AtRest, figure)));
        cells.extend(MAIN.map(|figure| value(Phase::Moving, figure)));
        cells
    };
    Table::new(heads, Row::all().map(row))
}

fn people(judgement: &Judgement) -> Table {
    let row = |person: &Person| {
        let value = |phase: Phase, figure: Figure| figure.format(person.averages[phase as usize][figure as usize]);
        let mut cells = vec![person.name.clone()];
        cells.extend(MAIN.map(|figure| value(Phase::All, figure)));
        cells.extend([Figure::Bias, Figure::Mse].map(|figure| value(Phase::AtRest, figure)));
        cells.extend(COMPARED.map(|figure| value(Phase::Moving, figure)));
        cells.push(value(Phase::All, Figure::Jitter));
        cells
    };
    let heads =
        ["person", "r", "MSE", "bias", "gain", "slope", "at rest: bias", "MSE", "moving: r", "MSE", "jitter at rest"];
    Table::new(heads, judgement.people.iter().map(row))
}

fn summary(judged: &Judged) -> Table {
    let row = |judgement: &Judgement, state: &str, row: Row, phase: Phase| {
        let mut cells = vec![format!("{state}, {}, {}", name(row, judgement), phase.title())];
        cells.extend(with_intervals(judgement, row, phase));
        cells.extend(
            [Figure::Gain, Figure::Slope, Figure::Jitter].map(|own| own.format(judgement.get(row, phase, own))),
        );
        cells
    };
    let heads = ["neutral face, mean, pictures"].into_iter().chain(WITH_INTERVALS).chain(["gain", "slope", "jitter"]);
    let mut rows = Vec::new();
    for (rivals, state) in judged.neutral.iter().zip(["known", "not known"]) {
        rows.extend(MEANS.iter().flat_map(|mean| Phase::ALL.map(|phase| row(&rivals.model, state, *mean, phase))));
    }
    Table::new(heads, rows)
}

pub const WITH_INTERVALS: [&str; 8] = ["r", "95 %", "MSE", "95 %", "= bias", "+ gain", "+ rest", "bias"];

pub fn with_intervals(judgement: &Judgement, row: Row, phase: Phase) -> impl Iterator<Item = String> {
    let value = |figure: Figure| figure.format(judgement.get(row, phase, figure));
    let pairs = COMPARED.map(|figure| {
        let Interval { low, high } = judgement.interval(row, phase, figure);
        [value(figure), format!("{} .. {}", figure.format(low), figure.format(high))]
    });
    let parts = [Figure::MseOfBias, Figure::MseOfGain, Figure::MseOfRest, Figure::Bias].map(value);
    pairs.into_iter().flatten().chain(parts)
}

/// Describes in one line the coefficients of faces that are at rest as a whole, if the set has any.
fn resting(judgement: &Judgement, neutral: &str) -> Result<String> {
    let value = |row| judgement.get(row, Phase::All, Figure::Resting);
    let all = value(Row::Blendshapes);
    if !all.is_finite() {
        return Ok(String::new());
    }
    let shapes = BLENDSHAPES.iter().enumerate().map(|(index, name)| (value(Row::Blendshape(index)), name));
    let (most, shape) = shapes.max_by(|a, b| a.0.total_cmp(&b.0)).context("there are blendshapes")?;
    let Interval { low, high } = judgement.interval(Row::Blendshapes, Phase::All, Figure::Resting);
    Ok(format!(
        "{neutral}: mean coefficient of turned faces at rest {all:.3} ({low:.3} .. {high:.3}), highest {most:.3} ({shape})\n"
    ))
}

#[derive(Clone, Copy)]
struct Pair<'a> {
    model: &'a Judgement,
    other: &'a Judgement,
}

type Compared<'a, const N: usize> = (String, Pair<'a>, Row, Phase, [Figure; N]);

/// Returns a table of named rows with the figures of both models in columns with `titles`, and their differences. A
/// difference whose interval excludes 0 is marked; on a page its interval is drawn to the scale of its column.
fn comparison<'a, const N: usize>(
    first: &str,
    titles: &[&str; N],
    rows: impl Iterator<Item = Compared<'a, N>>,
) -> Table {
    let heads = titles.iter().flat_map(|title| [title, "other", "difference", "95 %", ""]);
    let compare = |own: Compared<'a, N>| {
        let (_, pair, row, phase, figures) = &own;
        let found = figures.map(|figure| pair.model.difference(pair.other, *row, *phase, figure));
        (own, found)
    };
    let rows: Vec<_> = rows.map(compare).collect();
    let reach = core::array::from_fn::<f64, N, _>(|column| {
        let ends = rows.iter().flat_map(|(_, found)| [found[column].1.low, found[column].1.high]);
        ends.filter(|end| end.is_finite()).map(f64::abs).fold(f64::MIN_POSITIVE, f64::max)
    });
    let cells = |((name, pair, row, phase, figures), found): &(Compared<N>, [(f64, Interval); N])| {
        let mut cells = vec![Cell::from(name.as_str())];
        for (figure, ((difference, interval), reach)) in figures.iter().zip(found.iter().zip(reach)) {
            let own = [pair.model, pair.other].map(|judgement| figure.format(judgement.get(*row, *phase, *figure)));
            cells.extend(own.map(Cell::from));
            cells.push(figure.signed(*difference).into());
            if difference.is_finite() {
                cells.push(format!("{} .. {}", figure.signed(interval.low), figure.signed(interval.high)).into());
                let verdict = match (interval.excludes_zero(), (*difference > 0.0) == (*figure == Figure::R)) {
                    (false, _) => "",
                    (true, true) => "better",
                    (true, false) => "worse",
                };
                let mark = if verdict.is_empty() { "" } else { "*" };
                cells.push(Cell::with_html(mark, bar(*difference, *interval, reach, verdict)));
            } else {
                cells.extend(["-", ""].map(Cell::from));
            }
        }
        cells
    };
    Table::new([first].into_iter().chain(heads), rows.iter().map(cells).collect::<Vec<_>>())
}

/// Draws an interval around its middle line, which is 0, and says whether the model is certainly better or worse.
fn bar(value: f64, interval: Interval, reach: f64, verdict: &str) -> Markup {
    let x = |value: f64| format!("{:.1}", BAR_PX / 2.0 + value / reach * (BAR_PX / 2.0 - MARGIN_PX));
    html! {
        svg class={ "bar " (verdict) } width=(BAR_PX) height="14" viewBox={ "0 0 " (BAR_PX) " 14" } aria-hidden="true" {
            line.zero x1=(x(0.0)) x2=(x(0.0)) y1="0" y2="14" {}
            line x1=(x(interval.low)) x2=(x(interval.high)) y1="7" y2="7" {}
            circle cx=(x(value)) cy="7" r="3.5" {}
        }
        span class=(verdict) { (verdict) }
    }
}

pub fn page(judged: &[Judged], names: &[String; 2]) -> Result<(Vec<String>, Markup)> {
    let mut pairs = Vec::new();
    for one in judged {
        for (Rivals { model, against }, neutral) in one.neutral.iter().zip(NEUTRAL) {
            let other = against.as_ref().context("there is no other model")?;
            pairs.push((format!("{}, {neutral}", short(&one.set)), Pair { model, other }));
        }
    }
    let means = pairs.iter().flat_map(|(title, pair)| {
        MEANS.map(|row| (format!("{title}, {}", name(row, pair.model)), *pair, row, Phase::All, COMPARED))
    });
    let overview = comparison("set", &["r", "MSE"], means).html();
    let sections = pairs.iter().map(|(title, pair)| pair.section(title)).collect::<Result<Vec<_>>>()?;
    let page = html! {
        p { "Model: " (names[0]) ". Other model: " (names[1]) "." }
        h2 id="overview" { "Overview" }
        (overview)
        (guide(&GUIDE))
        @for section in &sections { (section) }
    };
    Ok((pairs.into_iter().map(|(title, _)| title).collect(), page))
}

/// Returns the last two parts of a path, which tell sets apart.
fn short(path: &str) -> &str {
    path.trim_end_matches('/').rmatch_indices('/').nth(1).map_or(path, |(index, _)| &path[index + 1..])
}

const GUIDE: [(&str, &str); 7] = [
    ("difference", "Model minus other model. A higher r and a lower MSE are better."),
    (
        "95 %",
        "Confidence interval of the difference, by the bootstrap over people: whole people are drawn with replacement, and \
         both models are compared on the same draws. The drawing has the same scale within a column; its middle line is 0.",
    ),
    (
        "better, worse",
        "The interval excludes 0, so that the difference is certain. Without a mark, these people are too few to tell. Of \
         51 blendshapes that do not differ, two or three are marked by chance.",
    ),
    ("mean of 51", "Mean over the blendshapes of figures of all pictures together."),
    ("mean of people", "Mean over people of each person's mean over the blendshapes that this person moves."),
    ("at rest, moving", "The pictures in which a blendshape's true coefficient is at most 0.02, and the others."),
    (
        "bias, gain, rest",
        "The parts of the MSE: what subtracting each person's mean error would remove, what scaling each person's \
         estimates by the best factor would remove after that, and the remainder.",
    ),
];

impl Pair<'_> {
    fn section(self, title: &str) -> Result<Markup> {
        let model = self.model;
        let means = MEANS.iter().flat_map(|row| {
            let title = |phase: Phase| format!("{}, {}", name(*row, model), phase.title());
            Phase::ALL.map(|phase| (title(phase), self, *row, phase, COMPARED))
        });
        let parts = [
            (Figure::MseOfBias, "MSE: bias"),
            (Figure::MseOfGain, "MSE: gain"),
            (Figure::MseOfRest, "MSE: rest"),
            (Figure::Jitter, "jitter at rest"),
            (Figure::Resting, "faces at rest: mean coefficient"),
        ];
        let parts = MEANS.iter().flat_map(|row| parts.map(|(own, title)| (*row, own, title)));
        let parts = parts.filter(|(row, own, _)| model.get(*row, Phase::All, *own).is_finite());
        let parts =
            parts.map(|(row, own, title)| (format!("{}, {title}", name(row, model)), self, row, Phase::All, [own]));
        let shown = |phase: Phase, figures: [Figure; 2]| {
            let rows = Row::all().filter(|row| model.moves(*row));
            rows.map(move |row| (name(row, model), self, row, phase, figures))
        };
        let charts = [(Figure::R, ["r, other model", "r, model"]), (Figure::Mse, ["MSE, other model", "MSE, model"])];
        let charts = charts.map(|(own, axes)| Ok::<_, anyhow::Error>((self.people_chart(own, axes)?, axes[0])));
        let charts = charts.into_iter().collect::<Result<Vec<_>>>()?;
        Ok(html! {
            section id=(title) {
                h2 { (title) }
                p { (model.people.len()) " people, " (model.pictures()) " pictures." }
                (comparison("mean, pictures", &["r", "MSE"], means).html())
                h3 { "Where the error comes from" }
                (comparison("mean, figure", &["MSE"], parts).html())
                h3 { "Blendshapes, all pictures" }
                (comparison("blendshape", &["r", "MSE"], shown(Phase::All, COMPARED)).html())
                h3 { "Blendshapes at rest" }
                (comparison("blendshape", &["bias", "MSE"], shown(Phase::AtRest, [Figure::Bias, Figure::Mse])).html())
                h3 { "People" }
                div.figures {
                    @for (chart, axis) in &charts { (figure(chart, "Each person. On the line, both models are equal", axis)) }
                }
                @if model.people.len() <= LISTED_PEOPLE { (self.people_table().html()) }
            }
        })
    }

    fn of_people(self, figure: Figure) -> impl Iterator<Item = [f64; 2]> {
        let value = move |person: &Person| person.averages[Phase::All as usize][figure as usize];
        self.model.people.iter().zip(&self.other.people).map(move |(one, other)| [value(one), value(other)])
    }

    fn people_chart(self, figure: Figure, [x, y]: [&'static str; 2]) -> Result<String> {
        let points: Vec<(f64, f64)> = self.of_people(figure).map(|[model, other]| (other, model)).collect();
        let values = || points.iter().flat_map(|point| [point.0, point.1]).filter(|value| value.is_finite());
        let [least, most] = [values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max)];
        let range = if least < most { [least, most] } else { [0.0, 1.0] };
        let axes = [Axis::linear(x, range), Axis::linear(y, range)];
        scatter(&[(&points, BLUE_INK)], &axes, &[[(range[0], range[0]), (range[1], range[1])]])
    }

    fn people_table(self) -> Table {
        let [r, mse] = COMPARED
            .map(|own| self.of_people(own).map(move |[a, b]| [own.format(a), own.format(b), own.signed(a - b)]));
        let rows = self.model.people.iter().zip(r.zip(mse));
        let rows = rows.map(|(person, (r, mse))| [person.name.clone()].into_iter().chain(r).chain(mse).collect());
        Table::new(["person", "r", "other", "difference", "MSE", "other", "difference"], rows.collect::<Vec<Vec<_>>>())
    }
}

pub fn json(judged: &[Judged]) -> Value {
    let set = |judged: &Judged| {
        let state = |(Rivals { model, against }, name): (&Rivals, &str)| {
            let difference = against.as_ref().map(|against| differences(model, against));
            let against = against.as_ref().map(of_judgement);
            let own = json!({ "model": of_judgement(model), "against": against, "difference": difference });
            (name.replace(' ', "_"), own)
        };
        let states: Map<_, _> = judged.neutral.iter().zip(NEUTRAL).map(state).collect();
        let model = &judged.neutral[0].model;
        json!({
            "set": judged.set,
            "notes": judged.notes,
            "people": model.people.len(),
            "pictures": model.pictures(),
            "neutral": states,
        })
    };
    json!({ "sets": judged.iter().map(set).collect::<Vec<_>>() })
}

fn by_phase(value: impl Fn(Phase, Figure) -> Value) -> Map<String, Value> {
    let figures = |phase| Figure::all().map(|figure| (figure.name().to_owned(), value(phase, figure)));
    Phase::ALL.map(|phase| (phase.name().to_owned(), figures(phase).into_iter().collect())).into_iter().collect()
}

fn tree(value: impl Fn(Row, Phase, Figure) -> Value) -> Value {
    let key = |row| match row {
        Row::Blendshape(index) => BLENDSHAPES[index].to_owned(),
        Row::Blendshapes => "mean_of_blendshapes".to_owned(),
        Row::People => "mean_of_people".to_owned(),
    };
    Row::all().map(|row| (key(row), by_phase(|phase, figure| value(row, phase, figure)))).collect()
}

fn of_judgement(judgement: &Judgement) -> Value {
    let figure = |row, phase, figure| {
        let (value, interval) = (judgement.get(row, phase, figure), judgement.interval(row, phase, figure));
        json!({ "value": value, "interval": interval })
    };
    let person = |person: &Person| {
        let mut own = by_phase(|phase, figure| json!(person.averages[phase as usize][figure as usize]));
        own.insert("person".to_owned(), json!(person.name));
        own
    };
    json!({ "figures": tree(figure), "people": judgement.people.iter().map(person).collect::<Vec<_>>() })
}

fn differences(model: &Judgement, against: &Judgement) -> Value {
    tree(|row, phase, figure| {
        let (value, interval) = model.difference(against, row, phase, figure);
        json!({ "value": value, "interval": interval, "certain": interval.excludes_zero() })
    })
}

/// Returns a line for each person, blendshape and phase, with an empty cell for what is not defined.
pub fn csv(judged: &[Judged]) -> String {
    let names = Figure::all().map(Figure::name).join(",");
    let mut text = format!("set,neutral,model,person,blendshape,pictures,{names}\n");
    let cell = |value: &f64| if value.is_finite() { format!("{value:.6}") } else { String::new() };
    let cells = |figures: &Figures| figures.iter().map(cell).collect::<Vec<_>>().join(",");
    for Judged { set, neutral, .. } in judged {
        let states = neutral.iter().zip(["known", "not_known"]);
        let judgements = states.flat_map(|(Rivals { model, against }, state)| {
            [(state, "model", Some(model)), (state, "against", against.as_ref())]
        });
        for (state, model, judgement) in judgements {
            for person in judgement.iter().flat_map(|judgement| &judgement.people) {
                for (shape, blendshape) in BLENDSHAPES.iter().enumerate() {
                    for phase in Phase::ALL {
                        let (name, cells) = (&person.name, cells(person.figures(shape, phase)));
                        text += &format!("{set},{state},{model},{name},{blendshape},{},{cells}\n", phase.name());
                    }
                }
            }
        }
    }
    text
}
