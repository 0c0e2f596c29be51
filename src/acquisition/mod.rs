//! Taking 3D scans: stop, step the tilt, wait, file the line (paper, section II).
//!
//! [`Acquisition`] is driven from outside: it is handed laser lines, joint readings and the time, and
//! hands back commands and, in the end, a [`Scan`]. It knows two clocks. Lines and readings carry the
//! server's [`Stamp`]; commands are sent at a session [`Arrival`], and [`StampClock`] bounds the
//! stamp at which they are in force. A line is filed only if its own stamp is later than the time at
//! which the tilt rests for certain.

mod body;
mod calibrate;
mod choosing;
mod clock;
mod config;
mod control;
mod cyclic;
mod dated;
mod fix;
mod flow;
mod guard;
mod identify;
mod nod;
mod park;
mod policy;
mod probe;
mod profile;
mod punctuality;
mod ramp;
mod reach;
mod repeat;
mod request;
mod round_trip;
mod scan;
mod servo;
mod stillness;
mod sweep;
mod synchronise;
#[cfg(test)]
mod testbed;
mod tilt_mount;
mod track;
mod triples;
mod way;

pub use body::BodyTrack;
pub use calibrate::CalibrationReport;
pub use clock::{ClockStep, StampClock};
pub use config::AcquisitionConfig;
pub use control::{HeadControl, Timing};
pub use cyclic::{CyclicSource, Triple, scan_by_request};
pub use fix::{TiltFix, TiltReference};
pub use flow::{Flow, FlowDrive};
pub use guard::{GuardConfig, GuardTilt, guard_tilt};
pub use identify::{Observation, ServoFit};
pub use nod::NodTerms;
pub use park::ParkState;
pub use policy::{Interest, Offer, RING_M};
pub use profile::{Clipped, FanConfig, Profile, QUARTER_DEGREE_RAD, QuarterDegrees};
pub use reach::Reach;
pub use request::{CONTINUOUS_CYCLE_S, SweepMode, SweepRequest};
pub use scan::{Scan, ScanErrors, TimeBudget};
pub use servo::{HINGE_GAP_RAD, ServoLaw, ServoState};
pub use sweep::Sweep;
pub use synchronise::{Synchronised, Synchroniser};
pub use tilt_mount::TiltMount;
pub use track::{AxisEstimate, AxisReading, AxisTrack, Verdict};
pub use triples::{HEADING, RecordedTriples, TripleError};

use crate::protocol::Dialect;
use crate::robot::{Demand, GroundView, HeadPose, HeadReading, Rig, ScanHead};
use crate::scan::LaserLine;
use crate::time::{Arrival, Stamp};
use calibrate::{Calibration, reference_profile};
use nalgebra::Isometry3;
use park::Park;
use probe::Probe;
use repeat::Repeat;
use serde::{Deserialize, Serialize};
use way::Way;

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
    /// The answer to a [`HeadAction::Query`].
    Answered,
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
    /// Ask the laser for a line: it speaks only when asked.
    Ask,
    /// Ask the server anything that it answers at once: how long that takes bounds how long commands
    /// take, however late all its messages come.
    Query,
    /// A row was filed.
    Filed {
        /// Its place in the profile.
        row: usize,
        /// Its demanded tilt.
        tilt: QuarterDegrees,
    },
    /// The sweep is over, as asked for or cut short.
    Finished(Box<Scan>),
    /// The calibration is over.
    Calibrated(Box<CalibrationReport>),
    /// The tilt was found to reach something else than was known: less, or all of it again.
    Reach(Reach),
}

/// Everything that moves the scan head: sweeps, and parking between them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Acquisition {
    config: AcquisitionConfig,
    control: HeadControl,
    activity: Activity,
    /// Whether the server takes rates.
    rates: bool,
    /// What becomes of a sweep that an end of the tilt's reach left without rows.
    repeat: Repeat,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Activity {
    Idle,
    Parking(Park),
    Sweeping(Box<Sweep>),
    Flowing(Box<Flow>),
    Calibrating(Box<Calibration>),
    Probing(Box<Probe>),
}

