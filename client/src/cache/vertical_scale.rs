//! Vertical exaggeration: heights are scaled when a chunk arrives, so that levels, shadows and
//! vegetation all see the scaled land.

use terrain::Chunk;
use terrain::constants::HEIGHT_LIMIT;

/// Scale 1, Q8.
pub const ONE: i32 = 256;

/// A chunk with its heights scaled by `scale` / 256, rounded down. Its error scales too and covers
/// the rounding.
#[must_use]
pub fn scaled(chunk: Chunk, scale: i32) -> Chunk {
    if scale == ONE {
        return chunk;
    }
    let Chunk { key, mut heights, error, grass, .. } = chunk;
    for height in heights.iter_mut() {
        *height = scaled_height(*height, scale);
    }
    let scaled_error = (u64::from(error) * u64::from(scale.unsigned_abs())).div_ceil(256) + 1;
    // A server may state any error: saturating, so that no large one becomes a small one.
    let error = u32::try_from(scaled_error).unwrap_or(u32::MAX);
    Chunk::from_parts(key, heights, error, grass)
}

/// A height in units scaled by `scale` / 256, clamped to the height limit.
#[must_use]
pub fn scaled_height(height: i32, scale: i32) -> i32 {
    let limit = i64::from(HEIGHT_LIMIT) - 1;
    ((i64::from(height) * i64::from(scale)) >> 8).clamp(-limit, limit) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::{ChunkKey, Land};

    #[test]
    fn bounds_follow_the_scaled_heights_and_scale_one_is_identity() {
        let chunk = Land::new(1).chunk(ChunkKey::new(1, 2, 3).unwrap());
        assert_eq!(scaled(chunk.clone(), ONE), chunk);
        let high = scaled(chunk.clone(), 512);
        assert_eq!((high.max(), high.min()), (2 * chunk.max(), 2 * chunk.min()));
        assert!(high.error > 2 * chunk.error && high.slope > chunk.slope);
        assert_eq!(scaled_height(HEIGHT_LIMIT - 1, 1024), HEIGHT_LIMIT - 1);
        assert_eq!(scaled(Chunk { error: u32::MAX, ..chunk }, 512).error, u32::MAX);
    }
}
