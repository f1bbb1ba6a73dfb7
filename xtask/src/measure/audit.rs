//! `audit`: what can be counted of the honesty of figures and checks.
//!
//! Figures of other measurements come from the newest record of each machine that is not out of
//! date, the worst of the machines; a record without a row misses it.

use super::record_runs;
use super::run::Run;
use crate::ci::rehearsal;
use crate::process;
use crate::records::{self, record::Record, record::Row};
use crate::source::Files;
use anyhow::{Context, Result, bail};
use bars::{Bar, figures};
use toml::{Table, Value};

/// The table of findings.
const FINDINGS: &str = "docs/measurements/audit.toml";

/// Every row.
///
/// # Errors
/// Files cannot be read, or the table of findings is not one.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let files = Files::tracked()?;
    let table = files.0.get(FINDINGS).with_context(|| format!("there is no {FINDINGS}"))?;
    let findings = findings(table)?;
    let unsettled: Vec<_> = findings.iter().filter_map(|finding| finding.fault(&files)).collect();
    let blind = rehearsal::green_without_looking();
    let near_misses = NearMisses::of(run)?;
    let count = |count: usize| Some(count as f64);
    let (unfit, withdrawn) = (count(records::unfit_quotes()?), count(records::withdrawn()?));
    let differing = count(record_runs::faults()?.len());
    let mut rows = vec![
        Bar::none("findings of severity 2+ without a fix or an answer", count(unsettled.len())),
        Bar::none("records quoted in the README: stale, dirty, or of a single run", unfit),
        Bar::none("rows of records that differ from their runs in runs.csv", differing),
        Bar::reported(
            "figures of the README that are withdrawn until they are measured again",
            withdrawn,
            "",
        ),
        Bar::none(
            "ci steps that can be green without running",
            blind.as_ref().and_then(|all| count(all.len())),
        ),
        Bar::none("near-miss controls that pass a golden", near_misses.passed()),
    ];
    rows.extend(recorded(&records::of("streaming")?, &records::of("culling")?));
    run.notes.push(format!(
        "findings of severity 2+ without a fix or an answer: of {} in {FINDINGS}, whose files and texts are \
         looked up.",
        findings.len()
    ));
    run.notes.push(format!("Near misses rejected: {}.", near_misses.rejected.join("; ")));
    run.notes.extend(near_misses.passed.iter().map(|what| format!("A near miss passed: {what}.")));
    run.notes.extend(unsettled.iter().map(|fault| format!("Open: {fault}.")));
    run.notes.extend(blind.into_iter().flatten().map(|name| format!("Green without looking: {name}.")));
    Ok(rows)
}

/// Near misses of which each must have been compared, by a part of its name.
const NEAR_MISSES: [&str; 6] = [
    "without shadows",
    "the sun moved by 5 degrees",
    "one level coarser",
    "one octave less",
    "without a tree",
    "without plants",
];

/// Near misses as the golden tests report them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct NearMisses {
    rejected: Vec<String>,
    passed: Vec<String>,
    /// Whether a test failed.
    has_failed: bool,
}

impl NearMisses {
    /// Runs the golden tests. Without a GPU adapter they fail.
    fn of(run: &Run) -> Result<Self> {
        let report = run.file("near-misses.txt");
        // A report of an earlier run must not pass for one of this.
        let _ = std::fs::remove_file(&report);
        // Chosen among the workspace: one package alone would be built with other features.
        let mut tests = process::cargo("test --workspace --test pictures --test pictures_gallery");
        // All names end so, of one near miss or of several.
        tests.args(["--no-fail-fast", "the_comparison"]);
        tests.env("TOMBOLO_REQUIRE_GPU", "1").env("TOMBOLO_NEAR_MISSES", &report);
        let ended = process::status(&mut tests)?;
        let text = std::fs::read_to_string(&report).unwrap_or_default();
        Ok(Self { has_failed: !ended.success(), ..Self::parse(&text) })
    }

    fn parse(text: &str) -> Self {
        let with = |outcome: &str| {
            text.lines().filter_map(|line| line.strip_prefix(outcome)).map(str::to_owned).collect()
        };
        Self { rejected: with("rejected "), passed: with("passed "), has_failed: false }
    }

    /// How many passed; none if one of [`NEAR_MISSES`] was not compared, or a test failed for
    /// another reason.
    fn passed(&self) -> Option<f64> {
        let is_compared = |what: &&str| self.rejected.iter().any(|name| name.contains(what));
        let is_known = !self.passed.is_empty() || NEAR_MISSES.iter().all(is_compared) && !self.has_failed;
        is_known.then_some(self.passed.len() as f64)
    }
}

