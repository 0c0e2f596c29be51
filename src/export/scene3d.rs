//! A small software renderer: shaded polygons, lines and points seen by a free camera.
//!
//! World coordinates are metres in any right-handed frame; pictures come out as a [`Canvas`].
//! Visibility is decided per pixel by a depth buffer, at twice the asked resolution each way, which
//! is then halved to smooth edges.

use super::canvas::{Canvas, Colour};
use nalgebra::{Isometry3, Point2, Point3, Vector3};

/// Lines and points are drawn this share of their distance nearer, so that an outline on its own
/// polygon is not lost in the polygon's depth.
const LINE_DEPTH_SHARE: f64 = 2e-3;

/// Vertical field of view of [`Camera::around`], in radians.
pub const FIELD_OF_VIEW_RAD: f64 = 0.7;

/// How the camera turns space into a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lens {
    /// Central projection; the angle is the vertical field of view in radians, below π.
    Perspective(f64),
    /// Parallel projection; the number is the height of the picture in metres.
    Parallel(f64),
}

/// Where the picture is taken from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Eye in the world.
    pub eye: Point3<f64>,
    /// What the middle of the picture shows.
    pub target: Point3<f64>,
    /// Direction that is up in the picture; must not be along the view.
    pub up: Vector3<f64>,
    /// Projection.
    pub lens: Lens,
}

impl Camera {
    /// A camera that sees the whole box `low..high` from the direction `azimuth_rad` (of the eye,
    /// counter-clockwise from x) and `elevation_rad` above the horizon, below π/2.
    pub fn around(
        low: Point3<f64>,
        high: Point3<f64>,
        azimuth_rad: f64,
        elevation_rad: f64,
    ) -> Self {
        let target = nalgebra::center(&low, &high);
        let radius = (0.5 * (high - low).norm()).max(0.1);
        let distance = radius / f64::sin(0.5 * FIELD_OF_VIEW_RAD);
        let towards_eye = Vector3::new(
            azimuth_rad.cos() * elevation_rad.cos(),
            azimuth_rad.sin() * elevation_rad.cos(),
            elevation_rad.sin(),
        );
        Self {
            eye: target + towards_eye * distance,
            target,
            up: Vector3::z(),
            lens: Lens::Perspective(FIELD_OF_VIEW_RAD),
        }
    }

    /// A view from straight above on the box `low..high`, x to the right, y up; `aspect` is width
    /// over height of the picture.
    pub fn above(low: Point3<f64>, high: Point3<f64>, aspect: f64) -> Self {
        let size = high - low;
        let target = nalgebra::center(&low, &high);
        Self {
            eye: Point3::new(target.x, target.y, high.z + 1.0),
            target,
            up: Vector3::y(),
            lens: Lens::Parallel(1.08 * size.y.max(size.x / aspect).max(0.1)),
        }
    }

    fn view(&self, width: usize, height: usize) -> View {
        let camera_from_world = Isometry3::look_at_rh(&self.eye, &self.target, &self.up);
        let half = Point2::new(0.5 * width as f64, 0.5 * height as f64);
        let scale = match self.lens {
            Lens::Perspective(angle_rad) => half.y / f64::tan(0.5 * angle_rad),
            Lens::Parallel(height_m) => height as f64 / height_m,
        };
        let perspective = matches!(self.lens, Lens::Perspective(_));
        View { camera_from_world, half, scale, perspective }
    }

    /// Pixel of a picture of `width × height` at which a point appears; `None` behind the eye.
    pub fn pixel(&self, point: &Point3<f64>, width: usize, height: usize) -> Option<Point2<f64>> {
        self.view(width, height).pixel(point)
    }

    /// The same for many points.
    pub fn pixels<'a>(
        &self,
        points: &'a [Point3<f64>],
        width: usize,
        height: usize,
    ) -> impl Iterator<Item = Option<Point2<f64>>> + 'a {
        let view = self.view(width, height);
        points.iter().map(move |point| view.pixel(point))
    }
}

/// Nearest distance that is drawn, in metres.
const NEAR_M: f64 = 0.02;

/// A camera with the picture's size worked in.
struct View {
    camera_from_world: Isometry3<f64>,
    half: Point2<f64>,
    scale: f64,
    perspective: bool,
}

impl View {
    fn pixel(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        let p = self.camera_from_world * point;
        (-p.z > NEAR_M).then(|| {
            let [x, y, _] = self.project(&p);
            Point2::new(x, y)
        })
    }

