//! The way through a profile in one motion: where it leads, how far apart its rows lie, and where the
//! set-point belongs.

use super::config::AcquisitionConfig;
use super::control::HeadControl;
use super::flow::FlowDrive;
use super::profile::{Profile, QuarterDegrees};
use crate::scan::LaserLine;
use crate::time::{Arrival, Span};
use serde::{Deserialize, Serialize};

/// A profile and how the tilt is driven through it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Way {
    /// The rows, in the order in which they are passed; not empty where one is asked about them.
    pub profile: Profile,
    /// How the tilt is driven.
    pub drive: FlowDrive,
}

/// A row may be this share of the spacing off, where that is more than the configured error: rows lie
/// far apart where the ground is near, and there an angle moves a point by little.
const TOLERATED_SHARE: f64 = 0.1;
/// A set-point farther ahead than this makes no joint faster, and takes longer to call back.
const LONGEST_LEAD_RAD: f64 = 0.1;

/// How far the tilt may turn from one line to the next for all that is known of the times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StepLimit {
    /// Tilt error that the uncertainty of the times may cause, in radians.
    pub tolerated_rad: f64,
    /// The same as a share of the spacing of the rows, where that is more.
    pub tolerated_share: f64,
    /// Lines between which the tilt turns once the uncertainty of a line's time.
    pub lines_per_sigma: f64,
}

impl StepLimit {
    pub(super) fn of(control: &HeadControl, config: &AcquisitionConfig) -> Self {
        let sigma_s = control.timing.sigma.seconds().max(1e-4);
        // Without readings a fast tilt is dead reckoning: an error of its speed adds up over the sweep.
        let reads = control.tilt.last_reading().is_some();
        Self {
            tolerated_rad: config.flow_sigma_deg.to_radians(),
            tolerated_share: if reads { TOLERATED_SHARE } else { 0.0 },
            lines_per_sigma: control.rhythm.interval().seconds() / sigma_s,
        }
    }

    /// The step for rows `spacing_rad` apart.
    pub(super) fn step(&self, spacing_rad: f64) -> f64 {
        let tolerated = self.tolerated_rad.max(self.tolerated_share * spacing_rad);
        spacing_rad.min((tolerated * self.lines_per_sigma).max(super::QUARTER_DEGREE_RAD))
    }
}

impl Way {
    pub(super) fn direction(&self) -> f64 {
        let (first, last) = self.ends();
        if last < first { -1.0 } else { 1.0 }
    }

    pub(super) fn ends(&self) -> (f64, f64) {
        let tilts = &self.profile.tilts;
        (tilts[0].radians(), tilts[tilts.len() - 1].radians())
    }

    /// Distance between rows around a tilt, in radians.
    pub(super) fn spacing_at(&self, tilt_rad: f64) -> f64 {
        let tilts = &self.profile.tilts;
        let direction = self.direction();
        let ahead = tilts.partition_point(|t| (t.radians() - tilt_rad) * direction <= 0.0);
        let at = ahead.clamp(1, tilts.len().max(2) - 1);
        match (tilts.get(at - 1), tilts.get(at)) {
            (Some(a), Some(b)) => (b.radians() - a.radians()).abs(),
            _ => super::QUARTER_DEGREE_RAD,
        }
    }

    /// The spacing that the times are known well enough for.
    pub(super) fn step_at(
        &self,
        tilt_rad: f64,
        control: &HeadControl,
        config: &AcquisitionConfig,
    ) -> f64 {
        StepLimit::of(control, config).step(self.spacing_at(tilt_rad))
    }

    /// Sets the point ahead so that the tilt comes on by one row between the next two castings that a
    /// command sent now can still influence.
    ///
    /// `None` where the point does not move on from `demanded`.
    pub(super) fn next_set_point(
        &self,
        line: &LaserLine,
        demanded: QuarterDegrees,
        control: &HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> Option<QuarterDegrees> {
        let sent = control.clock().earliest(now)?;
        let in_force = sent + control.command_delay();
        let interval = control.rhythm.interval();
        let mut cast = control.cast_time(line) + interval;
        let half = Span::from_seconds(0.5 * interval.seconds());
        // A line lost or late leaves `cast` in the past; the bound keeps a broken clock from spinning.
        for _ in 0..64 {
            if cast >= in_force + half {
                break;
            }
            cast = cast + interval;
        }
        let before = control.tilt.estimate(cast - interval)?;
        let start = control.tilt.estimate(in_force)?;
        let direction = self.direction();
        let step = self.step_at(before.angle_rad, control, config);
        let wanted = before.angle_rad + direction * step;
        let set_point = match control.tilt.law() {
            Some(law) => {
                let state =
                    super::ServoState { angle_rad: start.angle_rad, rate_rad_s: start.rate_rad_s };
                law.set_point_for(state, wanted, (cast - in_force).seconds())
            }
            None => wanted,
        };
        // Beyond the last row no more than one proportional gap, which keeps the speed up to the end.
        let (_, last) = self.ends();
        let beyond = last + direction * super::HINGE_GAP_RAD;
        let far = start.angle_rad + direction * LONGEST_LEAD_RAD;
        let nearest = |a: f64, b: f64| if direction > 0.0 { a.min(b) } else { a.max(b) };
        let reachable = control.head().tilt().map_or(0.0, |axis| axis.clamp(nearest(beyond, far)));
        let limited = if set_point.is_finite() { nearest(set_point, reachable) } else { reachable };
        let next = QuarterDegrees::nearest(limited);
        (f64::from(next.0 - demanded.0) * direction > 0.0).then_some(next)
    }
}
