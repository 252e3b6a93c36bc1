//! Claims: which serial port belongs to which link of this process.
//!
//! `serialport` locks an open port against other processes: with TIOCEXCL, which does not hold off root, and with
//! `flock`, which does. Its attempt to open a locked port takes TIOCEXCL off the port, though, and its error does not
//! say who has the port. Links therefore claim a port before they touch it.

use std::fs::metadata;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The claimed devices by their device numbers, and the path of the link that claimed each.
static CLAIMS: Mutex<Vec<(u64, PathBuf)>> = Mutex::new(Vec::new());

/// The exclusive right of one link to a serial port, until it is dropped.
#[derive(Debug)]
pub struct PortClaim(Option<u64>);

impl PortClaim {
    /// Claims the port for one link. A path without a device cannot be contested, so the claim succeeds.
    ///
    /// # Errors
    /// Returns the path of the link that holds the port.
    pub fn acquire(device: &Path) -> Result<Self, PathBuf> {
        let number = device_number(device);
        let mut claims = claims();
        if let Some((_, holder)) = claims.iter().find(|(claimed, _)| Some(*claimed) == number) {
            return Err(holder.clone());
        }
        claims.extend(number.map(|number| (number, device.to_owned())));
        Ok(Self(number))
    }

    /// Whether there was no device to claim.
    pub fn is_empty(&self) -> bool {
        self.0.is_none()
    }
}

impl Drop for PortClaim {
    fn drop(&mut self) {
        claims().retain(|(number, _)| Some(*number) != self.0);
    }
}

/// Returns the device number, which is the same under all names of a device.
fn device_number(device: &Path) -> Option<u64> {
    let node = metadata(device).ok()?;
    node.file_type().is_char_device().then(|| node.rdev())
}

fn claims() -> MutexGuard<'static, Vec<(u64, PathBuf)>> {
    CLAIMS.lock().unwrap_or_else(PoisonError::into_inner)
}