    /// Pixel and depth key of a point in front of the camera. The key grows with nearness and is
    /// linear across the picture: the inverse of depth in perspective, its negative else.
    fn project(&self, p: &Point3<f64>) -> [f64; 3] {
        let depth = -p.z;
        let (scale, key) =
            if self.perspective { (self.scale / depth, 1.0 / depth) } else { (self.scale, -depth) };
        [self.half.x + scale * p.x, self.half.y - scale * p.y, key]
    }

    /// A depth key moved towards the eye by a small share of the distance.
    fn nearer(&self, key: f64) -> f64 {
        if self.perspective { key * (1.0 + LINE_DEPTH_SHARE) } else { key + 0.01 }
    }

    /// The part of a polygon beyond the near limit, in camera coordinates.
    fn clip_near(&self, polygon: &[Point3<f64>]) -> Vec<Point3<f64>> {
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (i, a) in polygon.iter().enumerate() {
            let b = &polygon[(i + 1) % polygon.len()];
            let (before, after) = (-a.z - NEAR_M, -b.z - NEAR_M);
            if before >= 0.0 {
                kept.push(*a);
            }
            if (before > 0.0 && after < 0.0) || (before < 0.0 && after > 0.0) {
                kept.push(a + (b - a) * (before / (before - after)));
            }
        }
        kept
    }
}

struct Face {
    corners: Vec<Point3<f64>>,
    colour: Colour,
}

struct Stroke {
    points: Vec<Point3<f64>>,
    width: f64,
    colour: Colour,
}

struct Mark {
    at: Point3<f64>,
    text: String,
    scale: usize,
    colour: Colour,
}

/// Things to draw, in world coordinates.
#[derive(Default)]
pub struct Scene {
    faces: Vec<Face>,
    strokes: Vec<Stroke>,
    marks: Vec<Mark>,
    low: Option<Point3<f64>>,
    high: Option<Point3<f64>>,
}

impl Scene {
    /// An empty scene.
    pub fn new() -> Self {
        Self::default()
    }

    /// A flat convex polygon of at least three corners, shaded from both sides. With an opacity
    /// below 255 it lets what is behind shine through.
    pub fn polygon(&mut self, corners: &[Point3<f64>], colour: Colour) {
        if corners.len() >= 3 && self.include(corners) {
            self.faces.push(Face { corners: corners.to_vec(), colour });
        }
    }

    /// The outline of a polygon, `width` pixels wide.
    pub fn outline(&mut self, corners: &[Point3<f64>], width: f64, colour: Colour) {
        let mut closed = corners.to_vec();
        closed.extend(corners.first());
        self.path(&closed, width, colour);
    }

    /// Straight pieces through `points`, `width` pixels wide.
    pub fn path(&mut self, points: &[Point3<f64>], width: f64, colour: Colour) {
        if points.len() >= 2 && self.include(points) {
            self.strokes.push(Stroke { points: points.to_vec(), width, colour });
        }
    }

    /// A dot of `size` pixels.
    pub fn point(&mut self, at: Point3<f64>, size: f64, colour: Colour) {
        if self.include(&[at]) {
            self.strokes.push(Stroke { points: vec![at], width: size, colour });
        }
    }

    /// A box with its centre at `pose` and the lengths `size`, in one colour.
    pub fn block(&mut self, pose: &Isometry3<f64>, size: &Vector3<f64>, colour: Colour) {
        let corner = |x: f64, y: f64, z: f64| {
            pose * Point3::from(size.component_mul(&Vector3::new(x, y, z)) * 0.5)
        };
        for side in [-1.0, 1.0] {
            let ring = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
            self.polygon(&ring.map(|(a, b)| corner(side, a, b)), colour);
            self.polygon(&ring.map(|(a, b)| corner(a, side, b)), colour);
            self.polygon(&ring.map(|(a, b)| corner(a, b, side)), colour);
        }
    }

    /// The axes of a frame: x red, y green, z blue, `length_m` long.
    pub fn axes(&mut self, pose: &Isometry3<f64>, length_m: f64, width: f64) {
        let colours =
            [Colour::rgb(210, 40, 40), Colour::rgb(40, 160, 40), Colour::rgb(50, 80, 220)];
        for (axis, colour) in colours.into_iter().enumerate() {
            let tip = Point3::from(Vector3::ith(axis, length_m));
            self.path(&[pose * Point3::origin(), pose * tip], width, colour);
        }
    }

