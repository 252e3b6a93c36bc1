//! The tables that shape the output.

use super::{Entry, Field, Overlay, Reader, Section, Table, Takes, field, flag, number, one_of, whole};
use crate::{Adjustment, Adjustments, BLENDSHAPES, FilterKind, Filters, Group, Rules, Shaping, section};

section! {
    /// All of them.
    ShapingSettings {
        smoothing: SmoothingSettings = SmoothingSettings::default(), Table;
        plausibility: Rules = Rules::ALL, Table;
        adjust: Adjustments = Adjustments::default(), Table;
    }

    /// The filter of each part of the face and of the head, and its time.
    SmoothingSettings {
        lids: FilterKind = FilterKind::GatedAverage, one_of(FilterKind::NAMES);
        lids_ms: u16 = 350, whole(0..=350, "ms");
        gaze: FilterKind = FilterKind::GatedAverage, one_of(FilterKind::NAMES);
        gaze_ms: u16 = 100, whole(0..=350, "ms");
        brows: FilterKind = FilterKind::GatedAverage, one_of(FilterKind::NAMES);
        brows_ms: u16 = 350, whole(0..=350, "ms");
        mouth: FilterKind = FilterKind::GatedAverage, one_of(FilterKind::NAMES);
        mouth_ms: u16 = 350, whole(0..=350, "ms");
        jaw: FilterKind = FilterKind::GatedAverage, one_of(FilterKind::NAMES);
        jaw_ms: u16 = 220, whole(0..=350, "ms");
        cheeks: FilterKind = FilterKind::GatedAverage, one_of(FilterKind::NAMES);
        cheeks_ms: u16 = 350, whole(0..=350, "ms");
        head: FilterKind = FilterKind::GatedAverage, one_of(FilterKind::NAMES);
        head_ms: u16 = 350, whole(0..=350, "ms");
    }
}

/// What these settings make of coefficients and of the head's pose.
pub fn shaping(smoothing: &SmoothingSettings, rules: Rules, adjustments: &Adjustments) -> Shaping {
    let seconds = |ms: u16| f32::from(ms) / 1000.0;
    let of_group = |group: Group| {
        let (kind, ms) = match group {
            Group::Lids => (smoothing.lids, smoothing.lids_ms),
            Group::Gaze => (smoothing.gaze, smoothing.gaze_ms),
            Group::Brows => (smoothing.brows, smoothing.brows_ms),
            Group::Mouth => (smoothing.mouth, smoothing.mouth_ms),
            Group::Jaw => (smoothing.jaw, smoothing.jaw_ms),
            Group::Cheeks => (smoothing.cheeks, smoothing.cheeks_ms),
        };
        group.filter(kind, seconds(ms))
    };
    let filters = Filters::new(of_group, smoothing.head, seconds(smoothing.head_ms));
    Shaping { rules, filters, adjustments: adjustments.clone() }
}

impl Section for Rules {
    fn fields(&mut self) -> Vec<Field<'_>> {
        vec![
            field("lids", &mut self.lids, flag()),
            field("gaze", &mut self.gaze, flag()),
            field("opposed", &mut self.opposed, flag()),
            field("mouth_close", &mut self.mouth_close, flag()),
            field("dead_zone", &mut self.dead_zone, number(0.0..=0.2, "")),
        ]
    }
}

/// `mirror`, and a key for each blendshape.
impl Section for Adjustments {
    fn fields(&mut self) -> Vec<Field<'_>> {
        let coefficients = BLENDSHAPES.into_iter().zip(&mut self.coefficients);
        let coefficients = coefficients.map(|(key, coefficient)| field(key, coefficient, Limited));
        [field("mirror", &mut self.mirror, flag())].into_iter().chain(coefficients).collect()
    }
}

/// Reads an adjustment whose limits do not contradict each other.
struct Limited;

impl Reader<Adjustment> for Limited {
    fn takes(&self, adjustment: &mut Adjustment) -> Takes {
        Table.takes(adjustment)
    }

    fn read(&self, adjustment: &mut Adjustment, entry: &Entry<'_>, file: &mut Overlay<'_>) {
        file.section(adjustment, entry);
        if adjustment.min > adjustment.max {
            file.refuse(entry, "a min that is at most max");
        }
    }
}

impl Section for Adjustment {
    fn fields(&mut self) -> Vec<Field<'_>> {
        vec![
            field("gain", &mut self.gain, number(0.0..=10.0, "")),
            field("offset", &mut self.offset, number(-1.0..=1.0, "")),
            field("min", &mut self.min, number(0.0..=1.0, "")),
            field("max", &mut self.max, number(0.0..=1.0, "")),
        ]
    }
}
