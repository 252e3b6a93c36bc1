//! An impairment is reported where it makes tracking poor, and only there.
//!
//! The tests disturb the built-in clip as a camera would (dim light with its noise, light from behind, a face that is far
//! away or cut off), and compare its coefficients with those of the undisturbed clip. To see the figures from which the
//! thresholds of `src/watch/mod.rs` come, also for films of people where the folder of reference clips exists, run
//! `cargo test --release --test impairments -- --ignored --nocapture`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]
#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "pixels")]

mod common;
#[path = "impairments/photo.rs"]
mod photo;
#[path = "impairments/track.rs"]
mod track;

use std::io::BufReader;
use std::sync::LazyLock;
use std::thread::scope;

use common::film::{decode, read_y4m};
use common::service::Service;
use common::{eventually, shared};
use facewire::capture::{Clip, Source};
use facewire_board::Impairment;
use photo::Photo;
use track::{Track, agreement};

/// White of a sensor in electrons: of one that amplifies little, and of one in dim light at its highest gain.
const BRIGHT: f32 = 6400.0;
const DIM: f32 = 400.0;
const WINDOW: u8 = 235;

struct Film {
    name: String,
    photos: Vec<Photo>,
    whole: Track,
}

impl Film {
    /// Takes every `step`th frame of a film.
    fn new(name: &str, film: &mut dyn Source, step: usize) -> Self {
        let mut photos = Vec::new();
        while let Some(frame) = film.next().unwrap() {
            if frame.number % step as u64 == 0 {
                photos.push(Photo::of(frame.picture().unwrap()));
            }
        }
        let whole = Track::of(&photos, step, |photo, _| photo.clone());
        Self { name: name.to_owned(), photos, whole }
    }

    fn demo(step: usize) -> Self {
        Self::new("demo", &mut Clip::once().unwrap(), step)
    }

    /// The film as a camera takes it: the picture and the box around the face become another picture.
    fn taken(&self, alter: impl Fn(&Photo, [f32; 4]) -> Photo) -> Track {
        Track::of(&self.photos, self.whole.step, |photo, number| alter(photo, self.whole.boxes[number]))
    }

    fn in_light(&self, light: f32, electrons: f32) -> Track {
        self.taken(|photo, _| photo.clone().exposed(light, electrons))
    }

    /// In front of a window, whose light makes the camera expose less and adds a veil to the face.
    fn against_light(&self, light: f32) -> Track {
        self.taken(|photo, face| photo.clone().exposed(light, BRIGHT).backlit(face, WINDOW, 0.05).exposed(1.0, BRIGHT))
    }

    fn far_away(&self, size: f32) -> Track {
        self.taken(|photo, _| photo.smaller(size))
    }

    fn with_few_pixels(&self, size: f32) -> Track {
        self.taken(|photo, _| {
            let inner = [photo.width, photo.height].map(|side| (side as f32 * size) as usize);
            let from = [(photo.width - inner[0]) / 2, (photo.height - inner[1]) / 2];
            photo.smaller(size).cut(from, [from[0] + inner[0], from[1] + inner[1]])
        })
    }

    /// Without a part of the face on one side of its mean box: 0 is the left side, then top, right, bottom.
    fn cut_off(&self, side: usize, share: f32) -> Track {
        let boxes = &self.whole.boxes;
        let mean = |side: usize| boxes.iter().map(|face| face[side]).sum::<f32>() / boxes.len() as f32;
        let edge = (mean(side) + share * (mean((side + 2) % 4) - mean(side))) as usize;
        self.taken(|photo, _| {
            let (mut from, mut to) = ([0, 0], [photo.width, photo.height]);
            if side < 2 {
                from[side] = edge;
            } else {
                to[side - 2] = edge;
            }
            photo.cut(from, to)
        })
    }

    /// Checks that what is told about a film fits its coefficients: the impairment if they are poor, and none if they are
    /// good. Returns their correlation.
    fn judge(&self, poor: &Track, impairment: Impairment) -> f32 {
        let r = agreement(&self.whole, poor);
        let told = poor.told();
        println!("{}: r {r:.3}, told {told}", impairment.name());
        let others = told.iter().filter(|other| *other != impairment).count();
        assert_eq!(others, 0, "r {r:.3}: {told} is told in place of {}", impairment.name());
        assert!(r >= 0.88 || told.contains(impairment), "r {r:.3}, and nothing is told");
        assert!(r <= 0.95 || !told.contains(impairment), "r {r:.3}, and {told} is told");
        r
    }

    /// As [`Film::judge`] for a film that is disturbed more and more. The first of the tracks is good, the last one is
    /// poor.
    fn judge_all(&self, tracks: impl IntoIterator<Item = Track>, impairment: Impairment) {
        let r: Vec<f32> = tracks.into_iter().map(|track| self.judge(&track, impairment)).collect();
        assert!(r[0] > 0.9 && r[r.len() - 1] < 0.88, "the test shows both sides of the threshold: {r:?}");
    }
}

static DEMO: LazyLock<Film> = LazyLock::new(|| Film::demo(6));

#[test]
fn nothing_is_told_about_the_built_in_clip() {
    assert_eq!(DEMO.whole.told().to_string(), "none");
}

#[test]
fn darkness_is_told_where_the_noise_of_dim_light_makes_the_coefficients_poor() {
    let film = &*DEMO;
    film.judge_all([1.0, 0.5, 0.125, 0.06].map(|light| film.in_light(light, DIM)), Impairment::Dark);
}