    /// Text beside a point, always readable and never hidden.
    pub fn text(&mut self, at: Point3<f64>, scale: usize, text: &str, colour: Colour) {
        if self.include(&[at]) {
            self.marks.push(Mark { at, text: text.to_owned(), scale, colour });
        }
    }

    /// The smallest box around everything that was added, if anything was.
    pub fn bounds(&self) -> Option<(Point3<f64>, Point3<f64>)> {
        self.low.zip(self.high)
    }

    /// The corners of all polygons and lines.
    pub fn points(&self) -> impl Iterator<Item = &Point3<f64>> {
        let faces = self.faces.iter().flat_map(|face| &face.corners);
        faces.chain(self.strokes.iter().flat_map(|stroke| &stroke.points))
    }

    /// Widens the bounds; whether all points are finite and may be drawn.
    fn include(&mut self, points: &[Point3<f64>]) -> bool {
        if points.iter().any(|p| !p.coords.iter().all(|c| c.is_finite())) {
            return false;
        }
        for p in points {
            self.low = Some(self.low.map_or(*p, |low| low.inf(p)));
            self.high = Some(self.high.map_or(*p, |high| high.sup(p)));
        }
        true
    }

    /// Draws the scene. Opaque polygons and lines first, then translucent polygons from the far to
    /// the near, each by the distance of its middle.
    pub fn render(
        &self,
        camera: &Camera,
        width: usize,
        height: usize,
        background: Colour,
    ) -> Canvas {
        let mut raster = Raster::new(2 * width.max(1), 2 * height.max(1), background);
        let view = camera.view(raster.canvas.width(), raster.canvas.height());
        let (opaque, mut translucent): (Vec<&Face>, Vec<&Face>) =
            self.faces.iter().partition(|face| face.colour.alpha == 255);
        for face in opaque {
            raster.face(&view, camera, face);
        }
        for stroke in &self.strokes {
            raster.stroke(&view, stroke);
        }
        let distance = |face: &&Face| {
            let sum: Vector3<f64> = face.corners.iter().map(|c| c - camera.eye).sum();
            sum.norm() / face.corners.len() as f64
        };
        translucent.sort_by(|a, b| distance(b).total_cmp(&distance(a)));
        for face in translucent {
            raster.face(&view, camera, face);
        }
        let mut picture = raster.canvas.halved();
        for mark in &self.marks {
            if let Some(p) = camera.pixel(&mark.at, picture.width(), picture.height()) {
                picture.text(p.x, p.y, mark.scale, &mark.text, mark.colour);
            }
        }
        picture
    }
}

/// A picture with a depth key per pixel.
struct Raster {
    canvas: Canvas,
    keys: Vec<f64>,
}

impl Raster {
    fn new(width: usize, height: usize, background: Colour) -> Self {
        let canvas = Canvas::new(width, height, background);
        Self { canvas, keys: vec![f64::NEG_INFINITY; width * height] }
    }

    fn put(&mut self, x: usize, y: usize, key: f64, colour: Colour) {
        let known = &mut self.keys[y * self.canvas.width() + x];
        if key >= *known {
            if colour.alpha == 255 {
                *known = key;
            }
            self.canvas.blend(x as i64, y as i64, colour);
        }
    }

    fn face(&mut self, view: &View, camera: &Camera, face: &Face) {
        let colour = shaded(&face.corners, camera, face.colour);
        let seen: Vec<_> = face.corners.iter().map(|c| view.camera_from_world * c).collect();
        let corners: Vec<_> = view.clip_near(&seen).iter().map(|p| view.project(p)).collect();
        for i in 2..corners.len() {
            self.triangle([corners[0], corners[i - 1], corners[i]], colour);
        }
    }

