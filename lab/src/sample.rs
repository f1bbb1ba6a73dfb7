//! Reproducible pseudo-random sample points, the same on every machine.

use terrain::base::Base;
use terrain::constants::{FINE_BITS, ISLAND_CELL_BITS, SPACING_BITS, UNIT_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::hash::mix;
use terrain::island::{Archipelago, Lobe};
use terrain::{Land, Position};

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
/// over the world. Even over the area of a lobe, so that rims and tops are both met.
pub fn land_vertices(world_seed: u64, count: u32, stream: u32) -> impl Iterator<Item = (i32, i32)> {
    land_points(world_seed, count, stream).map(|(x, z)| (on_grid(x), on_grid(z)))
}

/// The same on and off the vertex grid.
pub fn land_points(world_seed: u64, count: u32, stream: u32) -> impl Iterator<Item = (i32, i32)> {
    let (archipelago, base) = (Archipelago::new(world_seed), Base::new(world_seed));
    (0..count).map(move |n| {
        let words: [u32; 5] = std::array::from_fn(|part| word(stream, 5 * n + part as u32));
        let cell = if words[0] & 1 == 0 { (0, 0) } else { far_cell(&archipelago, words[0], words[1]) };
        inside(&base, &lobe(&archipelago, cell, words[2]), words[3], words[4])
    })
}

/// Points (units) where the height is within 12 m of the sea: beaches and cliffs. Drawn from
/// [`land_points`], of which about one in six qualifies.
pub fn coast_points(world_seed: u64, count: u32, stream: u32) -> impl Iterator<Item = (i32, i32)> {
    const BAND: i32 = 12 * UNITS_PER_METRE;
    let land = Land::new(world_seed);
    let is_coast = move |(x, z): &(i32, i32)| {
        Position::new(*x, *z).is_ok_and(|position| land.height_at(position).abs() < BAND)
    };
    (0..u32::MAX / count.max(1))
        .flat_map(move |round| land_points(world_seed, count, stream ^ (round << 8)))
        .filter(is_coast)
        .take(count as usize)
}

/// Points (units) of islands at the borders of the world, within 1,024 m of them.
pub fn border_points(world_seed: u64, count: u32, stream: u32) -> impl Iterator<Item = (i32, i32)> {
    const DEPTH: f64 = (1024 * UNITS_PER_METRE) as f64;
    let (archipelago, base) = (Archipelago::new(world_seed), Base::new(world_seed));
    (0..count).map(move |n| {
        let words: [u32; 6] = std::array::from_fn(|part| word(stream, 6 * n + part as u32));
        let border = if words[0] & 1 == 0 { WORLD_HALF } else { -WORLD_HALF };
        let is_east = words[0] & 2 == 0;
        let own = Archipelago::cell(border);
        let cell = nearest(&archipelago, |step| {
            let other = axis(words[1].wrapping_add(step << (32 - SPAN)));
            if is_east { (own, other) } else { (other, own) }
        });
        let (x, z) = inside(&base, &lobe(&archipelago, cell, words[2]), words[3], words[4]);
        let near = border - border.signum() * (DEPTH * unit(words[5]).powi(3)) as i32;
        if is_east { (near, z) } else { (x, near) }
    })
}

/// log2 of the cells of the archipelago along an axis of the world.
const SPAN: u32 = 31 - ISLAND_CELL_BITS;

/// A cell coordinate from a word. The cells of the border are only half inside the world: kept out.
fn axis(word: u32) -> i32 {
    ((word >> (32 - SPAN)) as i32 - (1 << (SPAN - 1))).max(1 - (1 << (SPAN - 1)))
}

/// A cell anywhere in the world that holds an island.
fn far_cell(archipelago: &Archipelago, first: u32, second: u32) -> (i32, i32) {
    nearest(archipelago, |step| (axis(first), axis(second.wrapping_add(step << (32 - SPAN)))))
}

/// The first of a row of cells that holds an island; of 64 nearly always one does, else the home
/// cell.
fn nearest(archipelago: &Archipelago, cell: impl Fn(u32) -> (i32, i32)) -> (i32, i32) {
    (0..64).map(cell).find(|cell| archipelago.kind(cell.0, cell.1).is_some()).unwrap_or_default()
}

/// One of the lobes of a cell that holds an island.
pub fn lobe(archipelago: &Archipelago, cell: (i32, i32), word: u32) -> Lobe {
    let mut lobes = Vec::new();
    archipelago.lobes_of(cell.0, cell.1, &mut lobes);
    lobes[word as usize % lobes.len()]
}

/// A point (units) inside a lobe as it lies in the land, even over the area of the circle of its
/// longer axis, so that points just outside its rim are met too.
pub fn inside(base: &Base, lobe: &Lobe, first: u32, second: u32) -> (i32, i32) {
    let radius = f64::from(lobe.reach_m) * f64::from(UNITS_PER_METRE) * unit(first).sqrt();
    let (sin, cos) = (unit(second) * std::f64::consts::TAU).sin_cos();
    let clamp = |v: i32| v.clamp(-WORLD_HALF, WORLD_HALF);
    let (x, z) = (clamp(lobe.centre.0 + (radius * cos) as i32), clamp(lobe.centre.1 + (radius * sin) as i32));
    // The warp displaces the place that is looked up; its value changes slowly.
    let (warp_x, warp_z) = base.warp(x, z);
    let units = |fine: i32| fine >> (FINE_BITS - UNIT_BITS);
    (clamp(x - units(warp_x)), clamp(z - units(warp_z)))
}

/// The level-0 vertex line at or below a coordinate, units.
pub const fn on_grid(coordinate: i32) -> i32 {
    coordinate & !((1 << SPACING_BITS) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn land_vertices_are_vertices_of_islands_near_and_far() {
        let land = Land::new(5);
        let (mut far, mut near, mut dry) = (0, 0, 0);
        for (x, z) in land_vertices(5, 4_000, 1) {
            assert_eq!((x % 512, z % 512), (0, 0));
            let height = land.height_at(Position::new(x, z).expect("inside the world"));
            dry += u32::from(height > 0);
            if x.abs() > 1 << 28 { far += 1 } else { near += 1 }
        }
        assert!(far > 1_200 && near > 1_800, "{far} far, {near} near");
        assert!(dry > 1_200, "{dry} of 4,000 on dry land");
    }

    #[test]
    fn coast_points_are_near_the_sea() {
        let land = Land::new(6);
        let points: Vec<_> = coast_points(6, 500, 1).collect();
        assert_eq!(points.len(), 500);
        for (x, z) in points {
            assert!(land.height_at(Position::new(x, z).unwrap()).abs() < 12 << 8);
        }
    }

    #[test]
    fn border_points_are_near_all_four_borders_and_some_on_land() {
        let land = Land::new(6);
        let (mut sides, mut land_count) = ([0; 4], 0);
        for (x, z) in border_points(6, 2_000, 1) {
            let depths = [x, -x, z, -z].map(|v| i64::from(WORLD_HALF) - i64::from(v));
            let side = (0..4).min_by_key(|side| depths[*side]).unwrap();
            assert!((0..=1024 << 8).contains(&depths[side]));
            sides[side] += 1;
            land_count += u32::from(land.height_at(Position::new(x, z).unwrap()) > -(60 << 8));
        }
        assert!(sides.iter().all(|count| *count > 300), "{sides:?}");
        assert!(land_count > 400, "{land_count} of 2,000 above the sea floor");
    }

    #[test]
    fn world_points_reach_all_four_quarters() {
        let quarters: std::collections::HashSet<_> =
            world_points(100, 3).map(|(x, z)| (x < 0, z < 0)).collect();
        assert_eq!(quarters.len(), 4);
    }
}
