//! What a client must know before it asks for anything else.

use crate::SOFTWARE;
use crate::listener::Shared;
use crate::map;
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use protocol::{PROTOCOL_VERSION, SUBPROTOCOL, chunk_codec};
use serde_json::json;
use std::sync::Arc;
use terrain::constants::{
    CELLS, GENERATOR_VERSION, SPACING_BITS, TOP_LEVEL, UNIT_BITS, UNITS_PER_METRE, VERTICES, WORLD_HALF,
};

/// `GET /v1/world`.
pub async fn get(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    let digest = shared.offer.digest.to_string();
    let description = json!({
        "server": SOFTWARE,
        "world_seed": shared.config.world_seed,
        "generator_version": GENERATOR_VERSION,
        "digest": digest,
        "takes_token": shared.offer.token.is_some(),
        "stream": { "path": "/v1/stream", "subprotocol": SUBPROTOCOL, "version": PROTOCOL_VERSION },
        "chunks": format!("/v1/{digest}/chunk/{{level}}/{{x}}/{{z}}"),
        "chunk_format_version": chunk_codec::VERSION,
        // The style is there for caches: a server that paints otherwise names its tiles otherwise.
        "map": format!("/v1/{digest}/map/{{level}}/{{x}}/{{z}}.png?style={}", map::STYLE),
        "map_tile_pixels": map::TILE_PIXELS,
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
    // Another server may answer here tomorrow.
    ([(header::CACHE_CONTROL, "no-cache")], Json(description))
}
