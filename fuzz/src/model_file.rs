//! The reader of the blendshape model.

use facewire::solve::model_file::ModelFile;

/// Any text is read or refused in one line. What is read is written and read again the same, and gives the solver the
/// same model.
pub fn model_file(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let file = match ModelFile::parse(text) {
        Ok(file) => file,
        Err(error) => return judge(&error.to_string()),
    };
    let written = toml::to_string(&file).unwrap();
    let again = ModelFile::parse(&written).unwrap();
    // As text: a number that is none is not equal to itself.
    assert_eq!(toml::to_string(&again).unwrap(), written);
    let [model, model_again] = [&file, &again].map(|file| file.to_model().map_err(|error| error.to_string()));
    assert_eq!(format!("{model:?}"), format!("{model_again:?}"));
    let _ = model.map_err(|error| judge(&error));
}

fn judge(error: &str) {
    assert!(!error.is_empty() && !error.contains(char::is_control), "{error:?}");
}
