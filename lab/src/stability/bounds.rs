//! How steep the land can be near a point: the bound that every step of a sweep is held against.
//!
//! A bound for all of the world would be useless: it would have to assume that the narrowest lobes,
//! the strongest warp and the steepest octaves meet in one place, and allow hundreds of metres per
//! metre. So the formula is evaluated once more by forward-mode differentiation, with the worst
//! case in place of the derivative: a number is a value and a bound of its slope ([`Local`]) along
//! one axis, for every place within the reach `h` of a step (a local Lipschitz constant). Its
//! magnitude there is at most `M = |value| + slope h`.
//!
//! **Rules.** They follow from those of derivatives, with every factor at its largest:
//!
//! ```text
//! a + b                 slope a + slope b
//! a b                   M(a) slope b + M(b) slope a
//! min, max              that of the one taken; the larger where both may be taken within h
//! |a|                   slope a
//! smoothstep(x)         min(1.5, |6x(1 - x)| + 6 h slope x) slope x       (second derivative: 6)
//! beach(r)              min(1.64, B'(r) + 6.4 h slope r) slope r,  B' = 0.2 + 4.8 r² - 4 r⁴
//! a + (b - a) t         (1 - t) slope a + t slope b + M(b - a) slope t,  t at the worse end
//! spline of a, b, c     max(|b - a|, |c - b|) slope t: its derivative lies between both
//! ```
//!
//! **Noise.** With step weights `S0 = 1 - s`, `S1 = s` (quintic fade `s` of the fraction `t` east,
//! `u` south) and unit gradients `g`, noise is
//! `n = sum over corners (i, j) of W g·p` with `W = S_i(t) S_j(u)`, `p = (t - i, u - j)`. Along
//! unit directions `d` and `e`
//!
//! ```text
//! dn/dd    = sum of g·( W_d p + W d )                 <= sum of | W_d p + W d |
//! d²n/dd de = sum of g·( W_de p + W_d e + W_e d )      <= sum of | W_de p + W_d e + W_e d |
//! ```
//!
//! for any gradients. The largest values in a cell, found by a search on a grid and raised by more
//! than the search can have missed (tests), are [`NOISE_SLOPE`], [`NOISE_BEND`] and
//! [`NOISE_TWIST`]. So an octave of amplitude `a` and cell `c` is nowhere steeper than
//! `2.08 a / c`: the fine octaves take that. A noise of the base field takes its slope at the point
//! plus `9.3 h / c` for the way to the end of the step, and its gradient changes by at most
//! `9.3 / c` and `5.4 / c` per metre.
//!
//! **The land.** At levels 0 to 4 the nodes of the base lattice are constants, and the slope of the
//! base field is that of their spline: the largest difference of neighbours over 32 m. At a border
//! of a cell other nodes count; a step of at most one vertex spacing crosses one border of an axis,
//! so the larger bound of its two ends holds. Then
//!
//! ```text
//! raw = height + fine roughness          slope <= height' + M(fine) roughness' + M(roughness) 1.3
//! coast: beach has slope 1.64 at most, a cliff 1 + 1.5 * 34 / 8, and the exposure's slope is
//! multiplied by the distance of both, at most 36 m
//! ```
//!
//! At coarser levels the same rules run through the base field: the warp's chain rule multiplies a
//! lobe's gradient by `1 + warp'`, its mass is a product of complements, and so on. Where the
//! exposure begins, at the rim of the mass, it jumps; there beach and cliff are equal (the land
//! lies 64 m deep), so no height does.
//!
//! **How loose.** Triangle inequalities lose what cancels. On islands the bound is up to 11. The
//! true slope over the bound:
//!
//! | step | median | largest |
//! | --- | --- | --- |
//! | 2 m | 0.24 | 0.92 |
//! | 1 unit | 0.28 | 0.93 |
//! | 1 unit, levels from 5 on, without a spline | 0.22 | 0.98 |
//!
//! A test holds the bound below 15, the median above 0.2 and the largest above 0.9.
//!
//! **A step.** Heights are whole units and within [`HEIGHT_ERROR`] of the formula, so a step of `n`
//! units along an axis changes them by at most `n slope + 2 HEIGHT_ERROR`.

