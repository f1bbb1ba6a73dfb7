//! The height at a position, for the pointer on the map.

use crate::http::client::Client;
use crate::http::path;
use crate::http::problem::{Problem, ProblemKind};
use crate::state::ServerState;
use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::{Uri, header};
use axum::response::{IntoResponse, Response};
use serde_json::json;
use std::sync::Arc;
use terrain::constants::{SPACING_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::{Land, Position};

/// `GET /v1/{digest}/height/{x}/{z}`, both in whole metres.
pub async fn get(
    State(state): State<Arc<ServerState>>,
    client: Client,
    uri: Uri,
    raw: Result<Path<(String, String, String)>, PathRejection>,
) -> Result<Response, Problem> {
    client.authorise(&state)?;
    let Ok(Path((digest, x, z))) = raw else {
        return Err(Problem::new(ProblemKind::Malformed, "the percent-encoded path is not UTF-8"));
    };
    path::check_spelling(&uri, path::Query::None)?;
    path::check_world(&state, &digest)?;
    let (Some(x), Some(z)) = (path::number::<i32>(&x), path::number::<i32>(&z)) else {
        return Err(Problem::new(
            ProblemKind::Malformed,
            "x and z must be whole metres in their shortest form",
        ));
    };
    let half_m = WORLD_HALF / UNITS_PER_METRE;
    // No cell begins at the far border of the world.
    if ![x, z].iter().all(|metres| (-half_m..half_m).contains(metres)) {
        let detail =
            format!("({x}, {z}) m is outside the world: each axis goes from {} to {}", -half_m, half_m - 1);
        return Err(Problem::new(ProblemKind::OutsideWorld, detail));
    }
    let height_m = drawn_height_m(&state.offer.land, x * UNITS_PER_METRE, z * UNITS_PER_METRE);
    let body = json!({ "x_m": x, "z_m": z, "height_m": height_m });
    Ok(([(header::CACHE_CONTROL, "no-cache")], Json(body)).into_response())
}

/// Height of the finest mesh at a position inside the world, metres. The terrain is the mesh, not
/// the noise between its vertices (`docs/heightfield.md`), so the triangle is evaluated.
fn drawn_height_m(land: &Land, x: i32, z: i32) -> f64 {
    let (cell, spacing) = ((x >> SPACING_BITS, z >> SPACING_BITS), 1 << SPACING_BITS);
    let corner = |east: i32, south: i32| {
        let position = Position::new((cell.0 + east) << SPACING_BITS, (cell.1 + south) << SPACING_BITS);
        // A cell that begins inside the world ends inside it.
        position.map_or(0, |position| land.height_at(position))
    };
    let fraction = |v: i32| f64::from(v & (spacing - 1)) / f64::from(spacing);
    let (fx, fz) = (fraction(x), fraction(z));
    // The diagonal goes from the low corner to the high one.
    let side = if fx >= fz { corner(1, 0) } else { corner(0, 1) };
    let (upper, lower) = (fx.max(fz), fx.min(fz));
    let units = f64::from(corner(0, 0)) * (1.0 - upper)
        + f64::from(side) * (upper - lower)
        + f64::from(corner(1, 1)) * lower;
    units / f64::from(UNITS_PER_METRE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::ChunkKey;
    use terrain::chunk::drawn_height_scaled;

    #[test]
    fn the_height_is_that_of_the_drawn_triangles_of_level_0() {
        let land = Land::new(1);
        for key in [ChunkKey::new(0, 3, -7).unwrap(), ChunkKey::new(0, -32_768, 32_767).unwrap()] {
            let heights = land.chunk_heights(key);
            let (x0, z0) = key.origin();
            for (east_m, south_m) in
                [(0, 0), (1, 0), (0, 1), (1, 1), (64, 31), (31, 64), (127, 126), (126, 127)]
            {
                let drawn = drawn_height_scaled(&heights, east_m, south_m, 1) as f64 / 512.0;
                let at = |low: i32, metres: usize| low + metres as i32 * UNITS_PER_METRE;
                assert_eq!(drawn_height_m(&land, at(x0, east_m), at(z0, south_m)), drawn);
            }
        }
    }
}
