//! Checks the path from a camera's buffer to a network's input.

use facewire::capture::v4l2::{Layout, PixelFormat, Store};
use facewire_face::FaceBox;
use facewire_face::stages::{Block, Border, CropShape, crop};
use facewire_face::{MAX_SIDE_PX, Picture};
use v4l::format::{Colorspace, Quantization};
use v4l::{Format, FourCC};

use super::film::hash;
use super::input::Input;

/// Luma, Cb and Cr of a picture of one colour.
const COLOUR: [u8; 3] = [90, 100, 180];
/// The padding between and behind the rows, of another colour than the picture and than grey.
const PADDING: u8 = 0;
/// Larger frames are skipped, because they would slow the fuzzer down.
const MOST_BYTES: usize = 1 << 16;
/// Samples a side: those of the largest network, and fewer for the fuzzer's speed.
const SIDES: [usize; 4] = [192, 33, 7, 1];

/// Checks that a driver's format is accepted if and only if it can be read, and a buffer if and only if it is complete. A
/// region anywhere contains only pixels of the picture and its border. A JPEG image decodes to the same pixels whatever was
/// decoded before.
pub fn frame_intake(data: &[u8]) {
    let mut input = Input(data);
    let format = format(&mut input);
    let (region, shape) = (region(&mut input), shape(&mut input));
    let layout = Layout::of(&format);
    assert_eq!(layout.is_some(), can_be_read(&format), "{format}");
    let Some(layout) = layout else { return };
    if layout.stride * layout.height * 2 > MOST_BYTES {
        return;
    }
    if layout.format.is_jpeg() {
        jpeg(&layout, &mut input, &region, shape);
    } else {
        raw(&layout, usize::from(input.short()), &region, shape);
    }
}

fn format(input: &mut Input<'_>) -> Format {
    let fourccs = PixelFormat::ALL.map(|format| format.fourcc);
    let fourcc = fourccs.get(usize::from(input.byte())).copied().unwrap_or(*b"pBAA");
    let [width, height] = [input.short(), input.short()].map(u32::from);
    let stride = input.word();
    let [colorspace, quantization] = [input.byte(), input.byte()].map(u32::from);
    let mut format = Format { stride, ..Format::new(width, height, FourCC::new(&fourcc)) };
    format.colorspace = Colorspace::try_from(colorspace).unwrap_or(format.colorspace);
    format.quantization = Quantization::try_from(quantization).unwrap_or(format.quantization);
    format
}

fn can_be_read(format: &Format) -> bool {
    let [width, height, stride] = [format.width, format.height, format.stride].map(|number| number as usize);
    let row_bytes = match &format.fourcc.repr {
        b"YUYV" | b"UYVY" | b"YVYU" | b"VYUY" => (width + width % 2) * 2,
        b"NV12" | b"NV21" | b"NV16" | b"NV61" | b"YU12" | b"YV12" | b"422P" => width + width % 2,
        b"RGB3" | b"BGR3" => 3 * width,
        b"RGB4" | b"BGR4" | b"XB24" | b"AB24" | b"XR24" | b"AR24" | b"BX24" | b"BA24" | b"RX24" | b"RA24" => 4 * width,
        b"RGBP" | b"Y10 " | b"Y12 " | b"Y14 " | b"Y16 " => 2 * width,
        b"GREY" | b"MJPG" | b"JPEG" => width,
        _ => return false,
    };
    let sides_fit = [width, height].iter().all(|side| (1..=MAX_SIDE_PX).contains(side));
    sides_fit && (stride == 0 || (row_bytes..=16 * MAX_SIDE_PX).contains(&stride))
}

/// Returns a region of any numbers, or of likely numbers in eighths of a pixel and thousandths of a radian.
fn region(input: &mut Input<'_>) -> FaceBox {
    let [x, y, size, angle_rad] = if input.byte().is_multiple_of(2) {
        [(); 4].map(|()| f32::from_bits(input.word()))
    } else {
        [8.0, 8.0, 8.0, 1000.0].map(|parts| f32::from(input.short().cast_signed()) / parts)
    };
    FaceBox { centre: [x, y], size, angle_rad }
}

fn shape(input: &mut Input<'_>) -> CropShape {
    let choice = input.byte();
    let border = if choice & 1 == 0 { Border::Replicate } else { Border::Black };
    CropShape { side: SIDES[usize::from(choice >> 1) % SIDES.len()], range: [-1.0, 1.0], border }
}

