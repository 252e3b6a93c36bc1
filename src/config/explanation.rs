//! The settings as `facewire.toml` and `links.toml` explain them: each with its default below a comment, in TOML.

use std::fmt;

#[derive(Clone, Copy)]
pub struct Explanation<'a> {
    /// The heading of the table, such as `[camera]`. Empty for what stands above all tables.
    pub heading: &'a str,
    /// The lines of the comment, each with its `# ` and its end.
    pub comment: &'a str,
    pub key: &'a str,
    pub value: &'a str,
}

/// Reads such a text. A setting may be commented out itself. An empty line ends a comment.
pub fn explanations(text: &str) -> Vec<Explanation<'_>> {
    let mut explanations = Vec::new();
    let mut heading = "";
    let mut comment_start = 0;
    let mut line_start = 0;
    for line in text.split_inclusive('\n') {
        let line_end = line_start + line.len();
        let line = line.trim_end();
        let comment = text.get(comment_start..line_start).unwrap_or_default();
        let setting = assignment(line.strip_prefix("# ").unwrap_or(line));
        if line.starts_with('[') {
            heading = line;
        }
        if let Some((key, value)) = setting {
            explanations.push(Explanation { heading, comment, key, value });
        }
        if setting.is_some() || line.is_empty() || line.starts_with('[') {
            comment_start = line_end;
        }
        line_start = line_end;
    }
    explanations
}

/// The key and the value in a line that assigns one, which a sentence or an indented example does not.
fn assignment(line: &str) -> Option<(&str, &str)> {
    let is_bare = |key: &str| key.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    line.split_once(" = ").filter(|(key, _)| is_bare(key))
}

/// The explanation in TOML, with a setting that is not commented out.
impl fmt::Display for Explanation<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}{} = {}", self.comment, self.key, self.value)
    }
}
