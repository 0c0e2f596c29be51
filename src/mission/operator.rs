//! What an operator can do, and the lease under which a drive command lives.

use crate::time::{Arrival, Span};
use serde::{Deserialize, Serialize};

/// How long a drive command moves the robot unless it is renewed: a dead-man's switch that needs
/// no message to open.
pub const DRIVE_LEASE: Span = Span::from_millis(300);

/// Who decides where the robot goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The robot; an operator's drive commands are refused and logged.
    #[default]
    Auto,
    /// The robot, and the operator while holding the drive lease.
    Shared,
    /// The operator alone; without a lease the robot stands.
    Teleop,
}

/// One act of an operator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum OperatorEvent {
    /// Drive like this until the lease ends.
    Drive {
        /// Forward speed in m/s, negative backwards.
        linear_mps: f64,
        /// Turning speed in rad/s, positive to the left.
        angular_rps: f64,
    },
    /// Stop and give the lease back.
    Stop,
    /// Change who decides.
    SetMode(Mode),
    /// Take a scan where the robot stands.
    ScanNow,
    /// End the mission.
    Quit,
}

/// Why an operator event could not be read from a recording.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("operator event of {length} bytes is not readable: {reason}")]
pub struct OperatorDecodeError {
    length: usize,
    reason: String,
}

impl OperatorEvent {
    /// The event as bytes for a recording.
    ///
    /// # Panics
    ///
    /// Never: encoding into memory cannot fail for this type.
    pub fn encode(&self) -> Vec<u8> {
        postcard::to_stdvec(self).expect("a plain enum of numbers always encodes")
    }

    /// The event of recorded bytes.
    ///
    /// # Errors
    ///
    /// When the bytes are not exactly one event.
    pub fn decode(bytes: &[u8]) -> Result<Self, OperatorDecodeError> {
        let fail = |reason: String| OperatorDecodeError { length: bytes.len(), reason };
        match postcard::take_from_bytes(bytes) {
            Ok((event, [])) => Ok(event),
            Ok((_, rest)) => Err(fail(format!("{} bytes left over", rest.len()))),
            Err(error) => Err(fail(error.to_string())),
        }
    }
}

/// The drive command an operator holds, and until when it counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DriveLease {
    held: Option<Held>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Held {
    linear_mps: f64,
    angular_rps: f64,
    ends: Arrival,
}

impl DriveLease {
    /// Takes or renews the lease. A speed that is not a number counts as standing still.
    pub fn renew(&mut self, linear_mps: f64, angular_rps: f64, now: Arrival) {
        let finite = |speed: f64| if speed.is_finite() { speed } else { 0.0 };
        self.held = Some(Held {
            linear_mps: finite(linear_mps),
            angular_rps: finite(angular_rps),
            ends: now + DRIVE_LEASE,
        });
    }

    /// Gives the lease back.
    pub fn release(&mut self) {
        self.held = None;
    }

    /// The commanded speeds (m/s, rad/s) while the lease runs; it ends *at* its end.
    pub fn command(&self, now: Arrival) -> Option<(f64, f64)> {
        self.held.filter(|held| now < held.ends).map(|held| (held.linear_mps, held.angular_rps))
    }

    /// When the running lease ends.
    pub fn ends(&self) -> Option<Arrival> {
        self.held.map(|held| held.ends)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lease_ends_after_300_ms_without_renewal() {
        let mut lease = DriveLease::default();
        let start = Arrival::from_seconds(5.0);
        lease.renew(0.4, 0.0, start);
        assert!(lease.command(start + Span::from_millis(299)).is_some());
        assert!(lease.command(start + Span::from_millis(300)).is_none());
        lease.renew(0.4, 0.1, start + Span::from_millis(250));
        assert_eq!(lease.command(start + Span::from_millis(500)), Some((0.4, 0.1)));
    }

    #[test]
    fn a_speed_that_is_no_number_is_standing_still() {
        let mut lease = DriveLease::default();
        lease.renew(f64::NAN, f64::INFINITY, Arrival(0));
        assert_eq!(lease.command(Arrival(1)), Some((0.0, 0.0)));
    }

    #[test]
    fn events_survive_the_recording() {
        let events = [
            OperatorEvent::Drive { linear_mps: -0.2, angular_rps: 0.7 },
            OperatorEvent::Stop,
            OperatorEvent::SetMode(Mode::Teleop),
            OperatorEvent::ScanNow,
            OperatorEvent::Quit,
        ];
        for event in events {
            assert_eq!(OperatorEvent::decode(&event.encode()).unwrap(), event);
        }
        assert!(OperatorEvent::decode(&[9, 9, 9]).is_err());
        assert!(OperatorEvent::decode(&[1, 0]).is_err());
    }
}
