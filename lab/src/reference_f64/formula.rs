//! The formula of the land in any kind of number.

use super::noise::{Cut, FineOctave, Sample, Turned, TurnedNoises, amplitude_m};
use super::real::Real;
use terrain::Octaves;
use terrain::constants::{
    BEACH_M, CLIFF_FOOT_M, CLIFF_M, FINE_OCTAVES, MOUNTAIN_M, RIM_M, SEA_FLOOR_M, SHORE_M, UPLIFT_M,
    WARP_AMPLITUDE_M,
};
use terrain::hash::stream_seed;
use terrain::island::{Archipelago, Lobe};
use terrain::spline::CELL_BITS;

/// A point of the world, and how it meets the lattices.
pub trait Place: Copy {
    /// The numbers that it is computed in.
    type Real: Real;
    /// A fine octave here.
    fn fine(self, octave: &FineOctave) -> Self::Real;
    /// A noise of the base field here.
    fn turned(self, noise: &Turned) -> Sample<Self::Real>;
    /// East and south of a position (units), metres.
    fn beyond(self, centre: (i32, i32)) -> [Self::Real; 2];
    /// Cell of the base lattice.
    fn base(self) -> [Cut<Self::Real>; 2];
    /// The node of a cell of the base lattice.
    fn node(self, cells: [i32; 2]) -> Self;
}

/// Everything that a seed decides.
#[derive(Clone, Copy, Debug)]
pub struct World {
    /// Seeds of the fine octaves.
    pub fine_seeds: [u32; FINE_OCTAVES],
    /// Noises of the base field.
    pub noises: TurnedNoises,
    /// Islands.
    pub archipelago: Archipelago,
    /// Rounds the weights of fine octaves to so many fraction bits: a control.
    pub weight_bits: Option<u32>,
    /// Never uses the spline: a control.
    pub is_direct: bool,
}

/// The base field, and what it follows from.
#[derive(Clone, Copy, Debug)]
pub struct Node<R> {
    /// Height without fine octaves and coasts, metres.
    pub height: R,
    /// Share of the fine octaves.
    pub roughness: R,
    /// Beach (0) or cliff (1).
    pub exposure: R,
}

/// Steps on the way to the base field: where its curves begin and end.
#[derive(Clone, Copy, Debug)]
pub struct Stages<R> {
    /// How much land there is.
    pub mass: R,
    /// The sum that the coast follows, metres.
    pub shore: R,
    /// How flat all octaves are together.
    pub flatness: R,
}

impl World {
    /// The world of a seed.
    pub fn new(world_seed: u64) -> Self {
        Self {
            fine_seeds: std::array::from_fn(|octave| stream_seed(world_seed, octave as u32)),
            noises: TurnedNoises::new(world_seed),
            archipelago: Archipelago::new(world_seed),
            weight_bits: None,
            is_direct: false,
        }
    }

    /// The lobes that can matter to a height at a position (units), nodes of its spline included.
    pub fn lobes(&self, x: i32, z: i32) -> Vec<Lobe> {
        const NEAR: i32 = 2 << CELL_BITS;
        self.archipelago.lobes_near(x - NEAR, z - NEAR, 2 * NEAR as u32)
    }

    /// The height of a place, metres, from the lobes that can matter.
    pub fn height<P: Place>(&self, place: P, lobes: &[Lobe], octaves: Octaves) -> P::Real {
        if lobes.is_empty() {
            return Node::<P::Real>::sea().height;
        }
        let node = if octaves.splined() && !self.is_direct {
            self.splined(place, lobes, octaves.base())
        } else {
            self.node(place, lobes, octaves.base()).0
        };
        coast(node.height + self.fine_sum(place, octaves) * node.roughness, node.exposure)
    }

    /// Sum of the fine octaves, metres.
    pub fn fine_sum<P: Place>(&self, place: P, octaves: Octaves) -> P::Real {
        (0..octaves.fine()).fold(P::Real::of(0.0), |sum, index| {
            let octave = FineOctave { index, seed: self.fine_seeds[index], weight_bits: self.weight_bits };
            sum + P::Real::of(amplitude_m(index)) * place.fine(&octave)
        })
    }

    fn splined<P: Place>(&self, place: P, lobes: &[Lobe], octaves: usize) -> Node<P::Real> {
        let [x, z] = place.base();
        let columns = [-1, 0, 1].map(|east| {
            let rows = [-1, 0, 1]
                .map(|south| self.node(place.node([x.cell + east, z.cell + south]), lobes, octaves).0);
            Node::spline(rows, z.fraction)
        });
        Node::spline(columns, x.fraction)
    }

