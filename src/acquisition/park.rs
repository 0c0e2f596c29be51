use super::HeadCommand;
use super::config::AcquisitionConfig;
use super::control::{HeadControl, Settle};
use super::track::Verdict;
use crate::robot::{Demand, HeadPose};
use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};

/// Whether the head is where it was parked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ParkState {
    /// Nobody parked it, or a sweep has moved it since.
    NotParked,
    /// On its way.
    Moving,
    /// A sweep is taken while the robot drives: there is no guard line.
    Nodding,
    /// There by computation; the rig sends no readings.
    Computed {
        /// Lines stamped from here on were taken under `pose`.
        since: Stamp,
        /// Where it is parked.
        pose: HeadPose,
    },
    /// There, and a reading says so.
    Verified {
        /// Lines stamped from here on were taken under `pose`.
        since: Stamp,
        /// Where it is parked.
        pose: HeadPose,
    },
    /// It should be there, but reads otherwise: the head is stuck or its limits are narrower.
    Elsewhere {
        /// The tilt that was read, in radians.
        tilt_rad: f64,
    },
}

impl ParkState {
    /// Whether a line stamped `stamp` was taken with the head parked.
    pub fn covers(&self, stamp: Stamp) -> bool {
        match *self {
            Self::Computed { since, .. } | Self::Verified { since, .. } => stamp >= since,
            Self::NotParked | Self::Moving | Self::Nodding | Self::Elsewhere { .. } => false,
        }
    }
}

/// The head on its way to, or at, a place where it is to stay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Park {
    pose: HeadPose,
    /// From this stamp on the head is there by computation; `None` until the server's clock is known.
    settled: Option<Stamp>,
    /// From this stamp on it was told a second time, the laser having seen nothing turn.
    told_again: Option<Stamp>,
}

/// The guard line needs no more: a quarter of a degree moves it by a few centimetres.
const TOLERANCE_RAD: f64 = super::QUARTER_DEGREE_RAD;
/// Time given to a second command beyond its settling, a few lines long.
const LOOKS_AGAIN: Span = Span::from_millis(1_000);

impl Park {
    pub(super) fn start(
        pose: HeadPose,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> (Self, Vec<HeadCommand>) {
        let reachable = HeadPose {
            pan_rad: control.head().pan().map_or(0.0, |axis| axis.clamp(pose.pan_rad)),
            tilt_rad: control.head().tilt().map_or(0.0, |axis| axis.clamp(pose.tilt_rad)),
        };
        let mut park = Self { pose: reachable, settled: None, told_again: None };
        let commands = park.command(control, config, now);
        (park, commands)
    }

    fn command(
        &mut self,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> Vec<HeadCommand> {
        let Some(in_force) = control.in_force(now) else { return Vec::new() };
        let settle_span = |settle: Option<Settle>| {
            Span::from_seconds(settle.map_or(config.unknown_settle_s, |settle| settle.total_s))
        };
        let mut settled = in_force;
        let mut commands = Vec::new();
        if control.head().tilt().is_some() {
            let settle = control.tilt_settles(self.pose.tilt_rad, TOLERANCE_RAD, in_force);
            settled = settled.max(in_force + settle_span(settle));
            commands.push(control.command_tilt(Demand::Angle(self.pose.tilt_rad), now));
        }
        if control.head().pan().is_some() {
            let settle = control.pan_settles(self.pose.pan_rad, TOLERANCE_RAD, in_force);
            settled = settled.max(in_force + settle_span(settle));
            commands.push(control.command_pan(Demand::Angle(self.pose.pan_rad), now));
        }
        self.settled = Some(settled);
        commands
    }

    /// Commands the head anew when the server's clock has become known or has jumped.
    pub(super) fn handle(
        &mut self,
        jumped: bool,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> Vec<HeadCommand> {
        if jumped || self.settled.is_none() {
            return self.command(control, config, now);
        }
        self.heed_laser(control, config, now)
    }

    /// A tilt that the laser does not see turning is told once more, and then taken to rest where it is.
    fn heed_laser(
        &mut self,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> Vec<HeadCommand> {
        let Some(unmoved) = control.unmoved() else {
            self.told_again = None;
            return Vec::new();
        };
        match (self.told_again, control.still().newest()) {
            (None, _) => {
                let commands = self.command(control, config, now);
                self.told_again = self.settled;
                commands
            }
            (Some(settled), Some(newest)) if newest > settled + LOOKS_AGAIN => {
                control.rests_at(unmoved.rest_rad, unmoved.towards);
                self.told_again = None;
                // As near to it as the tilt reaches.
                let limits = control.reach().limits();
                self.pose.tilt_rad =
                    limits.map_or(self.pose.tilt_rad, |l| l.clamp(self.pose.tilt_rad));
                self.command(control, config, now)
            }
            _ => Vec::new(),
        }
    }

    pub(super) fn state(&self, control: &HeadControl, now: Arrival) -> ParkState {
        let (Some(settled), Some(server)) = (self.settled, control.clock().earliest(now)) else {
            return ParkState::Moving;
        };
        let verdict =
            control.tilt.verdict(self.pose.tilt_rad, TOLERANCE_RAD, settled, Stamp(i64::MAX));
        let (since, pose) = (settled, self.pose);
        // Where a stuck tilt rests is known to a step of the sweep that found it: no guard.
        let stuck = control.reach().stuck_rad().filter(|_| verdict == Verdict::Unverified);
        if let Some(tilt_rad) = stuck {
            return ParkState::Elsewhere { tilt_rad };
        }
        match verdict {
            Verdict::Confirmed => ParkState::Verified { since, pose },
            Verdict::Contradicted { .. } if control.tilt.moves(Some(server)) => ParkState::Moving,
            Verdict::Contradicted { angle_rad } => ParkState::Elsewhere { tilt_rad: angle_rad },
            Verdict::Unverified if server < settled => ParkState::Moving,
            // A rig whose readings are merely due is given a moment to send the next one.
            Verdict::Unverified if reads(control, server) => ParkState::Moving,
            // Nor is a tilt there that the laser saw no turn of.
            Verdict::Unverified if control.still().suspects() => ParkState::Moving,
            Verdict::Unverified => ParkState::Computed { since, pose },
        }
    }
}

/// Whether readings are coming in.
fn reads(control: &HeadControl, server: Stamp) -> bool {
    const RECENT: Span = Span::from_millis(700);
    control.tilt.last_reading().is_some_and(|reading| server - reading.stamp < RECENT)
}