/// Rows that other measurements have recorded, judged here by the worst of the machines. A machine
/// without the row leaves no figure.
fn recorded(streaming: &[Record], culling: &[Record]) -> Vec<Bar> {
    let lowest = |what: &str| figures::least(streaming.iter().map(|one| number(one, what)));
    let hidden = "hidden chunks of grass that survive the chunk and block tests";
    let goodput = "five times the capacity: goodput over peak, worst round";
    let cached = lowest("whole frame to verified chunk, cached level");
    let hot = lowest("whole frame to verified chunk, hot level");
    let hidden = figures::worst(culling.iter().map(|one| number(one, hidden)));
    let goodput = figures::least(streaming.iter().map(|one| least_of_runs(one, goodput)));
    let over_best = "goodput at five times capacity over the best rate ever shown, worst round";
    vec![
        Bar::at_least("whole-frame decode, cached level, one thread", cached, "GB/s", 1.2),
        Bar::at_least("whole-frame decode, hot level, one thread", hot, "GB/s", 3.0),
        Bar::at_most("chunks of hidden grass that survive the chunk and block stage", hidden, "%", 20.0),
        Bar::at_least(over_best, goodput, "", 0.85),
    ]
}

/// The number of a row.
fn number(record: &Record, what: &str) -> Option<f64> {
    first_number(&row(record, what)?.figure)
}

/// The least number of a row over all runs: the median of worst rounds is not the worst.
fn least_of_runs(record: &Record, what: &str) -> Option<f64> {
    let row = row(record, what)?;
    first_number(&row.range).or_else(|| first_number(&row.figure))
}

fn first_number(text: &str) -> Option<f64> {
    text.split_whitespace().next()?.parse().ok()
}

/// A row; "the same, X" names X of the row before.
fn row<'a>(record: &'a Record, what: &str) -> Option<&'a Row> {
    let mut base = "";
    record.rows.iter().find(|row| {
        let more = row.what.strip_prefix("the same");
        base = if more.is_some() { base } else { &row.what };
        more.is_some_and(|more| what.strip_prefix(base) == Some(more)) || row.what == what
    })
}

/// A finding of the audit, and what is claimed to settle it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Finding {
    what: String,
    /// Texts that must be in a file: path and text.
    present: Vec<(String, String)>,
    /// Texts that must not.
    absent: Vec<(String, String)>,
    /// Files that must change.
    open: Vec<String>,
}

impl Finding {
    /// Why it is not settled; none if it is.
    fn fault(&self, files: &Files) -> Option<String> {
        let what = &self.what;
        if !self.open.is_empty() {
            return Some(format!("{what}: {}", self.open.join(", ")));
        }
        let joined = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        for (pairs, is_wanted) in [(&self.present, true), (&self.absent, false)] {
            for (path, text) in pairs {
                let Some(file) = files.0.get(path) else {
                    return Some(format!("{what}: {path} does not exist"));
                };
                // A comment marks each of its lines.
                let plain = joined(&file.replace("\n//!", "\n").replace("\n///", "\n"));
                if plain.contains(&joined(text)) != is_wanted {
                    let word = if is_wanted { "lacks" } else { "still has" };
                    return Some(format!("{what}: {path} {word} `{text}`"));
                }
            }
        }
        None
    }
}

