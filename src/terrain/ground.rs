//! Which points of a fan are ground, which stretches between them count as seen, and where ground
//! that was due is missing.
//!
//! A column is read from the robot outwards. Points nearer together than [`MERGE_M`] become one
//! node, which evens out range noise in fine scans. Two nodes are ground when the line between them
//! is no steeper than the robot may drive and agrees with its neighbours: its slope must lie between
//! the slopes before and after it. A platform edge, seen from the platform, fails that test (level,
//! then falling, then level again), and so do kerbs and steps; the foot of a ramp passes it.

use super::config::{RobotShape, TerrainConfig};
use super::fan::{Fan, FloorPlane, Sample};
use nalgebra::{Point3, Vector3};

/// Points of a column within this distance are one node.
const MERGE_M: f64 = 0.07;
/// Two nodes nearer than this need no neighbours to agree with.
const SHORT_M: f64 = 0.12;
/// Longest stretch of which both ends may be called ground though what lies between is unknown.
const LABEL_M: f64 = 1.3;
/// Slopes agree within this, beyond their noise.
const SLOPE_SLACK: f64 = 0.06;
/// A ray must come down this much lower than the ground was due before ground counts as missing.
const MISSING_M: f64 = 0.10;
/// A row that meets the ground farther beyond the last seen ground than this says nothing about it.
const DUE_M: f64 = 1.5;
/// A single point on the robot's own plane is ground up to this distance.
const ALONE_M: f64 = 2.0;
/// Longest stretch that one ray's evidence marks as missing ground.
const MARK_M: f64 = 1.0;

/// Ground that was due between two points of a column and did not show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Missing {
    /// Last ground seen; equal to `to` where none was.
    pub from: Point3<f64>,
    /// Where the next row would have met it.
    pub to: Point3<f64>,
    /// Whether no slope that the robot may drive explains it.
    pub proven: bool,
}

/// What a fan says about ground, sample by sample (row-major like the fan).
pub(super) struct Labels {
    /// The sample is a point of ground.
    pub ground: Vec<bool>,
    /// Row of the next ground sample outwards in the same column to which the stretch counts as
    /// seen; 0 for none (no stretch leads to row 0).
    pub next: Vec<u16>,
    /// Height of the sample above the ground before it in its column, NaN where there was none.
    pub above_m: Vec<f32>,
    /// Missing ground.
    pub missing: Vec<Missing>,
}

struct Node {
    p: Vector3<f64>,
    away_m: f64,
    points: f64,
    first: usize,
    last: usize,
    first_p: Point3<f64>,
    /// A beam between this node and the next returned nothing.
    broken: bool,
}

struct Pair {
    gap_m: f64,
    slope: f64,
    sigma_m: f64,
    /// Ground as far as this pair alone can say.
    candidate: bool,
    accepted: bool,
}

/// Reads all columns of a fan. `known(p, sigma_m)` tells whether ground is already known at a point.
pub(super) fn label(
    fan: &Fan,
    floor: &FloorPlane,
    config: &TerrainConfig,
    shape: &RobotShape,
    known: impl Fn(&Point3<f64>, f64) -> bool,
) -> Labels {
    let cells = fan.samples.len();
    let mut labels = Labels {
        ground: vec![false; cells],
        next: vec![0; cells],
        above_m: vec![f32::NAN; cells],
        missing: Vec::new(),
    };
    let mut reader = Reader {
        fan,
        floor,
        config,
        tan_max: shape.max_slope_rad.tan(),
        max_step_m: shape.max_step_m,
        column: 0,
        nodes: Vec::new(),
        pairs: Vec::new(),
    };
    for column in 0..fan.columns.len() {
        reader.column = column;
        reader.read(&known, &mut labels);
    }
    labels
}

struct Reader<'a> {
    fan: &'a Fan,
    floor: &'a FloorPlane,
    config: &'a TerrainConfig,
    tan_max: f64,
    max_step_m: f64,
    column: usize,
    nodes: Vec<Node>,
    pairs: Vec<Pair>,
}

