//! Accepts connections, serves them, and drains them on shutdown.
//!
//! A hand-written accept loop around hyper instead of `axum::serve`: hyper enforces its header
//! timeout only when it is given a timer, and upgraded sockets have to be counted and drained.

use crate::config::ServerConfig;
use crate::http;
use crate::limits::per_ip::PerIpLimiter;
use crate::limits::write_timeout::WriteTimeoutStream;
use crate::state::ServerState;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use rayon::ThreadPoolBuildError;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

/// Connections in addition to sessions: probes, metrics and downloads. When all permits are taken,
/// accepting pauses and the system's backlog queues further connections.
const EXTRA_CONNECTIONS: usize = 256;

/// Connections per client network in addition to its sessions: a quarter, so that one network
/// cannot take all.
const EXTRA_CONNECTIONS_PER_IP: usize = EXTRA_CONNECTIONS / 4;

/// Limit of hyper's buffer for one request's headers, bytes.
const HEADER_BUFFER: usize = 16 * 1024;

/// Pause after a failed accept. The usual cause is a lack of file descriptors, which an immediate
/// retry would meet again.
const ACCEPT_RETRY: Duration = Duration::from_millis(100);

/// Serves until `shutdown` completes, then drains: no new connections, a notice and a close frame
/// to every session, and at most [`ServerConfig::drain_timeout`] for them to end.
///
/// # Errors
/// The system cannot start the generation threads. Accept errors are logged and retried.
pub async fn run(
    listener: TcpListener,
    config: ServerConfig,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ThreadPoolBuildError> {
    let state = Arc::new(ServerState::new(config)?);
    let address = listener.local_addr().map_or_else(|_| "unknown".into(), |address| address.to_string());
    tracing::info!(%address, world_seed = state.config.world_seed, digest = %state.offer.digest, "listening");

    if let Some(mechanism) = state.config.without {
        tracing::warn!(?mechanism, "a mechanism against overload is turned off: for measurements only");
    }

    let router = http::router(Arc::clone(&state));
    let connections = TaskTracker::new();
    let permits = Arc::new(Semaphore::new(state.config.max_sessions + EXTRA_CONNECTIONS));
    // A session releases its connection's permits when it starts, so these count requests,
    // downloads, and connections that have sent nothing yet.
    let max_per_ip = state.config.max_sessions_per_address.saturating_add(EXTRA_CONNECTIONS_PER_IP);
    let connections_per_ip = PerIpLimiter::new(max_per_ip);
    tokio::pin!(shutdown);
    loop {
        let permit = tokio::select! {
            () = &mut shutdown => break,
            // The semaphore is never closed.
            Ok(permit) = Arc::clone(&permits).acquire_owned() => permit,
        };
        let (stream, peer) = tokio::select! {
            () = &mut shutdown => break,
            stream = accept(&listener) => stream,
        };
        let Some(ip_permit) = connections_per_ip.try_acquire(Some(peer.ip())) else {
            // Closed without a response, which would cost more than the accept.
            state.metrics.connections_rejected.inc();
            continue;
        };
        let (router, state) = (router.clone(), Arc::clone(&state));
        connections.spawn(async move {
            state.metrics.connections.inc();
            serve_connection(stream, peer, router, &state).await;
            state.metrics.connections.dec();
            drop((permit, ip_permit));
        });
    }

    drop(listener);
    tracing::info!(sessions = state.sessions.len(), "draining");
    state.draining.cancel();
    state.sessions.close();
    connections.close();
    let drained = async {
        state.sessions.wait().await;
        connections.wait().await;
    };
    if tokio::time::timeout(state.config.drain_timeout, drained).await.is_err() {
        tracing::warn!(sessions = state.sessions.len(), "drain timed out with open sessions");
    }
    state.generation.close().await;
    tracing::info!("stopped");
    Ok(())
}

/// Accepts one connection, retrying after failures.
async fn accept(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                // Messages are written whole; Nagle's algorithm would only delay the last packet.
                let _ = stream.set_nodelay(true);
                return (stream, peer);
            }
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(ACCEPT_RETRY).await;
            }
        }
    }
}

async fn serve_connection(stream: TcpStream, peer: SocketAddr, router: axum::Router, state: &ServerState) {
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        request.extensions_mut().insert(peer);
        router.clone().oneshot(request.map(Body::new))
    });
    let stream = WriteTimeoutStream::new(stream, state.config.write_timeout);
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(state.config.handshake_timeout)
        .max_buf_size(HEADER_BUFFER)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    tokio::pin!(connection);
    let result = tokio::select! {
        result = &mut connection => result,
        () = state.draining.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "connection ended");
    }
}
