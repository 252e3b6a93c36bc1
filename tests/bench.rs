//! The figures of `facewire bench` are complete and consistent.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use common::program::{Run, facewire};
use serde_json::Value;

/// Multiply-adds of all networks without the detector. MediaPipe's own networks have the same number.
const MULTIPLY_ADDS: u64 = 43_476_672;

fn number(value: &Value, path: &str) -> f64 {
    value.pointer(path).unwrap_or_else(|| panic!("no {path}: {value}")).as_f64().unwrap()
}

#[test]
fn json_has_every_quantile_the_distribution_and_the_speed_of_each_layer() {
    let run = Run::of(&mut facewire(["bench", "demo", "--rounds", "1", "--json", "--layers"])).succeeded();
    let found: Value = serde_json::from_str(&run.out).unwrap();
    for stage in ["decode", "detect", "mesh", "solve", "whole", "decode_and_whole", "constant_work"] {
        let quantiles = ["p50", "p95", "p99", "p999", "max"].map(|name| number(&found, &format!("/{stage}/{name}_ms")));
        assert!(quantiles.is_sorted(), "{stage}: {quantiles:?}");
    }
    let distribution = found["whole_distribution_ms"].as_array().unwrap();
    assert!(distribution.len() >= 10 && distribution.iter().map(|point| number(point, "/1")).is_sorted());
    assert!(number(&found, "/whole/p50_ms") < number(&found, "/decode_and_whole/p50_ms"));
    for key in ["/cpu_percent", "/cpu_percent_at_30_fps", "/peak_memory_mb", "/interruptions/interrupts"] {
        assert!(number(&found, key) > 0.0, "{key}: {found}");
    }

    let networks = found["layers"]["networks"].as_array().unwrap();
    let names: Vec<&str> = networks.iter().map(|network| network["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["mesh", "lips", "left_eye", "right_eye", "detector"]);
    assert_eq!(found["layers"]["frame"]["multiply_adds"], MULTIPLY_ADDS);
    for network in networks {
        let layers = network["layers"].as_array().unwrap();
        let of_layers: u64 = layers.iter().map(|layer| layer["multiply_adds"].as_u64().unwrap()).sum();
        assert!(layers.len() > 10 && network["multiply_adds"] == of_layers, "{network}");
    }
    // No network can be faster than the core. The margin allows for other programs that run while the peak is measured.
    let share = number(&found, "/layers/frame/percent_of_peak");
    assert!((0.1..120.0).contains(&share), "{share} % of the peak");
}
