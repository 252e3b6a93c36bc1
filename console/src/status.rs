//! The state of the service, asked for again and again, and its history of the last hour.

use std::{collections::VecDeque, fs, path::Path, time::Instant};

use facewire_board::{HardwareSettings, Sensors};
use nix::sys::statvfs::statvfs;
use serde_json::{Map, Value, json};

/// Time between two rows of the history, in seconds.
pub const ROW_PERIOD_S: u64 = 5;
const MOST_ROWS: usize = 720;
/// What a row tells of the durations of a stage: their median, 95 % of them are shorter, and the longest one. The limits of the
/// histogram's buckets are known, and not the durations in between, so that the longest one is rounded up.
const SHARES: [(&str, f64); 3] = [("p50", 0.5), ("p95", 0.95), ("max", 1.0)];
/// The histograms of a status: a metric's name, with its label if there are several.
const HISTOGRAM: &str = "_seconds_bucket{";

/// Reads the samples of an OpenMetrics text. Those of histograms are left out.
pub fn samples(text: &str) -> Map<String, Value> {
    let samples = lines(text).filter(|(name, _)| !name.contains(HISTOGRAM));
    samples.map(|(name, value)| (name.to_owned(), value.into())).collect()
}

fn lines(text: &str) -> impl Iterator<Item = (&str, f64)> {
    let samples = text.lines().filter(|line| !line.starts_with('#')).filter_map(|line| line.rsplit_once(' '));
    samples.filter_map(|(name, value)| Some((name, value.parse().ok()?)))
}

/// How many durations were at most so long, by stage: pairs of a limit in seconds and a count.
#[derive(Debug, Default, Clone, PartialEq)]
struct Stage {
    name: String,
    below: Vec<(f64, f64)>,
}

/// Reads the histograms of an OpenMetrics text.
fn stages(text: &str) -> Vec<Stage> {
    let mut stages: Vec<Stage> = Vec::new();
    for (sample, count) in lines(text) {
        let Some((metric, labels)) = sample.split_once(HISTOGRAM) else { continue };
        let label = |key: &str| labels.split(key).nth(1)?.strip_prefix("=\"")?.split('"').next();
        let name = label("stage").unwrap_or(metric.trim_start_matches("facewire_"));
        let Some(limit_s) = label("le").and_then(|limit| limit.replace("+Inf", "inf").parse().ok()) else { continue };
        match stages.last_mut() {
            Some(stage) if stage.name == name => stage.below.push((limit_s, count)),
            _ => stages.push(Stage { name: name.to_owned(), below: vec![(limit_s, count)] }),
        }
    }
    stages
}

/// Returns a quantile of the durations that came between two histograms, in milliseconds. `None` if there were none.
fn quantile_ms(before: Option<&Stage>, now: &Stage, share: f64) -> Option<f64> {
    let old = |index: usize| before.and_then(|before| before.below.get(index)).map_or(0.0, |(_, count)| *count);
    let counts: Vec<(f64, f64)> =
        now.below.iter().enumerate().map(|(index, (limit_s, count))| (*limit_s, count - old(index))).collect();
    let total = counts.last().map(|(_, count)| *count).filter(|total| *total > 0.0)?;
    let (mut low_s, mut low) = (0.0, 0.0);
    for (limit_s, count) in counts {
        if count >= share * total {
            // The last bucket has no upper limit.
            let high_s = if limit_s.is_finite() { limit_s } else { low_s };
            let part = if count > low { (share * total - low) / (count - low) } else { 1.0 };
            return Some(((low_s + (high_s - low_s) * part) * 1e6).round() / 1e3);
        }
        (low_s, low) = (limit_s, count);
    }
    None
}

