use super::belief::BeliefConfig;
use super::opening::OpeningConfig;
use super::operator::Mode;
use crate::acquisition::AcquisitionConfig;
use crate::exploration::ExploreConfig;
use crate::navigation::{FollowConfig, GuardConfig, PlanConfig, RecoveryConfig, StuckConfig};
use crate::victims::VictimConfig;
use serde::{Deserialize, Serialize};

/// Everything an agent runs with: `--config` files and `[agent]` of a scenario override parts of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AgentConfig {
    /// The mission as a whole.
    pub mission: MissionConfig,
    /// Opening a session.
    pub opening: OpeningConfig,
    /// Taking scans.
    pub acquisition: AcquisitionConfig,
    /// Pose, map and terrain.
    pub belief: BeliefConfig,
    /// Planning paths.
    pub plan: PlanConfig,
    /// Following them.
    pub follow: FollowConfig,
    /// Watching the line ahead.
    pub guard: GuardConfig,
    /// Choosing where to look.
    pub explore: ExploreConfig,
    /// Noticing trouble.
    pub stuck: StuckConfig,
    /// Getting out of it.
    pub recovery: RecoveryConfig,
    /// Telling victims from false alarms.
    pub victims: VictimConfig,
}

/// The mission as a whole.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MissionConfig {
    /// Class that INIT asks for.
    pub class: String,
    /// Name that INIT gives the robot.
    pub name: String,
    /// Who decides where the robot goes.
    pub mode: Mode,
    /// Estimate and map only: nothing is ever sent. For recordings of others.
    pub observe: bool,
    /// Session time after which the mission ends, in seconds; 0 for none.
    pub time_limit_s: f64,
    /// Whether a small motion at the start shows which way pan and tilt turn.
    pub verify_signs: bool,
    /// Whether a full sweep of 220 rows is taken at the start.
    pub fine_sweep_at_start: bool,
    /// How it is taken.
    pub fine_sweep: FineSweep,
    /// Whether the tilt's motion is identified at the start, and exploration sweeps are then taken
    /// in motion instead of coming to rest at every row.
    pub flowing_sweeps: bool,
    /// Whether sweeps are also taken while the robot drives on slowly, where that shows more per second
    /// than a stop.
    pub nodding: bool,
    /// Which sweeps explore.
    pub looks: LookPolicy,
    /// Standing still before a sweep, in seconds, so that the body has come to rest. [0, 10]
    pub settle_s: f64,
    /// Ground beyond the robot's turning circle that is assumed at the start, in metres. [0, 2]
    pub assumed_margin_m: f64,
    /// Silence of the server after which the wheels are stopped, in seconds. (0, 10]
    pub silence_s: f64,
    /// How long a lost connection is sought before the mission ends, in seconds; 0 ends it at once.
    /// [0, 3600]
    pub reconnect_s: f64,
    /// How often the grid is made anew while driving, in seconds. [0.1, 10]
    pub grid_period_s: f64,
    /// Age of a clear guard line up to which the robot may drive on, in seconds. (0, 5]
    pub guard_age_s: f64,
    /// Longest time for one goal, in seconds; then another is chosen. [5, 600]
    pub goal_timeout_s: f64,
    /// Greatest distance driven between two sweeps, in metres: dead reckoning grows with it. [1, 50]
    pub leg_m: f64,
}

/// How the full sweep at the start is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FineSweep {
    /// As the paper does where the paper's filter maps, or where sweeps in motion are off; in motion
    /// otherwise.
    #[default]
    Auto,
    /// At rest at every quarter of a degree, as the paper does in the simulator.
    Paper,
    /// In motion, every row filed under the tilt that the servo's model gives.
    Model,
    /// At a constant rate, as the paper's real robot does.
    Continuous,
}

/// Which sweep is taken where the robot stops to look. Whichever it is, rows are added to it where a
/// suspected edge or unknown ground in the way asks for finer ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LookPolicy {
    /// The one that shows most per second.
    #[default]
    Auto,
    /// The full sweep of 220 rows, taken as the one at the start.
    Full,
    /// The whole height in rows of 2°.
    Coarse,
    /// The whole ground fan.
    Fan,
}

impl Default for MissionConfig {
    fn default() -> Self {
        Self {
            class: "USARBot.P3AT".into(),
            name: "R1".into(),
            mode: Mode::Auto,
            observe: false,
            time_limit_s: 1200.0,
            verify_signs: true,
            fine_sweep_at_start: true,
            fine_sweep: FineSweep::Auto,
            flowing_sweeps: true,
            nodding: true,
            looks: LookPolicy::Auto,
            settle_s: 0.6,
            assumed_margin_m: 0.1,
            silence_s: 1.5,
            reconnect_s: 60.0,
            grid_period_s: 1.0,
            guard_age_s: 0.65,
            goal_timeout_s: 90.0,
            leg_m: 8.0,
        }
    }
}

impl AgentConfig {
    /// Every value out of its range: dotted key, and what was found and expected.
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        let mut check = |holds: bool, key: &str, value: f64, range: &str| {
            if !holds {
                found.push((key.to_owned(), format!("{value}, expected {range}")));
            }
        };
        let m = &self.mission;
        let finite = |v: f64| v >= 0.0 && v.is_finite();
        check(finite(m.time_limit_s), "mission.time_limit_s", m.time_limit_s, "0 or more");
        check((0.0..=10.0).contains(&m.settle_s), "mission.settle_s", m.settle_s, "0 to 10");
        check(
            (0.0..=2.0).contains(&m.assumed_margin_m),
            "mission.assumed_margin_m",
            m.assumed_margin_m,
            "0 to 2",
        );
        let silence = m.silence_s > 0.0 && m.silence_s <= 10.0;
        check(silence, "mission.silence_s", m.silence_s, "more than 0, at most 10");
        check(
            (0.0..=3600.0).contains(&m.reconnect_s),
            "mission.reconnect_s",
            m.reconnect_s,
            "0 to 3600",
        );
        check(
            (0.1..=10.0).contains(&m.grid_period_s),
            "mission.grid_period_s",
            m.grid_period_s,
            "0.1 to 10",
        );
        let age = m.guard_age_s > 0.0 && m.guard_age_s <= 5.0;
        check(age, "mission.guard_age_s", m.guard_age_s, "more than 0, at most 5");
        check(
            (5.0..=600.0).contains(&m.goal_timeout_s),
            "mission.goal_timeout_s",
            m.goal_timeout_s,
            "5 to 600",
        );
        check((1.0..=50.0).contains(&m.leg_m), "mission.leg_m", m.leg_m, "1 to 50");
        if m.class.trim().is_empty() || m.name.trim().is_empty() {
            found.push(("mission".into(), "class and name must not be empty".into()));
        }
        let words = self.acquisition.problems();
        found.extend(words.into_iter().map(|problem| ("acquisition".to_owned(), problem)));
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_within_their_ranges() {
        assert_eq!(AgentConfig::default().problems(), []);
    }

    #[test]
    fn the_effective_configuration_survives_its_own_text() {
        let config = AgentConfig::default();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<AgentConfig>(&text).unwrap(), config);
    }
}
