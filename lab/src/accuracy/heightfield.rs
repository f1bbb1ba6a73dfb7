//! The bars of the heightfield: integers within 1/128 m of the formula in f64, slopes within 0.2
//! degrees.

use super::errors::{compare, exact, integers};
use crate::reference_f64::ReferenceF64;
use crate::sample;
use crate::stats::Figures;
use serde::Serialize;
use std::fmt;
use terrain::{Land, Octaves};

/// Largest allowed distance from the formula, metres.
pub const HEIGHT_BAR_M: f64 = 1.0 / 128.0;

/// Largest allowed angle between the normals of central differences, degrees.
pub const SLOPE_BAR_DEG: f64 = 0.2;

const CONTROL_POINTS: u32 = 20_000;

/// Errors over one set of points.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The comparison, and its place.
    pub what: &'static str,
    /// Height errors, metres.
    pub height_m: Figures,
    /// Slope errors, degrees.
    pub slope_deg: Figures,
}

/// All sets of points, and the controls.
#[derive(Clone, Debug, Serialize)]
pub struct Headline {
    /// Must hold both bars.
    pub rows: Vec<Row>,
    /// Must miss at least one.
    pub controls: Vec<Row>,
}

/// Compares integers and reference over so many points of each kind.
pub fn measure(world_seed: u64, points: u32) -> Headline {
    let (land, reference) = (Land::new(world_seed), ReferenceF64::new(world_seed));
    let got = integers(land, Octaves::ALL);
    let exact = exact(reference);
    let row = |what, places: Vec<(i32, i32)>| {
        let (height_m, slope_deg) = compare(&got, &exact, &places);
        Row { what, height_m, slope_deg }
    };
    let rows = vec![
        row("land, vertices", sample::land_vertices(world_seed, points, 1).collect()),
        row("land, between vertices", sample::land_points(world_seed, points, 2).collect()),
        row("near coasts", sample::coast_points(world_seed, points, 5).collect()),
        row("world borders", sample::border_points(world_seed, points, 6).collect()),
        row("all of the world", sample::world_points(points, 3).collect()),
    ];
    let places: Vec<_> = sample::land_vertices(world_seed, CONTROL_POINTS, 4).collect();
    let sixteenth = |x, z| (got(x, z) * 16.0).round() / 16.0;
    let [coarse, direct] = [reference.with_coarse_weights(10), reference.without_spline()];
    let q10 = |x, z| coarse.height_m(x, z, Octaves::ALL);
    let unsplined = |x, z| direct.height_m(x, z, Octaves::ALL);
    let control = |what, (height_m, slope_deg)| Row { what, height_m, slope_deg };
    let controls = vec![
        control("heights rounded to 1/16 m", compare(&sixteenth, &exact, &places)),
        control("weights rounded to Q10", compare(&q10, &exact, &places)),
        control("base field without its spline", compare(&unsplined, &exact, &places)),
        control("the world of another seed", {
            let other = integers(Land::new(world_seed ^ 1), Octaves::ALL);
            compare(&other, &exact, &places)
        }),
    ];
    Headline { rows, controls }
}

impl Row {
    fn holds(&self) -> bool {
        // False for values that are not a number.
        self.height_m.max <= HEIGHT_BAR_M && self.slope_deg.max <= SLOPE_BAR_DEG
    }
}

impl Headline {
    /// Whether all rows hold the bars and no control does.
    ///
    /// # Errors
    /// One line with the first that does not.
    pub fn verdict(&self) -> Result<(), String> {
        if let Some(row) = self.rows.iter().find(|row| !row.holds()) {
            return Err(format!(
                "`{}` is {:.5} m and {:.3} degrees from the formula: allowed are {HEIGHT_BAR_M:.5} m and \
                 {SLOPE_BAR_DEG} degrees",
                row.what, row.height_m.max, row.slope_deg.max
            ));
        }
        match self.controls.iter().find(|control| control.holds()) {
            Some(control) => {
                Err(format!("the control `{}` holds the bars: the comparison detects nothing", control.what))
            }
            None => Ok(()),
        }
    }
}

impl fmt::Display for Headline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "integers against f64 (bars: {HEIGHT_BAR_M:.5} m, {SLOPE_BAR_DEG} degrees)")?;
        writeln!(
            f,
            "{:<28} {:>9} {:>11} {:>11} {:>13} {:>13}  bars",
            "where", "points", "max, m", "p99, m", "max, degrees", "p99, degrees"
        )?;
        let rows = self.rows.iter().map(|row| (row, ""));
        for (row, prefix) in rows.chain(self.controls.iter().map(|row| (row, "control: "))) {
            let (height, slope) = (row.height_m, row.slope_deg);
            writeln!(
                f,
                "{:<28} {:>9} {:>11.5} {:>11.5} {:>13.4} {:>13.4}  {}",
                format!("{prefix}{}", row.what),
                height.count,
                height.max,
                height.p99,
                slope.max,
                slope.p99,
                if row.holds() { "held" } else { "missed" }
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_hold_the_bars_and_every_control_misses_them() {
        let headline = measure(1, 5_000);
        assert!(headline.rows[0].holds(), "{headline}");
        assert!(headline.controls.iter().all(|control| !control.holds()), "{headline}");
    }

    #[test]
    fn no_height_of_the_world_is_beyond_the_bar() {
        let headline = measure(2, 5_000);
        assert_eq!(headline.verdict(), Ok(()), "{headline}");
    }

    #[test]
    fn a_missed_bar_and_a_control_that_holds_are_errors() {
        let good = measure(1, 1_000);
        let held = vec![good.rows[0].clone()];
        let passing = Headline { controls: held.clone(), rows: held };
        assert!(passing.verdict().unwrap_err().contains("detects nothing"));
        let missed = Headline { rows: vec![good.controls[0].clone()], ..good };
        assert!(missed.verdict().unwrap_err().contains("heights rounded"));
    }
}
