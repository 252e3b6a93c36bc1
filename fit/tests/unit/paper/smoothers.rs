use facewire_fit::paper::smoothers::*;

#[test]
fn excess_is_stated_clip_by_clip() {
    let found = excess("gated-average", [&[0.93, 0.91, 0.90], &[0.90, 0.92, 0.86]]);
    assert_eq!(found, "gated-average +0.0200 ± 0.0265 (above 0 in 2 of 3 clips)");
}
