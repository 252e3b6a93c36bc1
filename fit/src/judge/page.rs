//! The page that compares two models.

mod comparison;

use anyhow::{Context, Result};
use maud::{Markup, html};

use self::comparison::{Column, Place, comparison, signed};
use super::{
    command::{Judged, NEUTRAL, Rivals},
    people::Phase,
    sheet::{Figure, Judgement, Row, rows},
    text::{LISTED_PEOPLE, name, number},
};
use crate::{
    drawing::{Axes, Axis, BLUE_INK, scatter},
    html::{RowHeader, figure, page, table},
};

/// The figures that are compared for every row.
const COMPARED: [Figure; 2] = [Figure::R, Figure::Mse];
/// The rows of means.
const MEANS: [Row; 2] = [Row::Blendshapes, Row::People];
/// The figures of each person that are charted, with the names of the axes.
const CHARTED: [(Figure, [&str; 2]); 2] =
    [(Figure::R, ["r, other model", "r, model"]), (Figure::Mse, ["MSE, other model", "MSE, model"])];

/// The same people judged with two models.
struct Pair<'a> {
    set: &'a str,
    neutral: &'static str,
    model: &'a Judgement,
    other: &'a Judgement,
}

/// Returns the whole page. `names` are those of the model and of the other model.
pub fn html(judged: &[Judged], names: &[String; 2]) -> Result<String> {
    let pairs = pairs(judged)?;
    let sections = pairs.iter().enumerate().map(|(index, pair)| pair.section(index)).collect::<Result<Vec<_>>>()?;
    let body = html! {
        header {
            h1 { "Two models on the same people" }
            p { "Model: " (names[0]) ". Other model: " (names[1]) "." }
        }
        nav aria-label="Contents" {
            a href="#overview" { "Overview" }
            a href="#guide" { "How to read it" }
            @for (index, pair) in pairs.iter().enumerate() { a.small href={ "#set" (index) } { (pair.title()) } }
        }
        main {
            h2 id="overview" { "Overview" }
            (overview(&pairs))
            (guide())
            @for section in &sections { (section) }
        }
    };
    Ok(page("two models", &body))
}

fn pairs(judged: &[Judged]) -> Result<Vec<Pair<'_>>> {
    let mut pairs = Vec::new();
    for one in judged {
        for (Rivals { model, against }, neutral) in one.neutral.iter().zip(NEUTRAL) {
            let other = against.as_ref().context("there is no other model")?;
            pairs.push(Pair { set: short(&one.set), neutral, model, other });
        }
    }
    Ok(pairs)
}

/// Returns the last two parts of a path, which tell sets apart.
fn short(path: &str) -> &str {
    path.trim_end_matches('/').rmatch_indices('/').nth(1).map_or(path, |(index, _)| &path[index + 1..])
}

fn guide() -> Markup {
    html! {
        h2 id="guide" { "How to read it" }
        dl {
            dt { "difference" }
            dd { "Model minus other model. A higher r and a lower MSE are better." }
            dt { "interval" }
            dd {
                "95 % confidence interval of the difference, by the bootstrap over people: whole people are drawn with \
                 replacement, and both models are compared on the same draws. The drawing has the same scale within a \
                 column; its middle line is 0."
            }
            dt { "better, worse" }
            dd {
                "The interval excludes 0, so that the difference is certain. Without a mark, these people are too few \
                 to tell. Of 51 blendshapes that do not differ, two or three are marked by chance."
            }
            dt { "mean of 51" }
            dd { "Mean over the blendshapes of figures of all pictures together." }
            dt { "mean of people" }
            dd { "Mean over people of each person's mean over the blendshapes that this person moves." }
            dt { "at rest, moving" }
            dd { "The pictures in which a blendshape's true coefficient is at most 0.02, and the others." }
            dt { "bias, gain, rest" }
            dd {
                "The parts of the MSE: what subtracting each person's mean error would remove, what scaling each person's \
                 estimates by the best factor would remove after that, and the remainder."
            }
        }
    }
}

/// Returns a row for every set and neutral state.
fn overview(pairs: &[Pair]) -> Markup {
    let places: Vec<_> = pairs.iter().flat_map(|pair| MEANS.map(|row| (pair, row))).collect();
    let names = places.iter().map(|(pair, row)| format!("{}, {}", pair.title(), name(*row, pair.model)));
    let column = |figure| {
        Column::new(figure, places.iter().map(|(pair, row)| Place { pair, row: *row, phase: Phase::All, figure }))
    };
    comparison("set", names, &COMPARED.map(column))
}

