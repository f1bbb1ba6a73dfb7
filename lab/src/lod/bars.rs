//! The bars of the drawn levels of detail.

use crate::report::{list, number};
use bars::{Bar, Limit, worst};
use serde_json::Value;

/// Poses of the screen error and of the search for gaps; fewer measure nothing.
const POSES: f64 = 50.0;
const VIEWS: f64 = 200.0;

const KIB: f64 = 1024.0;

/// The row that needs a GPU.
const GPU_TIME: &str = "GPU time of the island at 1920 x 1080";

/// Every figure beside its bar.
pub fn rows(lod: &Value) -> Vec<Bar> {
    let at = |path: &str| lod.pointer(path).and_then(Value::as_f64);
    let screen = |field: &str| at(&format!("/screen/{field}")).filter(|_| at("/screen/poses") >= Some(POSES));
    let views = list(lod, "/triangles");
    let flights = list(lod, "/popping");
    let is_whole = at("/cracks/whole/poses") >= Some(VIEWS) && at("/cracks/whole/pixels") > Some(0.0);
    let magenta = |fault: &str| at(&format!("/cracks/{fault}/magenta")).filter(|_| is_whole);
    let of_views = |field: &str| worst(&views.iter().map(|view| number(view, field)).collect::<Vec<_>>());
    let block = |kind: &str| {
        let figures: Vec<_> = flights.iter().map(|flight| number(flight.get(kind)?, "block")).collect();
        worst(&figures)
    };
    let eight_km = |field: &str| number(views.first()?, field);
    let share = |part: Option<f64>, whole: Option<f64>| Some(part? / whole?);
    let mut rows = vec![
        Bar::new("screen error over 50 poses: tolerances", screen("max"), "", Limit::AtMost(1.0)),
        Bar::new(
            "the same, chosen for 4 tolerances (control)",
            screen("max_when_loose"),
            "",
            Limit::AtLeast(1.0),
        ),
        Bar::new("triangles of the 8 km view at 1 px", eight_km("triangles"), "", Limit::Under(1.5e6)),
        Bar::new(
            "share of the triangles without levels",
            share(eight_km("triangles"), eight_km("triangles_without_lod")),
            "x",
            Limit::Reported,
        ),
        Bar::new("triangles of the worst of all cameras", of_views("triangles"), "", Limit::Reported),
        Bar::new("magenta pixels in 200 poses", magenta("whole"), "", Limit::AtMost(0.0)),
        Bar::new("with a chunk left out (control)", magenta("chunk_left_out"), "", Limit::AtLeast(1.0)),
        Bar::new("with borders that do not meet (control)", magenta("no_seams"), "", Limit::AtLeast(1.0)),
        Bar::new(
            "GPU memory of a resident chunk, heights and normals",
            at("/frames/bytes_per_chunk").map(|bytes| bytes / KIB),
            "KiB",
            Limit::Under(24.0),
        ),
        Bar::new(
            "draw calls for terrain, bar: levels drawn",
            at("/frames/terrain_draws").filter(|draws| *draws > 0.0),
            "",
            Limit::AtMost(at("/frames/levels").unwrap_or(0.0)),
        ),
        Bar::new("change by levels in a frame, 8 x 8 pixels of 255", block("morphed"), "", Limit::Reported),
        Bar::new(
            "the same without morphs (control)",
            share(block("unmorphed"), block("morphed")),
            "x",
            Limit::AtLeast(2.0),
        ),
        Bar::new(
            "change by the motion of that frame",
            share(block("motion"), block("morphed")),
            "x",
            Limit::Reported,
        ),
    ];
    rows.extend(times(lod));
    rows
}

/// Absolute times of a GPU; of a software driver ratios alone, which say how work grows and nothing
/// about a GPU.
fn times(lod: &Value) -> Vec<Bar> {
    let frames = list(lod, "/frames/rows");
    let at = |tolerance: f64| frames.iter().find(|row| number(row, "tolerance_px") == Some(tolerance));
    let passes = |row: &Value| {
        let of = |pass: &str| row.pointer(&format!("/passes/{pass}")).and_then(Value::as_f64);
        Some((of("light_ms")?, of("whole_ms")?))
    };
    let whole = at(1.0).and_then(passes).map(|(_, whole)| whole);
    let is_software = lod.pointer("/frames/is_software").and_then(Value::as_bool);
    let time = match is_software {
        Some(true) => Bar::not_measured(GPU_TIME, crate::report::NEEDS_GPU, "ms", Limit::Under(2.0)),
        _ => Bar::new(GPU_TIME, whole, "ms", Limit::Under(2.0)),
    };
    let frame_ms = |tolerance| number(at(tolerance)?, "frame_ms");
    let ratio = |part: Option<f64>, whole: Option<f64>| Some(part? / whole?);
    vec![
        time,
        Bar::new(
            "time of a frame at 1 px: of one at 4 px",
            ratio(frame_ms(1.0), frame_ms(4.0)),
            "x",
            Limit::Reported,
        ),
        Bar::new(
            "land, sky and sea: share of the frame",
            ratio(at(1.0).and_then(passes).map(|(light, _)| light), whole),
            "x",
            Limit::Reported,
        ),
    ]
}

