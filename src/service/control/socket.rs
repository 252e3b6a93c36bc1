//! Where the control socket is.

use std::fs::{DirBuilder, Permissions, set_permissions};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use crate::config::Listen;
use crate::service::listener::Listener;

/// Name of the socket.
pub(super) const SOCKET: &str = "control";
/// Where the service manager puts the runtime directory of the service.
const SYSTEM_FOLDER: &str = "/run/facewire";

/// Where a client looks for the service.
#[must_use]
pub(crate) fn candidates() -> Vec<PathBuf> {
    match std::env::var("RUNTIME_DIRECTORY") {
        Ok(_) => path().into_iter().collect(),
        Err(_) => path().into_iter().chain([Path::new(SYSTEM_FOLDER).join(SOCKET)]).collect(),
    }
}

/// Where the service listens: in the runtime directory of the service manager, or else of the user.
pub(super) fn path() -> Option<PathBuf> {
    let of_service = || std::env::var("RUNTIME_DIRECTORY").ok()?.split(':').next().map(PathBuf::from);
    let of_user = || std::env::var("XDG_RUNTIME_DIR").ok().map(|folder| Path::new(&folder).join("facewire"));
    let folder = of_service().or_else(of_user).filter(|folder| folder.is_absolute())?;
    Some(folder.join(SOCKET))
}

/// Opens the socket, for its user alone. One that a killed service has left is replaced.
///
/// # Errors
/// Another service listens there, or the folder cannot be written.
pub(super) fn bind(path: &Path) -> io::Result<Listener> {
    if let Some(folder) = path.parent() {
        DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    }
    let listener = Listener::bind(&Listen::Unix(path.to_owned()))?;
    set_permissions(path, Permissions::from_mode(0o600))?;
    Ok(listener)
}
