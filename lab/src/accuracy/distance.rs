//! Distance from the origin: integers are unaffected, floats lose a bit with every doubling.
//!
//! Only the sum of the fine octaves is compared (no islands), so that every distance counts. Each
//! field has its own reference: for our formula f64 on exact cells; for the `noise` crate in f32
//! coordinates the same in f64 coordinates; for it in f64 coordinates the same whole periods of its
//! lattice (32,768 m) nearer to the origin, which should be equal.

use crate::curve::{Curve, Sheet};
use crate::floats::{FloatLand, NOISE_CRATE_PERIOD_M, TOTAL_M, metres, metres_f32, noise_crate};
use crate::reference_f64::ReferenceF64;
use crate::sample::{unit, word};
use crate::stats::Figures;
use chart::{Panel, log};
use noise::NoiseFn;
use rayon::prelude::*;
use terrain::Octaves;
use terrain::constants::{FINE_BITS, UNITS_PER_METRE, WORLD_HALF};
use terrain::noise::Fbm;

const POINTS: u32 = 20_000;

/// The border of the world, metres.
const BORDER_M: f64 = (WORLD_HALF / UNITS_PER_METRE) as f64;

const DISTANCES_M: [f64; 15] =
    [1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 3e4, 1e5, 3e5, 1e6, 2e6, BORDER_M];

/// Names of the fields in the table and in diagrams.
const FIELDS: [(&str, &str); 4] = [
    ("ours", "ours: fixed point"),
    ("f32", "our formula in f32"),
    ("noise f32", "noise 0.9, coordinates through f32"),
    ("noise f64", "noise 0.9, coordinates in f64"),
];

pub fn measure(world_seed: u64) -> Curve {
    let (fbm, reference, float) =
        (Fbm::new(world_seed), ReferenceF64::new(world_seed), FloatLand::new(world_seed));
    let crate_noise = noise_crate(world_seed as u32);
    let period = NOISE_CRATE_PERIOD_M * UNITS_PER_METRE;
    let row = |(index, distance_m): (usize, f64)| {
        let errors: Vec<[f64; 4]> = points(distance_m, index as u32)
            .into_par_iter()
            .map(|(x, z)| {
                let exact = reference.fractal_sum(x, z, Octaves::ALL);
                let ours = f64::from(fbm.at(x, z, Octaves::ALL)) / f64::from(1i32 << FINE_BITS);
                let f32_m = f64::from(float.fractal_sum(metres_f32(x), metres_f32(z)));
                let in_f64 = crate_noise.get([metres(x), metres(z)]);
                let in_f32 = crate_noise.get([f64::from(metres_f32(x)), f64::from(metres_f32(z))]);
                let home = crate_noise.get([metres(x.rem_euclid(period)), metres(z.rem_euclid(period))]);
                [ours - exact, f32_m - exact, (in_f32 - in_f64) * TOTAL_M, (in_f64 - home) * TOTAL_M]
                    .map(f64::abs)
            })
            .collect();
        let of_field = |field: usize| Figures::of(errors.iter().map(|point| point[field]).collect());
        (distance_m, [0, 1, 2, 3].map(of_field))
    };
    let mut sheet = Sheet::new(
        "distance",
        format!("fine octaves at {POINTS} points per distance, each field against its own reference."),
        DISTANCES_M.into_iter().enumerate().map(row).collect(),
    );
    sheet.column("distance, m", |row| row.0);
    for (field, (name, _)) in FIELDS.into_iter().enumerate() {
        sheet.column(format!("{name} max, m"), |row| row.1[field].max);
        sheet.column(format!("{name} p99, m"), |row| row.1[field].p99);
    }
    let panel = |title, figure| {
        let line = |panel: Panel, (column, name): (&str, &str)| {
            let points = sheet.points("distance, m", &format!("{column} {figure}, m"));
            // A logarithmic axis cannot show zeros.
            let zero = if points.iter().all(|point| point.1 == 0.0) { " (0 everywhere)" } else { "" };
            panel.line(format!("{name}{zero}"), points)
        };
        let empty = Panel::new(title, log("distance from the origin, m"), log("relief error, m"));
        let panel = FIELDS.into_iter().fold(empty, line);
        panel.bound("bar, 1/128 m", [(1.0, 1.0 / 128.0), (4.2e6, 1.0 / 128.0)])
    };
    let panels = vec![
        panel("Largest error against distance", "max"),
        panel("99th percentile against distance", "p99"),
    ];
    let title = "Distance from the origin: relief error of integers and floats";
    Curve { name: "distance", title, tables: vec![sheet.into()], panels }
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
    fn integers_are_as_accurate_at_the_border_and_f32_is_not() {
        let curve = measure(5);
        let table = &curve.tables[0];
        for (distance, error) in table.points("distance, m", "ours max, m") {
            assert!(error < 0.001, "{error} m at {distance} m");
        }
        let f32_errors = table.points("distance, m", "f32 p99, m");
        let (near, far) = (f32_errors[6].1, f32_errors[DISTANCES_M.len() - 1].1);
        assert!(near < 0.001 && far > 0.02, "{near} near, {far} far");
        let in_f64 = table.points("distance, m", "noise f64 max, m");
        assert!(in_f64.iter().all(|point| point.1 < 1e-6), "f64 is fine enough: {in_f64:?}");
    }
}
