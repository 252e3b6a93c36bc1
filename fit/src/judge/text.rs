//! The figures as tables of text.

use std::fmt::Write as _;

use anyhow::{Context, Result};
use facewire::solve::BLENDSHAPES;

use super::{
    command::{Judged, NEUTRAL, Rivals},
    people::Phase,
    sheet::{Figure, Judgement, Row, rows},
};

/// People are listed one by one if they are no more than this.
pub const LISTED_PEOPLE: usize = 50;
/// The figures that tables show of every phase.
const MAIN: [Figure; 5] = [Figure::R, Figure::Mse, Figure::Bias, Figure::Gain, Figure::Slope];
/// The two means.
const MEANS: [Row; 2] = [Row::Blendshapes, Row::People];

/// Returns all tables of one set.
pub fn of(judged: &Judged) -> Result<String> {
    let mut text = String::new();
    for (rivals, neutral) in judged.neutral.iter().zip(NEUTRAL) {
        let model = &rivals.model;
        write!(text, "{neutral}: all pictures of all people together\n{}\n", blendshapes(model))?;
        write!(text, "{neutral}: mean over people (standard deviation over people)\n{}\n", spread(model))?;
        if model.people.len() <= LISTED_PEOPLE {
            write!(text, "{neutral}: each person, mean of the blendshapes that move\n{}\n", people(model))?;
        }
        if let Some(against) = &rivals.against {
            write!(text, "{neutral}: compared with the other model\n{}\n", comparison(model, against))?;
        }
    }
    write!(text, "{}\n{}", heading(judged), summary(judged))?;
    for (rivals, neutral) in judged.neutral.iter().zip(NEUTRAL) {
        text += &resting(&rivals.model, neutral)?;
    }
    Ok(text + &judged.notes + "\n")
}

fn heading(judged: &Judged) -> String {
    let model = &judged.neutral[0].model;
    let (people, pictures, moving) = (model.people.len(), model.pictures(), model.moving());
    format!("{}: {people} people, {pictures} pictures; {moving} blendshapes move\n", judged.set)
}

