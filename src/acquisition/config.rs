use super::guard::GuardConfig;
use super::profile::FanConfig;
use crate::time::Span;
use serde::{Deserialize, Serialize};

/// How scans are taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AcquisitionConfig {
    /// How far the tilt may be from the demanded angle when a line of the paper's profile is taken,
    /// in degrees, in (0, 1].
    pub tolerance_deg: f64,
    /// The same for the coarse profiles of exploration, in degrees, in (0, 1].
    pub coarse_tolerance_deg: f64,
    /// Bound on the time from sending a command until it is in force, less the fastest way of a
    /// message back: network both ways and one server frame, in seconds, in [0, 5]. A server that
    /// answers questions later than that is given as long as its answers take.
    pub command_latency_s: f64,
    /// Time given to a joint whose law is unknown and that sends no readings, in seconds, above 0.
    pub unknown_settle_s: f64,
    /// Time beyond the expected one after which a step is repeated, and then given up, in seconds,
    /// above 0.
    pub row_timeout_s: f64,
    /// Rows lost one after the other that end a sweep, at least 1.
    pub give_up_rows: u32,
    /// Tilt error that overlapped motion may cause, in degrees, in (0, 1]: the tilt is slowed to where
    /// the uncertainty of the times allows no more.
    pub flow_sigma_deg: f64,
    /// The exploration fan.
    pub fan: FanConfig,
    /// The guard line between sweeps.
    pub guard: GuardConfig,
}

impl Default for AcquisitionConfig {
    fn default() -> Self {
        Self {
            tolerance_deg: 0.0125,
            coarse_tolerance_deg: 0.05,
            command_latency_s: 0.06,
            unknown_settle_s: 1.5,
            row_timeout_s: 1.5,
            give_up_rows: 3,
            flow_sigma_deg: 0.07,
            fan: FanConfig::default(),
            guard: GuardConfig::default(),
        }
    }
}

impl AcquisitionConfig {
    pub(super) fn command_latency(&self) -> Span {
        Span::from_seconds(self.command_latency_s)
    }

    pub(super) fn row_timeout(&self) -> Span {
        Span::from_seconds(self.row_timeout_s)
    }

    /// Every value out of its range, in words that name key, value and range; empty if all is well.
    pub fn problems(&self) -> Vec<String> {
        let mut found = Vec::new();
        let mut check = |holds: bool, key: &str, value: f64, range: &str| {
            if !holds {
                found.push(format!("{key} = {value}: must be {range}"));
            }
        };
        let in_degrees = |v: f64| v > 0.0 && v <= 1.0;
        let positive = |v: f64| v > 0.0 && v.is_finite();
        check(in_degrees(self.tolerance_deg), "tolerance_deg", self.tolerance_deg, "in (0, 1]");
        check(
            in_degrees(self.coarse_tolerance_deg),
            "coarse_tolerance_deg",
            self.coarse_tolerance_deg,
            "in (0, 1]",
        );
        check(in_degrees(self.flow_sigma_deg), "flow_sigma_deg", self.flow_sigma_deg, "in (0, 1]");
        check(
            (0.0..=5.0).contains(&self.command_latency_s),
            "command_latency_s",
            self.command_latency_s,
            "in [0, 5]",
        );
        check(
            positive(self.unknown_settle_s),
            "unknown_settle_s",
            self.unknown_settle_s,
            "above 0",
        );
        check(positive(self.row_timeout_s), "row_timeout_s", self.row_timeout_s, "above 0");
        check(self.give_up_rows >= 1, "give_up_rows", f64::from(self.give_up_rows), "at least 1");
        check(
            positive(self.fan.ring_spacing_m),
            "fan.ring_spacing_m",
            self.fan.ring_spacing_m,
            "above 0",
        );
        check(
            self.fan.reach_m > self.fan.nearest_m && self.fan.nearest_m >= 0.0,
            "fan.reach_m",
            self.fan.reach_m,
            "above fan.nearest_m, which must not be negative",
        );
        found.extend(self.guard.problems());
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_within_their_ranges() {
        assert_eq!(AcquisitionConfig::default().problems(), Vec::<String>::new());
    }

    #[test]
    fn all_values_out_of_range_are_named_at_once() {
        let config = AcquisitionConfig {
            tolerance_deg: 0.0,
            give_up_rows: 0,
            row_timeout_s: f64::NAN,
            ..AcquisitionConfig::default()
        };
        let problems = config.problems();
        assert_eq!(problems.len(), 3, "{problems:?}");
        assert_eq!(problems[0], "tolerance_deg = 0: must be in (0, 1]");
    }
}
