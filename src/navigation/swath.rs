use super::Pose2;
use nalgebra::{Isometry2, Isometry3, Point2, Vector2};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Edge length of a cell in metres.
const CELL_M: f64 = 0.05;
/// Ground within this of a point that a line has met is swept: beams and, at full speed, lines lie less
/// than twice this apart.
const SWEPT_M: f64 = 0.09;
/// Cells farther from the robot than this are forgotten, in metres.
const KEPT_M: f64 = 4.0;
/// Way after which they are.
const TIDY_M: f64 = 1.0;

/// The ground about a moving robot that its guard line has swept, or that its hull stood on.
///
/// The map takes in what is seen once it is certain where from, and not at all in a quick turn. What a
/// robot that is driven by hand may roll over in the next second is known here, in its own measure.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Swath {
    /// From the cells' frame to the map: corrections of the pose carry the cells along.
    map_from_cells: Isometry2<f64>,
    cells: BTreeSet<(i32, i32)>,
    tidied_at: Point2<f64>,
}

impl Swath {
    /// Notes ground that a line has met at a point of the map.
    pub fn met(&mut self, point: &Point2<f64>) {
        let p = self.map_from_cells.inverse() * point;
        let reach = (SWEPT_M / CELL_M).ceil() as i32;
        let (x, y) = cell_of(&p);
        for cell in
            (y - reach..=y + reach).flat_map(|y| (x - reach..=x + reach).map(move |x| (x, y)))
        {
            if (centre_of(cell) - p).norm() <= SWEPT_M {
                self.cells.insert(cell);
            }
        }
    }

    /// Notes ground that bears: a rectangle of `length_m` by `width_m` about `pose`.
    pub fn stood(&mut self, pose: &Pose2, length_m: f64, width_m: f64) {
        let map_from_hull = Isometry2::new(Vector2::new(pose.x_m, pose.y_m), pose.yaw_rad);
        let cells_from_hull = self.map_from_cells.inverse() * map_from_hull;
        let steps = |size_m: f64| {
            let count = (size_m / (0.5 * CELL_M)).ceil().max(1.0) as u32;
            (0..=count).map(move |step| size_m * (f64::from(step) / f64::from(count) - 0.5))
        };
        for x in steps(length_m) {
            for y in steps(width_m) {
                self.cells.insert(cell_of(&(cells_from_hull * Point2::new(x, y))));
            }
        }
        self.tidy(&(self.map_from_cells.inverse() * pose.point()));
    }

    /// Whether the ground at a point of the map was swept or stood on.
    pub fn covers(&self, point: &Point2<f64>) -> bool {
        self.cells.contains(&cell_of(&(self.map_from_cells.inverse() * point)))
    }

    /// Carries the ground along when the robot's pose is corrected, as [`Trail::correct`](super::Trail::correct) does.
    pub fn correct(&mut self, before: &Isometry3<f64>, after: &Isometry3<f64>) {
        let planar = |pose: &Isometry3<f64>| {
            let pose = Pose2::from_isometry(pose);
            Isometry2::new(Vector2::new(pose.x_m, pose.y_m), pose.yaw_rad)
        };
        self.map_from_cells = planar(after) * planar(before).inverse() * self.map_from_cells;
    }

    /// Forgets what lies far from the robot at `here`, in the cells' frame.
    fn tidy(&mut self, here: &Point2<f64>) {
        if (here - self.tidied_at).norm() >= TIDY_M {
            self.tidied_at = *here;
            self.cells.retain(|cell| (centre_of(*cell) - here).norm() <= KEPT_M);
        }
    }
}

fn cell_of(p: &Point2<f64>) -> (i32, i32) {
    ((p.x / CELL_M).floor() as i32, (p.y / CELL_M).floor() as i32)
}

fn centre_of((x, y): (i32, i32)) -> Point2<f64> {
    Point2::new((f64::from(x) + 0.5) * CELL_M, (f64::from(y) + 0.5) * CELL_M)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn lines_at_full_speed_leave_no_gap() {
        // 0.7 m/s, five lines a second, a degree between beams, the line 1.3 m ahead.
        let mut swath = Swath::default();
        for line in 0..10 {
            let x_m = 1.3 + 0.14 * f64::from(line);
            for degrees in -45..=45 {
                swath.met(&Point2::new(x_m, 1.3 * f64::from(degrees).to_radians().tan()));
            }
        }
        for (x, y) in (0..=120).flat_map(|x| (-100..=100).map(move |y| (x, y))) {
            let p = Point2::new(1.3 + 0.01 * f64::from(x), 0.01 * f64::from(y));
            assert!(swath.covers(&p), "{p}");
        }
        assert!(!swath.covers(&Point2::new(1.1, 0.0)));
        assert!(!swath.covers(&Point2::new(2.8, 0.0)));
    }

    #[test]
    fn the_hull_covers_what_it_stands_on_and_no_more() {
        let mut swath = Swath::default();
        let pose = Pose2 { x_m: 1.0, y_m: 2.0, yaw_rad: 0.7 };
        swath.stood(&pose, 0.6, 0.4);
        for (ahead_m, left_m, on) in
            [(0.29, 0.19, true), (-0.29, 0.0, true), (0.37, 0.0, false), (0.0, 0.27, false)]
        {
            let at = pose.driven(ahead_m, 0.0);
            let p = Pose2 { yaw_rad: at.yaw_rad + std::f64::consts::FRAC_PI_2, ..at };
            assert_eq!(swath.covers(&p.driven(left_m, 0.0).point()), on, "{ahead_m} {left_m}");
        }
    }

    #[test]
    fn a_correction_carries_the_ground_along() {
        let mut swath = Swath::default();
        swath.met(&Point2::new(2.0, 0.0));
        let before = Isometry3::translation(1.0, 0.0, 0.0);
        let after = Isometry3::new(Vector3::new(5.0, 5.0, 0.0), Vector3::z() * 0.5);
        swath.correct(&before, &after);
        let carried = after * before.inverse() * nalgebra::Point3::new(2.0, 0.0, 0.0);
        assert!(swath.covers(&carried.xy()));
        assert!(!swath.covers(&Point2::new(2.0, 0.0)));
    }

    #[test]
    fn what_lies_far_behind_is_forgotten() {
        let mut swath = Swath::default();
        for step in 0..400 {
            let pose = Pose2::default().driven(0.05 * f64::from(step), 0.0);
            swath.stood(&pose, 0.6, 0.4);
        }
        let most = 2.0 * (KEPT_M + TIDY_M) * 0.6 / (CELL_M * CELL_M);
        assert!((swath.cells.len() as f64) < most, "{}", swath.cells.len());
        assert!(swath.covers(&Point2::new(17.0, 0.0)));
        assert!(!swath.covers(&Point2::new(5.0, 0.0)));
    }
}
