//! Checks the reader of the blendshape model.

use facewire_face::model::ModelFile;

/// Checks that any text is either read or refused with an error of one line. A file that was read is the same after it has
/// been written and read again, and gives the solver the same model.
pub fn model_file(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let file = match ModelFile::parse(text) {
        Ok(file) => file,
        Err(error) => return judge(&error.to_string()),
    };
    let written = toml::to_string(&file).unwrap();
    let again = ModelFile::parse(&written).unwrap();
    // The texts are compared, because NaN is not equal to itself.
    assert_eq!(toml::to_string(&again).unwrap(), written);
    let [model, model_again] = [&file, &again].map(|file| file.to_model().map_err(|error| error.to_string()));
    assert_eq!(format!("{model:?}"), format!("{model_again:?}"));
    let _ = model.map_err(|error| judge(&error));
}

/// Checks that an error fills one line.
fn judge(error: &str) {
    assert!(!error.is_empty() && !error.contains(char::is_control), "{error:?}");
}
