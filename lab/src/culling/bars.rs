//! The bars of vegetation culling.

use crate::culling::gpu_time::CLUMPS;
use bars::figures::{at, each, fill, list, ratio, text, value};
use bars::{Bar, Limit};
use serde_json::Value;

/// Poses that are judged by sight.
const POSES: f64 = 300.0;

/// Poses of each kind among them, at least.
const OF_A_KIND: f64 = 30.0;

/// Kinds of poses, by their field.
const KINDS: [(&str, &str); 4] = [
    ("steep", "pitches of -89 to -12 and 2 to 60 degrees"),
    ("absent_chunks", "chunks absent at random"),
    ("chunk_border", "eye exactly on a border of chunks"),
    ("level_border", "eye exactly on a border of levels"),
];

/// Poses at which the GPU is compared with the twin, at least.
const COMPARED: f64 = 20.0;

/// Every figure beside its bar.
pub fn rows(culling: &Value) -> Vec<Bar> {
    let least = |path, count: f64| at(culling, path) >= Some(count);
    let is_positive = |figure: &f64| *figure > 0.0;
    let is_whole = least("poses", POSES) && least("sight/scenes", 0.99 * POSES);
    let sight = |path: &str| at(culling, &format!("sight/{path}")).filter(|_| is_whole);
    // Of nothing nothing can be lost.
    let lost = |test: &str| {
        sight(&format!("{test}/visible")).filter(is_positive)?;
        sight(&format!("{test}/false_culls"))
    };
    let kept = |test: &str| {
        let hidden = sight(&format!("{test}/hidden")).filter(is_positive);
        ratio(sight(&format!("{test}/kept")), hidden).map(|share| 100.0 * share)
    };
    let survivors = |poses: &str| {
        at(culling, &format!("{poses}/scenes")).filter(|scenes| *scenes >= 0.99 * POSES)?;
        let of = |field: &str| at(culling, &format!("{poses}/chunks_by_blocks/{field}"));
        ratio(of("kept"), of("hidden").filter(is_positive)).map(|share| 100.0 * share)
    };
    let is_drawn = least("shown/poses", 0.99 * POSES) && at(culling, "shown/seen") > Some(0.0);
    let shown = |path| at(culling, path).filter(|_| is_drawn);
    let frame_ratio =
        list(culling, "frames/ways").iter().find(|way| text(way, "way") == Some("T4 hierarchical"));
    let is_compared = least("same/poses", COMPARED)
        && least("same/stretched", 1.0)
        && least("same/far", 1.0)
        && at(culling, "same/clumps") > Some(0.0);
    let same = |path| at(culling, path).filter(|_| is_compared);
    let fetches = ratio(sight("fetches_march"), sight("fetches_exact").filter(is_positive));
    let time = ratio(Some(1.0), sight("time_ratio").filter(is_positive));
    let framed = |path: &str| {
        at(culling, "frame_ratios/all/poses").filter(|poses| *poses >= 0.99 * POSES)?;
        at(culling, &format!("frame_ratios/{path}"))
    };
    let is_million = least("gpu_time/full/clumps", CLUMPS as f64)
        && least("gpu_time/size/0", 1920.0)
        && least("gpu_time/size/1", 1080.0);
    let million_ms = at(culling, "gpu_time/full/whole_ms").filter(|_| is_million);
    let eighth_ms = at(culling, "gpu_time/sparse/whole_ms").filter(is_positive);
    // The bar is a GPU's: a software adapter shows its figure and is not held against it.
    let million = if culling.pointer("/gpu_time/is_software") == Some(&Value::Bool(true)) {
        Bar::reported(
            "1 M clumps at 1080p, cull and draw (software adapter: shown, not held to a GPU's 1.5 ms)",
            million_ms,
            "ms",
        )
    } else {
        Bar::new("on a GPU: 1 M clumps at 1080p, cull and draw", million_ms, "ms", Limit::Under(1.5))
    };
    let of_kind = |kind: &str, test: &str| {
        sight(&format!("variations/{kind}/scenes")).filter(|scenes| *scenes >= OF_A_KIND)?;
        lost(&format!("variations/{kind}/{test}"))
    };
    let kinds = KINDS.into_iter().flat_map(|(kind, what)| {
        [
            Bar::none(format!("T4, {what}: clumps lost that are seen"), of_kind(kind, "hierarchical")),
            Bar::some(format!("T2 and T3 by marching, {what}: the same (control)"), of_kind(kind, "inexact")),
        ]
    });
    let mut rows = vec![
        Bar::none("T3 exact: clumps lost that are seen", lost("exact")),
        Bar::none("T4: the same", lost("hierarchical")),
        Bar::none("T4: clumps lost of whose bound a point is seen", lost("bound")),
        Bar::none("T4: chunks of grass lost that are seen", lost("chunks")),
        Bar::none("T4: chunks of trees lost that are seen", lost("tree_chunks")),
        Bar::none("T3 exact: plants lost that show in a picture", shown("shown/lost_exact")),
        Bar::none("T4 on the GPU: the same", shown("shown/lost_hierarchical")),
        Bar::some("T2: the same (control)", shown("shown/lost_noise")),
        Bar::some("T3 by marching: the same (control)", shown("shown/lost_march")),
        Bar::some("T2: clumps lost that are seen (control)", lost("noise")),
        Bar::some("T3 by marching: the same (control)", lost("march")),
        Bar::some("five points: chunks lost that are seen (control)", lost("five_points")),
        Bar::under("T4: hidden grass kept", kept("grass"), "%", 3.0),
        Bar::reported("T4: hidden trees kept", kept("trees"), "%"),
        Bar::under(
            "hidden chunks of grass that survive the chunk and block tests",
            survivors("held_out"),
            "%",
            20.0,
        )
        .with_note("at as many other poses, which no test was tuned on"),
        Bar::reported("the same at the poses of the other rows", survivors("sight"), "%"),
        Bar::reported("hidden chunks of grass with a clump kept", kept("chunks"), "%"),
        Bar::reported("T4: hidden chunks of trees with a clump kept", kept("tree_chunks"), "%"),
        Bar::at_least("fetches of a march in steps of 0.5 m over those of T3", fetches, "x", 6.0),
        Bar::at_least("time of the march over that of T3, CPU", time, "x", 4.0),
        Bar::at_most(
            "valley scene: time of a frame with T4 over that with T1",
            frame_ratio.and_then(|way| at(way, "frame_ratio")),
            "x",
            0.5,
        ),
        Bar::reported("the same at 300 poses, p50", framed("all/p50"), "x"),
        Bar::reported("the same at 300 poses, p99", framed("all/p99"), "x"),
        Bar::reported("the same in the valleys among them, p50", framed("valleys/p50"), "x"),
        Bar::reported("the same in the valleys among them, p99", framed("valleys/p99"), "x"),
        Bar::reported("T1 over T1 at 300 poses, p99: scatter of the machine", framed("repeated/p99"), "x"),
        Bar::none("GPU against the twin: differing clumps", same("same/differing")),
        Bar::some("GPU against a twin that does not test the land (control)", same("same/differing_control")),
        Bar::at_most("root off the drawn triangle, worst", sight("root_mm"), "mm", 1.0),
        million,
        Bar::at_least(
            "GPU time of 1 M clumps over that of an eighth of the grass (control)",
            ratio(million_ms, eighth_ms),
            "x",
            1.5,
        ),
    ];
    rows.extend(kinds);
    rows
}

