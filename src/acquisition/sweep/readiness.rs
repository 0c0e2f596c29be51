//! Whether the tilt was at rest where it was demanded when a line was cast.

use super::{STAMP_ROUNDING, Waiting};
use crate::acquisition::config::AcquisitionConfig;
use crate::acquisition::control::HeadControl;
use crate::acquisition::track::Verdict;
use crate::time::{Span, Stamp};

/// Readings that show a joint of unknown law at rest: so many, over so long a time. A spring whose
/// half swing lasts as long as the time between two readings is read on its way through its target
/// each time; by the fifth its swing has died away, or got out of step. Three were met by one spring
/// of 2500, of 26 to 32 rad/s and little damped, five by one of 300 000.
const RESTING_READINGS: (usize, Span) = (5, Span::from_millis(350));

/// Whether a line may be filed.
pub(super) enum Readiness {
    /// The tilt was not yet there when the rays were cast, or not provably.
    NotYet,
    /// By computation it was there, and a reading says so too.
    Verified,
    /// By computation it was there; no reading of that time exists.
    Computed,
    /// By computation it was there, but a reading shows it at this angle.
    Elsewhere(f64),
}

pub(super) fn readiness(
    waiting: &Waiting,
    target_rad: f64,
    tolerance_rad: f64,
    cast: Stamp,
    control: &HeadControl,
    config: &AcquisitionConfig,
) -> Readiness {
    let track = &control.tilt;
    let Some(settled) = waiting.settled else {
        let since = (waiting.in_force, cast);
        let rested = track.rests(target_rad, tolerance_rad, since, RESTING_READINGS);
        if rested {
            return Readiness::Verified;
        }
        let patience = Span::from_seconds(config.unknown_settle_s);
        if cast < waiting.in_force + patience {
            return Readiness::NotYet;
        }
        return match track.verdict(target_rad, tolerance_rad, waiting.in_force, cast) {
            Verdict::Unverified => Readiness::Computed,
            Verdict::Contradicted { angle_rad } => Readiness::Elsewhere(angle_rad),
            // It reads as there, but has not yet been seen to rest.
            Verdict::Confirmed => Readiness::NotYet,
        };
    };
    if cast < settled {
        return Readiness::NotYet;
    }
    match track.verdict(target_rad, tolerance_rad, settled, cast + STAMP_ROUNDING) {
        Verdict::Confirmed => Readiness::Verified,
        Verdict::Unverified => Readiness::Computed,
        Verdict::Contradicted { angle_rad } => Readiness::Elsewhere(angle_rad),
    }
}
