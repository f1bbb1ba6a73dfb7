//! The bars of vegetation culling.

use crate::report::number;
use bars::{Bar, Limit};
use serde_json::Value;

/// Poses that are judged by sight.
const POSES: f64 = 300.0;

/// Poses at which the GPU is compared with the twin, at least.
const COMPARED: f64 = 20.0;

const GPU_AGAINST_TWIN: &str = "GPU against the twin: differing clumps";
const GPU_AGAINST_TWIN_CONTROL: &str = "GPU against a twin that does not test the land (control)";
const GPU_TIME: &str = "on a GPU: 1 M clumps at 1080p, cull and draw";

/// Every figure beside its bar.
pub fn rows(culling: &Value) -> Vec<Bar> {
    let at = |path: &str| culling.pointer(path).and_then(Value::as_f64);
    let is_whole = at("/poses") >= Some(POSES) && at("/sight/scenes") >= Some(0.99 * POSES);
    let sight = |path: &str| at(&format!("/sight/{path}")).filter(|_| is_whole);
    // Of nothing nothing can be lost.
    let lost = |test: &str| {
        sight(&format!("{test}/false_culls")).filter(|_| sight(&format!("{test}/visible")) > Some(0.0))
    };
    let kept = |test: &str| {
        let hidden = sight(&format!("{test}/hidden")).filter(|hidden| *hidden > 0.0)?;
        Some(100.0 * sight(&format!("{test}/kept"))? / hidden)
    };
    let ratio = |above: Option<f64>, below: Option<f64>| Some(above? / below.filter(|below| *below > 0.0)?);
    let shown = |path: &str| {
        let is_enough = at("/shown/poses") >= Some(0.99 * POSES) && at("/shown/seen") > Some(0.0);
        at(&format!("/shown/{path}")).filter(|_| is_enough)
    };
    let frame = |way: &str, field: &str| {
        let ways = culling.pointer("/frames/ways").and_then(Value::as_array)?;
        number(ways.iter().find(|cost| cost.get("way").and_then(Value::as_str) == Some(way))?, field)
    };
    let same = |path: &str| {
        let is_enough = at("/same/poses") >= Some(COMPARED)
            && at("/same/stretched") >= Some(1.0)
            && at("/same/far") >= Some(1.0)
            && at("/same/clumps") > Some(0.0);
        at(&format!("/same/{path}")).filter(|_| is_enough)
    };
    vec![
        Bar::new("T3 exact: clumps lost that are seen", lost("exact"), "", Limit::AtMost(0.0)),
        Bar::new("T4: the same", lost("hierarchical"), "", Limit::AtMost(0.0)),
        Bar::new("T4: clumps lost of whose bound a point is seen", lost("bound"), "", Limit::AtMost(0.0)),
        Bar::new("T4: chunks of grass lost that are seen", lost("chunks"), "", Limit::AtMost(0.0)),
        Bar::new("T4: chunks of trees lost that are seen", lost("tree_chunks"), "", Limit::AtMost(0.0)),
        Bar::new("T3 exact: plants lost that show in a picture", shown("lost_exact"), "", Limit::AtMost(0.0)),
        Bar::new("T4 on the GPU: the same", shown("lost_hierarchical"), "", Limit::AtMost(0.0)),
        Bar::new("T2: the same (control)", shown("lost_noise"), "", Limit::AtLeast(1.0)),
        Bar::new("T3 by marching: the same (control)", shown("lost_march"), "", Limit::AtLeast(1.0)),
        Bar::new("T2: clumps lost that are seen (control)", lost("noise"), "", Limit::AtLeast(1.0)),
        Bar::new("T3 by marching: the same (control)", lost("march"), "", Limit::AtLeast(1.0)),
        Bar::new(
            "five points: chunks lost that are seen (control)",
            lost("five_points"),
            "",
            Limit::AtLeast(1.0),
        ),
        Bar::new("T4: hidden grass kept", kept("grass"), "%", Limit::Under(3.0)),
        Bar::new("T4: hidden trees kept", kept("trees"), "%", Limit::Reported),
        Bar::new(
            "hidden chunks of grass that survive the chunk and block tests",
            kept("chunks_by_blocks"),
            "%",
            Limit::Under(20.0),
        ),
        Bar::new("hidden chunks of grass with a clump kept", kept("chunks"), "%", Limit::Reported),
        Bar::new("T4: hidden chunks of trees with a clump kept", kept("tree_chunks"), "%", Limit::Reported),
        Bar::new(
            "fetches of a march in steps of 0.5 m over those of T3",
            ratio(sight("fetches_march"), sight("fetches_exact")),
            "x",
            Limit::AtLeast(6.0),
        ),
        Bar::new(
            "time of the march over that of T3, CPU",
            ratio(Some(1.0), sight("time_ratio")),
            "x",
            Limit::AtLeast(4.0),
        ),
        Bar::new(
            "valley scene: time of a frame with T4 over that with T1",
            frame("T4 hierarchical", "frame_ratio"),
            "x",
            Limit::AtMost(0.5),
        ),
        Bar::new(GPU_AGAINST_TWIN, same("differing"), "", Limit::AtMost(0.0)),
        Bar::new(GPU_AGAINST_TWIN_CONTROL, same("differing_control"), "", Limit::AtLeast(1.0)),
        Bar::new("root off the drawn triangle, worst", sight("root_mm"), "mm", Limit::AtMost(1.0)),
        Bar::new("streams: chi-square, worst, as p", at("/lots/worst_stream_p"), "", Limit::AtLeast(0.001)),
        Bar::new("two streams: the same", at("/lots/worst_pair_p"), "", Limit::AtLeast(0.001)),
        Bar::new(
            "streams cut out of a hash of the cell (control)",
            at("/lots/poor_stream_p"),
            "",
            Limit::Under(0.001),
        ),
        Bar::new(
            "two streams with bits in common (control)",
            at("/lots/poor_pair_p"),
            "",
            Limit::Under(0.001),
        ),
        Bar::not_measured(GPU_TIME, crate::report::NEEDS_GPU, "ms", Limit::Under(1.5)),
    ]
}

