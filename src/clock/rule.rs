//! The rule of a time zone for the time after its last listed change, such as `CET-1CEST,M3.5.0,M10.5.0/3`, in the form that POSIX
//! and RFC 8536 define. Files of the time zone database may list no change after 1996 and leave the rest to the rule.

const DAY_S: i64 = 86_400;

#[derive(Debug, PartialEq, Eq)]
pub(super) struct Rule {
    /// What standard time is ahead of UTC, seconds.
    standard_s: i64,
    summer: Option<Summer>,
}

#[derive(Debug, PartialEq, Eq)]
struct Summer {
    ahead_s: i64,
    begins: Change,
    ends: Change,
}

/// A change at this time of a day, by the clocks that are in force before it.
#[derive(Debug, PartialEq, Eq)]
struct Change {
    day: Day,
    time_s: i64,
}

#[derive(Debug, PartialEq, Eq)]
enum Day {
    /// From 1 to 365. 29 February is never counted.
    Common(i64),
    /// From 0 to 365.
    Any(i64),
    /// The `week`-th of these weekdays in the month, the last one if `week` is 5. Sunday is 0.
    Weekday { month: i64, week: i64, weekday: i64 },
}

impl Rule {
    /// Returns `None` if this is no rule.
    pub(super) fn parse(text: &[u8]) -> Option<Self> {
        let mut text = Text(text);
        text.name()?;
        let standard_s = -text.time()?;
        if text.0.is_empty() {
            return Some(Self { standard_s, summer: None });
        }
        text.name()?;
        let is_given = text.0.first().is_some_and(|byte| *byte != b',');
        let ahead_s = if is_given { -text.time()? } else { standard_s + 3600 };
        let begins = text.change()?;
        let ends = text.change()?;
        let summer = Some(Summer { ahead_s, begins, ends });
        text.0.is_empty().then_some(Self { standard_s, summer })
    }

    /// What local time is ahead of UTC at this time, seconds.
    pub(super) fn offset_s(&self, utc_s: i64) -> i64 {
        let Some(summer) = &self.summer else { return self.standard_s };
        let year = year_of(utc_s.saturating_add(self.standard_s).div_euclid(DAY_S));
        let begins_s = summer.begins.in_year(year) - self.standard_s;
        let ends_s = summer.ends.in_year(year) - summer.ahead_s;
        // In the south, summer time goes on over the new year.
        let is_summer =
            if begins_s < ends_s { (begins_s..ends_s).contains(&utc_s) } else { !(ends_s..begins_s).contains(&utc_s) };
        if is_summer { summer.ahead_s } else { self.standard_s }
    }
}

impl Change {
    /// Seconds from 1970 to the change, by the clocks before it.
    fn in_year(&self, year: i64) -> i64 {
        let new_year = days_until(year, 1, 1);
        let day = match self.day {
            Day::Any(day) => new_year + day,
            Day::Common(day) => {
                let is_behind_leap_day = day > 59 && days_until(year, 3, 1) - new_year == 60;
                new_year + day - 1 + i64::from(is_behind_leap_day)
            }
            Day::Weekday { month, week, weekday } => {
                let first = days_until(year, month, 1);
                let next_month = days_until(year + month / 12, month % 12 + 1, 1);
                // 1 January 1970 was a Thursday.
                let first_weekday = (first + 4).rem_euclid(7);
                let day = first + (weekday - first_weekday).rem_euclid(7) + 7 * (week - 1);
                if day < next_month { day } else { day - 7 }
            }
        };
        day * DAY_S + self.time_s
    }
}

/// Days from 1 January 1970 to a day of the Gregorian calendar.
fn days_until(year: i64, month: i64, day: i64) -> i64 {
    // Years that begin in March have their leap day at the end.
    let from_march = (month + 9) % 12;
    let year = year - i64::from(month < 3);
    let leap_days = year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400);
    let before_month = (153 * from_march + 2) / 5;
    365 * year + leap_days + before_month + day - 1 - 719_468
}

