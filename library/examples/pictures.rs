//! Prints the strongest blendshapes of all faces in the JPEG pictures of a folder:
//! `cargo run --release -p facewire-library --example pictures FOLDER`

use std::time::Duration;
use std::{env, error::Error, fs};

use facewire_library::{BLENDSHAPES, Format, Options};
use turbojpeg::{Decompressor, Image, PixelFormat};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = env::args().nth(1).ok_or("usage: pictures FOLDER")?;
    let mut tracker = Options::for_stills().max_faces(4).open()?;
    let mut paths: Vec<_> =
        fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<Result<_, std::io::Error>>()?;
    paths.sort();
    for path in paths {
        let jpeg = fs::read(&path)?;
        let mut decoder = Decompressor::new()?;
        let Ok(header) = decoder.read_header(&jpeg) else { continue };
        let (width, height) = (header.width, header.height);
        let mut pixels = vec![0; width * height * 3];
        let image = Image { pixels: &mut pixels[..], width, pitch: 3 * width, height, format: PixelFormat::RGB };
        decoder.decompress(&jpeg, image)?;
        let picture = Format::Rgb.picture(&pixels, [width, height])?;
        for face in tracker.process_all(&picture, Duration::ZERO)? {
            let mut strongest: Vec<_> = BLENDSHAPES.iter().zip(face.coefficients).collect();
            strongest.sort_by(|one, other| other.1.total_cmp(&one.1));
            let named = strongest.iter().take(4).map(|(name, value)| format!("{name} {value:.2}"));
            println!("{}: {}", path.display(), named.collect::<Vec<_>>().join(", "));
        }
    }
    Ok(())
}
