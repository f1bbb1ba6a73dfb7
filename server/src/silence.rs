//! When a peer has been silent for too long. Plain data: the socket has the clock.

use std::time::Duration;
use tokio::time::Instant;

/// Intervals of silence after which a session ends. In those before it is pinged once each.
const PATIENCE: u32 = 3;

/// What a silence calls for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Due {
    /// Nothing: the peer said something meanwhile.
    Nothing,
    /// A ping, which a living peer answers.
    Ping,
    /// The end.
    End,
}

/// The silence of one peer, measured from the last that was heard of it and not by a clock of its
/// own: a beat that just misses the limit would see it a whole interval late.
#[derive(Clone, Copy, Debug)]
pub struct Silence {
    interval: Duration,
    heard: Instant,
}

impl Silence {
    /// Begins now. `interval` is longer than zero.
    #[must_use]
    pub const fn new(interval: Duration, now: Instant) -> Self {
        Self { interval, heard: now }
    }

    /// The peer has been heard.
    pub const fn broken(&mut self, now: Instant) {
        self.heard = now;
    }

    /// What is due at a moment, and when to look again.
    #[must_use]
    pub fn at(&self, now: Instant) -> (Due, Instant) {
        let passed = now.saturating_duration_since(self.heard).as_nanos() / self.interval.as_nanos().max(1);
        let passed = u32::try_from(passed).unwrap_or(u32::MAX).min(PATIENCE);
        let due = match passed {
            0 => Due::Nothing,
            PATIENCE => Due::End,
            _ => Due::Ping,
        };
        (due, self.heard + self.interval * (passed + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL: Duration = Duration::from_secs(20);

    /// Follows a peer that is heard at these milliseconds, in order, and then never again. Returns
    /// the pings and the end.
    fn follow(heard: &[u64]) -> (Vec<u64>, u64) {
        let start = Instant::now();
        let at = |milliseconds| start + Duration::from_millis(milliseconds);
        let mut silence = Silence::new(INTERVAL, start);
        let (mut heard, mut pings) = (heard.iter().copied().peekable(), Vec::new());
        let mut look = silence.at(start).1;
        loop {
            while let Some(moment) = heard.next_if(|moment| at(*moment) <= look) {
                silence.broken(at(moment));
            }
            let now = (look - start).as_millis() as u64;
            let (due, next) = silence.at(look);
            assert!(next > look || due == Due::End, "{due:?} at {now} ms looks again at once");
            match due {
                Due::Nothing => {}
                Due::Ping => pings.push(now),
                Due::End => return (pings, now),
            }
            look = next;
        }
    }

    #[test]
    fn a_silence_ends_a_session_after_three_intervals_whenever_it_begins() {
        for last in [0, 1, 50, 19_999, 20_000, 20_001, 31_000, 39_999] {
            let (mut pings, end) = follow(&[last]);
            pings.retain(|ping| *ping > last);
            assert_eq!(
                (pings, end),
                (vec![last + 20_000, last + 40_000], last + 60_000),
                "heard at {last} ms"
            );
        }
    }

    #[test]
    fn whoever_answers_each_ping_is_pinged_once_an_interval_and_never_ended_for_it() {
        let answers: Vec<u64> = (0..50).map(|ping| 20_030 * (ping + 1)).collect();
        let (pings, end) = follow(&answers);
        assert_eq!(pings.len(), 50 + 2);
        assert_eq!(end, answers[49] + 60_000);
    }

    #[test]
    fn a_look_that_comes_late_sees_what_is_due_by_then() {
        let start = Instant::now();
        let silence = Silence::new(INTERVAL, start);
        assert_eq!(silence.at(start + INTERVAL * 5 / 2), (Due::Ping, start + INTERVAL * 3));
        assert_eq!(silence.at(start + INTERVAL * 99).0, Due::End);
        assert_eq!(Silence::new(Duration::ZERO, start).at(start).0, Due::Nothing, "no division by zero");
    }
}
