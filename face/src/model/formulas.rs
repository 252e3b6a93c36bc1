//! The paper's own regression: for each blendshape a formula of a few selected features, as numbers and as tables of a
//! model file.
//!
//! A formula is `T(c(w x + b))`. Its features `x` have mean 0 and deviation 1 over the faces of the fit (eq. 4, 5). The
//! curve `c` depends on the kind of the formula, and `T` undoes the transformation of the coefficients that it was
//! fitted to (eq. 6). Faces with and without a known neutral face have formulas of their own.

#![allow(missing_docs, reason = "the example of `ModelFile` shows what the fields hold")]

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::file::{TOO_MANY, blendshapes, feature, finite, invalid};
use super::{COEFFS, FeatureId, ModelError};

/// Most features of a formula.
pub const MAX_FORMULA_INPUTS: usize = 64;
/// Most features of a quadratic formula that are multiplied with each other.
pub const MAX_MULTIPLIED: usize = 24;
pub const MAX_PRODUCTS: usize = MAX_MULTIPLIED * (MAX_MULTIPLIED + 1) / 2;

/// The constant that an exponential formula subtracts, because most coefficients are 0. The slopes of the steepest and
/// the flattest part of its curve are in the ratio `(1 + LIFT) / LIFT`.
pub const LIFT: f64 = 0.25;
/// Largest exponent. Coefficients end at 1, so larger exponents have no use.
pub const MAX_EXPONENT: f64 = 1.0;
/// Coefficients are clamped to this distance from 0 and 1, where the logit is infinite.
const EDGE: f64 = 0.02;

/// What a formula computes of its features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FormulaKind {
    /// `w x + b`.
    #[default]
    Affine,
    /// `exp(w x + b) - 0.25`.
    Exponential,
    /// `exp(w l + b) - 0.25` of the features' [logarithms](signed_logarithm) `l`.
    LogExponential,
    /// `w x + b` of the features and of products of two features.
    Quadratic,
}

impl FormulaKind {
    /// Applies the curve of this kind to `w x + b`.
    pub fn curve(self, sum: f64) -> f64 {
        match self {
            Self::Affine | Self::Quadratic => sum,
            Self::Exponential | Self::LogExponential => sum.min(MAX_EXPONENT).exp() - LIFT,
        }
    }
}

/// The logarithm of a displacement, which has a sign: `sign(x) ln(1 + |x|)`.
pub fn signed_logarithm(feature: f64) -> f64 {
    feature.signum() * feature.abs().ln_1p()
}

/// The transformation of the coefficients before the fit (eq. 6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Response {
    /// The coefficient itself.
    #[default]
    Plain,
    /// Its square root.
    SquareRoot,
    /// Its logit, `ln(y / (1 - y))`.
    Logit,
}

impl Response {
    /// Transforms a coefficient.
    pub fn transform(self, coefficient: f64) -> f64 {
        match self {
            Self::Plain => coefficient,
            Self::SquareRoot => coefficient.max(0.0).sqrt(),
            Self::Logit => {
                let inside = coefficient.clamp(EDGE, 1.0 - EDGE);
                (inside / (1.0 - inside)).ln()
            }
        }
    }

    /// Returns the coefficient whose transformation is `value`. The logit stretches what lies between its edges to
    /// `0..=1`.
    pub fn restore(self, value: f64) -> f64 {
        match self {
            Self::Plain => value,
            Self::SquareRoot => value.max(0.0).powi(2),
            Self::Logit => ((1.0 / (1.0 + (-value).exp()) - EDGE) / (1.0 - 2.0 * EDGE)).clamp(0.0, 1.0),
        }
    }
}

/// Formulas of all blendshapes with their features. Those of both cases take at most 256 KiB.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FormulaSet {
    pub inputs: Box<[ScaledInput]>,
    pub formulas: Box<[Formula]>,
}

/// A feature with its scale over the faces of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScaledInput {
    pub feature: FeatureId,
    pub mean: f32,
    /// The inverse of the standard deviation.
    pub per_deviation: f32,
}

/// The formula of a blendshape. The default is always 0.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Formula {
    pub kind: FormulaKind,
    pub response: Response,
    pub offset: f32,
    /// Indices into [`FormulaSet::inputs`], at most [`MAX_FORMULA_INPUTS`].
    pub inputs: Box<[u16]>,
    pub weights: Box<[f32]>,
    /// How many of the inputs, the first ones, are multiplied with each other.
    pub multiplied: usize,
    /// Weights of the products: of the first input with itself and all later ones that are multiplied, then of the
    /// second input with itself and all later ones, and so on.
    pub products: Box<[f32]>,
}

