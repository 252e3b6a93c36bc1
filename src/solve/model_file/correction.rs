//! The table `correction`: the corrective terms of single blendshapes (eq. 7).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{BLENDSHAPES, finite};
use crate::solve::{
    model::correction::{Correction, CorrectiveTerms},
    model_error::ModelError,
};

/// The corrective terms of a blendshape.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorrectionTable {
    /// `beta`: what is added to the result of the regression.
    pub shift: f64,
    /// `1 - gamma`: the factor on small values.
    pub slope: f64,
    /// `1/eta`: what is added to the factor at the top of the range.
    pub lift: f64,
    /// The values at which the response function begins and ends to rise.
    pub response: [f64; 2],
}

/// Checks every name and number. Blendshapes that the table does not have keep the usual terms.
pub(super) fn read(tables: &BTreeMap<String, CorrectionTable>) -> Result<Correction, ModelError> {
    let mut all = Correction::default();
    for (name, table) in tables {
        let slot = BLENDSHAPES.iter().zip(&mut all.0).find(|(known, _)| *known == name);
        let unknown = || ModelError::Unknown { table: "correction".to_owned(), name: name.clone() };
        *slot.ok_or_else(unknown)?.1 = terms(name, table)?;
    }
    Ok(all)
}

fn terms(name: &str, table: &CorrectionTable) -> Result<CorrectiveTerms, ModelError> {
    let entry = format!("correction.{name}");
    let number = |key: &str, value| finite(&entry, key, value);
    let [from, to] = table.response;
    let terms = CorrectiveTerms {
        shift: number("shift", table.shift)?,
        slope: number("slope", table.slope)?,
        lift: number("lift", table.lift)?,
        response: [number("response", from)?, number("response", to)?],
    };
    if terms.keep_order() { Ok(terms) } else { Err(ModelError::OutOfOrder { table: entry }) }
}

impl From<&CorrectiveTerms> for CorrectionTable {
    fn from(terms: &CorrectiveTerms) -> Self {
        let [from, to] = terms.response;
        // The nearest short number reads better, and is the same number as an f32.
        let short = |number: f32| number.to_string().parse().unwrap_or_default();
        let [shift, slope, lift, from, to] = [terms.shift, terms.slope, terms.lift, from, to].map(short);
        Self { shift, slope, lift, response: [from, to] }
    }
}
