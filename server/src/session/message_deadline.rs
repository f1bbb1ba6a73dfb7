//! The time limit of a message: a peer that begins one has to finish it. Plain data; the driver has
//! the clock.

use std::time::Duration;
use tokio::time::Instant;

/// Since when a message is unfinished.
///
/// A peer that sends a byte now and then is active for the keep-alive, and would hold its session
/// and a partial message without end.
#[derive(Clone, Copy, Debug)]
pub struct MessageDeadline {
    limit: Duration,
    since: Option<Instant>,
}

impl MessageDeadline {
    /// No message is unfinished.
    #[must_use]
    pub const fn new(limit: Duration) -> Self {
        Self { limit, since: None }
    }

    /// Records the state after bytes were read: whether a message ended in them, and whether
    /// another is unfinished. Control frames between the fragments of a message end none.
    pub fn record(&mut self, has_ended: bool, is_unfinished: bool, now: Instant) {
        self.since = match self.since {
            Some(since) if is_unfinished && !has_ended => Some(since),
            _ => is_unfinished.then_some(now),
        };
    }

    /// When the unfinished message must be complete; none if there is none.
    #[must_use]
    pub fn by(&self) -> Option<Instant> {
        self.since.map(|since| since + self.limit)
    }

    /// Whether that time has passed.
    #[must_use]
    pub fn has_passed(&self, now: Instant) -> bool {
        self.by().is_some_and(|by| by <= now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_secs(5);

    #[tokio::test]
    async fn it_counts_from_the_first_byte_of_the_unfinished_message() {
        let start = Instant::now();
        let after = |seconds| start + Duration::from_secs(seconds);
        let mut deadline = MessageDeadline::new(LIMIT);
        assert_eq!(deadline.by(), None);
        deadline.record(false, true, after(1));
        deadline.record(false, true, after(4));
        assert_eq!(deadline.by(), Some(after(6)));
        assert!(!deadline.has_passed(after(5)) && deadline.has_passed(after(6)));
        // It ended, and the next one began in the same bytes.
        deadline.record(true, true, after(5));
        assert_eq!(deadline.by(), Some(after(10)));
        deadline.record(true, false, after(7));
        assert_eq!(deadline.by(), None);
        assert!(!deadline.has_passed(after(100)));
    }
}
