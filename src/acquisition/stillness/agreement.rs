//! What two lines say of one another: whether they show the same, and how they change with the tilt.

use crate::scan::{LaserLine, Return};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// Beams that count hit something at most this far to the side, in metres, about the robot's own
/// half width: what runs along its side farther out may be a wall.
const BESIDE_M: f64 = 0.35;
/// Nor do beams beyond this bearing, in radians, or nearer than this, in metres: the robot itself.
const WIDEST_RAD: f64 = 0.8;
const NEAREST_M: f64 = 0.4;
/// Most that the logarithms of two ranges of one place differ by: USARSim's ±0.1 % twice, and half
/// of that again.
const NOISE: f64 = 0.003;
/// Share of the beams that may differ by more: edges, and what moves.
const ODD_SHARE: f64 = 0.15;
/// Fewest beams that tell anything.
pub(super) const FEWEST: usize = 3;
/// The mean over `n` beams is this much of a beam's own tolerance over `√n`: 3.5 deviations.
const MEAN_SHARE: f64 = 1.3;

/// A line, and when and where it was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Seen {
    pub line: LaserLine,
    pub cast: Stamp,
    /// By the servo law.
    pub tilt_rad: f64,
}

/// The slope `d ln r / dθ` of the ranges, and the tilt of the perpendicular that makes it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Facing {
    pub slope: f64,
    pub perpendicular_rad: f64,
}

/// Whether two lines show the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Agreement {
    /// Within the noise; the mean logarithm of their ranges straight ahead by this much.
    Same {
        /// Of the mean logarithm.
        tolerance: f64,
    },
    /// Straight ahead neither hits anything, and the rest of the view ahead is the same: walls along
    /// the way look so under any tilt.
    Blind {
        /// Beams that hit something, the same in both.
        hits: usize,
    },
    /// They show something else.
    Different,
    /// They cannot be compared.
    Unknown,
}

/// Compares two lines taken from one place.
pub(super) fn agreement(a: &LaserLine, b: &LaserLine) -> Agreement {
    if a.len() != b.len() {
        return Agreement::Unknown;
    }
    let quantum_m = quantum_m(a).max(quantum_m(b));
    let (mut ahead, mut around) = (Tally::default(), Tally::default());
    for beam in (0..a.len()).filter(|&beam| a.bearing_rad(beam).abs() <= WIDEST_RAD) {
        let is_ahead = |range_m: f64| (range_m * a.bearing_rad(beam).sin()).abs() <= BESIDE_M;
        match (a.classify(beam), b.classify(beam)) {
            (Return::Hit(first), Return::Hit(second)) => {
                let (near, far) = (first.min(second), first.max(second));
                if far < NEAREST_M {
                    continue;
                }
                let (log, tolerance) = ((second / first).ln(), NOISE + 1.1 * quantum_m / first);
                around.compare(log, tolerance);
                if is_ahead(near) {
                    ahead.compare(log, tolerance);
                }
            }
            (Return::Hit(range_m), Return::Nothing) | (Return::Nothing, Return::Hit(range_m))
                if range_m >= NEAREST_M =>
            {
                around.odd += 1;
                ahead.odd += usize::from(is_ahead(range_m));
            }
            _ => {}
        }
    }
    if ahead.told() >= FEWEST {
        return ahead.verdict();
    }
    match around.is_odd() || (ahead.odd > 0 && ahead.even == 0) {
        true => Agreement::Different,
        false => Agreement::Blind { hits: around.even },
    }
}

/// How many beams of two whole lines, taken from one place, differ by more than the noise, and how many
/// can be compared.
pub(super) fn changed_beams(a: &LaserLine, b: &LaserLine) -> (usize, usize) {
    let quantum_m = quantum_m(a).max(quantum_m(b));
    let (mut changed, mut told) = (0, 0);
    for beam in 0..a.len().min(b.len()) {
        match (a.classify(beam), b.classify(beam)) {
            (Return::Hit(first), Return::Hit(second)) if first.max(second) >= NEAREST_M => {
                told += 1;
                let differs = (second / first).ln().abs() > NOISE + 1.1 * quantum_m / first;
                changed += usize::from(differs);
            }
            (Return::Hit(range_m), Return::Nothing) | (Return::Nothing, Return::Hit(range_m))
                if range_m >= NEAREST_M =>
            {
                told += 1;
                changed += 1;
            }
            _ => {}
        }
    }
    (changed, told)
}