    /// Fills a triangle whose corners are pixel and depth key. A pixel belongs to it when its
    /// centre does; a shared edge belongs to the left or upper side alone, so that translucent
    /// neighbours leave no seam.
    fn triangle(&mut self, [a, b, c]: [[f64; 3]; 3], colour: Colour) {
        let doubled = |p: [f64; 3], q: [f64; 3], x: f64, y: f64| {
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
        };
        let area = doubled(a, b, c[0], c[1]);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let (b, c, area) = if area < 0.0 { (c, b, -area) } else { (b, c, area) };
        let owns = |p: [f64; 3], q: [f64; 3]| q[1] > p[1] || (q[1] == p[1] && q[0] < p[0]);
        let limits = |k: usize, size: usize| {
            let low = a[k].min(b[k]).min(c[k]).floor().clamp(0.0, size as f64) as usize;
            let high = a[k].max(b[k]).max(c[k]).ceil().clamp(0.0, size as f64) as usize;
            low..high
        };
        for y in limits(1, self.canvas.height()) {
            for x in limits(0, self.canvas.width()) {
                let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                let weights = [doubled(b, c, px, py), doubled(c, a, px, py), doubled(a, b, px, py)];
                let inside = [(b, c), (c, a), (a, b)]
                    .iter()
                    .zip(weights)
                    .all(|(&(p, q), weight)| weight > 0.0 || (weight == 0.0 && owns(p, q)));
                if inside {
                    let key = (weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2]) / area;
                    self.put(x, y, key, colour);
                }
            }
        }
    }

    fn stroke(&mut self, view: &View, stroke: &Stroke) {
        let seen: Vec<_> = stroke.points.iter().map(|p| view.camera_from_world * p).collect();
        if let [p] = seen.as_slice() {
            if -p.z > NEAR_M {
                self.segment(view, view.project(p), view.project(p), stroke);
            }
            return;
        }
        for pair in seen.windows(2) {
            // A polygon of two corners: the same clipping serves.
            let clipped = view.clip_near(&[pair[0], pair[1]]);
            let (Some(first), Some(last)) = (clipped.first(), clipped.get(1)) else { continue };
            self.segment(view, view.project(first), view.project(last), stroke);
        }
    }

    fn segment(&mut self, view: &View, a: [f64; 3], b: [f64; 3], stroke: &Stroke) {
        let (start, end) = (Point2::new(a[0], a[1]), Point2::new(b[0], b[1]));
        let along = end - start;
        // The raster has twice the resolution of the picture, so a radius in it is a width in that.
        let radius = stroke.width.max(1.0);
        let limits = |low: f64, high: f64, size: usize| {
            (low - radius).floor().clamp(0.0, size as f64) as usize
                ..(high + radius).ceil().clamp(0.0, size as f64) as usize
        };
        for y in limits(start.y.min(end.y), start.y.max(end.y), self.canvas.height()) {
            // Along a row only the pixels near the line matter: a long diagonal stays cheap.
            let row = y as f64 + 0.5;
            let (mut left, mut right) = (start.x.min(end.x), start.x.max(end.x));
            if along.y.abs() > 1e-9 {
                let middle = start.x + along.x * ((row - start.y) / along.y);
                let reach = radius * (along.norm() / along.y.abs());
                (left, right) = (left.max(middle - reach), right.min(middle + reach));
            }
            for x in limits(left, right, self.canvas.width()) {
                let p = Point2::new(x as f64 + 0.5, row);
                let length_squared = along.norm_squared();
                let t = if length_squared > 0.0 {
                    ((p - start).dot(&along) / length_squared).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                if (p - (start + along * t)).norm() <= radius {
                    let key = a[2] + (b[2] - a[2]) * t;
                    self.put(x, y, view.nearer(key), stroke.colour);
                }
            }
        }
    }
}

