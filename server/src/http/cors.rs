//! Which routes pages of other origins may read: those whose answer is the same for everybody.
//! Fetch standard, section 3.3.
//!
//! What it refuses: cookies (none are used, and `*` forbids them). A token travels in
//! `Authorization`, which a preflight allows by name because `*` does not cover it.

use crate::listener::Shared;
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::map_response;
use axum::response::{IntoResponse, Response};
use axum::routing::MethodRouter;
use std::sync::Arc;

/// Opens a route to all origins, preflights included.
pub fn open(methods: MethodRouter<Arc<Shared>>) -> MethodRouter<Arc<Shared>> {
    methods.options(preflight).layer(map_response(allow))
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

/// The same with or without `Origin`, so that caches need not tell the two apart by `Vary`.
async fn allow(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, HeaderValue::from_static("*"));
    // What scripts may read besides the headers that are always readable.
    headers.insert(header::ACCESS_CONTROL_EXPOSE_HEADERS, HeaderValue::from_static("ETag, Retry-After"));
    // For pages that isolate themselves and load tiles as pictures.
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("cross-origin"));
    response
}
