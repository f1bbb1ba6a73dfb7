//! Geometric error of a chunk on screen, by block.
//!
//! A chunk's stated error is the maximum over the chunk. With its children resident, the distance
//! between their vertices and the chunk's triangles is known for each block, and each block's error
//! is divided by its own distance. Fewer chunks are split, and the bound holds: in every block the
//! drawn surface is within the block's error of the land, of quantised chunks of the rounded land.

use crate::cache::block_errors::BLOCKS;
use crate::cache::{ChunkCache, Resident, vertical_scale};
use protocol::Delivery;
use terrain::ChunkKey;
use terrain::lod::{SUMMIT, Viewer};

/// Error on screen up to which a chunk is not split, 1/16 pixel.
#[must_use]
pub fn tolerance(viewer: &Viewer) -> f64 {
    f64::from(viewer.tolerance())
}

/// The error of a chunk to select by, units: that of the land's own chunk, or less. A quantised
/// chunk states the rounding of its heights too, of which a server's selection knows nothing: finer
/// chunks are rounded alike, so none would be sent for it.
#[must_use]
pub fn without_rounding(stated: u32, delivery: Delivery) -> u32 {
    match delivery {
        Delivery::Quantised(tolerance) => stated.saturating_sub(tolerance.units().into()),
        Delivery::Exact | Delivery::Refined | Delivery::SeedOnly => stated,
    }
}

/// Whether a chunk must be split for a viewer. Implies that the server splits it too, for `served`
/// ([`vertical_scale::served`] of the viewer): the server uses the chunk's error, or a larger
/// bound, at the nearest distance. A chunk that overstates its error waits for children that no
/// server sends, and is drawn itself.
#[must_use]
pub fn is_too_coarse(
    cache: &ChunkCache,
    viewer: &Viewer,
    served: &Viewer,
    key: ChunkKey,
    chunk: &Resident,
) -> bool {
    let bound = served.screen_error_q4(chunk.served_error, served.distance_to(key));
    bound > served.tolerance() && on_screen(cache, viewer, key, chunk) > tolerance(viewer)
}

/// Bound of the error on screen of a drawn chunk, 1/16 pixel, not rounded.
#[must_use]
pub fn on_screen(cache: &ChunkCache, viewer: &Viewer, key: ChunkKey, chunk: &Resident) -> f64 {
    let bounds = ChunkError::new(cache, viewer, key, chunk);
    if bounds.is_negligible() {
        return bounds.whole;
    }
    let worst_of = |worst: f64, child| Some(worst.max(bounds.part(cache, child, INSIDE)?));
    let by_blocks = key.children().and_then(|children| children.into_iter().try_fold(0.0, worst_of));
    by_blocks.unwrap_or(bounds.whole).min(bounds.whole)
}

/// The whole chunk, for [`parent_error_on_screen`].
pub const INSIDE: (i32, i32) = (0, 0);

/// Error on screen of the parent drawn in place of `child`, 1/16 pixel: the part of [`on_screen`]
/// of the parent in this quarter. None without a resident parent. With [`INSIDE`], all blocks
/// count; with a direction (east, south), the blocks at that border.
#[must_use]
pub fn parent_error_on_screen(
    cache: &ChunkCache,
    viewer: &Viewer,
    child: ChunkKey,
    toward: (i32, i32),
) -> Option<f64> {
    let key = child.parent()?;
    let bounds = ChunkError::new(cache, viewer, key, cache.get(key)?);
    let part = if bounds.is_negligible() { None } else { bounds.part(cache, child, toward) };
    Some(part.unwrap_or(bounds.whole).min(bounds.whole))
}

/// Error bounds of one chunk for one viewer.
struct ChunkError<'a> {
    viewer: &'a Viewer,
    /// Bound of the error anywhere, units.
    stated: u32,
    /// Lower bound of the distance, units.
    nearest: u64,
    /// The stated error at the nearest distance, 1/16 pixel.
    whole: f64,
}

impl<'a> ChunkError<'a> {
    fn new(cache: &ChunkCache, viewer: &'a Viewer, key: ChunkKey, chunk: &Resident) -> Self {
        let stated = chunk.error;
        let summit = vertical_scale::scaled_height(SUMMIT, cache.vertical_scale());
        let nearest = viewer.distance_to_box(key, i32::MIN, summit);
        let bounds = Self { viewer, stated, nearest, whole: 0.0 };
        let whole = bounds.on_screen_at(stated, distance(viewer, key.origin(), key.side(), chunk, chunk.max));
        Self { whole, ..bounds }
    }

