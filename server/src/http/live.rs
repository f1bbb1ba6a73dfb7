//! Live statistics.
//!
//! Polled, not pushed: a browser opens six connections to one HTTP/1.1 server. An event stream
//! would occupy one of them and a connection permit while the page is open, and would have to be
//! closed on shutdown.

use crate::http::client::Client;
use crate::http::problem::Problem;
use crate::state::ServerState;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Instant;

/// `GET /v1/live`.
pub async fn get(State(state): State<Arc<ServerState>>, client: Client) -> Result<Response, Problem> {
    // Positions of clients are as restricted as the sessions.
    client.authorise(&state)?;
    let body = state.stats.report(Instant::now(), &state.open_sessions, &state.metrics, &state.generation);
    let headers = [(header::CONTENT_TYPE, "application/json"), (header::CACHE_CONTROL, "no-store")];
    Ok((headers, body).into_response())
}
