//! The estimate by which a server refuses a view, as docs/protocol.md states it.

use terrain::lod::{Viewer, estimated_chunks};

/// Usual errors of the levels from 0 on, metres; the last one holds for all coarser levels.
const ERROR_M: [u64; 8] = [0, 4, 7, 12, 22, 40, 80, 1558];

fn published(viewer: &Viewer) -> u64 {
    let distance = u64::from(viewer.distance_m) * 256;
    let finer = (0..viewer.top_level()).map(|level| {
        let error = 256 * ERROR_M[usize::from(level + 1).min(7)];
        let reach = error * u64::from(viewer.pixels_per_radian) * 16 / u64::from(viewer.tolerance_q4);
        let side = 2 * distance.min(reach) / (32_768 << level) + 2;
        side * side
    });
    viewer.tops().len() as u64 + finer.sum::<u64>()
}

#[test]
fn the_published_formula_is_that_of_the_code() {
    let mut estimates = Vec::new();
    for distance_m in [1, 300, 2000, 20_000, 65_536] {
        for (pixels_per_radian, tolerance_q4) in [(1, 1 << 14), (312, 64), (624, 16), (935, 64), (5000, 1)] {
            let viewer = Viewer { eye: (0, 0, 0), distance_m, pixels_per_radian, tolerance_q4 };
            let estimate = estimated_chunks(&viewer);
            assert_eq!(estimate, published(&viewer), "{viewer:?}");
            estimates.push(estimate);
        }
    }
    estimates.sort_unstable();
    estimates.dedup();
    assert!(estimates.len() > 15, "views of different cost: {estimates:?}");
}