/// Index of the product of two of `multiplied` inputs in [`Formula::products`].
pub fn product_index(one: usize, other: usize, multiplied: usize) -> usize {
    let first = one.min(other);
    let second = one.max(other);
    first * multiplied - first * first.saturating_sub(1) / 2 + second - first
}

/// Formulas of all blendshapes with their features.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormulaSetTable {
    pub inputs: BTreeMap<String, [f64; 2]>,
    pub blendshapes: BTreeMap<String, FormulaTable>,
}

/// The formula of a blendshape.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormulaTable {
    pub kind: FormulaKind,
    pub response: Response,
    pub score: FormulaScoreTable,
    pub offset: f64,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub weights: BTreeMap<String, f64>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub products: BTreeMap<String, f64>,
}

/// How well a formula estimates its blendshape for subjects that the fit has not seen, by the statistics of the paper. Files
/// may lack all but the first two.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormulaScoreTable {
    pub r: f64,
    pub mse: f64,
    /// The coefficient of determination.
    pub r2: Option<f64>,
    /// Chatterjee's correlation.
    pub xi: Option<f64>,
    /// The Durbin-Watson statistic of the residuals, ordered by estimate.
    pub dw: Option<f64>,
    /// The Breusch-Pagan statistic of the residuals.
    pub bp: Option<f64>,
}

impl FormulaSetTable {
    /// Checks every name and number and lays the numbers out for the solver.
    pub(super) fn to_set(&self, table: &str) -> Result<FormulaSet, ModelError> {
        let scaled = |(name, [mean, deviation]): (&String, &[f64; 2])| {
            let entry = format!("{table}.inputs");
            let feature = feature(&entry, name)?;
            if !(finite(&entry, *deviation)? > 0.0) {
                return Err(invalid(&format!("the deviation of {name} in {entry}"), "is not above 0"));
            }
            Ok(ScaledInput { feature, mean: finite(&entry, *mean)?, per_deviation: finite(&entry, 1.0 / deviation)? })
        };
        // Indices into the inputs are those of their names, in ascending order.
        let names: Vec<&str> = self.inputs.keys().map(String::as_str).collect();
        let index_of = |entry: &str, name: &str| {
            feature(entry, name)?;
            let index = names.binary_search(&name).ok().and_then(|index| u16::try_from(index).ok());
            index.ok_or_else(|| invalid(&format!("{table}.inputs.{name}"), "is missing"))
        };
        let mut formulas = vec![Formula::default(); COEFFS];
        for (index, entry, found) in blendshapes(&format!("{table}.blendshapes"), &self.blendshapes)? {
            let formula = found.to_formula(&entry, index_of)?;
            if let Some(slot) = formulas.get_mut(index) {
                *slot = formula;
            }
        }
        let inputs = self.inputs.iter().map(scaled).collect::<Result<_, _>>()?;
        Ok(FormulaSet { inputs, formulas: formulas.into() })
    }
}