impl Acquisition {
    /// A head at rest at zero, as a robot is created, whose joints follow `law` where one is known.
    pub fn new(head: &ScanHead, law: Option<ServoLaw>, config: AcquisitionConfig) -> Self {
        let control = HeadControl::new(head, law, &config);
        let rates = !matches!(law, None | Some(ServoLaw::Spring { .. }));
        Self { config, control, activity: Activity::Idle, rates, repeat: Repeat::default() }
    }

    /// The head of a rig just created: UT2004 joints follow the hinge law at the speed that CONF gave,
    /// or the pan-tilt's usual one; UDK's spring is unknown. `None` for a rig without a laser.
    pub fn for_rig(rig: &Rig, config: AcquisitionConfig) -> Option<Self> {
        let laser = rig.laser.as_ref()?;
        let law = match rig.dialect {
            Dialect::Ut2004 => Some(ServoLaw::hinge(USUAL_LINK_SPEED_RAD_S)),
            Dialect::Udk => None,
        };
        let mut acquisition = Self::new(&laser.head, law, config);
        acquisition.rates = rig.dialect == Dialect::Ut2004;
        acquisition.stands_at(rig.body.origin_height_m);
        Some(acquisition)
    }

    /// Goes on with what `other` learnt of the line to the server.
    pub fn keep_line_of(&mut self, other: &Self) {
        self.control.keep_line_of(&other.control);
    }

    /// Takes in how high the robot's origin stands above the floor, in metres.
    pub fn stands_at(&mut self, origin_height_m: f64) {
        self.control.origin_height_m = Some(origin_height_m);
    }

    /// Finds out how the tilt moves and when commands and rays take effect: a sweep of nine rows at
    /// rest and eight seconds of motion, with the robot standing still. Ends in
    /// [`HeadAction::Calibrated`].
    pub fn calibrate(&mut self, now: Arrival) -> Vec<HeadAction> {
        let head = self.control.head().clone();
        let view = self.control.origin_height_m.map(|origin_height_m| GroundView {
            head: &head,
            origin_height_m,
            half_fov_rad: std::f64::consts::FRAC_PI_2,
        });
        let profile = reference_profile(view.as_ref(), &self.control);
        let query = self.control.query_if_due(now);
        let (calibration, actions) =
            Calibration::start(profile, &mut self.control, &self.config, now);
        self.activity = match calibration.is_finished() {
            true => Activity::Idle,
            false => Activity::Calibrating(Box::new(calibration)),
        };
        query.into_iter().chain(actions).collect()
    }

    /// Whether a calibration has found the servo law and the small times.
    pub fn is_calibrated(&self) -> bool {
        self.control.timing().calibrated
    }

    /// Whether messages come later than when the small times were found, so that sweeps in motion have to
    /// wait for another calibration.
    pub fn wants_calibration(&self) -> bool {
        self.is_calibrated() && self.control.wants_calibration()
    }

    /// Seconds by which commands are obeyed later than the configuration supposes.
    pub fn obeyed_late_s(&self) -> f64 {
        (self.control.obeyed_within() - self.config.command_latency()).seconds().max(0.0)
    }

    /// Whether the tilt was found not to turn at all.
    pub fn is_stuck(&self) -> bool {
        self.control.reach().stuck_rad().is_some()
    }

    /// Whether it does not turn and nothing but the laser told so, which tells where it was last seen to
    /// turn, not where it rests: no row has a place.
    fn is_stuck_out_of_sight(&self) -> bool {
        let latest = self.control.clock().latest();
        self.is_stuck() && !latest.is_some_and(|latest| self.control.reads_at(latest))
    }

    /// Whether the tilt was found to reach less than told so long ago that the next sweep tries it again.
    pub fn tries_again(&self) -> bool {
        self.control.is_worth_a_try()
    }

    /// Begins a sweep; one that is under way is dropped.
    pub fn start(&mut self, request: SweepRequest, now: Arrival) -> Vec<HeadAction> {
        let standing = request.mode != SweepMode::Nodding;
        self.repeat = Repeat::of(standing.then(|| request.clone()));
        if standing {
            self.control.try_again();
        }
        self.begin(request, now)
    }

