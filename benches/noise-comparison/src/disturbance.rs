//! Whether other programs took the core during a measurement.
//!
//! Linux counts the time that a thread was runnable without a core. A measurement in which that is
//! more than a small share is invalid. The count does not depend on what the thread computed, so
//! dropping such measurements favours no contender.

use std::time::Duration;

/// Share of its time that a thread may be runnable without a core.
const DISTURBANCE: f64 = 0.01;

/// Time that this thread was runnable without a core. Zero if the system does not count it.
pub fn ready_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split_whitespace().nth(1).and_then(|field| field.parse().ok());
    Duration::from_nanos(nanoseconds.unwrap_or(0))
}

/// Whether a wait without a core invalidates `seconds` of measurement.
pub fn is_disturbed(waited: Duration, seconds: f64) -> bool {
    waited.as_secs_f64() > seconds * DISTURBANCE
}
