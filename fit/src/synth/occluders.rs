//! Things that hide a part of a face: what people wear, hold and have in front of it. Lengths are in centimetres.

use core::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Mat3, Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::props::Prop;
use super::rig::{Rig, piecewise};

/// What hides a part of a face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Occluder {
    Hand,
    Microphone,
    Strands,
    Fringe,
    Scarf,
    Headset,
    Mask,
    Cup,
    Goggles,
    Glove,
    Paper,
}

/// The occluders of a set, with their relative frequencies.
pub const USUAL: [(Occluder, u32); 8] = [
    (Occluder::Headset, 8),
    (Occluder::Hand, 7),
    (Occluder::Mask, 6),
    (Occluder::Microphone, 4),
    (Occluder::Scarf, 3),
    (Occluder::Cup, 3),
    (Occluder::Strands, 3),
    (Occluder::Fringe, 3),
];
/// Occluders that only judging shows, so that it can tell whether what training has never shown is noticed.
pub const STRANGE: [(Occluder, u32); 3] = [(Occluder::Goggles, 1), (Occluder::Glove, 1), (Occluder::Paper, 1)];

/// The face behind an occluder.
pub struct Behind<'a> {
    pub rig: &'a Rig,
    /// The vertices of the person's face at rest.
    pub base: &'a [Vec3],
    pub skin: Vec3,
    pub hair: Vec3,
}

impl Behind<'_> {
    /// One of the 68 usual landmarks.
    fn at(&self, landmark: usize) -> Vec3 {
        self.base[self.rig.landmarks[landmark]]
    }

    /// Height of the eyes.
    fn eyes_y(&self) -> f32 {
        f32::midpoint(self.at(36).y, self.at(45).y)
    }
}

impl Occluder {
    /// Draws one of these occluders by their frequencies.
    pub fn random(rng: &mut ChaCha8Rng, among: &[(Self, u32)]) -> Self {
        let total: u32 = among.iter().map(|(_, frequency)| frequency).sum();
        let mut left = rng.random_range(0..total.max(1));
        for (occluder, frequency) in among {
            match left.checked_sub(*frequency) {
                Some(rest) => left = rest,
                None => return *occluder,
            }
        }
        Self::Hand
    }

    pub fn build(self, rng: &mut ChaCha8Rng, face: &Behind) -> Prop {
        let mut prop = Prop::default();
        match self {
            Self::Hand => hand(rng, &mut prop, face.skin),
            Self::Microphone => microphone(rng, &mut prop),
            Self::Strands => strands(rng, &mut prop, face.hair),
            Self::Fringe => fringe(rng, &mut prop, face),
            Self::Scarf => scarf(rng, &mut prop),
            Self::Headset => headset(rng, &mut prop, face),
            Self::Mask => mask(rng, &mut prop, face),
            Self::Cup => cup(rng, &mut prop, face),
            Self::Goggles => goggles(rng, &mut prop, face),
            Self::Glove => {
                let colour = cloth_colour(rng);
                hand(rng, &mut prop, colour);
            }
            Self::Paper => paper(rng, &mut prop, face),
        }
        prop
    }
}

fn cloth_colour(rng: &mut ChaCha8Rng) -> Vec3 {
    let hue = Vec3::new(rng.random(), rng.random(), rng.random());
    hue * hue * rng.random_range(0.1..1.0)
}

/// The colour of a device: black, white or grey, with a slight tint.
fn device_colour(rng: &mut ChaCha8Rng) -> Vec3 {
    let grey = match rng.random_range(0..4) {
        0 | 1 => rng.random_range(0.008..0.05),
        2 => rng.random_range(0.35..0.8),
        _ => rng.random_range(0.05..0.35),
    };
    let tint = Vec3::new(rng.random_range(0.85..1.1), 1.0, rng.random_range(0.85..1.15));
    grey * tint
}

fn axes(along: Vec3, half: Vec3) -> Mat3 {
    let along = along.normalize_or(Vec3::Y);
    let right = along.cross(Vec3::Z).normalize_or(Vec3::X);
    Mat3::from_cols(right * half.x, along * half.y, right.cross(along) * half.z)
}

fn random_side(rng: &mut ChaCha8Rng) -> f32 {
    if rng.random() { 1.0 } else { -1.0 }
}