/// How the figures were measured, for the record.
pub fn notes(culling: &Value) -> Vec<String> {
    let scenes = culling.pointer("/sight/scenes").and_then(Value::as_f64).unwrap_or(f64::NAN);
    let mut notes = vec![
        format!(
            "Sight: {scenes:.0} of {POSES} seeded poses with a scene, in valleys, on peaks \
             and between, a person's height above the ground or a tower's, tolerances of 0.7 \
             to 4 pixels, every third over land that is stretched 1.8 or 4 times, every fifth \
             10^6 m from the origin. Truth, in f64: a clump is seen if the drawn triangles \
             leave any vertex of it in sight of the eye, as the twins of the shapes place it; \
             a chunk of 128 m, if any clump of it that stands in the view is."
        ),
        "Fetches: reads of heights, bounds and tiles of the same rays; time: one thread, the same \
         rays one after the other."
            .into(),
        "T2 marches over the noise, T3 by marching over the drawn vertices, bilinear, both in steps \
         of 2 m and to the tip of the clump; five points are a chunk's corners and middle at its \
         highest."
            .into(),
    ];
    for (test, what) in [
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
    ] {
        let Some(score) = culling.pointer(&format!("/sight/{test}")) else { continue };
        let of = |field: &str| number(score, field).unwrap_or(f64::NAN);
        // With none lost of n, the share that would be is below 3 / n with 95 % certainty (Hanley
        // and Lippman-Hand, JAMA 249(13), 1983).
        let bound = if of("false_culls") == 0.0 {
            format!(", so fewer than {:.1e} of them with 95 % certainty", 3.0 / of("visible"))
        } else {
            String::new()
        };
        notes.push(format!(
            "{what}: {} lost of {} that are seen{bound}; {} kept of {} that are hidden.",
            of("false_culls"),
            of("visible"),
            of("kept"),
            of("hidden")
        ));
    }
    if let Some(shown) = culling.get("shown").filter(|shown| shown.is_object()) {
        let of = |field: &str| number(shown, field).unwrap_or(f64::NAN);
        notes.push(format!(
            "Pictures: {} poses drawn without culling, each pixel the place of the plant that it \
             shows, at {} pixels across; {} plants show of {} that are there; of those that show T1 \
             loses {}, \
             T2 {}, T3 by marching {}, T3 exact {}, T4 {}, so fewer than {:.1e} of them with 95 % \
             certainty where none is lost.",
            of("poses"),
            shown.get("widths").map_or_else(String::new, ToString::to_string),
            of("seen"),
            of("drawn"),
            of("lost_frustum"),
            of("lost_noise"),
            of("lost_march"),
            of("lost_exact"),
            of("lost_hierarchical"),
            3.0 / of("seen")
        ));
    }
    for cost in culling.pointer("/frames/ways").and_then(Value::as_array).into_iter().flatten() {
        let of = |field: &str| number(cost, field).unwrap_or(f64::NAN);
        notes.push(format!(
            "Frames of the valley scene, {}: {} clumps, choice {:.2} and frame {:.2} of those with T1.",
            cost.get("way").and_then(Value::as_str).unwrap_or("unknown"),
            of("clumps"),
            of("choice_ratio"),
            of("frame_ratio")
        ));
    }
    if let Some(same) = culling.get("same").filter(|same| same.is_object()) {
        let of = |field: &str| number(same, field).unwrap_or(f64::NAN);
        notes.push(format!(
            "GPU against the twin: {} clumps at {} poses, {} of them over stretched land, {} 10^6 m \
             from the origin; grass up to 160 m with 4 clumps on a cell, trees up to 800 m.",
            of("clumps"),
            of("poses"),
            of("stretched"),
            of("far")
        ));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn culling() -> Value {
        let good = json!({ "visible": 1000, "false_culls": 0, "hidden": 1000, "kept": 9 });
        let poor = json!({ "visible": 1000, "false_culls": 5, "hidden": 1000, "kept": 1 });
        json!({
            "poses": 300,
            "sight": {
                "scenes": 299, "exact": good, "hierarchical": good, "bound": good, "grass": good,
                    "trees": good, "chunks": good,
                "chunks_by_blocks": good, "tree_chunks": good, "noise": poor, "march": poor,
                    "march_fine": poor, "five_points": poor,
                "fetches_exact": 100.0, "fetches_march": 900.0, "time_ratio": 0.1, "root_mm": 0.4,
            },
            "shown": { "poses": 299, "widths": [160], "seen": 1000, "drawn": 9000, "lost_noise": 9,
                "lost_march": 5, "lost_exact": 0, "lost_hierarchical": 0 },
            "frames": { "ways": [{ "way": "T1 frustum", "frame_ratio": 1.0 }, { "way": "T4 hierarchical",
                "frame_ratio": 0.4 }] },
            "lots": { "worst_stream_p": 0.1, "worst_pair_p": 0.01, "poor_stream_p": 0.0, "poor_pair_p": 0.0 },
            "same": { "adapter": "soft", "poses": 24, "stretched": 8, "far": 5, "clumps": 9999,
                "differing": 0, "differing_control": 50 },
        })
    }

    fn missed(culling: &Value) -> usize {
        let rows = rows(culling);
        assert_eq!(rows.len(), 28);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar() {
        assert_eq!(missed(&culling()), 0);
    }

    #[test]
    fn every_missing_field_is_a_miss() {
        for (path, field, expected) in [
            ("", "poses", 16),
            ("", "lots", 4),
            ("", "same", 2),
            ("/sight", "scenes", 16),
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
        assert_eq!(missed(&Value::Null), 27);
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
            ("/sight/chunks_by_blocks/kept", json!(200)),
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
            ("/lots/worst_stream_p", json!(0.0009)),
            ("/lots/worst_pair_p", json!(0.0009)),
            ("/lots/poor_stream_p", json!(0.001)),
            ("/lots/poor_pair_p", json!(0.5)),
        ] {
            let mut culling = culling();
            *culling.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&culling), 1, "{path}");
        }
        let mut fewer = culling();
        fewer["same"]["poses"] = json!(19);
        assert_eq!(missed(&fewer), 2);
    }
}
