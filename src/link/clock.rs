//! The session's monotonic clock.

use crate::time::Arrival;
use tokio::time::Instant;

/// Tells the time since the session began; copies tell the same time.
///
/// The shell's one clock: what arrives and what is due is measured with it. It stands still with
/// tokio's paused time.
#[derive(Clone, Copy, Debug)]
pub struct SessionClock {
    began: Instant,
}

impl SessionClock {
    /// A clock that shows 0 now.
    pub fn start() -> Self {
        Self { began: Instant::now() }
    }

    /// The time now.
    pub fn now(&self) -> Arrival {
        Arrival(i64::try_from(self.began.elapsed().as_nanos()).unwrap_or(i64::MAX))
    }

    /// The instant that `arrival` names, to sleep until; one before the session is its beginning.
    pub fn instant(&self, arrival: Arrival) -> Instant {
        let nanos = u64::try_from(arrival.0).unwrap_or(0);
        self.began + std::time::Duration::from_nanos(nanos)
    }
}
