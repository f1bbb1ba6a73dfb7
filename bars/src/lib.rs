//! Figures beside the bars that they must keep.
//!
//! A program that measures owns a table of [`Bar`]s, prints it with [`text()`], writes it as JSON
//! under `bars`, and ends with an error if one is missed. Other programs read the JSON and judge
//! each figure again; the `met` in it is for people and scripts.
//!
//! A figure that is missing or not a number misses its bar. A figure that this machine cannot
//! produce is [`Figure::NotMeasured`] with a reason: neither met nor missed.

#![forbid(unsafe_code)]

pub mod figures;
mod record;
pub mod stats;
mod table;

pub use table::{markdown, text};

use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;

/// What a figure must keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// Strictly less: "under 3 s" excludes 3 s.
    Under(f64),
    /// Not more.
    AtMost(f64),
    /// Not less.
    AtLeast(f64),
    /// No bar, but the figure must exist.
    Reported,
}

/// What was measured.
#[derive(Clone, Debug, PartialEq)]
pub enum Figure {
    /// A value.
    Measured(f64),
    /// No value where there should be one. Misses every bar.
    Missing,
    /// This machine cannot produce the figure. Neither met nor missed.
    NotMeasured {
        /// What is lacking, such as "needs a GPU".
        reason: String,
    },
}

impl From<f64> for Figure {
    fn from(value: f64) -> Self {
        if value.is_nan() { Self::Missing } else { Self::Measured(value) }
    }
}

impl From<Option<f64>> for Figure {
    fn from(value: Option<f64>) -> Self {
        value.map_or(Self::Missing, Self::from)
    }
}

/// How a figure compares with its bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The bar is kept.
    Met,
    /// The bar is not kept, or the figure is missing.
    Missed,
    /// The figure has no bar.
    Reported,
    /// The figure could not be measured here.
    NotMeasured,
}

/// One row of a table.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "record::Record", into = "record::Record")]
pub struct Bar {
    /// What was measured.
    pub name: String,
    /// The figure.
    pub figure: Figure,
    /// Unit of figure and limit; empty for counts and shares.
    pub unit: Cow<'static, str>,
    /// The bar.
    pub limit: Limit,
    /// How the figure is defined, where the name does not say it.
    pub note: Option<String>,
}

impl Bar {
    /// A row without a note.
    pub fn new(
        name: impl Into<String>,
        figure: impl Into<Figure>,
        unit: impl Into<Cow<'static, str>>,
        limit: Limit,
    ) -> Self {
        Self { name: name.into(), figure: figure.into(), unit: unit.into(), limit, note: None }
    }

    /// A figure that must be less.
    pub fn under(name: impl Into<String>, figure: Option<f64>, unit: &'static str, limit: f64) -> Self {
        Self::new(name, figure, unit, Limit::Under(limit))
    }

    /// A figure that must not be more.
    pub fn at_most(name: impl Into<String>, figure: Option<f64>, unit: &'static str, limit: f64) -> Self {
        Self::new(name, figure, unit, Limit::AtMost(limit))
    }

    /// A figure that must not be less.
    pub fn at_least(name: impl Into<String>, figure: Option<f64>, unit: &'static str, limit: f64) -> Self {
        Self::new(name, figure, unit, Limit::AtLeast(limit))
    }

    /// A figure without a bar, which must exist.
    pub fn reported(name: impl Into<String>, figure: Option<f64>, unit: &'static str) -> Self {
        Self::new(name, figure, unit, Limit::Reported)
    }

    /// A count that must be 0.
    pub fn none(name: impl Into<String>, count: Option<f64>) -> Self {
        Self::at_most(name, count, "", 0.0)
    }

    /// A count that must not be 0: what a control found.
    pub fn some(name: impl Into<String>, count: Option<f64>) -> Self {
        Self::at_least(name, count, "", 1.0)
    }

    /// The row without its figure where this machine cannot produce it.
    #[must_use]
    pub fn not_measured_if(self, cannot: bool, reason: &str) -> Self {
        let figure = if cannot { Figure::NotMeasured { reason: reason.into() } } else { self.figure };
        Self { figure, ..self }
    }

    /// The row with a note.
    #[must_use]
    pub fn with_note(self, note: impl Into<String>) -> Self {
        Self { note: Some(note.into()), ..self }
    }

