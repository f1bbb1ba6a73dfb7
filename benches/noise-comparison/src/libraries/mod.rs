//! Noise libraries for comparison: one file each, with the same fractal.

pub mod fastnoise2;
pub mod fastnoise_lite;
pub mod noise;
pub mod plain;

/// Octaves of the fractal sum: those that every vertex of the land evaluates.
pub const OCTAVES: usize = 5;

/// Side of the first octave's lattice cell in samples; the last one's is 4.
pub const FIRST_CELL: usize = 64;

/// Offset of the samples from the lattice lines. Half a sample, as in the land: otherwise every
/// fourth sample would be on a lattice line of the last octave, where gradient noise is zero.
pub const SHIFT: f32 = 0.5;

/// Factor between the frequencies of two octaves; the gain is that between their amplitudes.
pub const LACUNARITY: f32 = 2.0;
/// See [`LACUNARITY`].
pub const GAIN: f32 = 0.5;

/// Fills a grid point by point, for libraries without a grid function.
pub fn fill_points(
    corner: crate::rounds::Corner,
    columns: usize,
    out: &mut [f32],
    mut at: impl FnMut(f32, f32) -> f32,
) {
    for (row, line) in out.chunks_exact_mut(columns).enumerate() {
        for (column, value) in line.iter_mut().enumerate() {
            *value = at((corner.x + column as i32) as f32 + SHIFT, (corner.z + row as i32) as f32 + SHIFT);
        }
    }
}
