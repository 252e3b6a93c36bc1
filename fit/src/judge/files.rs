//! The figures as JSON, with their intervals, and as CSV, for each person and blendshape.

use facewire::solve::BLENDSHAPES;
use serde_json::{Map, Value, json};

use super::{
    command::{Judged, NEUTRAL, Rivals},
    people::Phase,
    sheet::{Figure, Figures, Judgement, Row, rows},
};

/// Returns all figures. Those that are not defined are null.
pub fn json(judged: &[Judged]) -> Value {
    let set = |judged: &Judged| {
        let states = judged.neutral.iter().zip(NEUTRAL);
        let states: Map<_, _> = states.map(|(rivals, name)| (name.replace(' ', "_"), of_rivals(rivals))).collect();
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

fn of_rivals(rivals: &Rivals) -> Value {
    let Rivals { model, against } = rivals;
    json!({
        "model": of_judgement(model),
        "against": against.as_ref().map(of_judgement),
        "difference": against.as_ref().map(|against| differences(model, against)),
    })
}

fn key(row: Row) -> String {
    match row {
        Row::Blendshape(index) => BLENDSHAPES[index].to_owned(),
        Row::Blendshapes => "mean_of_blendshapes".to_owned(),
        Row::People => "mean_of_people".to_owned(),
    }
}

/// Returns a value for each row, phase and figure.
fn tree(value: impl Fn(Row, Phase, Figure) -> Value) -> Value {
    let figures = |row, phase: Phase| -> Map<_, _> {
        Figure::ALL.iter().map(|figure| (figure.name().to_owned(), value(row, phase, *figure))).collect()
    };
    let phases = |row| -> Map<_, _> {
        Phase::ALL.iter().map(|phase| (phase.name().to_owned(), figures(row, *phase).into())).collect()
    };
    rows().map(|row| (key(row), Value::from(phases(row)))).collect::<Map<_, _>>().into()
}

fn of_judgement(judgement: &Judgement) -> Value {
    let figures = tree(|row, phase, figure| {
        let value = judgement.sheet.get(row, phase, figure);
        let mut own = json!({ "value": value, "interval": judgement.interval(row, phase, figure) });
        if let (Row::Blendshape(shape), Some(own)) = (row, own.as_object_mut()) {
            let [mean, deviation] = judgement.spread(shape, phase, figure);
            own.insert("people".to_owned(), json!({ "mean": mean, "deviation": deviation }));
        }
        own
    });
    let person = |(person, averages): (&super::people::Person, &[Figures; Phase::ALL.len()])| {
        let named = |figures: &Figures| -> Map<_, _> {
            Figure::ALL.iter().map(|figure| (figure.name().to_owned(), json!(figures[*figure as usize]))).collect()
        };
        let mut own: Map<_, _> = Phase::ALL
            .iter()
            .map(|phase| (phase.name().to_owned(), named(&averages[*phase as usize]).into()))
            .collect();
        own.insert("person".to_owned(), json!(person.name));
        Value::from(own)
    };
    let people: Vec<Value> = judgement.people.iter().zip(&judgement.averages).map(person).collect();
    json!({ "figures": figures, "people": people })
}

fn differences(model: &Judgement, against: &Judgement) -> Value {
    tree(|row, phase, figure| {
        let (value, interval) = model.difference(against, row, phase, figure);
        json!({ "value": value, "interval": interval, "certain": interval.excludes_zero() })
    })
}

/// Returns a line for each person, blendshape and phase, with an empty cell for what is not defined.
pub fn csv(judged: &[Judged]) -> String {
    let names = Figure::ALL.map(Figure::name).join(",");
    let mut text = format!("set,neutral,model,person,blendshape,pictures,{names}\n");
    for Judged { set, neutral, .. } in judged {
        for (rivals, state) in neutral.iter().zip(["known", "not_known"]) {
            let judgements = [Some(&rivals.model), rivals.against.as_ref()].into_iter().flatten();
            for (judgement, model) in judgements.zip(["model", "against"]) {
                let lines = judgement.people.iter().flat_map(|person| {
                    let start = format!("{set},{state},{model},{}", person.name);
                    let shapes = BLENDSHAPES.iter().enumerate();
                    shapes.flat_map(move |(shape, name)| {
                        let start = format!("{start},{name}");
                        Phase::ALL.map(|phase| line(&start, phase, person.figures(shape, phase)))
                    })
                });
                text.extend(lines);
            }
        }
    }
    text
}

fn line(start: &str, phase: Phase, figures: &Figures) -> String {
    let cell = |value: &f64| if value.is_finite() { format!("{value:.6}") } else { String::new() };
    format!("{start},{},{}\n", phase.name(), figures.iter().map(cell).collect::<Vec<_>>().join(","))
}
