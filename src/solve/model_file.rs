//! The model as a file that people can read and compare (TOML).
//!
//! ```toml
//! format = 1
//! made_by = "facewire-fit train ..."
//!
//! [neutral_known.jawOpen]
//! r = 0.95          # Pearson's, held-out subjects, after both steps
//! mse = 0.004
//!
//! [neutral_known.jawOpen.linear]        # step 1: weights of features, per eye distance
//! bias = 0.01
//! d13-14 = 1.9
//!
//! [neutral_known.jawOpen.polynomial]    # step 2: weights of clipped estimates and their products
//! bias = -0.01
//! jawOpen = 0.9
//! "jawOpen*mouthFunnel" = 0.2
//! ```

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{
    BLENDSHAPES,
    features::FeatureId,
    model_error::ModelError,
    regression::{Blendshape, Map, Model, ONE, Term},
};

/// Version of the layout.
pub(super) const FORMAT: u32 = 1;
/// The entry of both tables that is not multiplied by anything.
const BIAS: &str = "bias";
/// No landmark lies on the tongue: it has no model and stays 0.
const WITHOUT_MODEL: &str = "tongueOut";

/// The file as it is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFile {
    /// Version of the layout.
    pub format: u32,
    /// The command that made it.
    pub made_by: String,
    /// What it was fitted on, in words.
    pub fitted_on: String,
    /// Maps by blendshape, for displacements from the wearer's neutral face.
    pub neutral_known: BTreeMap<String, BlendshapeTable>,
    /// Maps by blendshape, for faces whose neutral is not known.
    pub neutral_unknown: BTreeMap<String, BlendshapeTable>,
}

/// One blendshape of a map.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlendshapeTable {
    /// Pearson's r on held-out subjects.
    pub r: f64,
    /// Mean squared error on held-out subjects.
    pub mse: f64,
    /// Weights of features.
    pub linear: BTreeMap<String, f64>,
    /// Weights of clipped estimates and of their products.
    pub polynomial: BTreeMap<String, f64>,
}

impl ModelFile {
    /// An empty file of the present format.
    #[must_use]
    pub fn new(made_by: String, fitted_on: String) -> Self {
        Self { format: FORMAT, made_by, fitted_on, neutral_known: BTreeMap::new(), neutral_unknown: BTreeMap::new() }
    }

    /// Reads a file's text.
    ///
    /// # Errors
    /// [`ModelError::WrongFormat`] or [`ModelError::Damaged`].
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        #[derive(Deserialize)]
        struct Header {
            format: u32,
        }
        let Header { format: found } = from_toml(text)?;
        if found != FORMAT {
            return Err(ModelError::WrongFormat { found });
        }
        from_toml(text)
    }

    /// Checks every name and number and lays the maps out for the solver.
    ///
    /// # Errors
    /// [`ModelError`], naming the table and the entry.
    pub fn to_model(&self) -> Result<Model, ModelError> {
        Ok(Model {
            neutral_known: map("neutral_known", &self.neutral_known)?,
            neutral_unknown: map("neutral_unknown", &self.neutral_unknown)?,
        })
    }
}

fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, ModelError> {
    toml::from_str(text).map_err(|error| {
        let before = text.get(..error.span().map_or(0, |span| span.start)).unwrap_or_default();
        ModelError::Damaged { line: 1 + before.matches('\n').count(), reason: error.message().to_owned() }
    })
}

fn map(table: &'static str, entries: &BTreeMap<String, BlendshapeTable>) -> Result<Map, ModelError> {
    if let Some(name) = entries.keys().find(|name| !BLENDSHAPES.contains(&name.as_str()) || *name == WITHOUT_MODEL) {
        return Err(ModelError::Unknown { table: table.to_owned(), name: name.clone() });
    }
    let one = |name: &&'static str| match entries.get(*name) {
        Some(entry) => blendshape(&format!("{table}.{name}"), entry),
        None if *name == WITHOUT_MODEL => Ok(Blendshape::default()),
        None => Err(ModelError::Missing { table, blendshape: name }),
    };
    Ok(Map(BLENDSHAPES.iter().map(one).collect::<Result<_, _>>()?))
}

fn blendshape(table: &str, entry: &BlendshapeTable) -> Result<Blendshape, ModelError> {
    let mut out = Blendshape::default();
    for (name, weight) in &entry.linear {
        let weight = finite(table, name, *weight)?;
        if name == BIAS {
            out.bias = weight;
            continue;
        }
        let id = FeatureId::from_name(name).ok_or_else(|| unknown(table, name))?;
        out.linear.push((id, weight)).map_err(|_| too_many(table))?;
    }
    for (name, weight) in &entry.polynomial {
        let weight = finite(table, name, *weight)?;
        let term = Term::from_name(name).ok_or_else(|| unknown(table, name))?;
        out.polynomial.push((term, weight)).map_err(|_| too_many(table))?;
    }
    Ok(out)
}

