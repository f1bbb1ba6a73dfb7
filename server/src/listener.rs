//! Accepts connections, serves them, and drains them on shutdown.
//!
//! A hand-written accept loop around hyper instead of `axum::serve`: hyper enforces its header
//! timeout only when it is given a timer, and upgraded sockets have to be counted and drained.

use crate::config::{EXTRA_CONNECTIONS, ServerConfig};
use crate::connections::{ConnectionFailure, ConnectionState, OpenConnection, OpenConnections};
use crate::http;
use crate::limits::per_ip::{IpPermit, PerIpLimiter};
use crate::limits::system_buffers;
use crate::limits::write_timeout::WriteTimeoutStream;
use crate::memory::mark;
use crate::proxy::proxy_protocol;
use crate::reload;
use crate::session::end::EndReason;
use crate::state::ServerState;
use crate::tls::PeerStream;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use rayon::ThreadPoolBuildError;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;
use std::{io, mem};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, timeout};
use tokio_util::either::Either;
use tokio_util::task::{AbortOnDropHandle, TaskTracker};
use tower::ServiceExt;

/// When fewer permits are free, each connection that is accepted displaces one
/// ([`OpenConnections::displace_for`]). A place becomes free within [`DISPLACEMENT`]; until then
/// the permits suffice for the next ones. Without a permit a connection is closed: accepting never
/// waits.
const RESERVED_CONNECTIONS: usize = EXTRA_CONNECTIONS / 4;

/// Time in which a displaced connection may finish its request.
const DISPLACEMENT: Duration = Duration::from_millis(250);

/// Limit of hyper's buffer for one request's headers, bytes.
const HEADER_BUFFER: usize = 16 * 1024;

/// Pause after a failed accept. The usual cause is a lack of file descriptors, which an immediate
/// retry would meet again.
const ACCEPT_RETRY: Duration = Duration::from_millis(100);

/// Time between two lines about failed accepts.
const ACCEPT_LOG_INTERVAL: Duration = Duration::from_secs(60);

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

    let (cache_mib, memory) = (state.config.cache_bytes >> 20, state.config.memory.as_ref());
    let memory = memory.map_or_else(|| "unknown".into(), ToString::to_string);
    tracing::info!(cache_mib, memory, "chunk cache, and memory that this process may use");
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
    )));
    let router = http::router(Arc::clone(&state));
    let connections = TaskTracker::new();
    let total = state.config.max_connections();
    let permits = Arc::new(Semaphore::new(total));
    // A session releases its connection's permits when it starts, so these count requests,
    // downloads, and connections that have sent nothing yet.
    let per_ip = state.config.connections_per_ip();
    let places = Places { permits, per_ip, open: OpenConnections::default() };
    let mut failures = AcceptFailures::default();
    tokio::pin!(shutdown);
    loop {
        let (stream, peer) = tokio::select! {
            () = &mut shutdown => break,
            stream = accept(&listener, state.config.write_timeout, &mut failures) => stream,
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

/// Accepts one connection, retrying after failures. The system ends it when its peer takes no bytes
/// for `write_timeout`.
async fn accept(
    listener: &TcpListener,
    write_timeout: Duration,
    failures: &mut AcceptFailures,
) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                // Messages are written whole; Nagle's algorithm would only delay the last packet.
                let _ = stream.set_nodelay(true);
                system_buffers::limit(&stream, write_timeout);
                return (stream, peer);
            }
            Err(error) => {
                if let Some(failures) = failures.record(Instant::now()) {
                    tracing::warn!(%error, failures, "cannot accept a connection");
                }
                tokio::time::sleep(ACCEPT_RETRY).await;
            }
        }
    }
}

/// Failed accepts: there are ten a second while file descriptors lack, and one line a minute.
#[derive(Debug, Default)]
struct AcceptFailures {
    logged: Option<Instant>,
    /// Failures since then.
    count: u64,
}

impl AcceptFailures {
    /// Counts a failure; if a line is due, the failures since the last one.
    fn record(&mut self, now: Instant) -> Option<u64> {
        self.count += 1;
        if self.logged.is_some_and(|logged| now.saturating_duration_since(logged) < ACCEPT_LOG_INTERVAL) {
            return None;
        }
        self.logged = Some(now);
        Some(mem::take(&mut self.count))
    }
}

/// Places of connections: in all, by client network, and the open connections of clients.
#[derive(Clone)]
struct Places {
    permits: Arc<Semaphore>,
    per_ip: PerIpLimiter,
    open: OpenConnections,
}

/// The place of a connection, released on drop.
struct HeldPlace {
    places: Places,
    #[expect(dead_code, reason = "held for its drop")]
    permit: OwnedSemaphorePermit,
    /// None of a proxy.
    client: Option<ClientPlace>,
}

/// The part of a client in a place, released on drop.
struct ClientPlace {
    connection: OpenConnection,
    #[expect(dead_code, reason = "held for its drop")]
    ip_permit: IpPermit,
}

impl Places {
    /// The place of a connection; none if there is none, or if the client's network has all of its
    /// own.
    fn take(&self, peer: IpAddr, is_proxy: bool, state: &ServerState) -> Option<HeldPlace> {
        let permit = Arc::clone(&self.permits).try_acquire_owned().ok();
        let ip_permit = if is_proxy { None } else { Some(self.permit_of(peer, state)?) };
        if self.permits.available_permits() < RESERVED_CONNECTIONS && self.open.displace_for(peer) {
            let reason = ConnectionFailure::Displaced.name();
            state.metrics.limits.connection_failed(reason);
        }
        let Some(permit) = permit else {
            state.metrics.limits.connections_rejected.inc();
            return None;
        };
        let client = ip_permit.map(|ip_permit| self.client_place(peer, ip_permit));
        Some(HeldPlace { places: self.clone(), permit, client })
    }

    /// The permit of a client; none if its network has all of its own.
    fn permit_of(&self, client: IpAddr, state: &ServerState) -> Option<IpPermit> {
        let permit = self.per_ip.try_acquire(Some(client), self.permits.available_permits());
        if permit.is_none() {
            state.metrics.limits.connections_rejected.inc();
            state.peer_log.report(Some(client), "too many connections");
        }
        permit
    }

    fn client_place(&self, client: IpAddr, ip_permit: IpPermit) -> ClientPlace {
        ClientPlace { connection: self.open.add(client), ip_permit }
    }
}

impl HeldPlace {
    /// The state of the connection; of a proxy's one that nothing displaces.
    fn state(&self) -> Arc<ConnectionState> {
        self.client.as_ref().map(|client| client.connection.state()).unwrap_or_default()
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
            let Some(ip_permit) = place.places.permit_of(client, state) else { return Ok(None) };
            place.client = Some(place.places.client_place(client, ip_permit));
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
    use futures_util::FutureExt;
    use tokio::sync::oneshot;

    #[test]
    fn failed_accepts_have_one_line_a_minute_with_their_number() {
        let (mut failures, start) = (AcceptFailures::default(), Instant::now());
        assert_eq!(failures.record(start), Some(1));
        let soon = (1..600).filter_map(|n| failures.record(start + ACCEPT_RETRY * n)).count();
        assert_eq!(soon, 0);
        assert_eq!(failures.record(start + ACCEPT_LOG_INTERVAL), Some(600));
        assert_eq!(failures.record(start + ACCEPT_LOG_INTERVAL), None);
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
