//! The bars of the codecs.

use super::LOSSY;
use super::baselines::{PLANE_ZSTD, PNG16, SCAN_DELTA};
use bars::Bar;
use bars::figures::{at, fill, list, text, worst};
use serde_json::Value;

/// Names of our codecs.
pub const COMPACT: &str = "exact, compact";
pub const FAST: &str = "exact, fast";

/// Every figure beside its bar.
pub fn rows(report: &Value) -> Vec<Bar> {
    let of = |name: &str, field| {
        at(list(report, "rows").iter().find(|row| text(row, "codec") == Some(name))?, field)
    };
    let losses = |is_control: bool| {
        let rows = list(report, "rows").iter();
        let rows = rows.filter(|row| is_control == (text(row, "codec") == Some(LOSSY)));
        worst(rows.map(|row| Some(f64::from(!row.get("lossless")?.as_bool()?))))
    };
    // Times of a build that is not optimised say nothing.
    let optimised = report.get("optimised").and_then(Value::as_bool);
    let rate =
        |name: &str, figure: Option<f64>, bar: fn(String, Option<f64>, &'static str, f64) -> Bar, limit| {
            let row = bar(name.to_owned(), figure.filter(|_| optimised.is_some()), "GB/s", limit);
            row.not_measured_if(optimised == Some(false), "needs an optimised build")
        };
    let has_lerc = report.get("lerc").is_some();
    vec![
        Bar::at_most("bytes of lossless heights over their entropy", of(COMPACT, "of_entropy"), "x", 1.08),
        Bar::reported("scan deltas, zigzag and gzip: the same (rival)", of(SCAN_DELTA, "of_entropy"), "x"),
        Bar::reported("LERC: the same (rival)", at(report, "lerc/of_entropy"), "x")
            .not_measured_if(!has_lerc, "needs --lerc"),
        Bar::reported(
            "plane residuals in byte planes, one zstd frame: the same (rival)",
            of(PLANE_ZSTD, "of_entropy"),
            "x",
        ),
        Bar::none("lossless codecs that lose something", losses(false)),
        Bar::some("a lossy one (control)", losses(true)),
        rate("decoding heights alone, cached level", of(COMPACT, "decode_gb_per_s"), Bar::at_least, 1.2),
        rate("decoding heights alone, hot level", of(FAST, "decode_gb_per_s"), Bar::at_least, 3.0),
        Bar::reported(
            "plane residuals in byte planes, one zstd frame: decoding heights alone (rival)",
            of(PLANE_ZSTD, "decode_gb_per_s").filter(|_| optimised == Some(true)),
            "GB/s",
        )
        .not_measured_if(optimised == Some(false), "needs an optimised build"),
        rate(
            "whole frame to verified chunk, cached level",
            of(COMPACT, "frame_gb_per_s"),
            Bar::at_least,
            1.2,
        ),
        rate("whole frame to verified chunk, hot level", of(FAST, "frame_gb_per_s"), Bar::at_least, 3.0),
        Bar::reported(
            "PNG, 16 bits: decoding heights alone (rival)",
            of(PNG16, "decode_gb_per_s").filter(|_| optimised == Some(true)),
            "GB/s",
        )
        .not_measured_if(optimised == Some(false), "needs an optimised build"),
    ]
}

