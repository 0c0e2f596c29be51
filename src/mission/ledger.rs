//! Counts and times of a mission, for its report.

use crate::acquisition::{Scan, TimeBudget};
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
