mod rhythm;
mod turning;

use super::body::BodyTrack;
use super::clock::{ClockStep, StampClock};
use super::config::AcquisitionConfig;
use super::identify::ServoFit;
use super::reach::Reach;
use super::round_trip::RoundTrips;
use super::servo::ServoLaw;
use super::stillness::StillWatch;
use super::track::{AxisReading, AxisTrack};
use super::{HeadAction, HeadCommand, HeadEvent};
use crate::robot::{Demand, HeadPose, JointAngle, ScanHead};
use crate::scan::LaserLine;
use crate::time::{Arrival, Span, Stamp};
use nalgebra::Isometry3;
pub(super) use rhythm::{Disorder, LineRhythm};
use serde::{Deserialize, Serialize};

/// What is known of the scan head over time: clocks, joints, and the rhythm of the laser.
///
/// Sweeps come and go; this stays, so that what one sweep learns serves the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeadControl {
    head: ScanHead,
    /// The map between the session's clock and the server's, from everything but the scanner.
    clock: StampClock,
    /// The same from the scanner's stamps alone, for a server that stamps nothing else.
    scanner_clock: StampClock,
    /// What questions to the server take to be answered.
    trips: RoundTrips,
    /// The tilt joint.
    pub(super) tilt: AxisTrack,
    /// The pan joint.
    pub(super) pan: AxisTrack,
    /// Where the body was over time.
    pub(super) body: BodyTrack,
    /// When lines come, and how many beams they have.
    pub(super) rhythm: LineRhythm,
    /// When a line was last asked for, and how often in all.
    asked: Option<Arrival>,
    asks: u64,
    /// The law by which the tilt rests for certain: as told by CONF, or as found and then derated.
    tilt_proof: Option<ServoLaw>,
    pan_proof: Option<ServoLaw>,
    latency: Span,
    /// Time after which a tilt of unknown law is taken to rest.
    unknown_settle: Span,
    /// What the tilt was told to reach, and was found to.
    reach: Reach,
    /// When an end of its reach was last found, and how long that is believed.
    ended: Option<(Stamp, Span)>,
    /// Until then an end found by the laser alone leaves it unsure where the tilt is.
    unsure_until: Option<Stamp>,
    /// Whether the laser sees that a tilt without readings turns.
    still: StillWatch,
    /// Height of the robot's origin above the floor, in metres, as far as is known.
    pub(super) origin_height_m: Option<f64>,
    /// Tilt and body as they were known before the jump of the clock that was just noted.
    past: Option<Box<(AxisTrack, BodyTrack)>>,
    /// How late the last reading came.
    readings_late: Span,
    /// What came out of order so far.
    disorder: Disorder,
    /// By how much messages came later than they did when a calibration was last begun.
    slower_calibrated: Span,
    /// Times found by calibration, or supposed.
    pub(super) timing: Timing,
}

/// Small times between commands, stamps and rays.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// From the clock's lower bound at sending until a command is in force.
    pub command_delay: Span,
    /// From a line's stamp to the casting of its rays.
    pub line_lag: Span,
    /// Standard deviation of a line's time against the tilt's.
    pub sigma: Span,
    /// Standard deviation of what the servo law predicts at rest, in radians.
    pub model_sigma_rad: f64,
    /// Standard deviation of the law's speed, as a share of it.
    pub speed_sigma: f64,
    /// Whether a calibration found them.
    pub calibrated: bool,
}

/// UT2004 stamps scanner lines with the time of the burst before, so a clock that hears nothing else
/// must take such a stamp for this much later to stay on the safe side.
const SCANNER_LAG: Span = Span::from_millis(300);

/// Added to a delay of commands that was measured, for the wait until one is surely obeyed.
const DELAY_SPARE: Span = Span::from_millis(20);

/// A tilt that the laser has found at the end of its reach is where it was last seen to turn to, or so
/// much farther on, in radians: a fast one runs on by that while the law and its times are believed.
const UNSURE_RAD: f64 = 0.2;

/// Lines stamped farther apart than this, one after the other, are not out of order: the clock jumped.
const CLOCK_JUMP: Span = Span::from_millis(3_000);

/// A line asked for and not answered is asked for again after this; real scanners speak as often.
const ASK_EVERY: Span = Span::from_millis(200);

