//! A server without a listener: sessions over any stream, and a gated generation thread.

use crate::gate::{Gate, GatedSource, Outcome, Threads};
use crate::plant::Plant;
use protocol::Delivery;
use protocol::server::ChunkRequest;
use server::ServerConfig;
use server::generation::{Generation, Limits};
use server::limits::rate_limit::TokenBucket;
use server::session::driver::{self, READ_LIMIT};
use server::state::ServerState;
use server::websocket::socket::WebSocket;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use terrain::ChunkKey;
use tokio::io::DuplexStream;
use tokio::task::{JoinSet, spawn_local};
use tokio::time::timeout;
use tokio_util::task::AbortOnDropHandle;

/// Jobs that may be queued or running: fewer than four clients can have.
pub const MAX_JOBS: usize = 48;

/// Memory for frames, bytes: some are generated again.
const CACHE_BYTES: u64 = 1 << 20;

/// Longest time from the announcement of the end to the end of all sessions.
const DRAIN: Duration = Duration::from_secs(5);

/// Longest time of a job on the clock of the machine: none is refused for its wait.
const DEADLINE: Duration = Duration::from_secs(3600);

pub struct Server {
    pub state: Arc<ServerState>,
    gate: Arc<Gate>,
    threads: Threads,
    /// Tasks of sessions, at most one for each connection so far.
    sessions: JoinSet<()>,
    _gate_task: AbortOnDropHandle<()>,
    plant: Plant,
}

impl Server {
    /// Starts a server whose chunks take the time and have the outcome of `pace`.
    pub async fn start(
        threads: &Threads,
        plant: Plant,
        mut pace: impl FnMut() -> Option<(Duration, Outcome)> + 'static,
    ) -> Self {
        let config =
            ServerConfig { threads: 1, max_jobs: Some(MAX_JOBS), memory: None, ..Default::default() };
        let mut state = ServerState::new(config).expect("one thread");
        let gate = Arc::new(Gate::default());
        let limits = Limits {
            threads: 1,
            cache_bytes: CACHE_BYTES,
            jobs: MAX_JOBS,
            deadline: DEADLINE,
            without: None,
        };
        let source = GatedSource(Arc::clone(&gate));
        state.generation =
            Generation::new(source, limits, Arc::clone(&state.metrics)).expect("one more thread");
        threads.add(&gate, &state.generation);
        // The thread is known once it has generated a chunk: the first one has no fault.
        let mut first = Some((Duration::from_millis(1), Outcome::Right));
        let running = Arc::clone(&gate);
        let run = async move { running.run(move || first.take().or_else(&mut pace)).await };
        let gate_task = AbortOnDropHandle::new(spawn_local(run));
        let key = ChunkKey::new(0, 900, 900).expect("in the world");
        let chunk = ChunkRequest { key, request: None, priority: 0 };
        state.generation.flow().frame(chunk, Delivery::Exact).await.expect("the first chunk");
        let (state, threads) = (Arc::new(state), threads.clone());
        Self { state, gate, threads, sessions: JoinSet::new(), _gate_task: gate_task, plant }
    }

    /// Begins a session with a client, which `10.0.0.client` names.
    pub fn serve(&mut self, client: u32, stream: DuplexStream) {
        let (state, plant) = (Arc::clone(&self.state), self.plant);
        self.sessions.spawn(async move {
            let number = state.next_session.fetch_add(1, Ordering::Relaxed);
            let open = state.open_sessions.register(number, Some(IpAddr::from([10, 0, 0, client as u8])));
            let socket = WebSocket::new(stream, &[], READ_LIMIT);
            let offer = state.offer.clone();
            let bucket = TokenBucket::default();
            drop(driver::serve(socket, &state, offer, open, bucket, None).await);
            if plant == Plant::LeakedSession && number.is_multiple_of(3) {
                std::future::pending::<()>().await;
            }
        });
    }

    /// Announces the end to all sessions and waits for theirs; those that remain are aborted.
    ///
    /// # Errors
    /// A session has panicked.
    pub async fn drain(mut self) -> Result<(), String> {
        self.state.draining.cancel();
        let all_ended = async {
            while let Some(ended) = self.sessions.join_next().await {
                ended.map_err(|error| format!("a session: {error}"))?;
            }
            Ok(())
        };
        let ended = timeout(DRAIN, all_ended).await.unwrap_or(Ok(()));
        self.kill().await;
        ended
    }

    /// Ends all sessions at once.
    pub async fn kill(mut self) {
        self.sessions.shutdown().await;
    }

    /// The number of sessions whose tasks have not ended.
    ///
    /// # Errors
    /// One has panicked, or more jobs than are allowed exist.
    pub fn check(&mut self) -> Result<usize, String> {
        let jobs = self.state.metrics.generation.pending_jobs.get();
        if jobs > MAX_JOBS as i64 {
            return Err(format!("{jobs} jobs"));
        }
        while let Some(ended) = self.sessions.try_join_next() {
            ended.map_err(|error| format!("a session: {error}"))?;
        }
        Ok(self.sessions.len())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.threads.remove(&self.gate);
        // The thread ends with its pool.
        self.gate.open();
    }
}
