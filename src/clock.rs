//! The clocks of the machine.

mod rule;

use std::fs;
use std::time::{SystemTime, UNIX_EPOCH};

use rustix::time::{ClockId, clock_gettime};

use self::rule::Rule;

/// Returns the time of `CLOCK_MONOTONIC` in microseconds. Most drivers take their timestamps from this clock.
pub fn monotonic_us() -> u64 {
    let time = clock_gettime(ClockId::Monotonic);
    let [seconds, nanoseconds] = [time.tv_sec, time.tv_nsec].map(|part| u64::try_from(part).unwrap_or(0));
    seconds * 1_000_000 + nanoseconds / 1000
}

/// Returns a time of the system's clock in whole seconds since 1970.
pub fn seconds_since_1970(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs())
}

/// The time zone of this machine, as a file of the time zone database.
const ZONE: &str = "/etc/localtime";
/// The system's clock has been set if it differs by more than this from what it showed before and the time since then,
/// microseconds. Reading two clocks takes less on a busy machine.
const SET_US: i64 = 50_000;

/// The local time, which goes on as evenly as the monotonic clock until somebody sets the system's clock.
#[derive(Debug)]
pub struct LocalTime {
    zone: Zone,
    /// What the system's clock, in UTC, is ahead of the monotonic clock, microseconds.
    ahead_us: i64,
}

impl LocalTime {
    /// The time in the time zone of this machine, or in UTC if it has none.
    pub fn of_this_machine() -> Self {
        let zone = fs::read(ZONE).ok().and_then(|file| Zone::parse(&file)).unwrap_or_default();
        Self { zone, ahead_us: 0 }
    }

    /// Returns the microseconds since midnight of 1 January 1970 by local clocks. Does not allocate.
    pub fn now_us(&mut self) -> u64 {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.at(monotonic_us(), u64::try_from(since_1970.as_micros()).unwrap_or(0))
    }

    fn at(&mut self, monotonic_us: u64, utc_us: u64) -> u64 {
        let ahead_us = utc_us.wrapping_sub(monotonic_us).cast_signed();
        if ahead_us.abs_diff(self.ahead_us) > SET_US.unsigned_abs() {
            self.ahead_us = ahead_us;
        }
        let utc_us = monotonic_us.saturating_add_signed(self.ahead_us);
        utc_us.saturating_add_signed(self.zone.offset_s((utc_us / 1_000_000).cast_signed()) * 1_000_000)
    }
}

#[derive(Debug, Default)]
struct Zone {
    /// What local time is ahead of UTC, and since when, both in seconds. The first entry has no beginning.
    changes: Vec<(i64, i64)>,
    /// What holds after the last change. Without a rule, nothing changes any more.
    rule: Option<Rule>,
}

impl Zone {
    /// Reads a file as RFC 8536 defines it. In Debian's files, the listed changes reach to the year 2037. In others the rule begins
    /// earlier.
    fn parse(file: &[u8]) -> Option<Self> {
        // The same data come twice, first with times of 32 bits.
        let first = Counts::read(file)?;
        let file = file.get(HEADER_BYTES + first.bytes(4)..)?;
        let counts = Counts::read(file)?;
        let (times, rest) = file.get(HEADER_BYTES..)?.split_at_checked(8 * counts.changes)?;
        let (kinds, rest) = rest.split_at_checked(counts.changes)?;
        let (offsets, _) = rest.get(..6 * counts.kinds)?.as_chunks::<6>();
        let ahead_s = |kind: u8| Some(i64::from(i32::from_be_bytes(*offsets.get(usize::from(kind))?.first_chunk()?)));
        let mut changes = vec![(i64::MIN, ahead_s(0)?)];
        for (time, kind) in times.as_chunks().0.iter().zip(kinds) {
            changes.push((i64::from_be_bytes(*time), ahead_s(*kind)?));
        }
        let rule = file.get(HEADER_BYTES + counts.bytes(8)..).and_then(|rest| rest.strip_prefix(b"\n"));
        let rule = rule.and_then(|rest| rest.split(|byte| *byte == b'\n').next()).and_then(Rule::parse);
        Some(Self { changes, rule })
    }

    fn offset_s(&self, utc_s: i64) -> i64 {
        let is_after_last = self.changes.last().is_some_and(|(since_s, _)| *since_s <= utc_s);
        if let Some(rule) = self.rule.as_ref().filter(|_| is_after_last) {
            return rule.offset_s(utc_s);
        }
        self.changes.iter().rev().find(|(since_s, _)| *since_s <= utc_s).map_or(0, |(_, ahead_s)| *ahead_s)
    }
}

const HEADER_BYTES: usize = 44;

/// How much of everything the data after a header of a time zone have.
struct Counts {
    universal: usize,
    standard: usize,
    leap_seconds: usize,
    changes: usize,
    kinds: usize,
    letters: usize,
}

impl Counts {
    fn read(file: &[u8]) -> Option<Self> {
        let counts = file.strip_prefix(b"TZif")?.get(16..HEADER_BYTES - 4)?;
        let mut counts = counts.as_chunks().0.iter().map(|count| u32::from_be_bytes(*count) as usize);
        // No zone has so many, and sums do not overflow.
        let mut next = || counts.next().filter(|count| *count <= 0xFFFF);
        Some(Self {
            universal: next()?,
            standard: next()?,
            leap_seconds: next()?,
            changes: next()?,
            kinds: next()?,
            letters: next()?,
        })
    }