/// The load, the temperature and the supply voltage of the board whose `/proc` and `/sys` lie below `root`, of the sensors
/// that the settings choose.
pub fn board(root: &Path, settings: &Value) -> Value {
    let load = fs::read_to_string(root.join("proc/loadavg")).ok();
    let load = load.and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    let zone = settings.pointer("/hardware/thermal_zone").and_then(Value::as_str).unwrap_or_default();
    let settings = HardwareSettings { thermal_zone: zone.to_owned(), ..HardwareSettings::default() };
    let sensors = Sensors::find(root, &settings);
    let temperature_c = sensors.temperature_c().map(|celsius| (f64::from(celsius) * 10.0).round() / 10.0);
    json!({"load": load, "temperature_c": temperature_c, "undervoltage": sensors.is_undervolted()})
}

/// The space that is free for recordings.
#[allow(clippy::useless_conversion, reason = "these numbers have 32 bits on some boards")]
pub fn free_bytes(folder: &Path) -> u64 {
    statvfs(folder).map_or(0, |space| u64::from(space.blocks_available()) * u64::from(space.fragment_size()))
}

/// What a status of the service showed.
#[derive(Debug)]
struct Look {
    at: Instant,
    frames: f64,
    stages: Vec<Stage>,
}

/// The last hour, a row every [`ROW_PERIOD_S`] seconds.
#[derive(Debug, Default)]
pub struct History {
    last: Option<Look>,
    /// The names of the stages in the first status.
    stages: Vec<String>,
    rows: VecDeque<Vec<Option<f64>>>,
}

impl History {
    /// Adds a row from the metrics of the service, or one of a time without it.
    pub fn add(&mut self, metrics: Option<&str>, time_s: f64, board: &Value) {
        let look = metrics.map(|text| {
            let frames = lines(text).filter(|(name, _)| name.starts_with("facewire_frames_total{"));
            Look { at: Instant::now(), frames: frames.map(|(_, count)| count).sum(), stages: stages(text) }
        });
        if let (true, Some(look)) = (self.stages.is_empty(), &look) {
            self.stages = look.stages.iter().map(|stage| stage.name.clone()).collect();
        }
        // After a restart of the service all counts begin anew.
        let last = self.last.take().filter(|last| look.as_ref().is_some_and(|look| look.frames >= last.frames));
        let rate_hz = look.as_ref().zip(last.as_ref()).map(|(now, last)| {
            let span_s = now.at.saturating_duration_since(last.at).as_secs_f64().max(1e-3);
            ((now.frames - last.frames) / span_s * 10.0).round() / 10.0
        });
        let mut row = vec![Some(time_s.round()), rate_hz];
        for name in &self.stages {
            let of = |look: &Option<Look>| {
                look.as_ref().and_then(|look| look.stages.iter().find(|stage| stage.name == *name).cloned())
            };
            let (before, now) = (of(&last), of(&look));
            row.extend(SHARES.map(|(_, share)| quantile_ms(before.as_ref(), now.as_ref()?, share)));
        }
        row.extend(["load", "temperature_c"].map(|key| board.get(key).and_then(Value::as_f64)));
        self.last = look;
        self.rows.push_back(row);
        if self.rows.len() > MOST_ROWS {
            self.rows.pop_front();
        }
    }

