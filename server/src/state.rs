//! Application state shared by all connections.

use crate::access::gate::TokenGate;
use crate::cache::content_digests::ContentDigests;
use crate::cache::disk::Disk;
use crate::config::ServerConfig;
use crate::generation::{Generation, Limits};
use crate::limits::peer_log::PeerLog;
use crate::limits::per_ip::PerIpLimiter;
use crate::limits::rate_limit::RateLimiter;
use crate::map::Map;
use crate::mechanism::Mechanism;
use crate::memory::MemoryMark;
use crate::memory::reclaim::Reclaim;
use crate::metrics::Metrics;
use crate::open_sessions::OpenSessions;
use crate::source::ProceduralSource;
use crate::stats::LiveStats;
use crate::store::Store;
use crate::traces::Traces;
use protocol::server::ServerOffer;
use rayon::ThreadPoolBuildError;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use terrain::Land;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// Name and version as sent to peers.
pub const SOFTWARE: &str = concat!("tombolo-server ", env!("CARGO_PKG_VERSION"));

/// The map cache gets the chunk cache's memory divided by this, in addition to it.
const MAP_CACHE_DIVISOR: u64 = 8;

/// State shared by all connections.
pub struct ServerState {
    /// The checked configuration.
    pub config: ServerConfig,
    /// The offer to sessions, except for the check of tokens.
    pub offer: ServerOffer,
    /// The generation service.
    pub generation: Generation,
    /// Content digests of chunks that were served by address.
    pub content_digests: ContentDigests,
    /// The map renderer and its cache.
    pub map: Map,
    /// The open sessions.
    pub open_sessions: OpenSessions,
    /// Figures for the page at `/`.
    pub stats: LiveStats,
    /// Metrics.
    pub metrics: Arc<Metrics>,
    /// Cancelled when the server begins to drain.
    pub draining: CancellationToken,
    /// Session tasks; the server stops after the last one.
    pub sessions: TaskTracker,
    /// One permit per allowed session, held by the session task.
    pub session_permits: Arc<Semaphore>,
    /// Sessions per client network.
    pub sessions_per_ip: PerIpLimiter,
    /// One permit per request that is being answered, as many as connections may be open.
    pub request_permits: Semaphore,
    /// The same per client network.
    pub requests_per_ip: PerIpLimiter,
    /// Whether the memory is nearly used up.
    pub memory: Arc<MemoryMark>,
    /// Tokens of clients.
    pub gate: Arc<TokenGate>,
    /// Log lines about peers that break rules.
    pub peer_log: Arc<PeerLog>,
    /// Which chunks are traced.
    pub traces: Traces,
    /// Work per client network.
    pub rate_limiter: RateLimiter,
    /// Number of the next session.
    pub next_session: AtomicU64,
}

impl ServerState {
    /// The state of a server without a listener.
    ///
    /// # Errors
    /// The system cannot start the generation threads.
    pub fn new(config: ServerConfig) -> Result<Self, ThreadPoolBuildError> {
        let land = Land::new(config.world_seed);
        let metrics = Arc::new(Metrics::default());
        metrics.sessions.limit.set(i64::try_from(config.max_sessions).unwrap_or(i64::MAX));
        let source = ProceduralSource::new(land);
        let limits = Limits {
            threads: config.threads,
            cache_bytes: config.cache_bytes,
            jobs: config.job_limit(),
            deadline: config.deadline,
            without: config.without,
        };
        let disk = config.disk.clone().and_then(|disk| {
            Disk::new(disk, &land.digest(), Arc::clone(&metrics))
                .inspect_err(
                    |error| tracing::warn!(%error, "cannot start the disk cache; continuing without it"),
                )
                .ok()
        });
        let store = config.store.as_ref().and_then(|store| {
            Store::new(store, &land.digest(), Arc::clone(&metrics))
                .inspect(|_| tracing::info!(store = %store.address, "shared store"))
                .inspect_err(|error| tracing::warn!(%error, "cannot open the store; continuing without it"))
                .ok()
        });
        let generation = Generation::with_stores(source, limits, disk, store, Arc::clone(&metrics))?;
        let memory = config.memory.clone().filter(|_| config.without != Some(Mechanism::MemoryMark));
        let peer_log = Arc::new(PeerLog::default());
        let gate = TokenGate::new(
            config.tokens.clone(),
            config.token_file.clone(),
            Arc::clone(&metrics),
            Arc::clone(&peer_log),
        );
        Ok(Self {
            offer: ServerOffer { land, digest: land.digest(), token: None, software: SOFTWARE.into() },
            gate: Arc::new(gate),
            peer_log,
            map: Map::new(
                land.digest(),
                config.cache_bytes / MAP_CACHE_DIVISOR,
                config.threads,
                Arc::clone(&metrics),
            ),
            memory: Arc::new(MemoryMark::new(memory)),
            content_digests: ContentDigests::default(),
            open_sessions: OpenSessions::default(),
            stats: LiveStats::default(),
            generation,
            metrics,
            draining: CancellationToken::new(),
            sessions: TaskTracker::new(),
            session_permits: Arc::new(Semaphore::new(config.max_sessions)),
            next_session: AtomicU64::new(1),
            rate_limiter: RateLimiter::new(config.rate_limit_ms),
            traces: Traces::new(config.traces.as_ref()),
            request_permits: Semaphore::new(config.max_connections()),
            requests_per_ip: config.connections_per_ip(),
            sessions_per_ip: match config.max_sessions_per_address {
                Some(limit) => PerIpLimiter::new(limit),
                None => PerIpLimiter::fair_share(config.max_sessions),
            },
            config,
        })
    }
}

impl Reclaim for ServerState {
    fn stop_views(&self, is_stopped: bool) {
        self.generation.stop_views(is_stopped);
    }

    fn clear_caches(&self) {
        self.generation.clear_cache();
        self.map.clear_cache();
        self.metrics.limits.memory_cache_clears.inc();
    }

    fn return_pages(&self) {
        self.generation.return_pages();
    }
}
