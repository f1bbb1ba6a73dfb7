//! Terrain shadows: sun parameters, page table, clearances.

use bytemuck::{Pod, Zeroable};
use terrain::constants::VERTICES;

/// The sun and the extent of the page table, for `trace_terrain_shadow`, which documents each
/// field.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SunParams {
    /// Unit vector towards the sun, east and south.
    pub toward: [f32; 2],
    /// Least slope of the horizon, at least 0: slopes are clamped to it.
    pub slope_low: f32,
    /// Largest slope of the horizon: slopes are clamped to it.
    pub slope_high: f32,
    /// The sun above the level, radians.
    pub elevation: f32,
    /// log2 of the side of the top-level nodes, grid steps.
    pub root_bits: u32,
    /// Top-level nodes east.
    pub columns: u32,
    /// Top-level nodes south.
    pub rows: u32,
    /// The highest point of all that is drawn, units.
    pub max_height: i32,
    /// [`SKY_TRACE`], [`SKY_DARK`] or [`SKY_LIT`].
    pub sky: u32,
}

/// [`SunParams::sky`]: the land decides.
pub const SKY_TRACE: u32 = 0;

/// [`SunParams::sky`]: the sun is down.
pub const SKY_DARK: u32 = 1;

/// [`SunParams::sky`]: the sun is in the zenith, nothing hides it.
pub const SKY_LIT: u32 = 2;

/// A node of the page table of `trace_terrain_shadow`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct PageNode {
    /// [`LEAF`] and a slot, the index of the first of four children, or [`EMPTY_LINK`].
    pub link: u32,
    /// Nothing drawn under it is higher, units.
    pub max_height: i32,
}

/// The bit of [`PageNode::link`] that marks a leaf.
pub const LEAF: u32 = 1 << 31;

/// [`PageNode::link`] where nothing is drawn.
pub const EMPTY_LINK: u32 = LEAF - 1;

/// A chunk for `trace_terrain_shadow`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct ShadowTarget {
    /// Low corner east of that of the page table, steps of 2 m.
    pub x: i32,
    /// The same, south.
    pub z: i32,
    /// Its slot.
    pub slot: u32,
    /// Its level.
    pub level: u32,
}

/// Words of a slot that hold the sun's clearances: a byte per vertex, rows padded to whole words.
/// `shared/shadow.wesl` says what a byte means.
pub const CLEARANCE_WORDS: usize = VERTICES.div_ceil(4) * VERTICES;

/// A word of clearances that says: the sun is well clear of the land.
pub const CLEAR_WORD: u32 = u32::MAX;

/// Apparent radius of the sun, radians; the unit of clearances. Equal to the constant of
/// `shared/shadow.wesl`.
pub const SUN_RADIUS: f64 = 0.004651;

/// Clearances are clamped to this many radii. Equal to the constant of `shared/shadow.wesl`.
pub const CLEARANCE_RANGE: f64 = 8.0;

/// The clearance in radii of the sun that a byte means; the inverse of `clearance_byte` in
/// `shared/shadow.wesl`.
#[must_use]
pub fn clearance_of_byte(byte: u8) -> f64 {
    let part = (f64::from(byte) - 128.0) / 127.0;
    CLEARANCE_RANGE * part * part.abs()
}

/// Share of the sun's disc above a straight edge `clearance` radii below its middle; `disc_share`
/// of `shared/shadow.wesl`.
#[must_use]
pub fn disc_share(clearance: f64) -> f64 {
    let x = clearance.clamp(-1.0, 1.0);
    0.5 + (x * (1.0 - x * x).sqrt() + x.asin()) / std::f64::consts::PI
}

/// Capacity of the page table per slot, nodes, in addition to [`MAX_ROOTS`]. A balanced cover of
/// the view needs 4/3 of a node per drawn chunk.
pub const NODES_PER_SLOT: usize = 8;

/// Roots of the page table at most.
pub const MAX_ROOTS: usize = 64;
