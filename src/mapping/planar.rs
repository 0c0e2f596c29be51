//! A 2D mapper by scan matching: the baseline that the paper compares its figures 7 and 10 with.
//!
//! Each level scan is laid over the grid of those before it by a correlative search about the
//! odometry (Olson, "Real-time correlative scan matching", ICRA 2009), coarse to fine, and then drawn
//! into the grid as log-odds. It knows no ramps, no low obstacles and no second level: that is the
//! point of the comparison, not a fault of this implementation.

use nalgebra::{Isometry2, Point2, Vector2};
use std::collections::BTreeMap;

/// Edge of a cell in metres.
pub const PLANAR_CELL_M: f64 = 0.05;
/// Tenths of log-odds that a hit adds and a pass takes, and where they stop.
const HIT: i16 = 9;
const PASS: i16 = -4;
const MOST: i16 = 40;
/// First search about the odometry: half widths.
const SEARCH_M: f64 = 0.4;
const SEARCH_RAD: f64 = 0.14;
/// Steps of the search, coarse to fine: metres, radians.
const STEPS: [(f64, f64); 4] = [(0.1, 0.02), (0.05, 0.01), (0.02, 0.004), (0.01, 0.002)];
/// What a metre or a radian away from the odometry costs, as a share of a perfect match: enough to
/// settle ties along corridors and no more.
const AWAY_PER_M: f64 = 0.05;
const AWAY_PER_RAD: f64 = 0.1;
/// Scans that match less than this stay where odometry has them.
const LEAST_MATCH: f64 = 0.25;

/// One level scan in the robot's frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanarScan {
    /// Where the sensor stands.
    pub origin: Point2<f64>,
    /// Ends of beams that hit something.
    pub hits: Vec<Point2<f64>>,
    /// Ends of what is known to be free along beams that hit nothing.
    pub misses: Vec<Point2<f64>>,
}

/// Pose and occupancy grid in the plane.
#[derive(Clone, Debug)]
pub struct PlanarMapper {
    cells: BTreeMap<(i32, i32), i16>,
    world_from_robot: Isometry2<f64>,
    matched: bool,
}

impl PlanarMapper {
    /// An empty map at a pose.
    pub fn new(world_from_robot: Isometry2<f64>) -> Self {
        Self { cells: BTreeMap::new(), world_from_robot, matched: false }
    }

    /// The pose at the last scan.
    pub fn world_from_robot(&self) -> &Isometry2<f64> {
        &self.world_from_robot
    }

    /// Whether the last scan was laid over the map; otherwise odometry alone placed it.
    pub fn matched(&self) -> bool {
        self.matched
    }

    /// Cells that were seen with their log-odds in tenths, positive where something stands.
    pub fn cells(&self) -> impl Iterator<Item = ((i32, i32), i16)> + '_ {
        self.cells.iter().map(|(cell, odds)| (*cell, *odds))
    }

    /// Takes in a scan made after a motion measured by odometry.
    pub fn observe(&mut self, before_from_after: &Isometry2<f64>, scan: &PlanarScan) {
        let predicted = self.world_from_robot * before_from_after;
        let found = (!self.cells.is_empty()).then(|| self.search(&predicted, scan));
        let found = found.filter(|(_, share)| *share >= LEAST_MATCH);
        self.matched = found.is_some();
        self.world_from_robot = found.map_or(predicted, |(pose, _)| pose);
        self.draw(scan);
    }

    /// The best pose about the predicted one and the share of the hits that lie on occupied cells.
    fn search(&self, predicted: &Isometry2<f64>, scan: &PlanarScan) -> (Isometry2<f64>, f64) {
        let pose = |x: f64, y: f64, turn: f64| {
            Isometry2::new(
                predicted.translation.vector + Vector2::new(x, y),
                predicted.rotation.angle() + turn,
            )
        };
        let worth = |[x, y, turn]: [f64; 3]| {
            let away = AWAY_PER_M * x.hypot(y) + AWAY_PER_RAD * turn.abs();
            self.match_share(&pose(x, y, turn), scan) - away
        };
        let mut best = ([0.0; 3], worth([0.0; 3]));
        let (mut reach_m, mut reach_rad) = (SEARCH_M, SEARCH_RAD);
        for (step_m, step_rad) in STEPS {
            let around = best.0;
            let (count, turns) =
                ((reach_m / step_m).round() as i32, (reach_rad / step_rad).round() as i32);
            for k in -turns..=turns {
                for i in -count..=count {
                    for j in -count..=count {
                        let at = [
                            around[0] + f64::from(i) * step_m,
                            around[1] + f64::from(j) * step_m,
                            around[2] + f64::from(k) * step_rad,
                        ];
                        let worth = worth(at);
                        if worth > best.1 {
                            best = (at, worth);
                        }
                    }
                }
            }
            (reach_m, reach_rad) = (step_m, step_rad);
        }
        let [x, y, turn] = best.0;
        let pose = pose(x, y, turn);
        (pose, self.match_share(&pose, scan))
    }

    /// Mean over the hits of how occupied the map is there: 1 in an occupied cell, less beside one.
    fn match_share(&self, world_from_robot: &Isometry2<f64>, scan: &PlanarScan) -> f64 {
        let sum: f64 = scan
            .hits
            .iter()
            .map(|p| {
                let (x, y) = cell_of(&(world_from_robot * p));
                let occupied =
                    |dx: i32, dy: i32| self.cells.get(&(x + dx, y + dy)).is_some_and(|&c| c > 0);
                if occupied(0, 0) {
                    1.0
                } else if [(1, 0), (-1, 0), (0, 1), (0, -1)].iter().any(|d| occupied(d.0, d.1)) {
                    0.5
                } else {
                    0.0
                }
            })
            .sum();
        sum / scan.hits.len().max(1) as f64
    }

    fn draw(&mut self, scan: &PlanarScan) {
        let origin = self.world_from_robot * scan.origin;
        let mut passed = BTreeMap::new();
        for (end, hit) in
            scan.hits.iter().map(|p| (p, true)).chain(scan.misses.iter().map(|p| (p, false)))
        {
            let end = self.world_from_robot * end;
            let way = end - origin;
            let steps = (2.0 * way.norm() / PLANAR_CELL_M).ceil().max(1.0);
            for step in 0..steps as u32 {
                let cell = cell_of(&(origin + way * (f64::from(step) / steps)));
                passed.entry(cell).or_insert(PASS);
            }
            // A hit outweighs the other beams of the scan that pass through its cell.
            if hit {
                passed.insert(cell_of(&end), HIT);
            }
        }
        for (cell, odds) in passed {
            let held = self.cells.entry(cell).or_default();
            *held = (*held + odds).clamp(-MOST, MOST);
        }
    }
}

