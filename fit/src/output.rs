//! The files of the commands, tables as text and as HTML, and HTML pages. A page is a single file without external
//! resources, and suits phones and dark screens.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use facewire_face::{BLENDSHAPES, model::ModelFile};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde::Serialize as _;
use serde_json::Value;

const STYLE: &str = include_str!("output/style.css");

/// Checks that a file can be written before the work for it begins. An existing file is left unchanged.
pub fn check(path: &Path) -> Result<()> {
    let failed = || format!("cannot write {}", path.display());
    let is_new = !path.exists();
    File::options().append(true).create(true).open(path).with_context(failed)?;
    if is_new { fs::remove_file(path).with_context(failed) } else { Ok(()) }
}

pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    fs::write(path, content).with_context(|| format!("cannot write {}", path.display()))
}

/// Writes results as JSON if a path is given.
pub fn write_json(path: Option<&Path>, value: &Value) -> Result<()> {
    path.map_or(Ok(()), |path| write(path, serde_json::to_string_pretty(value)?))
}

pub fn read_model(path: &Path) -> Result<ModelFile> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(ModelFile::parse(&text)?)
}

/// Writes a model, with each formula on one line.
pub fn write_model(path: &Path, file: &ModelFile) -> Result<()> {
    let mut rest = file.clone();
    let formulas = rest.formulas.take();
    let mut text = toml::to_string(&rest)?;
    let cases = formulas.iter().flat_map(|formulas| {
        [("neutral_known", &formulas.neutral_known), ("neutral_unknown", &formulas.neutral_unknown)]
    });
    for (case, set) in cases {
        text += &format!("\n[formulas.{case}.inputs]\n{}", toml::to_string(&set.inputs)?);
        text += &format!("\n[formulas.{case}.blendshapes]\n");
        for (name, formula) in &set.blendshapes {
            let mut line = String::new();
            formula.serialize(toml::ser::ValueSerializer::new(&mut line))?;
            text += &format!("{name} = {line}\n");
        }
    }
    write(path, text)
}

/// Returns the files of a folder with one of these endings, in the order of their names.
pub fn files(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("cannot read the folder {}", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    let is_wanted = |own: &OsStr| endings.iter().any(|ending| own.eq_ignore_ascii_case(ending));
    paths.retain(|path| path.extension().is_some_and(is_wanted));
    paths.sort();
    Ok(paths)
}

/// A cell of a table, and what stands in its place on a page if that is more than its text.
pub struct Cell(String, Option<Markup>);

impl Cell {
    pub fn with_html(text: impl Into<String>, html: Markup) -> Self {
        Self(text.into(), Some(html))
    }
}

impl<T: Into<String>> From<T> for Cell {
    fn from(text: T) -> Self {
        Self(text.into(), None)
    }
}

pub struct Table {
    heads: Vec<String>,
    rows: Vec<Vec<Cell>>,
    linked: bool,
}

impl Table {
    pub fn new<C: Into<Cell>>(
        heads: impl IntoIterator<Item = impl Into<String>>,
        rows: impl IntoIterator<Item = Vec<C>>,
    ) -> Self {
        let rows = rows.into_iter().map(|row| row.into_iter().map(Into::into).collect()).collect();
        Self { heads: heads.into_iter().map(Into::into).collect(), rows, linked: false }
    }

    pub fn linked(self) -> Self {
        Self { linked: true, ..self }
    }

    pub fn text(&self) -> String {
        let width = |column: usize| {
            let cells = self.rows.iter().map(|row| row[column].0.chars().count());
            cells.chain([self.heads[column].chars().count()]).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.heads.len()).map(width).collect();
        let line = |cells: &mut dyn Iterator<Item = &str>| {
            let padded = cells.zip(&widths).enumerate().map(|(column, (cell, width))| match column {
                0 => format!("| {cell:<width$} |"),
                _ => format!(" {cell:>width$} |"),
            });
            padded.collect::<String>() + "\n"
        };
        let rule: String = widths.iter().map(|width| format!("{}:|", "-".repeat(width + 1))).collect();
        let rows = self.rows.iter().map(|row| line(&mut row.iter().map(|cell| cell.0.as_str())));
        let heads = line(&mut self.heads.iter().map(String::as_str));
        format!("{heads}|{}\n{}", rule.replacen("-:|", "--|", 1), rows.collect::<String>())
    }

    pub fn html(&self) -> Markup {
        let (first, heads) = self.heads.split_first().map_or(("", &[][..]), |(first, heads)| (first, heads));
        let show = |cell: &Cell| cell.1.clone().unwrap_or_else(|| html! { (cell.0) });
        html! {
            div.scroll tabindex="0" role="region" aria-label={ "Table by " (first) } {
                table {
                    thead { tr { th scope="col" { (first) } @for head in heads { th scope="col" { (head) } } } }
                    tbody {
                        @for row in &self.rows { tr {
                            @for (column, cell) in row.iter().enumerate() {
                                @if column > 0 { td { (show(cell)) } }
                                @else if self.linked && BLENDSHAPES.contains(&cell.0.as_str()) {
                                    th scope="row" { a href={ "#" (cell.0) } { (cell.0) } }
                                }
                                @else { th scope="row" { (show(cell)) } }
                            }
                        } }
                    }
                }
            }
        }
    }
}

pub fn number(value: Option<f64>, decimals: usize) -> String {
    value.filter(|value| value.is_finite()).map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
}

/// Writes a page with links to `contents` (section and title) and to `sections`, and prints its size.
pub fn write_page(
    path: &Path,
    title: &str,
    contents: &[(&str, &str)],
    sections: &[String],
    body: &Markup,
) -> Result<()> {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "facewire: " (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header { h1 { (title) } }
                nav aria-label="Contents" {
                    @for (section, title) in contents { a href={ "#" (section) } { (title) } }
                    @for name in sections { a.small href={ "#" (name) } { (name) } }
                }
                main { (body) }
            }
        }
    };
    let page = page.into_string();
    write(path, &page)?;
    println!("{}: {:.1} MB", path.display(), page.len() as f64 / 1e6);
    Ok(())
}

pub fn figure(drawing: &str, caption: &str, name: &str) -> Markup {
    html! {
        figure role="img" aria-label={ (name) ": " (caption) } {
            (PreEscaped(drawing))
            figcaption { (caption) }
        }
    }
}

/// Returns the drawings of a section, each with its caption.
pub fn figures(drawn: &[(String, &str)], name: &str) -> Markup {
    html! { div.figures { @for (drawing, caption) in drawn { (figure(drawing, caption, name)) } } }
}

pub fn guide(terms: &[(&str, &str)]) -> Markup {
    html! {
        h2 id="guide" { "How to read it" }
        dl { @for (term, meaning) in terms { dt { (term) } dd { (meaning) } } }
    }
}
