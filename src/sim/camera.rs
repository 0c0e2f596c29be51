//! Pictures of the world: plain shading, one ray for each pixel.

use super::physics::RobotKey;
use super::surroundings::{RobotBody, Seen, Surroundings};
use super::world::{ObjectKind, World};
use nalgebra::{Isometry3, Point3, Vector3};
use std::sync::Arc;

/// Red, green and blue of one pixel.
type Rgb = [f64; 3];

/// Rays end here, in metres; beyond is sky.
const FAR_M: f64 = 100.0;

/// Part of the light that comes from everywhere.
const AMBIENT: f64 = 0.45;

/// Part of the light that comes from the camera, so that no surface is a blot.
const HEADLIGHT: f64 = 0.2;

/// A distance at which haze takes half of a colour, in metres.
const HAZE_M: f64 = 60.0;

const SKY: Rgb = [0.62, 0.71, 0.82];
const FLOOR: Rgb = [0.55, 0.53, 0.50];
const WALL: Rgb = [0.74, 0.72, 0.68];
const SKIN: Rgb = [0.87, 0.62, 0.48];
const ROBOT: Rgb = [0.85, 0.33, 0.12];

/// An image, top row first, left to right.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Red, green, blue of each pixel.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// A black picture.
    pub fn black(width: u32, height: u32) -> Self {
        Self { width, height, rgb: vec![0; width as usize * height as usize * 3] }
    }

    /// Lays `other` over this picture with its upper left corner at column `x` and row `y`; what
    /// lies outside is cut off.
    pub fn lay(&mut self, other: &Self, x: u32, y: u32) {
        let columns = other.width.min(self.width.saturating_sub(x)) as usize;
        if columns == 0 {
            return;
        }
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let from = row as usize * other.width as usize * 3;
            let to = ((y + row) as usize * self.width as usize + x as usize) * 3;
            self.rgb[to..to + 3 * columns].copy_from_slice(&other.rgb[from..from + 3 * columns]);
        }
    }

    /// The part of this picture from column `x` and row `y` on, `width` × `height`; black where it
    /// has none.
    pub fn cut(&self, x: u32, y: u32, width: u32, height: u32) -> Self {
        let mut part = Self::black(width, height);
        let columns = width.min(self.width.saturating_sub(x)) as usize;
        if columns == 0 {
            return part;
        }
        for row in 0..height.min(self.height.saturating_sub(y)) {
            let from = ((y + row) as usize * self.width as usize + x as usize) * 3;
            let to = row as usize * width as usize * 3;
            part.rgb[to..to + 3 * columns].copy_from_slice(&self.rgb[from..from + 3 * columns]);
        }
        part
    }
}

/// What a camera had before it at one instant, to be drawn whenever there is time.
#[derive(Clone, Debug)]
pub struct View {
    pub(super) world: Arc<World>,
    pub(super) bodies: Arc<[RobotBody]>,
    /// The robot that carries the camera, which does not see itself.
    pub(super) own: Option<RobotKey>,
    /// x looks ahead, y left, z up.
    pub(super) world_from_camera: Isometry3<f64>,
    /// Opening from left to right in radians.
    pub(super) fov_rad: f64,
    /// Columns.
    pub(super) width: u32,
    /// Rows.
    pub(super) height: u32,
}

impl View {
    /// Draws the view; some microseconds for each pixel.
    pub fn draw(&self) -> Picture {
        // Keys count from 1, so that 0 is nobody's.
        let own = self.own.unwrap_or(RobotKey(0));
        let surroundings = Surroundings { world: &self.world, bodies: &self.bodies, own };
        let origin = Point3::from(self.world_from_camera.translation.vector);
        let mut picture = Picture::black(self.width, self.height);
        // Distance of the picture plane in pixels.
        let focal = f64::from(self.width) / 2.0 / (self.fov_rad / 2.0).tan();
        let mut pixels = picture.rgb.chunks_exact_mut(3);
        for row in 0..self.height {
            let up = f64::from(self.height) / 2.0 - f64::from(row) - 0.5;
            for column in 0..self.width {
                let left = f64::from(self.width) / 2.0 - f64::from(column) - 0.5;
                let ahead = Vector3::new(focal, left, up).normalize();
                let direction = self.world_from_camera.rotation * ahead;
                let seen = surroundings.cast(&origin, &direction, FAR_M);
                let colour = seen.map_or_else(
                    || sky(&direction),
                    |seen| shade(&self.world, &seen, &origin, &direction),
                );
                let pixel = pixels.next().expect("there are width × height pixels");
                pixel.copy_from_slice(
                    &colour.map(|channel| (channel.clamp(0.0, 1.0) * 255.0).round() as u8),
                );
            }
        }
        picture
    }
}

fn mix(a: Rgb, b: Rgb, part: f64) -> Rgb {
    [0, 1, 2].map(|channel| a[channel] + part * (b[channel] - a[channel]))
}

fn sky(direction: &Vector3<f64>) -> Rgb {
    mix(SKY, [0.35, 0.5, 0.72], direction.z.max(0.0))
}