/// The tests that notes count, by their field.
const TESTS: [(&str, &str); 10] = [
    ("exact", "T3 exact"),
    ("hierarchical", "T4"),
    ("grass", "T4, grass"),
    ("trees", "T4, trees"),
    ("chunks", "T4, chunks of grass"),
    ("tree_chunks", "T4, chunks of trees"),
    ("noise", "T2"),
    ("march", "T3 by marching"),
    ("march_fine", "T3 by marching in steps of 0.5 m"),
    ("five_points", "five points"),
];

/// How the figures were measured, for the record.
pub fn notes(culling: &Value) -> Vec<String> {
    let scenes = at(culling, "sight/scenes").unwrap_or(f64::NAN);
    let mut notes = vec![
        format!(
            "Sight: {scenes:.0} of {POSES} seeded poses with a scene, in valleys, on peaks and between, a \
             person's height above the ground or a tower's, tolerances of 0.7 to 4 pixels, every third over \
             land that is stretched 1.8 or 4 times, every fifth 10^6 m from the origin. Truth, in f64: a \
             clump is seen if the drawn triangles leave any vertex of it in sight of the eye, as the twins \
             of the shapes place it; a chunk of 128 m, if any clump of it that stands in the view is."
        ),
        "Fetches: reads of heights, bounds and tiles of the same rays; time: one thread, the same rays one \
         after the other."
            .into(),
        "T2 marches over the noise, T3 by marching over the drawn vertices, bilinear, both in steps of 2 m \
         and to the tip of the clump; five points are a chunk's corners and middle at its highest."
            .into(),
    ];
    notes.push(fill(
        "Hidden chunks of grass by blocks: {held_out/chunks_by_blocks/kept} kept of \
         {held_out/chunks_by_blocks/hidden} at poses that no test was tuned on, \
         {sight/chunks_by_blocks/kept} of {sight/chunks_by_blocks/hidden} at the others.",
        culling,
    ));
    // With none of n independent cases, the share is below 3 / n with 95 % certainty (Hanley and
    // Lippman-Hand, JAMA 249(13), 1983). Poses are independent; the plants of one pose are not.
    let certain =
        |poses: f64| format!("fewer than {:.1} % of such poses lose one, with 95 % certainty", 300.0 / poses);
    for (test, what) in TESTS {
        let Some(score) = value(culling, "sight").and_then(|sight| sight.get(test)) else { continue };
        let is_safe = at(score, "false_culls") == Some(0.0) && at(score, "visible") > Some(0.0);
        let bound = if is_safe { format!(", so {}", certain(scenes)) } else { String::new() };
        let sentence = "{false_culls} lost of {visible} that are seen";
        let hidden = fill("{kept} kept of {hidden} that are hidden.", score);
        notes.push(format!("{what}: {}{bound}; {hidden}", fill(sentence, score)));
    }
    notes.push(fill(
        "In {sight/below_land} of these poses the eye is below the drawn land, because chunks are absent; \
         land hides nothing from there, so these poses count for what is lost and not for what is kept.",
        culling,
    ));
    for (kind, what) in KINDS {
        let Some(variation) = value(culling, &format!("sight/variations/{kind}")) else { continue };
        let sentence = "{scenes} poses; T4 loses {hierarchical/false_culls} of {hierarchical/visible} clumps \
                        that are seen and keeps {hierarchical/kept} of {hierarchical/hidden} that are \
                        hidden; T2 and T3 by marching lose {inexact/false_culls} together.";
        notes.push(format!("Of these, {what}: {}", fill(sentence, variation)));
    }
    if let Some(shown) = culling.get("shown").filter(|shown| shown.is_object()) {
        let pictures = "Pictures: {poses} poses drawn without culling, each pixel the place of the plant \
                        that it shows, at {widths} pixels across; {seen} plants show of {drawn} that are \
                        there; of those that show T1 loses {lost_frustum}, T2 {lost_noise}, T3 by marching \
                        {lost_march}, T3 exact {lost_exact}, T4 {lost_hierarchical}, so ";
        let certain = certain(at(shown, "poses").unwrap_or(f64::NAN));
        notes.push(format!("{}{certain} where none is lost.", fill(pictures, shown)));
    }
    notes.extend(each(
        culling,
        "frames/ways",
        "Frames of the valley scene, {way}: {clumps} clumps, choice {choice_ratio:.2} and frame \
         {frame_ratio:.2} of those with T1.",
    ));
    notes.extend(culling.get("frame_ratios").filter(|found| found.is_object()).map(|found| {
        let sentence = "Frames of {all/poses} poses, 320 x 180 pixels, plants of the scene `culling`, \
                        shadows not traced, time with T4 over that with T1, in turns: p50 {all/p50:.2}, \
                        p99 {all/p99:.2}, most {all/max:.2}; {valleys/poses} of them in valleys: p50 \
                        {valleys/p50:.2}, p99 {valleys/p99:.2}, most {valleys/max:.2}; T1 once more over T1: \
                        p50 {repeated/p50:.2}, p99 {repeated/p99:.2}, most {repeated/max:.2}.";
        fill(sentence, found)
    }));
    if let Some(found) = culling.get("gpu_time").filter(|found| found.is_object()) {
        let sentence = "A million clumps: the meadow of the scene `grass` from 40 m above, 32 clumps on a \
                        cell up to {range_m} m, {size/0} x {size/1}, {samples} samples a pixel, drawn \
                        into an empty picture, so that no land hides a part of them; {full/clumps} of \
                        {in_view} clumps in view drawn in {full/whole_ms:.2} ms, {sparse/clumps} in \
                        {sparse/whole_ms:.2} ms.";
        let clock = if found.pointer("/full/passes").is_some_and(Value::is_object) {
            "By timestamps of the adapter: culling {full/passes/cull_ms:.2} ms, drawing \
             {full/passes/draw_ms:.2} ms; as the program sees it {full/program_ms:.2} ms."
        } else {
            "The adapter has no timestamps: times are those that the program sees."
        };
        notes.push(format!("{} {}", fill(sentence, found), fill(clock, found)));
    }
    notes.extend(culling.get("same").filter(|same| same.is_object()).map(|same| {
        let twin = "GPU against the twin: {clumps} clumps at {poses} poses, {stretched} of them over \
                    stretched land, {far} 10^6 m from the origin; grass up to 160 m with 4 clumps on a cell, \
                    trees up to 800 m.";
        fill(twin, same)
    }));
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use bars::{Figure, Verdict};
    use serde_json::json;

    fn culling() -> Value {
        let good = json!({ "visible": 1000, "false_culls": 0, "hidden": 1000, "kept": 9 });
        let poor = json!({ "visible": 1000, "false_culls": 5, "hidden": 1000, "kept": 1 });
        let kind = json!({ "scenes": 30, "hierarchical": good, "inexact": poor });
        let spread = json!({ "poses": 299, "p50": 0.8, "p99": 1.0, "max": 1.1 });
        let timed = |clumps: u64, whole_ms: f64| {
            let program_ms = whole_ms + 1.0;
            json!({ "clumps": clumps, "passes": null, "program_ms": program_ms, "whole_ms": whole_ms })
        };
        json!({
            "poses": 300,
            "sight": {
                "scenes": 299, "exact": good, "hierarchical": good, "bound": good, "grass": good,
                    "trees": good, "chunks": good,
                "chunks_by_blocks": good, "tree_chunks": good, "noise": poor, "march": poor,
                    "march_fine": poor, "five_points": poor,
                "fetches_exact": 100.0, "fetches_march": 900.0, "time_ratio": 0.1, "root_mm": 0.4,
                "variations": { "steep": kind, "absent_chunks": kind, "chunk_border": kind,
                    "level_border": kind },
            },
            "shown": { "poses": 299, "widths": [160], "seen": 1000, "drawn": 9000, "lost_noise": 9,
                "lost_march": 5, "lost_exact": 0, "lost_hierarchical": 0 },
            "held_out": { "scenes": 299, "chunks_by_blocks": good },
            "frames": { "ways": [{ "way": "T1 frustum", "frame_ratio": 1.0 }, { "way": "T4 hierarchical",
                "frame_ratio": 0.4 }] },
            "frame_ratios": { "all": spread, "valleys": spread, "repeated": spread },
            "gpu_time": { "adapter": "hard", "is_software": false, "size": [1920, 1080], "samples": 4,
                "full": timed(1_000_000, 1.4), "sparse": timed(125_000, 0.4) },
            "same": { "adapter": "soft", "poses": 24, "stretched": 8, "far": 5, "clumps": 9999,
                "differing": 0, "differing_control": 50 },
        })
    }

    fn missed(culling: &Value) -> usize {
        let rows = rows(culling);
        assert_eq!(rows.len(), 39);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar() {
        assert_eq!(missed(&culling()), 0);
    }

    #[test]
    fn every_missing_field_is_a_miss() {
        for (path, field, expected) in [
            ("", "poses", 23),
            ("", "frame_ratios", 5),
            ("/frame_ratios/all", "poses", 5),
            ("/frame_ratios/valleys", "p99", 1),
            ("", "gpu_time", 2),
            ("/gpu_time", "size", 2),
            ("/gpu_time/full", "clumps", 2),
            ("/gpu_time/sparse", "whole_ms", 1),
            ("/sight/variations", "steep", 2),
            ("/sight/variations/level_border", "scenes", 2),
            ("/sight/variations/chunk_border/hierarchical", "false_culls", 1),
            ("", "same", 2),
            ("/sight", "scenes", 24),
            ("/sight/exact", "false_culls", 1),
            ("/sight/hierarchical", "visible", 1),
            ("/sight/grass", "hidden", 1),
            ("/sight/chunks", "kept", 1),
            ("/sight", "fetches_exact", 1),
            ("/sight", "time_ratio", 1),
            ("/sight", "root_mm", 1),
            ("/same", "poses", 2),
            ("/same", "far", 2),
            ("/same", "differing", 1),
            ("", "held_out", 1),
            ("/held_out", "scenes", 1),
            ("/held_out/chunks_by_blocks", "hidden", 1),
            ("", "shown", 4),
            ("/shown", "poses", 4),
            ("/shown", "seen", 4),
            ("/shown", "lost_exact", 1),
            ("", "frames", 1),
        ] {
            for lost in [None, Some(Value::Null), Some(json!("much"))] {
                let mut culling = culling();
                let fields = culling.pointer_mut(path).unwrap().as_object_mut().unwrap();
                fields.remove(field);
                fields.extend(lost.map(|lost| (field.to_string(), lost)));
                assert_eq!(missed(&culling), expected, "{path} {field}");
            }
        }
        assert_eq!(missed(&Value::Null), 39);
    }

    #[test]
    fn each_bar_can_be_missed() {
        for (path, value) in [
            ("/sight/exact/false_culls", json!(1)),
            ("/sight/hierarchical/false_culls", json!(1)),
            ("/sight/bound/false_culls", json!(1)),
            ("/sight/chunks/false_culls", json!(1)),
            ("/sight/tree_chunks/false_culls", json!(1)),
            ("/sight/noise/false_culls", json!(0)),
            ("/sight/march/false_culls", json!(0)),
            ("/sight/five_points/false_culls", json!(0)),
            ("/sight/grass/kept", json!(30)),
            ("/held_out/chunks_by_blocks/kept", json!(200)),
            ("/sight/fetches_march", json!(599)),
            ("/sight/time_ratio", json!(0.26)),
            ("/sight/root_mm", json!(1.1)),
            ("/same/differing", json!(1)),
            ("/shown/lost_exact", json!(1)),
            ("/shown/lost_hierarchical", json!(1)),
            ("/shown/lost_noise", json!(0)),
            ("/shown/lost_march", json!(0)),
            ("/frames/ways/1/frame_ratio", json!(0.51)),
            ("/same/differing_control", json!(0)),
            ("/sight/variations/steep/hierarchical/false_culls", json!(1)),
            ("/sight/variations/absent_chunks/inexact/false_culls", json!(0)),
            ("/sight/variations/level_border/hierarchical/visible", json!(0)),
            ("/gpu_time/full/whole_ms", json!(1.5)),
            ("/gpu_time/sparse/whole_ms", json!(1.4)),
        ] {
            let mut culling = culling();
            *culling.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&culling), 1, "{path}");
        }
        for (path, value, expected) in [
            ("/same/poses", json!(19), 2),
            ("/gpu_time/full/clumps", json!(999_999), 2),
            ("/gpu_time/size/0", json!(1280), 2),
            ("/sight/variations/steep/scenes", json!(29), 2),
        ] {
            let mut fewer = culling();
            *fewer.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&fewer), expected, "{path}");
        }
    }

    #[test]
    fn a_software_adapter_shows_its_time_of_a_million_clumps_and_is_not_held_to_a_bar() {
        let verdict = |is_software: bool, whole_ms: Value| {
            let mut culling = culling();
            culling["gpu_time"]["is_software"] = json!(is_software);
            culling["gpu_time"]["full"]["whole_ms"] = whole_ms;
            let row = rows(&culling).into_iter().find(|row| row.name.contains("1 M clumps at 1080p"));
            let row = row.expect("the row");
            (row.verdict(), row.figure)
        };
        assert_eq!(verdict(true, json!(900.0)), (Verdict::Reported, Figure::Measured(900.0)));
        assert_eq!(verdict(true, Value::Null), (Verdict::Missed, Figure::Missing));
        assert_eq!(verdict(false, json!(1.4)).0, Verdict::Met);
        assert_eq!(verdict(false, json!(900.0)).0, Verdict::Missed);
    }
}