fn cell_of(point: &Point2<f64>) -> (i32, i32) {
    ((point.x / PLANAR_CELL_M).floor() as i32, (point.y / PLANAR_CELL_M).floor() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A room of 8 × 6 m with a corner cut off, seen from a pose.
    fn seen_from(world_from_robot: &Isometry2<f64>) -> PlanarScan {
        let walls =
            [(1.0, 0.0, 4.0), (-1.0, 0.0, 4.0), (0.0, 1.0, 3.0), (0.0, -1.0, 3.0), (0.6, 0.8, 4.0)];
        let mut scan = PlanarScan::default();
        for beam in -90..=90 {
            let turn = world_from_robot.rotation.angle() + f64::from(beam).to_radians();
            let ray = Vector2::new(turn.cos(), turn.sin());
            let from = world_from_robot.translation.vector;
            let range = walls
                .iter()
                .map(|&(nx, ny, d)| (d - nx * from.x - ny * from.y) / (nx * ray.x + ny * ray.y))
                .filter(|range| *range > 0.0)
                .fold(f64::INFINITY, f64::min);
            scan.hits.push(world_from_robot.inverse() * Point2::from(from + ray * range));
        }
        scan
    }

    #[test]
    fn wrong_odometry_is_corrected_to_a_cell() {
        let mut truth = Isometry2::new(Vector2::new(-1.0, -0.5), 0.2);
        let mut mapper = PlanarMapper::new(truth);
        mapper.observe(&Isometry2::identity(), &seen_from(&truth));
        for _ in 0..8 {
            truth *= Isometry2::new(Vector2::new(0.3, 0.0), 0.1);
            let told = Isometry2::new(Vector2::new(0.36, 0.05), 0.16);
            mapper.observe(&told, &seen_from(&truth));
            assert!(mapper.matched());
        }
        let error = mapper.world_from_robot().inverse() * truth;
        assert!(error.translation.vector.norm() < 0.08, "{error}");
        assert!(error.rotation.angle().abs() < 0.02, "{error}");
    }

    #[test]
    fn what_a_scan_crosses_is_free_and_what_it_hits_is_not() {
        let mut mapper = PlanarMapper::new(Isometry2::identity());
        mapper.observe(&Isometry2::identity(), &seen_from(&Isometry2::identity()));
        let at = |x: f64, y: f64| mapper.cells.get(&cell_of(&Point2::new(x, y))).copied();
        assert!(at(2.0, 0.0).is_some_and(|odds| odds < 0));
        assert!(at(4.0, 0.0).or(at(3.99, 0.0)).is_some_and(|odds| odds > 0));
        assert_eq!(at(-2.0, 0.0), None);
    }
}