fn unknown(table: &str, name: &str) -> ModelError {
    ModelError::Unknown { table: table.to_owned(), name: name.to_owned() }
}

fn too_many(table: &str) -> ModelError {
    ModelError::TooMany { table: table.to_owned() }
}

fn finite(table: &str, name: &str, weight: f64) -> Result<f32, ModelError> {
    #[expect(clippy::cast_possible_truncation, reason = "checked below")]
    let narrow = weight as f32;
    if narrow.is_finite() {
        return Ok(narrow);
    }
    Err(ModelError::NotFinite { table: table.to_owned(), name: name.to_owned() })
}

impl Term {
    /// `bias`, the name of a blendshape, or two of them joined by `*`.
    fn from_name(name: &str) -> Option<Self> {
        let place = |name: &str| u8::try_from(BLENDSHAPES.iter().position(|known| *known == name)?).ok();
        if name == BIAS {
            return Some(Self(ONE, ONE));
        }
        match name.split_once('*') {
            Some((a, b)) => Some(Self(place(a)?, place(b)?)),
            None => Some(Self(place(name)?, ONE)),
        }
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use std::path::Path;

    const SHIPPED: &str = include_str!("../../models/blendshapes.toml");

    fn shipped() -> ModelFile {
        ModelFile::parse(SHIPPED).expect("the shipped model is sound")
    }

    fn error_of(change: impl Fn(&mut BlendshapeTable)) -> String {
        let mut file = shipped();
        change(file.neutral_known.get_mut("jawOpen").expect("it has a jaw"));
        file.to_model().expect_err("a fault was put in").to_string()
    }

    #[test]
    fn missing_file_is_named() {
        let error = Model::load(Path::new("no/such/model.toml")).expect_err("there is none").to_string();
        assert!(error.contains("no/such/model.toml"), "{error}");
    }

    #[test]
    fn damaged_file_is_refused() {
        let cut = SHIPPED.get(..SHIPPED.len() / 2).expect("plain text");
        assert!(ModelFile::parse(cut).and_then(|file| file.to_model()).is_err());
        assert!(matches!(ModelFile::parse("\nformat = [1"), Err(ModelError::Damaged { line: 2, .. })));
        assert!(matches!(ModelFile::parse("format = 1"), Err(ModelError::Damaged { .. })));
    }

    #[test]
    fn other_format_is_told_from_damage() {
        assert!(matches!(ModelFile::parse("format = 2\nnew = true"), Err(ModelError::WrongFormat { found: 2 })));
    }

    #[test]
    fn missing_and_unknown_blendshapes_are_named() {
        let mut file = shipped();
        let entry = file.neutral_unknown.remove("jawOpen").expect("it has a jaw");
        assert!(file.to_model().expect_err("no jaw").to_string().contains("neutral_unknown.jawOpen"));
        file.neutral_unknown.insert("jawOpened".to_owned(), entry);
        assert!(file.to_model().expect_err("no such jaw").to_string().contains("jawOpened"));
    }

    #[test]
    fn weight_that_is_not_finite_is_named() {
        for wrong in [f64::NAN, f64::INFINITY, 1e300] {
            let error = error_of(|table| {
                table.linear.insert("y14".to_owned(), wrong);
            });
            assert!(error.contains("y14") && error.contains("neutral_known.jawOpen"), "{error}");
        }
    }

    #[test]
    fn unknown_feature_and_term_are_named() {
        assert!(
            error_of(|table| {
                table.linear.insert("q7".to_owned(), 1.0);
            })
            .contains("q7")
        );
        assert!(
            error_of(|table| {
                table.polynomial.insert("jawOpen*q7".to_owned(), 1.0);
            })
            .contains("jawOpen*q7")
        );
    }

    #[test]
    fn errors_fill_one_line_whatever_stands_in_names() {
        for weight in [1.0, f64::NAN] {
            let error = error_of(|table| {
                table.linear.insert("line\n\u{1b}end".to_owned(), weight);
            });
            assert!(error.contains(r#""line\n\u{1b}end""#) && !error.contains(char::is_control), "{error}");
        }
    }

    #[test]
    fn more_weights_than_fit_are_refused() {
        let many = (0..478).map(|landmark| (format!("x{landmark}"), 0.1));
        assert!(error_of(|table| table.linear.extend(many.clone())).contains("more weights"));
    }
}
