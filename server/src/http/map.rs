//! Map tiles by chunk key.

use crate::http::chunk::problem;
use crate::http::conditional::{Representation, etag, immutable_cache_control};
use crate::http::path::{ChunkPathRequest, Query, over_rate};
use crate::http::problem::{Problem, ProblemKind};
use crate::map::tiles::{MapError, Requester};
use crate::state::ServerState;
use axum::extract::State;
use axum::response::Response;
use std::sync::Arc;

/// `GET /v1/{digest}/map/{level}/{x}/{z}.png`.
pub async fn get(
    State(state): State<Arc<ServerState>>,
    request: ChunkPathRequest,
) -> Result<Response, Problem> {
    let (key, bucket) = request.admit(&state, ".png", Query::Style).await?;
    let client = request.client.address;
    let requester = Requester { client, generation: &state.generation, bucket: &bucket };
    let tile = state.map.tile(key, requester).await;
    let tile = tile.map_err(|error| match error {
        MapError::Busy => Problem::new(ProblemKind::MapBusy, error.to_string()),
        MapError::OverRate => over_rate(),
        MapError::Generation(error) => problem(error),
    })?;
    let representation = Representation {
        etag: etag(&tile.digest),
        content_type: "image/png",
        cache_control: if request.has_style() {
            immutable_cache_control(state.gate.requires_token())
        } else {
            "no-cache"
        },
        body: tile.png,
    };
    Ok(representation.respond(&request.client.headers))
}