/// The colour of what a ray met: lit by a lamp high up on one side, by the camera, and from all
/// around; distant things fade.
fn shade(world: &World, seen: &Seen, origin: &Point3<f64>, direction: &Vector3<f64>) -> Rgb {
    let place = origin + direction * seen.range_m;
    let base = match seen.object {
        None => ROBOT,
        Some(id) => {
            let object = world.object(id);
            let of_kind = match object.kind {
                ObjectKind::VictimPart { part, .. } if part.is_bare() => SKIN,
                ObjectKind::VictimPart { .. } => [0.25, 0.32, 0.5],
                ObjectKind::Structure if seen.normal.z > 0.7 => tiled(FLOOR, &place),
                ObjectKind::Structure => tinted(WALL, &object.name),
            };
            object.colour.unwrap_or(of_kind)
        }
    };
    let lamp = Vector3::new(0.35, 0.55, 0.76).normalize();
    let lit = AMBIENT
        + HEADLIGHT * -seen.normal.dot(direction)
        + (1.0 - AMBIENT - HEADLIGHT) * seen.normal.dot(&lamp).max(0.0);
    let haze = 1.0 - (-seen.range_m * std::f64::consts::LN_2 / HAZE_M).exp();
    mix(base.map(|channel| channel * lit), SKY, haze)
}

/// Tiles of half a metre, told apart by a shade: they give an eye the scale and the motion.
fn tiled(base: Rgb, place: &Point3<f64>) -> Rgb {
    let odd = ((place.x * 2.0).floor() + (place.y * 2.0).floor()).rem_euclid(2.0) > 0.5;
    if odd { base.map(|channel| channel * 0.9) } else { base }
}

/// A shade of its own for each name, so that neighbours can be told apart.
fn tinted(base: Rgb, name: &str) -> Rgb {
    let sum = name.bytes().fold(7_u32, |sum, octet| sum.wrapping_mul(31) + u32::from(octet));
    let channel = |shift: u32| f64::from(sum >> shift & 0xff) / 255.0 - 0.5;
    [0, 1, 2].map(|index| base[index] * (1.0 + 0.24 * channel(8 * index as u32)))
}

/// The server's screen: pictures of cameras side by side.
#[derive(Clone, Debug)]
pub struct Screen {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Views with their upper left corners.
    pub tiles: Vec<([u32; 2], View)>,
}

impl Screen {
    /// Draws all tiles; what none covers is black.
    pub fn draw(&self) -> Picture {
        let mut picture = Picture::black(self.width, self.height);
        for ([x, y], view) in &self.tiles {
            picture.lay(&view.draw(), *x, *y);
        }
        picture
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::map_file::MapFile;
    use std::collections::BTreeMap;

    /// A room with a red box to the left ahead and a floor.
    fn view() -> View {
        let map = "name = \"m\"\nbounds = [-5.0, -5.0, 5.0, 5.0]\n\
                   [[box]]\nname = \"floor\"\ncenter = [0.0, 0.0, -0.5]\nsize = [40.0, 40.0, 1.0]\n\
                   [[box]]\nname = \"red\"\ncenter = [4.0, 1.5, 0.5]\nsize = [1.0, 1.0, 1.0]\n\
                   colour = [1.0, 0.0, 0.0]\n";
        let world = World::new(&MapFile::parse(map).unwrap(), &BTreeMap::new()).unwrap();
        View {
            world: Arc::new(world),
            bodies: Arc::from([]),
            own: None,
            world_from_camera: Isometry3::translation(0.0, 0.0, 0.5),
            fov_rad: 1.2,
            width: 64,
            height: 48,
        }
    }

    fn pixel(picture: &Picture, column: usize, row: usize) -> [u8; 3] {
        let at = (row * picture.width as usize + column) * 3;
        picture.rgb[at..at + 3].try_into().unwrap()
    }

    #[test]
    fn left_is_left_and_the_sky_is_above() {
        let picture = view().draw();
        assert_eq!(picture.rgb.len(), 64 * 48 * 3);
        // The box's middle lies at atan(1.5 / 3.5) to the left: 64/2/tan(0.6) · 0.43 = 20 columns.
        let [r, g, b] = pixel(&picture, 32 - 20, 24);
        assert!(r > 120 && g < 40 && b < 40, "{r} {g} {b}");
        let [r, g, b] = pixel(&picture, 32 + 20, 24);
        assert!(r.abs_diff(g) < 60 && b > 60, "{r} {g} {b}");
        let [r, _, b] = pixel(&picture, 32, 2);
        assert!(b > r, "sky above");
        let [r, _, b] = pixel(&picture, 32, 46);
        assert!(r >= b, "floor below");
    }

    #[test]
    fn pictures_are_laid_and_cut() {
        let mut screen = Picture::black(8, 6);
        let white = Picture { width: 4, height: 3, rgb: vec![255; 36] };
        screen.lay(&white, 6, 4);
        let lit = screen.rgb.chunks(3).filter(|pixel| pixel[0] == 255).count();
        assert_eq!(lit, 4, "the rest is cut off");
        assert_eq!(screen.cut(6, 4, 2, 2), Picture { width: 2, height: 2, rgb: vec![255; 12] });
        let part = screen.cut(7, 5, 4, 4);
        assert_eq!(part.rgb.iter().filter(|octet| **octet == 255).count(), 3);
        assert_eq!(screen.cut(u32::MAX, u32::MAX, 2, 2), Picture::black(2, 2));
        screen.lay(&white, u32::MAX, 0);
    }
}
