//! The OpenAPI document: written by hand, because it is for people first; `tests/openapi.rs` keeps
//! it true.

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
        // RFC 9512 registers a type of its own for YAML only; JSON documents are JSON.
        content_type: "application/json",
        caching: "no-cache",
        body: Bytes::from_static(DOCUMENT.as_bytes()),
    };
    representation.answer(&headers)
}
