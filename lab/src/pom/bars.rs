//! The bars of parallax occlusion mapping.

use crate::report::{list, number};
use bars::{Bar, Limit, worst};
use serde_json::Value;

/// Rays of each map and angle; fewer cannot show the bar's ten-thousandth.
const RAYS: f64 = 200_000.0;

/// Maps times angles.
const CONDITIONS: usize = 24;

/// Every figure beside its bar.
pub fn rows(pom: &Value) -> Vec<Bar> {
    let at = |path: &str| pom.pointer(path).and_then(Value::as_f64);
    let search = list(pom, "/search");
    let is_whole = at("/rays") >= Some(RAYS) && search.len() == CONDITIONS;
    let of = |tier: &str, field: &str| {
        let figure = |row: &Value| number(row.get(tier)?, field);
        worst(&search.iter().map(figure).collect::<Vec<_>>()).filter(|_| is_whole)
    };
    let per_cent = |tier: &str, field: &str| of(tier, field).map(|share| 100.0 * share);
    let thousandths = |tier: &str| of(tier, "residual").map(|residual| 1024.0 * residual);
    let pixels = at("/pictures/zero_compared").filter(|compared| *compared > 0.0);
    let words = at("/loops/compared").filter(|compared| *compared > 0.0);
    let lines = list(pom, "/pictures/lines");
    let line = |field: &str| worst(&lines.iter().map(|row| number(row, field)).collect::<Vec<_>>());
    let silhouettes = list(pom, "/pictures/silhouettes");
    let overlaps = |field: &str| -> Vec<Option<f64>> {
        silhouettes.iter().map(|row| number(row, field).map(|overlap| -overlap)).collect()
    };
    let least = |field: &str| worst(&overlaps(field)).map(|overlap| -overlap);
    let costs = list(pom, "/cost");
    let cost = |tier: &str| {
        let ratios: Option<Vec<f64>> = costs.iter().map(|row| number(row, tier)).collect();
        ratios
            .filter(|ratios| ratios.len() == CONDITIONS)
            .map(|ratios| ratios.iter().map(|ratio| ratio.ln()).sum::<f64>() / CONDITIONS as f64)
            .map(f64::exp)
    };
    vec![
        Bar::new(
            "pyramid: rays more than 4 texels off, worst condition",
            per_cent("pyramid", "wrong"),
            "%",
            Limit::AtMost(0.01),
        ),
        Bar::new(
            "of these no tangents to a feature",
            per_cent("pyramid", "wrong_without_excuse"),
            "%",
            Limit::AtMost(0.0),
        ),
        Bar::new("automatic tier: the same", per_cent("auto", "wrong"), "%", Limit::AtMost(0.1)),
        Bar::new(
            "64 steps and a secant: the same (control)",
            per_cent("linear", "wrong"),
            "%",
            Limit::AtLeast(0.1),
        ),
        Bar::new(
            "pyramid: residual at p99.9, 1/1024 of the relief",
            thousandths("pyramid"),
            "",
            Limit::AtMost(1.0),
        ),
        Bar::new("automatic tier: the same", thousandths("auto"), "", Limit::AtMost(1.0)),
        Bar::new("64 steps and a secant: the same (control)", thousandths("linear"), "", Limit::AtLeast(1.0)),
        Bar::new(
            "no amplitude against flat: differing pixels",
            at("/pictures/zero_differing").filter(|_| pixels.is_some()),
            "",
            Limit::AtMost(0.0),
        ),
        Bar::new(
            "with amplitude (control)",
            at("/pictures/raised_differing").filter(|_| pixels.is_some()),
            "",
            Limit::AtLeast(1.0),
        ),
        Bar::new(
            "loop forms against each other: differing words",
            at("/loops/differing").filter(|_| words.is_some()),
            "",
            Limit::AtMost(0.0),
        ),
        Bar::new(
            "another refinement (control)",
            at("/loops/differing_control").filter(|_| words.is_some()),
            "",
            Limit::AtLeast(1.0),
        ),
        Bar::new("line of intersection against geometry, p99", line("with_depth"), "px", Limit::AtMost(1.0)),
        Bar::new("with the plane's depth (control)", line("without_depth"), "px", Limit::AtLeast(1.0)),
        Bar::new("silhouette of the shell over geometry's, least", least("shell"), "", Limit::AtLeast(0.98)),
        Bar::new("without a silhouette (control)", least("flat"), "", Limit::Under(0.98)),
        time(pom, cost("auto")),
        Bar::new("time of auto over 64 steps without exit, mean of all", cost("auto"), "x", Limit::Reported),
        Bar::new("time of 64 steps with exit over the same", cost("early_exit"), "x", Limit::Reported),
    ]
}

