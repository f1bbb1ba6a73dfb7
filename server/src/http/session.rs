//! The door to a session: from an HTTP request to a WebSocket.

use crate::http::problem::{Kind, Problem};
use crate::listener::Shared;
use crate::socket;
use crate::upgrade::Upgrade;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use protocol::SUBPROTOCOL;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// `GET /v1/stream`, and whatever method else comes to this door.
pub async fn stream(State(shared): State<Arc<Shared>>, mut request: Request) -> Response {
    let upgrade = match Upgrade::of(&mut request) {
        Ok(upgrade) => upgrade,
        Err((status, sentence)) => return refusal(status, sentence),
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
        let sentence = format!("the client offers subprotocol {shown}, this server speaks {SUBPROTOCOL}");
        return Problem::new(Kind::BadHandshake, sentence).into_response();
    }
    let permit = Arc::clone(&shared.permits).try_acquire_owned();
    let (false, Ok(permit)) = (shared.draining.is_cancelled(), permit) else {
        return Problem::new(Kind::NoSession, "no session is free, try again later").into_response();
    };
    let peer = peer_address(&request);
    let Some(place) = shared.addresses.enter(peer) else {
        shared.metrics.address_refusals.inc();
        let sentence = "too many sessions from this address, end one or try again later";
        return Problem::new(Kind::AddressFull, sentence).into_response();
    };
    let response = upgrade.response(SUBPROTOCOL);
    let number = shared.next_session.fetch_add(1, Ordering::Relaxed);
    let tracker = shared.sessions.clone();
    tracker.spawn(async move {
        if let Some(socket) = upgrade.socket().await {
            socket::serve(socket, &shared, number, shared.purses.of(peer)).await;
        }
        drop((permit, place));
    });
    response
}

/// Why a request is none that may become a session.
fn refusal(status: StatusCode, sentence: &str) -> Response {
    let kind = match status {
        StatusCode::METHOD_NOT_ALLOWED => Kind::WrongMethod,
        StatusCode::UPGRADE_REQUIRED => Kind::NotAnUpgrade,
        _ => Kind::BadHandshake,
    };
    let mut response = Problem::new(kind, sentence).into_response();
    if kind == Kind::WrongMethod {
        response.headers_mut().insert(header::ALLOW, HeaderValue::from_static("GET"));
    }
    response
}

/// Where a request comes from; the accept loop tells.
fn peer_address(request: &Request) -> Option<IpAddr> {
    request.extensions().get::<SocketAddr>().map(SocketAddr::ip)
}