impl HeadControl {
    /// A head at rest at zero, as a robot is created, whose joints follow `law` where one is known.
    pub fn new(head: &ScanHead, law: Option<ServoLaw>, config: &AcquisitionConfig) -> Self {
        let track = |axis: Option<&crate::robot::Axis>| {
            let law = match (law, axis.and_then(|a| a.speed_rad_s)) {
                (Some(ServoLaw::Hinge { gap_rad, .. }), Some(speed_rad_s)) => {
                    Some(ServoLaw::Hinge { speed_rad_s, gap_rad })
                }
                (law, _) => law,
            };
            AxisTrack::new(law, axis.and_then(|a| a.limits), 0.0)
        };
        let latency = config.command_latency();
        let (tilt, pan) = (track(head.tilt()), track(head.pan()));
        let tilt_limits = tilt.limits();
        Self {
            head: head.clone(),
            clock: StampClock::new(),
            scanner_clock: StampClock::new(),
            trips: RoundTrips::default(),
            tilt_proof: tilt.law(),
            pan_proof: pan.law(),
            tilt,
            pan,
            body: BodyTrack::default(),
            rhythm: LineRhythm::default(),
            asked: None,
            asks: 0,
            latency,
            unknown_settle: Span::from_seconds(config.unknown_settle_s),
            reach: Reach::told(tilt_limits),
            ended: None,
            unsure_until: None,
            still: StillWatch::default(),
            origin_height_m: None,
            past: None,
            readings_late: Span::ZERO,
            disorder: Disorder::default(),
            slower_calibrated: Span::ZERO,
            timing: Timing {
                command_delay: Span::from_seconds(0.5 * latency.seconds()),
                line_lag: Span::ZERO,
                sigma: Span::from_millis(60),
                model_sigma_rad: 0.002,
                speed_sigma: 0.03,
                calibrated: false,
            },
        }
    }

    /// Takes note of an event; true if the server's clock jumped and all known times are void.
    pub(super) fn note(&mut self, event: &HeadEvent<'_>, now: Arrival) -> bool {
        self.past = None;
        let step = match event {
            HeadEvent::Stamped(stamp) => self.clock.observe(*stamp, now),
            HeadEvent::Joints(reading) => {
                // A late reading says nothing about the clock, and must not look like a jump back.
                let in_time = self.clock.latest().is_none_or(|latest| reading.stamp >= latest);
                let step = match in_time {
                    true => self.clock.observe(reading.stamp, now),
                    false => ClockStep::Steady,
                };
                let read = |track: &mut AxisTrack, joint: Option<JointAngle>| {
                    if let Some(JointAngle { angle_rad, half_width_rad }) = joint {
                        let stamp = reading.stamp;
                        track.read(AxisReading { stamp, angle_rad, half_width_rad });
                    }
                };
                if step == ClockStep::Steady {
                    let newest = self.tilt.last_reading().map(|read| read.stamp);
                    self.disorder.readings += u32::from(newest > Some(reading.stamp));
                    let sent = self.clock.earliest(now).unwrap_or(reading.stamp);
                    self.readings_late = (sent - reading.stamp).max(Span::ZERO);
                    read(&mut self.tilt, reading.tilt);
                    read(&mut self.pan, reading.pan);
                    // One that was under way when an end was found says nothing against it.
                    let is_new = self.ended.is_none_or(|(found, _)| reading.stamp > found);
                    let beyond =
                        reading.tilt.is_some_and(|tilt| self.reach.is_exceeded_by(tilt.angle_rad));
                    if is_new && beyond {
                        self.set_reach(self.reach.as_told(), None);
                    }
                }
                step
            }
            HeadEvent::Line(line) => {
                let newest = self.rhythm.newest();
                let behind = newest.map(|newest| newest - line.stamp);
                if let Some(behind) = behind.filter(|&behind| behind < CLOCK_JUMP) {
                    self.disorder.lines += u32::from(behind > Span::ZERO);
                    self.disorder.lines_late = self.disorder.lines_late.max(behind);
                }
                self.rhythm.note(line, now);
                if self.rhythm.is_whole(line) {
                    let cast = self.cast_time(line);
                    let expected = self.expected_of(cast);
                    // While a joint of unknown law may still turn nothing is expected of a line; what
                    // was seen of it at rest, row by row, stays evidence.
                    if expected.is_some() || self.reads_at(cast) {
                        self.still.note(line, cast, expected.as_ref());
                        self.note_came_free(cast);
                    }
                }
                let step = self.scanner_clock.observe(line.stamp + SCANNER_LAG, now);
                if self.clock.latest().is_some() { ClockStep::Steady } else { step }
            }
            HeadEvent::Answered => {
                self.trips.answered(now);
                ClockStep::Steady
            }
            HeadEvent::Tick => ClockStep::Steady,
        };
        if step == ClockStep::Steady {
            return false;
        }
        self.past = Some(Box::new((self.tilt.clone(), self.body.clone())));
        self.tilt.forget_times();
        self.pan.forget_times();
        self.rhythm.forget_times();
        self.trips.forget_times();
        self.body.forget();
        self.still.forget();
        true
    }

