//! Taking 3D scans: stop, step the tilt, wait, file the line (paper, section II).
//!
//! [`Acquisition`] is driven from outside: it is handed laser lines, joint readings and the time, and
//! hands back commands and, in the end, a [`Scan`]. It knows two clocks. Lines and readings carry the
//! server's [`Stamp`]; commands are sent at a session [`Arrival`], and [`StampClock`] bounds the
//! stamp at which they are in force. A line is filed only if its own stamp is later than the time at
//! which the tilt rests for certain.

mod clock;
mod config;
mod control;
mod fix;
mod guard;
mod identify;
mod park;
mod profile;
mod scan;
mod servo;
mod sweep;
#[cfg(test)]
mod testbed;
mod track;

pub use clock::{ClockStep, StampClock};
pub use config::AcquisitionConfig;
pub use control::HeadControl;
pub use fix::{TiltFix, TiltReference};
pub use guard::{GuardConfig, GuardTilt, guard_tilt};
pub use identify::{Observation, ServoFit};
pub use park::ParkState;
pub use profile::{Clipped, FanConfig, Profile, QUARTER_DEGREE_RAD, QuarterDegrees};
pub use scan::{Scan, ScanErrors, TimeBudget};
pub use servo::{HINGE_GAP_RAD, ServoLaw, ServoState};
pub use sweep::Sweep;
pub use track::{AxisEstimate, AxisReading, AxisTrack, Verdict};

use crate::protocol::Dialect;
use crate::robot::{Demand, GroundView, HeadPose, HeadReading, Rig, ScanHead};
use crate::scan::LaserLine;
use crate::time::{Arrival, Stamp};
use park::Park;
use serde::{Deserialize, Serialize};

/// Speed of a pan-tilt link whose CONF is silent: CameraPanTilt's (protocol 5.4).
const USUAL_LINK_SPEED_RAD_S: f64 = 0.17;

/// What the acquisition is told.
#[derive(Clone, Copy, Debug)]
pub enum HeadEvent<'a> {
    /// A line of the rig's laser.
    Line(&'a LaserLine),
    /// A status line of the pan-tilt.
    Joints(HeadReading),
    /// The stamp of any other message, the scanner's excepted: it keeps the clocks together.
    Stamped(Stamp),
    /// Only that time has passed.
    Tick,
}

/// What the head's joints are to do; a joint without a demand is left alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeadCommand {
    /// The pan joint.
    pub pan: Option<Demand>,
    /// The tilt joint.
    pub tilt: Option<Demand>,
}

/// What the acquisition wants or has done.
#[derive(Clone, Debug, PartialEq)]
pub enum HeadAction {
    /// Command the head's joints.
    Send(HeadCommand),
    /// A row was filed.
    Filed {
        /// Its place in the profile.
        row: usize,
        /// Its demanded tilt.
        tilt: QuarterDegrees,
    },
    /// The sweep is over, as asked for or cut short.
    Finished(Box<Scan>),
}

/// A sweep to be taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SweepRequest {
    /// The tilts. Rows out of the link's reach are cut off with a remark; the sweep begins at the end
    /// nearer to where the tilt is.
    pub profile: Profile,
    /// Where the pan is held, in radians, left positive.
    pub pan_rad: f64,
    /// How far the tilt may be off its demanded angle when a line is taken, in radians; `None` for
    /// the paper's tolerance.
    pub tolerance_rad: Option<f64>,
}

impl SweepRequest {
    /// The paper's full sweep at its tolerance.
    pub fn paper() -> Self {
        Self { profile: Profile::paper_full(), pan_rad: 0.0, tolerance_rad: None }
    }

    /// A coarse sweep for exploration: `profile` at the coarse tolerance.
    pub fn coarse(profile: Profile, config: &AcquisitionConfig) -> Self {
        let tolerance_rad = Some(config.coarse_tolerance_deg.to_radians());
        Self { profile, pan_rad: 0.0, tolerance_rad }
    }

    /// The ground fan at the coarse tolerance.
    pub fn ground_fan(view: &GroundView<'_>, config: &AcquisitionConfig) -> Self {
        Self::coarse(Profile::ground_fan(view, &config.fan), config)
    }

    /// The same with the pan held at `pan_rad`.
    #[must_use]
    pub fn at_pan(self, pan_rad: f64) -> Self {
        Self { pan_rad, ..self }
    }
}

/// Everything that moves the scan head: sweeps, and parking between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Acquisition {
    config: AcquisitionConfig,
    control: HeadControl,
    activity: Activity,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Activity {
    Idle,
    Parking(Park),
    Sweeping(Box<Sweep>),
}

impl Acquisition {
    /// A head at rest at zero, as a robot is created, whose joints follow `law` where one is known.
    pub fn new(head: &ScanHead, law: Option<ServoLaw>, config: AcquisitionConfig) -> Self {
        let control = HeadControl::new(head, law, &config);
        Self { config, control, activity: Activity::Idle }
    }