/// Formats a table with aligned columns.
pub fn table(heads: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().map(|row| row[column].chars().count());
        cells.chain([heads[column].chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..heads.len()).map(width).collect();
    let line = |cells: &[String]| {
        let padded = cells.iter().zip(&widths).enumerate().map(|(column, (cell, width))| match column {
            0 => format!("| {cell:<width$} |"),
            _ => format!(" {cell:>width$} |"),
        });
        padded.collect::<String>() + "\n"
    };
    let rule: Vec<String> = widths.iter().map(|width| "-".repeat(*width)).collect();
    let heads: Vec<String> = heads.iter().map(|head| (*head).to_owned()).collect();
    line(&heads) + &line(&rule) + &rows.iter().map(|row| line(row)).collect::<String>()
}

/// Formats a figure with the decimals that suit it.
pub fn number(figure: Figure, value: f64) -> String {
    match figure {
        _ if !value.is_finite() => "-".to_owned(),
        Figure::Bias => format!("{value:+.3}"),
        Figure::Gain | Figure::Slope => format!("{value:.2}"),
        Figure::R | Figure::Resting => format!("{value:.3}"),
        _ => format!("{value:.4}"),
    }
}

/// Returns the name of a row.
pub fn name(row: Row, judgement: &Judgement) -> String {
    match row {
        Row::Blendshape(index) => BLENDSHAPES[index].to_owned(),
        Row::Blendshapes => "mean of 51".to_owned(),
        Row::People => format!("mean of {} people", judgement.people.len()),
    }
}

fn half_width(judgement: &Judgement, row: Row, figure: Figure) -> String {
    number(
        if figure == Figure::Bias { Figure::R } else { figure },
        judgement.interval(row, Phase::All, figure).half_width(),
    )
}

fn blendshapes(judgement: &Judgement) -> String {
    let heads = [
        "blendshape",
        "r",
        "+-",
        "MSE",
        "+-",
        "bias",
        "+-",
        "gain",
        "slope",
        "at rest: bias",
        "MSE",
        "moving: r",
        "MSE",
        "bias",
        "gain",
        "slope",
    ];
    let row = |row: Row| {
        let value = |phase, figure| number(figure, judgement.sheet.get(row, phase, figure));
        let mut cells = vec![name(row, judgement)];
        for figure in [Figure::R, Figure::Mse, Figure::Bias] {
            cells.extend([value(Phase::All, figure), half_width(judgement, row, figure)]);
        }
        cells.extend([Figure::Gain, Figure::Slope].map(|figure| value(Phase::All, figure)));
        cells.extend([Figure::Bias, Figure::Mse].map(|figure| value(Phase::AtRest, figure)));
        cells.extend(MAIN.map(|figure| value(Phase::Moving, figure)));
        cells
    };
    table(&heads, &rows().map(row).collect::<Vec<_>>())
}

fn spread(judgement: &Judgement) -> String {
    let row = |shape: usize| {
        let movers = judgement.people.iter().filter(|person| person.moves(shape)).count();
        let cell = |figure| {
            let [mean, deviation] = judgement.spread(shape, Phase::All, figure);
            let unsigned = if figure == Figure::Bias { Figure::R } else { figure };
            format!("{} ({})", number(figure, mean), number(unsigned, deviation))
        };
        let mut cells = vec![BLENDSHAPES[shape].to_owned(), movers.to_string()];
        cells.extend(MAIN.map(cell));
        cells
    };
    let rows: Vec<_> = (0..BLENDSHAPES.len()).map(row).collect();
    table(&["blendshape", "people who move it", "r", "MSE", "bias", "gain", "slope"], &rows)
}

fn people(judgement: &Judgement) -> String {
    let row = |person: usize| {
        let value =
            |phase: Phase, figure: Figure| number(figure, judgement.averages[person][phase as usize][figure as usize]);
        let mut cells = vec![judgement.people[person].name.clone()];
        cells.extend(MAIN.map(|figure| value(Phase::All, figure)));
        cells.extend([Figure::Bias, Figure::Mse].map(|figure| value(Phase::AtRest, figure)));
        cells.extend([Figure::R, Figure::Mse].map(|figure| value(Phase::Moving, figure)));
        cells.push(value(Phase::All, Figure::Jitter));
        cells
    };
    let heads =
        ["person", "r", "MSE", "bias", "gain", "slope", "at rest: bias", "MSE", "moving: r", "MSE", "jitter at rest"];
    table(&heads, &(0..judgement.people.len()).map(row).collect::<Vec<_>>())
}

fn comparison(model: &Judgement, against: &Judgement) -> String {
    let row = |row: Row| {
        let mut cells = vec![name(row, model)];
        for figure in [Figure::R, Figure::Mse] {
            let values = [model, against].map(|judgement| judgement.sheet.get(row, Phase::All, figure));
            cells.extend(values.map(|value| number(figure, value)));
            cells.extend(difference(model, against, row, figure));
        }
        cells
    };
    let heads = ["blendshape", "r", "other", "difference", "95 %", "", "MSE", "other", "difference", "95 %", ""];
    table(&heads, &rows().map(row).collect::<Vec<_>>())
}

/// Returns a difference, its interval, and a mark if it is certain.
fn difference(model: &Judgement, against: &Judgement, row: Row, figure: Figure) -> [String; 3] {
    let (value, interval) = model.difference(against, row, Phase::All, figure);
    let decimals = if figure == Figure::R { 3 } else { 4 };
    if !value.is_finite() {
        return ["-", "-", ""].map(str::to_owned);
    }
    let mark = if interval.excludes_zero() { "*" } else { "" };
    let ends = format!("{:+.decimals$} .. {:+.decimals$}", interval.low, interval.high);
    [format!("{value:+.decimals$}"), ends, mark.to_owned()]
}

/// Returns the means with their intervals, and the parts of the error.
fn summary(judged: &Judged) -> String {
    let heads = [
        "neutral face, mean, pictures",
        "r",
        "95 %",
        "MSE",
        "95 %",
        "= bias",
        "+ gain",
        "+ rest",
        "bias",
        "gain",
        "slope",
        "jitter",
    ];
    let row = |rivals: &Rivals, state: &str, row: Row, phase: Phase| {
        let model = &rivals.model;
        let value = |figure| number(figure, model.sheet.get(row, phase, figure));
        let ends = |figure| {
            let interval = model.interval(row, phase, figure);
            format!("{} .. {}", number(figure, interval.low), number(figure, interval.high))
        };
        let mut cells = vec![format!("{state}, {}, {}", name(row, model), phase.title())];
        cells.extend([value(Figure::R), ends(Figure::R), value(Figure::Mse), ends(Figure::Mse)]);
        cells.extend([Figure::MseOfBias, Figure::MseOfGain, Figure::MseOfRest].map(value));
        cells.extend([Figure::Bias, Figure::Gain, Figure::Slope, Figure::Jitter].map(value));
        cells
    };
    let mut lines = Vec::new();
    for (rivals, state) in judged.neutral.iter().zip(["known", "not known"]) {
        for mean in MEANS {
            lines.extend(Phase::ALL.map(|phase| row(rivals, state, mean, phase)));
        }
    }
    table(&heads, &lines)
}

/// Describes in one line the coefficients of faces that are at rest as a whole, if the set has any.
fn resting(judgement: &Judgement, neutral: &str) -> Result<String> {
    let value = |row| judgement.sheet.get(row, Phase::All, Figure::Resting);
    let all = value(Row::Blendshapes);
    if !all.is_finite() {
        return Ok(String::new());
    }
    let shapes = BLENDSHAPES.iter().enumerate().map(|(index, name)| (value(Row::Blendshape(index)), name));
    let (most, shape) = shapes.max_by(|a, b| a.0.total_cmp(&b.0)).context("there are blendshapes")?;
    let interval = judgement.interval(Row::Blendshapes, Phase::All, Figure::Resting);
    Ok(format!(
        "{neutral}: mean coefficient of turned faces at rest {all:.3} ({:.3} .. {:.3}), highest {most:.3} ({shape})\n",
        interval.low, interval.high
    ))
}
