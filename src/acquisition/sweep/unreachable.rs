//! Rows that the tilt does not get to.

use super::Sweep;
use crate::acquisition::profile::QuarterDegrees;

impl Sweep {
    /// The tilt rests at `stuck_rad` although `row` was demanded: rows on the far side of it are out
    /// of reach, be it that the link's limits are narrower than told or that it is stuck. The rows
    /// on the near side are still tried; if the next of them fails too, nothing is left.
    pub(super) fn skip_unreachable(&mut self, row: usize, stuck_rad: f64) {
        let demanded = self.profile.tilts[row].radians();
        let beyond = |tilt: &QuarterDegrees| {
            (tilt.radians() - stuck_rad) * (demanded - stuck_rad) > 0.0
                && (tilt.radians() - stuck_rad).abs() > self.tolerance_rad
        };
        let kept: Vec<_> =
            self.profile.tilts[row + 1..].iter().copied().filter(|tilt| !beyond(tilt)).collect();
        let lost = self.profile.len() - (row + 1) - kept.len() + 1;
        self.profile.tilts.truncate(row + 1);
        self.profile.tilts.extend(kept);
        self.remarks.push(format!(
            "the tilt rests at {:.2}° though {} was demanded: {lost} rows beyond it are lost",
            stuck_rad.to_degrees(),
            self.profile.tilts[row],
        ));
    }
}
