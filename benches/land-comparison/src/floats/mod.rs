//! The land of docs/heightfield.md in 32-bit floats on AVX2 with FMA: what a program would compute
//! that draws this land and needs no equal integers on every machine.

#[cfg(not(target_arch = "x86_64"))]
compile_error!("the floats are written for x86-64 with AVX2 and FMA");

mod base;
mod hash;
mod lanes;
mod noise;
mod spline;

pub use hash::{Hash, Ours, Short};

use anyhow::{Result, ensure};
use base::{Base, FloatLobe, Node, smoothstep};
use lanes::{COUNT, F8, I8};
use noise::Axis;
use spline::{Nodes, Weights};
use terrain::constants::{
    FINE_OCTAVES, FIRST_CELL_BITS, OCTAVE_SHIFT, SPACING_BITS, UNITS_PER_METRE, VERTEX_COUNT, VERTICES,
};
use terrain::hash::stream_seed;
use terrain::island::Archipelago;

/// Whole vectors of a row; the last column of a chunk is evaluated as vectors along z.
const VECTORS: usize = VERTICES / COUNT;

/// Half of the square around a chunk in which islands are sought, beyond its side: all nodes lie in
/// it.
const MARGIN: i32 = 2 << terrain::spline::CELL_BITS;

/// One world in floats.
pub struct FloatLand {
    fine: [u32; FINE_OCTAVES],
    base: Base,
    archipelago: Archipelago,
}

impl FloatLand {
    /// The world of a seed.
    ///
    /// # Errors
    /// This CPU has not AVX2 and FMA.
    pub fn new(world_seed: u64) -> Result<Self> {
        ensure!(
            is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            "this CPU has no AVX2 with FMA, which the comparison is for; run this on another machine"
        );
        Ok(Self {
            fine: std::array::from_fn(|octave| stream_seed(world_seed, octave as u32)),
            base: Base::new(world_seed),
            archipelago: Archipelago::new(world_seed),
        })
    }

    /// Heights of the chunk of level 0 of a low corner, units, row by row: with the first `FINE`
    /// fine octaves, and wide octaves as splines of 36 nodes where `SPLINED`, else at every vertex.
    pub fn heights<H: Hash, const FINE: usize, const SPLINED: bool>(
        &self,
        corner: (i32, i32),
        out: &mut [i32; VERTEX_COUNT],
    ) {
        let (x, z) = corner;
        let side = (((VERTICES - 1) << SPACING_BITS) as i32 + 2 * MARGIN) as u32;
        let lobes = self.archipelago.lobes_near(x - MARGIN, z - MARGIN, side);
        let lobes: Vec<_> = lobes.iter().map(FloatLobe::new).collect();
        // SAFETY: a world exists only where both features were detected.
        unsafe { chunk::<H, FINE, SPLINED>(self, &lobes, corner, out) }
    }
}

/// The vertices of a chunk.
#[target_feature(enable = "avx2,fma")]
fn chunk<H: Hash, const FINE: usize, const SPLINED: bool>(
    land: &FloatLand,
    lobes: &[FloatLobe],
    (x0, z0): (i32, i32),
    out: &mut [i32; VERTEX_COUNT],
) {
    let step = I8::ramp().shl::<{ SPACING_BITS as i32 }>();
    let at = |low: i32, vertex: usize| I8::splat(low + ((vertex as i32) << SPACING_BITS));
    let weights = Weights::new();
    let nodes = if SPLINED { Some(Nodes::new::<H>(&land.base, lobes, (x0, z0))) } else { None };

    let mut columns = [[Axis::none(); FINE_OCTAVES]; VECTORS];
    for (vector, axes) in columns.iter_mut().enumerate() {
        *axes = east::<H, FINE>(&land.fine, at(x0, vector * COUNT) + step);
    }
    for row in 0..VERTICES {
        let z = at(z0, row);
        let rows = south::<H, FINE>(z);
        let line = nodes.as_ref().map(|nodes| nodes.row(row));
        for (vector, columns) in columns.iter().enumerate() {
            let node = match &line {
                Some(line) => line.at(vector, &weights),
                None => land.base.at::<H>(lobes, at(x0, vector * COUNT) + step, z),
            };
            let first = row * VERTICES + vector * COUNT;
            let out = out[first..first + COUNT].first_chunk_mut().expect("a vector");
            vertices::<H, FINE>(node, columns, &rows).store(out);
        }
    }
    let x = at(x0, VERTICES - 1);
    let columns = east::<H, FINE>(&land.fine, x);
    let line = nodes.as_ref().map(Nodes::last_column);
    for vector in 0..=VECTORS {
        let z = at(z0, vector * COUNT) + step;
        let node = match &line {
            Some(line) => line.at(vector, &weights),
            None => land.base.at::<H>(lobes, x, z),
        };
        let mut heights = [0; COUNT];
        vertices::<H, FINE>(node, &columns, &south::<H, FINE>(z)).store(&mut heights);
        for (row, height) in (vector * COUNT..VERTICES).zip(heights) {
            out[row * VERTICES + VERTICES - 1] = height;
        }
    }
}

