//! Faults of mappings to servos: what a board cannot do, and limits that it could not keep.

use std::fmt::Display;

use super::{
    ChannelSettings, Fault, Faults, LinkKind, LinkSettings, Loss, MaestroSettings, PaceKind, Pca9685Settings,
    ServoSettings, servo::WithChannels,
};
use crate::link::maestro::{ACCELERATION_UNIT_US_PER_S2, SPEED_UNIT_US_PER_S};
use crate::link::pca9685::{CHANNELS, Period};

/// Longest pulse of every Maestro, and of those with 12 channels or more, microseconds.
const MAESTRO_PULSES_US: [u32; 2] = [3280, 4080];

/// What a board can do.
struct Board {
    name: &'static str,
    last_channel: u32,
    longest_pulse_us: u32,
    /// Least limits of speed and acceleration that the board can keep, µs/s and µs/s².
    least_limits: [f32; 2],
}

impl Board {
    fn maestro(settings: &MaestroSettings) -> Self {
        let [every, large] = MAESTRO_PULSES_US;
        Self {
            name: "Maestro",
            last_channel: 23,
            longest_pulse_us: if settings.board.multiple_targets { large } else { every },
            least_limits: [SPEED_UNIT_US_PER_S, ACCELERATION_UNIT_US_PER_S2],
        }
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some thousands")]
    fn pca9685(settings: &Pca9685Settings) -> Self {
        let period = Period::new(settings.board.pulses_hz, settings.board.oscillator_hz);
        let longest_pulse_us = period.longest_pulse_us() as u32;
        Self { name: "PCA9685", last_channel: u32::from(CHANNELS) - 1, longest_pulse_us, least_limits: [0.0; 2] }
    }
}

/// Adds the faults of a link to a servo board.
pub(super) fn check(link: &LinkSettings, faults: &mut Faults) {
    match &link.kind {
        LinkKind::Maestro(settings) => check_channels(settings, &Board::maestro(settings), faults),
        LinkKind::Pca9685(settings) => {
            check_channels(settings, &Board::pca9685(settings), faults);
            let expected = "\"rate\" for a PCA9685: its speed limits are kept by even steps";
            need(link.pace.pace == PaceKind::Rate, "link.pace", "another pace", expected, faults);
        }
        _ => return,
    }
    let expected =
        "\"neutral\" or \"hold\" for a servo board, and loss = \"release\" for channels that are to be switched off";
    need(link.pace.loss != Loss::Silent, "link.loss", "\"silent\"", expected, faults);
}

fn check_channels<B>(settings: &WithChannels<B>, board: &Board, faults: &mut Faults) {
    let channels = &settings.channels;
    need(!channels.is_empty(), "link.channel", "[]", "at least one [[link.channel]]", faults);
    for (index, channel) in channels.iter().enumerate() {
        let number = channel.servo.channel;
        let is_first = channels.iter().take(index).all(|earlier| earlier.servo.channel != number);
        let expected = "a number that no earlier channel of this board has";
        need(is_first, "link.channel.channel", number, expected, faults);
        let expected = format!("0 to {}: these are the channels of a {}", board.last_channel, board.name);
        need(number <= board.last_channel, "link.channel.channel", number, &expected, faults);
        check_sources(channel, faults);
        check_pulses(channel, board, faults);
        check_limits(channel, board, faults);
    }
}

fn check_sources(channel: &ChannelSettings, faults: &mut Faults) {
    let number = channel.servo.channel;
    // A source with a typing error counts for nothing.
    let is_misspelt =
        |fault: &Fault| matches!(fault, Fault::Unknown { key, .. } if key.starts_with("link.channel.sources."));
    if faults.iter().any(is_misspelt) {
        return;
    }
    let has_sources = channel.sources.used().next().is_some();
    let expected = format!("at least one source for channel {number}, such as {{ jawOpen = 1.0 }}");
    need(has_sources, "link.channel.sources", "{}", &expected, faults);
    let [least, most] = channel.range();
    let moves = !has_sources || (least < 1.0 && most > 0.0);
    let expected = format!(
        "another offset for channel {number}: its sum goes from {least} to {most}, so that it always stays at one end"
    );
    need(moves, "link.channel.offset", channel.servo.offset, &expected, faults);
}

fn check_pulses(channel: &ChannelSettings, board: &Board, faults: &mut Faults) {
    let ServoSettings { channel: number, pulse_at_0_us, pulse_at_1_us, .. } = channel.servo;
    for (key, pulse_us) in
        [("link.channel.pulse_at_0_us", pulse_at_0_us), ("link.channel.pulse_at_1_us", pulse_at_1_us)]
    {
        let Board { name, longest_pulse_us, .. } = board;
        let expected =
            format!("at most {longest_pulse_us} for channel {number}: the {name} cannot make a longer pulse");
        need(pulse_us <= *longest_pulse_us, key, pulse_us, &expected, faults);
    }
    let expected = format!("another pulse than pulse_at_0_us for channel {number}: the servo would not move");
    need(pulse_at_0_us != pulse_at_1_us, "link.channel.pulse_at_1_us", pulse_at_1_us, &expected, faults);
}

/// A board that counts limits in units cannot keep one below a unit.
fn check_limits(channel: &ChannelSettings, board: &Board, faults: &mut Faults) {
    let (span_us, [least_speed, least_acceleration]) = (channel.ends().span_us(), board.least_limits);
    let ServoSettings { channel: number, speed_per_s, acceleration_per_s2, .. } = channel.servo;
    let limits = [
        ("link.channel.speed_per_s", speed_per_s, least_speed),
        ("link.channel.acceleration_per_s2", acceleration_per_s2, least_acceleration),
    ];
    for (key, limit, least) in limits.into_iter().filter(|_| span_us > 0.0) {
        let expected = format!(
            "0 or at least {:.3} for channel {number}: the {} cannot keep less",
            rounded_up(least / span_us),
            board.name
        );
        need(limit <= 0.0 || limit * span_us >= least, key, limit, &expected, faults);
    }
}

/// Rounds up to three decimals.
fn rounded_up(number: f32) -> f32 {
    (number * 1000.0).ceil() / 1000.0
}

fn need(is_good: bool, key: &'static str, value: impl Display, expected: &str, faults: &mut Faults) {
    if !is_good {
        faults.push(Fault::Together { key, value: format!("{value}"), expected: expected.to_owned() });
    }
}

#[cfg(test)]
mod tests {
    use super::super::{parse, written};

