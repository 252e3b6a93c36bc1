//! Checks the reader of wearers' profiles.

use facewire::calibration::{MAX_PROFILE_BYTES, ProfileFile};

/// Checks that any text is either read or refused with an error of one line. A profile that was read can be written, and
/// is the same when it is read again.
pub fn profile_file(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    match ProfileFile::parse(text) {
        Ok(file) => {
            let written = file.text();
            assert!(written.len() <= MAX_PROFILE_BYTES, "{}", written.len());
            // The file holds four decimals.
            let again = ProfileFile::parse(&written).unwrap();
            assert_eq!(again.text(), written);
            assert_eq!(again.profile.neutral, file.profile.neutral);
        }
        Err(error) => {
            let error = error.to_string();
            assert!(!error.is_empty() && !error.contains(char::is_control), "{error:?}");
        }
    }
}
