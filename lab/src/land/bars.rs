//! The bars of the land's shape.

use super::features;
use bars::Bar;
use bars::figures::{at, fill};
use serde_json::Value;

/// Islands and start places that the bars ask for; fewer measure nothing.
const ISLANDS: f64 = 200.0;
const HOMES: f64 = 1000.0;

/// Every figure beside its bar, controls last.
pub fn rows(report: &Value) -> Vec<Bar> {
    let figure = |path: &str| at(report, path);
    let of_islands = |path: &str| figure(path).filter(|_| figure("land/islands") >= Some(ISLANDS));
    let homes = |path: &str| figure(path).filter(|_| figure("homes/seeds") >= Some(HOMES));
    let [median, cliffs] = ["coast: times a circle's of equal area, median", "coast with a cliff above 10 m"];
    let [p50, p99] = ["slope of land, p50", "slope of land, p99"];
    let (flat, pits) = ("land flatter than 3 degrees", "closed pits per km² of land");
    let (centres, axes) = ("strongest peak between island centres", "gradients within 5 degrees of the axes");
    let mut rows = vec![
        Bar::at_least(median, of_islands("land/coast_ratio/1"), "x", 3.0),
        Bar::reported("coast: the same, lower quartile", of_islands("land/coast_ratio/0"), "x"),
        Bar::reported("coast: the same, upper quartile", of_islands("land/coast_ratio/2"), "x"),
        Bar::at_least(p50, figure("land/slopes/0"), "degrees", 10.0),
        Bar::at_most("slope of land, p50: not above", figure("land/slopes/0"), "degrees", 20.0),
        Bar::reported("slope of land, p90", figure("land/slopes/1"), "degrees"),
        Bar::at_least(p99, figure("land/slopes/2"), "degrees", 45.0),
        Bar::at_least(flat, figure("land/flat"), "%", 12.0),
        Bar::at_most("land flatter than 3 degrees: not above", figure("land/flat"), "%", 35.0),
        Bar::at_most(pits, figure("land/pits_per_km2"), "", 12.0),
        Bar::at_least(cliffs, of_islands("land/cliffs"), "%", 10.0),
        Bar::at_most("coast with a cliff above 10 m: not above", of_islands("land/cliffs"), "%", 40.0),
        Bar::at_least("coast with a beach", of_islands("land/beaches"), "%", 30.0),
        Bar::at_most(centres, figure("centres/peak/height"), "", 0.15),
        Bar::at_most(axes, figure("land/axes"), "x", 1.15),
        Bar::reported("gradients within 5 degrees of the diagonals", figure("land/diagonals"), "x"),
        Bar::none(
            "worlds whose start lacks one of six features",
            homes("homes/all").zip(figure("homes/seeds")).map(|(all, seeds)| seeds - all),
        ),
    ];
    let feature =
        |name: &str| Bar::reported(format!("starts with a {name}"), homes(&format!("homes/{name}")), "");
    rows.extend(features::NAMES.map(feature));
    let control = |what: &str, path: &str, bar: fn(String, Option<f64>, &'static str, f64) -> Bar, limit| {
        bar(format!("{what} (control)"), figure(&format!("controls/{path}")), "", limit)
    };
    rows.extend([
        control("round islands: coast, times a circle's", "cones/coast_ratio/1", Bar::under, 3.0),
        control("an eighth of the height: p50", "low/slopes/0", Bar::under, 10.0),
        control("cones of 25 degrees: p50", "cones/slopes/0", Bar::at_least, 20.0),
        control("an eighth of the height: p99", "low/slopes/2", Bar::under, 45.0),
        control("cones of 25 degrees: flat, %", "cones/flat", Bar::under, 12.0),
        control("an eighth of the height: flat, %", "low/flat", Bar::at_least, 35.0),
        control("noise of 20 m: closed pits", "rough/pits_per_km2", Bar::at_least, 12.0),
        control("cones of 25 degrees: cliffs, %", "cones/cliffs", Bar::under, 10.0),
        control("walls all round: cliffs, %", "tables/cliffs", Bar::at_least, 40.0),
        control("walls all round: beaches, %", "tables/beaches", Bar::under, 30.0),
        control("lattice with a jitter of 10 %: peak", "lattice/height", Bar::at_least, 0.15),
        control("independent centres: peak", "independent/height", Bar::under, 0.15),
        control("waves along an axis: gradients near the axes", "waves/axes", Bar::at_least, 1.15),
        control("a cone as start: with all six features", "featured_cones", Bar::at_most, 0.0),
    ]);
    rows
}

