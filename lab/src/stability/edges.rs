//! Walks across the edges and corners of the turned lattices, on islands all over the world.

use super::samples::Walk;
use crate::reference_f64::Exact;
use crate::reference_f64::noise::{Turned, TurnedNoises};
use crate::sample;

/// Places per lattice from which its nearest edges and its nearest corner are looked up.
const PLACES: u32 = 50;

/// Walks over edges and corners of every turned lattice of a world.
pub fn walks(world_seed: u64) -> Vec<Walk> {
    let noises = TurnedNoises::new(world_seed);
    let of_lattice = |(index, noise): (usize, Turned)| {
        sample::land_points(world_seed, PLACES, 0xed6e + index as u32)
            .flat_map(move |(x, z)| near(&noise, Exact { x, z }))
    };
    noises.iter().copied().enumerate().flat_map(of_lattice).collect()
}

/// Walks over the nearest edges, along both axes of the world, and over the nearest corner.
fn near(noise: &Turned, place: Exact) -> Vec<Walk> {
    let cell = 1i64 << noise.bits;
    // The way to the nearest multiple of a cell, at most half a cell either way.
    let ways = place.turned_units(noise).map(|v| -((v + cell / 2).rem_euclid(cell) - cell / 2));
    let moved = |dx: i64, dz: i64| {
        let axis = |v: i32, d: i64| i32::try_from(i64::from(v) + d).ok();
        Some((axis(place.x, dx)?, axis(place.z, dz)?))
    };
    let (three, four) = (ways.map(|way| way / 3), ways.map(|way| way / 4));
    let to_edges = if noise.is_high {
        [(three[0], 0), (0, -four[0]), (four[1], 0), (0, three[1])]
    } else {
        [(four[0], 0), (0, -three[0]), (three[1], 0), (0, four[1])]
    };
    // Turning back is exact but for a factor of 25.
    let back = [ways[0], ways[1]];
    let corner = if noise.is_high {
        (3 * back[0] + 4 * back[1], 3 * back[1] - 4 * back[0])
    } else {
        (4 * back[0] + 3 * back[1], 4 * back[1] - 3 * back[0])
    };
    let mut walks = Vec::new();
    for (dx, dz) in to_edges {
        walks.extend(moved(dx, dz).and_then(|place| Walk::around(place, usize::from(dx == 0))));
    }
    let corner = moved(corner.0 / 25, corner.1 / 25);
    walks.extend([0, 1].into_iter().filter_map(|axis| Walk::around(corner?, axis)));
    walks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walks_cross_edges_of_every_lattice() {
        let noises = TurnedNoises::new(3);
        let cells = |walk: &Walk, noise: &Turned| {
            let cells: Vec<_> =
                walk.points().map(|(x, z)| Exact { x, z }.on_turned(noise).map(|cut| cut.cell)).collect();
            cells[0] != cells[cells.len() - 1]
        };
        let walks = walks(3);
        assert!(walks.len() > 2_000, "{}", walks.len());
        for noise in noises.iter() {
            let crossing = walks.iter().filter(|walk| cells(walk, noise)).count();
            assert!(crossing as u32 > 4 * PLACES, "{crossing} walks cross edges of {noise:?}");
        }
    }
}
