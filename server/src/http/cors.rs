//! CORS: the routes that pages of other origins may read, whose responses are the same for all
//! clients. Fetch standard, section 3.3.
//!
//! No cookies are used, and `*` excludes them. The token is sent in `Authorization`, which a
//! preflight has to name because `*` does not include it.

use crate::state::ServerState;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::routing::MethodRouter;
use std::sync::Arc;

/// The methods of a route that allows all origins: with preflights.
pub fn with_preflight(methods: MethodRouter<Arc<ServerState>>) -> MethodRouter<Arc<ServerState>> {
    methods.options(preflight)
}

async fn preflight() -> impl IntoResponse {
    let allowed = [
        (header::ALLOW, "GET, HEAD, OPTIONS"),
        (header::ACCESS_CONTROL_ALLOW_METHODS, "GET, HEAD"),
        (header::ACCESS_CONTROL_ALLOW_HEADERS, "Authorization, If-Match, If-None-Match"),
        (header::ACCESS_CONTROL_MAX_AGE, "86400"),
    ];
    (StatusCode::NO_CONTENT, allowed)
}

/// Allows all origins on every response of some routes, rejections included. Independent of
/// `Origin`, so that caches need no `Vary`.
pub async fn allow(
    State(paths): State<Arc<[&'static str]>>,
    path: Option<MatchedPath>,
    request: Request,
    next: Next,
) -> Response {
    let is_allowed = path.is_some_and(|path| paths.contains(&path.as_str()));
    let mut response = next.run(request).await;
    if !is_allowed {
        return response;
    }
    let headers = response.headers_mut();
    headers.insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, HeaderValue::from_static("*"));
    // Headers that scripts may read in addition to the safelisted ones.
    headers.insert(header::ACCESS_CONTROL_EXPOSE_HEADERS, HeaderValue::from_static("ETag, Retry-After"));
    // For cross-origin isolated pages that load tiles as images.
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("cross-origin"));
    response
}
