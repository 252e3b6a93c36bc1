//! The camera's picture as a JPEG image of at most [`MOST_WIDTH`] pixels.
//!
//! Only the rows and pixels that are shown are kept while a picture is read, so that a large one takes no more memory than a
//! small one.

use std::io;

use facewire_packet::control::{PictureFormat, PictureHead, Request};
use hyper::StatusCode;
use jpeg_encoder::{Encoder, ImageBuffer, JpegColorType};
use serde::Deserialize as _;
use serde_json::{Map, Value};

use crate::{
    control::{Connection, Control},
    web::Refusal,
};

const MOST_WIDTH: usize = 640;
const QUALITY: u8 = 70;
/// Cameras have at most this many pixels at a side.
const MOST_SIDE: usize = 8192;

const UNKNOWN: Refusal = Refusal::fixed(
    StatusCode::BAD_GATEWAY,
    "The service sends a picture that is not understood: update both programs.\n",
);

/// Asks for the newest picture. Returns a line of JSON that describes it, and then its bytes.
pub async fn newest(control: &Control) -> Result<Vec<u8>, Refusal> {
    let mut connection = control.open(&Request::Picture {}).await?;
    let mut line = connection.reply().await?.get_mut("picture").map(Value::take).ok_or(UNKNOWN)?;
    let head = PictureHead::deserialize(&line).map_err(|_| UNKNOWN)?;
    let picture = Small::read(&mut connection, &head).await?.turned(head.rotation_deg);
    let image = tokio::task::spawn_blocking(move || picture.encode())
        .await
        .map_err(|error| Refusal::failed(&error))?
        .map_err(|error| Refusal::failed(&error))?;
    if let Some(line) = line.as_object_mut() {
        // That of JPEG images is known.
        line.remove("full_range");
        stand_upright(line);
        line.extend([("format".to_owned(), "jpeg".into()), ("bytes".to_owned(), image.len().into())]);
    }
    let mut answer = format!("{line}\n").into_bytes();
    answer.extend(image);
    Ok(answer)
}

/// Asks for the landmarks of the next frame, and the size of its picture.
pub async fn landmarks(control: &Control) -> Result<Value, Refusal> {
    let mut line = control.ask(&Request::Landmarks {}).await?.get_mut("picture").map(Value::take).ok_or(UNKNOWN)?;
    if let Some(line) = line.as_object_mut() {
        line.retain(|key, _| !matches!(key.as_str(), "format" | "bytes" | "full_range"));
        stand_upright(line);
    }
    Ok(line)
}

/// Makes width and height those of the upright picture, as the landmarks and the image are.
fn stand_upright(line: &mut Map<String, Value>) {
    let rotation_deg = line.remove("rotation_deg");
    if rotation_deg.is_some_and(|turn| turn == 90 || turn == 270)
        && let (Some(width), Some(height)) = (line.remove("width"), line.remove("height"))
    {
        line.extend([("width".to_owned(), height), ("height".to_owned(), width)]);
    }
}

/// A raw picture of which every n-th pixel and row are left.
#[derive(Debug, PartialEq)]
struct Small {
    width: usize,
    height: usize,
    /// The planes of luma and of the two colour differences, of which grey pictures have none.
    planes: [Vec<u8>; 3],
}

impl Small {
    async fn read(connection: &mut Connection, head: &PictureHead) -> Result<Self, Refusal> {
        let PictureHead { format, width, height, bytes, full_range, .. } = *head;
        let row_bytes = if format == PictureFormat::Yuyv { 2 * width } else { width };
        let rows = if format == PictureFormat::Nv12 { height + height / 2 } else { height };
        let is_possible = [width, height].iter().all(|side| (2..=MOST_SIDE).contains(side) && side % 2 == 0);
        if !is_possible || bytes < row_bytes * rows {
            return Err(UNKNOWN);
        }
        let mut small = Self::new(head);
        let mut row = vec![0; row_bytes];
        for index in 0..rows {
            connection.read_exact(&mut row).await.map_err(|error| Refusal::failed(&error))?;
            small.take(head, index, &row);
        }
        if !full_range {
            small.widen();
        }
        Ok(small)
    }

