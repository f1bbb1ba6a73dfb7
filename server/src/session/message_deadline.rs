//! The time limit of a message: a peer that begins one has to finish it. Plain data; the driver has
//! the clock.

use tokio::time::Instant;

/// When an unfinished message must be complete.
///
/// A peer that sends a byte now and then is active for the keep-alive, and would hold its session
/// and a partial message without end.
#[derive(Clone, Copy, Debug, Default)]
pub struct MessageDeadline {
    by: Option<Instant>,
}

impl MessageDeadline {
    /// Records the state after bytes were read: whether a message ended in them, and whether
    /// another is unfinished. Control frames between the fragments of a message end none. `by` is
    /// the deadline of a message that begins now.
    pub fn record(&mut self, has_ended: bool, is_unfinished: bool, by: Instant) {
        self.by = match self.by {
            Some(by) if is_unfinished && !has_ended => Some(by),
            _ => is_unfinished.then_some(by),
        };
    }

    /// When the unfinished message must be complete; none if there is none.
    #[must_use]
    pub fn by(&self) -> Option<Instant> {
        self.by
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
    use std::time::Duration;

    #[tokio::test]
    async fn it_counts_from_the_first_byte_of_the_unfinished_message() {
        let start = Instant::now();
        let after = |seconds| start + Duration::from_secs(seconds);
        let mut deadline = MessageDeadline::default();
        assert_eq!(deadline.by(), None);
        deadline.record(false, true, after(6));
        deadline.record(false, true, after(9));
        assert_eq!(deadline.by(), Some(after(6)));
        assert!(!deadline.has_passed(after(5)) && deadline.has_passed(after(6)));
        // It ended, and the next one began in the same bytes.
        deadline.record(true, true, after(10));
        assert_eq!(deadline.by(), Some(after(10)));
        deadline.record(true, false, after(12));
        assert_eq!(deadline.by(), None);
        assert!(!deadline.has_passed(after(100)));
    }
}
