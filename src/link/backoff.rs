//! How often and how soon to try again.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Bounded exponential back-off: each wait is twice the one before, up to a bound.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Backoff {
    /// Attempts to connect, 1–1000; 0 counts as 1.
    pub attempts: u32,
    /// Milliseconds before the second attempt, 1–60 000.
    pub first_wait_ms: u64,
    /// Longest wait in milliseconds, at least `first_wait_ms`, at most 60 000.
    pub max_wait_ms: u64,
    /// Milliseconds that one attempt may take, 1–60 000.
    pub attempt_limit_ms: u64,
}

impl Default for Backoff {
    fn default() -> Self {
        // Five attempts within four seconds: long enough for a server that is being started beside
        // the agent, short enough for a person who mistyped the port.
        Self { attempts: 5, first_wait_ms: 250, max_wait_ms: 2000, attempt_limit_ms: 3000 }
    }
}

impl Backoff {
    /// A single attempt.
    pub fn once() -> Self {
        Self { attempts: 1, ..Self::default() }
    }

    pub(super) fn attempt_limit(&self) -> Duration {
        Duration::from_millis(self.attempt_limit_ms)
    }

    /// The wait before an attempt, counted from 1; the first needs none.
    pub fn wait_before(&self, attempt: u32) -> Duration {
        let Some(doublings) = attempt.checked_sub(2) else { return Duration::ZERO };
        let factor = 1_u64.checked_shl(doublings).unwrap_or(u64::MAX);
        Duration::from_millis(self.first_wait_ms.saturating_mul(factor).min(self.max_wait_ms))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_bound() {
        let backoff = Backoff { first_wait_ms: 100, max_wait_ms: 500, ..Backoff::default() };
        let waits: Vec<_> =
            [1, 2, 3, 4, 5, 90].map(|n| backoff.wait_before(n).as_millis()).into_iter().collect();
        assert_eq!(waits, [0, 100, 200, 400, 500, 500]);
    }
}