impl FormulaTable {
    /// `index_of` returns the index of a feature that the given entry names.
    fn to_formula(
        &self,
        entry: &str,
        index_of: impl Fn(&str, &str) -> Result<u16, ModelError>,
    ) -> Result<Formula, ModelError> {
        if self.kind != FormulaKind::Quadratic && !self.products.is_empty() {
            return Err(invalid(entry, "has products, but its kind is not quadratic"));
        }
        // A product without `*` is one of a feature with no name, which is unknown.
        let pairs: Vec<_> =
            self.products.keys().map(|name| name.split_once('*').unwrap_or((name.as_str(), ""))).collect();
        let multiplied: BTreeSet<&str> = pairs.iter().flat_map(|(one, other)| [*one, *other]).collect();
        let others = self.weights.keys().map(String::as_str).filter(|name| !multiplied.contains(name));
        let names: Vec<&str> = multiplied.iter().copied().chain(others).collect();
        if names.len() > MAX_FORMULA_INPUTS || multiplied.len() > MAX_MULTIPLIED {
            return Err(invalid(entry, TOO_MANY));
        }
        let inputs = names.iter().map(|name| index_of(entry, name)).collect::<Result<_, _>>()?;
        let weight = |name: &&str| finite(entry, self.weights.get(*name).copied().unwrap_or(0.0));
        let place = |name: &str| names.iter().position(|own| *own == name).unwrap_or(0);
        let mut products = vec![0.0; multiplied.len() * (multiplied.len() + 1) / 2];
        for (weight, (one, other)) in self.products.values().zip(&pairs) {
            let weight = finite(entry, *weight)?;
            let slot = products.get_mut(product_index(place(one), place(other), multiplied.len()));
            if let Some(slot) = slot {
                *slot += weight;
            }
        }
        Ok(Formula {
            kind: self.kind,
            response: self.response,
            offset: finite(entry, self.offset)?,
            inputs,
            weights: names.iter().map(weight).collect::<Result<_, _>>()?,
            multiplied: multiplied.len(),
            products: products.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::file::tests::{altered, features};
    use crate::model::{BLENDSHAPES, Cases, ModelFile, Regression};

    /// A file in which the jaw is `0.1 + 0.2 x + 0.3 y + 0.4 x y + 0.5 y y` of two features `x` and `y`.
    fn file() -> ModelFile {
        let named = |pairs: [(&str, f64); 2]| pairs.map(|(name, weight)| (name.to_owned(), weight)).into();
        let jaw = FormulaTable {
            kind: FormulaKind::Quadratic,
            offset: 0.1,
            weights: named([("d13-14", 0.2), ("y17", 0.3)]),
            products: named([("y17*d13-14", 0.4), ("y17*y17", 0.5)]),
            ..FormulaTable::default()
        };
        let modelled = BLENDSHAPES.iter().take(COEFFS - 1);
        let formula = |name: &str| if name == "jawOpen" { jaw.clone() } else { FormulaTable::default() };
        let set = FormulaSetTable {
            inputs: [("d13-14".to_owned(), [0.1, 0.5]), ("y17".to_owned(), [0.0, 2.0])].into(),
            blendshapes: modelled.map(|name| ((*name).to_owned(), formula(name))).collect(),
        };
        let formulas = Cases { neutral_known: set.clone(), neutral_unknown: set };
        ModelFile { formulas: Some(formulas), ..ModelFile::new(String::new(), String::new()) }
    }

    #[test]
    fn a_written_file_reads_back_with_multiplied_features_first_and_products_in_their_places() {
        let file = file();
        let read = ModelFile::parse(&toml::to_string(&file).expect("TOML")).expect("sound");
        assert_eq!(read, file);
        let Regression::Formulas(formulas) = file.regression().expect("sound") else { panic!("formulas") };
        let jaw = formulas.neutral_known.formulas.iter().find(|formula| formula.multiplied > 0).expect("the jaw");
        assert_eq!((jaw.multiplied, &*jaw.inputs, &*jaw.weights), (2, [0, 1].as_slice(), [0.2, 0.3].as_slice()));
        assert_eq!(&*jaw.products, [0.0, 0.4, 0.5], "x x, x y, y y");
    }

    #[test]
    fn faults_name_the_entry() {
        let jaw = "blendshapes.jawOpen";
        let weights = features(65, |name| format!("{name} = 1.0"));
        let products = features(25, |name| format!("\"{name}*{name}\" = 1.0"));
        for (entry, path, value) in [
            (jaw, "blendshapes.jawOpen.kind", "'affine'"),
            (jaw, "blendshapes.jawOpen.offset", "nan"),
            (jaw, "blendshapes.jawOpen.weights.y17", "1e300"),
            (jaw, "blendshapes.jawOpen.products.y17*y17", "inf"),
            ("\"q17\"", "blendshapes.jawOpen.weights.q17", "1.0"),
            ("\"q17\"", "blendshapes.jawOpen.products.y17*q17", "1.0"),
            ("\"\"", "blendshapes.jawOpen.products.y17", "1.0"),
            ("\"y17*y17\"", "blendshapes.jawOpen.products.y17*y17*y17", "1.0"),
            ("\"\"", "blendshapes.jawOpen.products.*", "1.0"),
            ("inputs.d13-14", "inputs.d13-14", ""),
            ("y17", "inputs.y17", "[0.0, 0.0]"),
            ("blendshapes.jawLeft", "blendshapes.jawLeft", ""),
            (jaw, "blendshapes.jawOpen.weights", &weights),
            (jaw, "blendshapes.jawOpen.products", &products),
            ("either offsets", "/inputs", "{ y17 = { neutral = 0.0, weights = [] } }"),
        ] {
            let path = path.strip_prefix('/').map_or(format!("formulas.neutral_known.{path}"), str::to_owned);
            let error = altered(&file(), &path, value);
            assert!(error.contains(entry) && error.contains("formulas"), "{path}: {error}");
        }
    }
}
