//! What two lines say of one another: whether they show the same, and how they change with the tilt.

use crate::scan::{LaserLine, Return, range_step_m};
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
/// The logarithms of ranges of one surface differ by less than this from one row to the next but one.
const SAME_SURFACE: f64 = 0.2;
/// So far the tilt turned, in radians, where a beam tells of it: two rows, and more for one that slowed
/// down before it stopped.
const TELLING_TURNS_RAD: [f64; 3] = [0.008, 0.016, 0.03];
const FEWEST_TELLING: usize = 12;
/// Beams that change and are no change yet: something that passes by, far away.
pub(super) const FEW: usize = 1;
/// What is hit beyond this share of the laser's range comes and goes with the noise.
const AT_THE_END: f64 = 0.995;
/// What comes into sight beyond this share of the laser's range comes from beyond it.
const AFAR: f64 = 0.9;
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
    /// Least and greatest tilt by the law as far as its times are unsure.
    pub span_rad: (f64, f64),
}

impl Seen {
    /// Takes in where else the law may have had the tilt.
    pub fn widen(&mut self, tilt_rad: f64) {
        let (least, most) = self.span_rad;
        self.span_rad = (least.min(tilt_rad), most.max(tilt_rad));
    }
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
                let (log, tolerance) = ((second / first).ln(), tolerance(quantum_m, first));
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

/// The beams that show how far the tilt turned just before `seen`: their ranges changed one way, and no more
/// than those of one surface do. None where they are few. Lines are given newest last.
pub(super) fn telling<'a>(
    before: impl DoubleEndedIterator<Item = &'a Seen> + Clone,
    seen: &Seen,
) -> Vec<usize> {
    let over = |turn_rad: f64| -> Option<Vec<usize>> {
        let turned = |earlier: &&Seen| (seen.tilt_rad - earlier.tilt_rad).abs() >= turn_rad;
        let earlier = before.clone().rev().find(turned)?;
        let middle = before.clone().rev().take_while(|earlier| !turned(earlier)).last()?;
        let beams = 0..seen.line.len();
        Some(beams.filter(|&beam| tells(beam, earlier, middle, seen)).collect())
    };
    let enough = |beams: &Vec<usize>| beams.len() >= FEWEST_TELLING;
    TELLING_TURNS_RAD.into_iter().filter_map(over).find(enough).unwrap_or_default()
}

fn tells(beam: usize, earlier: &Seen, middle: &Seen, seen: &Seen) -> bool {
    let lines = [&earlier.line, &middle.line, &seen.line];
    if lines.iter().any(|line| line.len() != seen.line.len())
        || seen.line.bearing_rad(beam).abs() > WIDEST_RAD
    {
        return false;
    }
    let [Return::Hit(first), Return::Hit(second), Return::Hit(last)] =
        lines.map(|line| line.classify(beam))
    else {
        return false;
    };
    let tolerance = tolerance(quantum_m(&seen.line), first);
    let (half, whole) = ((second / first).ln(), (last / first).ln());
    let between =
        half * whole.signum() >= -tolerance && (whole - half) * whole.signum() >= -tolerance;
    first.max(last) >= NEAREST_M && between && (tolerance..SAME_SURFACE).contains(&whole.abs())
}

/// How two whole lines compare, taken from one place.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Changes {
    /// Beams that differ by more than the noise, and all that can be compared.
    pub changed: usize,
    pub told: usize,
    /// Beams in one of the lines alone that hit something near the end of the laser's range.
    afar: usize,
    /// Sum of what each logarithm may differ by.
    tolerances: f64,
}

impl Changes {
    pub fn between(a: &LaserLine, b: &LaserLine) -> Self {
        let quantum_m = quantum_m(a).max(quantum_m(b));
        let mut changes = Self::default();
        for beam in 0..a.len().min(b.len()) {
            let (range_m, one_hits, differs) = match (a.classify(beam), b.classify(beam)) {
                (Return::Hit(first), Return::Hit(second)) => {
                    let log = (second / first).ln();
                    (first.max(second), false, log.abs() > tolerance(quantum_m, first))
                }
                (Return::Hit(range_m), Return::Nothing)
                | (Return::Nothing, Return::Hit(range_m)) => {
                    (range_m, true, range_m < AT_THE_END * a.max_range_m)
                }
                _ => continue,
            };
            if range_m >= NEAREST_M {
                changes.told += 1;
                changes.changed += usize::from(differs);
                changes.afar += usize::from(one_hits && differs && range_m > AFAR * a.max_range_m);
                changes.tolerances += tolerance(quantum_m, range_m);
            }
        }
        changes
    }

    /// Whether the ranges of some beams changed on average, and what that average may be off by.
    pub fn of_beams(a: &LaserLine, b: &LaserLine, beams: &[usize]) -> (bool, f64) {
        let quantum_m = quantum_m(a).max(quantum_m(b));
        let mut tally = Tally::default();
        for &beam in beams {
            if let (Return::Hit(first), Return::Hit(second)) = (a.classify(beam), b.classify(beam))
            {
                tally.compare((second / first).ln(), tolerance(quantum_m, first));
            }
        }
        match tally.verdict() {
            Agreement::Same { tolerance } => (false, tolerance),
            _ => (true, 0.0),
        }
    }

    /// Whether what changed came into sight, or went out of it, at the end of the laser's range, as floors
    /// and roofs do when the tilt turns.
    pub fn comes_from_afar(&self) -> bool {
        self.changed > FEW && 2 * self.afar > self.changed
    }

    /// What the logarithm of a range may differ by in the middle of all beams.
    pub fn tolerance(&self) -> f64 {
        self.tolerances / self.told.max(1) as f64
    }
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

/// What the logarithms of two ranges of one place differ by at most.
fn tolerance(quantum_m: f64, range_m: f64) -> f64 {
    NOISE + 1.1 * quantum_m / range_m
}

/// What ranges are cut to: UDK prints centimetres, UT2004 tenths of a millimetre.
fn quantum_m(line: &LaserLine) -> f64 {
    range_step_m(&line.ranges_m).unwrap_or(1e-4)
}

/// What the change from one line to the next says of the surface in sight; `None` where the tilt was
/// not told to turn, or too little is seen.
pub(super) fn facing(a: &Seen, b: &Seen) -> Option<Facing> {
    const LEAST_TURN_RAD: f64 = 0.001;
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