/// A hand on the chin, before the mouth, on the cheek or an eye of one side. Its fingers point upwards.
fn hand(rng: &mut ChaCha8Rng, prop: &mut Prop, skin: Vec3) {
    let side = random_side(rng);
    let reach: f32 = if rng.random_bool(0.3) { rng.random_range(-1.0..3.0) } else { rng.random_range(3.0..7.0) };
    let height: f32 = rng.random_range(-13.0..-3.0);
    let palm = Vec3::new(side * reach, height, 12.8 - 0.09 * reach * reach - 0.03 * (height + 1.0).powi(2));
    let up = Vec3::new(-side * rng.random_range(-0.2..0.4), 1.0, 0.05).normalize_or(Vec3::Y);
    let across = up.cross(Vec3::Z).normalize_or(Vec3::X);
    let shade = |unit: Vec3| skin * (0.92 + 0.08 * unit.y);
    prop.ellipsoid(palm, axes(up, Vec3::new(3.6, 4.2, 1.1)), shade);
    for finger in 0_u8..4 {
        let offset = f32::from(finger) - 1.5;
        let length = 3.6 - 0.35 * offset * offset + rng.random_range(-0.3..0.3);
        let direction = (up + 0.08 * offset * across).normalize_or(up);
        let centre = palm + offset * 1.75 * across + (3.2 + 0.75 * length) * direction;
        prop.ellipsoid(centre, axes(direction, Vec3::new(0.85, length, 0.8)), shade);
    }
    prop.ellipsoid(palm - 7.0 * up, axes(up, Vec3::new(2.9, 6.0, 2.2)), shade);
}

fn microphone(rng: &mut ChaCha8Rng, prop: &mut Prop) {
    let head = Vec3::new(rng.random_range(-3.0..3.0), rng.random_range(-9.0..-4.5), rng.random_range(13.0..17.0));
    let grey = rng.random_range(0.01..0.2);
    let radius = rng.random_range(1.8..3.2);
    let grid = move |unit: Vec3| Vec3::splat(grey * (1.0 + 0.5 * (14.0 * unit.x).sin() * (14.0 * unit.y).sin()));
    prop.ellipsoid(head, Mat3::from_diagonal(Vec3::splat(radius)), grid);
    let along = Vec3::new(rng.random_range(-0.7..0.7), -1.0, rng.random_range(-0.2..0.6));
    let handle = head + (radius + 6.0) * along.normalize_or(Vec3::NEG_Y);
    prop.ellipsoid(handle, axes(along, Vec3::new(1.1, 8.0, 1.1)), |_| Vec3::splat(0.6 * grey));
}

/// Hair that falls over one side of the face.
fn strands(rng: &mut ChaCha8Rng, prop: &mut Prop, hair: Vec3) {
    let side = random_side(rng);
    let (inner, length) = (rng.random_range(0.0..3.5), rng.random_range(2.5..6.0));
    for strand in 0_u8..7 {
        let x = inner + 0.75 * f32::from(strand) + rng.random_range(-0.2..0.2);
        let lean = side * rng.random_range(-0.05..0.3);
        add_strand(rng, prop, Vec2::new(side * x, 10.2 - 0.8 * length), length, lean, hair);
    }
}

/// Hair over the whole forehead, down to the brows or the eyes.
fn fringe(rng: &mut ChaCha8Rng, prop: &mut Prop, face: &Behind) {
    let end_y = face.eyes_y() + rng.random_range(-0.8..3.0);
    let top_y = 11.0;
    let lean = rng.random_range(-0.25..0.25);
    for strand in -8_i8..=8 {
        let x = 0.72 * f32::from(strand) + rng.random_range(-0.2..0.2);
        let length = 0.5 * (top_y - end_y) + rng.random_range(-0.3..0.3);
        let own_lean = lean + rng.random_range(-0.08..0.08);
        add_strand(rng, prop, Vec2::new(x, top_y - length), length, own_lean, face.hair);
    }
}

fn add_strand(rng: &mut ChaCha8Rng, prop: &mut Prop, at: Vec2, length: f32, lean: f32, hair: Vec3) {
    let along = Vec3::new(lean, -1.0, 0.1);
    let centre = Vec3::new(at.x, at.y, 11.4 - 0.075 * at.x * at.x);
    let light = rng.random_range(0.7..1.3);
    let shade = |unit: Vec3| hair * light * (1.0 + 0.3 * (20.0 * unit.x).sin());
    prop.ellipsoid(centre, axes(along, Vec3::new(0.55, length, 0.4)), shade);
}