use crate::reference_f64::formula::{Place, World};
use crate::reference_f64::noise::{Cut, FineOctave, Sample, Turned};
use crate::reference_f64::real::Real;
use crate::reference_f64::{Exact, amplitude_m, cell_m};
use std::ops::{Add, Mul, Neg, Sub};
use terrain::Octaves;
use terrain::constants::{FINE_OCTAVES, UNITS_PER_METRE};
use terrain::spline::CELL_BITS;

/// Upper bound of the slope of noise of amplitude 1 and cell 1, along an axis of its lattice or of
/// the world.
pub const NOISE_SLOPE: f64 = 2.08;

/// Upper bound of its second derivative along an axis of the world, for turned lattices.
pub const NOISE_BEND: f64 = 9.3;

/// Upper bound of its mixed second derivative along both axes of the world, for turned lattices.
pub const NOISE_TWIST: f64 = 5.4;

/// How far an integer height may be from the formula, units: the bar of 1/128 m, half a unit of
/// final rounding included.
pub const HEIGHT_ERROR: f64 = 2.0;

/// Slope bound of the sum of the fine octaves, metres per metre.
pub fn fine_slope() -> f64 {
    (0..FINE_OCTAVES).map(|octave| NOISE_SLOPE * amplitude_m(octave) / cell_m(octave)).sum()
}

/// Height (metres) at a position (units), and a bound of its slope along an axis (0 east, 1 south)
/// within `reach` units.
pub fn height_near(world: &World, (x, z): (i32, i32), axis: usize, reach: i32, octaves: Octaves) -> Local {
    let reach_m = f64::from(reach) / f64::from(UNITS_PER_METRE);
    let near = Near { exact: Exact { x, z }, axis, reach_m, speed: 1.0 };
    world.height(near, &world.lobes(x, z), octaves)
}

/// A number at a point with a bound of its slope nearby.
#[derive(Clone, Copy, Debug)]
pub struct Local {
    /// At the point.
    pub value: f64,
    /// Largest change per metre within the reach.
    pub slope: f64,
    /// Metres to either side.
    reach_m: f64,
}

/// A point that moves along one axis.
#[derive(Clone, Copy, Debug)]
struct Near {
    exact: Exact,
    axis: usize,
    reach_m: f64,
    /// 1, or 0 for a node, which does not move.
    speed: f64,
}

impl Near {
    fn local(&self, value: f64, slope: f64) -> Local {
        Local { value, slope: slope * self.speed, reach_m: self.reach_m }
    }

    /// Slope of a coordinate.
    fn along(&self, axis: usize) -> f64 {
        f64::from(u8::from(axis == self.axis))
    }
}

impl Place for Near {
    type Real = Local;

    fn fine(self, octave: &FineOctave) -> Local {
        self.local(self.exact.fine(octave), NOISE_SLOPE / cell_m(octave.index))
    }

    fn turned(self, noise: &Turned) -> Sample<Local> {
        let Sample { value, gradient } = self.exact.turned(noise);
        let cell_m = noise.cell_m();
        // Gradients are five times as long.
        let here = gradient[self.axis].abs() / 5.0;
        let slope = (here + NOISE_BEND * self.reach_m / cell_m).min(NOISE_SLOPE);
        let bend = |axis: usize| if axis == self.axis { NOISE_BEND } else { NOISE_TWIST };
        Sample {
            value: self.local(value, slope / cell_m),
            gradient: [0, 1].map(|axis| self.local(gradient[axis], 5.0 * bend(axis) / cell_m)),
        }
    }

    fn beyond(self, centre: (i32, i32)) -> [Local; 2] {
        let metres = self.exact.beyond(centre);
        [0, 1].map(|axis| self.local(metres[axis], self.along(axis)))
    }

    fn base(self) -> [Cut<Local>; 2] {
        const CELL_M: f64 = ((1 << CELL_BITS) / UNITS_PER_METRE) as f64;
        let cuts = self.exact.base();
        [0, 1].map(|axis| {
            let Cut { cell, fraction } = cuts[axis];
            Cut { cell, fraction: self.local(fraction, self.along(axis) / CELL_M) }
        })
    }

    fn node(self, cells: [i32; 2]) -> Self {
        Self { exact: self.exact.node(cells), speed: 0.0, ..self }
    }
}

impl Local {
    fn new(value: f64, slope: f64, of: [Self; 2]) -> Self {
        Self { value, slope, reach_m: of[0].reach_m.max(of[1].reach_m) }
    }

