//! The bars of the drawn levels of detail.

use crate::report::NEEDS_GPU;
use bars::Bar;
use bars::figures::{at, each, least, list, ratio, worst};
use serde_json::Value;

/// Poses of the screen error and of the search for gaps; fewer measure nothing.
const POSES: f64 = 50.0;
const VIEWS: f64 = 200.0;

const KIB: f64 = 1024.0;

/// Least change of levels without a morph, in times of those with one.
const UNMORPHED: f64 = 1.5;

/// Every figure beside its bar.
pub fn rows(lod: &Value) -> Vec<Bar> {
    let screen = |field| at(lod, field).filter(|_| at(lod, "screen/poses") >= Some(POSES));
    let of_views = |field| list(lod, "triangles").iter().map(move |view| at(view, field));
    let eight_km = |field| of_views(field).next()?;
    let is_whole = at(lod, "cracks/whole/poses") >= Some(VIEWS) && at(lod, "cracks/whole/pixels") > Some(0.0);
    let magenta = |field| at(lod, field).filter(|_| is_whole);
    let block = |change| worst(list(lod, "popping").iter().map(|flight| at(flight, change)));
    let morphed = block("morphed/block");
    let unmorphed = |by| {
        let flights = list(lod, by).iter();
        flights.map(|flight| ratio(at(flight, "unmorphed/block"), at(flight, "morphed/block")))
    };
    let draws = at(lod, "frames/terrain_draws").filter(|draws| *draws > 0.0);
    let chunk_kib = at(lod, "frames/bytes_per_chunk").map(|bytes| bytes / KIB);
    // Absolute times of a GPU; of a software driver ratios alone, which say how work grows and
    // nothing about a GPU.
    let is_software = lod.pointer("/frames/is_software") == Some(&Value::Bool(true));
    let timed = |tolerance_px: f64, field| {
        let mut rows = list(lod, "frames/rows").iter();
        at(rows.find(|row| at(row, "tolerance_px") == Some(tolerance_px))?, field)
    };
    let (light, whole) = (timed(1.0, "passes/light_ms"), timed(1.0, "passes/whole_ms"));
    let all_triangles = eight_km("triangles_without_lod");
    vec![
        Bar::at_most("screen error over 50 poses: tolerances", screen("screen/max"), "", 1.0),
        Bar::some("the same, chosen for 4 tolerances (control)", screen("screen/max_when_loose")),
        Bar::under("triangles of the 8 km view at 1 px", eight_km("triangles"), "", 1.5e6),
        Bar::reported(
            "share of the triangles without levels",
            ratio(eight_km("triangles"), all_triangles),
            "x",
        ),
        Bar::reported("triangles of the worst of all cameras", worst(of_views("triangles")), ""),
        Bar::none("magenta pixels in 200 poses", magenta("cracks/whole/magenta")),
        Bar::some("with a chunk left out (control)", magenta("cracks/chunk_left_out/magenta")),
        Bar::some("with borders that do not meet (control)", magenta("cracks/no_seams/magenta")),
        Bar::under("GPU memory of a resident chunk, heights and normals", chunk_kib, "KiB", 24.0),
        Bar::at_most("draw calls for terrain", draws, "", 1.0),
        Bar::reported("change by levels in a frame, 8 x 8 pixels of 255", morphed, ""),
        // Of each flight by itself: the largest change without morphs is not that of the flight
        // with the largest one with them.
        Bar::reported("without over with morphs, least of the flights", least(unmorphed("popping")), "x"),
        // Light of the land hides changes of the triangles, with and without morphs.
        Bar::at_least(
            "the same by light of the drawn triangles without shadows (control)",
            least(unmorphed("popping_by_triangles")),
            "x",
            UNMORPHED,
        ),
        Bar::reported("change by the motion of that frame", ratio(block("motion/block"), morphed), "x"),
        Bar::under("GPU time of the island at 1920 x 1080", whole, "ms", 2.0)
            .not_measured_if(is_software, NEEDS_GPU),
        Bar::reported(
            "time of a frame at 1 px: of one at 4 px",
            ratio(timed(1.0, "frame_ms"), timed(4.0, "frame_ms")),
            "x",
        ),
        Bar::reported("land, sky and sea: share of the frame", ratio(light, whole), "x"),
    ]
}

const NOTES: [&str; 3] = [
    "Screen error: at every vertex of level 0 within 8 km all round the eye, 1920 x 1080, 60 degrees, at \
     tolerances of 0.5, 1, 2 and 4 px; the drawn triangles are evaluated by the twin of the vertex shader.",
    "Gaps: pixels of 256 x 144 whose view ray comes below the deepest land within 3.6 km; most eyes on \
     borders of chunks, more than half of them while chunks are still arriving, half of them on islands up \
     to 4000 km out.",
    "Popping: each pose of a flight, a metre apart, is drawn with what is chosen for it and with what was \
     chosen for the pose before; 256 x 144, tolerance 0.5 px. Light follows the land, not the drawn \
     triangles, so that levels change it little even without morphs, on some flights no more than with \
     them. Shadows of the land are traced for the vertices of each chunk, and no morph changes them. The \
     control leaves both out.",
];

/// How the figures were measured, for the record.
pub fn notes(lod: &Value) -> Vec<String> {
    let camera = "Camera {camera}: {triangles:.0} triangles, {triangles_without_lod:.0} without levels.";
    let flight = "Flight {flight}: 8 x 8 pixels change by {morphed/block:.2} with morphs, \
                  {unmorphed/block:.2} without, {motion/block:.2} by motion; single pixels by \
                  {morphed/max:.2}, {unmorphed/max:.2} and {motion/max:.2}; 99.9 % of them by at most \
                  {morphed/p999:.2}, {unmorphed/p999:.2} and {motion/p999:.2}.";
    let measured = each(lod, "triangles", camera).chain(each(lod, "popping", flight));
    NOTES.map(str::to_owned).into_iter().chain(measured).collect()
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
            "popping_by_triangles": [{ "morphed": change(1.0), "unmorphed": change(8.0) }],
            "frames": { "adapter": "soft", "is_software": false, "terrain_draws": 1, "levels": 5,
                        "bytes_per_chunk": 17_000, "rows": [row(1.0, 2.0), row(4.0, 1.0)] },
        })
    }

    fn missed(lod: &Value) -> usize {
        let rows = rows(lod);
        assert_eq!(rows.len(), 17);
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
            ("/popping_by_triangles/0", "unmorphed", 1),
            ("/frames", "bytes_per_chunk", 1),
            ("/frames", "terrain_draws", 1),
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
        assert_eq!(missed(&Value::Null), 17);
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
            ("/popping_by_triangles/0/unmorphed/block", json!(1.4)),
            ("/frames/rows/0/passes/whole_ms", json!(2.0)),
        ] {
            let mut lod = lod();
            *lod.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&lod), 1, "{path}");
        }
    }
}
