//! The probe set: where an implementation is most likely to go wrong, and a million places at
//! random.

use terrain::constants::{FIRST_CELL_BITS, OCTAVE_SHIFT, WORLD_HALF};
use terrain::hash::mix;

/// Places at random.
const SCATTERED: u32 = 1_000_000;

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
        // In four: two on and around the home island, one in the world, one anywhere.
        let shift = [10, 10, 1, 0][n as usize % 4];
        [x >> shift, z >> shift]
    }));
    probes
}

/// Zero and the ends of i32, both sides of every power of two, of the world's border, and of every
/// octave's lattice lines next to the origin and to the border. Sorted, each once.
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
    fn the_probes_lie_in_all_quarters_inside_and_outside_the_world() {
        let probes = all();
        assert!((1_050_000..1_400_000).contains(&probes.len()), "{}", probes.len());
        let inside = |v: i32| (-WORLD_HALF..=WORLD_HALF).contains(&v);
        let n_inside = probes.iter().filter(|[x, z]| inside(*x) && inside(*z)).count();
        assert!(n_inside * 3 > probes.len() * 2 && n_inside < probes.len(), "{n_inside}");
        for (east, south) in [(false, false), (false, true), (true, false), (true, true)] {
            let quarter = probes.iter().filter(|[x, z]| (*x > 0) == east && (*z > 0) == south).count();
            assert!(quarter * 5 > probes.len(), "{quarter}");
        }
    }
}
