//! The work of both programs: awkward grids of one kernel, folded into 64 bits.

use terrain::{ChunkKey, Grid, Kernel, Land, Pyramid};

/// Digest of a kernel's heights, fine octaves and pyramids: every level at the origin and at a
/// corner of the world, narrow and wide strips, few rows and a second band of rows, rows of open
/// sea. Small, so that an interpreter that checks every access gets through.
pub fn digest(kernel: Kernel) -> u64 {
    let mut hasher = blake3::Hasher::new();
    let mut add = |values: &[i32]| values.iter().for_each(|value| _ = hasher.update(&value.to_le_bytes()));
    let land = Land::new(7);
    let odd = [
        (1, 1, 0, 0, 0),
        (7, 2, 0, -100_000, 7),
        (17, 2, 2, -5_000, 999),
        (66, 2, 0, 3, -3),
        (20, 67, 7, -2_102_152, 0),
    ];
    let levels = (0..=16u8).flat_map(|level| {
        let step = 512 << level;
        [(3, 2, level, -step, -step), (2, 3, level, (1 << 30) - step, (1 << 30) - 2 * step)]
    });
    for (columns, rows, level, x, z) in odd.into_iter().chain(levels) {
        let grid = Grid::new(x, z, level, columns, rows).expect("the grids lie in the world");
        let (mut heights, mut fine) = (vec![0; grid.vertex_count()], vec![0; grid.vertex_count()]);
        land.heights_on(kernel, &grid, &mut heights);
        land.fbm().grid_on(kernel, &grid, &mut fine);
        [heights, fine].iter().for_each(|values| add(values));
    }
    let mut chunk = Box::new([0; 4225]);
    land.heights_on(kernel, &Grid::of_chunk(ChunkKey::containing(0, 5_000, 5_000)), &mut chunk[..]);
    for pyramid in [Pyramid::of_maxima_on(kernel, &chunk), Pyramid::of_minima_on(kernel, &chunk)] {
        (0..7).for_each(|level| add(pyramid.level(level)));
    }
    u64::from_le_bytes(*hasher.finalize().as_bytes().first_chunk().expect("32 bytes"))
}
