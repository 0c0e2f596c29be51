//! Places recognised by the geometry of planes alone: by the angles between them, their distances and
//! their extents, wherever odometry says the robot is.
//!
//! The robot knows which way is up, a scanner that nobody described which way its z points. Two planes that
//! rise, as walls and ramps do, and do not face the same way over the ground, taken for two landmarks that
//! enclose the same angle, then tell heading and place; every such pair of pairs votes, and the
//! places with most votes are held against all planes of the scan. What is found here proposes where a
//! scan may have been made; whether it was is for the association and the map to say.

use super::landmark::Landmark;
use super::observation::Observation;
use crate::geometry::wrap_pi;
use nalgebra::{Isometry3, Matrix2, Translation3, UnitQuaternion, Vector2, Vector3};
use std::collections::BTreeMap;

/// A normal's rise above which a plane is level: where it lies over the ground says nothing.
const LEVEL: f64 = 0.9;
/// Rising planes of the scan that vote, the largest first, and those that any vote must contain one of.
const VOTERS: usize = 8;
const LEADERS: usize = 3;
/// Smallest angle between two planes that fix a place together.
const LEAST_ANGLE_RAD: f64 = 0.35;
/// What directions, rises and distances may differ by.
const ANGLE_RAD: f64 = 0.03;
const RISE: f64 = 0.05;
const OFFSET_M: f64 = 0.10;
/// How far a plane's middle may lie beyond the extent of the landmark that it is taken for, in metres.
const BEYOND_M: f64 = 0.3;
/// Edge of the cells, in metres, in which rising landmarks are looked up by their middles, and half the length
/// from which on one is long: the long ones are looked through one by one.
const NEAR_M: f64 = 8.0;
const LONG_M: f64 = 8.0;
/// Votes within this are for one place.
const CELL_M: f64 = 0.3;
const CELL_RAD: f64 = 0.05;
/// Places that are held against the whole scan, the most voted for first.
const MOST_HELD: usize = 40;
/// Places at least this far apart, or turned by this much, are different ones.
const APART_M: f64 = 0.5;
const APART_RAD: f64 = 0.15;
/// Most places that are told.
const MOST_TOLD: usize = 3;
/// Planes that must fit, and their share of the area of all that could.
const LEAST_FITTING: usize = 4;
const LEAST_SHARE: f64 = 0.4;

/// A place where a scan fits the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Recognised {
    /// The robot there, to a few centimetres and degrees.
    pub(super) world_from_robot: Isometry3<f64>,
    /// Share of the area of the scan's planes that fits landmarks.
    pub(super) share: f64,
}

/// The places where a scan fits the map, the best first. Of `predicted` only roll, pitch and, where no
/// floor tells it, the height are believed; `reachable` tells of a place over the ground, x, y and the turn
/// after `predicted`, whether the robot can be there.
///
/// Grows with the number of landmarks given and how many of them are near one another; asked only when a scan
/// is not recognised where it should be.
pub(super) fn recognise<'a>(
    scan: &[Observation],
    landmarks: impl IntoIterator<Item = &'a Landmark>,
    predicted: &Isometry3<f64>,
    reachable: impl Fn(&Vector2<f64>, f64) -> bool,
) -> Vec<Recognised> {
    let seen = Planes::of_scan(scan, &predicted.rotation);
    let map = Planes::of_map(landmarks);
    let pairs = seen.voting_pairs();
    let mut votes: BTreeMap<(i32, i32, i32), (f64, Place)> = BTreeMap::new();
    map.places(&pairs, predicted.translation.z, |(a, b), place| {
        if reachable(&place.at, wrap_pi(place.turn_rad)) {
            let weight = (a.area_m2.min(b.area_m2)).sqrt();
            votes.entry(place.cell()).or_insert((0.0, place)).0 += weight;
        }
    });
    let mut places: Vec<(f64, Place)> = votes.into_values().collect();
    places.sort_by(|a, b| b.0.total_cmp(&a.0));
    places.truncate(MOST_HELD);
    let mut found: Vec<Recognised> = Vec::new();
    for (_, place) in places {
        let Some(recognised) = map.held_against(&seen, &place, predicted) else { continue };
        let same = |other: &Recognised| {
            let gap = other.world_from_robot.inverse() * recognised.world_from_robot;
            gap.translation.vector.norm() < APART_M && gap.rotation.angle() < APART_RAD
        };
        match found.iter_mut().find(|other| same(other)) {
            Some(other) if other.share < recognised.share => *other = recognised,
            Some(_) => {}
            None => found.push(recognised),
        }
    }
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found.truncate(MOST_TOLD);
    found
}