    /// The head of a rig just created: UT2004 joints follow the hinge law at the speed that CONF gave,
    /// or the pan-tilt's usual one; UDK's spring is unknown. `None` for a rig without a laser.
    pub fn for_rig(rig: &Rig, config: AcquisitionConfig) -> Option<Self> {
        let laser = rig.laser.as_ref()?;
        let law = match rig.dialect {
            Dialect::Ut2004 => Some(ServoLaw::hinge(USUAL_LINK_SPEED_RAD_S)),
            Dialect::Udk => None,
        };
        Some(Self::new(&laser.head, law, config))
    }

    /// Begins a sweep; one that is under way is dropped.
    pub fn start(&mut self, request: SweepRequest, now: Arrival) -> Vec<HeadAction> {
        let limits = self.control.head().tilt().and_then(|axis| axis.limits);
        let (profile, clipped) = request.profile.clipped(limits);
        let profile = profile.from_nearer_end(self.control.tilt.target_rad().unwrap_or(0.0));
        let tolerance =
            request.tolerance_rad.unwrap_or_else(|| self.config.tolerance_deg.to_radians());
        let (mut sweep, actions) =
            Sweep::start(profile, request.pan_rad, tolerance, &mut self.control, &self.config, now);
        if let Some(clipped) = clipped {
            sweep.remark(format!("the tilt's limits cut {} rows off", clipped.rows));
        }
        self.activity = match sweep.is_finished() {
            true => Activity::Idle,
            false => Activity::Sweeping(Box::new(sweep)),
        };
        actions
    }

    /// Ends a sweep that is under way and hands over what there is.
    pub fn stop_sweep(&mut self, why: &str, now: Arrival) -> Option<Scan> {
        let Activity::Sweeping(sweep) = &mut self.activity else { return None };
        let scan = sweep.stop(why, &self.control, now);
        self.activity = Activity::Idle;
        scan
    }

    /// Parks the head at `pose`; a sweep that is under way is dropped.
    pub fn park(&mut self, pose: HeadPose, now: Arrival) -> Vec<HeadAction> {
        let (park, commands) = Park::start(pose, &mut self.control, &self.config, now);
        self.activity = Activity::Parking(park);
        commands.into_iter().map(HeadAction::Send).collect()
    }

    /// Whether the head is parked, and how that is known.
    pub fn parked(&self, now: Arrival) -> ParkState {
        match &self.activity {
            Activity::Parking(park) => park.state(&self.control, now),
            Activity::Idle | Activity::Sweeping(_) => ParkState::NotParked,
        }
    }

    /// Takes an event; returns what is to be sent and what was done.
    pub fn handle(&mut self, event: &HeadEvent<'_>, now: Arrival) -> Vec<HeadAction> {
        let jumped = self.control.note(event, now);
        match &mut self.activity {
            Activity::Idle => Vec::new(),
            Activity::Parking(park) => {
                let commands = park.handle(jumped, &mut self.control, &self.config, now);
                commands.into_iter().map(HeadAction::Send).collect()
            }
            Activity::Sweeping(sweep) => {
                let actions = sweep.handle(event, jumped, &mut self.control, &self.config, now);
                if sweep.is_finished() {
                    self.activity = Activity::Idle;
                }
                actions
            }
        }
    }

    /// When [`Self::handle`] must be called again even if nothing arrives.
    pub fn next_wakeup(&self) -> Option<Arrival> {
        match &self.activity {
            Activity::Sweeping(sweep) => sweep.next_wakeup(),
            Activity::Idle | Activity::Parking(_) => None,
        }
    }

    /// Rows dealt with and rows in all, while a sweep is under way.
    pub fn progress(&self) -> Option<(usize, usize)> {
        match &self.activity {
            Activity::Sweeping(sweep) => Some(sweep.progress()),
            Activity::Idle | Activity::Parking(_) => None,
        }
    }

    /// Where the head pointed at `stamp`, as far as commands, servo law and readings tell.
    pub fn pose_at(&self, stamp: Stamp) -> Option<HeadPose> {
        let tilt = match self.control.head().tilt() {
            Some(_) => self.control.tilt.estimate(stamp)?.angle_rad,
            None => 0.0,
        };
        let pan = match self.control.head().pan() {
            Some(_) => self.control.pan.estimate(stamp)?.angle_rad,
            None => 0.0,
        };
        Some(HeadPose { pan_rad: pan, tilt_rad: tilt })
    }

    /// What is known of the head over time.
    pub fn control(&self) -> &HeadControl {
        &self.control
    }

    /// The configuration.
    pub fn config(&self) -> &AcquisitionConfig {
        &self.config
    }
}

#[cfg(test)]
mod tests;
