//! Outcomes of the checks of a run, and whether the run is green.

use std::fmt;
use std::time::Duration;

/// Outcome of one check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It looked and found nothing wrong.
    Passed,
    /// It found something, with the reason.
    Failed(String),
    /// It could not look.
    Skipped {
        /// The name of what is missing, for `--allow-skips`.
        lacks: &'static str,
        /// Why, and how to get it.
        reason: String,
    },
    /// The hardware does not have what it would look at. No package brings it.
    NotHere(String),
}

/// One line of the list at the end of a run.
#[derive(Clone, Debug)]
pub struct Line {
    /// The step.
    pub step: &'static str,
    /// The part of the step; empty for the step itself.
    pub part: String,
    /// The outcome.
    pub outcome: Outcome,
    /// How long the step took; none for its parts.
    pub took: Option<Duration>,
}

/// All lines of a run.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// In the order of the run.
    pub lines: Vec<Line>,
    /// Names of steps and tools that may be skipped.
    pub allowed: Vec<String>,
}

impl Report {
    /// Whether a skip of this line may be: its step or what it lacks is allowed by name.
    fn is_allowed(&self, line: &Line) -> bool {
        let Outcome::Skipped { lacks, .. } = &line.outcome else { return false };
        self.allowed.iter().any(|name| name == lacks || name == line.step)
    }

    /// Lines that keep the run from being green.
    pub fn faults(&self) -> impl Iterator<Item = &Line> {
        self.lines.iter().filter(|line| match line.outcome {
            Outcome::Passed | Outcome::NotHere(_) => false,
            Outcome::Failed(_) => true,
            Outcome::Skipped { .. } => !self.is_allowed(line),
        })
    }

    /// Whether everything that was to be looked at was looked at and is right. A run without a line
    /// that passed is not green.
    pub fn is_green(&self) -> bool {
        self.lines.iter().any(|line| line.outcome == Outcome::Passed) && self.faults().next().is_none()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for line in &self.lines {
            let word = match &line.outcome {
                Outcome::Passed => "passed",
                Outcome::Failed(_) => "FAILED",
                Outcome::Skipped { .. } if self.is_allowed(line) => "skipped",
                Outcome::Skipped { .. } => "SKIPPED",
                Outcome::NotHere(_) => "not here",
            };
            let name =
                if line.part.is_empty() { line.step.into() } else { format!("{}: {}", line.step, line.part) };
            write!(f, "{word:<8}  {name}")?;
            if let Some(took) = line.took {
                write!(f, ", {:.1} s", took.as_secs_f64())?;
            }
            match &line.outcome {
                Outcome::Passed => {}
                Outcome::Failed(why) | Outcome::NotHere(why) => write!(f, ": {why}")?,
                Outcome::Skipped { lacks, reason } => write!(f, ": {lacks}: {reason}")?,
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(outcomes: &[Outcome], allowed: &[&str]) -> Report {
        let line = |outcome: &Outcome| Line {
            step: "shaders",
            part: String::new(),
            outcome: outcome.clone(),
            took: None,
        };
        Report {
            lines: outcomes.iter().map(line).collect(),
            allowed: allowed.iter().map(|name| (*name).to_owned()).collect(),
        }
    }

    #[test]
    fn a_skip_is_green_only_if_its_step_or_tool_is_allowed_by_name() {
        let skip = Outcome::Skipped { lacks: "tint", reason: "not on PATH".into() };
        let outcomes = [Outcome::Passed, skip];
        for (allowed, green) in [
            (&["tint"][..], true),
            (&["node", "shaders"], true),
            (&["node"], false),
            (&[], false),
            (&["tin", "Tint", ""], false),
        ] {
            assert_eq!(report(&outcomes, allowed).is_green(), green, "{allowed:?}");
        }
    }

    #[test]
    fn what_the_hardware_lacks_is_green_and_a_failure_or_an_empty_run_never() {
        assert!(report(&[Outcome::Passed, Outcome::NotHere("no AVX-512".into())], &[]).is_green());
        assert!(!report(&[Outcome::Passed, Outcome::Failed("x".into())], &["shaders"]).is_green());
        assert!(!report(&[], &[]).is_green());
        assert!(!report(&[Outcome::NotHere("no AVX-512".into())], &[]).is_green());
    }

    #[test]
    fn the_list_shows_every_line_with_its_reason() {
        let outcomes = [
            Outcome::Passed,
            Outcome::Failed("two words differ".into()),
            Outcome::Skipped { lacks: "tint", reason: "not on PATH".into() },
            Outcome::NotHere("no AVX-512".into()),
        ];
        let expected = "passed    shaders\nFAILED    shaders: two words differ\n\
                        SKIPPED   shaders: tint: not on PATH\nnot here  shaders: no AVX-512\n";
        assert_eq!(report(&outcomes, &[]).to_string(), expected);
        assert!(report(&outcomes, &["tint"]).to_string().contains("\nskipped   shaders: tint"));
    }
}
