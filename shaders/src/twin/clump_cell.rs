//! Twin of `wgsl/shared/clump_cell.wesl`: Voronoi cells whose clumps share a part of their height
//! and hue.
//!
//! Integers only: every client finds the same cell.

use terrain::hash::hash2;

/// log2 of the side of a square of the lattice, fine units: 1 m.
pub const SQUARE_BITS: u32 = 12;
const PART_BITS: u32 = 4;
const CLUMP_CELL_SEED: u32 = 0x6a57;

/// Numbers that the clumps of a cell share, 6 bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClumpCell {
    /// Of the height.
    pub height: u32,
    /// Of the hue.
    pub hue: u32,
}

/// The cell of a place, fine units from a corner, which is `origin` metres from the origin of the
/// world.
#[must_use]
pub fn clump_cell(origin: [i32; 2], place: [i32; 2]) -> ClumpCell {
    let corner = place.map(|axis| (axis + (1 << (SQUARE_BITS - 1))) >> SQUARE_BITS);
    let part = [0, 1].map(|axis| (place[axis] - (corner[axis] << SQUARE_BITS)) >> PART_BITS);
    let mut nearest = i32::MAX;
    let mut found = 0;
    for square in 0..4 {
        let low = [(square & 1) - 1, (square >> 1) - 1];
        let hash = hash2(CLUMP_CELL_SEED, origin[0] + corner[0] + low[0], origin[1] + corner[1] + low[1]);
        let point = [(low[0] << 8) + 64 + (hash & 127) as i32, (low[1] << 8) + 64 + (hash >> 7 & 127) as i32];
        let apart = [part[0] - point[0], part[1] - point[1]];
        let far = apart[0] * apart[0] + apart[1] * apart[1];
        if far < nearest {
            nearest = far;
            found = hash;
        }
    }
    return ClumpCell { height: found >> 14 & 63, hue: found >> 20 & 63 };
}

/// A number of a clump, 6 bits, of which `share` sixteenths are its cell's.
#[must_use]
pub fn shared_number(own: u32, cell: u32, share: u32) -> u32 {
    return ((16 - share) * own + share * cell) >> 4;
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::hash::mix;

    /// The hash of the nearest of the points of the squares up to `around` squares from a place, by
    /// brute force.
    fn nearest_of(origin: [i32; 2], place: [i32; 2], around: i32) -> (i32, Vec<ClumpCell>) {
        let square = place.map(|axis| axis >> SQUARE_BITS);
        let (mut nearest, mut cells) = (i32::MAX, Vec::new());
        for z in -around..=around {
            for x in -around..=around {
                let at = [square[0] + x, square[1] + z];
                let hash = hash2(CLUMP_CELL_SEED, origin[0] + at[0], origin[1] + at[1]);
                let point =
                    [at[0] * 256 + 64 + (hash & 127) as i32, at[1] * 256 + 64 + (hash >> 7 & 127) as i32];
                let apart = [(place[0] >> PART_BITS) - point[0], (place[1] >> PART_BITS) - point[1]];
                let far = apart[0].pow(2) + apart[1].pow(2);
                if far < nearest {
                    (nearest, cells) = (far, Vec::new());
                }
                if far == nearest {
                    cells.push(ClumpCell { height: hash >> 14 & 63, hue: hash >> 20 & 63 });
                }
            }
        }
        (nearest, cells)
    }

    fn any_place(seed: u32) -> [i32; 2] {
        [0, 1].map(|axis| (mix(seed * 2 + axis) >> 12) as i32)
    }

    #[test]
    fn the_point_of_a_cell_is_the_nearest_of_all() {
        let mut narrower = 0;
        for seed in 0..20_000 {
            let (origin, place) = ([-7000 + seed as i32, 912], any_place(seed));
            let (_, cells) = nearest_of(origin, place, 2);
            assert!(cells.contains(&clump_cell(origin, place)), "{place:?}");
            // The control: the point of the own square alone.
            narrower += u32::from(!nearest_of(origin, place, 0).1.contains(&cells[0]));
        }
        assert!(narrower > 1000, "{narrower}");
    }

    #[test]
    fn cells_are_fixed_in_the_world_and_differ() {
        let mut apart = 0;
        for seed in 0..5000 {
            let place = any_place(seed);
            let moved = [place[0] - (5 << SQUARE_BITS), place[1] + (9 << SQUARE_BITS)];
            let here = clump_cell([100, -200], place);
            assert_eq!(here, clump_cell([105, -209], moved));
            // The control: the same place in another part of the world.
            apart += u32::from(here != clump_cell([104, -209], moved));
        }
        assert!(apart > 4000, "{apart}");
    }

    #[test]
    fn shared_numbers_stay_in_six_bits_and_follow_their_cell() {
        for share in 0..=16 {
            assert_eq!(shared_number(63, 63, share), 63);
            assert_eq!(shared_number(0, 0, share), 0);
        }
        assert_eq!((shared_number(63, 0, 16), shared_number(63, 0, 0)), (0, 63));
    }
}