/// The year of a day, which is counted from 1 January 1970.
fn year_of(days: i64) -> i64 {
    let year = 1970 + (days.clamp(-1_000_000_000, 1_000_000_000) * 400).div_euclid(146_097);
    // The mean length of a year may be wrong by a day or two.
    let candidates = [year + 1, year, year - 1];
    candidates.into_iter().find(|year| days_until(*year, 1, 1) <= days).unwrap_or(year)
}

/// What was not read yet.
struct Text<'a>(&'a [u8]);

impl Text<'_> {
    fn take(&mut self, wanted: u8) -> Option<()> {
        let (first, rest) = self.0.split_first()?;
        (*first == wanted).then_some(())?;
        self.0 = rest;
        Some(())
    }

    /// Passes bytes as long as they are of this kind. Returns how many there were.
    fn pass(&mut self, is_wanted: fn(&u8) -> bool) -> usize {
        let count = self.0.iter().take_while(|byte| is_wanted(byte)).count();
        self.0 = self.0.get(count..).unwrap_or_default();
        count
    }

    /// Passes the name of a time: letters, or anything in angle brackets.
    fn name(&mut self) -> Option<()> {
        if self.take(b'<').is_some() {
            self.pass(|byte| *byte != b'>');
            return self.take(b'>');
        }
        (self.pass(u8::is_ascii_alphabetic) >= 3).then_some(())
    }

    fn number(&mut self, most: i64) -> Option<i64> {
        let before = self.0;
        let digits = before.get(..self.pass(u8::is_ascii_digit))?;
        let number = str::from_utf8(digits).ok()?.parse().ok()?;
        (0..=most).contains(&number).then_some(number)
    }

    /// Reads hours, or hours and minutes, or also seconds.
    fn time(&mut self) -> Option<i64> {
        let sign = if self.take(b'-').is_some() { -1 } else { 1 };
        let _ = self.take(b'+');
        let mut time_s = 3600 * self.number(167)?;
        for unit_s in [60, 1] {
            if self.take(b':').is_some() {
                time_s += unit_s * self.number(59)?;
            }
        }
        Some(sign * time_s)
    }

    fn change(&mut self) -> Option<Change> {
        self.take(b',')?;
        let day = if self.take(b'J').is_some() {
            Day::Common(self.number(365).filter(|day| *day > 0)?)
        } else if self.take(b'M').is_some() {
            let month = self.number(12).filter(|month| *month > 0)?;
            self.take(b'.')?;
            let week = self.number(5).filter(|week| *week > 0)?;
            self.take(b'.')?;
            Day::Weekday { month, week, weekday: self.number(6)? }
        } else {
            Day::Any(self.number(365)?)
        };
        let time_s = if self.take(b'/').is_some() { self.time()? } else { 2 * 3600 };
        Some(Change { day, time_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The changes between the beginning of 2026 and that of 2029, to the second, and what they lead to.
    fn changes(rule: &str) -> Vec<(i64, i64)> {
        let rule = Rule::parse(rule.as_bytes()).unwrap_or_else(|| panic!("{rule}"));
        let hours = (1_767_225_600..1_861_920_000).step_by(3600);
        let mut changes = Vec::new();
        for hour in hours {
            if rule.offset_s(hour) != rule.offset_s(hour + 3600) {
                let at = (hour..=hour + 3600).find(|at| rule.offset_s(*at) == rule.offset_s(hour + 3600));
                changes.extend(at.map(|at| (at, rule.offset_s(at))));
            }
        }
        changes
    }

    #[test]
    fn a_rule_gives_the_changes_of_the_time_zone_database() {
        let table: [(&str, &[(i64, i64)]); 7] = [
            (
                "CET-1CEST,M3.5.0,M10.5.0/3",
                &[
                    (1_774_746_000, 7200),
                    (1_792_890_000, 3600),
                    (1_806_195_600, 7200),
                    (1_824_944_400, 3600),
                    (1_837_645_200, 7200),
                    (1_856_394_000, 3600),
                ],
            ),
            (
                "IST-1GMT0,M10.5.0,M3.5.0/1",
                &[
                    (1_774_746_000, 3600),
                    (1_792_890_000, 0),
                    (1_806_195_600, 3600),
                    (1_824_944_400, 0),
                    (1_837_645_200, 3600),
                    (1_856_394_000, 0),
                ],
            ),
            (
                "<-04>4<-03>,M9.1.6/24,M4.1.6/24",
                &[
                    (1_775_358_000, -14_400),
                    (1_788_667_200, -10_800),
                    (1_806_807_600, -14_400),
                    (1_820_116_800, -10_800),
                    (1_838_257_200, -14_400),
                    (1_851_566_400, -10_800),
                ],
            ),
            (
                "<+1030>-10:30<+11>-11,M10.1.0,M4.1.0",
                &[
                    (1_775_314_800, 37_800),
                    (1_791_041_400, 39_600),
                    (1_806_764_400, 37_800),
                    (1_822_491_000, 39_600),
                    (1_838_214_000, 37_800),
                    (1_853_940_600, 39_600),
                ],
            ),
            (
                "EST5EDT,M3.2.0,M11.1.0",
                &[
                    (1_772_953_200, -14_400),
                    (1_793_512_800, -18_000),
                    (1_805_007_600, -14_400),
                    (1_825_567_200, -18_000),
                    (1_836_457_200, -14_400),
                    (1_857_016_800, -18_000),
                ],
            ),
            ("IST-5:30", &[]),
            (
                "<-02>2<-01>,M3.5.0/-1,M10.5.0/0",
                &[
                    (1_774_746_000, -3600),
                    (1_792_890_000, -7200),
                    (1_806_195_600, -3600),
                    (1_824_944_400, -7200),
                    (1_837_645_200, -3600),
                    (1_856_394_000, -7200),
                ],
            ),
        ];
        for (rule, expected) in table {
            assert_eq!(changes(rule), expected, "{rule}");
        }
        assert_eq!(Rule::parse(b"<+0530>-5:30").unwrap().offset_s(0), 19_800);
    }

    #[test]
    fn days_of_the_year_count_the_leap_day_or_not() {
        let begins = |rule| changes(rule).into_iter().step_by(2).map(|(at, _)| at).collect::<Vec<_>>();
        // 1 March, by days that leave 29 February out, and the 60th day after New Year, which is 29 February in 2028.
        assert_eq!(begins("AAA0BBB,J60/0,J300/0"), [1_772_323_200, 1_803_859_200, 1_835_481_600]);
        assert_eq!(begins("AAA0BBB,59/0,299/0"), [1_772_323_200, 1_803_859_200, 1_835_395_200]);
    }

    #[test]
    fn what_is_no_rule_is_none() {
        for text in [
            "",
            "CET",
            "CE-1",
            "CET-1CEST",
            "CET-1CEST,M3.5.0",
            "CET-1CEST,M13.5.0,M10.5.0",
            "CET-1CEST,M3.6.0,M10.5.0",
            "CET-1CEST,M3.5.0,M10.5.0/3x",
            "<+01-1",
            "CET-168",
            "CET-1:60",
            "CET-1CEST,J0,J300",
            "CET-1CEST,366,300",
            "CET-99999999999999999999",
        ] {
            assert_eq!(Rule::parse(text.as_bytes()), None, "{text}");
        }
        let rule = Rule::parse(b"CET-1CEST,M3.5.0,M10.5.0/3").unwrap();
        for utc_s in [i64::MIN, i64::MAX] {
            assert!([3600, 7200].contains(&rule.offset_s(utc_s)));
        }
    }
}