fn scarf(rng: &mut ChaCha8Rng, prop: &mut Prop) {
    let hue = Vec3::new(rng.random(), rng.random(), rng.random());
    let (stripes, strength) = (rng.random_range(0.0..25.0), rng.random_range(0.0..0.6));
    let top = rng.random_range(-6.5..-1.5);
    let half = rng.random_range(3.5..6.0);
    let cloth = move |unit: Vec3| hue * hue * (1.0 - strength * (0.5 + 0.5 * (stripes * unit.y).sin()));
    let centre = Vec3::new(0.0, top - half, 4.0);
    prop.ellipsoid(centre, Mat3::from_diagonal(Vec3::new(9.0, half, 9.5)), cloth);
}

const OUTLINE: u16 = 36;

/// A headset for virtual reality: a box with round corners before the eyes, a strap to each side, often one over the head.
fn headset(rng: &mut ChaCha8Rng, prop: &mut Prop, face: &Behind) {
    let bridge = face.at(27);
    let tip = face.at(30);
    let top = face.eyes_y() + rng.random_range(2.4..5.2);
    let bottom = tip.y + rng.random_range(-0.4..1.9);
    let half = Vec2::new(face.at(0).x.abs() * rng.random_range(0.95..1.3), 0.5 * (top - bottom));
    let middle = Vec2::new(rng.random_range(-0.3..0.3), f32::midpoint(top, bottom));
    let corner = rng.random_range(2.6..8.0);
    let notch = if rng.random_bool(0.7) { rng.random_range(0.4..1.6) } else { 0.0 };
    let front_z = bridge.z + rng.random_range(2.8..8.5);
    let bulge = rng.random_range(0.0..0.03);
    let colour = device_colour(rng);
    let panel = if rng.random_bool(0.5) { device_colour(rng) } else { colour };
    let outline = |share: f32, z: f32, curve: f32| {
        (0..OUTLINE).map(move |step| {
            let round = Vec2::from_angle(f32::from(step) / f32::from(OUTLINE) * TAU);
            let stretched = |value: f32| value.signum() * value.abs().powf(2.0 / corner);
            let mut at = middle + share * half * Vec2::new(stretched(round.x), stretched(round.y));
            if round.y < 0.0 {
                at.y += notch * (-(at.x / 1.5).powi(2)).exp();
            }
            Vec3::new(at.x, at.y, z - curve * at.x * at.x)
        })
    };
    let edge_share = rng.random_range(0.82..0.97);
    let rings = [
        outline(1.0, bridge.z + 0.4, 0.06).collect::<Vec<_>>(),
        outline(1.0, front_z - 0.8, bulge).collect(),
        outline(edge_share, front_z, bulge).collect(),
    ];
    let shades = [0.55, 0.75, 1.0];
    let rings: Vec<Vec<u32>> = rings
        .iter()
        .zip(shades)
        .map(|(ring, shade)| ring.iter().map(|point| prop.vertex(*point, shade * colour)).collect())
        .collect();
    for pair in rings.windows(2) {
        join(prop, &pair[0], &pair[1]);
    }
    let front: Vec<u32> = outline(edge_share, front_z, bulge).map(|point| prop.vertex(point, panel)).collect();
    let centre = prop.vertex(Vec3::new(middle.x, middle.y, front_z + 0.2), panel * rng.random_range(0.7..1.3));
    for (one, next) in front.iter().zip(front.iter().cycle().skip(1)) {
        prop.triangles.extend([[centre, *one, *next], [centre, *next, *one]]);
    }
    if rng.random_bool(0.5) {
        for sign in [-1.0, 1.0] {
            let at = Vec3::new(sign * 0.55 * half.x, middle.y + rng.random_range(-0.4..0.4) * half.y, front_z - 0.2);
            let radius = rng.random_range(0.4..1.0);
            prop.ellipsoid(at, Mat3::from_diagonal(Vec3::splat(radius)), |_| Vec3::splat(0.01));
        }
    }
    let strap = cloth_colour(rng) * 0.3;
    let width = rng.random_range(0.8..2.0);
    for sign in [-1.0, 1.0] {
        let from = Vec3::new(sign * half.x, middle.y, bridge.z - 2.0);
        let to = Vec3::new(sign * (face.at(0).x.abs() + 1.0), middle.y + 0.5, -4.0);
        bar(prop, [from, to], Vec3::Y * width, strap);
    }
    if rng.random_bool(0.5) {
        bar(prop, [Vec3::new(0.0, top, front_z - 2.0), Vec3::new(0.0, 13.5, 3.0)], Vec3::X * width, strap);
    }
}

