//! Keep-alive: pings an inactive peer and closes a dead one. Plain data; the driver has the clock.

use std::time::Duration;
use tokio::time::Instant;

/// Intervals without activity after which a session is closed, if it was pinged. Each earlier
/// interval sends a ping.
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
    last_activity: Instant,
    /// At least 1. Milliseconds, and not a duration: an idle session holds it.
    interval_ms: u32,
    /// Whether a ping was sent since then.
    is_pinged: bool,
}

impl Keepalive {
    /// Starts now. `interval` is at least a millisecond.
    #[must_use]
    pub fn new(interval: Duration, now: Instant) -> Self {
        let interval_ms = u32::try_from(interval.as_millis()).unwrap_or(u32::MAX).max(1);
        Self { last_activity: now, interval_ms, is_pinged: false }
    }

    /// Records that the peer sent something.
    pub const fn on_activity(&mut self, now: Instant) {
        (self.last_activity, self.is_pinged) = (now, false);
    }

    /// Records that a ping was sent.
    pub const fn on_ping(&mut self) {
        self.is_pinged = true;
    }

    /// The action at a moment, and when to check again. A check that is late by a long write pings
    /// first: a peer that was not pinged had nothing to answer.
    #[must_use]
    pub fn check(&self, now: Instant) -> (KeepaliveAction, Instant) {
        let idle = now.saturating_duration_since(self.last_activity);
        let interval = Duration::from_millis(self.interval_ms.into());
        let passed = idle.as_millis() / u128::from(self.interval_ms);
        let passed = u32::try_from(passed).unwrap_or(u32::MAX).min(TIMEOUT_INTERVALS);
        let action = match passed {
            0 => KeepaliveAction::None,
            TIMEOUT_INTERVALS if !self.is_pinged => return (KeepaliveAction::Ping, now + interval),
            TIMEOUT_INTERVALS => KeepaliveAction::Close,
            _ => KeepaliveAction::Ping,
        };
        (action, self.last_activity + interval * (passed + 1))
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
                KeepaliveAction::Ping => {
                    pings.push(now);
                    keepalive.on_ping();
                }
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
        let mut keepalive = Keepalive::new(INTERVAL, start);
        assert_eq!(keepalive.check(start + INTERVAL * 5 / 2), (KeepaliveAction::Ping, start + INTERVAL * 3));
        let late = start + INTERVAL * 99;
        assert_eq!(keepalive.check(late), (KeepaliveAction::Ping, late + INTERVAL), "it was not pinged");
        keepalive.on_ping();
        assert_eq!(keepalive.check(late).0, KeepaliveAction::Close);
        keepalive.on_activity(late);
        assert_eq!(keepalive.check(late + INTERVAL * 3).0, KeepaliveAction::Ping, "not since its activity");
        let zero = Keepalive::new(Duration::ZERO, start);
        assert_eq!(zero.check(start).0, KeepaliveAction::None, "no division by zero");
    }
}
