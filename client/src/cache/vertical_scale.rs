//! Vertical exaggeration: heights are scaled when a chunk arrives, so that levels, shadows and
//! vegetation all see the scaled land.

use terrain::Chunk;
use terrain::constants::HEIGHT_LIMIT;
use terrain::lod::Viewer;

/// Scale 1, Q8.
pub const ONE: i32 = 256;

/// A chunk with its heights scaled by `scale` / 256, rounded down. Its error scales too and covers
/// the rounding.
#[must_use]
pub(super) fn scaled(chunk: Chunk, scale: i32) -> Chunk {
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

/// The viewer to select chunks of the unscaled land by, as a server does, so that a viewer of the
/// scaled land needs no other chunk. Above scale 1 a vertical error is `scale` / 256 times as
/// large, and the eye is lower over the unscaled land. Below it the viewer itself needs more than
/// enough.
#[must_use]
pub fn served(viewer: &Viewer, scale: i32) -> Viewer {
    let times = i64::from(scale.max(ONE));
    let unscaled = |value: i64| value * i64::from(ONE) / times;
    let (east, up, south) = viewer.eye;
    Viewer {
        eye: (east, unscaled(up.into()) as i32, south),
        tolerance_q4: unscaled(viewer.tolerance().into()).max(1) as u32,
        ..*viewer
    }
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

    #[test]
    fn a_server_selects_by_unscaled_heights() {
        let viewer =
            Viewer { eye: (-5, 4000, 7), distance_m: 2000, pixels_per_radian: 300, tolerance_q4: 30 };
        let lower = Viewer { eye: (-5, 1000, 7), tolerance_q4: 7, ..viewer };
        let least = Viewer { tolerance_q4: 1, ..viewer };
        assert_eq!(served(&viewer, 4 * ONE), lower);
        assert_eq!([served(&viewer, ONE), served(&viewer, ONE / 4)], [viewer; 2]);
        assert_eq!(served(&least, 4 * ONE).tolerance_q4, 1);
    }
}
