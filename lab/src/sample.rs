//! Reproducible pseudo-random sample points, the same on every machine.

use terrain::constants::{ISLAND_CELL_BITS, SPACING_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::hash::mix;
use terrain::island::{Archipelago, Island};

/// The `index`-th word of a stream.
pub fn word(stream: u32, index: u32) -> u32 {
    mix(mix(stream ^ 0x5eed_1ab5).wrapping_add(index.wrapping_mul(0x9e37_79b9)))
}

/// A number in `[0, 1)` from a word.
pub fn unit(word: u32) -> f64 {
    f64::from(word) / 4_294_967_296.0
}

/// Points (units) spread evenly over the whole world, on and off the vertex grid.
pub fn world_points(count: u32, stream: u32) -> impl Iterator<Item = (i32, i32)> {
    (0..count).map(move |n| (word(stream, 2 * n) as i32 >> 1, word(stream, 2 * n + 1) as i32 >> 1))
}

/// Level-0 vertices (units) inside islands: half of them on the home island, half on islands all
/// over the world. Even over the area of an island, so that rims and tops are both met.
pub fn land_vertices(world_seed: u64, count: u32, stream: u32) -> impl Iterator<Item = (i32, i32)> {
    land_points(world_seed, count, stream).map(|(x, z)| (on_grid(x), on_grid(z)))
}

/// The same on and off the vertex grid.
pub fn land_points(world_seed: u64, count: u32, stream: u32) -> impl Iterator<Item = (i32, i32)> {
    let archipelago = Archipelago::new(world_seed);
    (0..count).map(move |n| {
        let words: [u32; 4] = std::array::from_fn(|part| word(stream, 4 * n + part as u32));
        inside(&island(&archipelago, words[0], words[1]), words[2], words[3])
    })
}

/// The island that two words choose: the home island for every other first word.
pub fn island(archipelago: &Archipelago, first: u32, second: u32) -> Island {
    const SPAN: u32 = 31 - ISLAND_CELL_BITS;
    let home = archipelago.island(0, 0);
    let mut cell = (0, 0);
    if first & 1 == 1 {
        // The cells of the border are only half inside the world: kept out.
        let axis = |word: u32| ((word >> (32 - SPAN)) as i32 - (1 << (SPAN - 1))).max(1 - (1 << (SPAN - 1)));
        cell = (axis(first), axis(second));
    }
    // One cell in four is empty sea; the home cell never is.
    archipelago.island(cell.0, cell.1).or(home).expect("the cell of the origin holds an island")
}

/// A point (units) inside an island's circle, even over its area.
pub fn inside(island: &Island, first: u32, second: u32) -> (i32, i32) {
    let radius = f64::from(island.radius_m) * f64::from(UNITS_PER_METRE) * unit(first).sqrt();
    let (sin, cos) = (unit(second) * std::f64::consts::TAU).sin_cos();
    let axis = |centre: i32, offset: f64| (centre + offset as i32).clamp(-WORLD_HALF, WORLD_HALF);
    (axis(island.centre.0, radius * cos), axis(island.centre.1, radius * sin))
}

/// The level-0 vertex line at or below a coordinate, units.
pub const fn on_grid(coordinate: i32) -> i32 {
    coordinate & !((1 << SPACING_BITS) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn land_vertices_are_vertices_inside_islands_near_and_far() {
        let archipelago = Archipelago::new(5);
        let (mut far, mut near) = (0, 0);
        for (x, z) in land_vertices(5, 4_000, 1) {
            assert_eq!((x % 512, z % 512), (0, 0));
            assert!(x.abs() <= WORLD_HALF && z.abs() <= WORLD_HALF);
            let island = archipelago.island_at(x, z).expect("an island's cell");
            let distance = f64::from(x - island.centre.0).hypot(f64::from(z - island.centre.1));
            assert!(distance <= f64::from(island.radius_m) * 256.0 + 1024.0);
            if x.abs() > 1 << 28 { far += 1 } else { near += 1 }
        }
        assert!(far > 800 && near > 1_500, "{far} far, {near} near");
    }

    #[test]
    fn world_points_reach_all_four_quarters() {
        let quarters: std::collections::HashSet<_> =
            world_points(100, 3).map(|(x, z)| (x < 0, z < 0)).collect();
        assert_eq!(quarters.len(), 4);
    }
}