/// The findings of severity 2 and more.
fn findings(text: &str) -> Result<Vec<Finding>> {
    let table: Table = text.parse().with_context(|| format!("{FINDINGS} is no table"))?;
    let all = table.get("finding").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    if all.is_empty() {
        bail!("{FINDINGS} has no findings");
    }
    let mut findings = Vec::new();
    for entry in all {
        let what = entry.get("what").and_then(Value::as_str).context("a finding does not say what")?;
        let severity = entry.get("severity").and_then(Value::as_integer).unwrap_or(5);
        if severity < 2 {
            continue;
        }
        let list = |key: &str| -> Vec<String> {
            let items = entry.get(key).and_then(Value::as_array).into_iter().flatten();
            items.filter_map(Value::as_str).map(str::to_owned).collect()
        };
        let pairs = |key: &str| -> Result<Vec<(String, String)>> {
            let split = |item: String| {
                let (path, text) = item
                    .split_once(" :: ")
                    .with_context(|| format!("{what}: `{item}` is no PATH :: TEXT"))?;
                Ok((path.to_owned(), text.to_owned()))
            };
            list(key).into_iter().map(split).collect()
        };
        let (answers, absent, open) = (pairs("answer")?, pairs("gone")?, list("open"));
        if answers.iter().any(|(path, _)| !path.starts_with("docs/measurements/")) {
            bail!("{what}: an answer stands in docs/measurements");
        }
        let present = [pairs("fixed")?, answers].concat();
        if present.is_empty() && absent.is_empty() && open.is_empty() {
            bail!("{what}: neither fixed, answered nor open");
        }
        findings.push(Finding { what: what.into(), present, absent, open });
    }
    Ok(findings)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(rows: &[(&str, &str)]) -> Record {
        let row = |(what, figure): &(&str, &str)| Row {
            what: (*what).into(),
            figure: (*figure).into(),
            ..Row::default()
        };
        Record { rows: rows.iter().map(row).collect(), ..Record::default() }
    }

    #[test]
    fn rows_of_records_are_judged_and_a_record_without_them_misses_all() {
        let streaming = |hot, worst| {
            record(&[
                ("whole frame to verified chunk, cached level", "1.3 GB/s"),
                ("whole frame to verified chunk, hot level", hot),
                ("five times the capacity: goodput over peak", "0.99"),
                ("the same, worst round", worst),
            ])
        };
        let culling = record(&[("hidden chunks of grass that survive the chunk and block tests", "19 %")]);
        let culling = [culling];
        let missed_by =
            |streaming: &[Record]| recorded(streaming, &culling).iter().filter(|b| b.is_missed()).count();
        let missed = |streaming: &Record| missed_by(std::slice::from_ref(streaming));
        assert_eq!(missed(&streaming("3.1 GB/s", "0.86")), 0);
        assert_eq!(missed(&streaming("2.9 GB/s", "0.86")), 1);
        assert_eq!(missed(&streaming("3.1 GB/s", "0.84")), 1);
        assert_eq!(missed(&streaming("missing", "0.84")), 2);
        // Of two runs the worse round counts, whatever the median says.
        let mut two_runs = streaming("3.1 GB/s", "0.86");
        two_runs.rows[3].range = "0.81 to 0.86".into();
        assert_eq!(missed(&two_runs), 1);
        // Of two machines the worse one counts, and one without the row leaves no figure.
        let (good, bad) = (streaming("3.1 GB/s", "0.86"), streaming("2.9 GB/s", "0.84"));
        assert_eq!(missed_by(&[good.clone(), good.clone()]), 0);
        assert_eq!((missed_by(&[good.clone(), bad.clone()]), missed_by(&[bad, good.clone()])), (2, 2));
        assert_eq!(missed_by(&[good, Record::default()]), 3);
        for none in [&[][..], &[Record::default()]] {
            assert_eq!(recorded(none, none).iter().filter(|bar| bar.is_missed()).count(), 4);
        }
    }

    #[test]
    fn near_misses_count_only_if_some_were_compared() {
        let passed = |text: &str, has_failed| NearMisses { has_failed, ..NearMisses::parse(text) }.passed();
        let all: String = NEAR_MISSES.iter().map(|what| format!("rejected start, {what}\n")).collect();
        assert_eq!(passed(&all, false), Some(0.0));
        assert_eq!(passed(&all.replace("without a tree", "blank"), false), None);
        assert_eq!(passed("rejected start, blank\npassed sea, x\n", true), Some(1.0));
        assert_eq!(passed(&all, true), None);
        assert_eq!(passed("", false), None);
    }

    fn fault(entry: &str) -> Option<String> {
        let files = Files::of(&[
            ("a.rs", "//! One thing\n//! is said.\nfn test() {}\n"),
            ("docs/measurements/b.md", "c"),
        ]);
        findings(&format!("[[finding]]\nwhat = \"x\"\nseverity = 3\n{entry}\n")).unwrap()[0].fault(&files)
    }

    #[test]
    fn a_finding_is_settled_only_by_what_exists() {
        assert_eq!(fault("fixed = [\"a.rs :: fn test()\"]"), None);
        assert_eq!(fault("fixed = [\"a.rs :: One thing is said.\"]"), None);
        assert_eq!(fault("answer = [\"docs/measurements/b.md :: c\"]"), None);
        assert_eq!(fault("gone = [\"a.rs :: fn other()\"]"), None);
        for entry in [
            "fixed = [\"a.rs :: fn other()\"]",
            "fixed = [\"a.rs :: fn test()\", \"b.rs :: fn test()\"]",
            "gone = [\"a.rs :: fn test()\"]",
            "gone = [\"b.rs :: fn test()\"]",
            "fixed = [\"a.rs :: fn test()\"]\nopen = [\"a.rs\"]",
            "open = [\"a.rs\"]",
        ] {
            assert!(fault(entry).is_some(), "{entry}");
        }
    }

    #[test]
    fn a_table_that_settles_nothing_is_an_error() {
        for text in [
            "",
            "x",
            "[[finding]]\nseverity = 3\nopen = [\"a\"]",
            "[[finding]]\nwhat = \"x\"\nseverity = 3",
            "[[finding]]\nwhat = \"x\"\nseverity = 3\nanswer = [\"src/a.rs :: b\"]",
            "[[finding]]\nwhat = \"x\"\nseverity = 3\nfixed = [\"src/a.rs\"]",
        ] {
            assert!(findings(text).is_err(), "{text}");
        }
        assert!(findings("[[finding]]\nwhat = \"x\"\nseverity = 1").unwrap().is_empty());
    }
}
