//! Which way to look so that what the map holds there fixes the robot's place and heading.

use crate::geometry::wrap_pi;
use crate::mapping::Landmark;
use crate::navigation::Pose2;
use crate::terrain::Grid;
use nalgebra::{Matrix3, Point2, Vector2, Vector3};
use std::f64::consts::TAU;

/// Headings that are weighed.
const HEADINGS: u32 = 24;
/// Half the angle in which surfaces are found: the paper leaves the outer beams out.
const HALF_VIEW_RAD: f64 = 1.1;
/// How far a surface may be, in metres: what lies farther away takes few readings.
const REACH_M: f64 = 12.0;
/// How well one surface places the robot along its normal; what place and heading ought to be known to.
const SURFACE_M: f64 = 0.003;
const PLACE_M: f64 = 0.03;
const HEADING_RAD: f64 = 0.005;
/// Length of the pieces by which surfaces are in sight or not, in metres.
const PIECE_M: f64 = 0.5;
/// A surface seen at a flatter angle than this sine is not counted on, nor is one that is not upright by this.
const SLANT: f64 = 0.2;
const UPRIGHT: f64 = 0.9;
/// How near to a surface the ray towards it may meet something, in metres: the surface itself.
const ARRIVED_M: f64 = 0.4;
/// A heading must leave this share of the spread that looking ahead leaves, to be worth turning.
const WORTH: f64 = 0.5;

/// The heading from which `landmarks` fix the robot best, if that is much better than looking ahead.
/// `covariance` is that of x, y and heading.
pub(super) fn best_heading<'a>(
    landmarks: impl Iterator<Item = &'a Landmark>,
    pose: &Pose2,
    covariance: &Matrix3<f64>,
    grid: &Grid,
) -> Option<f64> {
    let prior = covariance.try_inverse()?;
    let tell: Vec<Told> = landmarks.flat_map(|landmark| told_by(landmark, pose, grid)).collect();
    // What a look there leaves of the spread, in units of what ought to be known.
    let spread = |yaw_rad: f64| {
        let is_in_view = |told: &&Told| wrap_pi(told.bearing_rad - yaw_rad).abs() <= HALF_VIEW_RAD;
        let in_view = tell.iter().filter(is_in_view);
        let information = in_view.fold(prior, |sum, told| sum + told.information);
        let left = information.try_inverse().unwrap_or(*covariance);
        (left[(0, 0)] + left[(1, 1)]) / PLACE_M.powi(2) + left[(2, 2)] / HEADING_RAD.powi(2)
    };
    let turned = |step: u32| wrap_pi(pose.yaw_rad + TAU * f64::from(step) / f64::from(HEADINGS));
    let (yaw_rad, left) = (1..HEADINGS)
        .map(|step| (turned(step), spread(turned(step))))
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    (left < WORTH * spread(pose.yaw_rad)).then_some(yaw_rad)
}

/// A piece of a surface: its bearing, and the information on x, y and heading that a look at it gives.
struct Told {
    bearing_rad: f64,
    information: Matrix3<f64>,
}

/// The pieces of a surface that are in sight; none of one that does not stand upright.
fn told_by(landmark: &Landmark, pose: &Pose2, grid: &Grid) -> Vec<Told> {
    let normal = landmark.normal();
    if normal.xy().norm() < UPRIGHT {
        return Vec::new();
    }
    let (origin, along) = (landmark.origin().xy(), Vector2::new(-normal.y, normal.x).normalize());
    let ends = landmark.hull_points().map(|corner| along.dot(&(corner.xy() - origin)));
    let (first_m, last_m) =
        ends.fold((f64::MAX, f64::MIN), |(first, last), end| (first.min(end), last.max(end)));
    let pieces = ((last_m - first_m) / PIECE_M).ceil().max(1.0);
    let piece = |number: u32| {
        let aside_m = first_m + (last_m - first_m) * (f64::from(number) + 0.5) / pieces;
        let at = origin + along * aside_m;
        let way = at - pose.point();
        let slant = -normal.xy().dot(&way) / way.norm();
        if !(way.norm() <= REACH_M && slant >= SLANT && in_sight(&pose.point(), &way, grid)) {
            return None;
        }
        let turned = landmark.covariance[(1, 1)] + landmark.covariance[(2, 2)];
        let variance = SURFACE_M.powi(2) + landmark.covariance[(0, 0)] + turned * aside_m.powi(2);
        // What a surface is off by is common to its pieces.
        let weight = 1.0 / (variance * pieces);
        let row = Vector3::new(normal.x, normal.y, way.x * normal.y - way.y * normal.x);
        let information = weight * row * row.transpose();
        Some(Told { bearing_rad: way.y.atan2(way.x), information })
    };
    (0..pieces as u32).filter_map(piece).collect()
}

