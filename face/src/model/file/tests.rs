use super::*;

const SHIPPED: &str = include_str!("../../../../models/blendshapes.toml");

fn shipped() -> ModelFile {
    ModelFile::parse(SHIPPED).expect("the shipped model is sound")
}

fn error_of(change: impl Fn(&mut ModelFile)) -> String {
    let mut file = shipped();
    change(&mut file);
    file.to_model().expect_err("a fault was put in").to_string()
}

#[test]
fn file_that_cannot_be_read_is_told_from_one_that_is_damaged() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("model.toml");
    let error = Model::load(&path).expect_err("there is no file");
    assert!(matches!(error, ModelError::Unreadable { .. }));
    assert!(error.to_string().contains("model.toml cannot be read (No such file"), "{error}");
    std::fs::write(&path, b"format = 3\nmade_by = \"\xff\"\n").expect("a file");
    let error = Model::load(&path).expect_err("the file is not text");
    assert!(error.to_string().contains("line 2 (it is not UTF-8)"), "{error}");
    std::fs::write(&path, SHIPPED).expect("a file");
    assert_eq!(Model::load(&path).expect("the shipped model is sound"), Model::embedded());
}

#[test]
fn damaged_file_and_one_of_another_format_are_refused() {
    let refusal = |text: &str| ModelFile::parse(text).and_then(|file| file.to_model()).unwrap_err().to_string();
    refusal(SHIPPED.get(..SHIPPED.len() / 2).unwrap());
    assert!(refusal("\nformat = [1").contains("damaged in line 2"));
    assert!(refusal("format = 3").contains("damaged"));
    assert!(refusal("format = 1\nold = true").contains("has format 1, this program reads format 3"));
}

#[test]
fn missing_and_unknown_blendshapes_are_named() {
    let mut file = shipped();
    let entry = file.blendshapes.remove("jawOpen").expect("it has a jaw");
    assert!(file.to_model().expect_err("no jaw").to_string().contains("blendshapes.jawOpen"));
    file.blendshapes.insert("jawOpened".to_owned(), entry);
    assert!(file.to_model().expect_err("no such jaw").to_string().contains("jawOpened"));
}

#[test]
fn a_file_without_a_regression_or_with_two_is_refused() {
    let formulas = Some(FormulasTable::default());
    for file in [
        ModelFile { formulas: formulas.clone(), ..shipped() },
        ModelFile { formulas, offsets: None, ..shipped() },
        ModelFile { offsets: None, ..shipped() },
        ModelFile::new(String::new(), String::new()),
    ] {
        assert!(file.to_model().unwrap_err().to_string().contains("either offsets"));
    }
}

#[test]
fn numbers_that_are_not_finite_are_named() {
    for wrong in [f64::NAN, f64::INFINITY, 1e300] {
        let jaw = |file: &mut ModelFile| file.blendshapes.entry("jawOpen".to_owned()).or_default().offset = wrong;
        assert!(error_of(jaw).contains("\"offset\" in blendshapes.jawOpen"));
        let input = |file: &mut ModelFile| file.inputs.entry("y14".to_owned()).or_default().weights = vec![wrong];
        assert!(error_of(input).contains("\"weights\" in inputs.y14"));
    }
}

#[test]
fn an_unknown_feature_is_named() {
    let error = error_of(|file| _ = file.inputs.insert("q7".to_owned(), InputTable::default()));
    assert!(error.contains("unknown \"q7\" in inputs"), "{error}");
}

#[test]
fn errors_fill_one_line_whatever_stands_in_names() {
    for weight in [1.0, f64::NAN] {
        let table = InputTable { neutral: weight, ..InputTable::default() };
        let error = error_of(|file| _ = file.inputs.insert("line\n\u{1b}end".to_owned(), table.clone()));
        assert!(error.contains(r#""line\n\u{1b}end""#) && !error.contains(char::is_control), "{error}");
    }
}

#[test]
fn more_weights_than_fit_are_refused() {
    let wide = |file: &mut ModelFile| file.offsets.get_or_insert_default().neutral_known = vec![0.0; MAX_HIDDEN + 1];
    assert!(error_of(wide).contains("offsets.neutral_known of the model file has more weights"));
    let many = |file: &mut ModelFile| {
        let names = (0..=MAX_INPUTS).filter_map(|index| FeatureId::from_index(index).map(|id| id.to_string()));
        file.inputs.extend(names.map(|name| (name, InputTable::default())));
    };
    assert!(error_of(many).contains("inputs of the model file has more weights"));
}

#[test]
fn corrective_terms_must_keep_the_order_of_values() {
    let with = |lift: f64, response: [f64; 2]| {
        let table = CorrectionTable { shift: -0.02, slope: 1.1, lift, response };
        let mut file = shipped();
        file.correction.insert("jawOpen".to_owned(), table);
        file.to_model()
    };
    let [found, before] = [with(0.2, [0.4, 0.8]), shipped().to_model()].map(|model| model.expect("sound").correction);
    let changed = found.0.iter().zip(&before.0).position(|(found, before)| found != before);
    assert_eq!(changed.and_then(|index| BLENDSHAPES.get(index)), Some(&"jawOpen"));
    for wrong in [with(-0.2, [0.4, 0.8]), with(0.2, [0.8, 0.8])] {
        let error = wrong.expect_err("out of order").to_string();
        assert!(error.contains("correction.jawOpen") && error.contains("order"), "{error}");
    }
}
