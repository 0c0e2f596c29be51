//! Counts and times of a mission, for its report.

use crate::acquisition::{Scan, TimeBudget};
use crate::mapping::{UpdateReport, WeakDirection};
use crate::time::Arrival;
use serde::{Deserialize, Serialize};

/// What the time is spent on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pastime {
    /// Standing while something is decided or waited for.
    #[default]
    Think,
    /// Sweeping.
    Scan,
    /// Driving.
    Drive,
    /// Turning in place.
    Turn,
    /// Getting free.
    Recover,
}

/// Seconds spent on each [`Pastime`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TimeSplit {
    /// See [`Pastime::Think`].
    pub think_s: f64,
    /// See [`Pastime::Scan`].
    pub scan_s: f64,
    /// See [`Pastime::Drive`].
    pub drive_s: f64,
    /// See [`Pastime::Turn`].
    pub turn_s: f64,
    /// See [`Pastime::Recover`].
    pub recover_s: f64,
}

/// One sweep that was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SweepEntry {
    /// Name of the profile.
    pub profile: String,
    /// Rows filed.
    pub rows: usize,
    /// Rows given up.
    pub gaps: usize,
    /// Seconds from the first tilt command to the last filed line.
    pub seconds: f64,
    /// Where those went.
    pub budget: TimeBudget,
    /// Standard deviation of the tilts of single rows, in radians.
    pub tilt_sigma_rad: f64,
    /// Metres driven meanwhile; `None` for a sweep taken standing.
    pub driven_m: Option<f64>,
}

/// A scan that left the robot's place open in some direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WeakScan {
    /// Number of the scan among those in the map, from 0.
    pub scan: usize,
    /// The directions, weakest first.
    pub directions: Vec<WeakDirection>,
}

/// How well the scans fixed the robot's place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fixes {
    /// Scans that met a map; the first of all has nothing to be compared with.
    pub scans: usize,
    /// Those of them that left a direction open.
    pub weak: usize,
    /// The last few of these.
    pub last_weak: Vec<WeakScan>,
    /// Explanations of all that was seen that are alive now.
    pub hypotheses: usize,
    /// Most that were alive at once.
    pub most_hypotheses: usize,
    /// Loops closed.
    pub loops_closed: usize,
    /// Times that another explanation became the best, which takes back what the one before had closed.
    pub explanations_changed: usize,
}

/// Weak scans that are kept.
const KEPT_WEAK: usize = 5;

impl Fixes {
    /// Books what a scan did to the map.
    pub fn book(&mut self, update: &UpdateReport) {
        self.hypotheses = update.hypotheses;
        self.most_hypotheses = self.most_hypotheses.max(update.hypotheses);
        self.loops_closed += usize::from(update.loop_closed);
        self.explanations_changed += usize::from(update.loop_undone);
        if update.keyframe == 0 {
            return;
        }
        self.scans += 1;
        if !update.weak_directions.is_empty() {
            self.weak += 1;
            let directions = update.weak_directions.clone();
            self.last_weak.push(WeakScan { scan: update.keyframe, directions });
            let surplus = self.last_weak.len().saturating_sub(KEPT_WEAK);
            self.last_weak.drain(..surplus);
        }
    }
}

/// The running account of a mission.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    /// Where the time went.
    pub split: TimeSplit,
    /// Every sweep in order.
    pub sweeps: Vec<SweepEntry>,
    /// Planes, spheres and cylinders over all sweeps.
    pub surfaces: [usize; 3],
    /// Observations matched to a landmark.
    pub associations: usize,
    /// How well the scans fixed the robot's place.
    pub fixes: Fixes,
    /// Times the robot found itself in trouble.
    pub troubles: usize,
    last: Option<(Arrival, Pastime)>,
}

impl Ledger {
    /// Books the time since the last call on what was done then, and notes what is done from `now`.
    pub fn spend(&mut self, now: Arrival, on: Pastime) {
        if let Some((since, what)) = self.last {
            let seconds = (now - since).seconds().max(0.0);
            let split = &mut self.split;
            *match what {
                Pastime::Think => &mut split.think_s,
                Pastime::Scan => &mut split.scan_s,
                Pastime::Drive => &mut split.drive_s,
                Pastime::Turn => &mut split.turn_s,
                Pastime::Recover => &mut split.recover_s,
            } += seconds;
        }
        self.last = Some((now, on));
    }

    /// Books a finished sweep.
    pub fn sweep(&mut self, scan: &Scan) {
        self.sweeps.push(SweepEntry {
            profile: scan.profile.clone(),
            rows: scan.filed,
            gaps: scan.gaps,
            seconds: scan.seconds(),
            budget: scan.budget,
            tilt_sigma_rad: scan.errors.tilt_row_rad,
            driven_m: scan.driven_m,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_scans_that_left_a_direction_open_are_kept() {
        let mut fixes = Fixes::default();
        let open = WeakDirection { direction: nalgebra::Vector6::x(), sigma_m: f64::INFINITY };
        for keyframe in 0..20 {
            let weak_directions = if keyframe % 2 == 0 { vec![open] } else { Vec::new() };
            let hypotheses = if keyframe == 7 { 3 } else { 1 };
            fixes.book(&UpdateReport {
                keyframe,
                weak_directions,
                hypotheses,
                ..UpdateReport::default()
            });
        }
        // The first has nothing to be compared with, and all is open.
        assert_eq!((fixes.scans, fixes.weak), (19, 9));
        let scans: Vec<usize> = fixes.last_weak.iter().map(|weak| weak.scan).collect();
        assert_eq!(scans, [10, 12, 14, 16, 18]);
        assert_eq!((fixes.hypotheses, fixes.most_hypotheses), (1, 3));
    }

    #[test]
    fn all_time_is_booked_once() {
        let mut ledger = Ledger::default();
        let at = Arrival::from_seconds;
        ledger.spend(at(0.0), Pastime::Think);
        ledger.spend(at(2.0), Pastime::Scan);
        ledger.spend(at(5.0), Pastime::Drive);
        ledger.spend(at(6.0), Pastime::Drive);
        ledger.spend(at(6.5), Pastime::Think);
        let split = ledger.split;
        assert_eq!((split.think_s, split.scan_s, split.drive_s), (2.0, 3.0, 1.5));
    }
}
