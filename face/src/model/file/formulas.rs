//! The table `formulas`: one formula for each blendshape, as in the paper.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::{ScoreTable, blendshapes, finite, missing, too_many, unknown};
use crate::model::{
    COEFFS, FeatureId, Formula, FormulaKind, FormulaSet, Formulas, MAX_FORMULA_INPUTS, MAX_MULTIPLIED, ModelError,
    Response, ScaledInput, product_index,
};

/// Formulas of all blendshapes.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormulasTable {
    /// Formulas of displacements from the wearer's neutral face.
    pub neutral_known: FormulaSetTable,
    /// Formulas of the measures themselves, for wearers whose neutral face is not known.
    pub neutral_unknown: FormulaSetTable,
}

/// Formulas of all blendshapes with their features.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormulaSetTable {
    /// Mean and standard deviation, over the faces of the fit, of each feature that a formula selects.
    pub inputs: BTreeMap<String, [f64; 2]>,
    /// Blendshapes by name.
    pub blendshapes: BTreeMap<String, FormulaTable>,
}

/// The formula of a blendshape.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormulaTable {
    /// What the formula computes.
    pub kind: FormulaKind,
    /// The transformation of the coefficient that the formula was fitted to.
    pub response: Response,
    /// The score.
    pub score: ScoreTable,
    /// The value of the formula, before its curve, for a face whose features have their means.
    pub offset: f64,
    /// Weight of each selected feature, after the feature was scaled to mean 0 and deviation 1.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub weights: BTreeMap<String, f64>,
    /// Weight of each product of two scaled features, such as `x13*y14`. Only quadratic formulas have products.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub products: BTreeMap<String, f64>,
}

impl TryFrom<&FormulasTable> for Formulas {
    type Error = ModelError;

    fn try_from(table: &FormulasTable) -> Result<Self, ModelError> {
        Ok(Self {
            neutral_known: table.neutral_known.to_set("formulas.neutral_known")?,
            neutral_unknown: table.neutral_unknown.to_set("formulas.neutral_unknown")?,
        })
    }
}

impl FormulaSetTable {
    fn to_set(&self, table: &str) -> Result<FormulaSet, ModelError> {
        let inputs_table = format!("{table}.inputs");
        let scaled = |(name, [mean, deviation]): (&String, &[f64; 2])| {
            let feature = FeatureId::from_name(name).ok_or_else(|| unknown(&inputs_table, name))?;
            if !(*deviation > 0.0) {
                return Err(ModelError::Invalid(format!(
                    "the deviation of {name:?} in {inputs_table} of the model file is not above 0; restore it or fit it \
                     again"
                )));
            }
            finite(&inputs_table, name, *deviation)?;
            let per_deviation = finite(&inputs_table, name, 1.0 / deviation)?;
            Ok(ScaledInput { feature, mean: finite(&inputs_table, name, *mean)?, per_deviation })
        };
        // Indices into the inputs are those of their names, in ascending order.
        let names: Vec<&str> = self.inputs.keys().map(String::as_str).collect();
        let index_of = |table: &str, name: &str| {
            let index = names.binary_search(&name).ok().and_then(|index| u16::try_from(index).ok());
            index.ok_or_else(|| match FeatureId::from_name(name) {
                Some(_) => missing(&format!("{inputs_table}.{name}")),
                None => unknown(table, name),
            })
        };
        let mut formulas = vec![Formula::default(); COEFFS];
        for (index, entry, found) in blendshapes(&format!("{table}.blendshapes"), &self.blendshapes)? {
            let formula = found.to_formula(&entry, index_of)?;
            formulas.get_mut(index).into_iter().for_each(|slot| slot.clone_from(&formula));
        }
        let inputs = self.inputs.iter().map(scaled).collect::<Result<_, _>>()?;
        Ok(FormulaSet { inputs, formulas: formulas.into() })
    }
}

