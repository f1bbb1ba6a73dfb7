//! Accepting connections, and letting go of them.
//!
//! An own accept loop around hyper instead of `axum::serve`: hyper enforces its header timeout only
//! when it is given a timer, and upgraded sockets must be counted and drained by whoever owns them.

use crate::addresses::Addresses;
use crate::config::ServerConfig;
use crate::disk::Disk;
use crate::generation::{Generation, Limits};
use crate::live::Live;
use crate::map::Map;
use crate::metrics::Metrics;
use crate::patient::Patient;
use crate::purse::Purses;
use crate::source::Procedural;
use crate::{SOFTWARE, http};
use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use protocol::server::ServerOffer;
use rayon::ThreadPoolBuildError;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;
use terrain::Land;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

/// Connections beyond the sessions, for probes, metrics and chunk downloads. When all are taken,
/// accepting pauses and the system's backlog holds the rest.
const SPARE_CONNECTIONS: usize = 256;

/// Connections that one address may have beyond its sessions: a quarter of the spare ones, so that
/// nobody takes them all.
const SPARE_OF_ADDRESS: usize = SPARE_CONNECTIONS / 4;

/// Of the memory for chunks, as much again as one part in so many for tiles of the map.
const MAP_SHARE: u64 = 8;

/// Bytes that hyper may hold of one request's headers.
const HEADER_BUFFER: usize = 16 * 1024;

/// What every connection shares.
pub struct Shared {
    /// The checked configuration.
    pub config: ServerConfig,
    /// What is offered to sessions.
    pub offer: ServerOffer,
    /// Makes chunk frames.
    pub generation: Generation,
    /// Paints the map.
    pub map: Map,
    /// Who is where.
    pub live: Live,
    /// Counts.
    pub metrics: Arc<Metrics>,
    /// Cancelled when the server begins to drain.
    pub draining: CancellationToken,
    /// Session tasks; the server is done when the last one is.
    pub sessions: TaskTracker,
    /// One permit per allowed session, held inside the session task.
    pub permits: Arc<Semaphore>,
    /// Sessions by address.
    pub addresses: Addresses,
    /// What addresses may cost.
    pub purses: Purses,
    /// Number of the next session.
    pub next_session: AtomicU64,
}

impl Shared {
    /// All of a server but its doors.
    ///
    /// # Errors
    /// The system refuses to start the generation threads.
    pub fn new(config: ServerConfig) -> Result<Self, ThreadPoolBuildError> {
        let land = Land::new(config.world_seed);
        let metrics = Arc::new(Metrics::default());
        let source = Procedural::new(land);
        let limits = Limits {
            threads: config.threads,
            cache_bytes: config.cache_bytes,
            jobs: config.max_jobs,
            deadline: config.deadline,
        };
        let disk = config.disk.clone().and_then(|disk| {
            Disk::new(disk, &land.digest(), Arc::clone(&metrics))
                .inspect_err(|error| tracing::warn!(%error, "no thread for the disk cache; the server goes on without"))
                .ok()
        });
        let generation = Generation::with_disk(source, limits, disk, Arc::clone(&metrics))?;
        let token = config.token.clone();
        Ok(Self {
            offer: ServerOffer { land, digest: land.digest(), token, software: SOFTWARE.into() },
            map: Map::new(land.digest(), config.cache_bytes / MAP_SHARE, config.threads),
            live: Live::default(),
            generation,
            metrics,
            draining: CancellationToken::new(),
            sessions: TaskTracker::new(),
            permits: Arc::new(Semaphore::new(config.max_sessions)),
            next_session: AtomicU64::new(1),
            purses: Purses::new(config.cost_per_second),
            addresses: Addresses::new(config.max_sessions_per_address),
            config,
        })
    }
}

/// Serves until `shutdown` completes, then drains: no new connections, a notice and a close frame
/// to every session, and at most [`ServerConfig::drain_timeout`] for them to end.
///
/// # Errors
/// The system refuses to start the generation threads. Accept errors are logged and survived.
pub async fn run(
    listener: TcpListener,
    config: ServerConfig,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ThreadPoolBuildError> {
    let shared = Arc::new(Shared::new(config)?);
    let address = listener.local_addr().map_or_else(|_| "unknown".into(), |address| address.to_string());
    tracing::info!(%address, world_seed = shared.config.world_seed, digest = %shared.offer.digest, "listening");

    let router = http::router(Arc::clone(&shared));
    let connections = TaskTracker::new();
    let slots = Arc::new(Semaphore::new(shared.config.max_sessions + SPARE_CONNECTIONS));
    // A session leaves its connection's place when it begins, so these are requests, downloads, and
    // who has not said what it wants.
    let places = Addresses::new(shared.config.max_sessions_per_address.saturating_add(SPARE_OF_ADDRESS));
    tokio::pin!(shutdown);
    loop {
        let slot = tokio::select! {
            () = &mut shutdown => break,
            // The semaphore is never closed.
            Ok(slot) = Arc::clone(&slots).acquire_owned() => slot,
        };
        let (stream, peer) = tokio::select! {
            () = &mut shutdown => break,
            stream = accept(&listener) => stream,
        };
        let Some(place) = places.enter(Some(peer.ip())) else {
            // Closed without a word: whoever has so many is not waiting for one.
            shared.metrics.connection_refusals.inc();
            continue;
        };
        let (router, shared) = (router.clone(), Arc::clone(&shared));
        connections.spawn(async move {
            shared.metrics.connections.inc();
            serve_connection(stream, peer, router, &shared).await;
            shared.metrics.connections.dec();
            drop((slot, place));
        });
    }

    drop(listener);
    tracing::info!(sessions = shared.sessions.len(), "draining");
    shared.draining.cancel();
    shared.sessions.close();
    connections.close();
    let all_gone = async {
        shared.sessions.wait().await;
        connections.wait().await;
    };
    if tokio::time::timeout(shared.config.drain_timeout, all_gone).await.is_err() {
        tracing::warn!(sessions = shared.sessions.len(), "drain timed out, leaving sessions behind");
    }
    shared.generation.close().await;
    tracing::info!("stopped");
    Ok(())
}

/// Accepts one connection. A failure (most often: out of file descriptors) is waited out, since the
/// cause outlives a retry.
async fn accept(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                // Frames are written whole; waiting to fill packets would only delay the last one.
                let _ = stream.set_nodelay(true);
                return (stream, peer);
            }
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

async fn serve_connection(stream: TcpStream, peer: SocketAddr, router: axum::Router, shared: &Shared) {
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        request.extensions_mut().insert(peer);
        router.clone().oneshot(request.map(Body::new))
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(shared.config.handshake_timeout)
        .max_buf_size(HEADER_BUFFER)
        .serve_connection(TokioIo::new(Patient::new(stream, shared.config.write_timeout)), service)
        .with_upgrades();
    tokio::pin!(connection);
    let result = tokio::select! {
        result = &mut connection => result,
        () = shared.draining.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "connection ended");
    }
}
