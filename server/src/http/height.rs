//! The height of one place: what a person who points at the map wants to know.

use crate::http::address;
use crate::http::problem::{Kind, Problem};
use crate::listener::Shared;
use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use serde_json::json;
use std::sync::Arc;
use terrain::constants::{SPACING_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::{Land, Position};

/// `GET /v1/{digest}/height/{x}/{z}`, both in whole metres.
pub async fn get(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    raw: Result<Path<(String, String, String)>, PathRejection>,
) -> Result<Response, Problem> {
    address::authorise(&shared, &headers)?;
    let Ok(Path((digest, x, z))) = raw else {
        return Err(Problem::new(Kind::Malformed, "the path is not UTF-8 behind its percent signs"));
    };
    address::check_world(&shared, &digest)?;
    let (Ok(x), Ok(z)) = (x.parse::<i32>(), z.parse::<i32>()) else {
        return Err(Problem::new(Kind::Malformed, "x and z must be whole metres"));
    };
    let half_m = WORLD_HALF / UNITS_PER_METRE;
    // The far border belongs to the world, but no cell begins there.
    if ![x, z].iter().all(|metres| (-half_m..half_m).contains(metres)) {
        let detail =
            format!("({x}, {z}) m is outside the world: each axis goes from {} to {}", -half_m, half_m - 1);
        return Err(Problem::new(Kind::OutsideWorld, detail));
    }
    let height_m = drawn_height_m(&shared.offer.land, x * UNITS_PER_METRE, z * UNITS_PER_METRE);
    let body = json!({ "x_m": x, "z_m": z, "height_m": height_m });
    Ok(([(header::CACHE_CONTROL, "no-cache")], Json(body)).into_response())
}

/// Height of the finest mesh at a place inside the world, metres. The mesh is the land: the noise
/// between vertices is nobody's business (`docs/heightfield.md`), so the triangle is evaluated, not
/// the field.
fn drawn_height_m(land: &Land, x: i32, z: i32) -> f64 {
    let (cell, spacing) = ((x >> SPACING_BITS, z >> SPACING_BITS), 1 << SPACING_BITS);
    let corner = |east: i32, south: i32| {
        let place = Position::new((cell.0 + east) << SPACING_BITS, (cell.1 + south) << SPACING_BITS);
        // A cell that begins inside the world ends inside it.
        place.map_or(0, |place| land.height_at(place))
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
                let place = |low: i32, metres: usize| low + metres as i32 * UNITS_PER_METRE;
                assert_eq!(drawn_height_m(&land, place(x0, east_m), place(z0, south_m)), drawn);
            }
        }
    }
}
