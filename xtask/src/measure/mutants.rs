//! `mutants`: whether tests notice a change of the code they test, by cargo-mutants.
//!
//! A mutant is the code with one operator or function body changed. Each is built and tested by its
//! package's tests. All of them take days: a run takes
//! the sample [`SHARD`]; `TOMBOLO_MUTANTS_SHARD=K/N` takes the K-th, from 0, of N samples.

use super::run::Run;
use crate::process;
use anyhow::{Context, Result, bail};
use bars::Bar;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Packages whose code is changed, and the folders in them.
const CODE: [(&str, &[&str]); 3] = [
    ("tombolo-terrain", &["terrain/src/**"]),
    ("tombolo-protocol", &["protocol/src/**"]),
    ("tombolo-server", &["server/src/limits/**", "server/src/session/**", "server/src/cache/**"]),
];

/// The sample: its number and how many there are.
const SHARD: &str = "0/64";

/// Survivors with the reason why no test notices them.
const REASONS: &str = "docs/measurements/mutants.toml";

/// The row that notes on survivors belong to.
const NOTICED: &str = "viable mutants that tests notice";

/// Reasons by the place of their mutants, one for each survivor.
type Reasons = BTreeMap<String, Vec<String>>;

/// A function without a test, whose mutants must survive.
const UNTESTED: &str = "pub fn is_even(value: u32) -> bool {\n    value % 2 == 0\n}\n";

/// Outcomes of the mutants of a run, each by its name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Outcomes {
    caught: Vec<String>,
    /// Those whose tests did not end; a failure, too.
    timeout: Vec<String>,
    missed: Vec<String>,
    /// Those that do not compile.
    unviable: Vec<String>,
}

/// Builds and tests the mutants of the sample.
///
/// # Errors
/// cargo-mutants is not installed, the unchanged code fails its tests, or the table of reasons is
/// not one.
pub fn rows(run: &mut Run) -> Result<Vec<Bar>> {
    let reasons = reasons(&fs::read_to_string(process::root().join(REASONS)).context(REASONS)?)?;
    let control = control(run)?;
    let shard = std::env::var("TOMBOLO_MUTANTS_SHARD").unwrap_or_else(|_| SHARD.into());
    let mut mutants = process::cargo("mutants --no-times --colors never --sharding round-robin");
    for (package, files) in CODE {
        mutants.args(["--package", package]);
        mutants.args(files.iter().flat_map(|files| ["--file", files]));
    }
    let outcomes = tested(mutants.args(["--shard", &shard]), &run.file("outcomes"))?;
    run.notes.push(format!(
        "Sample {shard} of the mutants of terrain, protocol, and the server's limits, sessions and caches."
    ));
    for (name, reason) in explained(&outcomes.missed, &reasons) {
        let reason = reason.unwrap_or("no reason is known");
        run.notes.push(format!("{NOTICED}: survived: {name}: {reason}."));
    }
    Ok(bars_of(&outcomes, &control, &reasons))
}

/// The rows. Without survivors in the control nothing counts.
fn bars_of(outcomes: &Outcomes, control: &Outcomes, reasons: &Reasons) -> Vec<Bar> {
    let noticed = (outcomes.caught.len() + outcomes.timeout.len()) as f64;
    let viable = noticed + outcomes.missed.len() as f64;
    let can_survive = !control.missed.is_empty();
    let share = (viable > 0.0 && can_survive).then(|| 100.0 * noticed / viable);
    let explained = explained(&outcomes.missed, reasons);
    let unexplained = explained.iter().filter(|(_, reason)| reason.is_none()).count();
    vec![
        Bar::at_least(NOTICED, share, "%", 95.0),
        Bar::reported("viable mutants", Some(viable), ""),
        Bar::reported("of these with tests that did not end", Some(outcomes.timeout.len() as f64), ""),
        Bar::reported("mutants that do not compile", Some(outcomes.unviable.len() as f64), ""),
        Bar::none("survivors without a reason", share.map(|_| unexplained as f64)),
        Bar::some("survivors of a function without a test (control)", Some(control.missed.len() as f64)),
    ]
}

/// The mutants of a package that has no test.
fn control(run: &Run) -> Result<Outcomes> {
    let folder = run.file("control");
    fs::create_dir_all(folder.join("src")).with_context(|| format!("cannot create {}", folder.display()))?;
    let manifest = "[package]\nname = \"untested\"\nedition = \"2024\"\n[workspace]\n";
    fs::write(folder.join("Cargo.toml"), manifest)?;
    fs::write(folder.join("src/lib.rs"), UNTESTED)?;
    let mut mutants = process::cargo("mutants --no-times --colors never --dir");
    tested(mutants.arg(&folder), &run.file("control-outcomes"))
}

/// Runs cargo-mutants and reads its lists.
fn tested(mutants: &mut std::process::Command, folder: &Path) -> Result<Outcomes> {
    // Lists of an earlier run must not pass for those of this.
    let _ = fs::remove_dir_all(folder);
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    // Each copy of the code has a target folder of its own: several at once must not take each
    // other's test programs.
    mutants.env_remove("CARGO_TARGET_DIR");
    let ended = process::status(mutants.arg("--output").arg(folder))?;
    if let Some(fault) = fault(ended.code()) {
        bail!("cargo-mutants: {fault} ({ended})");
    }
    let list = |name: &str| -> Result<Vec<String>> {
        let path: PathBuf = folder.join("mutants.out").join(name);
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        Ok(text.lines().map(str::to_owned).collect())
    };
    Ok(Outcomes {
        caught: list("caught.txt")?,
        timeout: list("timeout.txt")?,
        missed: list("missed.txt")?,
        unviable: list("unviable.txt")?,
    })
}