    /// The control as it was before the clock jumped, to date what was taken before; `None` unless it
    /// has just jumped.
    pub(super) fn before_jump(&self) -> Option<Self> {
        let (tilt, body) = self.past.as_deref()?.clone();
        Some(Self { tilt, body, past: None, ..self.clone() })
    }

    /// Whether the tilt's own readings tell where it was at `stamp`.
    pub(super) fn reads_at(&self, stamp: Stamp) -> bool {
        const RECENT: Span = Span::from_millis(1_000);
        self.tilt.last_reading().is_some_and(|reading| stamp - reading.stamp < RECENT)
    }

    /// The clock to go by.
    pub(super) fn clock(&self) -> &StampClock {
        match self.clock.latest() {
            Some(_) => &self.clock,
            None => &self.scanner_clock,
        }
    }

    /// The latest stamp at which a command sent `now` is in force; `None` while the server's clock
    /// is unknown.
    ///
    /// Messages that come later than they did mean a slower line, or a server that paused. Readings
    /// tell which; without them it is taken for the slower line.
    pub(super) fn in_force(&self, now: Arrival) -> Option<Stamp> {
        let read = self.clock().latest().is_some_and(|latest| self.reads_at(latest));
        let slower = if read { Span::ZERO } else { self.clock().slower_as_a_rule() };
        // The first answer tells how long commands take; what is sent before it may take any time.
        let bound = (self.latency + slower).max(self.trips.bound(now));
        self.clock().in_force_by(now, bound).filter(|_| !self.awaits_answer(now))
    }

    /// The stamp until which it is known where the tilt was in motion; `None` if it always is: by its
    /// readings, or by its law and the times of commands.
    pub(super) fn sure_until(&self) -> Option<Stamp> {
        let read = self.clock().latest().is_some_and(|latest| self.reads_at(latest));
        let sure = [self.clock().sure_until(), self.trips.sure_until()];
        sure.into_iter().flatten().min().filter(|_| !read)
    }

    /// Takes note that a calibration begins, which measures with whatever messages are late by now.
    pub(super) fn begin_calibration(&mut self, now: Arrival) {
        self.slower_calibrated = self.clock().slower_by();
        self.trips.begin_calibration(now);
    }

    /// Whether messages come later by another time than when a calibration was last begun.
    pub(super) fn is_otherwise_late(&self) -> bool {
        const OTHER: Span = Span::from_millis(80);
        let more = self.clock().slower_by() - self.slower_calibrated;
        more > OTHER || more + OTHER < Span::ZERO
    }

    /// Whether the line changed while a calibration was under way, so that it measured nothing.
    pub(super) fn changed_in_calibration(&self) -> bool {
        self.is_otherwise_late() || self.trips.changed_meanwhile()
    }

    /// Whether messages have come later for so long that another calibration can measure with it.
    pub(super) fn wants_calibration(&self) -> bool {
        let by_answers = self.trips.sure_until().is_some() && self.trips.is_steady();
        let by_stamps = self.clock().is_regular() && self.is_otherwise_late();
        self.sure_until().is_some() && (by_stamps || by_answers)
    }

    /// What a command takes to be obeyed beyond the clock's lower bound, for all that is known.
    pub(super) fn obeyed_within(&self) -> Span {
        let by_answers = self.trips.bound(Arrival::default());
        (self.latency + self.clock().slower_by()).max(by_answers)
    }