/// Beams of two lines, compared.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    even: usize,
    odd: usize,
    /// Of the logarithms of the even ones, and of what each may be off by.
    sum: f64,
    tolerances: f64,
}

impl Tally {
    fn compare(&mut self, log: f64, tolerance: f64) {
        if log.abs() > tolerance {
            self.odd += 1;
            return;
        }
        self.even += 1;
        self.sum += log;
        self.tolerances += tolerance;
    }

    fn told(&self) -> usize {
        self.even + self.odd
    }

    fn is_odd(&self) -> bool {
        self.odd as f64 > ODD_SHARE * self.told() as f64
    }

    fn verdict(&self) -> Agreement {
        if self.is_odd() || self.even < FEWEST {
            return Agreement::Different;
        }
        let even = self.even as f64;
        let tolerance = (MEAN_SHARE / even.sqrt()).min(1.0) * self.tolerances / even;
        match (self.sum / even).abs() <= tolerance {
            true => Agreement::Same { tolerance },
            false => Agreement::Different,
        }
    }
}

/// Whether most beams of a line reach well beyond the floor, if it was taken at `tilt_rad`, down
/// positive, `height_m` above a level floor.
pub(super) fn sees_through_floor(line: &LaserLine, tilt_rad: f64, height_m: f64) -> bool {
    /// A robot may stand on a slope, and its height be a guess.
    const WELL: f64 = 1.5;
    const MOST: f64 = 0.8;
    let (mut through, mut all) = (0_usize, 0_usize);
    for beam in (0..line.len()).filter(|&beam| line.bearing_rad(beam).abs() <= WIDEST_RAD) {
        let falls = line.bearing_rad(beam).cos() * tilt_rad.sin();
        let beyond_m = WELL * height_m / falls;
        if falls <= 0.0 || beyond_m >= line.max_range_m {
            continue;
        }
        match line.classify(beam) {
            Return::Hit(range_m) if range_m < NEAREST_M => continue,
            Return::Hit(range_m) => through += usize::from(range_m > beyond_m),
            Return::Nothing => through += 1,
            Return::Missing => continue,
        }
        all += 1;
    }
    all >= FEWEST && through as f64 >= MOST * all as f64
}

/// What ranges are cut to: UDK prints centimetres, UT2004 tenths of a millimetre.
fn quantum_m(line: &LaserLine) -> f64 {
    let whole = |range_m: &f64| (100.0 * range_m - (100.0 * range_m).round()).abs() < 1e-6;
    match line.ranges_m.iter().filter(|range| range.is_finite()).all(whole) {
        true => 0.01,
        false => 1e-4,
    }
}

/// What the change from one line to the next says of the surface in sight; `None` where the tilt was
/// not told to turn, or too little is seen.
pub(super) fn facing(a: &Seen, b: &Seen) -> Option<Facing> {
    const LEAST_TURN_RAD: f64 = 0.001;
    const SAME_SURFACE: f64 = 0.2;
    let turn_rad = b.tilt_rad - a.tilt_rad;
    if turn_rad.abs() < LEAST_TURN_RAD || a.line.len() != b.line.len() {
        return None;
    }
    let logs: Vec<f64> = (0..a.line.len())
        .filter(|&beam| a.line.bearing_rad(beam).abs() <= WIDEST_RAD)
        .filter_map(|beam| match (a.line.classify(beam), b.line.classify(beam)) {
            (Return::Hit(first), Return::Hit(second)) => {
                let beside_m = (first * a.line.bearing_rad(beam).sin()).abs();
                let counts = first >= NEAREST_M && beside_m <= BESIDE_M;
                Some((second / first).ln()).filter(|log| counts && log.abs() < SAME_SURFACE)
            }
            _ => None,
        })
        .collect();
    if logs.len() < FEWEST {
        return None;
    }
    let slope = logs.iter().sum::<f64>() / logs.len() as f64 / turn_rad;
    let middle_rad = 0.5 * (a.tilt_rad + b.tilt_rad);
    Some(Facing { slope, perpendicular_rad: middle_rad - slope.atan() })
}