    fn begin(&mut self, request: SweepRequest, now: Arrival) -> Vec<HeadAction> {
        // First of all, so that whoever sends the commands lets them through.
        let news = self.control.new_reach().map(HeadAction::Reach);
        let query = self.control.query_if_due(now);
        let limits = self.control.head().tilt().and_then(|axis| axis.limits);
        let (mut profile, clipped) = request.profile.clipped(limits);
        if self.is_stuck_out_of_sight() {
            profile.tilts.clear();
        }
        let driving = request.mode == SweepMode::Nodding;
        let profile = match driving {
            true => profile,
            false => profile.from_nearer_end(self.control.tilt.target_rad().unwrap_or(0.0)),
        };
        if driving {
            self.control.body.forget();
        }
        let limited =
            clipped.map(|clipped| format!("the tilt's limits cut {} rows off", clipped.rows));
        let coarse = self.config.coarse_tolerance_deg.to_radians();
        let (drive, tolerance_rad) = match request.mode {
            SweepMode::Settled { tolerance_rad } => (None, tolerance_rad),
            _ if !self.may_flow() => (None, coarse),
            SweepMode::Continuous { rate_rad_s, cycle_s } if self.rates => {
                (Some(FlowDrive::Rate { rate_rad_s, cycle_s }), coarse)
            }
            SweepMode::Continuous { rate_rad_s, cycle_s } => {
                (Some(FlowDrive::Ramp { rate_rad_s, cycle_s }), coarse)
            }
            SweepMode::Flowing | SweepMode::Nodding => (Some(FlowDrive::SetPoints), coarse),
        };
        let at_rest = matches!(request.mode, SweepMode::Settled { .. });
        let (profile, thinned) = match drive {
            None if !at_rest => self.thinned(profile),
            _ => (profile, None),
        };
        let limited = limited.into_iter().chain(thinned);
        let (control, config) = (&mut self.control, &self.config);
        let pan_rad = request.pan_rad;
        let actions = match drive {
            None => {
                let (mut sweep, actions) =
                    Sweep::start(profile, pan_rad, tolerance_rad, control, config, now);
                limited.for_each(|text| sweep.remark(text));
                let over = sweep.is_finished();
                self.activity =
                    if over { Activity::Idle } else { Activity::Sweeping(Box::new(sweep)) };
                actions
            }
            Some(drive) => {
                let (mut flow, actions) =
                    Flow::start(Way { profile, drive }, pan_rad, driving, control, config, now);
                limited.for_each(|text| flow.remark(text));
                let over = flow.is_finished();
                self.activity =
                    if over { Activity::Idle } else { Activity::Flowing(Box::new(flow)) };
                actions
            }
        };
        news.into_iter().chain(query).chain(actions).collect()
    }

    /// Takes note of where the robot's body is, by odometry and inertial unit, in any frame that stays
    /// the same during a sweep.
    pub fn moved(&mut self, stamp: Stamp, frame_from_robot: Isometry3<f64>) {
        self.control.body.note(stamp, frame_from_robot);
    }

    /// Ends a sweep that is under way and hands over what there is.
    pub fn stop_sweep(&mut self, why: &str, now: Arrival) -> Option<Scan> {
        let scan = match &mut self.activity {
            Activity::Sweeping(sweep) => sweep.stop(why, &self.control, now),
            Activity::Flowing(flow) => flow.stop(why, &self.control, now),
            Activity::Probing(_) => None,
            Activity::Idle | Activity::Parking(_) | Activity::Calibrating(_) => return None,
        };
        let scan = match std::mem::replace(&mut self.activity, Activity::Idle) {
            Activity::Probing(probe) => Some(probe.stop(why, now)),
            _ => scan,
        };
        let repeat = std::mem::take(&mut self.repeat);
        scan.map(|scan| repeat.joined(scan))
    }

    /// Parks the head at `pose`; a sweep that is under way is dropped.
    pub fn park(&mut self, pose: HeadPose, now: Arrival) -> Vec<HeadAction> {
        self.repeat = Repeat::default();
        let query = self.control.query_if_due(now);
        let (park, commands) = Park::start(pose, &mut self.control, &self.config, now);
        self.activity = Activity::Parking(park);
        query.into_iter().chain(commands.into_iter().map(HeadAction::Send)).collect()
    }

    /// Whether the head is parked, and how that is known.
    pub fn parked(&self, now: Arrival) -> ParkState {
        match &self.activity {
            Activity::Parking(park) => park.state(&self.control, now),
            Activity::Flowing(flow) if flow.is_driving() => ParkState::Nodding,
            _ => ParkState::NotParked,
        }
    }

