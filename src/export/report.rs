//! `report.json`: what a run came to.

use crate::mapping::WeakDirection;
use crate::mission::Fixes;
use serde::{Deserialize, Serialize};

/// Everything a run's report holds. A field that needs ground truth is `None` without it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Scenario name, or the level's name of a foreign server.
    pub scenario: String,
    /// Seed of the mission.
    pub seed: u64,
    /// How the mission ended: `time`, `explored`, `fallen`, `operator`, `battery`, `link lost` …
    pub outcome: String,
    /// Session time from connection to end, in seconds.
    pub mission_time_s: f64,
    /// Wall time of the run, in seconds.
    pub wall_time_s: f64,
    /// Where the mission time went.
    pub time_split_s: TimeSplit,
    /// Length of the estimated path, in metres.
    pub distance_m: f64,
    /// Every sweep in order.
    pub sweeps: Vec<SweepReport>,
    /// Those of them that were taken while the robot drove on, together.
    #[serde(default)]
    pub nods: NodTotals,
    /// Surfaces fitted over all sweeps.
    pub surfaces: SurfaceCounts,
    /// Planar landmarks in the final map.
    pub landmarks: usize,
    /// Observations matched to a landmark over the mission.
    pub associations: usize,
    /// How well the scans fixed the robot's place.
    #[serde(default)]
    pub localisation: Localisation,
    /// Floor that the robot can be driven to on the true map, in m².
    pub reachable_m2: Option<f64>,
    /// Part of it that was explored, in m².
    pub explored_m2: Option<f64>,
    /// `explored_m2 / reachable_m2`.
    pub coverage: Option<f64>,
    /// Explored area per minute of mission time.
    pub m2_per_minute: Option<f64>,
    /// Errors of the estimated pose against the truth.
    pub pose_error: Option<PoseError>,
    /// Falls, by the simulator's count.
    pub falls: Option<usize>,
    /// Collisions, by the simulator's count.
    pub collisions: Option<usize>,
    /// Speed of the hardest collision in m/s.
    pub hardest_collision_mps: Option<f64>,
    /// Times the robot found itself stuck.
    pub stuck: usize,
    /// Victims reported against those there are.
    pub victims: VictimCounts,
    /// Portals driven through.
    pub portals: Option<PortalCounts>,
    /// The 2019 rules' score with α = 1 and β = 0.5.
    pub score_2019: Option<f64>,
    /// Phases of the mission.
    pub phases: Vec<PhaseReport>,
    /// Share of the mission time in which the robot decided: no operator held the drive lease, and the
    /// mode was not teleoperation.
    pub autonomy_fraction: f64,
    /// Acts of an operator.
    pub operator_acts: usize,
    /// Frontiers that were left, and why.
    pub frontiers_left: Vec<FrontierLeft>,
    /// What came over the link.
    #[serde(default)]
    pub link: LinkCounts,
    /// What the agent was warned of: missing answers, clipped sweeps, blind ground, damaged lines.
    pub warnings: Vec<String>,
}

impl Report {
    /// The `scenario` of a folder that `usar map` wrote: scans are of no scenario that it knows.
    pub const MAPPED: &str = "usar map";

    /// Whether it stands for what `usar map` wrote.
    pub fn is_of_map(&self) -> bool {
        self.scenario == Self::MAPPED
    }
}

/// How well the scans fixed the robot's place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Localisation {
    /// Scans that met a map.
    pub scans: usize,
    /// Those of them that left a direction open: along a corridor, or on a floor alone.
    pub weak_scans: usize,
    /// The last few of these.
    pub last_weak: Vec<WeakScan>,
    /// Explanations of all that was seen that are alive at the end; 1 where nothing is ambiguous.
    pub hypotheses: usize,
    /// Most that were alive at once.
    pub most_hypotheses: usize,
    /// Loops closed.
    pub loops_closed: usize,
    /// Times that another explanation became the best.
    pub explanations_changed: usize,
}

/// A scan that left a direction open.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WeakScan {
    /// Its number among those in the map, from 0: its place in `keyframes.json`.
    pub scan: usize,
    /// The directions, weakest first.
    pub open: Vec<OpenDirection>,
}

/// A direction that a scan left open.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OpenDirection {
    /// The axis that it has most of: `forward`, `left`, `up`, `roll`, `pitch`, `heading`.
    pub axis: String,
    /// Unit direction in the robot frame: forward, left and up in metres, then rotations about these axes
    /// in units of 1/3 rad.
    pub direction: [f64; 6],
    /// Standard deviation in metres that the scan alone leaves along it; null where it says nothing.
    pub sigma_m: Option<f64>,
}

impl From<&Fixes> for Localisation {
    fn from(fixes: &Fixes) -> Self {
        let open = |weak: &WeakDirection| OpenDirection {
            axis: weak.word().to_owned(),
            direction: weak.direction.into(),
            sigma_m: weak.sigma_m.is_finite().then_some(weak.sigma_m),
        };
        let weak = fixes.last_weak.iter().map(|weak| WeakScan {
            scan: weak.scan,
            open: weak.directions.iter().map(open).collect(),
        });
        Self {
            scans: fixes.scans,
            weak_scans: fixes.weak,
            last_weak: weak.collect(),
            hypotheses: fixes.hypotheses,
            most_hypotheses: fixes.most_hypotheses,
            loops_closed: fixes.loops_closed,
            explanations_changed: fixes.explanations_changed,
        }
    }
}

