//! Accepts connections, serves them, and drains them on shutdown.
//!
//! A hand-written accept loop around hyper instead of `axum::serve`: hyper enforces its header
//! timeout only when it is given a timer, and upgraded sockets have to be counted and drained.

mod accept;
mod places;

use crate::config::ServerConfig;
use crate::connections::{ConnectionFailure, ConnectionState};
use crate::http;
use crate::limits::write_timeout::WriteTimeoutStream;
use crate::memory::{self, mark};
use crate::proxy::proxy_protocol;
use crate::reload;
use crate::session::end::EndReason;
use crate::state::ServerState;
use crate::tls::PeerStream;
use accept::AcceptFailures;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use places::{HeldPlace, Places};
use rayon::ThreadPoolBuildError;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::time::timeout;
use tokio_util::either::Either;
use tokio_util::task::{AbortOnDropHandle, TaskTracker};
use tower::ServiceExt;

/// Time in which a displaced connection may finish its request.
const DISPLACEMENT: Duration = Duration::from_millis(250);

/// Limit of hyper's buffer for one request's headers, bytes.
const HEADER_BUFFER: usize = 16 * 1024;

/// Connections that the system keeps until they are accepted; Linux bounds it by
/// `net.core.somaxconn`, 4,096 by default. Beyond it the system drops the handshake of a new
/// connection, which its client repeats a second later. This many may come at once after a restart.
const BACKLOG: u32 = 4096;

/// Listens on an address, with room for many new connections at once.
///
/// # Errors
/// The address is taken or not of this machine.
pub fn bind(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    // As tokio does: a restarted server gets its port although old connections linger. On Windows
    // the option would let two servers share a port.
    #[cfg(not(windows))]
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

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

    let (cache_bytes, limit) = (state.config.cache_bytes, state.config.memory.as_ref());
    let memory = limit.map_or_else(|| "unknown".into(), ToString::to_string);
    tracing::info!(
        cache_mib = cache_bytes >> 20,
        memory,
        "chunk cache, and memory that this process may use"
    );
    if !memory::has_room_for_cache(limit, cache_bytes) {
        tracing::warn!("the chunk cache may exceed the memory: it will be cleared often; reduce --cache-mb");
    }
    if let Some(mechanism) = state.config.without {
        tracing::warn!(?mechanism, "a mechanism against overload is turned off: for measurements only");
    }

    state.metrics.sessions.declare_ends(EndReason::ALL.map(EndReason::name));
    state.metrics.limits.declare_connection_ends(ConnectionFailure::ALL.map(ConnectionFailure::name));
    warn_of_openness(&state, &listener);
    let _reload = AbortOnDropHandle::new(tokio::spawn(reload::run(Arc::clone(&state))));
    let _memory = AbortOnDropHandle::new(tokio::spawn(mark::watch(
        Arc::clone(&state.memory),
        Arc::clone(&state.metrics),
        state.open_sessions.clone(),
        Arc::clone(&state),
    )));
    let _peer_log = AbortOnDropHandle::new(tokio::spawn(Arc::clone(&state.peer_log).run()));
    let router = http::router(Arc::clone(&state));
    let connections = TaskTracker::new();
    let places = Places::new(&state.config);
    let mut failures = AcceptFailures::default();
    tokio::pin!(shutdown);
    loop {
        let (stream, peer) = tokio::select! {
            () = &mut shutdown => break,
            stream = accept::accept(&listener, state.config.write_timeout, &mut failures) => stream,
        };
        let peer = peer.ip().to_canonical();
        // The connections of a proxy are those of all its clients.
        let is_proxy = state.config.proxies.contains(peer);
        // Closed without a response, which would cost more than the accept.
        let Some(place) = places.take(peer, is_proxy, &state) else { continue };
        let (router, state) = (router.clone(), Arc::clone(&state));
        connections.spawn(async move {
            state.metrics.limits.connections.inc();
            serve_connection(stream, peer, place, router, &state).await;
            state.metrics.limits.connections.dec();
        });
    }

    drop(listener);
    tracing::info!(sessions = state.sessions.len(), "draining");
    state.draining.cancel();
    state.sessions.close();
    connections.close();
    if timeout(state.config.drain_timeout, ended(&connections, &state.sessions)).await.is_err() {
        tracing::warn!(sessions = state.sessions.len(), "drain timed out with open sessions");
    }
    state.generation.close().await;
    state.peer_log.write();
    tracing::info!("stopped");
    Ok(())
}

/// Waits until all connections and sessions have ended. Connections first: the upgrade of one that
/// was checked just before the server began to drain may begin a session, and a connection ends
/// with its upgrade, before its session.
async fn ended(connections: &TaskTracker, sessions: &TaskTracker) {
    connections.wait().await;
    sessions.wait().await;
}

/// Logs warnings for the operator of a server that other machines reach.
fn warn_of_openness(state: &ServerState, listener: &TcpListener) {
    let is_loopback = listener.local_addr().is_ok_and(|address| address.ip().to_canonical().is_loopback());
    if is_loopback {
        return;
    }
    if state.config.tls.is_none() && !state.config.proxies.any() {
        tracing::warn!("without TLS: machines on the way can read tokens and positions");
    }
    if !state.gate.requires_token() {
        tracing::warn!("without tokens: every client that reaches this address may open sessions");
    }
}

