//! The report of a comparison: JSON, table, verdict.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The result of a run. Field names are a contract with scripts.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    pub probes: usize,
    /// The frozen digest that all must yield.
    pub expected: String,
    pub backends: Vec<Backend>,
    /// The float twin: on a GPU, or on this processor where there is none.
    pub control: Control,
    /// Whether no backend differs or fails, and the control differs.
    pub equal: bool,
}

/// One implementation on one machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Backend {
    /// Compiler and driver, for people.
    pub name: String,
    /// Of its words; none where it computed nothing.
    pub digest: Option<String>,
    pub state: State,
    /// Reason of a skip or a failure, or the first differences; else facts about the backend.
    pub detail: String,
    pub seconds: f64,
}

/// How a backend compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The expected digest.
    Equal,
    /// Another digest.
    Different,
    /// It was there and computed nothing: it crashed, gave up, or took too long.
    Failed,
    /// Not on this machine.
    Skipped,
}

/// The twin that must differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Control {
    /// What ran it.
    pub name: String,
    /// Of its words.
    pub digest: String,
    /// Whether it differs, as it must.
    pub differs: bool,
    /// How many of its words do.
    pub words_different: usize,
}

/// Results of the adapters of one process; a child of this program sends them as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdapterResults {
    /// One for every adapter, or one skipped entry without adapters.
    pub backends: Vec<Backend>,
    /// The float twin on the first adapter that ran it.
    pub control: Option<Control>,
}

impl Backend {
    /// One that is not on this machine.
    pub fn skipped(name: impl Into<String>, why: impl Into<String>) -> Self {
        Self { name: name.into(), digest: None, state: State::Skipped, detail: why.into(), seconds: 0.0 }
    }

    /// One that is there and computed nothing usable.
    pub fn failed(name: impl Into<String>, why: impl Into<String>, seconds: f64) -> Self {
        Self { name: name.into(), digest: None, state: State::Failed, detail: why.into(), seconds }
    }
}

impl Report {
    /// Whether everything holds.
    ///
    /// # Errors
    /// One line with what does not.
    pub fn verdict(&self) -> Result<(), String> {
        let first = |state: State| self.backends.iter().find(|backend| backend.state == state);
        // A wrong result is reported before a missing one.
        if let Some(backend) = first(State::Different) {
            return Err(format!("{} differs: {}", backend.name, backend.detail));
        }
        if let Some(backend) = first(State::Failed) {
            return Err(format!("{} failed: {}", backend.name, backend.detail));
        }
        if !self.control.differs {
            let name = &self.control.name;
            return Err(format!(
                "the float control on {name} equals the integers: the comparison detects nothing"
            ));
        }
        Ok(())
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} probes, expected digest {}", self.probes, self.expected)?;
        let width = self.backends.iter().map(|backend| backend.name.chars().count()).max().unwrap_or(0);
        let width = width.max(self.control.name.chars().count() + 9);
        for backend in &self.backends {
            let state = match backend.state {
                State::Equal => "equal",
                State::Different => "DIFFERENT",
                State::Failed => "FAILED",
                State::Skipped => "skipped",
            };
            // The JSON has all digits.
            let digest = backend.digest.as_deref().map_or("-", |digest| &digest[..16]);
            let Backend { name, detail, seconds, .. } = backend;
            let line = format!("{name:width$}  {digest:16}  {state:9}  {seconds:6.2} s  {detail}");
            writeln!(f, "{}", line.trim_end())?;
        }
        let Control { name, digest, differs, words_different } = &self.control;
        let state = if *differs { "differs, as it must" } else { "EQUAL: the comparison detects nothing" };
        let name = format!("control: {name}");
        writeln!(f, "{name:width$}  {:16}  {state} ({words_different} words)", &digest[..16])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(state: State, differs: bool) -> Report {
        let digest = "0".repeat(64);
        let control =
            Control { name: "f32".into(), digest: digest.clone(), differs, words_different: differs.into() };
        let detail = "at (0, 0) fine is 1, expected 2".into();
        let backend = Backend { name: "b".into(), digest: Some(digest.clone()), state, detail, seconds: 0.5 };
        Report { probes: 1, expected: digest, backends: vec![backend], control, equal: true }
    }

    #[test]
    fn a_differing_or_failed_backend_and_an_equal_control_are_errors() {
        assert_eq!(report(State::Equal, true).verdict(), Ok(()));
        assert_eq!(report(State::Skipped, true).verdict(), Ok(()));
        let different = report(State::Different, true).verdict().unwrap_err();
        assert!(different.contains("fine is 1, expected 2"), "{different}");
        let failed = report(State::Failed, true).verdict().unwrap_err();
        assert!(failed.starts_with("b failed: ") && !failed.contains("differs"), "{failed}");
        assert!(report(State::Equal, false).verdict().unwrap_err().contains("detects nothing"));
    }

    #[test]
    fn the_json_has_the_documented_fields() {
        let json = serde_json::to_value(report(State::Equal, true)).unwrap();
        assert_eq!(json["backends"][0]["state"], "equal");
        assert_eq!(serde_json::to_value(State::Failed).unwrap(), "failed");
        assert_eq!(json["control"]["words_different"], 1);
        assert_eq!((&json["probes"], &json["equal"]), (&1.into(), &true.into()));
    }

    #[test]
    fn the_table_has_a_line_for_every_backend_and_the_control() {
        let text = report(State::Different, true).to_string();
        assert_eq!(text.lines().count(), 3, "{text}");
        assert!(text.contains("DIFFERENT") && text.contains("as it must"), "{text}");
    }
}
