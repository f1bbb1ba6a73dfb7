//! The chunks that codecs are compared on: here and in `benches/lerc`, which includes this file.

use terrain::{Chunk, ChunkKey, Land};

/// Level-0 chunks around the origin, row by row up to `reach` of them to every side, without those
/// of open sea.
pub fn land_keys(land: &Land, reach: i32) -> impl Iterator<Item = ChunkKey> + '_ {
    let near = (-reach..reach).flat_map(move |z| (-reach..reach).map(move |x| (x, z)));
    near.filter_map(|(x, z)| ChunkKey::new(0, x, z).ok()).filter(|key| {
        let (x, z) = key.origin();
        !land.archipelago().is_open_sea(x, z, key.side())
    })
}

/// 2^64 over the golden ratio. Its multiples are spread evenly, and, unlike equal steps through the
/// rows, cannot all lie in one column.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// At most `count` chunks scattered over the home island, each with its heights above its lowest;
/// chunks whose relief does not fit `u16` are left out.
pub fn chunks(land: &Land, count: usize) -> impl Iterator<Item = (Chunk, Vec<u16>)> + '_ {
    let keys: Vec<_> = land_keys(land, 24).collect();
    let above_lowest = |key| {
        let chunk = land.chunk(key);
        let low = chunk.min();
        let above = chunk.heights.iter().map(|height| u16::try_from(height - low).ok());
        let above = above.collect::<Option<_>>()?;
        Some((chunk, above))
    };
    (0..count as u64)
        .map(|index| ((index.wrapping_mul(GOLDEN) >> 32) * keys.len() as u64) >> 32)
        .filter_map(|index| keys.get(index as usize).copied())
        .collect::<Vec<_>>()
        .into_iter()
        .filter_map(above_lowest)
}