impl FormulaTable {
    /// `index_of` returns the index of a feature that the table with the given name names.
    fn to_formula(
        &self,
        table: &str,
        index_of: impl Fn(&str, &str) -> Result<u16, ModelError>,
    ) -> Result<Formula, ModelError> {
        if self.kind != FormulaKind::Quadratic && !self.products.is_empty() {
            return Err(ModelError::Invalid(format!(
                "{table} of the model file has products, but its kind is not quadratic; restore it or fit it again"
            )));
        }
        let [weights_table, products_table] = ["weights", "products"].map(|name| format!("{table}.{name}"));
        let pair = |name| str::split_once(name, '*').ok_or_else(|| unknown(&products_table, name));
        let pairs = self.products.keys().map(|name| pair(name)).collect::<Result<Vec<_>, _>>()?;
        let multiplied: BTreeSet<&str> = pairs.iter().flat_map(|(one, other)| [*one, *other]).collect();
        let others = self.weights.keys().map(String::as_str).filter(|name| !multiplied.contains(name));
        let names: Vec<&str> = multiplied.iter().copied().chain(others).collect();
        if names.len() > MAX_FORMULA_INPUTS || multiplied.len() > MAX_MULTIPLIED {
            return Err(too_many(table));
        }
        let place = |name: &str| names.iter().position(|own| *own == name).unwrap_or(0);
        let mut products = vec![0.0; multiplied.len() * (multiplied.len() + 1) / 2];
        for ((name, weight), (one, other)) in self.products.iter().zip(&pairs) {
            let weight = finite(&products_table, name, *weight)?;
            if let Some(slot) = products.get_mut(product_index(place(one), place(other), multiplied.len())) {
                *slot += weight;
            }
        }
        let weight = |name: &&str| finite(&weights_table, name, self.weights.get(*name).copied().unwrap_or(0.0));
        let table_of = |name: &str| if multiplied.contains(name) { &products_table } else { &weights_table };
        Ok(Formula {
            kind: self.kind,
            response: self.response,
            offset: finite(table, "offset", self.offset)?,
            inputs: names.iter().map(|name| index_of(table_of(name), name)).collect::<Result<_, _>>()?,
            weights: names.iter().map(weight).collect::<Result<_, _>>()?,
            multiplied: multiplied.len(),
            products: products.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{BLENDSHAPES, ModelFile};

    /// A file in which the jaw is `0.1 + 0.2 x + 0.3 y + 0.4 x y + 0.5 y y` of two features `x` and `y`.
    fn file() -> ModelFile {
        let inputs: BTreeMap<String, [f64; 2]> =
            [("d13-14".to_owned(), [0.1, 0.5]), ("y17".to_owned(), [0.0, 2.0])].into();
        let named = |pairs: [(&str, f64); 2]| pairs.map(|(name, weight)| (name.to_owned(), weight)).into();
        let jaw = FormulaTable {
            kind: FormulaKind::Quadratic,
            offset: 0.1,
            weights: named([("d13-14", 0.2), ("y17", 0.3)]),
            products: named([("y17*d13-14", 0.4), ("y17*y17", 0.5)]),
            ..FormulaTable::default()
        };
        let blendshapes = BLENDSHAPES.iter().take(COEFFS - 1).map(|name| match *name {
            "jawOpen" => ("jawOpen".to_owned(), jaw.clone()),
            other => (other.to_owned(), FormulaTable::default()),
        });
        let set = FormulaSetTable { inputs, blendshapes: blendshapes.collect() };
        let formulas = FormulasTable { neutral_known: set.clone(), neutral_unknown: set };
        ModelFile { formulas: Some(formulas), ..ModelFile::new(String::new(), String::new()) }
    }

    fn error_of(change: impl Fn(&mut FormulaSetTable, &mut FormulaTable)) -> String {
        let mut file = file();
        let set = &mut file.formulas.as_mut().expect("formulas").neutral_unknown;
        let mut jaw = set.blendshapes.remove("jawOpen").expect("a jaw");
        change(set, &mut jaw);
        set.blendshapes.insert("jawOpen".to_owned(), jaw);
        file.to_model().expect_err("a fault was put in").to_string()
    }

    #[test]
    fn multiplied_features_come_first_and_products_find_their_places() {
        let formulas = Formulas::try_from(&file().formulas.expect("formulas")).expect("sound");
        let jaw = formulas.neutral_known.formulas.iter().find(|formula| formula.multiplied > 0).expect("the jaw");
        assert_eq!((jaw.multiplied, &*jaw.inputs, &*jaw.weights), (2, [0, 1].as_slice(), [0.2, 0.3].as_slice()));
        assert_eq!(&*jaw.products, [0.0, 0.4, 0.5], "x x, x y, y y");
    }

    #[test]
    fn a_written_file_reads_back_as_the_same_model() {
        let text = toml::to_string(&file()).expect("TOML");
        let read = ModelFile::parse(&text).expect("sound");
        assert_eq!(read, file());
        assert_eq!(read.to_model().expect("sound"), file().to_model().expect("sound"));
    }

    #[test]
    fn faults_name_the_entry() {
        let jaw = "formulas.neutral_unknown.blendshapes.jawOpen";
        let error = error_of(|_, jaw| jaw.kind = FormulaKind::Affine);
        assert!(error.contains(&format!("{jaw} of the model file has products")), "{error}");
        let error = error_of(|_, jaw| jaw.offset = f64::NAN);
        assert!(error.contains(&format!("\"offset\" in {jaw}")), "{error}");
        let error = error_of(|_, jaw| _ = jaw.weights.insert("y17".to_owned(), 1e300));
        assert!(error.contains(&format!("\"y17\" in {jaw}.weights")), "{error}");
        let error = error_of(|_, jaw| _ = jaw.weights.insert("q17".to_owned(), 1.0));
        assert!(error.contains(&format!("unknown \"q17\" in {jaw}.weights")), "{error}");
        for wrong in ["y17", "y17*q17", "y17*y17*y17", "*"] {
            let error = error_of(|_, jaw| _ = jaw.products.insert(wrong.to_owned(), 1.0));
            assert!(error.contains("unknown") && error.contains(&format!("in {jaw}.products")), "{error}");
        }
        let error = error_of(|set, _| _ = set.inputs.remove("d13-14"));
        assert!(error.contains("no formulas.neutral_unknown.inputs.d13-14"), "{error}");
        let error = error_of(|set, _| _ = set.inputs.insert("y17".to_owned(), [0.0, 0.0]));
        assert!(error.contains("deviation of \"y17\" in formulas.neutral_unknown.inputs"), "{error}");
        let error = error_of(|set, _| _ = set.blendshapes.remove("jawLeft"));
        assert!(error.contains("no formulas.neutral_unknown.blendshapes.jawLeft"), "{error}");
    }

    #[test]
    fn more_features_and_products_than_fit_are_refused() {
        let names = || (0..80).filter_map(FeatureId::from_index).map(|feature| feature.to_string());
        let inputs = |set: &mut FormulaSetTable| set.inputs.extend(names().map(|name| (name, [0.0, 1.0])));
        let wide = |set: &mut FormulaSetTable, jaw: &mut FormulaTable| {
            inputs(set);
            jaw.weights.extend(names().take(MAX_FORMULA_INPUTS).map(|name| (name, 1.0)));
        };
        assert!(error_of(wide).contains("blendshapes.jawOpen of the model file has more weights"));
        let multiplied = |set: &mut FormulaSetTable, jaw: &mut FormulaTable| {
            inputs(set);
            jaw.products.extend(names().take(MAX_MULTIPLIED).map(|name| (format!("{name}*{name}"), 1.0)));
        };
        assert!(error_of(multiplied).contains("blendshapes.jawOpen of the model file has more weights"));
    }
}
