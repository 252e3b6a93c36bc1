//! Elements that the HTML pages share. A page is a single file without external resources, and suits phones and dark
//! screens.

use std::path::Path;

use anyhow::Result;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::output;

const STYLE: &str = include_str!("html/style.css");

/// Returns a page with this title and body.
pub fn page(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "facewire: " (title) }
                style { (PreEscaped(STYLE)) }
            }
            body { (body) }
        }
    };
    page.into_string()
}

/// Writes a page and prints its size.
pub fn write(path: &Path, page: &str) -> Result<()> {
    output::write(path, page)?;
    println!("{}: {:.1} MB", path.display(), page.len() as f64 / 1e6);
    Ok(())
}

/// Returns a drawing with its caption. `name` is the subject of the drawing, for screen readers.
pub fn figure(drawing: &str, caption: &str, name: &str) -> Markup {
    html! {
        figure role="img" aria-label={ (name) ": " (caption) } {
            (PreEscaped(drawing))
            figcaption { (caption) }
        }
    }
}

/// The header cell of a row.
pub struct RowHeader<'a> {
    /// The text of the cell.
    pub name: &'a str,
    /// Whether the cell links to the section of that name.
    pub link: bool,
}

/// Returns a table that scrolls on its own if the screen is narrow. Each row has a header cell and further cells.
pub fn table(first: &str, heads: &[&str], rows: &[(RowHeader, Vec<String>)]) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label={ "Table by " (first) } {
            table {
                thead { tr { th scope="col" { (first) } @for head in heads { th scope="col" { (head) } } } }
                tbody {
                    @for (RowHeader { name, link }, cells) in rows {
                        tr {
                            th scope="row" { @if *link { a href={ "#" (name) } { (name) } } @else { (name) } }
                            @for cell in cells { td { (cell) } }
                        }
                    }
                }
            }
        }
    }
}