/// The colour of a polygon under a light beside and above the camera; both sides are lit alike.
fn shaded(corners: &[Point3<f64>], camera: &Camera, colour: Colour) -> Colour {
    // Newell's sum: exact for any flat polygon, whichever three corners happen to be in a line.
    let normal: Vector3<f64> = (0..corners.len())
        .map(|i| corners[i].coords.cross(&corners[(i + 1) % corners.len()].coords))
        .sum();
    let Some(normal) = normal.try_normalize(0.0) else { return colour };
    let forward = (camera.target - camera.eye).normalize();
    let right = forward.cross(&camera.up).normalize();
    let light = (camera.up.normalize() * 0.7 - forward * 0.6 + right * 0.35).normalize();
    colour.scaled(0.55 + 0.50 * normal.dot(&light).abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: Colour = Colour::rgb(255, 0, 0);
    const GREEN: Colour = Colour::rgb(0, 255, 0);

    fn wall(x: f64, half: f64) -> Vec<Point3<f64>> {
        [(-half, -half), (half, -half), (half, half), (-half, half)]
            .map(|(y, z)| Point3::new(x, y, z))
            .to_vec()
    }

    fn from_origin() -> Camera {
        Camera {
            eye: Point3::origin(),
            target: Point3::new(1.0, 0.0, 0.0),
            up: Vector3::z(),
            lens: Lens::Perspective(1.0),
        }
    }

    #[test]
    fn the_nearer_polygon_hides_the_farther_in_either_order() {
        for order in [[2.0, 5.0], [5.0, 2.0]] {
            let mut scene = Scene::new();
            for x in order {
                scene.polygon(&wall(x, 0.3), if x < 3.0 { RED } else { GREEN });
            }
            let picture = scene.render(&from_origin(), 64, 64, Colour::BLACK);
            let middle = picture.pixel(32, 32).unwrap();
            assert!(middle.red > 100 && middle.green == 0, "{middle:?}");
        }
    }

    #[test]
    fn crossing_polygons_hide_one_another_by_pixel() {
        let mut scene = Scene::new();
        let slanted = |sign: f64| {
            [(2.0, -1.0), (4.0, 1.0)]
                .iter()
                .flat_map(|&(x, y)| [Point3::new(x, sign * y, -1.0), Point3::new(x, sign * y, 1.0)])
                .collect::<Vec<_>>()
        };
        for (sign, colour) in [(1.0, RED), (-1.0, GREEN)] {
            let p = slanted(sign);
            scene.polygon(&[p[0], p[2], p[3], p[1]], colour);
        }
        let picture = scene.render(&from_origin(), 64, 64, Colour::BLACK);
        assert!(picture.pixel(42, 32).unwrap().red > 100, "y < 0 is right, where red is near");
        assert!(picture.pixel(22, 32).unwrap().green > 100);
    }

    #[test]
    fn what_is_behind_the_eye_is_not_drawn() {
        let mut scene = Scene::new();
        scene.polygon(&wall(-2.0, 5.0), RED);
        scene.path(&[Point3::new(-3.0, 0.0, 0.0), Point3::new(-1.0, 1.0, 0.0)], 3.0, RED);
        let picture = scene.render(&from_origin(), 32, 32, Colour::BLACK);
        assert_eq!(picture, Canvas::new(32, 32, Colour::BLACK));
        // A floor that reaches from behind to far ahead is cut, not lost.
        let floor = [(-5.0, -5.0), (50.0, -5.0), (50.0, 5.0), (-5.0, 5.0)];
        scene.polygon(&floor.map(|(x, y)| Point3::new(x, y, -1.0)), GREEN);
        let picture = scene.render(&from_origin(), 32, 32, Colour::BLACK);
        assert!(picture.pixel(16, 30).unwrap().green > 100);
        assert_eq!(picture.pixel(16, 2), Some(Colour::BLACK));
    }

    #[test]
    fn pixel_agrees_with_what_is_drawn() {
        let at = Point3::new(4.0, 1.0, 0.5);
        let mut scene = Scene::new();
        scene.point(at, 2.0, RED);
        let picture = scene.render(&from_origin(), 80, 60, Colour::BLACK);
        let p = from_origin().pixel(&at, 80, 60).unwrap();
        assert!(picture.pixel(p.x as usize, p.y as usize).unwrap().red > 200);
        assert!(from_origin().pixel(&Point3::new(-1.0, 0.0, 0.0), 80, 60).is_none());
    }

    #[test]
    fn translucent_halves_of_a_square_leave_no_seam() {
        let mut scene = Scene::new();
        scene.polygon(&wall(3.0, 2.0), RED.with_alpha(128));
        let picture = scene.render(&from_origin(), 40, 40, Colour::BLACK);
        let shades: std::collections::BTreeSet<u8> =
            (0..40).flat_map(|i| picture.pixel(i, i).map(|c| c.red)).collect();
        assert_eq!(shades.len(), 1, "{shades:?}");
    }

    #[test]
    fn a_camera_around_a_box_sees_its_corners() {
        let (low, high) = (Point3::new(-3.0, -1.0, 0.0), Point3::new(9.0, 5.0, 2.5));
        for camera in [Camera::around(low, high, 0.8, 0.6), Camera::above(low, high, 1.5)] {
            for i in 0..8 {
                let pick = |bit: usize, k: usize| if i >> bit & 1 == 1 { high[k] } else { low[k] };
                let corner = Point3::new(pick(0, 0), pick(1, 1), pick(2, 2));
                let p = camera.pixel(&corner, 300, 200).unwrap();
                assert!((0.0..300.0).contains(&p.x) && (0.0..200.0).contains(&p.y), "{p}");
            }
        }
    }
}
