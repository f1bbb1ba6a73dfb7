//! A circuit breaker (M. Nygard, Release It!, 2007): after several failures in a row nothing is
//! asked for a while, then one request tries again.

use std::time::{Duration, Instant};

/// Failures in a row that open the breaker.
const FAILURES: u32 = 5;

/// Time for which it is open.
const PAUSE: Duration = Duration::from_secs(5);

/// See the module. It has no clock: the caller passes the time.
#[derive(Debug, Default)]
pub struct Breaker {
    failures: u32,
    open_until: Option<Instant>,
}

impl Breaker {
    /// Whether a request may be sent. After a pause this is true once in each pause, until a
    /// request succeeds.
    pub fn allows(&mut self, now: Instant) -> bool {
        match self.open_until {
            None => true,
            Some(until) if now < until => false,
            Some(_) => {
                self.open_until = Some(now + PAUSE);
                true
            }
        }
    }

    /// A request was answered.
    pub fn succeeded(&mut self) {
        *self = Self::default();
    }

    /// A request failed or had no answer in time.
    pub fn failed(&mut self, now: Instant) {
        self.failures = self.failures.saturating_add(1);
        if self.failures >= FAILURES {
            self.open_until = Some(now + PAUSE);
        }
    }

    /// Whether [`Breaker::allows`] would say no.
    #[must_use]
    pub fn holds_back(&self, now: Instant) -> bool {
        self.open_until.is_some_and(|until| now < until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_in_a_row_open_it_and_one_success_closes_it() {
        let (mut breaker, now) = (Breaker::default(), Instant::now());
        for _ in 1..FAILURES {
            breaker.failed(now);
        }
        assert!(breaker.allows(now) && !breaker.holds_back(now));
        breaker.succeeded();
        (0..FAILURES).for_each(|_| breaker.failed(now));
        assert!(!breaker.allows(now) && breaker.holds_back(now));
        breaker.succeeded();
        assert!(breaker.allows(now));
    }

    #[test]
    fn an_open_breaker_allows_one_request_a_pause() {
        let (mut breaker, start) = (Breaker::default(), Instant::now());
        (0..FAILURES).for_each(|_| breaker.failed(start));
        let later = start + PAUSE;
        assert!(!breaker.holds_back(later));
        assert!(breaker.allows(later) && !breaker.allows(later), "one");
        breaker.failed(later);
        assert!(!breaker.allows(later + PAUSE / 2));
        assert!(breaker.allows(later + PAUSE));
    }
}
