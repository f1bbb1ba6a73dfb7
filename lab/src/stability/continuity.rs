//! Continuity: every step across every line of interest, against the analytic bound and against the
//! reference, with all octaves and as a coarse level draws it, without a spline.
//!
//! The same sweep runs over the integers, which must hold, and over fields that must not: it takes
//! any height function.

use super::bounds::{HEIGHT_ERROR, Local, height_near};
use super::check::{self, Check};
use super::samples::{self, VERTEX_STEP, Walk};
use super::{edges, thresholds};
use crate::reference_f64::formula::World;
use crate::sample;
use rayon::prelude::*;
use terrain::Octaves;
use terrain::constants::{UNITS_PER_METRE, WORLD_HALF};

/// Unit steps walked from each corner of the world along each way inwards.
const CORNER_STEPS: i32 = 600;

/// The finest level whose vertices evaluate the base field themselves.
const DIRECT_LEVEL: u8 = 5;

/// Position (units) and octaves to height (units).
pub type Heights = Box<dyn Fn(i32, i32, Octaves) -> f64>;

/// The checks of a sweep.
const NAMES: [&str; 7] = [
    "steps of one unit within the slope bound",
    "steps of one vertex (2 m) within the slope bound",
    "vertices within 1/128 m of f64",
    "points between vertices within 1/128 m of f64",
    "open sea exactly flat",
    "steps of one unit without a spline within the slope bound",
    "points without a spline within 1/128 m of f64",
];

/// Results of the sweep of one world.
struct Sweep {
    world: World,
    /// By [`NAMES`].
    checks: [Check; NAMES.len()],
}

/// Sweeps worlds with a height function of their seed.
pub fn sweep(seeds: &[u64], heights: impl Fn(u64) -> Heights + Sync) -> Vec<Check> {
    let found = seeds.into_par_iter().map(|seed| {
        let mut sweep = Sweep { world: World::new(*seed), checks: NAMES.map(Check::new) };
        sweep.run(*seed, &*heights(*seed));
        Vec::from(sweep.checks)
    });
    let found: Vec<_> = found.collect();
    found.into_iter().fold(NAMES.map(Check::new).into(), check::merged)
}

impl Sweep {
    fn run(&mut self, seed: u64, height: &dyn Fn(i32, i32, Octaves) -> f64) {
        let (archipelago, stream) = (self.world.archipelago, (seed ^ (seed >> 32)) as u32);
        let lines = samples::lines();
        let lines = lines.iter().flat_map(|line| line.walks(&archipelago, stream));
        let others = edges::walks(seed).into_iter().chain(thresholds::walks(seed));
        for walk in lines.chain(samples::corner_walks(CORNER_STEPS)).chain(others) {
            self.walk(walk, height);
        }
        for from in sample::land_vertices(seed, 2_000, 31).filter(|(x, _)| *x < WORLD_HALF) {
            self.walk(Walk { from, axis: 0, step: VERTEX_STEP, count: 1 }, height);
            self.walk(Walk { from, axis: 0, step: 1, count: 1 }, height);
        }
    }

    fn walk(&mut self, walk: Walk, height: &dyn Fn(i32, i32, Octaves) -> f64) {
        self.walk_keeping(walk, Octaves::ALL, height);
        if walk.step == 1 {
            self.walk_keeping(walk, Octaves::at_level(DIRECT_LEVEL), height);
        }
    }

    fn walk_keeping(&mut self, walk: Walk, octaves: Octaves, height: &dyn Fn(i32, i32, Octaves) -> f64) {
        let mut before: Option<((i32, i32), f64, Local)> = None;
        for (x, z) in walk.points() {
            let got = height(x, z, octaves);
            let near = height_near(&self.world, (x, z), walk.axis, walk.step, octaves);
            let is_vertex = x % VERTEX_STEP == 0 && z % VERTEX_STEP == 0;
            let exact = near.value * f64::from(UNITS_PER_METRE);
            let check = if !octaves.splined() { 6 } else { 3 - usize::from(is_vertex) };
            self.checks[check].expect_within((got - exact).abs(), HEIGHT_ERROR, format_args!("({x}, {z})"));
            if let Some((from, low, lower)) = before {
                let place = format_args!("({}, {}) to ({x}, {z})", from.0, from.1);
                let (rise, slope) = ((got - low).abs(), lower.slope.max(near.slope));
                let allowed = slope * f64::from(walk.step) + 2.0 * HEIGHT_ERROR;
                let (check, allowed) = match slope == 0.0 {
                    true => (4, 0.0),
                    false if !octaves.splined() => (5, allowed),
                    false => (usize::from(walk.step != 1), allowed),
                };
                self.checks[check].expect_within(rise, allowed, place);
            }
            before = Some(((x, z), got, near));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::{Land, Position};

    fn integers(seed: u64) -> Heights {
        let land = Land::new(seed);
        Box::new(move |x, z, octaves| f64::from(land.height_keeping(Position::new(x, z).unwrap(), octaves)))
    }

    #[test]
    fn the_land_is_continuous_across_every_line() {
        let checks = sweep(&[0, 1 << 63], integers);
        for check in &checks {
            assert!(check.holds() && check.cases > 5_000, "{check:?}");
        }
    }

    #[test]
    fn a_step_of_ten_units_along_one_lattice_line_is_caught() {
        let torn = |seed| -> Heights {
            let whole = integers(seed);
            let line = (1 << 18) - terrain::constants::OCTAVE_SHIFT[0].0;
            Box::new(move |x, z, octaves| whole(x, z, octaves) + if x >= line { 10.0 } else { 0.0 })
        };
        let checks = sweep(&[0], torn);
        assert!(!checks[0].holds() && !checks[5].holds(), "{checks:?}");
    }

    #[test]
    fn an_error_of_three_units_at_one_border_is_caught() {
        let bent = |seed| -> Heights {
            let whole = integers(seed);
            Box::new(move |x, z, octaves| whole(x, z, octaves) + if x == -WORLD_HALF { 3.0 } else { 0.0 })
        };
        let checks = sweep(&[0], bent);
        assert!(!checks[2].holds(), "{checks:?}");
    }
}
