//! The description of the world, which clients read first.

use crate::access::ProtectedRoute;
use crate::http::client::Client;
use crate::http::problem::Problem;
use crate::map::elevation::TILE_PIXELS;
use crate::map::tiles::STYLE;
use crate::state::{SOFTWARE, ServerState};
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use protocol::{PROTOCOL_VERSION, SUBPROTOCOL, chunk_codec};
use serde_json::json;
use std::sync::Arc;
use terrain::constants::{
    CELLS, GENERATOR_VERSION, SPACING_BITS, TOP_LEVEL, UNIT_BITS, UNITS_PER_METRE, VERTICES, WORLD_HALF,
};

/// `GET /v1/world`.
pub async fn get(State(state): State<Arc<ServerState>>, client: Client) -> Result<Response, Problem> {
    if state.config.protected.contains(&ProtectedRoute::World) {
        client.authorise(&state)?;
    }
    let digest = state.offer.digest.to_string();
    let description = json!({
        "server": SOFTWARE,
        "world_seed": state.config.world_seed,
        // Parsers that read numbers as doubles lose seeds above 2^53.
        "world_seed_text": state.config.world_seed.to_string(),
        "generator_version": GENERATOR_VERSION,
        "digest": digest,
        "takes_token": state.gate.requires_token(),
        "stream": { "path": "/v1/stream", "subprotocol": SUBPROTOCOL, "version": PROTOCOL_VERSION },
        "chunks": format!("/v1/{digest}/chunk/{{level}}/{{x}}/{{z}}"),
        "chunk_format_version": chunk_codec::VERSION,
        // The style is for caches: a server with another style has other URLs.
        "map": format!("/v1/{digest}/map/{{level}}/{{x}}/{{z}}.png?style={}", STYLE),
        "map_tile_pixels": TILE_PIXELS,
        "heights": format!("/v1/{digest}/height/{{x}}/{{z}}"),
        "live": "/v1/live",
        "openapi": "/openapi.json",
        "units_per_metre": UNITS_PER_METRE,
        "levels": TOP_LEVEL + 1,
        "vertices_per_side": VERTICES,
        "level_0_spacing_m": 1 << (SPACING_BITS - UNIT_BITS),
        "level_0_side_m": CELLS << (SPACING_BITS - UNIT_BITS),
        "world_half_m": WORLD_HALF >> UNIT_BITS,
    });
    // Another server may be started at this address.
    Ok(([(header::CACHE_CONTROL, "no-cache")], Json(description)).into_response())
}
