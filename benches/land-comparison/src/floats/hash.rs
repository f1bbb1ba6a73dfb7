//! Hashes of lattice points. The highest five bits choose a gradient.

use super::lanes::I8;

/// A hash in three parts, so that columns and rows are hashed once where they are shared.
pub trait Hash {
    /// The part of a column of lattice points.
    fn column(seed: I8, cell_x: I8) -> I8;

    /// The part of a row.
    fn row(cell_z: I8) -> I8;

    /// The hash of the point on both.
    fn point(column: I8, row: I8) -> I8;
}

/// The hash of the land, for the comparison of heights.
#[derive(Clone, Copy, Debug)]
pub struct Ours;

impl Hash for Ours {
    #[inline(always)]
    fn column(seed: I8, cell_x: I8) -> I8 {
        mix(seed ^ (cell_x * I8::splat(0x9e37_79b9_u32 as i32)))
    }

    #[inline(always)]
    fn row(cell_z: I8) -> I8 {
        cell_z * I8::splat(0x85eb_ca6b_u32 as i32)
    }

    #[inline(always)]
    fn point(column: I8, row: I8) -> I8 {
        mix(column + row)
    }
}

/// `terrain::hash::mix` on vectors.
#[inline(always)]
fn mix(h: I8) -> I8 {
    let h = (h ^ h.shr::<16>()) * I8::splat(0x21f0_aaad);
    let h = (h ^ h.shr::<15>()) * I8::splat(0xd35a_2d97_u32 as i32);
    h ^ h.shr::<15>()
}

/// A hash with the work of FastNoise2's: one multiplication for each axis and one for each point.
#[derive(Clone, Copy, Debug)]
pub struct Short;

impl Hash for Short {
    #[inline(always)]
    fn column(seed: I8, cell_x: I8) -> I8 {
        seed ^ (cell_x * I8::splat(0x9e37_79b9_u32 as i32))
    }

    #[inline(always)]
    fn row(cell_z: I8) -> I8 {
        cell_z * I8::splat(0x85eb_ca6b_u32 as i32)
    }

    #[inline(always)]
    fn point(column: I8, row: I8) -> I8 {
        let h = (column ^ row) * I8::splat(0x27d4_eb2d);
        h ^ h.shr::<15>()
    }
}
