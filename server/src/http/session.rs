//! The route of sessions: checks handshake, origin and token, and starts a session task.

use crate::access::gate::{Presenter, Refusal};
use crate::access::hosts::Target;
use crate::http::client;
use crate::http::problem::{Problem, ProblemKind};
use crate::limits::per_ip::IpPermit;
use crate::limits::system_buffers;
use crate::open_sessions::Eviction;
use crate::proxy::ClientAddress;
use crate::session::driver::{self, READ_LIMIT};
use crate::state::ServerState;
use crate::tls::tcp_stream;
use crate::websocket::upgrade::{Upgrade, VERSION};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use data_encoding::BASE64URL_NOPAD;
use protocol::SUBPROTOCOL;
use protocol::server::ServerOffer;
use std::borrow::Cow;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

/// Start of a subprotocol entry with a token.
const TOKEN_SUBPROTOCOL: &str = "tombolo.bearer.";

/// `/v1/stream`, all methods.
pub async fn stream(State(state): State<Arc<ServerState>>, mut request: Request) -> Response {
    let upgrade = match Upgrade::of(&mut request) {
        Ok(upgrade) => upgrade,
        Err((status, sentence)) => return rejection(status, sentence),
    };
    let peer = request.extensions().get::<ClientAddress>().map(|client| client.0);
    let headers = request.headers();
    if !state.config.allowed_origins.allows(headers, request.extensions().get::<Target>()) {
        state.peer_log.report(peer, "page of another origin");
        let sentence = "this page may not open sessions here; see the option allowed-origin of the server";
        return Problem::new(ProblemKind::ForeignOrigin, sentence).into_response();
    }
    let offered = subprotocols(headers);
    if !offered.contains(&SUBPROTOCOL) {
        let shown = match offered.iter().find(|name| !name.starts_with(TOKEN_SUBPROTOCOL)) {
            Some(name) => name.chars().take(100).collect(),
            None => "none".to_owned(),
        };
        let sentence = format!("the client offers subprotocol {shown}, this server supports {SUBPROTOCOL}");
        return Problem::new(ProblemKind::BadHandshake, sentence).into_response();
    }
    let presented = match presented_token(headers, &offered) {
        Ok(presented) => presented,
        Err(problem) => return problem.into_response(),
    };
    let mut offer = state.offer.clone();
    match state.gate.check(peer, Presenter::Client, presented.as_deref()) {
        Ok(()) => {}
        // The hello of the session has to contain it.
        Err(Refusal::Missing) => offer.token = Some(state.gate.of_session(peer)),
        Err(refusal) => return client::problem(refusal).into_response(),
    }
    if state.draining.is_cancelled() {
        let sentence = "the server is shutting down, retry later";
        return Problem::new(ProblemKind::NoSession, sentence).into_response();
    }
    let Ok(permit) = Arc::clone(&state.session_permits).try_acquire_owned() else {
        if state.memory.is_below() && state.sessions_per_ip.try_acquire(peer, 0).is_some() {
            displace_for(peer, &offer, &state);
        }
        return Problem::new(ProblemKind::NoSession, "no session is free, retry later").into_response();
    };
    let free = state.session_permits.available_permits();
    let Some(ip_permit) = state.sessions_per_ip.try_acquire(peer, free) else {
        state.peer_log.report(peer, "too many sessions");
        let sentence = "too many sessions from this address, end one or retry later";
        return Problem::new(ProblemKind::AddressFull, sentence).into_response();
    };
    // Last: a client that is rejected takes no room. One for whose site a session ended has the
    // memory of that one.
    let held = state.open_sessions.held(peer);
    let is_admitted = state.memory.admits(peer, held)
        || (held == 0 && state.memory.is_below() && state.open_sessions.take_place(peer, Instant::now()));
    if !is_admitted {
        if held == 0 && state.memory.is_full() {
            displace_for(peer, &offer, &state);
        }
        let sentence = "the server has little memory left, retry later";
        return Problem::new(ProblemKind::NoSession, sentence).into_response();
    }
    let parent = state.traces.parent(headers);
    let response = upgrade.response(Some(SUBPROTOCOL));
    let number = state.next_session.fetch_add(1, Ordering::Relaxed);
    let tracker = state.sessions.clone();
    tracker.spawn(async move {
        // Bounded, as its client may not read the response. Boxed, so that an idle session stays
        // small.
        let upgraded = timeout(state.config.handshake_timeout, upgrade.socket(READ_LIMIT));
        let Ok(Some(socket)) = Box::pin(upgraded).await else { return };
        let bucket = state.rate_limiter.bucket(peer);
        let open = state.open_sessions.register(number, peer);
        let ended = driver::serve(socket, &state, offer, open, bucket, parent).await;
        if ended.reason.leaves_unread_bytes() || ended.eviction == Some(Eviction::Memory) {
            system_buffers::discard(tcp_stream(&ended.stream));
        }
        drop(ended.stream);
        if ended.reason.is_breach() {
            state.peer_log.report(peer, ended.reason.name());
        }
        // For clients of other sites: no session that could be displaced holds it any more.
        drop(permit);
        keep_in_share(ip_permit, ended.backoff_until, &state.draining).await;
    });
    response
}

