//! Tests of the workbench's parts, each in the file of its part.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod arrays;
mod compare;
mod curves;
mod dataset;
mod drawing;
mod evaluate;
mod faces;
mod gaze;
mod judge {
    mod figures;
    mod gaze;
    mod set;
}
mod kinds;
mod network;
mod output;
mod paper {
    mod corrective;
    mod figures;
    mod hardware;
    mod material;
    mod processes;
    mod sine;
    mod smoothers;
    mod transforms;
}
mod recording;
mod reference;
mod segments;
mod statistics;
mod synth {
    mod acting;
    mod anatomy;
    mod archive;
    mod assets;
    mod camera;
    mod canvas;
    mod describe;
    mod expression;
    mod film;
    mod occluders;
    mod options;
    mod rig;
    mod run;
    mod scene;
    mod script;
    mod shade;
    mod tongue;
    mod variety;
    mod worker;
}
mod tune {
    mod correction;
    mod measure;
}