#[test]
fn a_face_whose_upper_half_is_covered_is_doubted() {
    let covered = DEMO.taken(|photo, face| photo.clone().covered(face, [0.0, 0.55]));
    assert_eq!(covered.told().to_string(), "doubtful-face");
}

#[test]
fn darkness_is_told_without_a_face_and_a_black_picture_is_told_as_black() {
    let film = &*DEMO;
    let dark = film.in_light(0.06, DIM / 4.0);
    assert!(dark.looks.iter().all(|look| look.face.is_none()), "the test is about a face that is not found");
    assert_eq!(dark.told().to_string(), "dark");
    let black = film.taken(|photo, _| photo.clone().exposed(0.0, BRIGHT));
    assert_eq!(black.told().to_string(), "black");
    let wall = film.taken(|photo, _| photo.wall().exposed(1.0, 4.0 * DIM));
    assert_eq!(wall.told().to_string(), "none", "a wall in good light");
}

#[test]
fn light_from_behind_is_told_where_it_makes_the_coefficients_poor() {
    let film = &*DEMO;
    film.judge_all([0.5, 0.25, 0.06, 0.03].map(|light| film.against_light(light)), Impairment::Backlight);
}

#[test]
fn a_small_face_is_told_before_it_is_lost() {
    let film = &*DEMO;
    assert!(film.judge(&film.far_away(0.4), Impairment::SmallFace) > 0.95);
    assert!(film.judge(&film.with_few_pixels(0.33), Impairment::SmallFace) > 0.95);
    assert_eq!(film.far_away(0.26).told().to_string(), "small-face");
    assert_eq!(film.with_few_pixels(0.1).told().to_string(), "small-face");
}

#[test]
fn a_face_that_is_cut_off_is_told_where_the_coefficients_are_poor() {
    let film = &*DEMO;
    for side in [0, 2, 3] {
        film.judge_all([0.0, 0.3].map(|share| film.cut_off(side, share)), Impairment::CutOffFace);
    }
}

/// Runs a service whose camera plays this scene and then the clip, again and again. The status line must first name the
/// impairment and then none, and the log must name its remedy once. On a busy machine, a scene may be missed.
fn assert_told(scene: &str, impairment: Impairment) {
    let toml = format!("[camera]\ndevice = \"rehearsal: {scene} 10, live 10\"\n");
    let (service, receiver) = Service::with_receiver(&toml);
    receiver.packet();
    for wanted in [impairment.name(), "none"].map(|name| format!(" impaired_by={name} ")) {
        eventually(&wanted, || service.status().contains(&wanted));
    }
    assert_eq!(service.logged(impairment.sentence()), 1, "{}", service.log());
}

#[test]
fn the_service_names_impairments_while_they_last_and_each_remedy_once() {
    scope(|scope| {
        for (scene, impairment) in [
            ("cut-off", Impairment::CutOffFace),
            ("half-rate", Impairment::HalvedRate),
            ("lossy", Impairment::MissingFrames),
            ("dark", Impairment::Dark),
        ] {
            scope.spawn(move || assert_told(scene, impairment));
        }
    });
}

#[test]
#[ignore = "prints the figures from which the thresholds come"]
fn figures() {
    let mut films = vec![Film::demo(2)];
    for (name, frames) in [("single_face.mp4", "72"), ("face_noface.mov", "72")] {
        let Some(shared) = shared() else { continue };
        let options = ["-pix_fmt", "yuv420p", "-frames:v", frames];
        let mut decoder = decode(&shared.join("footage").join(name), &options).unwrap();
        let stream = BufReader::new(decoder.stdout.take().unwrap());
        films.push(Film::new(name, &mut read_y4m(stream), 2));
        decoder.wait().unwrap();
    }
    for film in &films {
        let tell = |case: String, track: &Track| println!("{:.11} {case:24} {}", film.name, track.row(&film.whole));
        tell("undisturbed".to_owned(), &film.whole);
        for light in [1.0, 0.5, 0.25, 0.125, 0.06, 0.03, 0.015, 0.008] {
            tell(format!("backlight {light}"), &film.against_light(light));
            for electrons in [BRIGHT, BRIGHT / 4.0, DIM, DIM / 4.0] {
                tell(format!("light {light}, {electrons} e-"), &film.in_light(light, electrons));
            }
        }
        for size in [0.5, 0.4, 0.35, 0.3, 0.27, 0.25, 0.2, 0.15, 0.1] {
            tell(format!("far away {size}"), &film.far_away(size));
            tell(format!("few pixels {size}"), &film.with_few_pixels(size));
        }
        for (share, side) in
            [0.0, 0.05, 0.1, 0.15, 0.2, 0.3].iter().flat_map(|share| [0, 1, 2, 3].map(|side| (share, side)))
        {
            tell(format!("{share} cut off on side {side}"), &film.cut_off(side, *share));
        }
        tell("upside down".to_owned(), &film.taken(|photo, _| photo.upside_down()));
        for part in [[0.0, 0.55], [0.25, 0.45], [0.55, 1.0]] {
            tell(format!("covered at {part:?}"), &film.taken(|photo, face| photo.clone().covered(face, part)));
        }
        for lost in [0.02, 0.05, 0.1, 0.2] {
            let mut random = fastrand::Rng::with_seed(7);
            tell(format!("{lost} of the frames lost"), &film.whole.keeping(|_| random.f32() >= lost));
        }
        tell("half the rate".to_owned(), &film.whole.keeping(|number| number % 2 == 0));
    }
}
