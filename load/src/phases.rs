//! The phases of a run: their start and end, and when each client connects.
//!
//! With a warm-up there are two. In the first (cold) clients fly the beginning of their paths and
//! the server generates the chunks. In the second (warm) they start again with new sessions and no
//! chunks and fly the same paths.

use std::time::Duration;

/// Pause between two phases, in which the last answers and closes of the first arrive.
const PAUSE: Duration = Duration::from_secs(4);

/// Time between the first connections of two clients, unless the phase is too short.
const RAMP_STEP: Duration = Duration::from_millis(10);

/// One phase of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Phase {
    /// `run` if it is the only one, otherwise `cold` or `warm`.
    pub name: &'static str,
    /// Since the start of the run.
    pub start: Duration,
    /// Its length.
    pub length: Duration,
}

/// The phases of a run of `seconds` seconds after a warm-up of `warm_up_s` seconds.
#[must_use]
pub fn phases(warm_up_s: u64, seconds: u64) -> Vec<Phase> {
    let (warm_up, length) = (Duration::from_secs(warm_up_s), Duration::from_secs(seconds));
    if warm_up_s == 0 {
        return vec![Phase { name: "run", start: Duration::ZERO, length }];
    }
    vec![
        Phase { name: "cold", start: Duration::ZERO, length: warm_up },
        Phase { name: "warm", start: warm_up + PAUSE, length },
    ]
}

impl Phase {
    /// End, since the start of the run.
    #[must_use]
    pub fn end(&self) -> Duration {
        self.start + self.length
    }

    /// When a client connects, since the start of the run. Clients are spread over at most the
    /// first fifth of the phase, so that the accept queue is not measured, unless `at_once`.
    #[must_use]
    pub fn client_start(&self, index: u32, n_clients: u32, at_once: bool) -> Duration {
        let step = if at_once { Duration::ZERO } else { RAMP_STEP.min(self.length / 5 / n_clients.max(1)) };
        self.start + step * index
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(seconds: u64) -> Phase {
        phases(0, seconds)[0]
    }

    #[test]
    fn a_ramp_takes_at_most_a_fifth_of_the_phase() {
        assert_eq!(run(30).client_start(1, 200, false), RAMP_STEP);
        assert_eq!(run(5).client_start(1, 1000, false), Duration::from_millis(1));
        assert_eq!(run(1).client_start(7, 8, false), RAMP_STEP * 7);
        assert_eq!(run(30).client_start(150, 200, true), Duration::ZERO);
    }

    #[test]
    fn a_warm_up_is_a_phase_of_its_own_with_a_pause_after_it() {
        let [cold, warm] = phases(5, 30)[..] else { panic!("two phases") };
        assert_eq!(
            (cold.name, cold.length, warm.name, warm.length.as_secs()),
            ("cold", Duration::from_secs(5), "warm", 30)
        );
        assert_eq!(warm.start, cold.end() + PAUSE);
        assert_eq!(phases(0, 30).len(), 1);
    }
}
