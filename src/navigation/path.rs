use super::Pose2;
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

/// A polyline over drivable ground, from the robot to a goal.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Path {
    points: Vec<Point2<f64>>,
    /// Arc length from the start to each point, metres.
    along_m: Vec<f64>,
    /// Heading to end with, if it matters, in radians.
    pub goal_yaw_rad: Option<f64>,
}

impl Path {
    /// A path through `points`; repeated points are dropped.
    pub fn new(points: impl IntoIterator<Item = Point2<f64>>) -> Self {
        let mut path = Self::default();
        for point in points {
            let along_m = match path.points.last() {
                None => 0.0,
                Some(last) => {
                    let step_m = (point - last).norm();
                    if step_m < 1e-6 {
                        continue;
                    }
                    path.length_m() + step_m
                }
            };
            path.points.push(point);
            path.along_m.push(along_m);
        }
        path
    }

    /// The same path, to end with a heading.
    #[must_use]
    pub fn with_goal_yaw(mut self, yaw_rad: f64) -> Self {
        self.goal_yaw_rad = Some(yaw_rad);
        self
    }

    /// The corners, from start to goal.
    pub fn points(&self) -> &[Point2<f64>] {
        &self.points
    }

    /// Where the path ends; `None` for an empty path.
    pub fn goal(&self) -> Option<Point2<f64>> {
        self.points.last().copied()
    }

    /// Length in metres.
    pub fn length_m(&self) -> f64 {
        self.along_m.last().copied().unwrap_or(0.0)
    }

    /// Index of the segment that holds arc length `along_m`, the last one beyond the end.
    fn segment(&self, along_m: f64) -> usize {
        let after = self.along_m.partition_point(|&at| at <= along_m);
        after.clamp(1, self.points.len().max(2) - 1) - 1
    }

    /// The pose at an arc length, heading along the path; cut to the path's ends.
    ///
    /// # Panics
    ///
    /// For an empty path.
    pub fn pose_at(&self, along_m: f64) -> Pose2 {
        if self.points.len() == 1 {
            let yaw_rad = self.goal_yaw_rad.unwrap_or(0.0);
            return Pose2 { x_m: self.points[0].x, y_m: self.points[0].y, yaw_rad };
        }
        let along_m = along_m.clamp(0.0, self.length_m());
        let segment = self.segment(along_m);
        let (a, b) = (self.points[segment], self.points[segment + 1]);
        let length_m = self.along_m[segment + 1] - self.along_m[segment];
        let p = a + (b - a) * ((along_m - self.along_m[segment]) / length_m);
        Pose2 { x_m: p.x, y_m: p.y, yaw_rad: (b.y - a.y).atan2(b.x - a.x) }
    }

    /// Arc length of the point of the path nearest to `p` among those between two arc lengths, and
    /// its distance, both in metres; of equal ones the first. `None` for an empty path.
    pub fn nearest(&self, p: &Point2<f64>, from_m: f64, to_m: f64) -> Option<(f64, f64)> {
        if self.points.len() < 2 {
            return self.points.first().map(|only| (0.0, (only - p).norm()));
        }
        let mut best: Option<(f64, f64)> = None;
        for segment in self.segment(from_m.max(0.0))..=self.segment(to_m.min(self.length_m())) {
            let (a, b) = (self.points[segment], self.points[segment + 1]);
            let (start_m, end_m) = (self.along_m[segment], self.along_m[segment + 1]);
            let direction = (b - a) / (end_m - start_m);
            let along_m =
                (start_m + (p - a).dot(&direction)).clamp(start_m, end_m).clamp(from_m, to_m);
            let away_m = (a + direction * (along_m - start_m) - p).norm();
            if best.is_none_or(|(_, least_m)| away_m < least_m - 1e-12) {
                best = Some((along_m, away_m));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner() -> Path {
        Path::new([(0.0, 0.0), (2.0, 0.0), (2.0, 0.0), (2.0, 3.0)].map(|(x, y)| Point2::new(x, y)))
    }

    #[test]
    fn poses_follow_the_corners() {
        let path = corner();
        assert_eq!(path.points().len(), 3);
        assert!((path.length_m() - 5.0).abs() < 1e-12);
        let before = path.pose_at(1.5);
        assert!((before.x_m - 1.5).abs() < 1e-12 && before.yaw_rad.abs() < 1e-12);
        let after = path.pose_at(2.5);
        assert!((after.y_m - 0.5).abs() < 1e-12);
        assert!((after.yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert!((path.pose_at(99.0).y_m - 3.0).abs() < 1e-12);
    }

    #[test]
    fn the_nearest_point_is_sought_in_the_window_only() {
        let path = corner();
        let (along_m, away_m) = path.nearest(&Point2::new(2.1, 1.0), 0.0, 5.0).unwrap();
        assert!((along_m - 3.0).abs() < 1e-12 && (away_m - 0.1).abs() < 1e-12);
        let (along_m, _) = path.nearest(&Point2::new(2.1, 1.0), 0.0, 1.0).unwrap();
        assert!((along_m - 1.0).abs() < 1e-12);
    }
}