/// The bar of the time holds on a GPU; a software driver, which runs eight rays in step and pays
/// for every instruction, gives only the ratio below.
fn time(pom: &Value, ratio: Option<f64>) -> Bar {
    let what = "time of auto over 64 steps without exit, on a GPU";
    match pom.get("is_software").and_then(Value::as_bool) {
        Some(true) => Bar::not_measured(what, crate::report::NEEDS_GPU, "x", Limit::Under(0.4)),
        _ => Bar::new(what, ratio, "x", Limit::AtMost(0.4)),
    }
}

/// How the figures were measured, for the record.
pub fn notes(pom: &Value) -> Vec<String> {
    let mut notes = vec![
        format!(
            "Search: {RAYS} rays of random place and heading for each of four maps of 512 x 512 \
            texels (smooth hills, bricks, thin posts, ridges of one texel) under 0, 30, 60, 75, 85 \
            and 89 degrees, relief 0.05 tiles high, on the GPU; truth: every cell that the ray \
            crosses, in f64. A tangent clears what it passes, or goes into it, by at most a \
            thousandth of the relief."
        ),
        "Pictures: a plane of cobblestones, 960 x 540, one sample a pixel, against 131,072 \
         displaced triangles; silhouettes from 60, 16 and 5 degrees and three bearings, lines of \
         intersection with a sunken ball from 60, 40, 16 and 5 degrees."
            .into(),
        "Time: 65,536 neighbouring rays of each map and angle, all ways in turn; the geometric mean \
         of all conditions. 64 steps are as far off as the table of the search says."
            .into(),
    ];
    for row in list(pom, "/search") {
        let of = |tier: &str, field: &str| {
            row.get(tier).and_then(|score| number(score, field)).unwrap_or(f64::NAN)
        };
        let shown = |tier: &str| {
            format!("{:.4} % off, {:.1} lookups", 100.0 * of(tier, "wrong"), of(tier, "fetches"))
        };
        notes.push(format!(
            "Map {}, {} degrees: pyramid {}; auto {}; 64 steps and a secant {}.",
            row.get("map").and_then(Value::as_str).unwrap_or("unknown"),
            number(row, "angle_deg").unwrap_or(f64::NAN),
            shown("pyramid"),
            shown("auto"),
            shown("linear"),
        ));
    }
    for row in list(pom, "/cost") {
        let of = |field: &str| number(row, field).unwrap_or(f64::NAN);
        notes.push(format!(
            "Time over 64 steps without exit, map {}, {} degrees: auto {:.2}, pyramid {:.2}, 64 \
             steps with exit {:.2}.",
            row.get("map").and_then(Value::as_str).unwrap_or("unknown"),
            of("angle_deg"),
            of("auto"),
            of("pyramid"),
            of("early_exit"),
        ));
    }
    for row in list(pom, "/pictures/silhouettes") {
        let of = |field: &str| number(row, field).unwrap_or(f64::NAN);
        notes.push(format!(
            "Silhouette over geometry's from {} degrees: shell {:.4}, rectangle {:.4}, none {:.4}.",
            of("elevation_deg"),
            of("shell"),
            of("rectangle"),
            of("flat"),
        ));
    }
    for row in list(pom, "/pictures/lines") {
        let of = |field: &str| number(row, field).unwrap_or(f64::NAN);
        notes.push(format!(
            "Line of intersection from {} degrees, {} pixels long: {:.2} px off, with the plane's \
             depth {:.2} px.",
            of("elevation_deg"),
            of("pixels"),
            of("with_depth"),
            of("without_depth"),
        ));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn pom() -> Value {
        let score = |wrong: f64, unexcused: f64, residual: f64| {
            json!({ "wrong": wrong,
            "wrong_without_excuse": unexcused, "residual": residual, "fetches": 9.0 })
        };
        let search = json!({ "map": "fbm", "angle_deg": 60.0, "pyramid": score(1e-5, 0.0, 1e-5),
            "auto": score(1e-5, 0.0, 1e-5), "linear": score(0.2, 0.2, 0.1) });
        let cost = json!({ "map": "fbm", "angle_deg": 60.0, "auto": 0.3, "pyramid": 0.3, "early_exit": 0.8 });
        json!({
            "adapter": "hard", "is_software": false, "rays": 200_000, "search": vec![search; 24],
                "cost": vec![cost; 24],
            "loops": { "compared": 9, "differing": 0, "differing_control": 5 },
            "pictures": { "zero_compared": 9, "zero_differing": 0, "raised_differing": 7,
                          "silhouettes": [{ "elevation_deg": 5.0, "shell": 0.99, "rectangle": 0.9,
                              "flat": 0.8 }],
                          "lines": [{ "elevation_deg": 5.0, "pixels": 99, "with_depth": 1.0,
                              "without_depth": 7.0 }] },
        })
    }

    fn missed(pom: &Value) -> usize {
        let rows = rows(pom);
        assert_eq!(rows.len(), 18);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar_and_a_software_driver_has_no_time() {
        assert_eq!(missed(&pom()), 0);
        let mut software = pom();
        software["is_software"] = json!(true);
        assert_eq!(missed(&software), 0);
        assert_eq!(
            rows(&software).iter().filter(|row| row.verdict() == bars::Verdict::NotMeasured).count(),
            1
        );
    }

    #[test]
    fn every_missing_field_is_a_miss() {
        for (path, field, expected) in [
            ("", "rays", 7),
            ("/search/3/pyramid", "wrong", 1),
            ("/search/3/pyramid", "wrong_without_excuse", 1),
            ("/search/0/auto", "residual", 1),
            ("/search/0", "linear", 2),
            ("/pictures", "zero_compared", 2),
            ("/pictures", "zero_differing", 1),
            ("/pictures", "silhouettes", 2),
            ("/pictures/lines/0", "with_depth", 1),
            ("/loops", "compared", 2),
            ("/cost/5", "auto", 2),
            ("/cost/5", "early_exit", 1),
        ] {
            for lost in [None, Some(Value::Null), Some(json!("much"))] {
                let mut pom = pom();
                let fields = pom.pointer_mut(path).unwrap().as_object_mut().unwrap();
                fields.remove(field);
                fields.extend(lost.map(|lost| (field.to_string(), lost)));
                assert_eq!(missed(&pom), expected, "{path} {field}");
            }
        }
        assert_eq!(missed(&Value::Null), 18);
    }

    #[test]
    fn each_bar_can_be_missed_and_fewer_conditions_measure_nothing() {
        for (path, value) in [
            ("/search/23/pyramid/wrong", json!(2e-4)),
            ("/search/23/pyramid/wrong_without_excuse", json!(1e-9)),
            ("/search/0/auto/wrong", json!(2e-3)),
            ("/search/0/auto/residual", json!(2e-3)),
            ("/pictures/zero_differing", json!(1)),
            ("/pictures/raised_differing", json!(0)),
            ("/loops/differing", json!(1)),
            ("/loops/differing_control", json!(0)),
            ("/pictures/silhouettes/0/shell", json!(0.97)),
            ("/pictures/silhouettes/0/flat", json!(0.99)),
            ("/pictures/lines/0/with_depth", json!(1.5)),
            ("/pictures/lines/0/without_depth", json!(0.5)),
        ] {
            let mut pom = pom();
            *pom.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&pom), 1, "{path}");
        }
        let mut slow = pom();
        slow["cost"].as_array_mut().unwrap().iter_mut().for_each(|row| row["auto"] = json!(0.5));
        assert_eq!(missed(&slow), 1);
        let mut fewer = pom();
        fewer["search"].as_array_mut().unwrap().pop();
        assert_eq!(missed(&fewer), 7);
    }
}