    /// Whether it is still to be told how long commands take.
    pub(super) fn awaits_answer(&self, now: Arrival) -> bool {
        self.trips.awaits_first(now)
    }

    /// What questions to the server take to be answered.
    pub(super) fn trips(&self) -> &RoundTrips {
        &self.trips
    }

    /// Goes on with what `other` learnt of the line to the server.
    pub(super) fn keep_line_of(&mut self, other: &Self) {
        self.trips = other.trips.clone();
    }

    /// Asks the server something, if it is time to know how long it takes to answer.
    pub(super) fn query_if_due(&mut self, now: Arrival) -> Option<HeadAction> {
        self.trips.is_due(now).then(|| self.query(now)).flatten()
    }

    /// Asks the server something now, unless an answer is waited for.
    pub(super) fn query(&mut self, now: Arrival) -> Option<HeadAction> {
        let stamp = self.clock().earliest(now).filter(|_| !self.trips.is_waiting(now))?;
        self.trips.ask(stamp, now);
        Some(HeadAction::Query)
    }

    /// By how much messages come later than they did, in words for an operator, where that is much.
    pub(super) fn slowness_remark(&self) -> Option<String> {
        const MUCH: Span = Span::from_millis(300);
        let slower = self.slower_by();
        (slower > MUCH).then(|| {
            format!(
                "messages of the server come {:.1} s later than they did: each row waits for them",
                slower.seconds()
            )
        })
    }

    /// How long the tilt needs to rest within `tolerance_rad` of `target_rad` if told so by a command in
    /// force at `in_force`; `None` if its law is unknown.
    pub(super) fn tilt_settles(
        &self,
        target_rad: f64,
        tolerance_rad: f64,
        in_force: Stamp,
    ) -> Option<Settle> {
        let unsure = self.unsure_until.is_some_and(|until| in_force < until);
        let unsure_rad = if unsure { UNSURE_RAD } else { 0.0 };
        let law = self.tilt_proof?;
        Settle::of(&self.tilt, law, target_rad, tolerance_rad, in_force, unsure_rad)
    }

    /// The same of the pan.
    pub(super) fn pan_settles(
        &self,
        target_rad: f64,
        tolerance_rad: f64,
        in_force: Stamp,
    ) -> Option<Settle> {
        Settle::of(&self.pan, self.pan_proof?, target_rad, tolerance_rad, in_force, 0.0)
    }

    /// Takes over what a calibration found: the model follows the law found. The waiting times keep to
    /// the law that CONF told, unless there is none or the joint is slower than told.
    pub(super) fn adopt(&mut self, fit: &ServoFit, lag: Option<(Span, Span)>) {
        self.tilt.set_law(fit.law);
        // On a slow connection the setting falls short; waiting longer than need be does no harm.
        let measured = fit.delay + fit.time_sigma + fit.time_sigma + DELAY_SPARE;
        self.latency = self.latency.max(measured);
        let slower_than_told = match (self.tilt_proof, fit.law) {
            (
                Some(ServoLaw::Hinge { speed_rad_s: told, gap_rad: told_gap }),
                ServoLaw::Hinge { speed_rad_s, gap_rad },
            ) => speed_rad_s / gap_rad < 0.97 * told / told_gap || speed_rad_s < 0.97 * told,
            (Some(ServoLaw::Hinge { .. }), ServoLaw::Spring { .. }) => true,
            (Some(ServoLaw::Spring { .. }) | None, _) => true,
        };
        if slower_than_told {
            self.tilt_proof = Some(fit.law.derated());
        }
        self.timing = Timing {
            command_delay: fit.delay,
            line_lag: lag.map_or(Span::ZERO, |(lag, _)| lag),
            sigma: lag.map_or(fit.time_sigma, |(_, sigma)| sigma),
            model_sigma_rad: fit.rms_rad,
            speed_sigma: fit.speed_sigma,
            calibrated: true,
        };
        // What messages come later by has been measured with it.
        self.clock.forgive();
        self.scanner_clock.forgive();
        self.trips.calibrated();
        self.slower_calibrated = Span::ZERO;
    }

    /// How late the tilt's readings come, by the last of them: zero on a server that keeps time.
    pub(super) fn readings_late(&self) -> Span {
        self.readings_late
    }