/// Serves one connection to its end or to its upgrade. `peer` is at the other end of it.
async fn serve_connection(
    stream: TcpStream,
    peer: IpAddr,
    place: HeldPlace,
    router: axum::Router,
    state: &ServerState,
) {
    let held = place.state();
    let opening = timeout(state.config.handshake_timeout, open(stream, peer, place, state));
    let opened = tokio::select! {
        opened = opening => {
            opened.unwrap_or(Err(Failure { client: peer, reason: ConnectionFailure::OpeningTimeout }))
        }
        () = held.displaced() => return,
        () = state.draining.cancelled() => return,
    };
    let (stream, client, place) = match opened {
        Ok(Some(opened)) => opened,
        Ok(None) => return,
        Err(Failure { client, reason }) => {
            let reason = reason.name();
            state.metrics.limits.connection_failed(reason);
            state.peer_log.report(Some(client), reason);
            return;
        }
    };
    serve_requests(stream, client, &place.state(), router, state).await;
    drop(place);
}

/// A connection that ended before its first request.
struct Failure {
    client: IpAddr,
    reason: ConnectionFailure,
}

/// The steps before requests: the header of a trusted proxy, and the handshake of TLS. None if the
/// client of a proxy has no place, or if the connection ends for another one.
async fn open(
    mut stream: TcpStream,
    peer: IpAddr,
    mut place: HeldPlace,
    state: &ServerState,
) -> Result<Option<(PeerStream, IpAddr, HeldPlace)>, Failure> {
    let mut client = peer;
    if state.config.proxies.sends_proxy_header(peer) {
        let named = proxy_protocol::read(&mut stream).await;
        // A proxy that asks for itself has no client.
        if let Some(named) = named.map_err(|error| failure(peer, ConnectionFailure::ProxyHeader, &error))? {
            client = named.to_canonical();
            if !place.add_client(client, state) {
                return Ok(None);
            }
        }
    }
    let stream = match &state.config.tls {
        None => Either::Left(stream),
        Some(tls) => {
            // Behind a proxy the client has a place, which another one may need, since its header.
            let held = place.state();
            let accepted = tokio::select! {
                accepted = tls.accept(stream, client) => accepted,
                () = held.displaced() => return Ok(None),
            };
            let accepted =
                accepted.map_err(|error| failure(client, ConnectionFailure::TlsHandshake, &error))?;
            Either::Right(Box::new(accepted))
        }
    };
    Ok(Some((stream, client, place)))
}

fn failure(client: IpAddr, reason: ConnectionFailure, error: &io::Error) -> Failure {
    tracing::debug!(%client, reason = reason.name(), %error, "connection ended");
    Failure { client, reason }
}

/// Serves HTTP requests. `connected` is the client, or a proxy that names it in each request.
async fn serve_requests(
    stream: PeerStream,
    connected: IpAddr,
    open: &Arc<ConnectionState>,
    router: axum::Router,
    state: &ServerState,
) {
    let proxies = state.config.proxies.clone();
    let busy = Arc::clone(open);
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        let client = proxies.client(connected, request.headers());
        request.extensions_mut().insert(client);
        let (answered, busy) = (router.clone().oneshot(request.map(Body::new)), Arc::clone(&busy));
        busy.set_busy(true);
        async move {
            let response = answered.await;
            busy.set_busy(false);
            response
        }
    });
    let stream = WriteTimeoutStream::new(stream, state.config.write_timeout);
    // Without `half_close`: the end of a client's direction is the only sign that it no longer
    // waits for its response, as a page for a map tile after a move. Its request is cancelled;
    // otherwise it would keep its turn and its places, those of a tile for 10 s. In consequence a
    // client that ends its direction after its request (`nc -N`) gets no response.
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
        () = open.displaced() => {
            connection.as_mut().graceful_shutdown();
            timeout(DISPLACEMENT, connection).await.unwrap_or(Ok(()))
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "connection ended");
        // A timeout is no breach: browsers leave connections idle.
        if error.is_parse() {
            state.peer_log.report(Some(connected), "malformed HTTP");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::StatusCode;
    use axum::routing::get;
    use futures_util::FutureExt;
    use std::future::pending;
    use tokio::io::AsyncWriteExt;
    use tokio::sync::oneshot;

    #[tokio::test]
    async fn the_request_of_a_client_that_ends_its_direction_is_cancelled() {
        let listener = bind(([127, 0, 0, 1], 0).into()).unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap());
        let (client, accepted) = tokio::join!(client, listener.accept());
        let (mut client, (stream, peer)) = (client.unwrap(), accepted.unwrap());
        client.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
        client.shutdown().await.unwrap();
        let router = axum::Router::new().route("/", get(pending::<StatusCode>));
        let state = ServerState::new(ServerConfig { threads: 1, ..ServerConfig::default() }).unwrap();
        let open = Arc::default();
        let served = serve_requests(Either::Left(stream), peer.ip(), &open, router, &state);
        timeout(Duration::from_secs(30), served).await.expect("nothing is served to its end");
    }

    #[tokio::test]
    async fn a_session_that_a_late_upgrade_begins_is_waited_for() {
        let (connections, sessions) = (TaskTracker::new(), TaskTracker::new());
        let (upgrade, upgraded) = oneshot::channel();
        let (end, ended_by) = oneshot::channel::<()>();
        let tracker = sessions.clone();
        let connection = connections.spawn(async move {
            upgraded.await.unwrap();
            drop(tracker.spawn(ended_by));
        });
        sessions.close();
        connections.close();
        let mut ended = std::pin::pin!(ended(&connections, &sessions));
        assert!(ended.as_mut().now_or_never().is_none());
        upgrade.send(()).unwrap();
        connection.await.unwrap();
        assert!(ended.as_mut().now_or_never().is_none(), "the session is open");
        end.send(()).unwrap();
        ended.await;
    }
}