/// Axes of the fine octaves.
type Axes = [Axis; FINE_OCTAVES];

/// The axes of the first `$fine` octaves, each with its number and the bits of its cell.
macro_rules! octaves {
    ($fine:ident, |$octave:ident, $bits:ident| $axis:expr) => {{
        const { assert!(FIRST_CELL_BITS == 15 && FINE_OCTAVES == 5) };
        macro_rules! one {
            ($number:literal) => {{
                const $octave: usize = $number;
                const $bits: i32 = 15 - $number;
                if $octave < $fine { $axis } else { Axis::none() }
            }};
        }
        [one!(0), one!(1), one!(2), one!(3), one!(4)]
    }};
}

#[inline(always)]
fn east<H: Hash, const FINE: usize>(seeds: &[u32; FINE_OCTAVES], x: I8) -> Axes {
    octaves!(FINE, |OCTAVE, BITS| Axis::east::<H, BITS>(seeds[OCTAVE], x + I8::splat(OCTAVE_SHIFT[OCTAVE].0)))
}

#[inline(always)]
fn south<H: Hash, const FINE: usize>(z: I8) -> Axes {
    octaves!(FINE, |OCTAVE, BITS| Axis::south::<H, BITS>(z + I8::splat(OCTAVE_SHIFT[OCTAVE].1)))
}

/// Heights of some vertices, units.
#[inline(always)]
fn vertices<H: Hash, const FINE: usize>(node: Node, columns: &Axes, rows: &Axes) -> I8 {
    let mut fine = F8::splat(0.0);
    // Spelled out: the compiler keeps a loop.
    macro_rules! octave {
        ($octave:literal) => {
            if $octave < FINE {
                let value = noise::value::<H>(&columns[$octave], &rows[$octave]);
                fine = value.mul_add(F8::splat(-16.0 / (1 << $octave) as f32), fine);
            }
        };
    }
    octave!(0);
    octave!(1);
    octave!(2);
    octave!(3);
    octave!(4);
    let raw = fine.mul_add(node.roughness, node.height);
    let low = beach(raw);
    let x = raw.mul_add(F8::splat(0.125), F8::splat(0.25));
    let cliff = smoothstep(x) * F8::splat(34.0);
    let height = (raw + cliff - low).mul_add(node.exposure, low);
    (height * F8::splat(UNITS_PER_METRE as f32)).to_integers()
}

/// Flattens land within 8 m of the sea by the polynomial `r (0.2 + 1.6 r^2 - 0.8 r^4)` of
/// docs/heightfield.md; vectors without such land skip it.
#[inline(always)]
fn beach(raw: F8) -> F8 {
    let (distance, edge) = (raw.abs(), 8.0);
    if !distance.any_below(edge) {
        return raw;
    }
    let r = raw * F8::splat(1.0 / edge);
    let r2 = r * r;
    let slope = r2.mul_add(F8::splat(-0.8), F8::splat(1.6)).mul_add(r2, F8::splat(0.2));
    distance.select_below(F8::splat(edge), raw * slope, raw)
}