    /// What came out of order since the session began.
    pub(super) fn disorder(&self) -> Disorder {
        self.disorder
    }

    /// Whether the scanner speaks only when it is asked (`SET … Scan`, protocol 4.5): one that speaks
    /// by itself soon has sent more lines than it was asked for.
    pub(super) fn must_ask(&self) -> bool {
        self.rhythm.lines <= self.asks
    }

    /// When the next line may be asked for.
    pub(super) fn may_ask_at(&self) -> Option<Arrival> {
        self.asked.map(|at| at + self.clock().arrival_span(ASK_EVERY))
    }

    /// Asks a scanner that speaks only when asked for its next line, if that is due.
    pub(super) fn ask_if_due(&mut self, now: Arrival) -> Option<HeadAction> {
        let due = self.must_ask()
            && self.clock().latest().is_some()
            && self.may_ask_at().is_none_or(|at| now >= at);
        due.then(|| {
            self.ask(now);
            HeadAction::Ask
        })
    }

    /// Takes note that a line is asked for.
    pub(super) fn ask(&mut self, now: Arrival) {
        self.asked = Some(now);
        self.asks += 1;
    }

    /// When the rays of a line were cast, as far as is known.
    pub fn cast_time(&self, line: &LaserLine) -> Stamp {
        line.stamp + self.timing.line_lag
    }

    /// What calibration found of the times, or what is supposed.
    pub fn timing(&self) -> &Timing {
        &self.timing
    }

    /// Commands the tilt joint and takes note of it.
    pub(super) fn command_tilt(&mut self, demand: Demand, now: Arrival) -> HeadCommand {
        if let Some(stamp) = self.expected_in_force(now) {
            self.tilt.demand(stamp, demand);
        }
        HeadCommand { pan: None, tilt: Some(demand) }
    }

    /// Commands the pan joint and takes note of it.
    pub(super) fn command_pan(&mut self, demand: Demand, now: Arrival) -> HeadCommand {
        if let Some(stamp) = self.expected_in_force(now) {
            self.pan.demand(stamp, demand);
        }
        HeadCommand { pan: Some(demand), tilt: None }
    }

    fn expected_in_force(&self, now: Arrival) -> Option<Stamp> {
        self.clock().earliest(now).map(|stamp| stamp + self.command_delay())
    }

    /// From the clock's lower bound at sending until a command is in force, as far as is known now.
    pub(super) fn command_delay(&self) -> Span {
        let known = self.timing.command_delay;
        match self.timing.calibrated {
            false => self.trips.middle().map_or(known, |measured| measured.max(known)),
            // Messages that have just begun to come late have not yet moved the clock's lower bound.
            true if self.clock().is_regular() => known + self.trips.later_by(),
            true => known,
        }
    }

    /// By how much messages come later than they did, by their stamps or by answers.
    pub(super) fn slower_by(&self) -> Span {
        self.clock().slower_by().max(self.trips.slower_by())
    }

    /// The head's joints and mounts.
    pub fn head(&self) -> &ScanHead {
        &self.head
    }

    /// The scan frame: the sensor at zero pan and tilt.
    pub(super) fn robot_from_scan(&self) -> Isometry3<f64> {
        self.head.robot_from_device(HeadPose::default())
    }

    /// The sensor under `pose` in the scan frame.
    pub(super) fn scan_from_sensor(&self, pose: HeadPose) -> Isometry3<f64> {
        self.robot_from_scan().inverse() * self.head.robot_from_device(pose)
    }
}

/// Times until a joint rests at a target, in seconds of simulated time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Settle {
    /// Slewing at full speed.
    pub slew_s: f64,
    /// In all.
    pub total_s: f64,
}

impl Settle {
    /// The command may have come into force earlier than `in_force`, while the joint was still on
    /// its way to the target before; what that one was allowed to be off is added for it.
    fn of(
        track: &AxisTrack,
        law: ServoLaw,
        target_rad: f64,
        tolerance_rad: f64,
        in_force: Stamp,
        unsure_rad: f64,
    ) -> Option<Self> {
        let error = track.error_bound_rad(target_rad, in_force) + tolerance_rad + unsure_rad;
        let total_s = law.settle_s(error, tolerance_rad);
        Some(Self { slew_s: law.slew_s(error), total_s })
    }
}