impl Reader<'_> {
    fn read(&mut self, known: &impl Fn(&Point3<f64>, f64) -> bool, labels: &mut Labels) {
        self.gather_nodes();
        let floor_slope = self.floor.slope(&self.azimuth());
        let from_floor = self.nodes.first().is_some_and(|node| {
            let sigma_m = self.config.height_sigma_at(node.away_m);
            let due_m = self.floor.z_at(node.p.x, node.p.y);
            (node.p.z - due_m).abs() < 0.05 + 2.0 * sigma_m
        });
        self.gather_pairs();
        self.accept_pairs(from_floor.then_some(floor_slope));
        self.write(known, from_floor, floor_slope, labels);
        if !from_floor {
            self.find_missing_floor(floor_slope, &mut labels.missing);
        }
    }

    fn azimuth(&self) -> Vector3<f64> {
        let row = self.fan.rows.len() / 2;
        let ray = self.fan.rows[row].direction(self.fan.columns[self.column]);
        let flat = Vector3::new(ray.x, ray.y, 0.0);
        flat / flat.norm().max(1e-9)
    }

    fn gather_nodes(&mut self) {
        self.nodes.clear();
        let mut open = false;
        for row in 0..self.fan.rows.len() {
            match *self.fan.sample(row, self.column) {
                Sample::Missing => {}
                Sample::Nothing => {
                    open = false;
                    if let Some(node) = self.nodes.last_mut() {
                        node.broken = true;
                    }
                }
                Sample::Hit { p, away_m } => {
                    if let Some(node) = self.nodes.last_mut()
                        && open
                        && (p - node.first_p).norm() < MERGE_M
                    {
                        node.points += 1.0;
                        node.p += (p.coords - node.p) / node.points;
                        node.away_m += (away_m - node.away_m) / node.points;
                        node.last = row;
                        continue;
                    }
                    self.nodes.push(Node {
                        p: p.coords,
                        away_m,
                        points: 1.0,
                        first: row,
                        last: row,
                        first_p: p,
                        broken: false,
                    });
                    open = true;
                }
            }
        }
    }

    fn gather_pairs(&mut self) {
        self.pairs.clear();
        for (a, b) in self.nodes.iter().zip(self.nodes.iter().skip(1)) {
            let gap_m = (b.p.x - a.p.x).hypot(b.p.y - a.p.y);
            let rise_m = b.p.z - a.p.z;
            let sigma_m = (self.config.relative_sigma_at(a.away_m) / a.points.sqrt())
                .hypot(self.config.relative_sigma_at(b.away_m) / b.points.sqrt());
            let slack_m = (2.5 * sigma_m).min(0.5 * self.max_step_m);
            let candidate = !a.broken
                && gap_m <= LABEL_M
                && b.away_m > a.away_m - 0.02
                && a.away_m <= self.config.ground_range_m
                && b.away_m <= self.config.ground_range_m
                && rise_m.abs() <= self.tan_max * gap_m + slack_m
                && self.fan.aligned(a.last, b.first);
            self.pairs.push(Pair {
                gap_m,
                slope: rise_m / gap_m.max(1e-3),
                sigma_m,
                candidate,
                accepted: false,
            });
        }
    }

    fn accept_pairs(&mut self, floor_slope: Option<f64>) {
        for index in 0..self.pairs.len() {
            let pair = &self.pairs[index];
            if !pair.candidate {
                continue;
            }
            let before = if index == 0 {
                floor_slope
            } else {
                self.steady_slope(index - 1, -1).or(if index == 1 { floor_slope } else { None })
            };
            let after = self.steady_slope(index + 1, 1);
            let accepted = pair.gap_m <= SHORT_M || self.agrees(index, before, after);
            self.pairs[index].accepted = accepted;
        }
    }

    /// Slope of the candidate pairs from `index` on in one direction, over a baseline long enough
    /// that noise does not rule it.
    fn steady_slope(&self, index: usize, step: isize) -> Option<f64> {
        let (mut run_m, mut rise_m) = (0.0, 0.0);
        let mut index = index;
        while let Some(pair) = self.pairs.get(index)
            && pair.candidate
            && run_m < 3.0 * SHORT_M
        {
            run_m += pair.gap_m;
            rise_m += pair.slope * pair.gap_m;
            let Some(next) = index.checked_add_signed(step) else { break };
            index = next;
        }
        (run_m > 0.5 * SHORT_M).then(|| rise_m / run_m)
    }

    fn agrees(&self, index: usize, before: Option<f64>, after: Option<f64>) -> bool {
        let pair = &self.pairs[index];
        let slack = SLOPE_SLACK + 2.5 * pair.sigma_m / pair.gap_m;
        let (low, high) = match (before, after) {
            (Some(a), Some(b)) => (a.min(b), a.max(b)),
            (Some(a), None) | (None, Some(a)) => (a, a),
            (None, None) => return false,
        };
        if pair.slope < low - slack || pair.slope > high + slack {
            return false;
        }
        // The gap must be one that the rows' own spacing explains on such a slope.
        let node = &self.nodes[index];
        let due_m = [before, after]
            .into_iter()
            .flatten()
            .filter_map(|slope| self.due_away_m(node, self.nodes[index + 1].first, slope))
            .fold(0.0_f64, |most, away_m| most.max(away_m - node.away_m));
        pair.gap_m <= 1.6 * due_m + 0.10
    }

    /// Fall per metre of a row's ray in this column; `None` for a ray straight down or up.
    fn descent(&self, row: usize) -> Option<f64> {
        let ray = self.fan.rows[row].direction(self.fan.columns[self.column]);
        let run = ray.x.hypot(ray.y);
        (run > 1e-6).then(|| -ray.z / run)
    }

    /// Horizontal distance at which a row meets the plane of `slope` through `node`.
    fn due_away_m(&self, node: &Node, row: usize, slope: f64) -> Option<f64> {
        let closing = slope + self.descent(row)?;
        let height_m = self.fan.rows[row].origin.z - node.p.z + slope * node.away_m;
        (closing > 0.01).then(|| height_m / closing).filter(|away_m| *away_m > 0.0)
    }

    fn write(
        &self,
        known: &impl Fn(&Point3<f64>, f64) -> bool,
        from_floor: bool,
        floor_slope: f64,
        labels: &mut Labels,
    ) {
        let columns = self.fan.columns.len();
        let accepted = |index: usize| self.pairs.get(index).is_some_and(|pair| pair.accepted);
        // Height, distance and slope of the ground last seen on the way outwards.
        let mut last: Option<(f64, f64, f64)> = None;
        for (index, node) in self.nodes.iter().enumerate() {
            let inwards = index > 0 && accepted(index - 1);
            // The first point out from the robot, near it and on the plane it stands on, is ground
            // even alone: beyond an edge close by there is no second one.
            let ground = inwards
                || accepted(index)
                || (index == 0 && from_floor && node.away_m <= ALONE_M)
                || (node.away_m <= self.config.ground_range_m
                    && known(
                        &Point3::from(node.p),
                        self.config.relative_sigma_at(node.away_m) / node.points.sqrt(),
                    ));
            let above_m = last.map(|(z, away_m, slope)| {
                node.p.z - z - slope * (node.away_m - away_m).clamp(0.0, 2.0)
            });
            let mut before = None;
            for row in node.first..=node.last {
                let at = row * columns + self.column;
                let Sample::Hit { p, .. } = &self.fan.samples[at] else { continue };
                labels.ground[at] = ground;
                if let Some(above_m) = above_m {
                    labels.above_m[at] = (above_m + p.z - node.p.z) as f32;
                }
                if ground && let Some(before) = before {
                    labels.next[before] = row as u16;
                }
                before = Some(at);
            }
            if accepted(index) && self.pairs[index].gap_m <= self.config.interpolate_m {
                labels.next[node.last * columns + self.column] = self.nodes[index + 1].first as u16;
            }
            if ground {
                let slope = self.slope_at(index, floor_slope);
                last = Some((node.p.z, node.away_m, slope));
                if !accepted(index) {
                    self.find_missing(node, slope, &mut labels.missing);
                }
            }
        }
    }

    /// Slope of the ground that ends at a node.
    fn slope_at(&self, index: usize, floor_slope: f64) -> f64 {
        let (mut run_m, mut rise_m) = (0.0, 0.0);
        for pair in self.pairs[..index].iter().rev() {
            if !pair.accepted || run_m > 3.0 * SHORT_M {
                break;
            }
            run_m += pair.gap_m;
            rise_m += pair.slope * pair.gap_m;
        }
        let slope = if run_m > SHORT_M { rise_m / run_m } else { floor_slope };
        slope.clamp(-self.tan_max, self.tan_max)
    }

    /// The first row after `row` that was read in this column.
    fn next_read(&self, row: usize) -> Option<(usize, &Sample)> {
        (row..self.fan.rows.len())
            .map(|row| (row, self.fan.sample(row, self.column)))
            .find(|(_, sample)| !matches!(sample, Sample::Missing))
    }

    /// Judges the row that follows the last ground before a break.
    fn find_missing(&self, node: &Node, slope: f64, missing: &mut Vec<Missing>) {
        let Some((row, sample)) = self.next_read(node.last + 1) else { return };
        let Some(due_m) = self.due_away_m(node, row, slope) else { return };
        if due_m <= node.away_m
            || due_m - node.away_m > DUE_M
            || due_m > self.config.ground_range_m
            || !self.fan.aligned(node.last, row)
        {
            return;
        }
        let along = self.azimuth();
        let at = |away_m: f64| {
            let ahead_m = away_m - node.away_m;
            Point3::from(node.p + along * ahead_m + Vector3::z() * (slope * ahead_m))
        };
        let descent = self.descent(row).unwrap_or(0.0);
        let mut mark = Missing {
            from: Point3::from(node.p),
            to: at(due_m.min(node.away_m + MARK_M)),
            proven: false,
        };
        match *sample {
            Sample::Missing => return,
            Sample::Nothing => {
                let range_m = due_m * descent.hypot(1.0);
                if range_m > 0.9 * self.fan.max_range_m {
                    return;
                }
            }
            Sample::Hit { p, away_m } => {
                let sigma_m = self.config.relative_sigma_at(away_m);
                let due_z = node.p.z + slope * (away_m - node.away_m);
                if away_m <= due_m || p.z > due_z - MISSING_M - 2.0 * sigma_m {
                    return;
                }
                // Where the ray first goes lower than the steepest drivable slope from here on.
                let closing = descent - self.tan_max;
                let head_m = self.fan.rows[row].origin.z - node.p.z - self.tan_max * node.away_m
                    + MISSING_M
                    + 2.0 * sigma_m;
                let proven_m = head_m / closing;
                if closing > 0.0 && proven_m < away_m && proven_m < node.away_m + MARK_M {
                    mark.proven = true;
                    mark.to = at(proven_m.max(due_m));
                }
            }
        }
        missing.push(mark);
    }

    /// Judges a column that does not begin on the plane the robot stands on.
    fn find_missing_floor(&self, floor_slope: f64, missing: &mut Vec<Missing>) {
        let Some((row, sample)) = self.next_read(0) else { return };
        let origin = self.fan.rows[row].origin;
        let Some(descent) = self.descent(row) else { return };
        let height_m = origin.z - self.floor.z_at(origin.x, origin.y);
        let closing = descent + floor_slope;
        if closing < 0.05 || height_m <= 0.0 {
            return;
        }
        let due_m = height_m / closing;
        let to = origin + self.azimuth() * due_m;
        let to = Point3::new(to.x, to.y, self.floor.z_at(to.x, to.y));
        let lower = match *sample {
            Sample::Missing => false,
            Sample::Nothing => due_m * descent.hypot(1.0) < 0.9 * self.fan.max_range_m,
            Sample::Hit { p, away_m } => {
                let sigma_m = self.config.height_sigma_at(away_m);
                away_m > due_m && p.z < self.floor.z_at(p.x, p.y) - MISSING_M - 2.0 * sigma_m
            }
        };
        if lower && due_m < 3.0 {
            missing.push(Missing { from: to, to, proven: false });
        }
    }
}
