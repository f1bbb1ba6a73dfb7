//! The probe set: where an implementation is most likely to go wrong, and places at random.

use terrain::constants::{
    BASE_CELL_BITS, BASE_OCTAVES, BASE_STREAM, EXPOSURE_CELL_BITS, EXPOSURE_STREAM, FIRST_CELL_BITS,
    ISLAND_CELL_BITS, OCTAVE_SHIFT, WARP_CELL_BITS, WARP_STREAM, WORLD_HALF,
};
use terrain::hash::mix;
use terrain::spline;

/// Places at random. Few, because the heights of a probe are ten evaluations of the base field: a
/// software GPU on two cores shall take no longer than a minute (measured: 3 s).
const SCATTERED: u32 = 100_000;

/// x and z, any i32.
pub type Probe = [i32; 2];

/// All pairs of the edge values, then the places at random. The same on every machine.
pub fn all() -> Vec<Probe> {
    let edges = edge_values();
    let mut probes = Vec::with_capacity(edges.len() * edges.len() + SCATTERED as usize);
    for x in &edges {
        probes.extend(edges.iter().map(|z| [*x, *z]));
    }
    probes.extend((0..SCATTERED).map(|n| {
        let (x, z) = (mix(2 * n) as i32, mix(2 * n + 1) as i32);
        // In four: one on the home island, one on and around some hundred islands, one in
        // the world, one anywhere.
        let shift = [11, 7, 1, 0][n as usize % 4];
        [x >> shift, z >> shift]
    }));
    probes
}

/// Stream and log2 of the cell of every turned lattice.
fn turned_lattices() -> impl Iterator<Item = (u32, u32)> {
    let octaves = (0..BASE_OCTAVES as u32).map(|octave| (BASE_STREAM + octave, BASE_CELL_BITS - octave));
    let warp = (0..4).map(|n| (WARP_STREAM + n, WARP_CELL_BITS[n as usize / 2]));
    octaves.chain(warp).chain([(EXPOSURE_STREAM, EXPOSURE_CELL_BITS)])
}

/// Where the axes of the world first meet a line of a turned lattice: there one of the turned
/// coordinates is four times the distance from the origin, plus the shift.
fn turned_line(stream: u32, bits: u32) -> i32 {
    let shift = stream.wrapping_mul(0x9e37_79b1);
    ((shift.wrapping_neg() & ((1 << bits) - 1)) >> 2) as i32
}

/// Zero and the ends of i32, both sides of every power of two, of the world's border, of every fine
/// octave's lattice lines next to the origin and to the border, of the turned lattices' lines on
/// the axes of the world, and of cells of the base lattice and of the archipelago. Sorted, each
/// once.
fn edge_values() -> Vec<i32> {
    let mut values = vec![0, i32::MIN, i32::MIN + 1, i32::MAX];
    let mut around = |value: i32| values.extend([value.wrapping_sub(1), value, value.wrapping_add(1)]);
    for power in (0..31).map(|bit| 1i32 << bit) {
        around(power);
        around(-power);
    }
    for (octave, (shift_x, shift_z)) in OCTAVE_SHIFT.into_iter().enumerate() {
        let cell_bits = FIRST_CELL_BITS - octave as u32;
        for shift in [shift_x, shift_z] {
            for near in [0, -WORLD_HALF, WORLD_HALF] {
                // The line on or below the place, and the next.
                let line = (((near + shift) >> cell_bits) << cell_bits) - shift;
                around(line);
                around(line + (1 << cell_bits));
            }
        }
    }
    for (stream, bits) in turned_lattices() {
        around(turned_line(stream, bits));
    }
    for cell in [1 << spline::CELL_BITS, 1 << ISLAND_CELL_BITS] {
        // Borders of cells of the archipelago lie half a cell from the origin's; nodes of the base
        // lattice likewise.
        for place in [cell / 2, 3 * cell / 2, 3 * cell, WORLD_HALF - cell / 2, WORLD_HALF - cell] {
            around(place);
            around(-place);
        }
    }
    values.sort_unstable();
    values.dedup();
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_set_has_the_world_borders_and_both_sides_of_lattice_lines() {
        let edges = edge_values();
        let beyond = WORLD_HALF + 1;
        for value in [0, 1, -1, i32::MIN, i32::MAX, i32::MIN + 1, WORLD_HALF, -WORLD_HALF, beyond, -beyond] {
            assert!(edges.binary_search(&value).is_ok(), "{value}");
        }
        for (octave, (shift, _)) in OCTAVE_SHIFT.into_iter().enumerate() {
            for line in [-shift, (1 << (FIRST_CELL_BITS - octave as u32)) - shift] {
                let near = line - 1..=line + 1;
                assert!(near.into_iter().all(|value| edges.binary_search(&value).is_ok()), "octave {octave}");
            }
        }
    }

    #[test]
    fn turned_lines_are_where_the_cell_changes() {
        for (stream, bits) in turned_lattices() {
            let line = turned_line(stream, bits);
            let cell = |v: i32| (4 * v as u32).wrapping_add(stream.wrapping_mul(0x9e37_79b1)) >> bits;
            assert!(cell(line - 1) != cell(line + 1), "stream {stream}");
        }
    }

    #[test]
    fn the_probes_lie_in_all_quarters_inside_and_outside_the_world() {
        let probes = all();
        assert!((250_000..350_000).contains(&probes.len()), "{}", probes.len());
        let inside = |v: i32| (-WORLD_HALF..=WORLD_HALF).contains(&v);
        let n_inside = probes.iter().filter(|[x, z]| inside(*x) && inside(*z)).count();
        assert!(n_inside * 3 > probes.len() * 2 && n_inside < probes.len(), "{n_inside}");
        for (east, south) in [(false, false), (false, true), (true, false), (true, true)] {
            let quarter = probes.iter().filter(|[x, z]| (*x > 0) == east && (*z > 0) == south).count();
            assert!(quarter * 5 > probes.len(), "{quarter}");
        }
    }
}