    /// How the figure compares with the bar.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let figure = match self.figure {
            Figure::Measured(figure) => figure,
            Figure::Missing => return Verdict::Missed,
            Figure::NotMeasured { .. } => return Verdict::NotMeasured,
        };
        // Comparisons with NaN are false, so a NaN misses every limit.
        let is_kept = match self.limit {
            Limit::Under(limit) => figure < limit,
            Limit::AtMost(limit) => figure <= limit,
            Limit::AtLeast(limit) => figure >= limit,
            Limit::Reported if figure.is_finite() => return Verdict::Reported,
            Limit::Reported => false,
        };
        if is_kept { Verdict::Met } else { Verdict::Missed }
    }

    /// Whether the bar is kept. False for a figure that was not measured.
    #[must_use]
    pub fn is_met(&self) -> bool {
        matches!(self.verdict(), Verdict::Met | Verdict::Reported)
    }

    /// Whether the bar is missed. False for a figure that was not measured.
    #[must_use]
    pub fn is_missed(&self) -> bool {
        self.verdict() == Verdict::Missed
    }
}

/// How many rows of a table have each verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Bars kept.
    pub met: usize,
    /// Bars missed.
    pub missed: usize,
    /// Figures without a bar.
    pub reported: usize,
    /// Figures that this machine cannot produce.
    pub not_measured: usize,
}

impl Summary {
    /// Counts the verdicts of a table.
    #[must_use]
    pub fn of(bars: &[Bar]) -> Self {
        let mut summary = Self::default();
        for bar in bars {
            match bar.verdict() {
                Verdict::Met => summary.met += 1,
                Verdict::Missed => summary.missed += 1,
                Verdict::Reported => summary.reported += 1,
                Verdict::NotMeasured => summary.not_measured += 1,
            }
        }
        summary
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { met, missed, not_measured, .. } = self;
        write!(f, "{met} bars met, {missed} missed, {not_measured} not measured")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(figure: impl Into<Figure>, limit: Limit) -> Verdict {
        Bar::new("x", figure, "s", limit).verdict()
    }

    #[test]
    fn every_limit_can_be_met_and_missed() {
        for (limit, met, missed) in [
            (Limit::Under(3.0), 2.999, 3.0),
            (Limit::AtMost(3.0), 3.0, 3.001),
            (Limit::AtLeast(3.0), 3.0, 2.999),
        ] {
            assert_eq!(verdict(met, limit), Verdict::Met, "{limit:?}");
            assert_eq!(verdict(missed, limit), Verdict::Missed, "{limit:?}");
        }
    }

    #[test]
    fn missing_figures_and_nan_miss_every_limit() {
        for limit in
            [Limit::Under(f64::MAX), Limit::AtMost(f64::MAX), Limit::AtLeast(f64::MIN), Limit::Reported]
        {
            assert_eq!(verdict(None, limit), Verdict::Missed);
            assert_eq!(verdict(f64::NAN, limit), Verdict::Missed);
            assert_eq!(verdict(Figure::Measured(f64::NAN), limit), Verdict::Missed);
        }
    }

    #[test]
    fn a_reported_figure_is_met_only_if_it_is_finite() {
        assert_eq!(verdict(0.0, Limit::Reported), Verdict::Reported);
        assert_eq!(verdict(f64::INFINITY, Limit::Reported), Verdict::Missed);
        assert!(Bar::new("x", 0.0, "", Limit::Reported).is_met());
    }

    #[test]
    fn what_was_not_measured_is_neither_met_nor_missed() {
        for limit in [Limit::AtMost(f64::MAX), Limit::AtLeast(f64::MIN), Limit::Reported] {
            let bar = Bar::new("x", 0.0, "ms", limit).not_measured_if(true, "needs a GPU");
            assert!(!bar.is_met() && !bar.is_missed());
            assert_eq!(bar.verdict(), Verdict::NotMeasured);
        }
    }

    #[test]
    fn the_summary_counts_each_verdict() {
        let bars = [
            Bar::new("a", 1.0, "", Limit::AtMost(1.0)),
            Bar::new("b", 2.0, "", Limit::AtMost(1.0)),
            Bar::new("c", None, "", Limit::AtMost(1.0)),
            Bar::new("d", 1.0, "", Limit::Reported),
            Bar::new("e", 0.0, "", Limit::AtMost(1.0)).not_measured_if(true, "needs a GPU"),
        ];
        let summary = Summary::of(&bars);
        assert_eq!(summary, Summary { met: 1, missed: 2, reported: 1, not_measured: 1 });
        assert_eq!(summary.to_string(), "1 bars met, 2 missed, 1 not measured");
    }
}
