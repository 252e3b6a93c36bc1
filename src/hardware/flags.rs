//! A Raspberry Pi's own flags of low voltage and reduced clock rate, as the program `vcgencmd` prints them.
//!
//! Only commands that a person calls ask for them: the service starts no programs. Unlike its sensors, the flags also tell
//! what has been since the board was started.

use std::fmt;
use std::process::{Command, Stdio};

use crate::impairment::{Impairment, ImpairmentSet};

/// What the bits from 0 and, for all the time since the start, from 16 on mean.
const MEANINGS: [&str; 4] = ["low voltage", "clock rate capped", "throttled", "soft temperature limit"];
const LOW_VOLTAGE: u32 = 1 << 16 | 1;
const SLOWED_DOWN: u32 = 0b110 << 16 | 0b110;
const SOFT_LIMIT: u32 = 1 << 19 | 1 << 3;

/// The flags of the firmware.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flags(u32);

impl Flags {
    /// Asks the firmware. Returns `None` where there is no `vcgencmd`, or where it may not ask.
    #[must_use]
    pub fn ask() -> Option<Self> {
        let output = Command::new("vcgencmd").arg("get_throttled").stdin(Stdio::null()).output().ok()?;
        Self::parse(std::str::from_utf8(&output.stdout).ok()?)
    }

    fn parse(text: &str) -> Option<Self> {
        u32::from_str_radix(text.trim().strip_prefix("throttled=0x")?, 16).ok().map(Self)
    }

    /// What has impaired the board since its start. Low voltage reduces the clock rate, too, so a reduced clock rate means
    /// heat only where the voltage was never low.
    #[must_use]
    pub fn impairments(self) -> ImpairmentSet {
        let has = |bits| self.0 & bits != 0;
        let mut found = ImpairmentSet::default();
        found.set(Impairment::Undervoltage, has(LOW_VOLTAGE));
        found.set(Impairment::Hot, has(SOFT_LIMIT) || has(SLOWED_DOWN) && !has(LOW_VOLTAGE));
        found
    }
}

impl fmt::Display for Flags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = |first: usize| {
            let set = MEANINGS.iter().enumerate().filter(|(bit, _)| self.0 >> (first + bit) & 1 == 1);
            let names: Vec<_> = set.map(|(_, name)| *name).collect();
            if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
        };
        write!(f, "firmware flags 0x{:x}: {} now, {} since the start", self.0, named(0), named(16))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flags(text: &str) -> Option<(String, String)> {
        Flags::parse(text).map(|flags| (flags.impairments().to_string(), flags.to_string()))
    }

    #[test]
    fn the_flags_of_a_raspberry_pi_tell_low_voltage_from_heat() {
        let found = |text| flags(text).map(|(found, _)| found);
        let cases = [
            ("throttled=0x0\n", "none"),
            ("throttled=0x50005\n", "undervoltage"),
            ("throttled=0x50000\n", "undervoltage"),
            ("throttled=0x20002", "hot"),
            ("throttled=0xe0000", "hot"),
            ("throttled=0x80008", "hot"),
            ("throttled=0xd0008", "undervoltage,hot"),
        ];
        for (text, want) in cases {
            assert_eq!(found(text).as_deref(), Some(want), "{text}");
        }
        for nonsense in
            ["", "VCHI initialization failed\n", "error=1 error_msg=\"Command not registered\"", "throttled=x"]
        {
            assert_eq!(flags(nonsense), None);
        }
    }

    #[test]
    fn the_flags_are_named_for_now_and_for_all_the_time() {
        let shown = |text| flags(text).map(|(_, shown)| shown);
        let want = "firmware flags 0x50001: low voltage now, low voltage, throttled since the start";
        assert_eq!(shown("throttled=0x50001").as_deref(), Some(want));
        let want = "firmware flags 0x0: nothing now, nothing since the start";
        assert_eq!(shown("throttled=0x0").as_deref(), Some(want));
    }
}