    /// Whether the error is so small that a test by blocks cannot change the selection.
    fn is_negligible(&self) -> bool {
        self.whole <= f64::from(self.viewer.tolerance()) / 4.0
    }

    fn on_screen_at(&self, error: u32, distance: u64) -> f64 {
        let scaled = f64::from(error) * f64::from(self.viewer.pixels_per_radian) * 16.0;
        scaled / distance.max(self.nearest).max(1) as f64
    }

    /// The largest block error in the quarter that a child covers, or along one of its borders;
    /// none without the child.
    fn part(&self, cache: &ChunkCache, key: ChunkKey, (east, south): (i32, i32)) -> Option<f64> {
        let child = cache.get(key)?;
        let block_errors = child.block_errors.as_ref()?;
        let (x, z) = key.origin();
        let side = key.side() / BLOCKS as u32;
        let blocks = block_rows(south).flat_map(|row| block_rows(east).map(move |column| (column, row)));
        let blocks = blocks.map(|(column, row)| {
            let index = row * BLOCKS + column;
            let corner = (x + column as i32 * side as i32, z + row as i32 * side as i32);
            let error =
                block_errors[index].saturating_add(block_error(cache, key, child, index)).min(self.stated);
            self.on_screen_at(error, distance(self.viewer, corner, side, child, child.maxima[index]))
        });
        Some(blocks.fold(0.0, f64::max))
    }
}

/// Rows of blocks: the first for -1, the last for 1, else all.
fn block_rows(direction: i32) -> std::ops::Range<usize> {
    match direction {
        -1 => 0..1,
        1 => BLOCKS - 1..BLOCKS,
        _ => 0..BLOCKS,
    }
}

/// Bound of a chunk's own error in one of its blocks, units: its stated error, or the bound from
/// its resident children.
fn block_error(cache: &ChunkCache, key: ChunkKey, chunk: &Resident, block: usize) -> u32 {
    let Some(children) = key.children() else { return chunk.error };
    // A block is two by two blocks of one child.
    let (x, z) = (2 * (block % BLOCKS), 2 * (block / BLOCKS));
    let child = cache.get(children[x / BLOCKS + 2 * (z / BLOCKS)]);
    let Some((child, block_errors)) = child.and_then(|child| Some((child, child.block_errors.as_ref()?)))
    else {
        return chunk.error;
    };
    let (x, z) = (x % BLOCKS, z % BLOCKS);
    let errors = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dz)| block_errors[(z + dz) * BLOCKS + x + dx]);
    errors.into_iter().max().unwrap_or(0).saturating_add(child.error).min(chunk.error)
}

/// Distance from the eye to the true land of a square in a chunk whose drawn surface is at most
/// `highest`, units.
fn distance(viewer: &Viewer, corner: (i32, i32), side: u32, chunk: &Resident, highest: i32) -> u64 {
    let error = i32::try_from(chunk.error).unwrap_or(i32::MAX);
    viewer.distance_to_block(corner, side, chunk.min.saturating_sub(error), highest.saturating_add(error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::Land;

    #[test]
    fn block_errors_lower_the_bound() {
        let land = Land::new(1);
        let mut cache = ChunkCache::new(100);
        let key = ChunkKey::new(1, 2, 3).unwrap();
        let viewer = Viewer {
            eye: (100_000, 30_000, 260_000),
            distance_m: 4000,
            pixels_per_radian: 900,
            tolerance_q4: 1,
        };
        cache.insert(land.chunk(key));
        let before = on_screen(&cache, &viewer, key, cache.get(key).unwrap());
        let [first, rest @ ..] = key.children().unwrap();
        for child in rest {
            cache.insert(land.chunk(child));
        }
        assert_eq!(on_screen(&cache, &viewer, key, cache.get(key).unwrap()), before, "one child is missing");
        cache.insert(land.chunk(first));
        let after = on_screen(&cache, &viewer, key, cache.get(key).unwrap());
        assert!(after < before && after > 0.0, "{after} {before}");
    }
}