fn raw(layout: &Layout, used: usize, region: &FaceBox, shape: CropShape) {
    let frame = painted(layout);
    let mut store = Store::new(*layout).unwrap();
    let padded = [&frame[..], &[PADDING; 64]].concat();
    let used = used.min(padded.len());
    assert_eq!(store.keep(&padded[..used]).is_ok(), used >= frame.len());
    store.keep(&padded).unwrap();
    let picture = store.picture().unwrap();
    assert_eq!((picture.width(), picture.height()), (layout.width, layout.height));
    let middle = FaceBox { centre: [0.0; 2], size: 0.0, angle_rad: 0.0 };
    let colour = sampled(&picture, &middle, CropShape { side: 1, border: Border::Replicate, ..shape });
    let border = [shape.range[0]; 3];
    for sample in sampled(&picture, region, shape).chunks_exact(3) {
        let is_border = shape.border == Border::Black && sample == border;
        assert!(sample == colour || is_border, "{region:?} {layout:?}");
    }
}

/// Returns a frame of one colour in the layout of a driver.
fn painted(layout: &Layout) -> Vec<u8> {
    let [luma, cb, cr] = COLOUR;
    let pairs = layout.width.div_ceil(2);
    let row = |samples: Vec<u8>| [samples.clone(), vec![PADDING; layout.stride - samples.len()]].concat();
    let rows = |samples: Vec<u8>, count: usize| row(samples).repeat(count);
    let Layout { width, height, stride, .. } = *layout;
    let luma_rows = || rows(vec![luma; width], height);
    let semi = |pair: [u8; 2], count| [luma_rows(), rows(pair.repeat(pairs), count)].concat();
    let half_row = |sample: u8| [vec![sample; pairs], vec![PADDING; stride / 2 - pairs]].concat();
    let planar = |samples: [u8; 2], count| {
        let planes = samples.map(|sample| half_row(sample).repeat(count)).concat();
        [luma_rows(), planes].concat()
    };
    let half = height.div_ceil(2);
    match &layout.format.fourcc {
        b"YUYV" => rows([luma, cb, luma, cr].repeat(pairs), height),
        b"UYVY" => rows([cb, luma, cr, luma].repeat(pairs), height),
        b"YVYU" => rows([luma, cr, luma, cb].repeat(pairs), height),
        b"VYUY" => rows([cr, luma, cb, luma].repeat(pairs), height),
        b"NV12" => semi([cb, cr], half),
        b"NV21" => semi([cr, cb], half),
        b"NV16" => semi([cb, cr], height),
        b"NV61" => semi([cr, cb], height),
        b"YU12" => planar([cb, cr], half),
        b"YV12" => planar([cr, cb], half),
        b"422P" => planar([cb, cr], height),
        // A pixel of one colour, whatever it is.
        b"RGB3" | b"BGR3" => rows(vec![luma; 3 * width], height),
        b"RGBP" => rows(vec![luma; 2 * width], height),
        b"Y10 " | b"Y12 " | b"Y14 " | b"Y16 " => rows([luma, 0].repeat(width), height),
        b"GREY" => luma_rows(),
        _ => rows(vec![luma; 4 * width], height),
    }
}

fn sampled(picture: &Picture<'_>, region: &FaceBox, shape: CropShape) -> Vec<f32> {
    let mut rows = vec![[f32::NAN; 3 * 192]; shape.side];
    crop(picture, region, shape, &mut Block::default(), &mut rows);
    rows.iter().flat_map(|row| row.iter().take(3 * shape.side)).copied().collect()
}

fn jpeg(layout: &Layout, input: &mut Input<'_>, region: &FaceBox, shape: CropShape) {
    let cut = usize::from(input.byte()) * input.0.len() / 256;
    let image = input.0;
    let decoded = |store: &mut Store, image: &[u8]| {
        store.keep(image).map(|()| hash(&store.picture().unwrap())).map_err(|fault| fault.to_string())
    };
    let mut store = Store::new(*layout).unwrap();
    let alone = decoded(&mut store, image);
    let mut used = Store::new(*layout).unwrap();
    for before in [&image[..cut], &image[cut..], image] {
        let _ = decoded(&mut used, before);
        assert_eq!(decoded(&mut used, image), alone);
    }
    assert_eq!(alone.is_ok(), store.picture().is_some());
    if let Some(picture) = store.picture() {
        assert_eq!((picture.width(), picture.height()), (layout.width, layout.height));
        assert!(sampled(&picture, region, shape).iter().all(|value| (-1.0..=1.0).contains(value)));
    }
}