/// All figures, for the record.
pub fn notes(report: &Value) -> Vec<String> {
    let codec = |row: &Value| {
        let is_whole = row.get("decodes_whole_frame").and_then(Value::as_bool) == Some(true);
        let decoded = if is_whole { "the whole frame decoded" } else { "decoded" };
        let sentence = "{codec}: {bytes_per_sample:.3} bytes a sample, {of_entropy:.3} of the entropy; \
                        encoded in {encode_ns*1e-3:.1} us, DECODED in {decode_ns*1e-3:.1} us \
                        ({decode_gb_per_s:.2} GB/s).";
        fill(&sentence.replace("DECODED", decoded), row)
    };
    let entropy = "Entropy: order 0, of each chunk's plane residuals, {entropy_bytes_per_sample:.3} bytes a \
                   sample.";
    let mut notes = vec![fill(entropy, report)];
    notes.extend(list(report, "rows").iter().map(codec));
    notes.extend(report.get("lerc").filter(|lerc| lerc.is_object()).map(codec));
    notes
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn report() -> Value {
        let codec = |name, of_entropy, rate, lossless| {
            json!({
                "codec": name, "of_entropy": of_entropy, "decode_gb_per_s": rate, "lossless": lossless,
                "frame_gb_per_s": 3.1,
            })
        };
        json!({
            "optimised": true,
            "rows": [
                codec(COMPACT, 1.03, 1.6, true),
                codec(FAST, 1.3, 4.0, true),
                codec(SCAN_DELTA, 1.7, 0.2, true),
                codec(PNG16, 1.8, 0.2, true),
                codec(LOSSY, 0.9, 1.6, false),
                codec(PLANE_ZSTD, 1.05, 0.9, true),
            ],
            "lerc": { "of_entropy": 1.7 },
        })
    }

    fn missed(report: &Value) -> usize {
        let rows = rows(report);
        assert_eq!(rows.len(), 12);
        rows.iter().filter(|row| row.is_missed()).count()
    }

    #[test]
    fn a_good_report_meets_every_bar() {
        assert_eq!(missed(&report()), 0);
    }

    #[test]
    fn a_debug_build_has_no_rates_and_a_run_without_lerc_no_ratio() {
        let mut debug = report();
        debug["optimised"] = json!(false);
        debug["rows"][0]["decode_gb_per_s"] = json!(0.01);
        debug.as_object_mut().unwrap().remove("lerc");
        assert_eq!(missed(&debug), 0);
        let kept = rows(&debug).iter().filter(|row| row.is_met()).count();
        assert_eq!(kept, 5, "bytes and losses");
    }

    #[test]
    fn every_missing_field_is_a_miss() {
        for (path, field, expected) in [
            ("/lerc", "of_entropy", 1),
            ("", "optimised", 6),
            ("", "rows", 11),
            ("/rows/0", "of_entropy", 1),
            ("/rows/1", "decode_gb_per_s", 1),
            ("/rows/1", "frame_gb_per_s", 1),
            ("/rows/3", "lossless", 1),
        ] {
            for lost in [None, Some(Value::Null), Some(json!("much"))] {
                let mut report = report();
                let fields = report.pointer_mut(path).unwrap().as_object_mut().unwrap();
                fields.remove(field);
                fields.extend(lost.map(|lost| (field.to_string(), lost)));
                assert_eq!(missed(&report), expected, "{path} {field}");
            }
        }
        let mut unbuilt = report();
        unbuilt["lerc"] = Value::Null;
        assert_eq!((missed(&unbuilt), missed(&Value::Null)), (1, 11));
    }

    #[test]
    fn each_bar_can_be_missed() {
        for (path, value) in [
            ("/rows/0/of_entropy", json!(1.09)),
            ("/rows/1/lossless", json!(false)),
            ("/rows/4/lossless", json!(true)),
            ("/rows/0/decode_gb_per_s", json!(1.19)),
            ("/rows/1/decode_gb_per_s", json!(2.9)),
            ("/rows/0/frame_gb_per_s", json!(1.19)),
            ("/rows/1/frame_gb_per_s", json!(2.9)),
        ] {
            let mut report = report();
            *report.pointer_mut(path).unwrap() = value;
            assert_eq!(missed(&report), 1, "{path}");
        }
    }

    #[test]
    fn every_codec_has_a_sentence() {
        let notes = notes(&report()).join("\n");
        assert!(notes.contains("PNG, 16 bits") && notes.contains("1.800 of the entropy"), "{notes}");
        assert_eq!(notes.lines().count(), 8);
        assert!(!notes.contains("whole frame"), "{notes}");
        let mut whole = report();
        whole["rows"][0]["decodes_whole_frame"] = json!(true);
        let notes = super::notes(&whole);
        assert_eq!(notes.iter().filter(|note| note.contains("the whole frame decoded in")).count(), 1);
    }
}
