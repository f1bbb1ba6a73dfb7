//! The bars of parallax occlusion mapping.

use crate::report::NEEDS_GPU;
use bars::Bar;
use bars::figures::{at, each, least, list, ratio, text, worst};
use serde_json::Value;

/// Rays of the traversal of each map and angle: at the bar's ten-thousandth 200 are off, known to a
/// seventh.
const RAYS: f64 = 2_000_000.0;

/// Rays of all other marches; fewer cannot show their bar's thousandth.
const OTHER_RAYS: f64 = 200_000.0;

/// Maps times angles.
const CONDITIONS: usize = 24;

/// Maps times mip levels times short travels.
const TRAVELS: usize = 48;

/// Every figure beside its bar.
pub fn rows(pom: &Value) -> Vec<Bar> {
    let of = |path, field| list(pom, path).iter().map(move |row| at(row, field));
    let is_whole = |field, rays| at(pom, field) >= Some(rays) && list(pom, "search").len() == CONDITIONS;
    let (of_traversal, of_others) = (is_whole("rays", RAYS), is_whole("other_rays", OTHER_RAYS));
    let search = |field: &'static str, scale: f64| {
        let is_whole = if field.starts_with("pyramid/") { of_traversal } else { of_others };
        worst(of("search", field)).filter(|_| is_whole).map(|worst| scale * worst)
    };
    let (per_cent, residual) = (|field| search(field, 100.0), |field| search(field, 1024.0));
    let travels = list(pom, "travels");
    let has_travels = at(pom, "other_rays") >= Some(OTHER_RAYS) && travels.len() == TRAVELS;
    // Half of the travels are of either tier.
    let by_tier = |tier, figure: fn(&Value) -> Option<f64>| {
        let is_of_tier = |row: &&Value| text(row, "tier") == Some(tier);
        let rows: Vec<_> = travels.iter().filter(is_of_tier).map(figure).collect();
        (has_travels && rows.len() == TRAVELS / 2).then(|| worst(rows)).flatten()
    };
    let over_flat = |tier| {
        by_tier(tier, |row| ratio(at(row, "auto/mean"), at(row, "flat/mean").filter(|mean| *mean > 0.0)))
    };
    let worst_texels = |tier| by_tier(tier, |row| at(row, "auto/p999"));
    let short = |field| of("travels", field).filter(move |_| has_travels);
    let counted = |path, compared| at(pom, path).filter(|_| at(pom, compared) > Some(0.0));
    let (pixels, words) =
        (|path| counted(path, "pictures/zero_compared"), |path| counted(path, "loops/compared"));
    let line = |field| worst(of("pictures/lines", field));
    let overlap = |field| least(of("pictures/silhouettes", field));
    let cost = |tier| {
        let ratios: Vec<f64> = of("cost", tier).collect::<Option<_>>()?;
        let mean = ratios.iter().map(|ratio| ratio.ln()).sum::<f64>() / CONDITIONS as f64;
        (ratios.len() == CONDITIONS).then(|| mean.exp())
    };
    // A software driver, which runs eight rays in step and pays for every instruction, gives only
    // the ratio.
    let is_software = pom.pointer("/is_software") == Some(&Value::Bool(true));
    vec![
        Bar::at_most(
            "pyramid: rays more than 4 texels off, worst condition",
            per_cent("pyramid/wrong"),
            "%",
            0.01,
        ),
        Bar::reported(
            "the same, upper end of the 95 % interval of the worst condition",
            per_cent("pyramid/wrong_interval/1"),
            "%",
        ),
        Bar::at_most(
            "pyramid: rays off that are no tangents to a feature",
            per_cent("pyramid/wrong_without_excuse"),
            "%",
            0.0,
        ),
        Bar::reported(
            "the same, less than this with 95 % certainty",
            per_cent("pyramid/without_excuse_below"),
            "%",
        ),
        Bar::at_most("automatic tier: rays more than 4 texels off", per_cent("auto/wrong"), "%", 0.1),
        Bar::at_least("64 steps and a secant: the same (control)", per_cent("linear/wrong"), "%", 0.1),
        Bar::at_most(
            "pyramid: residual at p99.9, 1/1024 of the relief",
            residual("pyramid/residual"),
            "",
            1.0,
        ),
        Bar::at_most("automatic tier: the same", residual("auto/residual"), "", 1.0),
        Bar::some("64 steps and a secant: the same (control)", residual("linear/residual")),
        Bar::under(
            "automatic tier, travel 0.6 to 1.9 texels (one offset): mean error over that of a flat texture",
            over_flat("offset"),
            "x",
            1.0,
        ),
        Bar::under(
            "automatic tier, travel 2.1 to 3.9 texels (linear search): the same",
            over_flat("linear"),
            "x",
            1.0,
        ),
        Bar::reported("one offset, error at p99.9, worst", worst_texels("offset"), "texels"),
        Bar::reported("linear search, error at p99.9, worst", worst_texels("linear"), "texels"),
        Bar::at_most(
            "pyramid at these travels: error at p99.9",
            worst(short("traversal/p999")),
            "texels",
            0.01,
        ),
        Bar::at_least(
            "a flat texture: error at p99.9, least (control)",
            least(short("flat/p999")),
            "texels",
            0.1,
        ),
        Bar::at_least(
            "rays that the automatic tier places unlike the pyramid at these travels, least (control)",
            least(short("differing")).map(|share| 100.0 * share),
            "%",
            1.0,
        ),
        Bar::none("no amplitude against flat: differing pixels", pixels("pictures/zero_differing")),
        Bar::some("with amplitude (control)", pixels("pictures/raised_differing")),
        Bar::none("loop forms against each other: differing words", words("loops/differing")),
        Bar::some("another refinement (control)", words("loops/differing_control")),
        Bar::at_most("line of intersection against geometry, p99", line("with_depth"), "px", 1.0),
        Bar::at_least("with the plane's depth (control)", line("without_depth"), "px", 1.0),
        Bar::at_least("silhouette of the shell over geometry's, least", overlap("shell"), "", 0.98),
        Bar::under("without a silhouette (control)", overlap("flat"), "", 0.98),
        Bar::at_most("time of auto over 64 steps without exit, on a GPU", cost("auto"), "x", 0.4)
            .not_measured_if(is_software, NEEDS_GPU),
        Bar::reported("time of auto over 64 steps without exit, mean of all", cost("auto"), "x"),
        Bar::reported("time of 64 steps with exit over the same", cost("early_exit"), "x"),
    ]
}

