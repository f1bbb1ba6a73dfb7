//! The height formula in f64: the reference of the integers.
//!
//! The choices (gradients, islands with their axes and masses) are the land's own integers, through
//! its public hash and archipelago; every number that follows from them is real arithmetic. An f64
//! keeps 52 bits of values below 2,048 m, so its own error is below a nanometre but for the few
//! steps that amplify it. Positions are integers (units), and cells and fractions are cut from them
//! as integers, so the reference is as good at the border of the world as at the origin.
//!
//! Where an integer ends one step below a limit (a share below 1), the reference takes the limit.
//! It follows the integers' choice between the spline of nodes and the field itself. The formula is
//! in [`formula`], its noises in [`noise`]; both take any kind of number ([`real`]), so that
//! [`crate::floats`] and the bounds of the stability sweep follow the same text.

pub mod formula;
pub mod noise;
pub mod real;

pub use noise::{amplitude_m, cell_m};

use formula::{Node, Place, Stages, World};
use noise::{Cut, FineOctave, Sample, Turned};
use terrain::Octaves;
use terrain::constants::{FIRST_CELL_BITS, OCTAVE_SHIFT, UNITS_PER_METRE};
use terrain::spline::CELL_BITS;

/// The land of a seed in f64.
#[derive(Clone, Copy, Debug)]
pub struct ReferenceF64 {
    world: World,
}

/// A position (units), exact.
#[derive(Clone, Copy, Debug)]
pub struct Exact {
    /// East.
    pub x: i32,
    /// South.
    pub z: i32,
}

impl ReferenceF64 {
    /// The reference about a world.
    pub fn new(world_seed: u64) -> Self {
        Self { world: World::new(world_seed) }
    }

    /// The same formula with every weight of the fine octaves rounded to `bits` fraction bits: a
    /// control.
    pub fn with_coarse_weights(self, bits: u32) -> Self {
        Self { world: World { weight_bits: Some(bits), ..self.world } }
    }

    /// The same formula with the base field at every point, never its spline: a control.
    pub fn without_spline(self) -> Self {
        Self { world: World { is_direct: true, ..self.world } }
    }

    /// The formula and its seeds.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The height of a point (units), metres.
    pub fn height_m(&self, x: i32, z: i32, octaves: Octaves) -> f64 {
        self.world.height(Exact { x, z }, &self.world.lobes(x, z), octaves)
    }

    /// The base field of a point (units), directly, and the steps to it.
    pub fn node(&self, x: i32, z: i32, octaves: Octaves) -> (Node<f64>, Stages<f64>) {
        self.world.node(Exact { x, z }, &self.world.lobes(x, z), octaves.base())
    }
}

impl Exact {
    /// Cells and fractions on the lattice of a fine octave.
    pub fn on_fine(self, octave: usize) -> [Cut<f64>; 2] {
        let (shift_x, shift_z) = OCTAVE_SHIFT[octave];
        [(self.x, shift_x), (self.z, shift_z)]
            .map(|(v, shift)| cut(i64::from(v) + i64::from(shift), FIRST_CELL_BITS - octave as u32))
    }

    /// Coordinates on a turned lattice, in `[0, 2^32)`: they wrap.
    pub fn turned_units(self, noise: &Turned) -> [i64; 2] {
        let (x, z) = (i64::from(self.x), i64::from(self.z));
        let turned =
            if noise.is_high { [3 * x - 4 * z, 4 * x + 3 * z] } else { [4 * x - 3 * z, 3 * x + 4 * z] };
        turned.map(|v| (v + i64::from(noise.shift)).rem_euclid(1 << 32))
    }

    /// Cells and fractions on a turned lattice.
    pub fn on_turned(self, noise: &Turned) -> [Cut<f64>; 2] {
        self.turned_units(noise).map(|v| cut(v, noise.bits))
    }
}

impl Place for Exact {
    type Real = f64;

    fn fine(self, octave: &FineOctave) -> f64 {
        octave.at(self.on_fine(octave.index))
    }

    fn turned(self, noise: &Turned) -> Sample<f64> {
        noise.at(self.on_turned(noise))
    }

    fn beyond(self, centre: (i32, i32)) -> [f64; 2] {
        [(self.x, centre.0), (self.z, centre.1)]
            .map(|(v, centre)| (f64::from(v) - f64::from(centre)) / f64::from(UNITS_PER_METRE))
    }

