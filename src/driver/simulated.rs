//! A whole mission against the simulator in one process: what `usar mission` and `usar demo` run.

use super::host::Host;
use super::lockstep::Lockstep;
use crate::export::coverage::{self, Passability};
use crate::export::report::{PhaseReport, PortalCounts, Report, VictimCounts};
use crate::export::run_folder::{self, Files};
use crate::export::score::{pose_error, score_2019};
use crate::export::tum::{self, TimedPose};
use crate::files::scenario::LoadedScenario;
use crate::mission::{Agent, Running};
use crate::record::{Header, Writer};
use crate::sim::{Phase, Session, Truth, World};
use crate::terrain::RobotShape;
use crate::time::Arrival;
use nalgebra::Point3;
use std::io::Write;

/// Truth is sampled this often for the trajectory.
const SAMPLE_S: f64 = 0.2;

/// A reported victim within this distance of a true one is found (rules of 2019).
const FOUND_WITHIN_M: f64 = 1.5;

/// A mission that is under way.
pub struct SimulatedMission<W: Write> {
    loaded: LoadedScenario,
    lockstep: Lockstep<W>,
    truth: Vec<TimedPose>,
    start: Option<Truth>,
    sampled: f64,
}

/// What a mission came to.
pub struct MissionResult {
    /// The report, complete but for the wall time.
    pub report: Report,
    /// Everything else of the run folder but recording and configuration.
    pub files: Files,
}

