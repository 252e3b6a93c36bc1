//! The blendshapes by their names.

use facewire_face::BLENDSHAPES;

/// Number of blendshapes that the model predicts: all but the last, `tongueOut`.
pub const MODELLED: usize = BLENDSHAPES.len() - 1;

pub fn find(name: &str) -> Option<usize> {
    BLENDSHAPES.iter().position(|known| *known == name)
}

/// Reads the name of a blendshape that the model predicts, for options.
pub fn modelled(name: &str) -> Result<usize, String> {
    find(name)
        .filter(|index| *index < MODELLED)
        .ok_or_else(|| "not a blendshape that landmarks show: names are like eyeBlinkLeft".to_owned())
}

pub fn index_of(name: &str) -> usize {
    find(name).unwrap_or_default()
}