/// Joins two rings by quadrilaterals.
fn join(prop: &mut Prop, one: &[u32], other: &[u32]) {
    for index in 0..one.len() {
        let next = (index + 1) % one.len();
        prop.quad([one[index], other[index], other[next], one[next]]);
    }
}

/// A flat bar between two points, `half` wide to either side.
fn bar(prop: &mut Prop, [from, to]: [Vec3; 2], half: Vec3, colour: Vec3) {
    let corners = [from - half, to - half, to + half, from + half].map(|point| prop.vertex(point, colour));
    prop.quad(corners);
}

const MASK_COLUMNS: u16 = 24;
const MASK_ROWS: u16 = 16;

/// A face mask, from the nose to below the chin, or worn below the nose.
fn mask(rng: &mut ChaCha8Rng, prop: &mut Prop, face: &Behind) {
    let chin = face.at(8);
    let tip = face.at(30);
    let centre_z = 5.0;
    let (above, below) = if rng.random_bool(0.8) {
        (rng.random_range(0.3..2.2), rng.random_range(0.3..2.0))
    } else {
        (rng.random_range(-2.4..-1.2), rng.random_range(0.3..2.0))
    };
    let [top, bottom] = [tip.y + above, chin.y - below];
    let gap = rng.random_range(0.3..0.9);
    let half_width = face.at(4).x.abs().max(face.at(12).x.abs()) * rng.random_range(1.02..1.15);
    // Heights and the depths of the cloth there, from chin to nose.
    let depths =
        [(chin.y, chin.z), (face.at(57).y, face.at(57).z + 0.5), (face.at(51).y, face.at(51).z + 0.6), (tip.y, tip.z)];
    let depths = depths.map(|(y, z)| (y, z + gap - centre_z));
    let colour = match rng.random_range(0..4) {
        0 => Vec3::new(0.2, 0.42, 0.6),
        1 => Vec3::splat(rng.random_range(0.5..0.85)),
        2 => Vec3::splat(rng.random_range(0.01..0.05)),
        _ => cloth_colour(rng),
    };
    let (pleats, depth) = (rng.random_range(2.0..12.0), rng.random_range(0.0..0.35));
    let droop = rng.random_range(0.0..0.09);
    let mut grid = Vec::new();
    for row in 0..=MASK_ROWS {
        let share = f32::from(row) / f32::from(MASK_ROWS);
        for column in 0..=MASK_COLUMNS {
            let angle = (f32::from(column) / f32::from(MASK_COLUMNS) - 0.5) * 0.9 * PI;
            let x = half_width * angle.sin() * (0.78 + 0.22 * (share * FRAC_PI_2).sin());
            let y = bottom + share * (top - droop * x * x - bottom);
            let z = centre_z + piecewise(&depths, y) * angle.cos();
            let shade = colour * (1.0 - depth * (0.5 + 0.5 * (pleats * share * PI).sin()));
            grid.push(prop.vertex(Vec3::new(x, y, z), shade * (0.7 + 0.3 * angle.cos())));
        }
    }
    let at = |row: u16, column: u16| grid[usize::from(row * (MASK_COLUMNS + 1) + column)];
    for (row, column) in (0..MASK_ROWS).flat_map(|row| (0..MASK_COLUMNS).map(move |column| (row, column))) {
        let [a, b, c, d] = [at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column)];
        prop.triangles.extend([[a, b, c], [a, c, d]]);
    }
    for sign in [-1.0, 1.0] {
        for height in [0.25, 0.8] {
            let from = Vec3::new(sign * half_width * 0.97, bottom + height * (top - bottom), centre_z + 1.0);
            let to = Vec3::new(sign * (face.at(1).x.abs() + 0.6), face.at(1).y + 1.0, -2.0);
            bar(prop, [from, to], Vec3::Y * 0.15, colour);
        }
    }
}