    const MAESTRO: &str = "[[link]]\nkind = \"maestro\"\n";
    const PCA9685: &str = "[[link]]\nkind = \"pca9685\"\n";
    const JAW: &str = "[[link.channel]]\nchannel = 3\nsources = { jawOpen = 1.0 }\n";

    fn faults(text: &[&str]) -> String {
        parse("file", &text.concat()).err().unwrap_or_default().to_string()
    }

    #[test]
    fn a_table_of_channels_loads_back_from_its_written_form() {
        for board in [MAESTRO, PCA9685] {
            let neck = "[[link.channel]]\nchannel = 0\noffset = 0.5\nneutral = 0.4\nspeed_per_s = 1.5\nloss = \"release\"\n\
                        [link.channel.sources]\nheadYaw = -0.0125\nheadRoll = 0.002\n";
            let settings =
                parse("file", &[board, JAW, neck, "[[link]]\naddress = \"127.0.0.1:1\"\n"].concat()).unwrap();
            assert_eq!(parse("written", &written(&settings)).unwrap(), settings);
        }
    }

    #[test]
    fn unknown_sources_and_keys_are_refused_with_the_nearest_name() {
        let typing_errors =
            "[[link.channel]]\nchannel = 1\nsources = { jawopen = 1.0, headYaw = 40.0 }\nnuetral = 0.5\n";
        let want = "file:5: link.channel.sources.jawopen is not a setting; did you mean jawOpen?\n\
                    file:5: link.channel.sources.headYaw = 40.0: give a number from -10.0 to 10.0\n\
                    file:6: link.channel.nuetral is not a setting; did you mean neutral?";
        assert_eq!(faults(&[MAESTRO, typing_errors]), want);
        assert!(faults(&["[[link]]\n", JAW]).contains("link.channel is not a setting of a link with kind = \"udp\""));
    }

    #[test]
    fn channels_that_a_board_does_not_have_or_that_share_a_number_are_refused() {
        assert_eq!(faults(&[MAESTRO]), "link.channel = []: give at least one [[link.channel]]");
        let twice = "link.channel.channel = 3: give a number that no earlier channel of this board has";
        assert_eq!(faults(&[MAESTRO, JAW, JAW]), twice);
        let jaw_16 = JAW.replace('3', "16");
        assert_eq!(faults(&[MAESTRO, &jaw_16]), "");
        assert_eq!(
            faults(&[PCA9685, &jaw_16]),
            "link.channel.channel = 16: give 0 to 15: these are the channels of a PCA9685"
        );
    }