    /// How far it may be from its value.
    fn change(self) -> f64 {
        self.slope * self.reach_m
    }

    /// Its largest magnitude.
    fn most(self) -> f64 {
        self.value.abs() + self.change()
    }
}

impl Add for Local {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::new(self.value + other.value, self.slope + other.slope, [self, other])
    }
}

impl Neg for Local {
    type Output = Self;

    fn neg(self) -> Self {
        Self { value: -self.value, ..self }
    }
}

impl Sub for Local {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Local {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let slope = self.most() * other.slope + other.most() * self.slope;
        Self::new(self.value * other.value, slope, [self, other])
    }
}

impl Real for Local {
    fn of(value: f64) -> Self {
        Self { value, slope: 0.0, reach_m: 0.0 }
    }

    fn abs(self) -> Self {
        Self { value: self.value.abs(), ..self }
    }

    fn min(self, other: Self) -> Self {
        -(-self).max(-other)
    }

    fn max(self, other: Self) -> Self {
        let lead = self.value - other.value;
        let reach = [self, other];
        if lead.abs() > self.change() + other.change() {
            let taken = if lead > 0.0 { self } else { other };
            return Self::new(taken.value, taken.slope, reach);
        }
        Self::new(self.value.max(other.value), self.slope.max(other.slope), reach)
    }

    fn vanishes(self) -> bool {
        self.most() == 0.0
    }

    fn rounded(self, bits: u32) -> Self {
        Self { value: self.value.rounded(bits), ..self }
    }

    fn smoothstep(self) -> Self {
        let x = self.value;
        let steepest = ((6.0 * x * (1.0 - x)).abs() + 6.0 * self.change()).min(1.5);
        Self { value: x.smoothstep(), slope: steepest * self.slope, ..self }
    }

    fn lerp(a: Self, b: Self, t: Self) -> Self {
        let share = |end: f64| {
            let t = (t.value + end * t.change()).clamp(0.0, 1.0);
            (1.0 - t) * a.slope + t * b.slope
        };
        let slope = share(-1.0).max(share(1.0)) + (b - a).most() * t.slope;
        let value = f64::lerp(a.value, b.value, t.value);
        Self { value, slope, reach_m: a.reach_m.max(b.reach_m).max(t.reach_m) }
    }

    fn spline(nodes: [Self; 3], t: Self) -> Self {
        let [a, b, c] = nodes.map(|node| node.value);
        // Of nodes and fraction only one moves.
        let of_nodes = nodes.iter().fold(0.0, |most: f64, node| most.max(node.slope));
        let slope = (b - a).abs().max((c - b).abs()) * t.slope + of_nodes;
        Self { value: f64::spline([a, b, c], t.value), slope, reach_m: nodes[0].reach_m.max(t.reach_m) }
    }

    fn beach(self) -> Self {
        let (inner, outer) = (self.value.abs() - self.change(), self.value.abs() + self.change());
        let squared = self.value.within(-1.0, 1.0).square();
        let bent = 0.2 + squared * (4.8 - 4.0 * squared) + 6.4 * self.change();
        let steepest = match () {
            () if inner >= 1.0 => 1.0,
            () if outer > 1.0 => bent.clamp(1.0, BEACH_SLOPE),
            () => bent.min(BEACH_SLOPE),
        };
        Self { value: self.value.beach(), slope: steepest * self.slope, ..self }
    }
}