/// How the figures were measured, for the record.
pub fn notes(lod: &Value) -> Vec<String> {
    let mut notes = vec![
        "Screen error: at every vertex of level 0 within 8 km all round the eye, 1920 x 1080, 60 \
         degrees, at tolerances of 0.5, 1, 2 and 4 px; the drawn triangles are evaluated by the \
         twin of the vertex shader."
            .into(),
        "Gaps: pixels of 256 x 144 whose view ray comes below the deepest land within 3.6 km; most \
         eyes on borders of chunks, more than half of them while chunks are still arriving, half of \
         them on islands up to 4000 km out."
            .into(),
        "Popping: each pose of a flight, a metre apart, is drawn with what is chosen for it and \
         with what was chosen for the pose before; 256 x 144, tolerance 0.5 px."
            .into(),
    ];
    for view in list(lod, "/triangles") {
        let count = |field| number(view, field).map_or("unknown".into(), |count| format!("{count:.0}"));
        let camera = view.get("camera").and_then(Value::as_str).unwrap_or("unknown");
        let (own, all) = (count("triangles"), count("triangles_without_lod"));
        notes.push(format!("Camera {camera}: {own} triangles, {all} without levels."));
    }
    for flight in list(lod, "/popping") {
        let name = flight.get("flight").and_then(Value::as_str).unwrap_or("unknown");
        let of = |kind: &str, field: &str| {
            let figure = flight.get(kind).and_then(|change| number(change, field));
            figure.map_or("unknown".into(), |figure| format!("{figure:.2}"))
        };
        notes.push(format!(
            "Flight {name}: 8 x 8 pixels change by {} with morphs, {} without, {} by motion; single \
             pixels by {}, {} and {}; 99.9 % of them by at most {}, {} and {}.",
            of("morphed", "block"),
            of("unmorphed", "block"),
            of("motion", "block"),
            of("morphed", "max"),
            of("unmorphed", "max"),
            of("motion", "max"),
            of("morphed", "p999"),
            of("unmorphed", "p999"),
            of("motion", "p999"),
        ));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn lod() -> Value {
        let change = |block: f64| json!({ "max": 9, "p999": 2, "block": block });
        let row = |tolerance: f64, ms: f64| {
            json!({ "tolerance_px": tolerance, "frame_ms": ms,
            "passes": { "light_ms": 1.0, "tone_ms": 0.5, "whole_ms": 1.6 } })
        };
        json!({
            "screen": { "poses": 50, "max": 0.99, "max_when_loose": 3.0 },
            "triangles": [{ "camera": "0", "triangles": 1_000_000, "triangles_without_lod": 20_000_000 }],
            "cracks": { "whole": { "poses": 200, "pixels": 5, "magenta": 0 },
                        "chunk_left_out": { "magenta": 7 }, "no_seams": { "magenta": 1 } },
            "popping": [{ "flight": "low", "morphed": change(1.0), "unmorphed": change(4.0),
                "motion": change(9.0) }],
            "frames": { "adapter": "soft", "is_software": false, "terrain_draws": 1, "levels": 5,
                        "bytes_per_chunk": 17_000, "rows": [row(1.0, 2.0), row(4.0, 1.0)] },
        })
    }

    fn missed(lod: &Value) -> usize {
        let rows = rows(lod);
        assert_eq!(rows.len(), 16);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar() {
        assert_eq!(missed(&lod()), 0);
    }

    #[test]
    fn every_missing_field_is_a_miss() {
        for (path, field, expected) in [
            ("/screen", "max", 1),
            ("/screen", "max_when_loose", 1),
            ("/screen", "poses", 2),
            ("/triangles/0", "triangles", 3),
            ("/triangles/0", "triangles_without_lod", 1),
            ("/cracks/whole", "magenta", 1),
            ("/cracks/whole", "poses", 3),
            ("/cracks/no_seams", "magenta", 1),
            ("/popping/0", "morphed", 3),
            ("/popping/0", "unmorphed", 1),
            ("/frames", "bytes_per_chunk", 1),
            ("/frames", "terrain_draws", 1),
            ("/frames", "levels", 1),
            ("/frames", "rows", 3),
            ("/frames/rows/0", "passes", 2),
            ("/frames/rows/1", "frame_ms", 1),
        ] {
            for lost in [None, Some(Value::Null), Some(json!("much"))] {
                let mut lod = lod();
                let fields = lod.pointer_mut(path).unwrap().as_object_mut().unwrap();
                fields.remove(field);
                fields.extend(lost.map(|lost| (field.to_string(), lost)));
                assert_eq!(missed(&lod), expected, "{path} {field}");
            }
        }
        assert_eq!(missed(&Value::Null), 16);
    }

    #[test]
    fn a_shorter_run_measures_nothing_and_a_software_driver_no_time() {
        for (path, value, expected) in [("/screen/poses", json!(49)), ("/cracks/whole/pixels", json!(0))]
            .into_iter()
            .zip([2, 3])
            .map(|((a, b), c)| (a, b, c))
        {
            let mut lod = lod();
            *lod.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&lod), expected, "{path}");
        }
        let mut lod = lod();
        lod["frames"]["is_software"] = json!(true);
        lod["frames"]["rows"][0]["passes"] = Value::Null;
        let rows = rows(&lod);
        let time = rows.iter().find(|row| row.verdict() == bars::Verdict::NotMeasured).unwrap();
        assert_eq!(time.cells()[0], "not measured");
        assert_eq!(rows.iter().filter(|row| row.is_missed()).count(), 1, "the share of the frame");
    }

    #[test]
    fn each_bar_can_be_missed() {
        for (path, value) in [
            ("/screen/max", json!(1.001)),
            ("/screen/max_when_loose", json!(0.9)),
            ("/triangles/0/triangles", json!(1_500_000)),
            ("/cracks/whole/magenta", json!(1)),
            ("/cracks/chunk_left_out/magenta", json!(0)),
            ("/frames/bytes_per_chunk", json!(24 * 1024)),
            ("/frames/terrain_draws", json!(6)),
            ("/popping/0/unmorphed/block", json!(1.9)),
            ("/frames/rows/0/passes/whole_ms", json!(2.0)),
        ] {
            let mut lod = lod();
            *lod.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&lod), 1, "{path}");
        }
    }
}