/// Why a mission could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum SimulatedError {
    /// Scenario and world do not fit.
    #[error(transparent)]
    Spec(#[from] crate::sim::SpecError),
    /// The recording could not be written.
    #[error("recording: {0}")]
    Io(#[from] std::io::Error),
    /// The effective configuration has no text form.
    #[error("configuration: {0}")]
    Config(#[from] toml::ser::Error),
}

impl<W: Write> SimulatedMission<W> {
    /// Sets up world, agent and recording.
    ///
    /// # Errors
    ///
    /// When the parts do not fit or the recording cannot be begun.
    pub fn new(loaded: LoadedScenario, sink: W) -> Result<Self, SimulatedError> {
        let session =
            Session::new(&loaded.files.world, &loaded.files.scenario, &loaded.files.catalogue)?;
        let header = Header {
            seed: loaded.files.scenario.seed,
            scenario: loaded.name.clone(),
            config: toml::to_string(&loaded.agent)?,
            placement: loaded.placement.clone(),
        };
        let agent = Agent::new(loaded.agent.clone(), loaded.placement.clone());
        let host = Host::new(agent, Some(Writer::new(sink, &header)?));
        let lockstep = Lockstep::new(session, vec![host])?;
        Ok(Self { loaded, lockstep, truth: Vec::new(), start: None, sampled: -SAMPLE_S })
    }

    /// The agent.
    ///
    /// # Panics
    ///
    /// Never: a mission has one.
    pub fn agent(&self) -> &Agent {
        self.lockstep.agents().next().expect("a mission has one agent")
    }

    /// Session time.
    pub fn now(&self) -> Arrival {
        self.lockstep.now()
    }

    /// Runs one step of 5 ms; false once the mission is over.
    ///
    /// # Errors
    ///
    /// When the recording cannot be written.
    pub fn step(&mut self) -> Result<bool, SimulatedError> {
        let alive = self.lockstep.step()?;
        let now = self.lockstep.now().seconds();
        if now - self.sampled >= SAMPLE_S || !alive {
            self.sampled = now;
            self.sample();
        }
        Ok(alive)
    }

    fn sample(&mut self) {
        let Some(truth) = self.lockstep.truth(0) else { return };
        let pose = truth.world_from_robot;
        // By the clock that the trajectory is stamped by.
        self.truth.push(TimedPose { time_s: truth.printed.seconds(), pose });
        self.start.get_or_insert(truth);
    }

    /// The truth now: for progress lines and scoring only.
    pub fn truth(&self) -> Option<Truth> {
        self.lockstep.truth(0)
    }

    /// Ends the mission early.
    ///
    /// # Errors
    ///
    /// When the recording cannot be written.
    pub fn end(&mut self, reason: &str) -> Result<(), SimulatedError> {
        self.lockstep.end(reason)?;
        Ok(())
    }

    /// Closes the recording and scores the mission.
    ///
    /// # Errors
    ///
    /// When the recording cannot be closed.
    pub fn finish(self) -> Result<MissionResult, SimulatedError> {
        let scenario = &self.loaded.files.scenario;
        let name = self.loaded.name.clone();
        let truth_now = self.lockstep.truth(0);
        let bystander = self.lockstep.bystander(0).clone();
        let mut report = run_folder::agent_report(self.agent(), &name, scenario.seed);
        if !scenario.phases.is_empty() {
            report.phases = phases(&scenario.phases, report.mission_time_s);
        }
        let world = &self.loaded.files.world;
        if let Some(running) = self.agent().running() {
            score_coverage(&mut report, running, world, self.start.as_ref());
            let trajectory: Vec<TimedPose> = running
                .belief()
                .trajectory()
                .into_iter()
                .map(|(stamp, pose)| TimedPose { time_s: stamp.seconds(), pose })
                .collect();
            let driven_m = truth_now.as_ref().map_or(0.0, |truth| truth.distance_m);
            report.pose_error = pose_error(&trajectory, &self.truth, driven_m, &bystander);
            score_victims(&mut report, running, world);
        }
        if let Some(truth) = &truth_now {
            score_truth(&mut report, truth, world);
        }
        let title = format!(
            "{name}, {:.0} s, seed {}: {}",
            report.mission_time_s, scenario.seed, report.outcome
        );
        let mut files = run_folder::map_files(self.agent(), &title);
        files.push(("truth.tum", tum::format(&self.truth).into_bytes()));
        files.push(("log.txt", log_text(self.agent()).into_bytes()));
        self.lockstep.finish()?;
        Ok(MissionResult { report, files })
    }
}

/// The scenario's phases as far as the mission came.
fn phases(planned: &[Phase], mission_time_s: f64) -> Vec<PhaseReport> {
    let mut from_s = 0.0;
    let mut reached = Vec::new();
    for phase in planned {
        if mission_time_s.min(phase.until_s) <= from_s {
            break;
        }
        let to_s = phase.until_s.min(mission_time_s);
        reached.push(PhaseReport { name: phase.name.to_string(), from_s, to_s });
        from_s = to_s;
    }
    reached
}

/// The agent's diary as text.
pub fn log_text(agent: &Agent) -> String {
    agent
        .journal()
        .since(0)
        .iter()
        .map(|note| {
            let level = format!("{:?}", note.level).to_lowercase();
            format!("{:9.2} {level:5} {}\n", note.arrival.seconds(), note.text)
        })
        .collect()
}

fn score_coverage(report: &mut Report, running: &Running, world: &World, start: Option<&Truth>) {
    let Some(start) = start else { return };
    let shape = running.shape();
    let place = Point3::from(start.world_from_robot.translation.vector);
    let reachable = coverage::reachable(world, &passability(shape), &place);
    let grid = running.belief().grid();
    let evidence = run_folder::evidence(&grid, running.belief());
    let (reachable_m2, explored_m2) = coverage::coverage(&reachable, &evidence);
    report.reachable_m2 = Some(reachable_m2);
    report.explored_m2 = Some(explored_m2);
    report.coverage = (reachable_m2 > 0.0).then(|| explored_m2 / reachable_m2);
    let minutes = report.mission_time_s / 60.0;
    report.m2_per_minute = (minutes > 0.0).then(|| explored_m2 / minutes);
}

/// The robot's own limits, as the truth is judged by.
pub fn passability(shape: &RobotShape) -> Passability {
    Passability {
        radius_m: shape.inscribed_radius_m(),
        height_m: shape.height_m + shape.clearance_m,
        max_step_m: shape.max_step_m,
        max_slope: shape.max_slope_rad.tan(),
        max_gap_m: shape.max_gap_m,
    }
}

fn score_victims(report: &mut Report, running: &Running, world: &World) {
    let victims = world.victims();
    let mut hit = vec![false; victims.len()];
    let mut wrong = 0;
    for candidate in running.victims() {
        let near = victims
            .iter()
            .enumerate()
            .map(|(i, victim)| {
                ((victim.world_from_victim.translation.vector - candidate.place.coords).norm(), i)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        match near {
            Some((away, i)) if away <= FOUND_WITHIN_M => hit[i] = true,
            _ => wrong += 1,
        }
    }
    let found = hit.iter().filter(|hit| **hit).count();
    report.victims = VictimCounts {
        truth: Some(victims.len()),
        found: Some(found),
        wrong: Some(wrong),
        missed: Some(victims.len() - found),
        contacts: None,
    };
}

fn score_truth(report: &mut Report, truth: &Truth, world: &World) {
    report.falls = Some(truth.falls as usize);
    report.collisions = Some(truth.collisions as usize);
    report.hardest_collision_mps = Some(truth.worst_collision_mps);
    report.victims.contacts = Some(truth.victim_contacts.values().sum::<u32>() as usize);
    let portals = PortalCounts { total: world.portals().len(), visited: truth.portals.len() };
    report.score_2019 = Some(score_2019(
        (portals.visited, portals.total),
        report.victims.found.unwrap_or(0),
        report.victims.wrong.unwrap_or(0),
        world.victims().len(),
    ));
    report.portals = Some(portals);
}