impl Pair<'_> {
    fn title(&self) -> String {
        format!("{}, {}", self.set, self.neutral)
    }

    fn section(&self, index: usize) -> Result<Markup> {
        let (people, pictures) = (self.model.people.len(), self.model.pictures());
        Ok(html! {
            section id={ "set" (index) } {
                h2 { (self.title()) }
                p { (people) " people, " (pictures) " pictures." }
                (self.means())
                h3 { "Where the error comes from" }
                (self.parts())
                h3 { "Blendshapes, all pictures" }
                (self.blendshapes(Phase::All, COMPARED))
                h3 { "Blendshapes at rest" }
                (self.blendshapes(Phase::AtRest, [Figure::Bias, Figure::Mse]))
                h3 { "People" }
                (self.people()?)
            }
        })
    }

    fn means(&self) -> Markup {
        let places: Vec<_> = MEANS.iter().flat_map(|row| Phase::ALL.map(|phase| (*row, phase))).collect();
        let names = places.iter().map(|(row, phase)| format!("{}, {}", name(*row, self.model), phase.title()));
        let column = |figure| {
            let places = places.iter().map(|(row, phase)| Place { pair: self, row: *row, phase: *phase, figure });
            Column::new(figure, places)
        };
        comparison("mean, pictures", names, &COMPARED.map(column))
    }

    /// Compares the other figures of the mean rows.
    fn parts(&self) -> Markup {
        let figures = [
            (Figure::MseOfBias, "MSE: bias"),
            (Figure::MseOfGain, "MSE: gain"),
            (Figure::MseOfRest, "MSE: rest"),
            (Figure::Jitter, "jitter at rest"),
            (Figure::Resting, "faces at rest: mean coefficient"),
        ];
        let is_defined = |row: Row, figure| self.model.sheet.get(row, Phase::All, figure).is_finite();
        let lines = MEANS.iter().flat_map(|row| figures.map(|(figure, title)| (*row, figure, title)));
        let lines: Vec<_> = lines.filter(|(row, figure, _)| is_defined(*row, *figure)).collect();
        let names = lines.iter().map(|(row, _, title)| format!("{}, {title}", name(*row, self.model)));
        let places =
            lines.iter().map(|(row, figure, _)| Place { pair: self, row: *row, phase: Phase::All, figure: *figure });
        comparison("mean, figure", names, &[Column::new(Figure::Mse, places)])
    }

    /// Compares the blendshapes that move, and their means.
    fn blendshapes(&self, phase: Phase, figures: [Figure; 2]) -> Markup {
        let moves = |row: &Row| !self.model.sheet.get(*row, Phase::All, Figure::R).is_nan();
        let shown: Vec<Row> = rows().filter(moves).collect();
        let column =
            |figure| Column::new(figure, shown.iter().map(|row| Place { pair: self, row: *row, phase, figure }));
        comparison("blendshape", shown.iter().map(|row| name(*row, self.model)), &figures.map(column))
    }

    /// Plots each person, and lists the people if they are few.
    fn people(&self) -> Result<Markup> {
        let charts = CHARTED.map(|(figure, axes)| Ok::<_, anyhow::Error>((self.people_chart(figure, axes)?, axes[0])));
        let charts = charts.into_iter().collect::<Result<Vec<_>>>()?;
        Ok(html! {
            div.figures {
                @for (chart, axis) in &charts { (figure(chart, "Each person. On the line, both models are equal", axis)) }
            }
            @if self.model.people.len() <= LISTED_PEOPLE { (self.people_table()) }
        })
    }

    /// Returns a figure of a person with both models.
    fn of_person(&self, person: usize, figure: Figure) -> [f64; 2] {
        [self.model, self.other].map(|judgement| judgement.averages[person][Phase::All as usize][figure as usize])
    }

    fn people_chart(&self, figure: Figure, [x, y]: [&'static str; 2]) -> Result<String> {
        let point = |person| {
            let [model, other] = self.of_person(person, figure);
            (other, model)
        };
        let points: Vec<(f64, f64)> = (0..self.model.people.len()).map(point).collect();
        let values = || points.iter().flat_map(|point| [point.0, point.1]).filter(|value| value.is_finite());
        let [least, most] = [values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max)];
        let range = if least < most { [least, most] } else { [0.0, 1.0] };
        let axes = Axes { x: Axis::linear(x, range), y: Axis::linear(y, range) };
        scatter(&[(&points, BLUE_INK)], axes, &[[(range[0], range[0]), (range[1], range[1])]])
    }

    fn people_table(&self) -> Markup {
        let cells = |person| {
            let cells = |figure| {
                let values = self.of_person(person, figure);
                values.map(|value| number(figure, value)).into_iter().chain([signed(figure, values[0] - values[1])])
            };
            COMPARED.into_iter().flat_map(cells).collect()
        };
        let row = |person: usize| (RowHeader { name: &self.model.people[person].name, link: false }, cells(person));
        let rows: Vec<_> = (0..self.model.people.len()).map(row).collect();
        table("person", &["r", "other", "difference", "MSE", "other", "difference"], &rows)
    }
}
