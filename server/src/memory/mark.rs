//! The memory mark: while the process uses more of its memory than a share, no further session
//! begins. What remains is for the sessions that are open.

use super::MemoryLimit;
use crate::metrics::Metrics;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The share of the limit beyond which no session begins, and the one below which sessions begin
/// again; in eighths.
const MARK: (u64, u64) = (6, 5);

/// Time between two looks. A look takes some microseconds.
const INTERVAL: Duration = Duration::from_millis(250);

/// See the module.
#[derive(Debug)]
pub struct MemoryMark {
    limit: Option<MemoryLimit>,
    is_reached: AtomicBool,
}

impl MemoryMark {
    /// The mark of a limit; without one it is never reached.
    #[must_use]
    pub const fn new(limit: Option<MemoryLimit>) -> Self {
        Self { limit, is_reached: AtomicBool::new(false) }
    }

    /// Whether no session may begin.
    #[must_use]
    pub fn is_reached(&self) -> bool {
        self.is_reached.load(Ordering::Relaxed)
    }

    /// Records the memory in use, bytes; true if that changes whether sessions may begin.
    fn record(&self, used: u64, limit: u64) -> bool {
        let was_reached = self.is_reached();
        let mark = if was_reached { MARK.1 } else { MARK.0 };
        let is_reached = used >= limit / 8 * mark;
        self.is_reached.store(is_reached, Ordering::Relaxed);
        is_reached != was_reached
    }
}

/// Looks at the memory in use until it is dropped. Ends at once without a limit.
pub async fn watch(mark: Arc<MemoryMark>, metrics: Arc<Metrics>) {
    let Some(limit) = &mark.limit else { return };
    metrics.memory_limit_bytes.set(i64::try_from(limit.bytes()).unwrap_or(i64::MAX));
    let mut ticks = tokio::time::interval(INTERVAL);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let Some(used) = limit.used_bytes() else { continue };
        metrics.memory_used_bytes.set(i64::try_from(used).unwrap_or(i64::MAX));
        if mark.record(used, limit.bytes()) {
            let (used_mib, is_reached) = (used >> 20, mark.is_reached());
            if is_reached {
                tracing::warn!(used_mib, %limit, "memory is nearly used up: no further sessions begin");
            } else {
                tracing::info!(used_mib, %limit, "memory is free again: sessions begin");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_begin_again_below_a_lower_share() {
        const LIMIT: u64 = 800 << 20;
        let mark = MemoryMark::new(Some(MemoryLimit::of_machine(LIMIT)));
        assert!(!mark.is_reached());
        for (used_mib, is_reached, changes) in [
            (599, false, false),
            (600, true, true),
            (799, true, false),
            (500, true, false),
            (499, false, true),
            (599, false, false),
        ] {
            assert_eq!(mark.record(used_mib << 20, LIMIT), changes, "{used_mib} MiB");
            assert_eq!(mark.is_reached(), is_reached, "{used_mib} MiB");
        }
    }
}
