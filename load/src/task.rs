//! The task of every kind of client for one phase, and the ends of a session.

use crate::config::LoadConfig;
use crate::counters::Counters;
use crate::path::FlightPath;
use crate::regeneration::Regeneration;
use crate::verify::Mismatch;
use crate::world::FirstWorld;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use terrain::Land;
use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

/// Timeout of a connection with its handshake, and again of the Welcome.
pub const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);

/// Time after the end in which an open loop waits for answers. A request without an answer by then
/// counts with the time that it has waited.
pub const GRACE: Duration = Duration::from_secs(2);

/// Time without a frame or an answer after which a client that waits for one counts as stalled.
pub const STALL_TIMEOUT: Duration = Duration::from_secs(5);

/// Time after which clients stop trying to reach a server that has never answered. Long enough for
/// a server that starts at the same time.
pub const GIVE_UP_AFTER: Duration = Duration::from_secs(10);

/// The task of one client for one phase of a run.
#[derive(Debug)]
pub struct Task<'a, D> {
    /// Number of the client.
    pub index: u32,
    /// Options of the whole run.
    pub config: &'a LoadConfig,
    /// Opens connections to the server.
    pub dial: &'a D,
    /// Counters of the phase.
    pub counters: &'a Arc<Counters>,
    /// Compares samples with local generation.
    pub regeneration: &'a Regeneration,
    /// Time zero of the path and of the arrivals.
    pub epoch: Instant,
    /// No request is started from here on.
    pub end: Instant,
    /// Ends the run before that. A token of this client alone: clients of one token would wait for
    /// its lock.
    pub interrupt: &'a CancellationToken,
    /// Limit of the read rate, bytes a second.
    pub read_rate: Option<u32>,
    /// The world that was announced first.
    pub world: &'a FirstWorld,
    /// Whether the client has had a session, in this phase or an earlier one.
    pub had_session: &'a AtomicBool,
}

impl<D> Task<'_, D> {
    /// The client's path. Searches the start of the world (milliseconds) for the first client of a
    /// run only.
    #[must_use]
    pub fn path(&self, land: &Land) -> FlightPath {
        FlightPath::new(self.config.path, self.config.seed, self.index, self.world.start(land))
    }

    /// Seed of the client's delays: clients disconnected or refused together do not return
    /// together. It follows from the options, so that a run can be repeated. A second load test
    /// beside this one takes another `--seed`.
    #[must_use]
    pub fn delay_seed(&self) -> u64 {
        u64::from(self.config.seed) << 32 | u64::from(self.index)
    }

    /// The client was admitted.
    pub fn admitted(&self) {
        self.counters.admitted();
        self.had_session.store(true, Ordering::Relaxed);
    }

    /// The result of `work`; none at a time or at the interrupt of the run, if it has none by then.
    pub async fn until<T>(&self, at: Instant, work: impl Future<Output = T>) -> Option<T> {
        self.interrupt.run_until_cancelled(timeout_at(at, work)).await?.ok()
    }

    /// The phase ended while a client that began then waited for its admission.
    pub fn ended_in_admission(&self, began: Instant) {
        if began.elapsed() >= STALL_TIMEOUT {
            self.counters
                .stalled(&format!("no admission by {} within {STALL_TIMEOUT:?}", self.config.connect));
        }
    }
}

/// How one session ended.
#[derive(Debug)]
pub enum SessionEnd {
    /// The phase is over.
    Finished,
    /// No connection, or no answer over it.
    Unreachable(String),
    /// Not admitted.
    NotAdmitted {
        /// The problem.
        problem: String,
        /// Whether another attempt may succeed.
        retry: bool,
    },
    /// Admitted, then lost, with the cause.
    Lost(String),
    /// The server sent invalid data.
    Wrong(String),
    /// The server serves another world than at the start of the run: nothing that follows could be
    /// compared.
    OtherWorld(String),
}

impl SessionEnd {
    /// Not admitted; another attempt may succeed.
    #[must_use]
    pub const fn not_admitted(problem: String) -> Self {
        Self::NotAdmitted { problem, retry: true }
    }

    /// Admitted to a wrong world.
    #[must_use]
    pub fn wrong_world(mismatch: &Mismatch) -> Self {
        match mismatch {
            Mismatch::OtherWorld { .. } => Self::OtherWorld(mismatch.to_string()),
            _ => Self::Wrong(mismatch.to_string()),
        }
    }
}
