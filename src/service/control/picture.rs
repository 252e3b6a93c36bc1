//! The tasks of clients that wait for the camera's next picture, or for the landmarks in it.

use facewire_face::Landmarks;
use facewire_packet::control::{PictureHead, Reply};

use super::Task;
use crate::config::ConsoleSettings;
use crate::service::picture::{Asker, Snapshot};

/// The size of a picture for which memory is taken at first.
pub(super) const USUAL_SIZE: [usize; 2] = [640, 480];
pub(super) const NO_PICTURES: &str =
    "the camera's picture stays in the service unless the settings have picture = true in [console]";
const TOO_MANY_PICTURES: &str = "too many requests for pictures are waiting: try again once the camera delivers frames";

/// Waits for a picture, and asks again with its true size if it exceeds `size`. Without a size, waits for the landmarks
/// alone.
pub(super) fn picture_of(pictures: Asker, size: Option<[usize; 2]>) -> Result<Task, &'static str> {
    let ask = move |size| pictures.ask(size).ok_or(TOO_MANY_PICTURES);
    let mut copied = ask(size.unwrap_or_default())?;
    Ok(Task::Wait(Box::new(move || {
        let copy = copied.try_recv().ok()?;
        if copy.bytes.is_empty() && size.is_some() {
            match ask(copy.size) {
                Ok(larger) => copied = larger,
                Err(why) => return Some((Reply::Refused(why.to_owned()), Vec::new())),
            }
            return None;
        }
        let points = |landmarks: Landmarks| landmarks.0.iter().map(|[x, y, _]| [*x, *y]).collect();
        let Snapshot { format, size: [width, height], full_range, time_us, landmarks, bytes, .. } = copy;
        let landmarks = landmarks.map(points);
        let rotation_deg = copy.rotation.degrees();
        let head =
            PictureHead { format, width, height, rotation_deg, full_range, bytes: bytes.len(), time_us, landmarks };
        Some((Reply::Picture(head), bytes))
    })))
}

/// Warns if programs at the control socket may see what the camera sees.
pub(super) fn warn_of_picture(settings: &ConsoleSettings) {
    if settings.picture {
        tracing::warn!("programs at the control socket may ask for the camera's picture: console.picture is true");
    }
}
