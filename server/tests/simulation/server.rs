//! A server without a listener: sessions over any stream, and a generation thread in virtual time.

use crate::plant::Plant;
use crate::worker::{Pace, VirtualWork, Worker};
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
use tokio::io::DuplexStream;
use tokio::task::{JoinSet, spawn_local};
use tokio::time::timeout;
use tokio_util::task::AbortOnDropHandle;

/// Jobs that may be queued or running: fewer than four clients can have.
pub const MAX_JOBS: usize = 48;

/// Memory for frames, bytes: some are generated again. So few that they are one part of the cache:
/// several would depend on the machine, and a frame's part on the keys of a hash table.
const CACHE_BYTES: u64 = 1 << 17;

/// Longest time from the announcement of the end to the end of all sessions.
const DRAIN: Duration = Duration::from_secs(5);

/// Longest wait of a request: some are refused while chunks are slow.
const DEADLINE: Duration = Duration::from_secs(1);

pub struct Server {
    pub state: Arc<ServerState>,
    /// Tasks of sessions, at most one for each connection so far.
    sessions: JoinSet<()>,
    _worker: AbortOnDropHandle<()>,
    plant: Plant,
}

impl Server {
    /// Starts a server whose chunks take the time and have the outcome of `pace`.
    pub fn start(plant: Plant, pace: impl FnMut() -> Pace + 'static) -> Self {
        let config =
            ServerConfig { threads: 1, max_jobs: Some(MAX_JOBS), memory: None, ..Default::default() };
        let mut state = ServerState::new(config).expect("one thread");
        let limits = Limits {
            threads: 1,
            cache_bytes: CACHE_BYTES,
            jobs: MAX_JOBS,
            deadline: DEADLINE,
            without: None,
        };
        let work = VirtualWork::default();
        let (worker, executor, source) = Worker::start(work.clone());
        let metrics = Arc::clone(&state.metrics);
        state.generation = Generation::on(Arc::new(executor), work, source, limits, metrics);
        let worker = AbortOnDropHandle::new(spawn_local(worker.run(pace)));
        Self { state: Arc::new(state), sessions: JoinSet::new(), _worker: worker, plant }
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
