//! The scans of a session as they went into its map, for other ways of mapping.

use super::say;
use super::session::{self, Session};
use crate::driver::replay::Replay;
use crate::export::score;
use crate::export::tum::{self, TimedPose};
use crate::mission::Agent;
use crate::record::MAGIC;
use crate::scan::PointGrid;
use crate::time::Stamp;
use anyhow::{Context, Result, bail};
use nalgebra::Isometry3;
use std::io::Read as _;
use std::path::Path;

/// How long after the end of the truth a scan may be, in seconds.
const MOST_BEYOND_S: f64 = 1.0;

/// The scans of a session with the poses of the sensor by dead reckoning alone.
#[derive(Default)]
pub struct Series {
    /// The scans as they came, at least one.
    pub scans: Vec<PointGrid>,
    /// Where dead reckoning had the sensor at each.
    pub way: Vec<TimedPose>,
    /// Where the sensor truly was, if the run's folder says where the robot was: for scoring only.
    pub truth: Option<Vec<TimedPose>>,
    /// Whether the session is not whole, or was replayed otherwise than it went.
    pub loss: bool,
    robot_from_scan: Vec<Isometry3<f64>>,
    /// The robot by dead reckoning at the last scan, and where the map put it after that.
    last: Option<(Isometry3<f64>, Isometry3<f64>)>,
    /// Where the agent had the robot a step ago.
    before: Option<Isometry3<f64>>,
}

/// Whether a path is a run folder or a recording of ours, and no scan.
pub fn is_session(path: &Path) -> bool {
    let mut start = vec![0; MAGIC.len()];
    path.is_dir()
        || std::fs::File::open(path)
            .is_ok_and(|mut file| file.read_exact(&mut start).is_ok() && start == MAGIC)
}

impl Series {
    /// The scans of a run folder or session, which is replayed for that.
    ///
    /// # Errors
    ///
    /// A session that cannot be read or has no scan, a truth that cannot be read.
    pub fn read(run: &Path) -> Result<Self> {
        let mut series = Self::default();
        series.loss = watched(run, |agent| series.watch(agent))?.loss;
        if series.scans.is_empty() {
            bail!("no scan in {}", run.display());
        }
        series.truth = series.true_way(run)?;
        Ok(series)
    }

    fn watch(&mut self, agent: &Agent) {
        let Some(running) = agent.running() else { return };
        let belief = running.belief();
        let now = belief.world_from_robot();
        if let Some((keyframe, image)) = belief.last_sweep()
            && keyframe >= self.scans.len()
        {
            // The map corrects the robot in the step that takes the scan in.
            let arrived = self.before.unwrap_or(now);
            let reckoned = match &self.last {
                Some((reckoned, corrected)) => reckoned * corrected.inverse() * arrived,
                None => arrived,
            };
            self.last = Some((reckoned, now));
            let stamp = belief.keyframe_stamps().last().flatten();
            self.way.push(TimedPose {
                time_s: stamp.map_or(self.scans.len() as f64, Stamp::seconds),
                pose: reckoned * image.robot_from_scan,
            });
            self.robot_from_scan.push(image.robot_from_scan);
            self.scans.push(image.point_grid(0..image.columns()));
        }
        self.before = Some(now);
    }

    fn true_way(&self, run: &Path) -> Result<Option<Vec<TimedPose>>> {
        let file = run.join("truth.tum");
        if !file.is_file() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&file)
            .with_context(|| format!("cannot read {}", file.display()))?;
        let truth = tum::parse(&text).with_context(|| format!("cannot read {}", file.display()))?;
        let ends_s = truth.last().map_or(f64::NEG_INFINITY, |timed| timed.time_s);
        if self.way.last().is_some_and(|last| last.time_s > ends_s + MOST_BEYOND_S) {
            say::warn(format_args!(
                "{} ends at {ends_s:.1} s, before the last scan: not scored",
                file.display()
            ));
            return Ok(None);
        }
        let sensors = self.way.iter().zip(&self.robot_from_scan);
        Ok(sensors
            .map(|(timed, robot_from_scan)| {
                let robot = score::at(&truth, timed.time_s)?;
                Some(TimedPose { time_s: timed.time_s, pose: robot * robot_from_scan })
            })
            .collect())
    }
}

/// A session at its end.
pub struct Replayed {
    /// The agent then.
    pub agent: Agent,
    /// The session's name.
    pub name: String,
    /// Whether the session is not whole, or was replayed otherwise than it went.
    pub loss: bool,
}

/// Replays a session, calling `watch` after each step.
///
/// # Errors
///
/// A session that cannot be read or replayed.
pub fn watched(run: &Path, mut watch: impl FnMut(&Agent)) -> Result<Replayed> {
    let Session { recording, agent, name, own } = session::open(run, None, false, &[])?;
    if let Some(loss) = &recording.loss {
        say::warn(format_args!("the recording is not whole: {loss}"));
    }
    let mut replay = Replay::new(agent, &recording);
    while replay.step().context("the recording holds an unreadable operator event")? {
        watch(replay.agent());
    }
    let (agent, _, difference) = replay.finish();
    let mut loss = recording.loss.is_some();
    // Text that others printed holds no actions of ours.
    if let Some(difference) = difference.filter(|_| own) {
        say::warn(format_args!(
            "this program decides otherwise than the one that recorded: {difference}; sweeps from there on may be lost"
        ));
        loss = true;
    }
    Ok(Replayed { agent, name, loss })
}
