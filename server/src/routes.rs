//! The HTTP side: probes, metrics, the world's description, single chunks, and the door to a session.

use crate::SOFTWARE;
use crate::listener::Shared;
use crate::metrics::Status;
use crate::socket;
use crate::upgrade::Upgrade;
use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Json, Response};
use axum::routing::{any, get};
use protocol::server::Wanted;
use protocol::{Delivery, PROTOCOL_VERSION, SUBPROTOCOL, chunk_codec};
use serde_json::json;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use terrain::constants::{
    CELLS, GENERATOR_VERSION, SPACING_BITS, TOP_LEVEL, UNIT_BITS, UNITS_PER_METRE, VERTICES, WORLD_HALF,
};
use terrain::{ChunkKey, WorldDigest};

/// Queue load above which the server calls itself not ready, so that a balancer sends new clients elsewhere.
const READY_LOAD: f64 = 0.9;

/// All routes of a server.
pub fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/livez", get(|| async { "ok\n" }))
        .route("/readyz", get(readyz))
        .route("/metrics", get(metrics))
        .route("/v1/world", get(world))
        .route("/v1/{digest}/chunk/{level}/{x}/{z}", get(chunk))
        .route("/v1/stream", any(stream))
        .fallback(|| async { problem(StatusCode::NOT_FOUND, "no such route; see GET /v1/world") })
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), count))
        .with_state(shared)
}

async fn count(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let response = next.run(request).await;
    let status = response.status().as_u16();
    shared.metrics.http_responses.get_or_create(&Status { status }).inc();
    response
}

/// An error as JSON with one sentence.
fn problem(status: StatusCode, sentence: impl Into<String>) -> Response {
    (status, Json(json!({ "error": sentence.into() }))).into_response()
}

async fn readyz(State(shared): State<Arc<Shared>>) -> Response {
    if shared.draining.is_cancelled() {
        return (StatusCode::SERVICE_UNAVAILABLE, "draining\n").into_response();
    }
    if shared.generation.load() > READY_LOAD {
        return (StatusCode::SERVICE_UNAVAILABLE, "generation queue is nearly full\n").into_response();
    }
    "ready\n".into_response()
}

async fn metrics(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    ([(header::CONTENT_TYPE, OPEN_METRICS)], shared.metrics.render())
}

async fn world(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    let digest = shared.offer.digest.to_string();
    Json(json!({
        "server": SOFTWARE,
        "world_seed": shared.config.world_seed,
        "generator_version": GENERATOR_VERSION,
        "digest": digest,
        "stream": { "path": "/v1/stream", "subprotocol": SUBPROTOCOL, "version": PROTOCOL_VERSION },
        "chunks": format!("/v1/{digest}/chunk/{{level}}/{{x}}/{{z}}"),
        "chunk_format_version": chunk_codec::VERSION,
        "units_per_metre": UNITS_PER_METRE,
        "levels": TOP_LEVEL + 1,
        "vertices_per_side": VERTICES,
        "level_0_spacing_m": 1 << (SPACING_BITS - UNIT_BITS),
        "level_0_side_m": CELLS << (SPACING_BITS - UNIT_BITS),
        "world_half_m": WORLD_HALF >> UNIT_BITS,
    }))
}

async fn chunk(
    State(shared): State<Arc<Shared>>,
    Path((digest, level, x, z)): Path<(String, String, String, String)>,
    headers: HeaderMap,
) -> Response {
    if !is_authorised(&shared, &headers) {
        return problem(StatusCode::UNAUTHORIZED, "give the access token as `Authorization: Bearer TOKEN`");
    }
    let ours = shared.offer.digest;
    if WorldDigest::from_hex(&digest) != Some(ours) {
        let shown: String = digest.chars().take(64).collect();
        return problem(
            StatusCode::NOT_FOUND,
            format!("world {shown} is not served here; this server has {ours}"),
        );
    }
    let key = match (level.parse(), x.parse(), z.parse()) {
        (Ok(level), Ok(x), Ok(z)) => {
            ChunkKey::new(level, x, z).map_err(|error| (StatusCode::NOT_FOUND, error.to_string()))
        }
        _ => Err((
            StatusCode::BAD_REQUEST,
            "level, x and z must be whole numbers (level 0 to 255, x and z 32-bit)".into(),
        )),
    };
    let key = match key {
        Ok(key) => key,
        Err((status, sentence)) => return problem(status, sentence),
    };
    // Always exact: what is cached for ever must be of use to whoever has no generator.
    let wanted = Wanted { key, request: Some(0), priority: u64::MAX };
    let frame = match shared.generation.frame(wanted, Delivery::Exact).await {
        Ok(frame) => frame,
        Err(error) => {
            let mut response = problem(StatusCode::SERVICE_UNAVAILABLE, error.to_string());
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
            return response;
        }
    };
    let content = chunk_codec::digest(&frame).unwrap_or_default();
    let etag = format!("\"{}\"", content.iter().map(|byte| format!("{byte:02x}")).collect::<String>());
    let unchanged =
        headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok()).is_some_and(|known| {
            known == "*" || known.split(',').any(|tag| tag.trim().trim_start_matches("W/") == etag)
        });
    let caching =
        [(header::ETAG, etag), (header::CACHE_CONTROL, "public, max-age=31536000, immutable".into())];
    if unchanged {
        return (StatusCode::NOT_MODIFIED, caching).into_response();
    }
    (caching, [(header::CONTENT_TYPE, "application/octet-stream")], frame).into_response()
}

/// Whether an HTTP request carries the token, where one is set.
fn is_authorised(shared: &Shared, headers: &HeaderMap) -> bool {
    let bearer = headers
        .get(header::AUTHORIZATION)
        .and_then(|value| value.to_str().ok())
        .and_then(|value| value.strip_prefix("Bearer "));
    protocol::server::token_matches(shared.offer.token.as_deref(), bearer)
}

async fn stream(State(shared): State<Arc<Shared>>, mut request: Request) -> Response {
    let upgrade = match Upgrade::of(&mut request) {
        Ok(upgrade) => upgrade,
        Err((status, sentence)) => return problem(status, sentence),
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
        return problem(StatusCode::BAD_REQUEST, sentence);
    }
    let permit = Arc::clone(&shared.permits).try_acquire_owned();
    let (false, Ok(permit)) = (shared.draining.is_cancelled(), permit) else {
        return come_back("no session is free, try again later");
    };
    let Some(place) = shared.addresses.enter(peer_address(&request)) else {
        shared.metrics.address_refusals.inc();
        return come_back("too many sessions from this address, end one or try again later");
    };
    let response = upgrade.response(SUBPROTOCOL);
    let number = shared.next_session.fetch_add(1, Ordering::Relaxed);
    let tracker = shared.sessions.clone();
    tracker.spawn(async move {
        if let Some(socket) = upgrade.socket().await {
            socket::serve(socket, &shared, number).await;
        }
        drop((permit, place));
    });
    response
}

/// A refusal that says when to try again.
fn come_back(sentence: &str) -> Response {
    let mut response = problem(StatusCode::SERVICE_UNAVAILABLE, sentence);
    response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("2"));
    response
}

/// Where a request comes from; the accept loop tells.
fn peer_address(request: &Request) -> Option<IpAddr> {
    request.extensions().get::<SocketAddr>().map(SocketAddr::ip)
}