/// What came over the link, in lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkCounts {
    /// Lines read.
    pub lines: usize,
    /// Lines of a type that is not known.
    pub unknown: usize,
    /// Lines with damage; what was whole in them was used.
    pub damaged: usize,
}

/// Where the mission time went, in seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TimeSplit {
    /// Sweeping.
    pub scan: f64,
    /// Driving.
    pub drive: f64,
    /// Turning in place.
    pub turn: f64,
    /// Standing while something is decided or waited for.
    pub think: f64,
    /// Getting free.
    pub recover: f64,
}

/// One sweep.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SweepReport {
    /// Name of the profile.
    pub profile: String,
    /// Rows filed.
    pub rows: usize,
    /// Seconds from the first tilt command to the last filed line.
    pub seconds: f64,
    /// Where those went.
    #[serde(default)]
    pub budget_s: SweepBudget,
    /// Standard deviation of the tilts of single rows, in degrees.
    #[serde(default)]
    pub tilt_sigma_deg: f64,
    /// Metres driven meanwhile; `None` for a sweep taken standing.
    #[serde(default)]
    pub driven_m: Option<f64>,
}

/// Sweeps taken while the robot drove on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NodTotals {
    /// How many.
    pub count: usize,
    /// Time they took, in seconds; the robot drove meanwhile.
    pub seconds: f64,
    /// Way driven meanwhile, in metres.
    pub driven_m: f64,
    /// Way per nod, in metres; `None` without a nod.
    pub metres_per_nod: Option<f64>,
    /// Time per metre of that way, in seconds; `None` if none was driven.
    pub seconds_per_metre: Option<f64>,
}

impl NodTotals {
    /// Those among `sweeps`.
    pub fn of(sweeps: &[SweepReport]) -> Self {
        let nods = || sweeps.iter().filter_map(|sweep| Some((sweep.seconds, sweep.driven_m?)));
        let count = nods().count();
        // Not `sum`, which makes -0 of nothing.
        let seconds = nods().fold(0.0, |sum, nod| sum + nod.0);
        let driven_m = nods().fold(0.0, |sum, nod| sum + nod.1);
        Self {
            count,
            seconds,
            driven_m,
            metres_per_nod: (count > 0).then(|| driven_m / count as f64),
            seconds_per_metre: (driven_m > 0.0).then(|| seconds / driven_m),
        }
    }
}

/// Where the seconds of a sweep went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SweepBudget {
    /// The tilt moving at speed.
    pub moving: f64,
    /// The servo creeping into its target.
    pub servo: f64,
    /// Waiting for the laser.
    pub laser: f64,
    /// Nothing useful.
    pub idle: f64,
}

/// Fitted surfaces by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SurfaceCounts {
    /// Planar patches.
    pub planes: usize,
    /// Spheres.
    pub spheres: usize,
    /// Cylinders.
    pub cylinders: usize,
}

/// Errors of the estimated pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseError {
    /// Root mean square of the position error over the trajectory, start poses laid on one another.
    pub ate_rmse_m: f64,
    /// Position error at the end.
    pub final_m: f64,
    /// Angle error at the end, in degrees.
    pub final_deg: f64,
    /// Final position error over the distance driven, in percent.
    pub drift_percent: f64,
    /// Final position error of odometry alone.
    pub odometry_final_m: Option<f64>,
    /// Final position error of the INS alone.
    pub ins_final_m: Option<f64>,
}

/// Victims.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VictimCounts {
    /// Victims in the world.
    #[serde(rename = "true")]
    pub truth: Option<usize>,
    /// Reported within 1.5 m of a true one.
    pub found: Option<usize>,
    /// Reported where there is none.
    pub wrong: Option<usize>,
    /// Not reported.
    pub missed: Option<usize>,
    /// Contacts of the robot with a victim.
    pub contacts: Option<usize>,
}

/// Portals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortalCounts {
    /// Portals of the map.
    pub total: usize,
    /// Those the robot drove through.
    pub visited: usize,
}

/// One phase of the mission.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhaseReport {
    /// Name of the phase.
    pub name: String,
    /// Its beginning in seconds of mission time.
    pub from_s: f64,
    /// Its end.
    pub to_s: f64,
}

/// A frontier that was not visited.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrontierLeft {
    /// Position in the map frame, in metres.
    pub x: f64,
    /// Position in the map frame, in metres.
    pub y: f64,
    /// Why it was left.
    pub reason: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nods_are_the_sweeps_that_were_driven_through() {
        let sweep = |seconds, driven_m| SweepReport { seconds, driven_m, ..Default::default() };
        let totals =
            NodTotals::of(&[sweep(9.0, None), sweep(8.0, Some(1.0)), sweep(4.0, Some(0.5))]);
        assert_eq!((totals.count, totals.seconds, totals.driven_m), (2, 12.0, 1.5));
        assert_eq!((totals.metres_per_nod, totals.seconds_per_metre), (Some(0.75), Some(8.0)));
        let none = NodTotals::of(&[sweep(9.0, None)]);
        assert_eq!((none.count, none.metres_per_nod, none.seconds_per_metre), (0, None, None));
        assert!(none.seconds.is_sign_positive() && none.driven_m.is_sign_positive());
    }
}
