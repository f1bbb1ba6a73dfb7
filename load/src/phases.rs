//! The parts of a run: when each begins and ends, and when each client begins in it.
//!
//! With a warm-up there are two. In the first everybody flies the beginning of the paths (cold:
//! nobody asked before), in the second everybody begins again, with sessions and hands empty, and
//! flies the same paths (warm: the server has made it before).

use std::time::Duration;

/// Pause between two parts: the first one's last answers and good-byes come in it, not in the
/// second.
const PAUSE: Duration = Duration::from_secs(4);

/// Time between two clients' first connections, unless the part is too short for it.
const RAMP_STEP: Duration = Duration::from_millis(10);

/// One part of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Phase {
    /// `run` where it is the only one, else `cold` or `warm`.
    pub name: &'static str,
    /// From the start of the run.
    pub begins: Duration,
    /// Its length.
    pub lasts: Duration,
}

/// The parts of a run of so many seconds after so many of warm-up.
#[must_use]
pub fn phases(warm_up_s: u64, seconds: u64) -> Vec<Phase> {
    let (warm_up, lasts) = (Duration::from_secs(warm_up_s), Duration::from_secs(seconds));
    if warm_up_s == 0 {
        return vec![Phase { name: "run", begins: Duration::ZERO, lasts }];
    }
    vec![
        Phase { name: "cold", begins: Duration::ZERO, lasts: warm_up },
        Phase { name: "warm", begins: warm_up + PAUSE, lasts },
    ]
}

impl Phase {
    /// When it is over, from the start of the run.
    #[must_use]
    pub fn ends(&self) -> Duration {
        self.begins + self.lasts
    }

    /// When a client begins, from the start of the run. All at once would measure the accept queue,
    /// not the streaming, so the first fifth of the part is for coming, except where all at once is
    /// what was asked for.
    #[must_use]
    pub fn begin_of(&self, index: u32, n_clients: u32, at_once: bool) -> Duration {
        let step = if at_once { Duration::ZERO } else { RAMP_STEP.min(self.lasts / 5 / n_clients.max(1)) };
        self.begins + step * index
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(seconds: u64) -> Phase {
        phases(0, seconds)[0]
    }

    #[test]
    fn a_ramp_takes_at_most_a_fifth_of_the_part_and_a_stampede_none() {
        assert_eq!(run(30).begin_of(1, 200, false), RAMP_STEP);
        assert_eq!(run(5).begin_of(1, 1000, false), Duration::from_millis(1));
        assert_eq!(run(1).begin_of(7, 8, false), RAMP_STEP * 7);
        assert_eq!(run(30).begin_of(150, 200, true), Duration::ZERO);
    }

    #[test]
    fn a_warm_up_is_a_part_of_its_own_and_the_two_do_not_touch() {
        let [cold, warm] = phases(5, 30)[..] else { panic!("two parts") };
        assert_eq!(
            (cold.name, cold.lasts, warm.name, warm.lasts.as_secs()),
            ("cold", Duration::from_secs(5), "warm", 30)
        );
        assert_eq!(warm.begins, cold.ends() + PAUSE);
        assert_eq!(phases(0, 30).len(), 1);
    }
}
