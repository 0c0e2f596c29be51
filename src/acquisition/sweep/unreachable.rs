//! Rows that the tilt does not get to.

use super::{Step, Sweep};
use crate::acquisition::HeadAction;
use crate::acquisition::control::HeadControl;
use crate::acquisition::profile::QuarterDegrees;
use crate::acquisition::stillness::Unmoved;
use crate::time::Arrival;

impl Sweep {
    /// The laser shows that the tilt stopped turning some rows ago: they were filed under angles that it
    /// never had. Where it is by now has to be found out before any other row is taken.
    pub(super) fn on_unmoved(
        &mut self,
        unmoved: &Unmoved,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let Step::Waiting(waiting) = &self.step else { return };
        let row = waiting.row;
        self.file(row, None);
        let mut left_out = self.profile.len() - row;
        // The row at which the joint slowed down into its limit is no better than those beyond.
        for filed in &mut self.rows {
            let taken = filed.line.as_ref().map(|line| control.cast_time(line));
            if taken.is_some_and(|cast| cast >= unmoved.slows_from) {
                filed.line = None;
                left_out += 1;
            }
        }
        // A row that was taken at rest tells better than the law where the tilt got to.
        let reached = self.rows.iter().rev().find(|filed| filed.line.is_some());
        let reached_rad = reached.map_or(unmoved.rest_rad, |filed| filed.demanded.radians());
        let ran_ahead = (unmoved.rest_rad - reached_rad) * unmoved.towards > 0.0;
        let rest_rad = if ran_ahead { reached_rad } else { unmoved.rest_rad };
        self.remarks.push(unmoved.remark(left_out));
        self.finish(control, now, actions);
        control.rests_at(rest_rad, unmoved.towards);
    }

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
