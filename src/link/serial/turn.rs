//! One link at a port: when new settings change a link, the old one may be still at its port.

use std::fs::metadata;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Devices at which links of this process are, by their numbers.
static TAKEN: Mutex<Vec<u64>> = Mutex::new(Vec::new());

/// The system's number of a device, the same under all its names; `None` where there is none.
#[must_use]
pub fn device_number(device: &Path) -> Option<u64> {
    let node = metadata(device).ok()?;
    node.file_type().is_char_device().then(|| node.rdev())
}

/// The right to be at a port, until it is dropped.
#[derive(Debug)]
pub struct Turn(Option<u64>);

impl Turn {
    /// `None` while another link is there. What is not there is for everybody.
    pub fn take(device: &Path) -> Option<Self> {
        let number = device_number(device);
        let mut taken = taken();
        if number.is_some_and(|number| taken.contains(&number)) {
            return None;
        }
        taken.extend(number);
        Some(Self(number))
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        taken().retain(|number| Some(*number) != self.0);
    }
}

fn taken() -> MutexGuard<'static, Vec<u64>> {
    TAKEN.lock().unwrap_or_else(PoisonError::into_inner)
}