/// Ends a session of a site that has more, for a client that gets none. Its place and its memory
/// become free for the retry; they are not reserved. Not for a client that may have no token: it
/// would end the sessions of those that have one.
fn displace_for(client: Option<IpAddr>, offer: &ServerOffer, state: &ServerState) {
    if offer.token.is_none() {
        let _ = state.open_sessions.displace_for(client, Instant::now());
    }
}

/// Counts a session that has ended for its network until its refusal back-off has ended: otherwise
/// its client could skip the pauses by a new session.
async fn keep_in_share(
    ip_permit: IpPermit,
    backoff_until: tokio::time::Instant,
    draining: &CancellationToken,
) {
    tokio::select! {
        () = tokio::time::sleep_until(backoff_until) => {}
        () = draining.cancelled() => {}
    }
    drop(ip_permit);
}

/// The response to an invalid handshake.
fn rejection(status: StatusCode, sentence: &str) -> Response {
    let kind = match status {
        StatusCode::METHOD_NOT_ALLOWED => ProblemKind::WrongMethod,
        StatusCode::UPGRADE_REQUIRED => ProblemKind::NotAnUpgrade,
        _ => ProblemKind::BadHandshake,
    };
    let mut response = Problem::new(kind, sentence).into_response();
    if kind == ProblemKind::WrongMethod {
        response.headers_mut().insert(header::ALLOW, HeaderValue::from_static("GET"));
    }
    // RFC 6455, section 4.2.2: a rejected client learns which version would be accepted.
    response.headers_mut().insert(header::SEC_WEBSOCKET_VERSION, VERSION);
    response
}

/// All names that the client offers.
fn subprotocols(headers: &HeaderMap) -> Vec<&str> {
    headers
        .get_all(header::SEC_WEBSOCKET_PROTOCOL)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .map(str::trim)
        .filter(|name| !name.is_empty())
        .collect()
}

/// The token of `Authorization`, or of an entry beside the subprotocol: scripts of browsers cannot
/// set headers.
fn presented_token<'a>(headers: &'a HeaderMap, offered: &[&str]) -> Result<Option<Cow<'a, str>>, Problem> {
    if let Some(token) = client::bearer(headers) {
        return Ok(Some(token.into()));
    }
    let Some(entry) = offered.iter().find_map(|name| name.strip_prefix(TOKEN_SUBPROTOCOL)) else {
        return Ok(None);
    };
    let token = BASE64URL_NOPAD.decode(entry.as_bytes()).ok().and_then(|token| String::from_utf8(token).ok());
    let malformed = || {
        let sentence =
            format!("what follows `{TOKEN_SUBPROTOCOL}` must be the token in base64url without padding");
        Problem::new(ProblemKind::BadHandshake, sentence)
    };
    token.map(|token| Some(token.into())).ok_or_else(malformed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::per_ip::PerIpLimiter;
    use futures_util::FutureExt;
    use std::pin::pin;
    use std::time::Duration;

    #[tokio::test]
    async fn a_session_counts_for_its_network_until_its_backoff_ends() {
        let (per_ip, draining) = (PerIpLimiter::new(1), CancellationToken::new());
        let client = Some(IpAddr::from([10, 0, 0, 1]));
        let ip_permit = per_ip.try_acquire(client, 0).unwrap();
        let until = tokio::time::Instant::now() + Duration::from_secs(3600);
        let mut keeping = pin!(keep_in_share(ip_permit, until, &draining));
        assert!(keeping.as_mut().now_or_never().is_none());
        assert!(per_ip.try_acquire(client, 0).is_none());
        draining.cancel();
        keeping.await;
        assert!(per_ip.try_acquire(client, 0).is_some());
    }
}