    fn step(head: &PictureHead) -> usize {
        head.width.div_ceil(MOST_WIDTH)
    }

    fn new(head: &PictureHead) -> Self {
        let step = Self::step(head);
        Self { width: head.width / step, height: head.height / step, planes: Default::default() }
    }

    /// Takes the next row of the picture.
    fn take(&mut self, head: &PictureHead, index: usize, row: &[u8]) {
        let step = Self::step(head);
        let [luma, blue, red] = &mut self.planes;
        // The rows and pixels of the result, of which each has one at a multiple of the step.
        let is_shown = |row: usize| row.is_multiple_of(step) && row / step < self.height;
        let pixels = (0..self.width).map(|x| x * step);
        let at = |offset: usize| row.get(offset).copied().unwrap_or(128);
        match head.format {
            PictureFormat::Yuyv if is_shown(index) => {
                for x in pixels {
                    luma.push(at(2 * x));
                    blue.push(at(x / 2 * 4 + 1));
                    red.push(at(x / 2 * 4 + 3));
                }
            }
            // After the plane of luma, a row of pairs of colour differences serves two rows of pixels.
            PictureFormat::Nv12 if index >= head.height => {
                let first = 2 * (index - head.height);
                for _ in (first..first + 2).filter(|row| is_shown(*row)) {
                    for x in pixels.clone() {
                        blue.push(at(x / 2 * 2));
                        red.push(at(x / 2 * 2 + 1));
                    }
                }
            }
            PictureFormat::Nv12 | PictureFormat::Grey if is_shown(index) => luma.extend(pixels.map(at)),
            _ => {}
        }
    }

    /// Widens the values of video to those of JPEG images.
    fn widen(&mut self) {
        let [luma, blue, red] = &mut self.planes;
        let widened = |value: u8, zero: i32, range: i32| (i32::from(value) - zero) * 255 / range;
        luma.iter_mut().for_each(|value| *value = widened(*value, 16, 219).clamp(0, 255) as u8);
        blue.iter_mut().chain(red).for_each(|value| *value = (widened(*value, 128, 224) + 128).clamp(0, 255) as u8);
    }

    /// The picture after a clockwise turn.
    fn turned(self, rotation_deg: u32) -> Self {
        let Self { width, height, planes } = self;
        let [new_width, new_height] = if rotation_deg % 180 == 90 { [height, width] } else { [width, height] };
        let source = |x: usize, y: usize| match rotation_deg {
            90 => (height - 1 - x) * width + y,
            180 => (height - 1 - y) * width + width - 1 - x,
            270 => x * width + width - 1 - y,
            _ => y * width + x,
        };
        let places = || (0..new_height).flat_map(|y| (0..new_width).map(move |x| (x, y)));
        let turn = |plane: Vec<u8>| places().filter_map(|(x, y)| plane.get(source(x, y)).copied()).collect();
        Self { width: new_width, height: new_height, planes: planes.map(turn) }
    }

    fn encode(self) -> io::Result<Vec<u8>> {
        let mut image = Vec::new();
        Encoder::new(&mut image, QUALITY).encode_image(self).map_err(|error| io::Error::other(error.to_string()))?;
        Ok(image)
    }
}

impl ImageBuffer for Small {
    fn get_jpeg_color_type(&self) -> JpegColorType {
        let [_, blue, _] = &self.planes;
        if blue.is_empty() { JpegColorType::Luma } else { JpegColorType::Ycbcr }
    }

    fn width(&self) -> u16 {
        u16::try_from(self.width).unwrap_or(u16::MAX)
    }

    fn height(&self) -> u16 {
        u16::try_from(self.height).unwrap_or(u16::MAX)
    }