/// What a status of cargo-mutants says; none if it tested the mutants.
fn fault(code: Option<i32>) -> Option<&'static str> {
    match code {
        // All were noticed; some survived; some tests did not end.
        Some(0 | 2 | 3) => None,
        Some(1) => Some("it rejects its options; TOMBOLO_MUTANTS_SHARD is K/N with K less than N"),
        Some(4) => Some("the unchanged code does not build or fails its tests"),
        _ => Some("it is not installed or failed; run: cargo install cargo-mutants --locked"),
    }
}

/// Survivors, each with its reason. An entry of the table is the reason of one survivor: the same
/// change on two lines of a function needs two. Entries have no line, so that only their number is
/// compared.
fn explained<'a>(missed: &'a [String], reasons: &'a Reasons) -> Vec<(&'a str, Option<&'a str>)> {
    let mut left: BTreeMap<_, _> = reasons.iter().map(|(place, all)| (place.as_str(), all.iter())).collect();
    let reason = |name: &String| left.get_mut(place(name).as_str())?.next().map(String::as_str);
    missed.iter().map(String::as_str).zip(missed.iter().map(reason)).collect()
}

/// A mutant's name without its line and column, which any edit of the file changes.
fn place(name: &str) -> String {
    let mut parts = name.splitn(4, ':');
    match (parts.next(), parts.nth(2)) {
        (Some(file), Some(change)) => format!("{file}:{change}"),
        _ => name.into(),
    }
}

/// The table of reasons.
fn reasons(text: &str) -> Result<Reasons> {
    let table: Table = toml::from_str(text).context(REASONS)?;
    let survivors = table.get("survivor").and_then(Value::as_array).cloned().unwrap_or_default();
    let mut reasons = Reasons::new();
    for survivor in &survivors {
        let field = |name: &str| survivor.get(name)?.as_str().map(str::to_owned);
        let (name, reason) = field("name")
            .zip(field("reason"))
            .with_context(|| format!("{REASONS}: a survivor needs name and reason"))?;
        reasons.entry(name).or_default().push(reason);
    }
    Ok(reasons)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|index| format!("a.rs:{index}:5: replace f -> bool with true")).collect()
    }

    /// A table with so many entries of the place of all `names`.
    fn table(entries: usize) -> Reasons {
        let entry = "[[survivor]]\nname = \"a.rs: replace f -> bool with true\"\nreason = \"x\"\n";
        reasons(&entry.repeat(entries)).unwrap()
    }

    fn missed(outcomes: &Outcomes, control: usize, reasons: &Reasons) -> Vec<String> {
        let control = Outcomes { missed: names(control), ..Outcomes::default() };
        let rows = bars_of(outcomes, &control, reasons);
        rows.into_iter().filter(Bar::is_missed).map(|row| row.name).collect()
    }

    #[test]
    fn survivors_count_unless_their_place_has_a_reason() {
        let none = table(0);
        let most = Outcomes { caught: names(18), timeout: names(1), missed: names(1), ..Outcomes::default() };
        assert_eq!(missed(&most, 1, &none), ["survivors without a reason"]);
        assert!(missed(&most, 1, &table(1)).is_empty());
        let fewer = Outcomes { caught: names(17), ..most };
        assert_eq!(missed(&fewer, 1, &none)[0], NOTICED);
    }

    #[test]
    fn a_reason_covers_one_survivor_of_its_place() {
        let two = Outcomes { caught: names(38), missed: names(2), ..Outcomes::default() };
        assert_eq!(missed(&two, 1, &table(1)), ["survivors without a reason"]);
        assert!(missed(&two, 1, &table(2)).is_empty());
        assert!(missed(&two, 1, &table(3)).is_empty());
        let (one, elsewhere) = (table(1), ["b.rs:0:5: replace f -> bool with true".to_owned()]);
        let reasons_of =
            |missed| explained(missed, &one).into_iter().map(|(_, reason)| reason).collect::<Vec<_>>();
        assert_eq!(reasons_of(&two.missed), [Some("x"), None]);
        assert!(reasons_of(&elsewhere)[0].is_none());
    }

    #[test]
    fn only_a_status_after_tested_mutants_is_no_fault() {
        assert!([0, 2, 3].iter().all(|code| fault(Some(*code)).is_none()));
        let says = |code, what: &str| fault(code).is_some_and(|fault| fault.contains(what));
        assert!(says(Some(1), "options") && says(Some(4), "unchanged code"));
        for other in [Some(5), Some(70), Some(101), None] {
            assert!(says(other, "installed") && !says(other, "unchanged code"), "{other:?}");
        }
    }

    #[test]
    fn nothing_counts_without_mutants_or_without_a_control_that_survives() {
        let all = Outcomes { caught: names(20), ..Outcomes::default() };
        assert!(missed(&all, 1, &Reasons::new()).is_empty());
        assert_eq!(missed(&all, 0, &Reasons::new()).len(), 3);
        assert_eq!(missed(&Outcomes::default(), 1, &Reasons::new()).len(), 2);
    }

    #[test]
    fn the_mutated_folders_exist() {
        for folder in CODE.iter().flat_map(|(_, files)| *files) {
            let folder = folder.strip_suffix("/**").unwrap();
            assert!(process::root().join(folder).is_dir(), "{folder}");
        }
        let table = fs::read_to_string(process::root().join(REASONS)).unwrap();
        assert!(reasons(&table).is_ok());
    }
}
