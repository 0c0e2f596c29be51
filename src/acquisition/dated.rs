//! Lines taken in motion, dated: each becomes a row under the tilt, and from the place, at which its
//! rays were cast.

use super::control::HeadControl;
use super::cyclic::LiveTriples;
use super::flow::FlowDrive;
use super::profile::QuarterDegrees;
use super::scan::FiledRow;
use super::way::Way;
use crate::robot::HeadPose;
use crate::scan::LaserLine;
use crate::time::{Span, Stamp};
use serde::{Deserialize, Serialize};

/// A line, and what was demanded when it came.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Taken {
    pub line: LaserLine,
    pub demanded: QuarterDegrees,
    /// Whether it came after a line that was stamped later.
    pub overtaken: bool,
}

/// A row nearer than this share of the spacing to the row before tells nothing new.
const CLOSEST: f64 = 0.4;
/// Rows farther apart than this are thin for fitting surfaces: lines between them that come for
/// nothing are kept.
const DENSE_RAD: f64 = 0.0175;
/// A law found to a few percent predicts a move to a few percent.
const LAW_ERROR: f64 = 0.03;
/// The share by which the law's speed is changed to see what an error of it does.
const SPEED_STEP: f64 = 1e-3;
/// A reading as near as this to a line's casting supports the line's tilt.
const SUPPORT: Span = Span::from_millis(400);
/// What a reading that supports a tilt leaves of its uncertainty, in radians.
const READING_SIGMA_RAD: f64 = 1e-4;

/// A row, and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DatedRow {
    pub row: FiledRow,
    /// Whether a reading supports its tilt.
    pub supported: bool,
}

/// The rows that `taken` make along `way`, under the tilts that all readings, the later ones included,
/// give them. With `driving` each is displaced as the body moved between its casting and the newest
/// pose known, and lines from before the body's first pose are left out.
pub(super) fn dated_rows(
    taken: &[Taken],
    way: &Way,
    pan_rad: f64,
    driving: bool,
    control: &HeadControl,
) -> Vec<DatedRow> {
    let cycle = match way.drive {
        FlowDrive::Rate { cycle_s, .. } | FlowDrive::Ramp { cycle_s, .. } => {
            Span::from_seconds(cycle_s)
        }
        FlowDrive::SetPoints => Span::ZERO,
    };
    let mut rows: Vec<DatedRow> = Vec::new();
    let mut kept: Option<f64> = None;
    let mut due = Stamp(i64::MIN);
    let mut source = LiveTriples::new(taken, driving, control);
    // A speed that is not quite the law's adds up on a long way, until the tilt comes near its set-point.
    let faster = control.tilt.law().map(|law| {
        let mut faster = control.tilt.clone();
        faster.set_law(law.changed(SPEED_STEP, 0.0));
        faster
    });
    while let Some((taken, triple)) = source.next_from(due) {
        let cast = triple.stamp;
        let Some(estimate) = control.tilt.estimate(cast) else { continue };
        let closest = match way.drive {
            FlowDrive::SetPoints => CLOSEST * way.spacing_at(estimate.angle_rad).min(DENSE_RAD),
            FlowDrive::Rate { .. } | FlowDrive::Ramp { .. } => 0.0,
        };
        let nothing_new = kept.is_some_and(|tilt| (estimate.angle_rad - tilt).abs() < closest);
        if nothing_new {
            continue;
        }
        // Counted from the first row, so that waiting for lines does not stretch the cycle.
        due = if kept.is_none() { cast } else { due } + cycle;
        kept = Some(estimate.angle_rad);
        let supported = estimate.support.is_some_and(|span| span <= SUPPORT);
        let still = if supported {
            READING_SIGMA_RAD.hypot(estimate.miss_rad)
        } else {
            let moved = control
                .tilt
                .estimate(cast - control.rhythm.interval())
                .map_or(0.0, |before| before.angle_rad - estimate.angle_rad);
            let farther = faster
                .as_ref()
                .and_then(|faster| faster.estimate(cast))
                .map_or(0.0, |e| (e.angle_rad - estimate.angle_rad) / SPEED_STEP);
            let law = (LAW_ERROR * moved).hypot(control.timing.speed_sigma * farther);
            control.timing.model_sigma_rad.hypot(law)
        };
        // Commands obeyed later than usual: without readings the law tells the tilt too far on.
        let late = if supported { Span::ZERO } else { control.trips().excess_at(cast) };
        let moving = estimate.rate_rad_s * control.timing.sigma.seconds().hypot(late.seconds());
        let row = FiledRow {
            demanded: taken.demanded,
            pose: HeadPose { pan_rad, tilt_rad: estimate.angle_rad },
            tilt_sigma_rad: still.hypot(moving),
            reference_from_robot: triple.frame_from_robot,
            line: Some(triple.line),
        };
        rows.push(DatedRow { row, supported });
    }
    rows
}
