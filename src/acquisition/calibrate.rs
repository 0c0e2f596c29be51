//! The calibration motion: how the tilt follows its set-point, and when commands and rays take effect.

use super::config::AcquisitionConfig;
use super::control::HeadControl;
use super::fix::TiltReference;
use super::identify::{MOST_DELAY, Observation, ServoFit, identify, lag_of};
use super::profile::{Profile, QuarterDegrees};
use super::scan::Scan;
use super::sweep::Sweep;
use super::track::AxisTrack;
use super::{HeadAction, HeadEvent};
use crate::robot::{Demand, GroundView};
use crate::scan::LaserLine;
use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};

/// What a calibration found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationReport {
    /// The servo law and the delay of commands, if one explains the motion.
    pub fit: Option<ServoFit>,
    /// How far the casting of rays lags the stamps of lines, and its standard deviation; `None` if
    /// the laser's view told nothing, or if there were no readings to hold it against, in which case
    /// the lag is part of the fit's delay.
    pub line_lag: Option<(Span, Span)>,
    /// Readings used.
    pub readings: usize,
    /// Lines whose tilt the laser's view told.
    pub fixes: usize,
    /// Lines taken in motion.
    pub lines: usize,
    /// Session seconds it took.
    pub seconds: f64,
    /// What was found, in plain words.
    pub text: String,
    /// What an operator should know of it: that commands take long to be obeyed.
    pub warning: Option<String>,
}

/// A delay of commands that a server on the same network does not have.
const LONG_DELAY: Span = Span::from_millis(120);

/// A reference sweep at rest, then jumps and small steps across it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    stage: Stage,
    started: Arrival,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Stage {
    Reference(Box<Sweep>),
    Moving(Box<Moving>),
    Finished,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Moving {
    reference: Option<TiltReference>,
    /// What is still to be demanded, last first.
    script: Vec<Motion>,
    lines_left: u32,
    /// Lines stamped from here on show what was told last.
    shown_from: Stamp,
    /// When the next motion is due, once the lines after the last one have come.
    next_at: Option<Arrival>,
    start_rad: f64,
    began: Stamp,
    commands: Vec<(Stamp, Demand)>,
    lines: Vec<LaserLine>,
    deadline: Arrival,
}

/// One motion of the calibration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Motion {
    tilt: QuarterDegrees,
    /// When it is demanded, in intervals after the last line: motions that all began with a line would
    /// leave speed and delay to be mistaken for one another.
    phase: f64,
    /// Lines to wait for after it.
    lines: u32,
}

/// How far the stamps of lines may run ahead of what they show: then the lag stands in the delay.
const LINES_LAG: Span = Span::from_millis(-1000);

/// The same where the line to the server was measured: no line is cast later than the next but one.
const LINES_AHEAD: Span = Span::from_millis(500);
/// What a command may take longer to be obeyed than a question to be answered: some frames.
const UNSURE: Span = Span::from_millis(150);
/// A line stamped this long before a command is in force may be the next one after it: UT2004 stamps
/// lines with the time of the burst before.
const STAMPED_EARLY: Span = Span::from_millis(300);

/// Rows of the reference sweep, one degree apart.
const REFERENCE_ROWS: i32 = 9;
const REFERENCE_STEP: i32 = 4;

/// The tilts to calibrate over: eight degrees that see ground at a middling distance, moved to where
/// the link's limits allow. Empty for a laser that cannot tilt.
pub(super) fn reference_profile(view: Option<&GroundView<'_>>, control: &HeadControl) -> Profile {
    let Some(axis) = control.head().tilt() else {
        return Profile { name: "calibration".into(), tilts: Vec::new() };
    };
    // Ground two to six metres ahead shows a change of tilt best; without a height known, 6° to 14°.
    let wanted = view
        .and_then(|v| v.tilt_for_ground_ahead(6.0))
        .map_or(24, |t| QuarterDegrees::nearest(t).0);
    let span = (REFERENCE_ROWS - 1) * REFERENCE_STEP;
    let (low, high) = axis.limits.map_or((i32::MIN, i32::MAX), |limits| {
        let quarter = |rad: f64| rad / super::QUARTER_DEGREE_RAD;
        (quarter(limits.min_rad).ceil() as i32, quarter(limits.max_rad).floor() as i32)
    });
    let first = wanted.min(high.saturating_sub(span)).max(low);
    let tilts = (0..REFERENCE_ROWS).map(|i| QuarterDegrees(first + i * REFERENCE_STEP)).collect();
    Profile { name: "calibration".into(), tilts }
}

