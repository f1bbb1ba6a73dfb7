//! Distance from the origin: integers know none, floats lose a bit with every doubling.
//!
//! Relief alone is compared (no islands), so that every place of the world counts. Each field has
//! its own truth: for our formula f64 on exact cells; for the `noise` crate in f32 coordinates
//! itself in f64 coordinates; for it in f64 coordinates itself one or more periods of its lattice
//! (262,144 m) nearer to the origin, where a perfect one would be equal.

use super::Curve;
use super::errors::Figures;
use crate::chart::{Panel, log, measured, stated};
use crate::floats::{FloatLand, RIVAL_PERIOD_M, metres, metres_f32, noise_crate};
use crate::sample::{unit, word};
use crate::table::Table;
use crate::truth::Truth;
use noise::NoiseFn;
use rayon::prelude::*;
use terrain::Octaves;
use terrain::constants::{FINE_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::noise::Fbm;

/// Points at each distance.
const POINTS: u32 = 20_000;

/// Distances, metres; the last is the border of the world.
const DISTANCES_M: [f64; 15] = [
    1.0,
    3.0,
    10.0,
    30.0,
    100.0,
    300.0,
    1e3,
    3e3,
    1e4,
    3e4,
    1e5,
    3e5,
    1e6,
    2e6,
    (WORLD_HALF / UNITS_PER_METRE) as f64,
];

/// Sum of the amplitudes, metres: scale of the `noise` crate's result.
const TOTAL_M: f64 = 255.0;

/// Measures all distances.
#[must_use]
pub fn measure(world_seed: u64) -> Curve {
    let (fbm, truth, float) = (Fbm::new(world_seed), Truth::new(world_seed), FloatLand::new(world_seed));
    let crate_noise = noise_crate(world_seed as u32);
    let period = RIVAL_PERIOD_M * UNITS_PER_METRE;
    let mut table = Table::new(
        "distance",
        format!("relief of 8 octaves at {POINTS} points per distance, each field against its own truth."),
        &[
            "distance, m",
            "ours max, m",
            "ours p99, m",
            "f32 max, m",
            "f32 p99, m",
            "noise f32 max, m",
            "noise f32 p99, m",
            "noise f64 max, m",
            "noise f64 p99, m",
        ],
    );
    for (index, distance_m) in DISTANCES_M.into_iter().enumerate() {
        let errors: Vec<[f64; 4]> = points(distance_m, index as u32)
            .into_par_iter()
            .map(|(x, z)| {
                let exact = truth.relief(x, z, Octaves::ALL).hills_m;
                let ours = f64::from(fbm.at(x, z, Octaves::ALL).hills) / f64::from(1i32 << FINE_BITS);
                let f32_m = f64::from(float.relief(metres_f32(x), metres_f32(z)).0);
                let in_f64 = crate_noise.get([metres(x), metres(z)]);
                let in_f32 = crate_noise.get([f64::from(metres_f32(x)), f64::from(metres_f32(z))]);
                let home = crate_noise.get([metres(x.rem_euclid(period)), metres(z.rem_euclid(period))]);
                [ours - exact, f32_m - exact, (in_f32 - in_f64) * TOTAL_M, (in_f64 - home) * TOTAL_M]
                    .map(f64::abs)
            })
            .collect();
        let mut row = vec![distance_m];
        for field in 0..4 {
            let figures = Figures::of(errors.iter().map(|of_point| of_point[field]).collect());
            row.extend([figures.max, figures.p99]);
        }
        table.push(row);
    }
    let curve = |y: &str| table.curve("distance, m", y);
    let series = |suffix: &str| {
        let name = |field: &str| format!("{field} {suffix}, m");
        vec![
            measured("ours: fixed point", curve(&name("ours"))),
            measured("our formula in f32", curve(&name("f32"))),
            measured("noise 0.9, coordinates through f32", curve(&name("noise f32"))),
            measured(
                format!("noise 0.9, coordinates in f64{}", all_zero(&curve(&name("noise f64")))),
                curve(&name("noise f64")),
            ),
            stated("bar, 1/128 m", [(1.0, 1.0 / 128.0), (4.2e6, 1.0 / 128.0)]),
        ]
    };
    let panel = |title, suffix| Panel {
        title,
        x: log("distance from the origin, m"),
        y: log("relief error, m"),
        series: series(suffix),
    };
    let panels = vec![
        panel("Largest error against distance", "max"),
        panel("99th percentile against distance", "p99"),
    ];
    Curve {
        name: "distance",
        title: "Distance from the origin: relief error of integers and floats",
        tables: vec![table],
        panels,
    }
}

/// What a legend says about a curve that a logarithmic axis cannot show.
fn all_zero(curve: &[(f64, f64)]) -> &'static str {
    if curve.iter().all(|point| point.1 == 0.0) { " (0 everywhere)" } else { "" }
}

/// Points (units) in a square ring: one axis within 20 % of the distance, the other anywhere up to
/// it, both signs.
fn points(distance_m: f64, stream: u32) -> Vec<(i32, i32)> {
    let distance = distance_m * f64::from(UNITS_PER_METRE);
    (0..POINTS)
        .map(|n| {
            let words: [u32; 3] = std::array::from_fn(|part| word(0xd157 + stream, 3 * n + part as u32));
            let far = (distance * (0.8 + 0.2 * unit(words[0]))) as i32;
            let free = (distance * (2.0 * unit(words[1]) - 1.0)) as i32;
            let far = if words[2] & 1 == 0 { far } else { -far };
            if words[2] & 2 == 0 { (far, free) } else { (free, far) }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_as_good_at_the_border_as_at_home_and_f32_is_not() {
        let curve = measure(5);
        let table = &curve.tables[0];
        for (distance, error) in table.curve("distance, m", "ours max, m") {
            assert!(error < 0.002, "{error} m at {distance} m");
        }
        let f32_errors = table.curve("distance, m", "f32 p99, m");
        let (near, far) = (f32_errors[6].1, f32_errors[DISTANCES_M.len() - 1].1);
        assert!(near < 0.001 && far > 0.05, "{near} near, {far} far");
        let in_f64 = table.curve("distance, m", "noise f64 max, m");
        assert!(in_f64.iter().all(|point| point.1 < 1e-6), "f64 is fine enough: {in_f64:?}");
    }
}