    fn fill_buffers(&self, y: u16, buffers: &mut [Vec<u8>; 4]) {
        let from = usize::from(y) * self.width;
        for (plane, buffer) in self.planes.iter().zip(buffers) {
            buffer.extend_from_slice(plane.get(from..from + self.width).unwrap_or_default());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture whose luma is the sum of the coordinates, blue 100 plus the column and red 200 minus the row.
    fn read(format: PictureFormat, width: usize, height: usize) -> Small {
        let (full_range, bytes, time_us, landmarks) = (true, 0, 0, None);
        let head = PictureHead { format, width, height, rotation_deg: 0, full_range, bytes, time_us, landmarks };
        let mut small = Small::new(&head);
        let luma = |x: usize, y: usize| (x + y) as u8;
        for y in 0..height {
            let row: Vec<u8> = match format {
                PictureFormat::Yuyv => (0..width)
                    .flat_map(|x| {
                        [luma(x, y), if x % 2 == 0 { (100 + x / 2) as u8 } else { 200_usize.wrapping_sub(y / 2) as u8 }]
                    })
                    .collect(),
                _ => (0..width).map(|x| luma(x, y)).collect(),
            };
            small.take(&head, y, &row);
        }
        if format == PictureFormat::Nv12 {
            for y in 0..height / 2 {
                let row: Vec<u8> =
                    (0..width / 2).flat_map(|x| [(100 + x) as u8, 200_usize.wrapping_sub(y) as u8]).collect();
                small.take(&head, height + y, &row);
            }
        }
        small
    }

    #[test]
    fn small_pictures_of_both_colour_formats_are_the_same() {
        let [yuyv, nv12] = [PictureFormat::Yuyv, PictureFormat::Nv12].map(|format| read(format, 32, 16));
        assert_eq!(yuyv, nv12);
        assert_eq!(
            (yuyv.width, yuyv.height, yuyv.planes[0][33], yuyv.planes[1][33], yuyv.planes[2][33]),
            (32, 16, 2, 100, 200)
        );
    }

    #[test]
    fn black_and_white_of_video_become_those_of_an_image() {
        let planes = [vec![16, 235, 0, 255, 126], vec![128, 240], vec![16, 0]];
        let mut small = Small { width: 5, height: 1, planes };
        small.widen();
        assert_eq!(small.planes, [vec![0, 255, 0, 255, 128], vec![128, 255], vec![1, 0]]);
    }

    #[test]
    fn a_picture_is_turned_clockwise_with_its_width_and_height() {
        let small = || Small { width: 3, height: 2, planes: [vec![1, 2, 3, 4, 5, 6], vec![], vec![]] };
        for (rotation_deg, want) in [
            (0, (3, [1, 2, 3, 4, 5, 6])),
            (90, (2, [4, 1, 5, 2, 6, 3])),
            (180, (3, [6, 5, 4, 3, 2, 1])),
            (270, (2, [3, 6, 2, 5, 1, 4])),
        ] {
            let turned = small().turned(rotation_deg);
            assert_eq!((turned.width, &turned.planes[0][..]), (want.0, &want.1[..]), "{rotation_deg}");
            let mut line = Map::from_iter(
                [("width", 3), ("height", 2), ("rotation_deg", rotation_deg as usize)]
                    .map(|(key, value)| (key.to_owned(), Value::from(value))),
            );
            stand_upright(&mut line);
            assert_eq!(Value::from(line), serde_json::json!({ "width": turned.width, "height": turned.height }));
        }
    }

    #[test]
    fn a_wide_picture_is_reduced_to_at_most_640_pixels() {
        for (format, width, height, want) in [
            (PictureFormat::Nv12, 1280, 720, (640, 360)),
            (PictureFormat::Yuyv, 1920, 1080, (640, 360)),
            (PictureFormat::Grey, 800, 600, (400, 300)),
            (PictureFormat::Nv12, 1922, 1082, (480, 270)),
        ] {
            let small = read(format, width, height);
            assert_eq!((small.width, small.height), want);
            assert_eq!(small.planes[0].len(), want.0 * want.1, "{format:?} {width}");
            let colours = if format == PictureFormat::Grey { 0 } else { want.0 * want.1 };
            assert_eq!((small.planes[1].len(), small.planes[2].len()), (colours, colours), "{format:?} {width}");
            let image = small.encode().unwrap();
            assert!(image.starts_with(&[0xff, 0xd8]) && image.ends_with(&[0xff, 0xd9]));
        }
    }
}