/// Where the robot stands and heads beside the predicted attitude.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Turn about the vertical, after the predicted attitude.
    turn_rad: f64,
    at: Vector2<f64>,
}

impl Place {
    fn cell(&self) -> (i32, i32, i32) {
        let cell = |x: f64, size: f64| (x / size).round().clamp(-1e9, 1e9) as i32;
        let turn_rad = wrap_pi(self.turn_rad);
        (cell(turn_rad, CELL_RAD), cell(self.at.x, CELL_M), cell(self.at.y, CELL_M))
    }
}

/// A plane that rises, in a frame whose z points up.
struct Rising {
    /// Direction of the normal over the ground, as an angle and as a vector, and what it rises by.
    azimuth_rad: f64,
    normal: Vector2<f64>,
    rise: f64,
    /// A point of the plane in the middle of it, half of what it extends along the ground, and up.
    middle: Vector3<f64>,
    half_length_m: f64,
    half_height_m: f64,
    area_m2: f64,
}

/// Two planes of a scan that vote together.
type Pair<'a> = (&'a Rising, &'a Rising);

/// A plane that lies, in a frame whose z points up.
struct Level {
    from_above: bool,
    z_m: f64,
    middle: Vector2<f64>,
    radius_m: f64,
    area_m2: f64,
}

#[derive(Default)]
struct Planes {
    /// Of a scan by area, of a map by azimuth.
    rising: Vec<Rising>,
    level: Vec<Level>,
    /// Of a map the rising ones by the cell of their middle, but for the long ones.
    cells: BTreeMap<(i32, i32), Vec<usize>>,
    long: Vec<usize>,
}

impl Planes {
    fn of_scan(scan: &[Observation], attitude: &UnitQuaternion<f64>) -> Self {
        let mut planes = Self::default();
        for seen in scan {
            let normal = attitude * seen.normal();
            let corners: Vec<Vector3<f64>> =
                seen.hull_points().map(|p| attitude * p.coords).collect();
            planes.add(&normal, &corners, seen.area_m2());
        }
        planes.rising.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
        planes
    }

