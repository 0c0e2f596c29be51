//! The three kinds of time: [`Stamp`] labels measurements, [`Arrival`] drives decisions, [`Span`]
//! is the distance between two of a kind.
//!
//! Estimation uses the simulator's own time ([`Stamp`]); waits and watchdogs use the session's
//! monotonic clock ([`Arrival`]). The types keep the two from being subtracted from one another.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::{Add, AddAssign, Neg, Sub};

const NANOS_PER_SECOND: f64 = 1e9;

/// Nanoseconds of simulated level time, as the server stamped a message.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Stamp(pub i64);

/// Monotonic nanoseconds since the session began: wall time live, simulated time in lockstep,
/// recorded time in replay.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Arrival(pub i64);

/// A signed difference of two [`Stamp`]s or of two [`Arrival`]s, in nanoseconds.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Span(pub i64);

impl Span {
    /// No time at all.
    pub const ZERO: Self = Self(0);

    /// The span of `seconds`, rounded to a nanosecond; saturates beyond ±292 years.
    pub fn from_seconds(seconds: f64) -> Self {
        Self((seconds * NANOS_PER_SECOND).round() as i64)
    }

    /// The span of a whole number of milliseconds.
    pub const fn from_millis(millis: i64) -> Self {
        Self(millis * 1_000_000)
    }

    /// This span in seconds.
    pub fn seconds(self) -> f64 {
        self.0 as f64 / NANOS_PER_SECOND
    }
}

impl Stamp {
    /// The stamp `seconds` after the level began, rounded to a nanosecond.
    pub fn from_seconds(seconds: f64) -> Self {
        Self(Span::from_seconds(seconds).0)
    }

    /// Seconds since the level began.
    pub fn seconds(self) -> f64 {
        Span(self.0).seconds()
    }
}

impl Arrival {
    /// The arrival `seconds` after the session began, rounded to a nanosecond.
    pub fn from_seconds(seconds: f64) -> Self {
        Self(Span::from_seconds(seconds).0)
    }

    /// Seconds since the session began.
    pub fn seconds(self) -> f64 {
        Span(self.0).seconds()
    }
}

macro_rules! instant_arithmetic {
    ($instant:ty) => {
        impl Sub for $instant {
            type Output = Span;
            fn sub(self, earlier: Self) -> Span {
                Span(self.0.saturating_sub(earlier.0))
            }
        }
        impl Add<Span> for $instant {
            type Output = Self;
            fn add(self, span: Span) -> Self {
                Self(self.0.saturating_add(span.0))
            }
        }
        impl Sub<Span> for $instant {
            type Output = Self;
            fn sub(self, span: Span) -> Self {
                Self(self.0.saturating_sub(span.0))
            }
        }
        impl fmt::Display for $instant {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{:.3} s", self.seconds())
            }
        }
    };
}

instant_arithmetic!(Stamp);
instant_arithmetic!(Arrival);

impl Add for Span {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl Sub for Span {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl Neg for Span {
    type Output = Self;
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

impl AddAssign for Span {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} s", self.seconds())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_decimal_stamps_survive_the_round_trip() {
        for hundredths in [0_i64, 1, 508_582, 99_999_999] {
            let seconds = hundredths as f64 / 100.0;
            assert_eq!(Stamp::from_seconds(seconds).0, hundredths * 10_000_000);
        }
    }

    #[test]
    fn arithmetic_saturates_instead_of_wrapping() {
        assert_eq!(Stamp(i64::MAX) + Span(1), Stamp(i64::MAX));
        assert_eq!(Arrival(i64::MIN) - Arrival(1), Span(i64::MIN));
    }
}
