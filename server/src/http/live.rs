//! What happens on the server at the moment.
//!
//! Polled, not pushed: a browser opens six connections to one HTTP/1.1 server, and a stream of
//! events would take one of them from the tiles for as long as the page is open, would hold a
//! connection slot of the server, and would have to be ended on shutdown.

use crate::http::address;
use crate::http::problem::Problem;
use crate::listener::Shared;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Instant;

/// `GET /v1/live`.
pub async fn get(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Response, Problem> {
    // Where others are is not for those who may not enter.
    address::authorise(&shared, &headers)?;
    let body = shared.live.sample(Instant::now(), &shared.metrics, &shared.generation);
    let headers = [(header::CONTENT_TYPE, "application/json"), (header::CACHE_CONTROL, "no-store")];
    Ok((headers, body).into_response())
}
