//! Continuity: every step across every line of interest, against the analytic bound and against the
//! reference.
//!
//! The same sweep runs over the integers, which must hold, and over fields that must not: it takes
//! any height function.

use super::bounds::{HEIGHT_ERROR, land_slope};
use super::check::Check;
use super::samples::{self, Step, VERTEX_STEP};
use crate::reference_f64::{ReferenceF64, falloff};
use crate::sample;
use rayon::prelude::*;
use std::collections::HashMap;
use terrain::Octaves;
use terrain::constants::{UNITS_PER_METRE, WORLD_HALF};
use terrain::island::{Archipelago, Island};

/// Unit steps walked from each corner of the world along each way inwards.
const CORNER_STEPS: i32 = 600;

/// What the sweep of one world found.
struct Sweep {
    archipelago: Archipelago,
    reference: ReferenceF64,
    /// Slope bounds by island radius, which decides the dome as well but for the home island, whose
    /// radius is its own.
    slopes: HashMap<i32, f64>,
    unit_steps: Check,
    vertex_steps: Check,
    at_vertices: Check,
    between_vertices: Check,
    open_sea: Check,
}

/// Sweeps worlds of the seeds `0..worlds` with a height function: seed and position (units) to
/// height (units).
pub fn sweep(worlds: u32, height: impl Fn(u64) -> Box<dyn Fn(i32, i32) -> f64> + Sync) -> Vec<Check> {
    let found: Vec<Sweep> = (0..u64::from(worlds))
        .into_par_iter()
        .map(|seed| {
            let mut sweep = Sweep::new(seed);
            sweep.run(seed as u32, &*height(seed));
            sweep
        })
        .collect();
    let mut checks = Sweep::new(0).into_checks();
    for sweep in found {
        checks = checks.into_iter().zip(sweep.into_checks()).map(|(all, one)| all.merged(one)).collect();
    }
    checks
}

impl Sweep {
    fn new(seed: u64) -> Self {
        Self {
            archipelago: Archipelago::new(seed),
            reference: ReferenceF64::new(seed),
            slopes: HashMap::new(),
            unit_steps: Check::new("steps of one unit within the slope bound"),
            vertex_steps: Check::new("steps of one vertex (2 m) within the slope bound"),
            at_vertices: Check::new("vertices within 1/128 m of f64"),
            between_vertices: Check::new("points between vertices within 1/128 m of f64"),
            open_sea: Check::new("open sea exactly flat"),
        }
    }

    fn into_checks(self) -> Vec<Check> {
        vec![self.unit_steps, self.vertex_steps, self.at_vertices, self.between_vertices, self.open_sea]
    }

    fn run(&mut self, stream: u32, height: &dyn Fn(i32, i32) -> f64) {
        let (archipelago, lines) = (self.archipelago, samples::lines());
        for step in lines.iter().flat_map(|line| line.steps(&archipelago, stream)) {
            self.try_step(step, height);
        }
        for step in samples::corner_walks(CORNER_STEPS) {
            self.try_step(step, height);
        }
        for (x, z) in sample::land_vertices(u64::from(stream), 2_000, 31).filter(|(x, _)| *x < WORLD_HALF) {
            self.try_step(Step { from: (x, z), to: (x + VERTEX_STEP, z) }, height);
            self.try_step(Step { from: (x, z), to: (x + 1, z) }, height);
        }
    }

    fn try_step(&mut self, step: Step, height: &dyn Fn(i32, i32) -> f64) {
        let Step { from, to } = step;
        let length = to.0 - from.0 + to.1 - from.1;
        let place = || format!("({}, {}) to ({}, {})", from.0, from.1, to.0, to.1);
        let (low, high) = (height(from.0, from.1), height(to.0, to.1));
        for ((x, z), got) in [(from, low), (to, high)] {
            let reference = self.reference.height_m(x, z, Octaves::ALL) * f64::from(UNITS_PER_METRE);
            let is_vertex = x % VERTEX_STEP == 0 && z % VERTEX_STEP == 0;
            let check = if is_vertex { &mut self.at_vertices } else { &mut self.between_vertices };
            check.expect_within((got - reference).abs(), HEIGHT_ERROR, format_args!("({x}, {z})"));
        }
        let slope = self.slope_at(from).max(self.slope_at(to));
        let rise = (high - low).abs();
        if slope == 0.0 {
            self.open_sea.expect_within(rise, 0.0, place());
            return;
        }
        let check = if length == 1 { &mut self.unit_steps } else { &mut self.vertex_steps };
        check.expect_within(rise, slope * f64::from(length) + 2.0 * HEIGHT_ERROR, place());
    }

    /// The slope bound at a point: that of its island, 0 where there is none.
    fn slope_at(&mut self, (x, z): (i32, i32)) -> f64 {
        match self.archipelago.island_at(x, z) {
            Some(island) if falloff(&island, x, z) > 0.0 => self.slope_of(&island),
            _ => 0.0,
        }
    }

    fn slope_of(&mut self, island: &Island) -> f64 {
        *self.slopes.entry(island.radius_m).or_insert_with(|| land_slope(island))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::{Land, Position};

    fn integers(seed: u64) -> Box<dyn Fn(i32, i32) -> f64> {
        let land = Land::new(seed);
        Box::new(move |x, z| f64::from(land.height_at(Position::new(x, z).unwrap())))
    }

    #[test]
    fn the_land_is_continuous_across_every_line() {
        let checks = sweep(2, integers);
        for check in &checks {
            assert!(check.holds() && check.cases > 10_000, "{check:?}");
        }
    }

    #[test]
    fn a_step_of_ten_units_along_one_lattice_line_is_caught() {
        let torn = |seed| -> Box<dyn Fn(i32, i32) -> f64> {
            let whole = integers(seed);
            let line = (1 << 18) - terrain::constants::OCTAVE_SHIFT[0].0;
            Box::new(move |x, z| whole(x, z) + if x >= line { 10.0 } else { 0.0 })
        };
        let checks = sweep(1, torn);
        assert!(!checks[0].holds(), "{checks:?}");
    }

    #[test]
    fn an_error_of_three_units_at_one_border_is_caught() {
        let bent = |seed| -> Box<dyn Fn(i32, i32) -> f64> {
            let whole = integers(seed);
            Box::new(move |x, z| whole(x, z) + if x == -WORLD_HALF { 3.0 } else { 0.0 })
        };
        let checks = sweep(1, bent);
        assert!(!checks[2].holds(), "{checks:?}");
    }
}
