use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// Width about the hull that a standing robot is taken to have tried with its wheels, in metres.
pub const TRIED_M: f64 = 0.06;

/// What the robot's body can pass, cross and climb. Defaults: the paper's Pioneer 3AT with its laser
/// head.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RobotShape {
    /// Length of the hull along x, wheels included, in metres. (0, 3]
    pub length_m: f64,
    /// Width of the hull along y, wheels included, in metres. (0, 3]
    pub width_m: f64,
    /// Height of the highest part above the floor, scan head included, in metres. (0, 3]
    pub height_m: f64,
    /// Height of the origin of `base_link` above the floor on level ground, in metres. [0, 1]
    pub base_above_floor_m: f64,
    /// Wheel radius in metres. (0, 0.5]
    pub wheel_radius_m: f64,
    /// Steepest slope that may be driven, in radians. [0, 0.8]
    pub max_slope_rad: f64,
    /// Highest step that may be driven over, up or down, in metres. [0, 0.3]
    pub max_step_m: f64,
    /// Widest gap in the ground that a wheel rolls across, in metres. [0, 0.3]
    pub max_gap_m: f64,
    /// Air that must stay between the highest part and anything above, in metres. [0, 0.5]
    pub clearance_m: f64,
}

impl Default for RobotShape {
    fn default() -> Self {
        Self {
            length_m: 0.524,
            width_m: 0.497,
            height_m: 0.72,
            base_above_floor_m: 0.13,
            wheel_radius_m: 0.13,
            max_slope_rad: 0.384,
            max_step_m: 0.06,
            max_gap_m: 0.10,
            clearance_m: 0.05,
        }
    }
}

impl RobotShape {
    /// About where the four wheels touch the ground, in the robot frame.
    pub fn contacts(&self) -> Vec<Point3<f64>> {
        let ahead_m = (0.5 * self.length_m - self.wheel_radius_m).max(0.0);
        let aside_m = 0.4 * self.width_m;
        [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
            .map(|(x, y)| Point3::new(x * ahead_m, y * aside_m, -self.base_above_floor_m))
            .to_vec()
    }

    /// Radius of the largest circle about `base_link` that lies within the hull, in metres.
    pub fn inscribed_radius_m(&self) -> f64 {
        0.5 * self.length_m.min(self.width_m)
    }

    /// Radius of the circle that the hull sweeps when it turns in place, in metres.
    pub fn circumscribed_radius_m(&self) -> f64 {
        0.5 * self.length_m.hypot(self.width_m)
    }
}

/// How measurements become terrain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TerrainConfig {
    /// Side of a cell in metres. [0.02, 0.5]
    pub cell_m: f64,
    /// Distance up to which points are read as ground, in metres. [1, 20]
    pub ground_range_m: f64,
    /// Distance up to which rays clear what they pass through, in metres. [1, 30]
    pub carve_range_m: f64,
    /// Longest stretch between two ground points of one beam's column that still counts as seen, in
    /// metres. [0, 1]
    pub interpolate_m: f64,
    /// Longest stretch between two ground points of neighbouring beams that still counts as seen, in
    /// metres. [0, 1]
    pub interpolate_across_m: f64,
    /// Standard deviation of a measured height near the robot, in metres. [0.001, 0.1]
    pub height_sigma_m: f64,
    /// Standard deviation of the scan's attitude, in radians: heights get worse with distance by
    /// this much. [0, 0.05]
    pub attitude_sigma_rad: f64,
    /// Standard deviation of one row's tilt against the next, in radians. [0, 0.02]
    pub row_sigma_rad: f64,
    /// Widest hole that may hide between measured ground points where the robot puts its wheels, in
    /// metres: interpolated ground with no measured point within half of it is not driven on until
    /// it was seen more closely. A hull longer than this does not fall in. [0.05, 1]
    pub sure_gap_m: f64,
    /// Distance up to which a ground point counts for coverage, in metres. [1, 20]
    pub coverage_range_m: f64,
    /// Air kept beside obstacles, beyond the hull, in metres. [0, 0.5]
    pub obstacle_margin_m: f64,
    /// Ground kept between the hull and any drop-off, proven or suspected, in metres: pose error,
    /// slip and the tail of a turn must not reach it. [0.02, 1]
    pub edge_margin_m: f64,
    /// Ground kept between the hull and what was not seen, in metres. [0, 0.5]
    pub unknown_margin_m: f64,
    /// Takes the floor as flat and whole wherever a single laser line found no obstacle. For robots
    /// with a fixed laser, in worlds without edges, on the operator's word only.
    pub flat_floor: bool,
}

impl Default for TerrainConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.05,
            ground_range_m: 10.0,
            carve_range_m: 12.0,
            interpolate_m: 0.65,
            interpolate_across_m: 0.45,
            height_sigma_m: 0.01,
            attitude_sigma_rad: 0.004,
            row_sigma_rad: 0.0015,
            sure_gap_m: 0.36,
            coverage_range_m: 8.0,
            obstacle_margin_m: 0.03,
            edge_margin_m: 0.15,
            unknown_margin_m: 0.05,
            flat_floor: false,
        }
    }
}

impl TerrainConfig {
    /// Standard deviation in metres of the height of a point `distance_m` away.
    pub fn height_sigma_at(&self, distance_m: f64) -> f64 {
        self.height_sigma_m.hypot(distance_m * self.attitude_sigma_rad)
    }

    /// Standard deviation in metres of the height of one point against its neighbour in the scan.
    pub fn relative_sigma_at(&self, distance_m: f64) -> f64 {
        self.height_sigma_m.hypot(distance_m * self.row_sigma_rad)
    }
}