/// How the figures were measured, for the record.
pub fn notes(pom: &Value) -> Vec<String> {
    let mut notes = vec![
        format!(
            "Search: {RAYS} rays of the traversal and {OTHER_RAYS} of the other marches, of random place and \
             heading, for each of four maps of 512 x 512 texels (smooth hills, bricks, thin posts, ridges of \
             one texel) under 0, 30, 60, 75, 85 and 89 degrees, relief 0.05 tiles high, on the GPU; truth: \
             every cell that the ray crosses, in f64. A tangent clears what it passes, or goes into it, by \
             at most a thousandth of the relief."
        ),
        "Pictures: a plane of cobblestones, 960 x 540, one sample a pixel, against 131,072 displaced \
         triangles; silhouettes from 60, 16 and 5 degrees and three bearings, lines of intersection with a \
         sunken ball from 60, 40, 16 and 5 degrees."
            .into(),
        "Time: 65,536 neighbouring rays of each map and angle, all ways in turn; the geometric mean of all \
         conditions. 64 steps are as far off as the table of the search says."
            .into(),
    ];
    for (path, sentence) in [
        (
            "search",
            "Map {map}, {angle_deg} degrees: pyramid {pyramid/wrong_rays} of {pyramid/rays} rays off, \
             {pyramid/wrong*100:.5} %, 95 % interval {pyramid/wrong_interval*100:.5} %, by batches \
             {pyramid/wrong_of_batches}, {pyramid/fetches:.1} lookups; auto {auto/wrong*100:.4} % off, \
             {auto/fetches:.1} lookups; 64 steps and a secant {linear/wrong*100:.4} % off, \
             {linear/fetches:.1} lookups.",
        ),
        (
            "travels",
            "Map {map}, level {lod}, travel of {texels:.1} texels: automatic tier ({tier}) mean \
             {auto/mean:.4}, p99.9 {auto/p999:.4} texels off; pyramid {traversal/mean:.5}, \
             {traversal/p999:.5}; flat {flat/mean:.4}, {flat/p999:.4}.",
        ),
        (
            "cost",
            "Time over 64 steps without exit, map {map}, {angle_deg} degrees: auto {auto:.2}, pyramid \
             {pyramid:.2}, 64 steps with exit {early_exit:.2}.",
        ),
        (
            "pictures/silhouettes",
            "Silhouette over geometry's from {elevation_deg} degrees: shell {shell:.4}, rectangle \
             {rectangle:.4}, none {flat:.4}.",
        ),
        (
            "pictures/lines",
            "Line of intersection from {elevation_deg} degrees, {pixels} pixels long: {with_depth:.2} px \
             off, with the plane's depth {without_depth:.2} px.",
        ),
    ] {
        notes.extend(each(pom, path, sentence));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn pom() -> Value {
        let score = |wrong: f64, unexcused: f64, residual: f64| {
            json!({ "wrong": wrong, "wrong_interval": [0.0, 2.0 * wrong],
            "wrong_without_excuse": unexcused, "without_excuse_below": 1.5e-6, "residual": residual,
            "fetches": 9.0 })
        };
        let errors = |mean: f64| json!({ "mean": mean, "p999": 3.0 * mean });
        let travel = |tier: &str| {
            json!({ "map": "fbm", "lod": 0, "texels": 1.9, "tier": tier, "auto": errors(0.1),
                "traversal": errors(1e-4), "flat": errors(0.5), "differing": 0.9 })
        };
        let travels: Vec<Value> = ["offset", "linear"].map(travel).into_iter().cycle().take(48).collect();
        let search = json!({ "map": "fbm", "angle_deg": 60.0, "pyramid": score(1e-5, 0.0, 1e-5),
            "auto": score(1e-5, 0.0, 1e-5), "linear": score(0.2, 0.2, 0.1) });
        let cost = json!({ "map": "fbm", "angle_deg": 60.0, "auto": 0.3, "pyramid": 0.3, "early_exit": 0.8 });
        json!({
            "adapter": "hard", "is_software": false, "rays": 2_000_000, "other_rays": 200_000,
                "search": vec![search; 24], "travels": travels, "cost": vec![cost; 24],
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
        assert_eq!(rows.len(), 27);
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
            ("", "rays", 5),
            ("", "other_rays", 11),
            ("", "travels", 7),
            ("/travels/0", "tier", 2),
            ("/travels/0/auto", "mean", 1),
            ("/travels/1/auto", "p999", 1),
            ("/travels/2/flat", "mean", 1),
            ("/travels/2/flat", "p999", 1),
            ("/travels/3/traversal", "p999", 1),
            ("/travels/47", "differing", 1),
            ("/search/3/pyramid", "wrong", 1),
            ("/search/3/pyramid", "wrong_interval", 1),
            ("/search/3/pyramid", "without_excuse_below", 1),
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
        assert_eq!(missed(&Value::Null), 27);
    }

    #[test]
    fn each_bar_can_be_missed_and_fewer_conditions_measure_nothing() {
        for (path, value) in [
            ("/search/23/pyramid/wrong", json!(2e-4)),
            ("/search/23/pyramid/wrong_without_excuse", json!(1e-9)),
            ("/search/0/auto/wrong", json!(2e-3)),
            ("/search/0/auto/residual", json!(2e-3)),
            ("/travels/0/auto/mean", json!(0.5)),
            ("/travels/1/auto/mean", json!(0.6)),
            ("/travels/1/traversal/p999", json!(0.02)),
            ("/travels/1/flat/p999", json!(0.05)),
            ("/travels/1/differing", json!(0.0)),
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
        assert_eq!(missed(&fewer), 9);
        let mut fewer = pom();
        fewer["travels"].as_array_mut().unwrap().pop();
        assert_eq!(missed(&fewer), 7);
    }
}