    fn of_map<'a>(landmarks: impl IntoIterator<Item = &'a Landmark>) -> Self {
        let mut planes = Self::default();
        for landmark in landmarks {
            let corners: Vec<Vector3<f64>> = landmark.hull_points().map(|p| p.coords).collect();
            planes.add(&landmark.normal(), &corners, landmark.area_m2());
        }
        planes.rising.sort_by(|a, b| a.azimuth_rad.total_cmp(&b.azimuth_rad));
        for (index, plane) in planes.rising.iter().enumerate() {
            if plane.half_length_m > LONG_M {
                planes.long.push(index);
            } else {
                planes.cells.entry(cell_of(&plane.middle.xy())).or_default().push(index);
            }
        }
        planes
    }

    fn add(&mut self, normal: &Vector3<f64>, corners: &[Vector3<f64>], area_m2: f64) {
        if corners.is_empty() {
            return;
        }
        let (low, high) = corners
            .iter()
            .fold((corners[0], corners[0]), |(low, high), p| (low.inf(p), high.sup(p)));
        let middle = 0.5 * (low + high);
        if normal.z.abs() > LEVEL {
            self.level.push(Level {
                from_above: normal.z > 0.0,
                z_m: middle.z,
                middle: middle.xy(),
                radius_m: 0.5 * (high - low).xy().norm(),
                area_m2,
            });
        } else {
            let flat = normal.xy().normalize();
            let along = Vector2::new(-flat.y, flat.x);
            let reach = |p: &Vector3<f64>| along.dot(&p.xy());
            let least = corners.iter().map(reach).fold(f64::INFINITY, f64::min);
            let most = corners.iter().map(reach).fold(f64::NEG_INFINITY, f64::max);
            let mean = corners.iter().sum::<Vector3<f64>>() / corners.len() as f64;
            // Along the ground the plane goes on at one height: the point is on it, too.
            let aside = along * (0.5 * (least + most) - reach(&mean));
            self.rising.push(Rising {
                azimuth_rad: flat.y.atan2(flat.x),
                normal: flat,
                rise: normal.z,
                middle: mean + Vector3::new(aside.x, aside.y, 0.0),
                half_length_m: 0.5 * (most - least),
                half_height_m: 0.5 * (high.z - low.z),
                area_m2,
            });
        }
    }

    /// The pairs of a scan's planes that fix a place together, with the angle between them.
    fn voting_pairs(&self) -> Vec<Pair<'_>> {
        let mut pairs = Vec::new();
        for (first, a) in self.rising.iter().take(LEADERS).enumerate() {
            for b in self.rising.iter().take(VOTERS).skip(first + 1) {
                let between = wrap_pi(b.azimuth_rad - a.azimuth_rad).abs();
                if (LEAST_ANGLE_RAD..std::f64::consts::PI - LEAST_ANGLE_RAD).contains(&between) {
                    pairs.push((a, b));
                }
            }
        }
        pairs
    }

    /// Calls `emit` with each place, `up_m` high, where a pair of a scan fits two landmarks.
    fn places<'a>(&self, pairs: &[Pair<'a>], up_m: f64, mut emit: impl FnMut(Pair<'a>, Place)) {
        // Landmarks too far apart for both to be seen are most of a large map.
        let apart_m = |(a, b): &Pair<'_>| (b.middle - a.middle).xy().norm() + 2.0 * BEYOND_M;
        let farthest_m = pairs.iter().map(apart_m).fold(0.0, f64::max);
        for first in &self.rising {
            let near = self.near(first, farthest_m);
            for pair in pairs {
                let most_m = apart_m(pair);
                if (first.rise - pair.0.rise).abs() < RISE {
                    places_of(*pair, first, &near, most_m, up_m, |place| emit(*pair, place));
                }
            }
        }
    }

    /// By azimuth the rising planes of a map that may be so near another, and the long ones.
    fn near(&self, first: &Rising, within_m: f64) -> Vec<&Rising> {
        let within_m = within_m + first.half_length_m + LONG_M;
        let at = first.middle.xy();
        let (low, high) = (cell_of(&at.add_scalar(-within_m)), cell_of(&at.add_scalar(within_m)));
        let rows = (low.0..=high.0).flat_map(|x| self.cells.range((x, low.1)..=(x, high.1)));
        let found = rows.flat_map(|(_, near)| near).chain(&self.long);
        let mut found: Vec<usize> = found.copied().collect();
        found.sort_unstable();
        found.into_iter().map(|index| &self.rising[index]).collect()
    }

    /// The rising planes whose normals point in a direction over the ground.
    fn facing(&self, azimuth_rad: f64) -> impl Iterator<Item = &Rising> {
        facing(&self.rising, azimuth_rad, |plane| plane.azimuth_rad)
    }

    /// The robot at a place if enough of what it saw fits there.
    fn held_against(
        &self,
        seen: &Self,
        place: &Place,
        predicted: &Isometry3<f64>,
    ) -> Option<Recognised> {
        let turn = nalgebra::Rotation2::new(place.turn_rad);
        let up_m = self.height(seen, place).unwrap_or(predicted.translation.z);
        let whole: f64 = seen.rising.iter().map(|plane| plane.area_m2).sum();
        let (mut fitting, mut area_m2) = (0, 0.0);
        for plane in &seen.rising {
            let middle = turn * plane.middle.xy() + place.at;
            let middle_z_m = plane.middle.z + up_m;
            let fits = self.facing(plane.azimuth_rad + place.turn_rad).any(|landmark| {
                let beside_m = landmark.normal.dot(&middle) - landmark.along_m(middle_z_m);
                (landmark.rise - plane.rise).abs() < RISE
                    && beside_m.abs() < OFFSET_M
                    && landmark.spans(&middle)
                    && (landmark.middle.z - middle_z_m).abs() < landmark.half_height_m + BEYOND_M
            });
            if fits {
                fitting += 1;
                area_m2 += plane.area_m2;
            }
        }
        let share = area_m2 / whole.max(1e-9);
        (fitting >= LEAST_FITTING && share >= LEAST_SHARE).then(|| {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), place.turn_rad)
                * predicted.rotation;
            let translation = Translation3::new(place.at.x, place.at.y, up_m);
            Recognised { world_from_robot: Isometry3::from_parts(translation, rotation), share }
        })
    }

    /// The height that most of what lies says.
    fn height(&self, seen: &Self, place: &Place) -> Option<f64> {
        let turn = nalgebra::Rotation2::new(place.turn_rad);
        let mut votes: BTreeMap<i32, (f64, f64)> = BTreeMap::new();
        for plane in &seen.level {
            let middle = turn * plane.middle + place.at;
            for landmark in self.level.iter().filter(|l| l.from_above == plane.from_above) {
                if (landmark.middle - middle).norm() < landmark.radius_m + BEYOND_M {
                    let up_m = landmark.z_m - plane.z_m;
                    let bin = (up_m / OFFSET_M).round().clamp(-1e9, 1e9) as i32;
                    let vote = votes.entry(bin).or_insert((0.0, 0.0));
                    vote.0 += plane.area_m2;
                    vote.1 += plane.area_m2 * up_m;
                }
            }
        }
        let best = votes.into_values().max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(best.1 / best.0.max(1e-9))
    }
}

