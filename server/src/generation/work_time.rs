//! The time that a piece of work of a thread takes.

use std::time::{Duration, Instant};

/// The start of a piece of work on this thread.
#[derive(Clone, Copy, Debug)]
pub struct WorkStart {
    clock: Instant,
    processor: Duration,
}

/// The time that a piece of work took.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorkTime {
    /// On the clock.
    pub clock: Duration,
    /// Of the processor: without pauses of the thread, and without waits for a disk or a store. 0
    /// where the system does not tell.
    pub processor: Duration,
}

impl WorkStart {
    /// Now.
    pub fn now() -> Self {
        Self { clock: Instant::now(), processor: processor_time() }
    }

    /// The time since then.
    pub fn elapsed(&self) -> WorkTime {
        let processor = processor_time().saturating_sub(self.processor);
        WorkTime { clock: self.clock.elapsed(), processor }
    }
}

#[cfg(target_os = "linux")]
fn processor_time() -> Duration {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}

#[cfg(not(target_os = "linux"))]
const fn processor_time() -> Duration {
    Duration::ZERO
}
