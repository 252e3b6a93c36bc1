//! The parts of the page, which the program contains.

/// A file of the page.
#[derive(Debug, Clone, Copy)]
pub struct Part {
    name: &'static str,
    /// Its media type.
    pub kind: &'static str,
    pub bytes: &'static [u8],
}

/// Declares parts: the media type of some files in the folder `page`.
macro_rules! parts {
    ( $( $kind:literal: $( $name:literal )* ; )* ) => {
        &[ $( $( Part { name: $name, kind: $kind, bytes: include_bytes!(concat!("../../page/", $name)) }, )* )* ]
    };
}

const PARTS: &[Part] = parts! {
    "text/html; charset=utf-8": "index.html";
    "text/css; charset=utf-8": "style.css";
    "image/svg+xml": "icon.svg";
    "text/javascript; charset=utf-8":
        "app.js" "bars.js" "chart.js" "common.js" "draft.js" "drive.js" "fields.js" "hand.js" "health.js" "impaired.js"
        "learn.js" "links.js" "live.js" "login.js" "picture.js" "plot.js" "poses.js" "puppet.js" "recorder.js" "recordings.js"
        "servos.js" "sets.js" "start.js" "status.js" "store.js" "stream.js" "wearer.js" "words.js" "vendor/hooks.module.js" "vendor/htm.module.js"
        "vendor/preact.js" "vendor/preact.module.js"
        "face/face.js" "face/form.js" "face/head.js" "face/maths.js" "face/morph.js" "face/parts.js" "face/shaders.js"
        "face/shapes-lower.js" "face/shapes-upper.js";
};

/// Returns the part of this name. The page itself has none.
pub fn part(name: &str) -> Option<Part> {
    let name = if name.is_empty() { "index.html" } else { name };
    PARTS.iter().copied().find(|part| part.name == name)
}