/// Calls `emit` with each place, `up_m` high, where the first of a pair fits `first` and the second one of `near`,
/// which are by azimuth, and whose ends may be so far from those of `first`.
fn places_of(
    (a, b): Pair<'_>,
    first: &Rising,
    near: &[&Rising],
    apart_m: f64,
    up_m: f64,
    mut emit: impl FnMut(Place),
) {
    let turn_rad = wrap_pi(first.azimuth_rad - a.azimuth_rad);
    let turn = nalgebra::Rotation2::new(turn_rad);
    for second in facing(near, b.azimuth_rad + turn_rad, |plane| plane.azimuth_rad) {
        let most_m = apart_m + first.half_length_m + second.half_length_m;
        if (second.middle - first.middle).xy().norm_squared() > most_m * most_m
            || (second.rise - b.rise).abs() >= RISE
        {
            continue;
        }
        // n · (turn p + at) is where the landmark lies along n at that height, for both.
        let rows = Matrix2::from_rows(&[first.normal.transpose(), second.normal.transpose()]);
        let gap = |seen: &Rising, landmark: &Rising| {
            let along_m = landmark.along_m(seen.middle.z + up_m);
            along_m - landmark.normal.dot(&(turn * seen.middle.xy()))
        };
        let gaps = Vector2::new(gap(a, first), gap(b, second));
        let Some(at) = rows.try_inverse().map(|inverse| inverse * gaps) else { continue };
        let lies =
            |seen: &Rising, landmark: &Rising| landmark.spans(&(turn * seen.middle.xy() + at));
        if lies(a, first) && lies(b, second) {
            emit(Place { turn_rad, at });
        }
    }
}

/// Of things by azimuth those within [`ANGLE_RAD`] of a direction.
fn facing<T>(
    by_azimuth: &[T],
    azimuth_rad: f64,
    azimuth_of: impl Fn(&T) -> f64,
) -> impl Iterator<Item = &T> {
    let azimuth_rad = wrap_pi(azimuth_rad);
    let within = |low: f64, high: f64| {
        let from = by_azimuth.partition_point(|thing| azimuth_of(thing) < low);
        let to = by_azimuth.partition_point(|thing| azimuth_of(thing) <= high);
        &by_azimuth[from..to.max(from)]
    };
    let (low, high) = (azimuth_rad - ANGLE_RAD, azimuth_rad + ANGLE_RAD);
    let turn = std::f64::consts::TAU;
    let turned =
        [within(low, high), within(low + turn, high + turn), within(low - turn, high - turn)];
    turned.into_iter().flatten()
}

/// The cell in which a rising landmark with this middle is looked up.
fn cell_of(at: &Vector2<f64>) -> (i32, i32) {
    let cell = |x: f64| (x / NEAR_M).floor().clamp(-1e6, 1e6) as i32;
    (cell(at.x), cell(at.y))
}

impl Rising {
    /// Whether a place over the ground lies beside the plane, between its ends.
    fn spans(&self, p: &Vector2<f64>) -> bool {
        let along = Vector2::new(-self.normal.y, self.normal.x);
        along.dot(&(p - self.middle.xy())).abs() < self.half_length_m + BEYOND_M
    }

    /// Where the plane is at some height, along its normal over the ground.
    fn along_m(&self, z_m: f64) -> f64 {
        let level = (1.0 - self.rise * self.rise).sqrt();
        self.normal.dot(&self.middle.xy()) - (z_m - self.middle.z) * self.rise / level
    }
}