impl Calibration {
    /// Begins with the reference sweep.
    pub(super) fn start(
        profile: Profile,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> (Self, Vec<HeadAction>) {
        control.begin_calibration(now);
        let limits = control.head().tilt().and_then(|axis| axis.limits);
        let (profile, _) = profile.clipped(limits);
        let tolerance = config.tolerance_deg.to_radians();
        let (sweep, actions) = Sweep::start(profile, 0.0, tolerance, control, config, now);
        let mut calibration = Self { stage: Stage::Reference(Box::new(sweep)), started: now };
        let actions = calibration.pass_on(actions, control, config, now);
        (calibration, actions)
    }

    /// Whether all is done.
    pub fn is_finished(&self) -> bool {
        self.stage == Stage::Finished
    }

    /// Whether the tilt is moved, the reference sweep being over.
    pub(super) fn is_moving(&self) -> bool {
        matches!(self.stage, Stage::Moving(_))
    }

    /// When the calibration must be called again even if nothing arrives.
    pub fn next_wakeup(&self) -> Option<Arrival> {
        match &self.stage {
            Stage::Reference(sweep) => sweep.next_wakeup(),
            Stage::Moving(moving) => Some(moving.next_at.unwrap_or(moving.deadline)),
            Stage::Finished => None,
        }
    }

    /// Takes an event that `control` has already noted; `jumped` if the server's clock did.
    pub(super) fn handle(
        &mut self,
        event: &HeadEvent<'_>,
        jumped: bool,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> Vec<HeadAction> {
        match &mut self.stage {
            Stage::Reference(sweep) => {
                let actions = sweep.handle(event, jumped, control, config, now);
                self.pass_on(actions, control, config, now)
            }
            Stage::Moving(_) if jumped => {
                vec![self.give_up("the server's clock jumped during the calibration", now)]
            }
            Stage::Moving(moving) => {
                if let HeadEvent::Line(line) = event
                    && control.rhythm.is_whole(line)
                {
                    moving.lines.push((*line).clone());
                    if line.stamp >= moving.shown_from {
                        moving.lines_left = moving.lines_left.saturating_sub(1);
                    }
                    moving.deadline = now + patience(control, config);
                    if moving.lines_left == 0 && moving.next_at.is_none() {
                        let phase = moving.script.last().map_or(0.0, |motion| motion.phase);
                        let wait = phase * control.rhythm.interval().seconds();
                        moving.next_at =
                            Some(now + control.clock().arrival_span(Span::from_seconds(wait)));
                    }
                }
                if moving.next_at.is_some_and(|at| now >= at) {
                    return self.next_motion(control, now);
                }
                if now >= moving.deadline {
                    return vec![self.give_up("the laser fell silent during the calibration", now)];
                }
                Vec::new()
            }
            Stage::Finished => Vec::new(),
        }
    }

    /// Hands on the reference sweep's actions, and begins the motion when it is over.
    fn pass_on(
        &mut self,
        actions: Vec<HeadAction>,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> Vec<HeadAction> {
        let mut handed_on = Vec::new();
        for action in actions {
            match action {
                HeadAction::Finished(scan) => {
                    handed_on.extend(self.begin_motion(&scan, control, config, now));
                }
                HeadAction::Filed { .. } => {}
                other => handed_on.push(other),
            }
        }
        handed_on
    }

    fn begin_motion(
        &mut self,
        scan: &Scan,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> Vec<HeadAction> {
        let rows = scan.image.rows();
        let (Some(first), Some(last), Some(began)) =
            (rows.first(), rows.last(), control.clock().earliest(now))
        else {
            return vec![self.give_up("no reference sweep could be taken", now)];
        };
        if scan.filed < 2 {
            return vec![self.give_up("no reference sweep could be taken", now)];
        }
        // One row in from either end, so that the tilt rests where the reference can tell it.
        let towards = if first.tilt_rad > last.tilt_rad { 1 } else { -1 };
        let inwards = |end: f64, sign: i32| {
            QuarterDegrees(QuarterDegrees::nearest(end).0 + sign * REFERENCE_STEP)
        };
        let (here, there) = (inwards(last.tilt_rad, towards), inwards(first.tilt_rad, -towards));
        // A jump there and back shows speed, gap and delay; steps as small and as frequent as a
        // sweep's show what matters for it; the last jump checks.
        let jump = |tilt, phase, lines| Motion { tilt, phase, lines };
        let lines = lines_to_settle((there.radians() - here.radians()).abs(), control);
        let mut script = vec![jump(there, 0.0, lines.max(8)), jump(here, 0.35, lines.max(9))];
        let steps = (1..=10).map(|i| QuarterDegrees(here.0 + i * towards));
        script.extend(steps.map(|tilt| Motion { tilt, phase: 0.0, lines: 1 }));
        script.extend([jump(there, 0.7, lines.max(7)), jump(here, 0.5, lines.max(7))]);
        script.reverse();
        self.stage = Stage::Moving(Box::new(Moving {
            reference: TiltReference::of(&scan.image),
            script,
            lines_left: 0,
            shown_from: Stamp(i64::MIN),
            next_at: None,
            start_rad: last.tilt_rad,
            began,
            commands: Vec::new(),
            lines: Vec::new(),
            deadline: now + patience(control, config),
        }));
        self.next_motion(control, now)
    }

    fn next_motion(&mut self, control: &mut HeadControl, now: Arrival) -> Vec<HeadAction> {
        let Stage::Moving(moving) = &mut self.stage else { return Vec::new() };
        let Some(motion) = moving.script.pop() else {
            return vec![self.solve(control, now)];
        };
        let demand = Demand::Angle(motion.tilt.radians());
        if let Some(stamp) = control.clock().earliest(now) {
            moving.commands.push((stamp, demand));
        }
        (moving.lines_left, moving.next_at) = (motion.lines, None);
        // Jumps have to be seen to their end, however late lines come; small steps follow one another as
        // in a sweep.
        let seen = motion.lines > 1;
        let in_force = control.in_force(now).filter(|_| seen);
        moving.shown_from = in_force.map_or(Stamp(i64::MIN), |stamp| stamp - STAMPED_EARLY);
        vec![HeadAction::Send(control.command_tilt(demand, now))]
    }

    fn solve(&mut self, control: &mut HeadControl, now: Arrival) -> HeadAction {
        let Stage::Moving(moving) = std::mem::replace(&mut self.stage, Stage::Finished) else {
            return self.give_up("nothing was measured", now);
        };
        if control.changed_in_calibration() {
            control.begin_calibration(now);
            let why = "the line to the server became slower during the calibration";
            return self.give_up(why, now);
        }
        let limits = control.head().tilt().and_then(|axis| axis.limits);
        let readings: Vec<Observation> = control
            .tilt
            .readings()
            .iter()
            .filter(|reading| reading.stamp >= moving.began)
            .map(|r| Observation {
                stamp: r.stamp,
                angle_rad: r.angle_rad,
                sigma_rad: r.half_width_rad,
            })
            .collect();
        let fixes: Vec<Observation> = moving
            .lines
            .iter()
            .filter_map(|line| {
                let fix = moving.reference.as_ref()?.fix(line)?;
                let (angle_rad, sigma_rad) = (fix.tilt_rad, fix.sigma_rad);
                Some(Observation { stamp: line.stamp, angle_rad, sigma_rad })
            })
            .collect();
        let prior = control.tilt.law();
        let law_of = |seen: &[Observation], least: Span| {
            let delays = delays(control, least);
            identify(moving.start_rad, limits, &moving.commands, seen, prior, delays)
        };
        // Readings and commands are on one clock. The stamps of lines lag by what nobody has told.
        let by_readings = law_of(&readings, Span::ZERO);
        let line_lag = by_readings.as_ref().and_then(|fit| {
            let mut track = AxisTrack::new(Some(fit.law), limits, moving.start_rad);
            for &(stamp, demand) in &moving.commands {
                track.demand(stamp + fit.delay, demand);
            }
            for reading in control.tilt.readings().iter().filter(|r| r.stamp >= moving.began) {
                track.read(*reading);
            }
            lag_of(&track, &fixes)
        });
        // Readings without a dated line leave the lag unknown by half an interval either way.
        let supposed = by_readings.as_ref().filter(|_| line_lag.is_none()).map(|_| {
            let half = 0.5 * control.rhythm.interval().seconds();
            (Span::from_seconds(half), Span::from_seconds(half / 3.0_f64.sqrt()))
        });
        let read = by_readings.is_some();
        let fit = by_readings.or_else(|| law_of(&fixes, LINES_LAG));
        if let Some(fit) = &fit {
            control.adopt(fit, line_lag.or(supposed));
        }
        let report = CalibrationReport {
            fit,
            line_lag,
            readings: readings.len(),
            fixes: fixes.len(),
            lines: moving.lines.len(),
            seconds: (now - self.started).seconds(),
            text: describe(fit.as_ref(), read, line_lag, (readings.len(), fixes.len())),
            warning: fit.map_or_else(|| slow_line(control), |fit| (fit.delay > LONG_DELAY).then(|| {
                format!(
                    "the line to the server is slow: commands are obeyed {} {:.0} ms after they are \
                     sent, and every wait is that much longer",
                    if read { "about" } else { "at least" },
                    1e3 * fit.delay.seconds()
                )
            })),
        };
        HeadAction::Calibrated(Box::new(report))
    }

    fn give_up(&mut self, why: &str, now: Arrival) -> HeadAction {
        self.stage = Stage::Finished;
        HeadAction::Calibrated(Box::new(CalibrationReport {
            fit: None,
            line_lag: None,
            readings: 0,
            fixes: 0,
            lines: 0,
            seconds: (now - self.started).seconds(),
            text: format!("{why}: scans are taken with the tilt at rest"),
            warning: None,
        }))
    }
}

/// What to say of a line that was measured to be slow though no law was found.
fn slow_line(control: &HeadControl) -> Option<String> {
    let (_, longest) = control.trips().calibrated_span()?;
    (longest > LONG_DELAY).then(|| {
        format!(
            "the line to the server is slow: it answers after {:.0} ms, and every wait is that much longer",
            1e3 * longest.seconds()
        )
    })
}

/// The least and the most that a command may take to be obeyed: what questions took to be answered
/// meanwhile, and no less than `least`.
fn delays(control: &HeadControl, least: Span) -> (Span, Span) {
    match control.trips().calibrated_span() {
        // What the stamps of lines run ahead of what they show is taken off the delay.
        Some((shortest, longest)) => ((shortest - LINES_AHEAD).max(least), longest + UNSURE),
        None => (least, MOST_DELAY),
    }
}

/// Lines that come while the tilt settles after a jump, as far as its law is known: one that is cut short
/// tells the speed badly.
fn lines_to_settle(jump_rad: f64, control: &HeadControl) -> u32 {
    const SETTLED_RAD: f64 = 0.005;
    const MOST: f64 = 40.0;
    let settle_s = control.tilt.law().map_or(0.0, |law| law.settle_s(jump_rad, SETTLED_RAD));
    let lines = (settle_s / control.rhythm.interval().seconds().max(0.01)).ceil() + 2.0;
    lines.min(MOST) as u32
}

fn patience(control: &HeadControl, config: &AcquisitionConfig) -> Span {
    let lines = Span::from_seconds(3.0 * control.rhythm.interval().seconds());
    control.clock().arrival_span(lines) + config.row_timeout()
}

fn describe(
    fit: Option<&ServoFit>,
    read: bool,
    line_lag: Option<(Span, Span)>,
    (readings, fixes): (usize, usize),
) -> String {
    let Some(fit) = fit else {
        return format!(
            "no servo law explains the motion ({readings} readings, {fixes} lines of known tilt): \
             scans are taken with the tilt at rest"
        );
    };
    let law = match fit.law {
        super::ServoLaw::Hinge { speed_rad_s, gap_rad } => {
            format!("hinge of {speed_rad_s:.3} rad/s with a gap of {:.2}°", gap_rad.to_degrees())
        }
        super::ServoLaw::Spring { frequency_rad_s, damping } => {
            format!("spring of {frequency_rad_s:.1} rad/s damped by {damping:.2}")
        }
    };
    let delay_ms = 1e3 * fit.delay.seconds();
    let times = match line_lag {
        Some((lag, sigma)) => format!(
            "commands obeyed after {delay_ms:.0} ms, lines lag {:.0} ± {:.0} ms",
            1e3 * lag.seconds(),
            1e3 * sigma.seconds()
        ),
        None if read => {
            format!("commands obeyed after {delay_ms:.0} ms, lag of the lines unknown")
        }
        // What the laser alone tells is how commands and the stamps of lines lie to one another.
        None => format!("delay of commands less lag of lines {delay_ms:.0} ms"),
    };
    format!(
        "{law}, {times}; {:.3}° rms over {} of {} observations",
        fit.rms_rad.to_degrees(),
        fit.explained.0,
        fit.explained.1
    )
}