    /// Takes an event; returns what is to be sent and what was done.
    pub fn handle(&mut self, event: &HeadEvent<'_>, now: Arrival) -> Vec<HeadAction> {
        let jumped = self.control.note(event, now);
        let limits = self.control.reach().limits();
        let probed = matches!(self.activity, Activity::Probing(_));
        let mut actions = self.pass_on(event, jumped, now);
        if self.activity != Activity::Idle {
            actions.extend(self.control.query_if_due(now));
        }
        self.probe_new_end(limits, &mut actions, now);
        self.repeat_what_was_in_vain(probed, &mut actions, now);
        // First of all, so that whoever takes the scan knows what it could not show.
        let news = self.control.new_reach().map(HeadAction::Reach);
        actions.splice(0..0, news);
        actions
    }

    fn pass_on(&mut self, event: &HeadEvent<'_>, jumped: bool, now: Arrival) -> Vec<HeadAction> {
        match &mut self.activity {
            Activity::Idle => Vec::new(),
            Activity::Parking(park) => {
                let commands = park.handle(jumped, &mut self.control, &self.config, now);
                let sent = commands.into_iter().map(HeadAction::Send);
                sent.chain(self.control.ask_if_due(now)).collect()
            }
            Activity::Sweeping(sweep) => {
                let actions = sweep.handle(event, jumped, &mut self.control, &self.config, now);
                if sweep.is_finished() {
                    self.activity = Activity::Idle;
                }
                actions
            }
            Activity::Flowing(flow) => {
                let mut actions = flow.handle(event, jumped, &mut self.control, &self.config, now);
                if flow.is_finished() {
                    self.activity = Activity::Idle;
                } else {
                    actions.extend(self.control.ask_if_due(now));
                }
                actions
            }
            Activity::Calibrating(calibration) => {
                let mut actions =
                    calibration.handle(event, jumped, &mut self.control, &self.config, now);
                if calibration.is_finished() {
                    self.activity = Activity::Idle;
                } else if calibration.is_moving() {
                    actions.extend(self.control.ask_if_due(now));
                }
                actions
            }
            Activity::Probing(probe) => match probe.handle(&mut self.control, now) {
                Some(scan) => {
                    self.activity = Activity::Idle;
                    vec![HeadAction::Finished(scan)]
                }
                None => {
                    let step = probe.next_step(&mut self.control, now);
                    step.into_iter().chain(self.control.ask_if_due(now)).collect()
                }
            },
        }
    }

    /// When [`Self::handle`] must be called again even if nothing arrives.
    pub fn next_wakeup(&self) -> Option<Arrival> {
        // A sweep at rest asks a scanner that speaks only when asked by itself; in motion, and on the
        // guard line, such a scanner is asked as often as others speak.
        let ask_at = || self.control.may_ask_at().filter(|_| self.control.must_ask());
        let earliest = |a: Option<Arrival>, b: Option<Arrival>| a.into_iter().chain(b).min();
        match &self.activity {
            Activity::Sweeping(sweep) => sweep.next_wakeup(),
            Activity::Flowing(flow) => earliest(flow.next_wakeup(), ask_at()),
            Activity::Calibrating(calibration) if calibration.is_moving() => {
                earliest(calibration.next_wakeup(), ask_at())
            }
            Activity::Calibrating(calibration) => calibration.next_wakeup(),
            Activity::Parking(_) => ask_at(),
            Activity::Probing(probe) => earliest(Some(probe.next_wakeup()), ask_at()),
            Activity::Idle => None,
        }
    }

    /// Rows dealt with and rows in all, while a sweep is under way.
    pub fn progress(&self) -> Option<(usize, usize)> {
        match &self.activity {
            Activity::Sweeping(sweep) => Some(sweep.progress()),
            Activity::Flowing(flow) => Some(flow.progress()),
            Activity::Idle
            | Activity::Parking(_)
            | Activity::Calibrating(_)
            | Activity::Probing(_) => None,
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

    /// Where the head pointed when a line was taken.
    pub fn pose_of_line(&self, line: &LaserLine) -> Option<HeadPose> {
        self.pose_at(self.control.cast_time(line))
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
mod flow_tests;
#[cfg(test)]
mod tests;
