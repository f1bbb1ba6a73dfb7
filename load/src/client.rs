//! One client through one part of a run: it comes, does its errands, and comes back when it is
//! thrown out.

use crate::agenda::Agenda;
use crate::config::LoadConfig;
use crate::counters::Counters;
use crate::dial::Dial;
use crate::http::{self, Visited};
use crate::mode::Mode;
use crate::regeneration::Regeneration;
use crate::session;
use std::sync::Arc;
use std::time::Duration;
use terrain::hash::mix;
use tokio::time::{Instant, sleep, timeout_at};

/// Time for a connection with its handshake, and again for the Welcome.
pub const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);

/// Time after the end in which an open loop still waits for answers. What has none by then counts
/// with the time that it has waited.
pub const GRACE: Duration = Duration::from_secs(2);

/// First and longest pause before connecting again; doubled after each failure.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));

/// What one client is told of the part of the run that it is in.
#[derive(Debug)]
pub struct Task<'a, D> {
    /// Which client.
    pub index: u32,
    /// The whole run's options.
    pub config: &'a LoadConfig,
    /// The way to the server.
    pub dial: &'a D,
    /// Where everything is counted.
    pub counters: &'a Arc<Counters>,
    /// Where samples are compared.
    pub regeneration: &'a Regeneration,
    /// Time zero of the path and of the arrivals.
    pub epoch: Instant,
    /// Nothing is begun from here on.
    pub end: Instant,
    /// Bytes a second that are read at most; none reads what comes.
    pub reads: Option<u32>,
}

/// How one session ended.
#[derive(Debug)]
pub enum End {
    /// The part of the run is over.
    Finished,
    /// Never admitted, and why. Trying again helps only if told so.
    NotAdmitted {
        /// What was wrong.
        problem: String,
        /// Whether trying again may help.
        retry: bool,
    },
    /// Admitted and lost, and why.
    Lost(String),
    /// The server sent something wrong.
    Wrong(String),
}

impl End {
    /// Not admitted this time.
    #[must_use]
    pub const fn not_admitted(problem: String) -> Self {
        Self::NotAdmitted { problem, retry: true }
    }
}

/// Runs a measured client to the end of its part, reconnecting with growing pauses. What was
/// visited is kept for the next part.
pub async fn run<D: Dial>(task: &Task<'_, D>, visited: &mut Visited) {
    let mut agenda = Agenda::new(task.config, task.index, task.epoch, task.end);
    let mut pause = BACKOFF.0;
    loop {
        let began = Instant::now();
        let end = match task.config.mode {
            Mode::Http => http::browse(task, &mut agenda, visited).await,
            Mode::View | Mode::Explicit => session::run(task, &mut agenda).await,
        };
        let counters = task.counters;
        match end {
            End::Finished => break,
            End::NotAdmitted { problem, retry } => {
                counters.refused(&problem);
                if !retry {
                    break;
                }
            }
            End::Lost(problem) => counters.dropped(&problem),
            End::Wrong(problem) => {
                counters.mismatch(&problem);
                counters.dropped(&problem);
            }
        }
        // A session that lasted starts over with the shortest pause.
        pause = if began.elapsed() > BACKOFF.1 { BACKOFF.0 } else { (pause * 2).min(BACKOFF.1) };
        // Half of the pause is spread by client, so that those thrown out together do not return
        // together.
        let spread = pause.mul_f64(0.5 + f64::from(mix(task.index)) / f64::from(u32::MAX) / 2.0);
        if timeout_at(task.end, sleep(spread)).await.is_err() || Instant::now() >= task.end {
            break;
        }
    }
    let now = Instant::now();
    for due in agenda.rest() {
        task.counters.unsent(now.saturating_duration_since(due));
    }
}
