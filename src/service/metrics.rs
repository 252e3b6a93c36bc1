//! The metrics: one page of `OpenMetrics` text, which Prometheus reads by HTTP, made from the table of the counters.
//!
//! There is no encryption and no password, so only this machine can connect ([`super::control`]). A page in a browser
//! could still ask under a host name that its owner points at this machine (DNS rebinding), so requests to other hosts are
//! refused.

use std::{fmt::Write as _, fs, net::IpAddr};

use facewire_servo::{Dial, Number, bus::HEALTH};
use httparse::{EMPTY_HEADER, Request, Status};
use rustix::param::page_size;

use super::counters::Counters;
use super::timing::Histogram;

/// The requests of Prometheus have about 300 bytes.
pub(super) const MAX_REQUEST_BYTES: usize = 4096;
const MAX_HEADERS: usize = 32;
const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Answers the bytes of a request that have come so far. Returns `None` while the request is incomplete.
pub(super) fn answer(bytes: &[u8], has_ended: bool, counters: &Counters) -> Option<String> {
    let mut headers = [EMPTY_HEADER; MAX_HEADERS];
    let mut request = Request::new(&mut headers);
    let refuse = |status, text| Some(response(status, "text/plain; charset=utf-8", text));
    let too_long = || refuse("431 Request Header Fields Too Large", "the request is too long\n");
    match request.parse(bytes) {
        Ok(Status::Partial) if bytes.len() >= MAX_REQUEST_BYTES => too_long(),
        Ok(Status::Partial) if !has_ended => None,
        Ok(Status::Complete(_)) => {
            let mut hosts = request.headers.iter().filter(|header| header.name.eq_ignore_ascii_case("host"));
            match (request.method, request.path.and_then(|path| path.split('?').next())) {
                _ if !hosts.all(|host| is_this_machine(host.value)) => {
                    refuse("421 Misdirected Request", "ask for localhost or a loopback address\n")
                }
                (Some("GET"), Some("/metrics")) => Some(response("200 OK", CONTENT_TYPE, &page(counters))),
                (Some("GET"), _) => refuse("404 Not Found", "the only page is /metrics\n"),
                _ => refuse("405 Method Not Allowed\r\nAllow: GET", "use GET\n"),
            }
        }
        Err(httparse::Error::TooManyHeaders) => too_long(),
        Ok(Status::Partial) | Err(_) => refuse("400 Bad Request", "this is not an HTTP request\n"),
    }
}

fn response(status: &str, content_type: &str, body: &str) -> String {
    let length = body.len();
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    )
}

