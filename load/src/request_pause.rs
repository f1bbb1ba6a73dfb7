//! The pause of a closed loop after refusals. An open loop has none: its times are fixed.
//!
//! A refusal frees a place for the next request at once, so without a pause a client would ask for
//! refused chunks as fast as the server refuses them.

use protocol::backoff::Backoff;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// Pause after a first refusal, and the longest one after several without a chunk between them.
const FIRST: Duration = Duration::from_millis(50);
const LONGEST: Duration = Duration::from_secs(5);

/// See the module.
#[derive(Clone, Debug)]
pub struct RequestPause {
    backoff: Backoff,
    until: Option<Instant>,
}

impl RequestPause {
    /// No pause. Clients with different seeds do not ask again together.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        Self { backoff: Backoff::new(FIRST, LONGEST, seed), until: None }
    }

    /// A request was refused. Refusals during a pause do not prolong it.
    pub fn refused(&mut self, now: Instant) {
        if self.until.is_none() {
            self.until = Some(now + self.backoff.next_delay());
        }
    }

    /// A chunk arrived: the next pause is a first one.
    pub const fn answered(&mut self) {
        self.backoff.reset();
    }

    /// Whether nothing may be requested.
    #[must_use]
    pub const fn is_paused(&self) -> bool {
        self.until.is_some()
    }

    /// Waits for the end of a pause and ends it; never returns without one. Cancel safe.
    pub async fn end(&mut self) {
        match self.until {
            Some(until) => sleep_until(until).await,
            None => std::future::pending().await,
        }
        self.until = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn pauses_double_until_a_chunk_arrives() {
        let mut pause = RequestPause::new(7);
        let mut lengths = Vec::new();
        for refusal in 0..12 {
            let start = Instant::now();
            (0..16).for_each(|_| pause.refused(start));
            pause.end().await;
            assert!(!pause.is_paused());
            // Timers count in milliseconds.
            let (length, full) = (start.elapsed(), (FIRST * (1 << refusal)).min(LONGEST));
            assert!(length >= full / 2 && length <= full + Duration::from_millis(1), "{refusal}: {length:?}");
            lengths.push(length);
        }
        pause.answered();
        let start = Instant::now();
        pause.refused(start);
        pause.end().await;
        assert!(start.elapsed() < lengths[11] / 10);
    }
}
