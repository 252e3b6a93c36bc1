//! What pages have in common: one file, nothing loaded from elsewhere, readable on a phone and on a dark screen.

use std::path::Path;

use anyhow::Result;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::output;

const STYLE: &str = include_str!("html/style.css");

/// A page of this title and body.
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

/// Writes a page, and says how large it is.
pub fn write(path: &Path, page: &str) -> Result<()> {
    output::write(path, page)?;
    println!("{}: {:.1} MB", path.display(), page.len() as f64 / 1e6);
    Ok(())
}

/// A drawing with its caption; `name` is what it is of.
pub fn figure(drawing: &str, caption: &str, name: &str) -> Markup {
    html! {
        figure role="img" aria-label={ (name) ": " (caption) } {
            (PreEscaped(drawing))
            figcaption { (caption) }
        }
    }
}

/// A cell at the head of a row.
pub struct RowHead<'a> {
    /// What stands there.
    pub name: &'a str,
    /// Whether it leads to the section of that name.
    pub link: bool,
}

/// A table that scrolls by itself where the screen is narrow. Each row is its head and its other cells.
pub fn table(first: &str, heads: &[&str], rows: &[(RowHead, Vec<String>)]) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label={ "Table by " (first) } {
            table {
                thead { tr { th scope="col" { (first) } @for head in heads { th scope="col" { (head) } } } }
                tbody {
                    @for (RowHead { name, link }, cells) in rows {
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