    /// The base field at a place, directly.
    pub fn node<P: Place>(
        &self,
        place: P,
        lobes: &[Lobe],
        octaves: usize,
    ) -> (Node<P::Real>, Stages<P::Real>) {
        let of = P::Real::of;
        let (mass, height) = self.mass(place, lobes);
        let mut stages = Stages { mass, shore: bare_shore(mass), flatness: of(1.0) };
        if mass.vanishes() {
            return (Node::sea(), stages);
        }
        let exposed = place.turned(&self.noises.exposure).value;
        let exposure = (of(3.0) * exposed - of(1.0 / 32.0)).within(0.0, 1.0);
        let ruggedness = of(0.75) + of(0.5) * exposure;
        let (mut wide_shore, mut relief) = (stages.shore, of(0.0));
        let mut slope = [of(0.0); 2];
        for (index, noise) in self.noises.octaves.iter().enumerate().take(octaves) {
            let Sample { value, gradient } = place.turned(noise);
            let fold = of(if index == 0 { 1.0 } else { 1.5 });
            slope = [0, 1].map(|axis| slope[axis] + fold * gradient[axis]);
            let steepness = slope[0].square() + slope[1].square();
            stages.flatness = (of(1.0) - steepness * of(1.0 / 204.8)).max(of(0.0));
            let damping = stages.flatness.square() * of(0.875) + of(0.125);
            let folded = if index == 0 { value } else { of(0.375) - fold * value.abs() };
            relief = relief + folded * damping * of(1.0 / f64::from(1u32 << index));
            let plain = value * of(f64::from(SHORE_M[index]));
            let added = match index {
                0 | 1 => plain,
                2 => plain * ruggedness,
                _ => plain * ruggedness * window(stages.shore * of(1.0 / 128.0)),
            };
            stages.shore = stages.shore + added;
            if index <= 2 {
                wide_shore = stages.shore;
            }
        }
        let inland = ((wide_shore - of(8.0)) * of(1.0 / 128.0)).within(0.0, 1.0).smoothstep();
        let relief = (of(13.0 / 32.0) + relief * of(1.375)).max(of(0.0)) + of(5.0 / 32.0);
        let mountain = height * inland * relief * of(f64::from(MOUNTAIN_M));
        let floor = of(f64::from(SEA_FLOOR_M));
        let sum = (lowland(stages.shore) + mountain + floor).max(of(0.0));
        let rim = (mass * of(8.0)).min(of(1.0));
        let roughness = {
            let near = window(stages.shore * of(1.0 / 32.0));
            let coast = near * (of(9.0 / 16.0) + of(3.0 / 16.0) * exposure);
            let foot = inland * (of(1.0) - inland);
            let mountain = height * (inland * stages.flatness + of(2.5) * foot);
            (coast + mountain + of(1.0 / 64.0)).min(of(1.0)) * rim
        };
        (Node { height: sum * rim.smoothstep() - floor, roughness, exposure }, stages)
    }

    /// Mass and height that lobes give a place.
    fn mass<P: Place>(&self, place: P, lobes: &[Lobe]) -> (P::Real, P::Real) {
        let of = P::Real::of;
        let warp = |axis: usize| {
            [0, 1].into_iter().fold(of(0.0), |sum, width| {
                let noise = place.turned(&self.noises.warp[2 * width + axis]);
                sum + of(f64::from(WARP_AMPLITUDE_M[width])) * noise.value
            })
        };
        let warp = [warp(0), warp(1)];
        let (mut mass_left, mut height_left) = (of(1.0), of(1.0));
        for lobe in lobes {
            let beyond = place.beyond(lobe.centre);
            let place = [beyond[0] + warp[0], beyond[1] + warp[1]];
            let along = |axis: (i32, i32)| {
                let per_metre = |part: i32| of(f64::from(part) / 2f64.powi(38));
                (place[0] * per_metre(axis.0) + place[1] * per_metre(axis.1)).square()
            };
            let u = (of(1.0) - along(lobe.long) - along(lobe.short)).max(of(0.0));
            if u.vanishes() {
                continue;
            }
            let s = u.square();
            let [first, second] = [lobe.mass.0, lobe.mass.1].map(|part| of(f64::from(part) / 8.0));
            let mass = (s * (first + second * s)).within(0.0, 1.0);
            mass_left = mass_left * (of(1.0) - mass);
            let mut top = (s * of(f64::from(1u32 << lobe.plateau))).min(of(1.0));
            if lobe.crater {
                let w = (u - of(15.0 / 16.0)).max(of(0.0)) * of(16.0);
                top = top - w.square() * of(7.0 / 16.0);
            }
            height_left = height_left * (of(1.0) - top * of(f64::from(lobe.height) / 256.0));
        }
        (of(1.0) - mass_left, of(1.0) - height_left)
    }
}

impl<R: Real> Node<R> {
    /// The open sea.
    fn sea() -> Self {
        Self { height: -R::of(f64::from(SEA_FLOOR_M)), roughness: R::of(0.0), exposure: R::of(0.0) }
    }

    fn spline(nodes: [Self; 3], t: R) -> Self {
        Self {
            height: R::spline(nodes.map(|node| node.height), t),
            roughness: R::spline(nodes.map(|node| node.roughness), t),
            exposure: R::spline(nodes.map(|node| node.exposure), t),
        }
    }
}

/// The shore without noise, metres.
fn bare_shore<R: Real>(mass: R) -> R {
    let rim = R::of(1.0) - (mass * R::of(8.0)).min(R::of(1.0));
    let middle = (mass - R::of(0.625)).max(R::of(0.0));
    middle.square() * R::of(f64::from(UPLIFT_M)) - rim.square() * R::of(f64::from(RIM_M))
}

/// Height of the land below the mountains, metres.
fn lowland<R: Real>(shore: R) -> R {
    let near = shore.within(0.0, 32.0);
    let sea = shore.min(R::of(0.0));
    shore * R::of(1.0 / 32.0) + sea * R::of(0.5) + near * R::of(0.5) - near.square() * R::of(1.0 / 128.0)
}

/// `(1 - x²)²` within ±1, 0 outside.
fn window<R: Real>(x: R) -> R {
    (R::of(1.0) - x.within(-1.0, 1.0).square()).square()
}

/// The height of a point, metres, from the height without coasts and the exposure.
fn coast<R: Real>(raw: R, exposure: R) -> R {
    let beach_m = R::of(f64::from(BEACH_M));
    let low = (raw * R::of(1.0 / f64::from(BEACH_M))).beach() * beach_m;
    let above_foot = raw + R::of(f64::from(CLIFF_FOOT_M));
    let rise = (above_foot * R::of(1.0 / f64::from(BEACH_M))).within(0.0, 1.0).smoothstep();
    R::lerp(low, raw + rise * R::of(f64::from(CLIFF_M)), exposure)
}
