//! The camera's picture for a program at the control socket: the hot loop copies the next one that is asked for, after its
//! result is on its way, into memory that the control thread has taken for it.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use crate::capture::Frame;
use facewire_face::{Landmarks, Picture, Pixels, Rotation};
use facewire_packet::control::PictureFormat;

/// Most pictures that wait for the next frame.
const WAITING: usize = 4;

/// Memory for a picture, and then the picture.
pub(super) struct Snapshot {
    pub(super) format: PictureFormat,
    pub(super) size: [usize; 2],
    pub(super) rotation: Rotation,
    pub(super) full_range: bool,
    pub(super) time_us: u64,
    pub(super) landmarks: Option<Landmarks>,
    /// The rows without gaps. Empty if there was no room for them.
    pub(super) bytes: Vec<u8>,
    pub(super) back: SyncSender<Self>,
}

/// Who asks for pictures, and who copies them.
#[derive(Clone)]
pub(super) struct Asker(SyncSender<Snapshot>);
pub(super) struct Copier(Receiver<Snapshot>);

pub(super) fn channel() -> (Asker, Copier) {
    let (asked, asks) = sync_channel(WAITING);
    (Asker(asked), Copier(asks))
}

impl Asker {
    /// Asks for the picture of the next frame, of at most this size. Returns `None` if too many are asked for.
    pub(super) fn ask(&self, [width, height]: [usize; 2]) -> Option<Receiver<Snapshot>> {
        let (back, copied) = sync_channel(1);
        let room = Snapshot {
            format: PictureFormat::Grey,
            size: [0; 2],
            rotation: Rotation::None,
            full_range: false,
            time_us: 0,
            landmarks: None,
            bytes: Vec::with_capacity(most_bytes(width, height)),
            back,
        };
        self.0.try_send(room).ok()?;
        Some(copied)
    }
}

impl Copier {
    /// Copies a picture if one is asked for. Neither allocates nor waits.
    pub(super) fn copy(&self, frame: &Frame, landmarks: Option<&Landmarks>) {
        let Some(picture) = frame.picture() else { return };
        let Ok(mut copy) = self.0.try_recv() else { return };
        let [width, height] = [picture.width(), picture.height()];
        copy.size = [width, height];
        copy.rotation = picture.rotation();
        copy.full_range = picture.full_range();
        copy.time_us = frame.captured_us;
        copy.landmarks = landmarks.cloned();
        if most_bytes(width, height) <= copy.bytes.capacity() {
            copy.format = write(picture, &mut copy.bytes);
        }
        let back = copy.back.clone();
        let _ = back.try_send(copy);
    }
}

fn most_bytes(width: usize, height: usize) -> usize {
    2 * (width + 1) * (height + 1)
}

