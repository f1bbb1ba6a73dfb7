//! Walks across the places where curves of the base field begin and end: rims of lobes, of the mass
//! and of its middle, ends of the shore's curves, where the flatness of the octaves is zero, where
//! exposure begins and is complete, and the water line.

use super::samples::{VERTEX_STEP, Walk};
use crate::reference_f64::ReferenceF64;
use crate::sample;
use terrain::Octaves;
use terrain::base::Base;
use terrain::constants::WORLD_HALF;
use terrain::island::{Lobe, Mass};

/// Rows on which thresholds are looked for.
const ROWS: u32 = 400;

/// Places on a row between which a threshold is looked for: 4 km in steps of 512 m.
const LENGTH: i32 = 8;
const APART: i32 = VERTEX_STEP << 8;

/// Number of thresholds; tests name them.
const COUNT: usize = 13;

/// What decides on which side of each threshold a place lies.
struct Sides {
    reference: ReferenceF64,
    base: Base,
}

/// Walks over all thresholds that are found in a world.
pub fn walks(world_seed: u64) -> Vec<Walk> {
    found(world_seed).into_iter().map(|(_, walk)| walk).collect()
}

/// Index of a threshold, and a walk across it.
fn found(world_seed: u64) -> Vec<(usize, Walk)> {
    let sides = Sides { reference: ReferenceF64::new(world_seed), base: Base::new(world_seed) };
    let mut found = Vec::new();
    for (x, z) in sample::land_points(world_seed, ROWS, 0x7e57) {
        let lobes = sides.reference.world().lobes(x, z);
        // The place lies in a lobe but for the change of the warp on the way to it.
        let Some(lobe) = lobes.first() else { continue };
        let row = (0..=LENGTH).map(|n| x.saturating_add((n - LENGTH / 2) * APART));
        let row: Vec<i32> = row.filter(|x| (-WORLD_HALF..=WORLD_HALF).contains(x)).collect();
        let on_row: Vec<_> = row.iter().map(|x| sides.of((*x, z), lobe)).collect();
        for threshold in 0..COUNT {
            let side = |n: usize| on_row.get(n).is_some_and(|sides| sides[threshold]);
            let Some(n) = (1..row.len()).find(|n| side(n - 1) != side(*n)) else { continue };
            let (mut low, mut high) = (row[n - 1], row[n]);
            while high - low > 1 {
                let middle = low + (high - low) / 2;
                let is_low = sides.of((middle, z), lobe)[threshold] == side(n - 1);
                if is_low { low = middle } else { high = middle }
            }
            found.extend(Walk::around((low, z), 0).map(|walk| (threshold, walk)));
        }
    }
    found
}

impl Sides {
    fn of(&self, (x, z): (i32, i32), lobe: &Lobe) -> [bool; COUNT] {
        let in_lobe = Mass::at(&[*lobe], (x, z), self.base.warp(x, z)).mass > 0;
        let (node, stages) = self.reference.node(x, z, Octaves::ALL);
        let shore = stages.shore;
        [
            in_lobe,
            stages.mass > 0.0,
            stages.mass > 0.125,
            stages.mass > 0.625,
            shore > 0.0,
            shore > -32.0,
            shore > 32.0,
            shore > -128.0,
            shore > 8.0,
            stages.flatness > 0.0,
            node.exposure > 0.0,
            node.exposure < 1.0,
            node.height > 0.0,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; COUNT] = [
        "rim of a lobe",
        "rim of the mass",
        "end of the rim",
        "middle of the mass",
        "water line of the shore",
        "shelf",
        "plain",
        "reach of the last octave at sea",
        "foot of mountains",
        "end of flatness",
        "beaches only",
        "cliffs only",
        "sea level",
    ];

    #[test]
    fn every_threshold_is_found() {
        let found = found(2);
        for (threshold, name) in NAMES.into_iter().enumerate() {
            let count = found.iter().filter(|(index, _)| *index == threshold).count();
            assert!(count > 0, "no `{name}`");
        }
    }
}
