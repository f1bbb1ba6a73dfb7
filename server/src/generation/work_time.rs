//! The time that a piece of work of a thread takes, by clocks that a test can replace.

use std::time::{Duration, Instant};

/// The clocks that work is measured by.
pub trait WorkClock: Send + Sync + 'static {
    /// Time since a moment that never changes.
    fn clock(&self) -> Duration;

    /// Processor time of this thread so far: without pauses of the thread, and without waits for a
    /// disk or a store. 0 where it is not known.
    fn processor(&self) -> Duration;
}

/// The clocks of the system.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock {
    start: Instant,
}

impl Default for SystemClock {
    fn default() -> Self {
        Self { start: Instant::now() }
    }
}

impl WorkClock for SystemClock {
    fn clock(&self) -> Duration {
        self.start.elapsed()
    }

    #[cfg(target_os = "linux")]
    fn processor(&self) -> Duration {
        use rustix::time::{ClockId, clock_gettime};
        let time = clock_gettime(ClockId::ThreadCPUTime);
        Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
    }

    #[cfg(not(target_os = "linux"))]
    fn processor(&self) -> Duration {
        Duration::ZERO
    }
}

/// The time that a piece of work took, or the readings of both clocks at its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorkTime {
    /// See [`WorkClock::clock`].
    pub clock: Duration,
    /// See [`WorkClock::processor`].
    pub processor: Duration,
}

impl WorkTime {
    /// The readings of both clocks.
    pub fn now(clock: &dyn WorkClock) -> Self {
        Self { clock: clock.clock(), processor: clock.processor() }
    }

    /// The time since these readings.
    pub fn elapsed(&self, clock: &dyn WorkClock) -> Self {
        let now = Self::now(clock);
        Self {
            clock: now.clock.saturating_sub(self.clock),
            processor: now.processor.saturating_sub(self.processor),
        }
    }
}
