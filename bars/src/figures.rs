//! Figures and sentences of a report in JSON. What is absent stays absent: its bars miss.

use serde_json::Value;

/// What stands at a path such as `loops/compared`.
#[must_use]
pub fn value<'a>(report: &'a Value, path: &str) -> Option<&'a Value> {
    report.pointer(&format!("/{path}"))
}

/// The number at a path. Absent, null or of another type is missing.
#[must_use]
pub fn at(report: &Value, path: &str) -> Option<f64> {
    value(report, path)?.as_f64()
}

/// The list at a path; empty if there is none.
#[must_use]
pub fn list<'a>(report: &'a Value, path: &str) -> &'a [Value] {
    value(report, path).and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// The text at a path.
#[must_use]
pub fn text<'a>(report: &'a Value, path: &str) -> Option<&'a str> {
    value(report, path)?.as_str()
}

/// The largest of several figures; none if there are none or one is missing, so that a failed run
/// cannot improve the result.
pub fn worst(figures: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    figures.into_iter().collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::max)
}

/// As [`worst`], where less is worse.
pub fn least(figures: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    worst(figures.into_iter().map(|figure| figure.map(|figure| -figure))).map(|figure| -figure)
}

/// As [`worst`], but the median: the upper one of an even number.
pub fn median(figures: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    crate::stats::median(figures.into_iter().collect::<Option<Vec<f64>>>()?)
}

/// A ratio; none without both figures.
#[must_use]
pub fn ratio(part: Option<f64>, whole: Option<f64>) -> Option<f64> {
    Some(part? / whole?)
}

/// A sentence with values of a report in place of `{path}`. `{path:.2}` gives a number, or each of
/// a list, two decimals; `{path*100}` multiplies first.
#[must_use]
pub fn fill(sentence: &str, report: &Value) -> String {
    let mut parts = sentence.split('{');
    let mut filled = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (slot, rest) = part.split_once('}').unwrap_or((part, ""));
        filled.push_str(&shown(slot, report));
        filled.push_str(rest);
    }
    filled
}

/// One sentence for each item of a list.
pub fn each<'a>(report: &'a Value, path: &str, sentence: &'a str) -> impl Iterator<Item = String> + 'a {
    list(report, path).iter().map(move |item| fill(sentence, item))
}

fn shown(slot: &str, report: &Value) -> String {
    let (scaled, decimals) =
        slot.split_once(":.").map_or((slot, None), |(path, digits)| (path, digits.parse().ok()));
    let (path, factor) = scaled.split_once('*').unwrap_or((scaled, "1"));
    let number = |value: &Value| {
        let number = value.as_f64()? * factor.parse::<f64>().ok()?;
        Some(decimals.map_or_else(|| number.to_string(), |decimals: usize| format!("{number:.decimals$}")))
    };
    let unknown = || "unknown".to_owned();
    match value(report, path) {
        None | Some(Value::Null) => unknown(),
        Some(Value::String(text)) => text.clone(),
        Some(Value::Array(items)) if decimals.is_some() => {
            items.iter().map(|item| number(item).unwrap_or_else(unknown)).collect::<Vec<_>>().join(", ")
        }
        Some(value) => number(value).unwrap_or_else(|| value.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn figures_are_numbers_at_paths() {
        let report = json!({ "a": { "b": [1.5, "x"] }, "c": null });
        assert_eq!((at(&report, "a/b/0"), at(&report, "a/b/1"), at(&report, "c")), (Some(1.5), None, None));
        assert_eq!(
            (text(&report, "a/b/1"), list(&report, "a/b").len(), list(&report, "c").len()),
            (Some("x"), 2, 0)
        );
        assert_eq!((ratio(Some(3.0), Some(2.0)), ratio(None, Some(2.0))), (Some(1.5), None));
    }

    #[test]
    fn a_failed_run_has_no_figure_and_cannot_improve_the_result() {
        let runs = [Some(1.0), Some(3.0), Some(2.0)];
        assert_eq!((worst(runs), least(runs), median(runs)), (Some(3.0), Some(1.0), Some(2.0)));
        for failed in [&[Some(1.0), None][..], &[]] {
            let failed = || failed.iter().copied();
            assert_eq!((worst(failed()), least(failed()), median(failed())), (None, None, None));
        }
    }

    #[test]
    fn sentences_show_texts_numbers_and_lists() {
        let report =
            json!({ "name": "x", "share": 0.125, "whole": 60.0, "rounds": [1.0, 2.375], "lost": null });
        for (sentence, expected) in [
            ("{name}: {whole}, {share}", "x: 60, 0.125"),
            ("{share*100:.1} % of {whole:.2}", "12.5 % of 60.00"),
            ("rounds {rounds:.2}; {rounds}", "rounds 1.00, 2.38; [1.0,2.375]"),
            ("{lost} and {absent:.3}", "unknown and unknown"),
            ("nothing", "nothing"),
        ] {
            assert_eq!(fill(sentence, &report), expected);
        }
        let runs = json!({ "runs": [{ "n": 1 }, { "n": 2 }] });
        assert_eq!(each(&runs, "runs", "run {n}.").collect::<Vec<_>>(), ["run 1.", "run 2."]);
    }
}