fn cup(rng: &mut ChaCha8Rng, prop: &mut Prop, face: &Behind) {
    const RINGS: u16 = 6;
    const AROUND: u16 = 20;
    let mouth = face.at(51).lerp(face.at(57), 0.5);
    let radius = rng.random_range(2.6..4.3);
    let height = rng.random_range(6.0..12.0);
    let top = mouth
        + Vec3::new(rng.random_range(-1.5..1.5), rng.random_range(-1.0..4.0), radius + rng.random_range(0.2..3.0));
    let tilt = Vec3::new(rng.random_range(-0.15..0.15), -1.0, rng.random_range(0.0..0.7)).normalize_or(Vec3::NEG_Y);
    let colour = if rng.random_bool(0.4) { Vec3::splat(rng.random_range(0.4..0.85)) } else { cloth_colour(rng) };
    let (stripes, strength) = (rng.random_range(0.0..9.0), rng.random_range(0.0..0.7));
    let first = u32::try_from(prop.points.len()).unwrap_or(u32::MAX);
    let across = tilt.cross(Vec3::Z).normalize_or(Vec3::X);
    let forward = across.cross(tilt);
    for ring in 0..=RINGS {
        let share = f32::from(ring) / f32::from(RINGS);
        for step in 0..AROUND {
            let round = Vec2::from_angle(f32::from(step) / f32::from(AROUND) * TAU);
            let wide = radius * (1.0 - 0.2 * share);
            let point = top + share * height * tilt + wide * (round.y * forward - round.x * across);
            prop.vertex(point, colour * (1.0 - strength * (0.5 + 0.5 * (stripes * share * PI).sin())));
        }
    }
    prop.tube(first, RINGS, AROUND);
    if rng.random_bool(0.7) {
        let side = random_side(rng);
        for finger in 0_u8..4 {
            let at = top + (0.25 + 0.17 * f32::from(finger)) * height * tilt;
            let centre = at + Vec3::new(side * 0.55 * radius, 0.0, 0.75 * radius);
            let shade = |unit: Vec3| face.skin * (0.92 + 0.08 * unit.y);
            prop.ellipsoid(centre, axes(Vec3::new(side, 0.1, -0.6), Vec3::new(0.85, 2.6, 0.8)), shade);
        }
    }
}

/// Goggles for skiing: one round and mirrored pane before both eyes.
fn goggles(rng: &mut ChaCha8Rng, prop: &mut Prop, face: &Behind) {
    let half = Vec3::new(rng.random_range(7.0..8.2), rng.random_range(2.6..3.8), face.at(27).z - 3.5);
    let centre = Vec3::new(0.0, face.eyes_y() + rng.random_range(-0.3..0.8), 5.5);
    let colours = [cloth_colour(rng), cloth_colour(rng)];
    let mirrored = |unit: Vec3| colours[0].lerp(colours[1], 0.5 + 0.5 * unit.y) * (1.0 + 0.4 * (3.0 * unit.x).sin());
    prop.ellipsoid(centre, Mat3::from_diagonal(half), mirrored);
    let strap = cloth_colour(rng);
    for sign in [-1.0, 1.0] {
        let from = Vec3::new(sign * 6.8, centre.y, 7.0);
        bar(prop, [from, Vec3::new(sign * 8.2, centre.y, -4.0)], Vec3::Y * 1.4, strap);
    }
}

/// A sheet of paper, a book or a telephone before a part of the face.
fn paper(rng: &mut ChaCha8Rng, prop: &mut Prop, face: &Behind) {
    const LINES: u16 = 12;
    let is_low = rng.random_bool(0.6);
    let y = if is_low { rng.random_range(-9.0..-5.0) } else { face.eyes_y() + rng.random_range(-0.5..3.0) };
    let centre = Vec3::new(rng.random_range(-3.0..3.0), y, rng.random_range(15.0..19.0));
    let turn = Vec2::from_angle(rng.random_range(-0.5..0.5));
    let across = Vec3::new(turn.x, turn.y, 0.0) * rng.random_range(2.5..7.0);
    let up = Vec3::new(-turn.y, turn.x, rng.random_range(-0.4..0.2)) * rng.random_range(2.5..5.5);
    let ground = if rng.random_bool(0.5) { Vec3::splat(rng.random_range(0.3..0.8)) } else { cloth_colour(rng) };
    let ink = rng.random_range(0.1..1.0);
    let row = |prop: &mut Prop, line: u16| {
        let share = 2.0 * f32::from(line) / f32::from(LINES) - 1.0;
        let colour = if line.is_multiple_of(2) { ground } else { ground * ink };
        [-1.0, 1.0].map(|side| prop.vertex(centre + side * across + share * up, colour))
    };
    let mut last = row(prop, 0);
    for line in 1..=LINES {
        let next = row(prop, line);
        prop.quad([last[0], last[1], next[1], next[0]]);
        last = next;
    }
}
