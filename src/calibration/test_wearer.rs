//! A wearer for tests, who shows the coefficients that a test wants.

use std::sync::Arc;

use super::{Calibration, Guide, Observation, Refusal, Seen, Sight, Take};
use facewire_face::model::{FormulaSetTable, FormulaTable, FormulasTable, ModelFile};
use facewire_face::stages::{Residual, normalise};
use facewire_face::{BLENDSHAPES, COEFFS, Model, testing::face};

/// Coefficients by name; all others are 0.
pub(crate) type Shown<'a> = &'a [(&'a str, f32)];

pub(crate) struct Wearer {
    pub(crate) model: Arc<Model>,
    /// The coefficients of the neutral face, measured from the mean of many people.
    pub(crate) general: Vec<(&'static str, f32)>,
}

/// A model that reads nothing in the landmarks, so that the residual is all that a face shows.
pub(crate) fn blank_model() -> Model {
    blank_model_file().to_model().unwrap()
}

pub(crate) fn blank_model_file() -> ModelFile {
    let named = |name: &&str| ((*name).to_owned(), FormulaTable::default());
    let blendshapes = BLENDSHAPES.iter().filter(|name| **name != "tongueOut").map(named).collect();
    let formulas = FormulaSetTable { blendshapes, ..FormulaSetTable::default() };
    let formulas = FormulasTable { neutral_known: formulas.clone(), neutral_unknown: formulas };
    ModelFile { formulas: Some(formulas), ..ModelFile::new(String::new(), String::new()) }
}

pub(crate) const FRAME_US: u64 = 33_333;

impl Wearer {
    pub(crate) fn new() -> Self {
        Self { model: blank_model().into(), general: Vec::new() }
    }

    /// A face whose head is turned by these angles and that shows these coefficients, relative to its neutral face.
    pub(crate) fn shows(&self, head_deg: [f32; 3], shown: Shown) -> Sight {
        let face = normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).unwrap();
        let general: Vec<_> = self.general.iter().chain(shown).copied().collect();
        let residuals = [&*general, shown].map(|shown| {
            let mut residual = Residual([0.0; COEFFS]);
            for (name, value) in shown {
                residual.0[BLENDSHAPES.iter().position(|known| known == name).unwrap()] += value;
            }
            residual
        });
        Sight::Face(Seen { face, residuals, head_deg })
    }

    /// The pose of a take, performed to this extent.
    pub(crate) fn pose(&self, take: Take, extent: f32) -> Sight {
        let shown: Vec<_> = take.raises().iter().map(|name| (*name, extent)).collect();
        self.shows([0.0; 3], &shown)
    }

    /// Follows the guide from `begun_us` on: `act` says what the wearer shows in each frame, given the take and the time
    /// since the guide asked for it. Returns the outcome, and the time of the last frame.
    pub(crate) fn follow(
        guide: &mut Guide,
        begun_us: u64,
        mut act: impl FnMut(Take, f32) -> Sight,
    ) -> (Result<Calibration, Refusal>, u64) {
        let (mut time_us, mut asked) = (begun_us, (None, begun_us));
        loop {
            if let Some(outcome) = guide.outcome() {
                return (outcome, time_us);
            }
            time_us += FRAME_US;
            assert!(time_us - begun_us < 300_000_000, "the guide does not end: {:?}", guide.progress());
            let take = guide.wanted().unwrap();
            if asked.0 != Some(take) {
                asked = (Some(take), time_us);
            }
            let sight = act(take, (time_us - asked.1) as f32 / 1e6);
            guide.update(&Observation { time_us, is_dark: false, sight });
        }
    }
}
