//! Every converter of this machine against the plain one.

use super::{Factors, GROUP, Packing, Samples, available, plain, unpackers};
use crate::testing::Random;

const FACTORS: Factors = Factors { luma: 9539, black: 16, red: 13075, green: [-3209, -6660], blue: 16525 };

fn assert_same_as_plain(samples: &Samples, groups: usize) {
    let mut wanted = vec![[[0; 4]; GROUP]; groups];
    plain(&FACTORS, samples, &mut wanted);
    for converter in available() {
        let mut output = vec![[[1; 4]; GROUP]; groups];
        // SAFETY: there are samples for all pixels.
        unsafe { converter(&FACTORS, samples, &mut output) };
        assert_eq!(output, wanted, "{samples:?}");
    }
}

#[test]
fn pixels_of_every_order_of_samples_are_those_of_the_plain_converter() {
    let mut random = Random::new(8);
    for groups in 0..40 {
        // Exactly as many samples as there must be, so that a sanitizer detects a read past their end.
        let mut bytes = |count: usize| (0..count).map(|_| u8::try_from(random.below(256)).unwrap()).collect::<Vec<_>>();
        let pixels = groups * GROUP;
        assert_same_as_plain(&Samples::Yuyv(&bytes(2 * pixels)), groups);
        assert_same_as_plain(&Samples::SemiPlanar(&bytes(pixels), &bytes(pixels)), groups);
        assert_same_as_plain(&Samples::Planar([&bytes(pixels), &bytes(pixels / 2), &bytes(pixels / 2)]), groups);
        assert_same_as_plain(&Samples::Grey(&bytes(pixels)), groups);
    }
}

#[test]
fn every_pair_of_luma_and_chroma_is_converted_as_by_the_plain_converter() {
    for luma in 0..=255 {
        let samples: Vec<u8> = (0..=255).flat_map(|chroma| [luma, chroma, 255 - luma, 255 - chroma]).collect();
        assert_same_as_plain(&Samples::Yuyv(&samples), samples.len() / 2 / GROUP);
    }
}

#[test]
fn every_unpacker_finds_the_colours_of_all_pixels_where_they_are() {
    let mut random = Random::new(9);
    for (step, rgb) in [(3, [0, 1, 2]), (3, [2, 1, 0]), (4, [0, 1, 2]), (4, [2, 1, 0]), (4, [3, 0, 1]), (5, [4, 0, 2])]
    {
        for groups in 0..20 {
            let (packing, pixels) = (Packing { step, rgb }, groups * GROUP);
            // Exactly as many bytes as there must be, so that a sanitizer detects a read past their end.
            let row: Vec<u8> = (0..step * pixels).map(|_| u8::try_from(random.below(256)).unwrap()).collect();
            let pixel = |bytes: &[u8]| [bytes[rgb[0]].into(), bytes[rgb[1]].into(), bytes[rgb[2]].into(), 0];
            let wanted: Vec<_> = row.chunks(step).map(pixel).collect();
            for unpacker in unpackers(packing) {
                let mut output = vec![[[1; 4]; GROUP]; groups];
                // SAFETY: there are bytes for all pixels, and each has its colours.
                unsafe { unpacker(&row, packing, &mut output) };
                assert_eq!(output.as_flattened(), wanted, "{packing:?}");
            }
        }
    }
}