const NOTES: [&str; 6] = [
    "Shape: {land/islands} islands and {land/land_km2:.0} km² of land in {windows} windows of \
     {window_km:.1} km in {seeds} worlds, anywhere; vertices 16 m apart with all octaves. \
     {land/left_out} islands touch the edge of a window and are left out.",
    "Coast: height 0 by marching squares with linear interpolation, {land/coast_km:.0} km; shores of \
     lakes do not count.",
    "Shores: {land/shores/points} points, each {every_m:.0} m of coast; {land/shores/lost} of them had no \
     sea within 24 m of the transect and count as neither.",
    "Centres: {centres/islands} islands of at least 0.05 km², {centres/large_islands} of at least 1 km², in \
     squares of 524 km, one of each world; the strongest peak lies at {centres/peak/lag_km:.1} km \
     (east, south), seen with a spread of {centres/peak/spread_km:.2} km.",
    "Starts: within 3 km, in worlds 0 to {homes/seeds} exclusive; the first without all six: \
     {homes/first_without}.",
    "Time: {seconds:.0} s.",
];

/// How the figures were measured, for the record.
pub fn notes(report: &Value) -> Vec<String> {
    NOTES.map(|sentence| fill(sentence, report)).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn report() -> Value {
        let shape =
            |ratio: f64, slopes: [f64; 3], flat: f64, pits: f64, cliffs: f64, beaches: f64, axes: f64| {
                json!({ "islands": 200, "coast_ratio": [ratio, ratio, ratio], "slopes": slopes, "flat": flat,
                "pits_per_km2": pits, "cliffs": cliffs, "beaches": beaches, "axes": axes, "diagonals": 1.0 })
            };
        let mut homes = json!({ "seeds": 1000, "all": 1000 });
        features::NAMES.iter().for_each(|name| homes[name] = json!(1000));
        json!({
            "land": shape(3.2, [15.0, 30.0, 46.0], 20.0, 6.0, 20.0, 50.0, 1.1),
            "centres": { "peak": { "height": 0.1 } },
            "homes": homes,
            "controls": {
                "cones": shape(1.0, [25.0; 3], 1.0, 0.0, 0.0, 0.0, 1.0),
                "tables": shape(1.0, [0.0; 3], 90.0, 0.0, 99.0, 0.0, 1.0),
                "low": shape(3.2, [2.0, 4.0, 8.0], 80.0, 6.0, 0.0, 90.0, 1.1),
                "rough": shape(3.2, [15.0; 3], 20.0, 300.0, 20.0, 50.0, 1.1),
                "waves": shape(3.2, [15.0; 3], 20.0, 6.0, 20.0, 50.0, 4.0),
                "lattice": { "height": 0.8 },
                "independent": { "height": 0.03 },
                "featured_cones": 0,
            },
        })
    }

    fn missed(report: &Value) -> usize {
        let rows = rows(report);
        assert_eq!(rows.len(), 37);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar_and_an_empty_one_none() {
        assert_eq!(missed(&report()), 0);
        assert_eq!(missed(&Value::Null), 37);
        let names: std::collections::HashSet<_> =
            rows(&Value::Null).into_iter().map(|row| row.name).collect();
        assert_eq!(names.len(), 37, "records find rows by their names");
    }

    #[test]
    fn each_bar_can_be_missed() {
        for (path, value) in [
            ("/land/coast_ratio/1", 2.9),
            ("/land/slopes/0", 9.9),
            ("/land/slopes/0", 20.1),
            ("/land/slopes/2", 44.9),
            ("/land/flat", 11.9),
            ("/land/flat", 35.1),
            ("/land/pits_per_km2", 12.1),
            ("/land/cliffs", 9.9),
            ("/land/cliffs", 40.1),
            ("/land/beaches", 29.9),
            ("/land/axes", 1.16),
            ("/centres/peak/height", 0.16),
            ("/homes/all", 999.0),
            ("/controls/cones/coast_ratio/1", 3.0),
            ("/controls/low/slopes/0", 10.0),
            ("/controls/cones/slopes/0", 19.0),
            ("/controls/low/slopes/2", 45.0),
            ("/controls/cones/flat", 12.0),
            ("/controls/low/flat", 34.0),
            ("/controls/rough/pits_per_km2", 11.0),
            ("/controls/cones/cliffs", 10.0),
            ("/controls/tables/cliffs", 39.0),
            ("/controls/tables/beaches", 30.0),
            ("/controls/lattice/height", 0.14),
            ("/controls/independent/height", 0.15),
            ("/controls/waves/axes", 1.14),
            ("/controls/featured_cones", 1.0),
        ] {
            let mut report = report();
            *report.pointer_mut(path).unwrap() = json!(value);
            assert_eq!(missed(&report), 1, "{path} {value}");
        }
    }

    #[test]
    fn a_shorter_run_measures_no_coast_and_no_starts() {
        for (path, value, expected) in [("/land/islands", 199, 6), ("/homes/seeds", 999, 7)] {
            let mut report = report();
            *report.pointer_mut(path).unwrap() = json!(value);
            assert_eq!(missed(&report), expected, "{path}");
        }
    }
}