    #[test]
    fn pulses_that_a_board_cannot_make_are_refused() {
        let too_long = faults(&[MAESTRO, JAW, "pulse_at_1_us = 3281\n"]);
        assert!(
            too_long.starts_with("link.channel.pulse_at_1_us = 3281: give at most 3280 for channel 3"),
            "{too_long}"
        );
        let mini = format!("{MAESTRO}multiple_targets = true\n");
        assert_eq!(faults(&[&mini, JAW, "pulse_at_1_us = 4080\n"]), "");
        let fast = format!("{PCA9685}pulses_hz = 400\n");
        assert!(faults(&[&fast, JAW, "pulse_at_0_us = 2600\n"]).contains("give at most 24"));
        assert!(faults(&[PCA9685, JAW, "pulse_at_0_us = 2000\n"]).contains("the servo would not move"));
    }

    #[test]
    fn a_limit_that_a_maestro_would_exceed_is_refused_with_the_least_that_it_keeps() {
        let want =
            "link.channel.speed_per_s = 0.02: give 0 or at least 0.025 for channel 3: the Maestro cannot keep less";
        assert_eq!(faults(&[MAESTRO, JAW, "speed_per_s = 0.02\n"]), want);
        assert!(faults(&[MAESTRO, JAW, "acceleration_per_s2 = 0.3\n"]).contains("at least 0.313"));
        assert_eq!(faults(&[MAESTRO, JAW, "speed_per_s = 0.025\nacceleration_per_s2 = 0.313\n"]), "");
        assert_eq!(faults(&[PCA9685, JAW, "speed_per_s = 0.02\n"]), "");
    }

    #[test]
    fn a_channel_that_follows_nothing_or_could_never_leave_an_end_is_refused() {
        assert!(faults(&[MAESTRO, "[[link.channel]]\nchannel = 3\n"]).contains("at least one source for channel 3"));
        let stuck = faults(&[MAESTRO, JAW, "offset = 1.0\n"]);
        assert!(
            stuck.starts_with("link.channel.offset = 1: give another offset for channel 3: its sum goes from 1 to 2"),
            "{stuck}"
        );
    }

    #[test]
    fn a_baud_rate_counts_on_a_serial_line_only_and_the_advice_is_one_that_a_maestro_can_follow() {
        let channels = |count: u32| (0..count).map(|number| JAW.replace('3', &number.to_string())).collect::<String>();
        let given = |lines: &str, count| faults(&[MAESTRO, lines, &channels(count)]);
        assert_eq!(given("rate_hz = 240\nbaud = 9600\n", 24), "");
        let line = "device = \"/dev/ttyS1\"\n";
        let because = "need more than 80 % of the line at /dev/ttyS1";
        for (more, count, advice) in [
            ("rate_hz = 60\n", 24, "115200: give pace = \"rate\" and rate_hz = 54: 60"),
            ("baud = 9600\n", 24, "9600: give 115200 or more: 50"),
            ("baud = 9600\nrate_hz = 60\n", 24, "9600: give 115200, pace = \"rate\" and rate_hz = 54: 60"),
            ("baud = 9600\n", 6, "9600: give 38400 or more, or pace = \"rate\" and rate_hz = 18: 50"),
        ] {
            let want = format!("link.baud = {advice} packets a second {because}");
            assert_eq!(given(&[line, more].concat(), count), want);
        }
    }

    #[test]
    fn paces_and_losses_that_do_not_suit_servos_are_refused() {
        let change = format!("{PCA9685}pace = \"change\"\n");
        assert!(faults(&[&change, JAW]).contains("\"rate\" for a PCA9685"));
        let silent = format!("{MAESTRO}loss = \"silent\"\n");
        assert!(faults(&[&silent, JAW]).contains("loss = \"release\" for channels"));
    }

    #[test]
    fn a_chip_or_a_maestro_that_two_links_share_is_refused_but_a_microcontroller_beside_a_maestro_is_not() {
        let chips = faults(&[PCA9685, JAW, PCA9685, JAW]);
        assert!(chips.starts_with("link.address = 0x40: give another bus or address"), "{chips}");
        assert!(faults(&[MAESTRO, JAW, MAESTRO, JAW]).contains("an earlier link has the same port"));
        assert_eq!(faults(&[MAESTRO, JAW, "[[link]]\nkind = \"serial\"\n"]), "");
    }
}