/// Whether a `Host` header names a loopback address or `localhost`, with or without a port.
fn is_this_machine(host: &[u8]) -> bool {
    let Ok(host) = str::from_utf8(host) else { return false };
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    let name = name.strip_suffix('.').unwrap_or(name);
    name.eq_ignore_ascii_case("localhost") || name.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

/// Upper limits of the histograms' buckets: powers of two in nanoseconds and 1.5 times each, from 16 microseconds to 1.6
/// seconds. [`Histogram::count_below`] is exact at these limits.
fn limits_ns() -> impl Iterator<Item = u64> {
    (0..34).map(|index| (2 + index % 2) << (13 + index / 2))
}

/// Renders everything with its present values. Writing to a string cannot fail.
pub(super) fn page(counters: &Counters) -> String {
    let mut page = String::new();
    head(&mut page, "build", "info", "Version of facewire.");
    let _ = writeln!(page, "facewire_build_info{{version=\"{}\"}} 1", env!("CARGO_PKG_VERSION"));
    for row in counters.rows() {
        head(&mut page, row.metric, row.kind, row.help);
        let total = if row.kind == "counter" { "_total" } else { "" };
        for (value, sample) in row.samples {
            let label = if row.label.is_empty() { String::new() } else { format!("{{{}=\"{value}\"}}", row.label) };
            let _ = writeln!(page, "facewire_{}{total}{label} {sample}", row.metric);
        }
    }
    for (at, (metric, help)) in HEALTH.iter().enumerate() {
        head(&mut page, metric, "gauge", help);
        for panel in counters.panels() {
            for Dial { number, health, .. } in &panel.dials.channels {
                if let Some(value) = health.get(at).and_then(Number::get) {
                    let _ = writeln!(page, "facewire_{metric}{{link={:?},servo=\"{number}\"}} {value}", panel.receiver);
                }
            }
        }
    }
    let [stages @ .., (_, work), (_, age)] = counters.times.all();
    let help = "Time of each stage of a frame; wait lasts from capture to the start of processing.";
    head(&mut page, "stage_seconds", "histogram", help);
    stages.iter().for_each(|(name, stage)| histogram(&mut page, "stage", &format!("stage=\"{name}\""), stage));
    head(&mut page, "work_seconds", "histogram", "Time from a frame in memory to its result.");
    histogram(&mut page, "work", "", work);
    head(&mut page, "age_seconds", "histogram", "Time from the capture of a pose to its sending.");
    histogram(&mut page, "age", "", age);
    head(&mut page, "resident_memory_bytes", "gauge", "Resident memory of the process.");
    let _ = writeln!(page, "facewire_resident_memory_bytes {}\n# EOF", resident_bytes());
    page
}

fn head(page: &mut String, metric: &str, kind: &str, help: &str) {
    let _ = writeln!(page, "# HELP facewire_{metric} {help}\n# TYPE facewire_{metric} {kind}");
    if let Some((_, unit @ ("seconds" | "bytes"))) = metric.rsplit_once('_') {
        let _ = writeln!(page, "# UNIT facewire_{metric} {unit}");
    }
}

fn histogram(page: &mut String, name: &str, label: &str, histogram: &Histogram) {
    let (all, comma) = if label.is_empty() { (String::new(), "") } else { (format!("{{{label}}}"), ",") };
    // Counted upwards, the total last, so that a duration recorded meanwhile makes no count smaller than the one before.
    let below: Vec<_> = limits_ns().map(|limit_ns| (limit_ns, histogram.count_below(limit_ns))).collect();
    let total = histogram.count_below(u64::MAX);
    let _ = writeln!(page, "facewire_{name}_seconds_sum{all} {}", histogram.sum_s());
    let _ = writeln!(page, "facewire_{name}_seconds_count{all} {total}");
    for (limit_ns, below) in below {
        let limit_s = limit_ns as f64 / 1e9;
        let _ = writeln!(page, "facewire_{name}_seconds_bucket{{le=\"{limit_s}\"{comma}{label}}} {below}");
    }
    let _ = writeln!(page, "facewire_{name}_seconds_bucket{{le=\"+Inf\"{comma}{label}}} {total}");
}

/// Returns the resident memory of the process, or 0 if `/proc/self/statm` cannot be read.
fn resident_bytes() -> u64 {
    let pages = fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let resident = pages.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok());
    resident.unwrap_or(0) * page_size() as u64
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering::Relaxed;
    use std::time::Duration;

    use facewire_packet::{NeutralFace, State, Visibility};

    use super::*;
    use crate::service::adaptation::{Cause, Step};
    use facewire_board::Impairment;

    #[test]
    fn the_status_line_and_the_page_show_every_count_under_its_name() {
        let counters = Counters::default();
        assert!(counters.status_line().contains(" state=neutral impaired_by=none step=full step_by=none "));
        assert!(counters.status_line().contains(" covered=none "));
        counters.frames.store(10, Relaxed);
        counters.solved.store(7, Relaxed);
        counters.traffic.dropped.store(2, Relaxed);
        // It begins twice, and lasts for two looks.
        [true, true, false, true].iter().for_each(|is_hot| counters.impairments.set(Impairment::Hot, *is_hot));
        counters.set_step(Step::Half, Some(Cause::Hot));
        counters.set_state(State::Decay);
        counters.set_neutral(NeutralFace::Estimated, 0.733, 2);
        counters.set_visibility(Visibility { left_eye: 0.3, mouth: 0.49, face: 0.5, ..Visibility::WHOLE });
        counters.times.mesh.record(Duration::from_micros(20));
        counters.times.age.record(Duration::from_millis(8));
        let line = counters.status_line();
        let page = page(&counters);
        let want = "frames=10 faces=7 no_face=0 rejected=0 engine_failures=0 skipped=0 left_out=0 mistimed=0 deadline_misses=0 \
                    damaged=0 cameras_opened=0 packets=0 sent=0 dropped=2 links_open=0 links_unheard=0 state=decay \
                    impaired_by=hot step=half step_by=hot step_changes=1 picture=full neutral=estimated neutral_share=0.73 \
                    neutral_forgotten=2 covered=left_eye,mouth face_score=0.0 proposed_rotation=none \
                    wait_ms=0.000/0.000/0.000 ";
        assert!(line.starts_with(want) && line.ends_with(" age_ms=8.13/8.13/8.13"), "{line}");
        for line in [
            "# TYPE facewire_frames counter",
            "facewire_frames_total{result=\"solved\"} 7",
            "facewire_link_packets_total{result=\"dropped\"} 2",
            "facewire_impairments_total{by=\"hot\"} 2",
            "facewire_step{step=\"half\"} 1",
            "facewire_visibility{part=\"left_eye\"} 0.3",
            "facewire_visibility{part=\"brows\"} 1",
            "facewire_visibility{part=\"mouth\"} 0.49",
            "facewire_stage_seconds_bucket{le=\"0.000016384\",stage=\"mesh\"} 0",
            "facewire_stage_seconds_bucket{le=\"0.000024576\",stage=\"mesh\"} 1",
            "facewire_stage_seconds_sum{stage=\"mesh\"} 0.00002",
            "facewire_age_seconds_bucket{le=\"+Inf\"} 1",
            "# EOF",
        ] {
            assert!(page.lines().any(|found| found == line), "no {line} in:\n{page}");
        }
        assert!(resident_bytes() > 1 << 20);
    }

    /// The status of the answer to a request that has ended.
    fn status(request: &str) -> u16 {
        let answer = answer(request.as_bytes(), true, &Counters::default()).unwrap();
        answer.split(' ').nth(1).unwrap().parse().unwrap()
    }

    #[test]
    fn requests_are_answered_once_they_are_whole_and_only_by_a_name_of_this_machine() {
        let many = format!("GET /metrics HTTP/1.1\r\n{}\r\n", "X: x\r\n".repeat(33));
        let requests = ["GET /metrics?name=x HTTP/1.0\r\n\r\n", "", "GET /metrics HTTP/1.1\r\nHost", &many];
        assert_eq!(requests.map(status), [200, 400, 400, 431]);
        let whole = b"GET /metrics HTTP/1.1\r\n\r\n";
        assert!((0..whole.len()).all(|length| answer(&whole[..length], false, &Counters::default()).is_none()));
        let asked = |host: &str| status(&format!("GET /metrics HTTP/1.1\r\nhost: {host}\r\n\r\n"));
        let good = ["LOCALHOST:9464", "localhost.", "127.0.0.1:9464", "127.9.9.9", "[::1]:9464", "[::1]"];
        assert_eq!(good.map(asked), [200; 6]);
        let bad = ["evil.example:9464", "localhost.evil.example", "127.0.0.1.evil.example", "192.168.1.5", "[::2]", ""];
        assert_eq!(bad.map(asked), [421; 6]);
        assert_eq!(asked("localhost\r\nHost: evil.example"), 421);
    }
}
