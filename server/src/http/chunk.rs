//! Chunks by key. Immutable, so any cache may store them.

use crate::generation::GenerationError;
use crate::http::conditional::{Representation, etag, immutable_cache_control};
use crate::http::path::{self, RawChunkPath};
use crate::http::problem::{Problem, ProblemKind};
use crate::state::ServerState;
use axum::extract::{Extension, State};
use axum::http::HeaderMap;
use axum::response::Response;
use protocol::server::ChunkRequest;
use protocol::{Delivery, chunk_codec};
use std::net::SocketAddr;
use std::sync::Arc;

/// `GET /v1/{digest}/chunk/{level}/{x}/{z}`.
pub async fn get(
    State(state): State<Arc<ServerState>>,
    headers: HeaderMap,
    peer: Option<Extension<SocketAddr>>,
    raw: RawChunkPath,
) -> Result<Response, Problem> {
    let key = path::chunk_key(&state, &headers, raw, "")?;
    // Always exact: a cached chunk must be usable without a generator.
    let chunk = ChunkRequest { key, request: Some(0), priority: u64::MAX };
    let bucket = path::wait_for_tokens(&state, peer).await?;
    // Compact: the address is immutable, so it has one representation for ever.
    let flow = state.generation.limited_flow(bucket).compact();
    let frame = flow.frame(chunk, Delivery::Exact).await.map_err(problem)?;
    let representation = Representation {
        // The frame contains its digest, over all of its bytes.
        etag: etag(&chunk_codec::digest(&frame).unwrap_or_default()),
        content_type: "application/octet-stream",
        cache_control: immutable_cache_control(state.offer.token.is_some()),
        body: frame,
    };
    Ok(representation.respond(&headers))
}

/// The problem document for a chunk that is not available.
pub fn problem(error: GenerationError) -> Problem {
    let kind = match error {
        GenerationError::Overloaded => ProblemKind::Overloaded,
        GenerationError::Failed => ProblemKind::Failed,
    };
    Problem::new(kind, error.to_string())
}