fn in_sight(from: &Point2<f64>, way: &Vector2<f64>, grid: &Grid) -> bool {
    let steps = ((way.norm() - ARRIVED_M) / grid.cell_m()).max(0.0) as u32;
    let step = way.normalize() * grid.cell_m();
    (1..=steps).all(|number| {
        let at = from + step * f64::from(number);
        !grid.get(grid.cell_of(at.x, at.y)).opaque
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{LandmarkId, PlaneMask};
    use crate::terrain::{RobotShape, Terrain, TerrainConfig};
    use nalgebra::{Isometry3, Rotation3};

    /// A wall 2 m high from `from` to `to`, facing left of that way.
    fn wall(id: u32, from: [f64; 2], to: [f64; 2]) -> Landmark {
        let (from, to) = (Point2::from(from), Point2::from(to));
        let along = (to - from).normalize();
        let normal = Vector3::new(-along.y, along.x, 0.0);
        let rotation = Rotation3::from_basis_unchecked(&[
            Vector3::new(along.x, along.y, 0.0),
            normal.cross(&Vector3::new(along.x, along.y, 0.0)),
            normal,
        ]);
        let middle = nalgebra::center(&from, &to);
        let half_m = 0.5 * (to - from).norm();
        Landmark {
            id: LandmarkId(id),
            world_from_plane: Isometry3::from_parts(
                Vector3::new(middle.x, middle.y, 1.0).into(),
                rotation.into(),
            ),
            covariance: Matrix3::zeros(),
            hull: [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, y)| Point2::new(x * half_m, y))
                .to_vec(),
            mask: PlaneMask::default(),
            points: 1000,
            rms_m: 0.01,
            sightings: 3,
            first_keyframe: 0,
            last_keyframe: 0,
            gone: false,
            openings: Vec::new(),
        }
    }

    fn heading(landmarks: &[Landmark], yaw_rad: f64) -> Option<f64> {
        let terrain = Terrain::new(TerrainConfig::default(), RobotShape::default());
        let grid = terrain.project(&Isometry3::identity());
        let covariance = Matrix3::from_diagonal(&Vector3::new(0.01, 0.01, 0.001));
        let pose = Pose2 { x_m: 0.0, y_m: 0.0, yaw_rad };
        best_heading(landmarks.iter(), &pose, &covariance, &grid)
    }

    #[test]
    fn the_corner_that_the_map_holds_is_looked_at() {
        // A wall ahead at x = 5 and one on the left at y = 4.
        let corner = [wall(0, [5.0, -3.0], [5.0, 4.0]), wall(1, [5.0, 4.0], [-1.0, 4.0])];
        let yaw_rad = heading(&corner, 3.9).unwrap();
        assert!((0.0..=1.4).contains(&yaw_rad), "{yaw_rad}");
        assert_eq!(heading(&corner, 0.7), None, "it looks there already");
    }

    #[test]
    fn surfaces_that_are_turned_away_or_not_upright_are_no_help() {
        let from_behind = [wall(0, [5.0, 4.0], [5.0, -3.0])];
        assert_eq!(heading(&from_behind, 3.0), None);
        let mut floor = wall(0, [5.0, -3.0], [5.0, 4.0]);
        floor.world_from_plane = Isometry3::identity();
        assert_eq!(heading(&[floor], 3.0), None);
    }
}
