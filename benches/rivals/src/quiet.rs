//! Whether other programs took the core away meanwhile.
//!
//! Linux counts for how long a thread stood ready and got no core. A measurement in which that was
//! more than a trifle measures the neighbours. The count knows nothing of what the thread computed,
//! so leaving such measurements out favours nobody.

use std::time::Duration;

/// Share of its time that a thread may stand ready without a core.
const DISTURBANCE: f64 = 0.01;

/// How long this thread has stood ready without a core. Where the system does not say, never: every
/// measurement counts.
pub fn ready_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split_whitespace().nth(1).and_then(|field| field.parse().ok());
    Duration::from_nanos(nanoseconds.unwrap_or(0))
}

/// Whether a wait without a core spoils `seconds` of measurement.
pub fn is_disturbed(waited: Duration, seconds: f64) -> bool {
    waited.as_secs_f64() > seconds * DISTURBANCE
}
