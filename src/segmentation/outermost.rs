//! Which of many points may be vertices of their convex hull, a vector of points at a time.

use super::vectors::run;
use pulp::{Arch, Simd, WithSimd};

/// Directions in which extreme points are sought at first, 45° apart.
const DIRECTIONS: usize = 8;
/// Opposite directions are those of one coordinate.
const COORDINATES: usize = DIRECTIONS / 2;
/// Vertices of the polygon in the end; what lies inside it is no vertex of the hull.
const VERTICES: usize = 2 * DIRECTIONS;
/// Rounding of an edge's side in single precision, as a share of the square of what coordinates
/// reach.
const ROUNDING: f32 = 2e-6;
/// Most points of a vector.
const WIDEST: usize = 16;
/// Points that are too few for a finer polygon to be worth it.
const FEW: usize = 32;

/// The points in single precision, filled up with the first of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Outermost {
    x: Vec<f32>,
    y: Vec<f32>,
    /// The third coordinate of what is to be carried into a plane.
    z: Vec<f32>,
    /// How far each point is to the left of the nearest edge.
    inside: Vec<f32>,
    /// Places of the points that are kept.
    kept: Vec<u32>,
}

/// The frame of a plane in space.
pub(super) struct Flat {
    pub origin: [f32; 3],
    /// Its two axes.
    pub sides: [[f32; 3]; 2],
}

impl Outermost {
    /// Takes the points that are strictly inside a polygon of others out of a list; they are given as
    /// it names them.
    #[cfg(test)]
    pub fn keep(&mut self, points: impl Iterator<Item = [f32; 2]>, named: &mut Vec<u32>) {
        self.x.resize(named.len(), 0.0);
        self.y.resize(named.len(), 0.0);
        for ((point, x), y) in points.zip(&mut self.x).zip(&mut self.y) {
            [*x, *y] = point;
        }
        self.drop_inside(named);
    }

    /// Takes cells out of a list whose points in a plane are strictly inside a polygon of others.
    pub fn keep_in_plane(&mut self, points: [&[f32]; 3], flat: &Flat, named: &mut Vec<u32>) {
        let count = named.len();
        for array in [&mut self.x, &mut self.y, &mut self.z] {
            array.resize(count, 0.0);
        }
        let length = points[0].len();
        let points = points.map(|array| &array[..length]);
        let places = self.x.iter_mut().zip(&mut self.y).zip(&mut self.z);
        for (&cell, ((x, y), z)) in named.iter().zip(places) {
            [*x, *y, *z] = points.map(|array| array[cell as usize]);
        }
        Arch::new().dispatch(Flatten { flat, columns: self });
        self.drop_inside(named);
    }

    /// Drops what is inside.
    ///
    /// The polygon starts with the extreme points in eight directions, and between two of its
    /// vertices comes the point that is farthest beyond their edge, twice.
    fn drop_inside(&mut self, named: &mut Vec<u32>) {
        if named.is_empty() {
            return;
        }
        self.fill_up();
        let mut polygon = [[self.x[0], self.y[0]]; VERTICES];
        run(Extremes { columns: self, polygon: &mut polygon });
        let mut count = DIRECTIONS;
        self.retain(&polygon[..count], named);
        while count < VERTICES && named.len() > FEW {
            let coarse = polygon;
            for (pair, &vertex) in polygon.chunks_mut(2).zip(&coarse[..count]) {
                pair.fill(vertex);
            }
            let between = &mut polygon[..2 * count];
            run(Beyond { columns: self, coarse: &coarse[..count], polygon: between });
            count *= 2;
            self.retain(&polygon[..count], named);
        }
    }

    fn fill_up(&mut self) {
        for array in [&mut self.x, &mut self.y] {
            if let Some(&first) = array.first() {
                array.resize(array.len().next_multiple_of(WIDEST), first);
            }
        }
    }

    /// Keeps what is not inside a polygon.
    fn retain(&mut self, polygon: &[[f32; 2]], named: &mut Vec<u32>) {
        self.inside.resize(self.x.len(), 0.0);
        let reach = polygon.iter().flatten().fold(0.0_f32, |reach, value| reach.max(value.abs()));
        let rounding = ROUNDING * reach * reach;
        run(Inside { columns: self, polygon });
        // Where the kept ones are is listed first: most are dropped.
        let count = named.len();
        self.kept.resize(count, 0);
        let places = &mut self.kept[..count];
        let mut kept = 0;
        for (place, &inside) in (0..).zip(&self.inside[..count]) {
            places[kept] = place;
            kept += usize::from(inside <= rounding);
        }
        let (x, y, names) = (&mut self.x[..count], &mut self.y[..count], &mut named[..count]);
        for (to, &from) in places[..kept].iter().enumerate() {
            let from = from as usize;
            (x[to], y[to], names[to]) = (x[from], y[from], names[from]);
        }
        self.x.truncate(kept);
        self.y.truncate(kept);
        named.truncate(kept);
        self.fill_up();
    }
}

/// Carries points into a plane.
struct Flatten<'a> {
    flat: &'a Flat,
    columns: &'a mut Outermost,
}

impl WithSimd for Flatten<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { flat: Flat { origin: [ox, oy, oz], sides }, columns } = self;
        let [[ax, ay, az], [bx, by, bz]] = sides;
        let Outermost { x, y, z, .. } = columns;
        for ((x, y), z) in x.iter_mut().zip(y).zip(z) {
            let d = [*x - ox, *y - oy, *z - oz];
            *x = ax * d[0] + ay * d[1] + az * d[2];
            *y = bx * d[0] + by * d[1] + bz * d[2];
        }
    }
}

