//! The route of sessions: checks the handshake and starts a session task.

use crate::http::problem::{Problem, ProblemKind};
use crate::session::driver::{self, READ_LIMIT};
use crate::state::ServerState;
use crate::websocket::upgrade::{Upgrade, VERSION};
use axum::extract::{Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use protocol::SUBPROTOCOL;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// `/v1/stream`, all methods.
pub async fn stream(State(state): State<Arc<ServerState>>, mut request: Request) -> Response {
    let upgrade = match Upgrade::of(&mut request) {
        Ok(upgrade) => upgrade,
        Err((status, sentence)) => return rejection(status, sentence),
    };
    let offered: Vec<_> = request
        .headers()
        .get_all(header::SEC_WEBSOCKET_PROTOCOL)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .collect();
    let offered = offered.join(", ");
    if !offered.split(',').any(|name| name.trim() == SUBPROTOCOL) {
        let shown: String =
            if offered.is_empty() { "none".into() } else { offered.chars().take(100).collect() };
        let sentence = format!("the client offers subprotocol {shown}, this server supports {SUBPROTOCOL}");
        return Problem::new(ProblemKind::BadHandshake, sentence).into_response();
    }
    let permit = Arc::clone(&state.session_permits).try_acquire_owned();
    let (false, Ok(permit)) = (state.draining.is_cancelled(), permit) else {
        return Problem::new(ProblemKind::NoSession, "no session is free, retry later").into_response();
    };
    let peer = peer_address(&request);
    let Some(ip_permit) = state.sessions_per_ip.try_acquire(peer) else {
        let sentence = "too many sessions from this address, end one or retry later";
        return Problem::new(ProblemKind::AddressFull, sentence).into_response();
    };
    let response = upgrade.response(Some(SUBPROTOCOL));
    let number = state.next_session.fetch_add(1, Ordering::Relaxed);
    let tracker = state.sessions.clone();
    tracker.spawn(async move {
        if let Some(socket) = upgrade.socket(READ_LIMIT).await {
            driver::serve(socket, &state, number, state.rate_limiter.bucket(peer)).await;
        }
        drop((permit, ip_permit));
    });
    response
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

/// The peer's address, inserted by the accept loop.
fn peer_address(request: &Request) -> Option<IpAddr> {
    request.extensions().get::<SocketAddr>().map(SocketAddr::ip)
}
