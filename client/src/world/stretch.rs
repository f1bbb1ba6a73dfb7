//! Land drawn higher than it is: heights are multiplied as a chunk arrives, so that everything
//! behind it (levels, shadows, plants, what hides them) is that of the stretched land without
//! knowing.

use terrain::Chunk;
use terrain::constants::HEIGHT_LIMIT;

/// No stretch, Q8.
pub const ONE: i32 = 256;

/// A chunk so many 256ths as high, heights rounded down. Its error grows with it and by the
/// rounding.
#[must_use]
pub fn stretched(chunk: Chunk, scale: i32) -> Chunk {
    if scale == ONE {
        return chunk;
    }
    let Chunk { key, mut heights, error, grass, .. } = chunk;
    for height in heights.iter_mut() {
        *height = times(*height, scale);
    }
    let error = (u64::from(error) * scale.unsigned_abs() as u64).div_ceil(256) as u32 + 1;
    Chunk::from_parts(key, heights, error, grass)
}

/// A height in units so many 256ths as high, within what a height may be.
#[must_use]
pub fn times(height: i32, scale: i32) -> i32 {
    let limit = i64::from(HEIGHT_LIMIT) - 1;
    ((i64::from(height) * i64::from(scale)) >> 8).clamp(-limit, limit) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::{ChunkKey, Land};

    #[test]
    fn bounds_follow_the_stretched_heights_and_one_changes_nothing() {
        let chunk = Land::new(1).chunk(ChunkKey::new(1, 2, 3).unwrap());
        assert_eq!(stretched(chunk.clone(), ONE), chunk);
        let high = stretched(chunk.clone(), 512);
        assert_eq!((high.max(), high.min()), (2 * chunk.max(), 2 * chunk.min()));
        assert!(high.error > 2 * chunk.error && high.slope > chunk.slope);
        assert_eq!(times(HEIGHT_LIMIT - 1, 1024), HEIGHT_LIMIT - 1);
    }
}