/// Finds the extreme points, counter-clockwise.
struct Extremes<'a> {
    columns: &'a Outermost,
    polygon: &'a mut [[f32; 2]],
}

#[inline(always)]
fn coordinates<S: Simd>(simd: S, x: S::f32s, y: S::f32s) -> [S::f32s; COORDINATES] {
    [x, simd.add_f32s(x, y), y, simd.sub_f32s(y, x)]
}

impl WithSimd for Extremes<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { columns, polygon } = self;
        let (x, y) = (S::as_simd_f32s(&columns.x).0, S::as_simd_f32s(&columns.y).0);
        let mut high = [simd.splat_f32s(f32::NEG_INFINITY); COORDINATES];
        let mut low = [simd.splat_f32s(f32::INFINITY); COORDINATES];
        for (&x, &y) in x.iter().zip(y) {
            let values = coordinates(simd, x, y);
            for k in 0..COORDINATES {
                high[k] = simd.max_f32s(values[k], high[k]);
                low[k] = simd.min_f32s(values[k], low[k]);
            }
        }
        for k in 0..COORDINATES {
            high[k] = simd.splat_f32s(simd.reduce_max_f32s(high[k]));
            low[k] = simd.splat_f32s(simd.reduce_min_f32s(low[k]));
        }
        for (at, (&x, &y)) in x.iter().zip(y).enumerate() {
            let values = coordinates(simd, x, y);
            let mut any = simd.greater_than_or_equal_f32s(values[0], high[0]);
            for k in 0..COORDINATES {
                any = simd.or_m32s(any, simd.greater_than_or_equal_f32s(values[k], high[k]));
                any = simd.or_m32s(any, simd.less_than_or_equal_f32s(values[k], low[k]));
            }
            if simd.first_true_m32s(any) == S::F32_LANES {
                continue;
            }
            for k in 0..COORDINATES {
                let most = simd.greater_than_or_equal_f32s(values[k], high[k]);
                let least = simd.less_than_or_equal_f32s(values[k], low[k]);
                // One of several is as good as another.
                let place = simd.first_true_m32s(most);
                if place < S::F32_LANES {
                    polygon[k] = point_at(columns, at * S::F32_LANES + place);
                }
                let place = simd.first_true_m32s(least);
                if place < S::F32_LANES {
                    polygon[k + COORDINATES] = point_at(columns, at * S::F32_LANES + place);
                }
            }
        }
    }
}

#[inline(always)]
fn point_at(columns: &Outermost, place: usize) -> [f32; 2] {
    [columns.x[place], columns.y[place]]
}

/// An edge as the factors of its side: `a x + b y + c` is positive on its left.
fn edge(polygon: &[[f32; 2]], k: usize) -> [f32; 3] {
    let ends = [polygon[k], polygon[(k + 1) % polygon.len()]];
    let [[ax, ay], [bx, by]] = ends.map(|end| end.map(f64::from));
    // An edge between equal points has everything on its left.
    let offset = if [ax, ay] == [bx, by] { f64::INFINITY } else { by * ax - bx * ay };
    [ay - by, bx - ax, offset].map(|factor| factor as f32)
}

/// The side of an edge on which points are.
#[inline(always)]
fn side<S: Simd>(simd: S, [a, b, c]: [S::f32s; 3], x: S::f32s, y: S::f32s) -> S::f32s {
    let along = simd.add_f32s(simd.mul_f32s(a, x), simd.mul_f32s(b, y));
    simd.add_f32s(along, c)
}

/// Finds how far each point is to the left of the nearest edge of a polygon.
struct Inside<'a> {
    columns: &'a mut Outermost,
    polygon: &'a [[f32; 2]],
}

impl WithSimd for Inside<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { columns: Outermost { x, y, inside, .. }, polygon } = self;
        let (x, y) = (S::as_simd_f32s(x).0, S::as_simd_f32s(y).0);
        let inside = S::as_mut_simd_f32s(inside).0;
        for inside in &mut *inside {
            *inside = simd.splat_f32s(f32::INFINITY);
        }
        for k in 0..polygon.len() {
            let [a, b, c] = edge(polygon, k);
            let edge = [simd.splat_f32s(a), simd.splat_f32s(b), simd.splat_f32s(c)];
            for ((&x, &y), inside) in x.iter().zip(y).zip(&mut *inside) {
                *inside = simd.min_f32s(side(simd, edge, x, y), *inside);
            }
        }
    }
}

/// Puts the point that is farthest beyond each edge of a polygon between the edge's ends.
struct Beyond<'a> {
    columns: &'a Outermost,
    coarse: &'a [[f32; 2]],
    polygon: &'a mut [[f32; 2]],
}

impl WithSimd for Beyond<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { columns, coarse, polygon } = self;
        let (x, y) = (S::as_simd_f32s(&columns.x).0, S::as_simd_f32s(&columns.y).0);
        for k in 0..coarse.len() {
            let [a, b, c] = edge(coarse, k);
            let edge = [simd.splat_f32s(a), simd.splat_f32s(b), simd.splat_f32s(c)];
            let mut least = simd.splat_f32s(0.0);
            for (&x, &y) in x.iter().zip(y) {
                least = simd.min_f32s(side(simd, edge, x, y), least);
            }
            let least = simd.reduce_min_f32s(least);
            if least >= 0.0 {
                continue;
            }
            let least = simd.splat_f32s(least);
            for (at, (&x, &y)) in x.iter().zip(y).enumerate() {
                let beyond = simd.less_than_or_equal_f32s(side(simd, edge, x, y), least);
                let place = simd.first_true_m32s(beyond);
                if place < S::F32_LANES {
                    polygon[2 * k + 1] = point_at(columns, at * S::F32_LANES + place);
                    break;
                }
            }
        }
    }
}
