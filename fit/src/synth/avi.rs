//! Writes Motion-JPEG AVI files: a header, the images, and an index.

/// A buffer of RIFF chunks.
struct Chunks(Vec<u8>);

impl Chunks {
    fn numbers(&mut self, values: &[u32]) -> &mut Self {
        for value in values {
            self.0.extend(value.to_le_bytes());
        }
        self
    }

    fn chunk(&mut self, id: [u8; 4], body: &[u8]) -> &mut Self {
        self.0.extend(id);
        self.numbers(&[length(body)]);
        self.0.extend(body);
        self.0.resize(self.0.len().next_multiple_of(2), 0);
        self
    }

    fn list(&mut self, id: [u8; 4], kind: [u8; 4], body: &[u8]) -> &mut Self {
        self.chunk(id, &[kind.as_slice(), body].concat())
    }
}

fn length(bytes: &[u8]) -> u32 {
    u32::try_from(bytes.len()).unwrap_or(u32::MAX)
}

/// Returns an AVI file with `frames` (JPEG images of `size`) at `rate` frames per second. It must be smaller than 4 GB.
pub fn film(frames: &[Vec<u8>], [width, height]: [u32; 2], rate: u32) -> Vec<u8> {
    let count = u32::try_from(frames.len()).unwrap_or(u32::MAX);
    let largest = frames.iter().map(|frame| length(frame)).max().unwrap_or(0);
    let (mut images, mut index) = (Chunks(vec![]), Chunks(vec![]));
    for frame in frames {
        let offset = length(&images.0) + 4;
        images.chunk(*b"00dc", frame);
        index.0.extend(b"00dc");
        // AVIIF_KEYFRAME: every image can be decoded on its own.
        index.numbers(&[0x10, offset, length(frame)]);
    }
    let mut body = Chunks(vec![]);
    body.list(*b"LIST", *b"hdrl", &header(count, largest, [width, height], rate));
    body.list(*b"LIST", *b"movi", &images.0).chunk(*b"idx1", &index.0);
    let mut file = Chunks(vec![]);
    file.list(*b"RIFF", *b"AVI ", &body.0);
    file.0
}

/// Returns the headers AVIMAINHEADER, AVISTREAMHEADER and BITMAPINFOHEADER.
fn header(count: u32, largest: u32, [width, height]: [u32; 2], rate: u32) -> Vec<u8> {
    let mut main = Chunks(vec![]);
    main.numbers(&[1_000_000 / rate, largest * rate, 0, 0x10, count, 0, 1, largest, width, height, 0, 0, 0, 0]);
    let mut stream = Chunks(b"vidsMJPG".to_vec());
    stream.numbers(&[0, 0, 0, 1, rate, 0, count, largest, u32::MAX, 0, 0, height << 16 | width]);
    let mut format = Chunks(vec![]);
    format.numbers(&[40, width, height, 24 << 16 | 1]).0.extend(b"MJPG");
    format.numbers(&[3 * width * height, 0, 0, 0, 0]);
    let mut streams = Chunks(vec![]);
    streams.chunk(*b"strh", &stream.0).chunk(*b"strf", &format.0);
    let mut all = Chunks(vec![]);
    all.chunk(*b"avih", &main.0).list(*b"LIST", *b"strl", &streams.0);
    all.0
}

#[cfg(test)]
mod tests {
    use facewire::capture::{AviSource, Source};

    use super::*;

    #[test]
    fn facewire_reads_size_rate_and_every_frame() {
        let image = turbojpeg::Image {
            pixels: vec![90_u8; 64 * 48 * 3],
            width: 64,
            pitch: 192,
            height: 48,
            format: turbojpeg::PixelFormat::RGB,
        };
        let jpeg = turbojpeg::compress(image.as_deref(), 80, turbojpeg::Subsamp::Sub2x1).expect("a JPEG").to_vec();
        let film = film(&[jpeg.clone(), jpeg.clone(), jpeg], [64, 48], 30);
        let mut source = AviSource::open(film.as_slice(), "film").expect("an AVI file");
        assert_eq!(source.frame_period_us(), Some(33_333));
        let mut count = 0;
        while let Some(frame) = source.next().expect("a frame") {
            assert_eq!(frame.picture().map(|picture| [picture.width, picture.height]), Some([64, 48]));
            count += 1;
        }
        assert_eq!(count, 3);
    }
}