/// Appends the rows of the picture. Returns their format: planar pictures become NV12, and RGB becomes grey.
fn write(picture: &Picture, bytes: &mut Vec<u8>) -> PictureFormat {
    let width = picture.width();
    let height = picture.height();
    let [half_width, half_height] = [width, height].map(|side| side.div_ceil(2));
    let mut rows = |plane: &[u8], stride: usize, row_bytes: usize, rows: usize| {
        let rows = plane.chunks(stride).take(rows).filter_map(|row| row.get(..row_bytes));
        rows.for_each(|row| bytes.extend_from_slice(row));
    };
    match picture.pixels() {
        Pixels::Yuyv { data, stride } => {
            rows(data, stride, 4 * half_width, height);
            PictureFormat::Yuyv
        }
        // Green is close to luma.
        Pixels::Packed { data, stride, step, rgb: [_, green, _] } => {
            let rows = data.chunks(stride).take(height);
            bytes.extend(rows.flat_map(|row| row.iter().skip(green).step_by(step).take(width)));
            PictureFormat::Grey
        }
        Pixels::Grey { data, stride } => {
            rows(data, stride, width, height);
            PictureFormat::Grey
        }
        Pixels::Nv12 { luma, chroma, stride } => {
            rows(luma, stride, width, height);
            rows(chroma, stride, 2 * half_width, half_height);
            PictureFormat::Nv12
        }
        Pixels::Planar { planes: [luma, cb, cr], strides: [stride, chroma_stride], chroma_shift: [x, y] } => {
            rows(luma, stride, width, height);
            for row in 0..half_height {
                let begin = ((2 * row) >> y) * chroma_stride;
                let places = (0..half_width).map(|column| begin + ((2 * column) >> x));
                bytes.extend(places.flat_map(|at| [cb, cr].map(|plane| plane.get(at).copied().unwrap_or(128))));
            }
            PictureFormat::Nv12
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::{Clip, Content, Source as _};

    #[test]
    fn a_picture_is_copied_when_it_is_asked_for_and_without_an_allocation() {
        let (asker, copier) = channel();
        let mut clip = Clip::looped().unwrap();
        let frame = clip.next().unwrap().unwrap();
        copier.copy(&frame, None);
        let small = asker.ask([64, 48]).unwrap();
        let fits = asker.ask([640, 480]).unwrap();
        let allocated = allocation_counter::measure(|| (0..3).for_each(|_| copier.copy(&frame, None)));
        assert_eq!(allocated.count_total, 0);
        let small = small.try_recv().unwrap();
        let copy = fits.try_recv().unwrap();
        assert_eq!((small.size, small.bytes.len()), ([640, 480], 0), "it tells the size for the next time");
        let want = (PictureFormat::Nv12, 640 * 480 * 3 / 2, frame.captured_us);
        assert_eq!((copy.format, copy.bytes.len(), copy.time_us), want);
        let face = Content::Face { face: None, size_px: [0.0; 2] };
        let waits = asker.ask([640, 480]).unwrap();
        [Frame { content: face, ..frame }, frame].iter().for_each(|frame| copier.copy(frame, None));
        assert!(waits.try_recv().is_ok(), "a frame without a picture leaves the request for the next one");
        let _waiting: Vec<_> = (0..WAITING).map(|_| asker.ask([6, 4]).unwrap()).collect();
        assert!(asker.ask([6, 4]).is_none());
    }

    #[test]
    fn rows_of_every_format_are_copied_without_their_gaps_and_with_the_chroma_of_every_second_pixel() {
        let data: Vec<u8> = (0..64).collect();
        let planes = [&data[..], &data[32..], &data[48..]];
        let packed = Pixels::Packed { data: &data, stride: 10, step: 3, rgb: [2, 1, 0] };
        let nv12 = Pixels::Nv12 { luma: &data, chroma: &data[32..], stride: 5 };
        let planar = |chroma_shift| Pixels::Planar { planes, strides: [4, 4], chroma_shift };
        for (pixels, want) in [
            (Pixels::Grey { data: &data, stride: 4 }, (PictureFormat::Grey, vec![0, 1, 2, 4, 5, 6])),
            (packed, (PictureFormat::Grey, vec![1, 4, 7, 11, 14, 17])),
            (Pixels::Yuyv { data: &data, stride: 10 }, (PictureFormat::Yuyv, (0..8).chain(10..18).collect())),
            (nv12, (PictureFormat::Nv12, vec![0, 1, 2, 5, 6, 7, 32, 33, 34, 35])),
            (planar([1, 1]), (PictureFormat::Nv12, vec![0, 1, 2, 4, 5, 6, 32, 48, 33, 49])),
            (planar([0, 0]), (PictureFormat::Nv12, vec![0, 1, 2, 4, 5, 6, 32, 48, 34, 50])),
        ] {
            let picture = Picture::new(3, 2, pixels, true).unwrap();
            let mut bytes = Vec::new();
            assert_eq!((write(&picture, &mut bytes), bytes), want);
        }
    }
}