/// Upper bound of the slope of the beach polynomial: `0.2 + 4.8 r² - 4 r⁴` at `r² = 0.6`.
const BEACH_SLOPE: f64 = 1.64;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference_f64::ReferenceF64;
    use crate::reference_f64::noise::{fade, fade_slope};
    use crate::sample;
    use crate::stats::quantiles;

    /// Value, first and second derivative of the two step weights at a fraction.
    fn steps(t: f64) -> [[f64; 3]; 2] {
        let (s, first, second) = (fade(t), fade_slope(t), 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t));
        [[1.0 - s, -first, -second], [s, first, second]]
    }

    /// Bounds of the first derivative along `d` and of the second along `d` and `e` at a place in a
    /// cell.
    fn derivatives(t: f64, u: f64, d: [f64; 2], e: [f64; 2]) -> [f64; 2] {
        let mut sums = [0.0; 2];
        for (j, south) in steps(u).into_iter().enumerate() {
            for (i, east) in steps(t).into_iter().enumerate() {
                let p = [t - i as f64, u - j as f64];
                let along = |d: [f64; 2]| east[1] * south[0] * d[0] + east[0] * south[1] * d[1];
                let both = east[2] * south[0] * d[0] * e[0]
                    + east[1] * south[1] * (d[0] * e[1] + d[1] * e[0])
                    + east[0] * south[2] * d[1] * e[1];
                let weight = east[0] * south[0];
                let length = |part: &dyn Fn(usize) -> f64| part(0).hypot(part(1));
                sums[0] += length(&|n| along(d) * p[n] + weight * d[n]);
                sums[1] += length(&|n| both * p[n] + along(d) * e[n] + along(e) * d[n]);
            }
        }
        sums
    }

    /// The largest of both in a cell.
    fn search(d: [f64; 2], e: [f64; 2]) -> [f64; 2] {
        const STEPS: u32 = 500;
        let places = (0..=STEPS).flat_map(|t| (0..=STEPS).map(move |u| (t, u)));
        let share = |step: u32| f64::from(step) / f64::from(STEPS);
        places.fold([0.0; 2], |worst, (t, u)| {
            let found = derivatives(share(t), share(u), d, e);
            [worst[0].max(found[0]), worst[1].max(found[1])]
        })
    }

    #[test]
    fn no_place_in_a_cell_is_steeper_or_bends_more_than_the_bounds() {
        // Between points of the search both change by less than 10 and 60 a cell along each axis,
        // so it misses less than 0.01 and 0.06 if the largest lies half a step off in both.
        let ([axis, _], [turned, bend], [_, twist]) =
            (search([1.0, 0.0], [1.0, 0.0]), search([0.8, 0.6], [0.8, 0.6]), search([0.8, 0.6], [-0.6, 0.8]));
        assert!(axis.max(turned) + 0.01 < NOISE_SLOPE && bend + 0.06 < NOISE_BEND, "{axis} {turned} {bend}");
        assert!(twist + 0.06 < NOISE_TWIST, "{twist}");
        assert!(axis > 2.06 && bend > 9.1 && twist > 5.2, "bounds far above what exists prove little");
    }

    #[test]
    fn a_height_near_is_the_reference() {
        let reference = ReferenceF64::new(6);
        for (x, z) in sample::land_points(6, 300, 1) {
            for octaves in [Octaves::ALL, Octaves::at_level(5)] {
                let near = height_near(reference.world(), (x, z), 0, 1, octaves);
                assert!((near.value - reference.height_m(x, z, octaves)).abs() < 1e-9);
            }
        }
    }

    /// Median and largest share that the truth's slope over one step has of its bound, and the
    /// largest bound; each truth is asserted to keep its bound.
    fn shares(octaves: Octaves, step: i32) -> ([f64; 2], f64) {
        let (mut shares, mut largest) = (Vec::new(), 0.0f64);
        let reference = ReferenceF64::new(6);
        for (n, (x, z)) in sample::land_points(6, 2_000, 2).enumerate() {
            let axis = n % 2;
            let to = if axis == 0 { (x + step, z) } else { (x, z + step) };
            let [from, end] =
                [(x, z), to].map(|place| height_near(reference.world(), place, axis, step, octaves));
            let slope = (end.value - from.value).abs() * 256.0 / f64::from(step);
            let bound = from.slope.max(end.slope);
            assert!(slope <= bound + 1e-6, "{slope} at ({x}, {z}), allowed {bound}");
            if bound > 0.0 {
                shares.push(slope / bound);
                largest = largest.max(bound);
            }
        }
        (quantiles(shares, [0.5, 1.0]), largest)
    }

    #[test]
    fn the_truth_never_climbs_faster_than_the_bound_and_the_bound_is_not_far_above() {
        for (octaves, step) in [(Octaves::ALL, 1), (Octaves::ALL, 512), (Octaves::at_level(5), 1)] {
            let ([median, worst], largest) = shares(octaves, step);
            assert!(median > 0.2 && worst > 0.9, "{octaves:?}, {step} units: {median}, {worst}");
            assert!(largest < 15.0, "{octaves:?}, {step} units: up to {largest}");
        }
    }
}