    pub fn to_json(&self) -> Value {
        let stages = self.stages.iter().flat_map(|name| SHARES.map(|(share, _)| format!("{name}_{share}_ms")));
        let columns = ["time_s", "rate_hz"].map(str::to_owned).into_iter().chain(stages);
        let columns: Vec<String> = columns.chain(["load", "temperature_c"].map(str::to_owned)).collect();
        // Rows from before the first status have no stages.
        let rows: Vec<_> = self.rows.iter().filter(|row| row.len() == columns.len()).collect();
        json!({"columns": columns, "rows": rows})
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metrics(faces: u32, quick: u32, slow: u32) -> String {
        format!(
            "# HELP facewire_frames Frames.\nfacewire_frames_total{{result=\"faces\"}} {faces}\n\
             facewire_stage_seconds_count{{stage=\"mesh\"}} {slow}\n\
             facewire_stage_seconds_bucket{{le=\"0.01\",stage=\"mesh\"}} {quick}\n\
             facewire_stage_seconds_bucket{{le=\"0.02\",stage=\"mesh\"}} {slow}\n\
             facewire_stage_seconds_bucket{{le=\"+Inf\",stage=\"mesh\"}} {slow}\n\
             facewire_age_seconds_bucket{{le=\"0.02\"}} 0\nfacewire_age_seconds_bucket{{le=\"+Inf\"}} 0\n# EOF"
        )
    }

    #[test]
    fn the_board_shows_the_sensor_that_the_settings_choose_and_its_supply_voltage() {
        let folder = tempfile::tempdir().unwrap();
        for (path, text) in [
            ("proc/loadavg", "0.25 0.50 0.75 1/123 4567"),
            ("sys/class/thermal/thermal_zone0/type", "gpu-thermal"),
            ("sys/class/thermal/thermal_zone0/temp", "99000"),
            ("sys/class/thermal/thermal_zone1/type", "cpu-thermal"),
            ("sys/class/thermal/thermal_zone1/temp", "48199"),
            ("sys/class/hwmon/hwmon0/name", "rpi_volt"),
            ("sys/class/hwmon/hwmon0/in0_lcrit_alarm", "1"),
        ] {
            let path = folder.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let zone = json!({"hardware": {"thermal_zone": "gpu-thermal"}});
        for (settings, temperature_c) in [(Value::Null, 48.2), (zone, 99.0)] {
            let want = json!({"load": 0.25, "temperature_c": temperature_c, "undervoltage": true});
            assert_eq!(board(folder.path(), &settings), want);
        }
        let unknown = json!({"load": null, "temperature_c": null, "undervoltage": null});
        assert_eq!(board(Path::new("/proc/self/no"), &Value::Null), unknown);
    }

    #[test]
    fn samples_have_their_labels_and_no_buckets() {
        let samples = samples(&metrics(7, 1, 2));
        assert_eq!(samples.len(), 2);
        assert_eq!(samples["facewire_frames_total{result=\"faces\"}"], 7.0);
    }

    #[test]
    fn a_row_shows_what_came_since_the_last_one() {
        let mut history = History::default();
        let board = json!({"load": 0.5, "temperature_c": null});
        history.add(None, 1.0, &board);
        // 100 durations before, all slow; then 100 more, half of them quick.
        history.add(Some(&metrics(100, 0, 100)), 6.0, &board);
        history.add(Some(&metrics(250, 50, 200)), 11.0, &board);
        let json = history.to_json();
        assert_eq!(
            json["columns"],
            json!([
                "time_s",
                "rate_hz",
                "mesh_p50_ms",
                "mesh_p95_ms",
                "mesh_max_ms",
                "age_p50_ms",
                "age_p95_ms",
                "age_max_ms",
                "load",
                "temperature_c"
            ])
        );
        let row = &json["rows"].as_array().unwrap().last().unwrap();
        assert_eq!((&row[2], &row[3], &row[4]), (&json!(10.0), &json!(19.0), &json!(20.0)));
        assert_eq!((&row[5], &row[8]), (&Value::Null, &json!(0.5)));
        assert!(row[1].as_f64().is_some_and(|rate_hz| rate_hz > 0.0), "{row}");
        // The service has started again.
        history.add(Some(&metrics(3, 3, 3)), 16.0, &board);
        assert_eq!(history.to_json()["rows"][2][1], Value::Null);
    }

    #[test]
    fn the_history_ends_after_an_hour() {
        let mut history = History::default();
        (0..1000).for_each(|row| history.add(Some(&metrics(row, 0, 0)), row.into(), &Value::Null));
        let json = history.to_json();
        assert_eq!(json["rows"].as_array().unwrap().len(), 720);
        assert_eq!(json["rows"][0][0], 280.0);
    }
}
