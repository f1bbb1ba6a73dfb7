//! The OpenAPI document. Written by hand for its readers; `server/tests/http/openapi.rs` compares
//! it with the routes.

use crate::http::conditional::{Representation, etag};
use axum::http::HeaderMap;
use axum::response::Response;
use bytes::Bytes;

/// The document.
pub const DOCUMENT: &str = include_str!("openapi.json");

/// `GET /openapi.json`.
pub async fn get(headers: HeaderMap) -> Response {
    let representation = Representation {
        etag: etag(&blake3::hash(DOCUMENT.as_bytes()).as_bytes()[..16]),
        // RFC 9512 registers a media type for YAML only.
        content_type: "application/json",
        cache_control: "no-cache",
        body: Bytes::from_static(DOCUMENT.as_bytes()),
    };
    representation.respond(&headers)
}