    fn base(self) -> [Cut<f64>; 2] {
        [self.x, self.z].map(|v| cut(v.into(), CELL_BITS))
    }

    fn node(self, [x, z]: [i32; 2]) -> Self {
        let middle = |cell: i32| (cell << CELL_BITS) + (1 << (CELL_BITS - 1));
        Self { x: middle(x), z: middle(z) }
    }
}

/// Cell and fraction of a coordinate on a lattice of cells of `2^bits` units. Both exact.
fn cut(coordinate: i64, bits: u32) -> Cut<f64> {
    let inside = coordinate & ((1 << bits) - 1);
    Cut { cell: (coordinate >> bits) as i32, fraction: inside as f64 / f64::from(1i32 << bits) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;
    use terrain::constants::{FINE_BITS, OCTAVES};
    use terrain::noise::Fbm;
    use terrain::{Land, Position};

    /// Fine units (2^-16 m) to metres.
    fn fine_m(fine: i32) -> f64 {
        f64::from(fine) / f64::from(1i32 << FINE_BITS)
    }

    fn worst(points: impl Iterator<Item = (i32, i32)>, apart: impl Fn(i32, i32) -> f64) -> f64 {
        points.map(|(x, z)| apart(x, z).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn integers_on_vertices_are_within_1_128_m_of_the_reference() {
        let (land, reference) = (Land::new(42), ReferenceF64::new(42));
        let worst = worst(sample::land_vertices(42, 20_000, 7), |x, z| {
            let integer = f64::from(land.height_at(Position::new(x, z).unwrap())) / 256.0;
            integer - reference.height_m(x, z, Octaves::ALL)
        });
        assert!(worst < 1.0 / 128.0, "{worst} m");
        assert!(
            worst > 0.4 / 256.0,
            "{worst} m: less than the last rounding means that nothing was compared"
        );
    }

    #[test]
    fn integers_agree_for_every_octave_count() {
        let (land, reference) = (Land::new(7), ReferenceF64::new(7));
        for octaves in (0..=OCTAVES).map(|count| Octaves::new(count).unwrap()) {
            let worst = worst(sample::land_points(7, 2_000, octaves.count() as u32), |x, z| {
                let integer = land.height_keeping(Position::new(x, z).unwrap(), octaves);
                f64::from(integer) / 256.0 - reference.height_m(x, z, octaves)
            });
            assert!(worst < 1.0 / 128.0, "{octaves:?}: {worst} m");
        }
    }

    #[test]
    fn the_base_field_agrees_before_coasts() {
        let (land, reference) = (Land::new(8), ReferenceF64::new(8));
        let (mut height, mut roughness) = (0.0f64, 0.0f64);
        for (x, z) in sample::land_points(8, 10_000, 3) {
            let got = land.base().at(&reference.world.lobes(x, z), (x, z), 4);
            let (node, _) = reference.node(x, z, Octaves::ALL);
            height = height.max((fine_m(got.height) - node.height).abs());
            roughness = roughness.max((f64::from(got.roughness) / 32768.0 - node.roughness).abs());
        }
        assert!(height < 0.002 && roughness < 0.000_2, "{height} m, roughness {roughness}");
        assert!(height > 0.000_01, "{height} m would mean that the integers were not looked at");
    }

    #[test]
    fn the_fractal_sum_agrees_for_every_octave_count() {
        let (fbm, reference) = (Fbm::new(3), ReferenceF64::new(3));
        for octaves in (0..=OCTAVES).map(|count| Octaves::new(count).unwrap()) {
            let worst = worst(sample::world_points(2_000, octaves.count() as u32), |x, z| {
                fine_m(fbm.at(x, z, octaves)) - reference.world.fine_sum(Exact { x, z }, octaves)
            });
            assert!(worst < 0.001, "{octaves:?}: {worst} m");
        }
    }

    #[test]
    fn controls_and_another_seed_are_far_from_the_reference() {
        let reference = ReferenceF64::new(42);
        let apart = |other: ReferenceF64| {
            worst(sample::land_vertices(42, 2_000, 9), |x, z| {
                reference.height_m(x, z, Octaves::ALL) - other.height_m(x, z, Octaves::ALL)
            })
        };
        assert!(apart(reference.with_coarse_weights(10)) > 1.0 / 128.0);
        assert!(apart(reference.without_spline()) > 1.0);
        assert!(apart(ReferenceF64::new(43)) > 10.0);
        assert!(apart(reference) == 0.0);
    }
}
