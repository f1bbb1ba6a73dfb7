//! Keep-alive: pings an inactive peer and closes a dead one. Plain data; the driver has the clock.

use std::time::Duration;
use tokio::time::Instant;

/// Intervals without activity after which a session is closed. Each earlier interval sends a ping.
const TIMEOUT_INTERVALS: u32 = 3;

/// The action that the driver must take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeepaliveAction {
    /// Nothing: the peer was active.
    None,
    /// Send a ping, which a live peer answers.
    Ping,
    /// Close the session.
    Close,
}

/// Measures from the last activity of the peer, not by a clock of its own: a periodic check that
/// just misses the timeout would detect it a whole interval late.
#[derive(Clone, Copy, Debug)]
pub struct Keepalive {
    interval: Duration,
    last_activity: Instant,
}

impl Keepalive {
    /// Starts now. `interval` is longer than zero.
    #[must_use]
    pub const fn new(interval: Duration, now: Instant) -> Self {
        Self { interval, last_activity: now }
    }

    /// Records that the peer sent something.
    pub const fn on_activity(&mut self, now: Instant) {
        self.last_activity = now;
    }

    /// The action at a moment, and when to check again.
    #[must_use]
    pub fn check(&self, now: Instant) -> (KeepaliveAction, Instant) {
        let idle = now.saturating_duration_since(self.last_activity);
        let passed = idle.as_nanos() / self.interval.as_nanos().max(1);
        let passed = u32::try_from(passed).unwrap_or(u32::MAX).min(TIMEOUT_INTERVALS);
        let action = match passed {
            0 => KeepaliveAction::None,
            TIMEOUT_INTERVALS => KeepaliveAction::Close,
            _ => KeepaliveAction::Ping,
        };
        (action, self.last_activity + self.interval * (passed + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL: Duration = Duration::from_secs(20);

    /// Simulates a peer that is active at these milliseconds, in order, and then no more. Returns
    /// the times of the pings and of the close.
    fn simulate(active: &[u64]) -> (Vec<u64>, u64) {
        let start = Instant::now();
        let at = |milliseconds| start + Duration::from_millis(milliseconds);
        let mut keepalive = Keepalive::new(INTERVAL, start);
        let (mut active, mut pings) = (active.iter().copied().peekable(), Vec::new());
        let mut check = keepalive.check(start).1;
        loop {
            while let Some(moment) = active.next_if(|moment| at(*moment) <= check) {
                keepalive.on_activity(at(moment));
            }
            let now = (check - start).as_millis() as u64;
            let (action, next) = keepalive.check(check);
            assert!(
                next > check || action == KeepaliveAction::Close,
                "{action:?} at {now} ms repeats at once"
            );
            match action {
                KeepaliveAction::None => {}
                KeepaliveAction::Ping => pings.push(now),
                KeepaliveAction::Close => return (pings, now),
            }
            check = next;
        }
    }

    #[test]
    fn a_session_is_closed_after_three_idle_intervals() {
        for last in [0, 1, 50, 19_999, 20_000, 20_001, 31_000, 39_999] {
            let (mut pings, end) = simulate(&[last]);
            pings.retain(|ping| *ping > last);
            assert_eq!(
                (pings, end),
                (vec![last + 20_000, last + 40_000], last + 60_000),
                "last active at {last} ms"
            );
        }
    }

    #[test]
    fn a_peer_that_answers_pings_gets_one_per_interval_and_stays_open() {
        let answers: Vec<u64> = (0..50).map(|ping| 20_030 * (ping + 1)).collect();
        let (pings, end) = simulate(&answers);
        assert_eq!(pings.len(), 50 + 2);
        assert_eq!(end, answers[49] + 60_000);
    }

    #[test]
    fn a_late_check_returns_the_action_of_its_moment() {
        let start = Instant::now();
        let keepalive = Keepalive::new(INTERVAL, start);
        assert_eq!(keepalive.check(start + INTERVAL * 5 / 2), (KeepaliveAction::Ping, start + INTERVAL * 3));
        assert_eq!(keepalive.check(start + INTERVAL * 99).0, KeepaliveAction::Close);
        let zero = Keepalive::new(Duration::ZERO, start);
        assert_eq!(zero.check(start).0, KeepaliveAction::None, "no division by zero");
    }
}