    /// The bytes of the data, whose times have so many bytes each.
    fn bytes(&self, of_time: usize) -> usize {
        let leap_seconds = self.leap_seconds * (of_time + 4);
        self.changes * (of_time + 1) + self.kinds * 6 + self.letters + leap_seconds + self.standard + self.universal
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A zone with these changes: when, and which of the kinds, which are so many seconds ahead of UTC. A rule may follow.
    fn zone(changes: &[(i64, u8)], kinds: &[i32], rule: &str) -> Vec<u8> {
        let header = |changes: usize, kinds: usize| {
            let counts = [0, 1, 0, changes, kinds, 4].map(|count| u32::try_from(count).unwrap().to_be_bytes());
            [&b"TZif2"[..], &[0; 15], counts.as_flattened()].concat()
        };
        let kinds_of =
            |kinds: &[i32]| kinds.iter().flat_map(|it| [&it.to_be_bytes()[..], &[0; 2]].concat()).collect::<Vec<_>>();
        let times = |bytes: usize| changes.iter().flat_map(move |(at, _)| at.to_be_bytes()[8 - bytes..].to_vec());
        let indices = || changes.iter().map(|(_, kind)| *kind);
        let data = |bytes: usize| {
            let mut data = header(changes.len(), kinds.len());
            data.extend(times(bytes).chain(indices()));
            data.extend(kinds_of(kinds));
            data.extend(b"LMT\0\0");
            data
        };
        [data(4), data(8), format!("\n{rule}\n").into_bytes()].concat()
    }

    const BERLIN: &str = "CET-1CEST,M3.5.0,M10.5.0/3";

    /// `zic -b slim` writes such files.
    #[test]
    fn summer_time_that_stands_in_the_rule_of_a_zone_alone_holds_after_the_last_listed_change() {
        let (spring, autumn) = (1_774_746_000, 1_792_890_000);
        for changes in [&[][..], &[(-2_422_054_408, 1), (autumn - 400 * 86_400, 1)]] {
            let berlin = Zone::parse(&zone(changes, &[3208, 3600], BERLIN)).unwrap();
            let offsets = [spring - 1, spring, autumn - 1, autumn].map(|at| berlin.offset_s(at));
            assert_eq!(offsets, [3600, 7200, 7200, 3600], "{changes:?}");
        }
        let before = Zone::parse(&zone(&[(autumn, 1)], &[3208, 3600], BERLIN)).unwrap();
        assert_eq!(before.offset_s(spring), 3208, "the rule does not hold before");
    }

    #[test]
    fn a_zone_says_what_local_time_is_ahead_at_each_time_and_a_cut_or_wrong_file_says_nothing() {
        // Berlin: summer time in 2026, and winter time after it.
        let (spring, autumn) = (1_774_746_000, 1_792_890_000);
        let file = zone(&[(-2_422_054_408, 1), (spring, 2), (autumn, 1)], &[3208, 3600, 7200], BERLIN);
        let berlin = Zone::parse(&file).unwrap();
        let offsets = [-3_000_000_000, 0, spring - 1, spring, autumn - 1, autumn].map(|at| berlin.offset_s(at));
        assert_eq!(offsets, [3208, 3600, 3600, 7200, 7200, 3600]);
        assert_eq!(Zone::parse(&zone(&[], &[-12_600], "")).unwrap().offset_s(spring), -12_600);
        let data = file.len() - BERLIN.len() - b"\n\nLMT\0\0".len();
        (0..data).for_each(|length| assert!(Zone::parse(&file[..length]).is_none(), "{length}"));
        assert!(Zone::parse(&zone(&[(0, 7)], &[0], "")).is_none(), "there is no seventh kind");
        assert!(Zone::parse(&[&b"TZif2"[..], &[0xFF; 100]].concat()).is_none());
        assert_eq!(Zone::default().offset_s(spring), 0);
    }

    #[test]
    fn local_time_goes_on_evenly_while_the_system_clock_is_read_unevenly_and_follows_it_when_it_is_set() {
        let noon_us = 1_774_785_600_000_000;
        let mut time = LocalTime { zone: Zone::parse(&zone(&[], &[7200], "")).unwrap(), ahead_us: 0 };
        let hours_us = |hours: u64| hours * 3_600_000_000;
        assert_eq!(time.at(1000, noon_us), noon_us + hours_us(2));
        // The thread may be interrupted between both clocks, and the system's clock may be corrected a little.
        assert_eq!(time.at(2000, noon_us + 41_000), noon_us + hours_us(2) + 1000);
        assert_eq!(time.at(3000, noon_us - 40_000), noon_us + hours_us(2) + 2000);
        assert_eq!(time.at(4000, noon_us + hours_us(5)), noon_us + hours_us(7));
        assert_eq!(time.at(5000, noon_us), noon_us + hours_us(2));
        assert_eq!(time.at(6000, 0), hours_us(2), "a board without a clock, before it knows the time");
    }
}
