//! Probes and metrics.

use crate::access::ProtectedRoute;
use crate::http::client::Client;
use crate::http::problem::Problem;
use crate::state::ServerState;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;

/// Queue load above which the server is not ready, so that a load balancer sends new clients to
/// another server.
const READY_LOAD: f64 = 0.9;

/// `GET /livez`.
pub async fn livez() -> &'static str {
    "ok\n"
}

/// `GET /readyz`. Full sessions are no reason: chunks are still served over HTTP, and a session of
/// the site with the most ends for a client of another site.
pub async fn readyz(State(state): State<Arc<ServerState>>) -> Response {
    if state.draining.is_cancelled() {
        return (StatusCode::SERVICE_UNAVAILABLE, "draining\n").into_response();
    }
    if !state.generation.is_ready() {
        return (StatusCode::SERVICE_UNAVAILABLE, "the store has not listed its regions yet\n")
            .into_response();
    }
    if state.generation.load() > READY_LOAD {
        return (StatusCode::SERVICE_UNAVAILABLE, "generation queue is nearly full\n").into_response();
    }
    if !state.memory.is_ready() {
        return (StatusCode::SERVICE_UNAVAILABLE, "memory is nearly used up\n").into_response();
    }
    "ready\n".into_response()
}

/// `GET /metrics`.
pub async fn metrics(State(state): State<Arc<ServerState>>, client: Client) -> Result<Response, Problem> {
    const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    if state.config.protected.contains(&ProtectedRoute::Metrics) {
        client.authorise(&state)?;
    }
    Ok(([(header::CONTENT_TYPE, OPEN_METRICS)], state.metrics.render()).into_response())
}
