//! Chunks by key, as the seed makes them. Immutable, so any cache may store them.

use crate::chunk_id::ChunkId;
use crate::generation::GenerationError;
use crate::http::conditional::{Representation, etag, immutable_cache_control};
use crate::http::path::{ChunkPathRequest, Query};
use crate::http::problem::{Problem, ProblemKind};
use crate::state::ServerState;
use axum::extract::State;
use axum::response::Response;
use protocol::Delivery;
use protocol::server::ChunkRequest;
use std::sync::Arc;
use tracing::Instrument;

/// `GET /v1/{digest}/chunk/{level}/{x}/{z}`.
pub async fn get(
    State(state): State<Arc<ServerState>>,
    request: ChunkPathRequest,
) -> Result<Response, Problem> {
    let (key, bucket) = request.admit(&state, "", Query::None).await?;
    // Always exact: a cached chunk must be usable without a generator.
    // Chunks of map tiles come first: a tile holds one of few turns until it has them.
    let chunk = ChunkRequest { key, request: Some(0), priority: u64::MAX - 1 };
    // Compact: the address is immutable, so it has one representation for ever.
    let flow = state.generation.download(request.client.address, bucket.clone()).compact();
    let parent = state.traces.parent(&request.client.headers);
    let span = state.traces.chunk(parent.as_ref(), key, Delivery::Exact);
    let frame = flow.base_frame(chunk, Delivery::Exact).instrument(span.clone()).await;
    span.record("outcome", if frame.is_ok() { "sent" } else { "refused" });
    let frame = frame.map_err(problem)?;
    let digest = state.content_digests.of(ChunkId::base(key), &frame, &state.offer.digest, &bucket).map_err(
        |error| Problem::new(ProblemKind::Failed, format!("the chunk's frame is damaged: {error}")),
    )?;
    let representation = Representation {
        // Of the content: replicas with other versions of the compressor have the same ETag.
        etag: etag(&digest),
        content_type: "application/octet-stream",
        cache_control: immutable_cache_control(state.gate.requires_token()),
        body: frame,
    };
    Ok(representation.respond(&request.client.headers))
}

/// The problem document for a chunk that is not available.
pub fn problem(error: GenerationError) -> Problem {
    let kind = match error {
        GenerationError::Overloaded => ProblemKind::Overloaded,
        GenerationError::Failed => ProblemKind::Failed,
    };
    Problem::new(kind, error.to_string())
}
