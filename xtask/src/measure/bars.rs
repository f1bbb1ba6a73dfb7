//! Figures beside their bars. A figure that is missing has missed.

use std::fmt;

/// What a figure must keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bar {
    /// Strictly less: "under 3 s" is not 3 s.
    Under(f64),
    /// Not more: "zero", or a bound that may be used up.
    AtMost(f64),
    /// Not less: a speed-up.
    AtLeast(f64),
    /// Anything, but there must be a figure.
    Reported,
    /// Under so much, but only on a GPU: a software driver cannot tell, so that there the row is
    /// neither kept nor missed.
    NeedsGpu(f64),
}

/// One row of a record.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What was measured.
    pub what: String,
    /// The figure, if it could be had.
    pub figure: Option<f64>,
    /// What it must keep.
    pub bar: Bar,
    /// Unit of figure and bar.
    pub unit: &'static str,
}

impl Row {
    /// A row.
    pub fn new(what: impl Into<String>, figure: Option<f64>, bar: Bar, unit: &'static str) -> Self {
        Self { what: what.into(), figure, bar, unit }
    }

    /// Whether the bar is not missed.
    pub fn is_met(&self) -> bool {
        match (self.figure, self.bar) {
            (Some(figure), Bar::Under(limit)) => figure < limit,
            (Some(figure), Bar::AtMost(limit)) => figure <= limit,
            (Some(figure), Bar::AtLeast(limit)) => figure >= limit,
            (Some(figure), Bar::Reported) => figure.is_finite(),
            (None, Bar::NeedsGpu(_)) => true,
            (Some(_), Bar::NeedsGpu(_)) | (None, _) => false,
        }
    }

    /// Figure, bar and verdict as three texts.
    pub fn cells(&self) -> [String; 3] {
        let missing = if matches!(self.bar, Bar::NeedsGpu(_)) { "not measured" } else { "missing" };
        let figure = self.figure.map_or(missing.into(), |figure| with_unit(figure, self.unit));
        let bar = match self.bar {
            Bar::Under(limit) => format!("under {}", with_unit(limit, self.unit)),
            Bar::AtMost(limit) => format!("at most {}", with_unit(limit, self.unit)),
            Bar::AtLeast(limit) => format!("at least {}", with_unit(limit, self.unit)),
            Bar::Reported => "reported".into(),
            Bar::NeedsGpu(limit) => format!("under {}", with_unit(limit, self.unit)),
        };
        let verdict = match (self.bar, self.is_met()) {
            (Bar::NeedsGpu(_), true) => "needs a GPU",
            (_, true) => "ok",
            (_, false) => "MISSED",
        };
        [figure, bar, verdict.into()]
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [figure, bar, verdict] = self.cells();
        write!(f, "{:<58} {figure:>14}   {bar:<18} {verdict}", self.what)
    }
}

/// The largest of several runs; none if there is none or one of them is missing, so that a lost run
/// cannot improve a figure.
pub fn worst(figures: &[Option<f64>]) -> Option<f64> {
    let figures: Option<Vec<f64>> = figures.iter().copied().collect();
    figures?.into_iter().reduce(f64::max)
}

fn with_unit(value: f64, unit: &str) -> String {
    // Whole numbers as such, the rest with three decimals: enough to tell a figure from its bar.
    let number = if value.fract() == 0.0 { format!("{value:.0}") } else { format!("{value:.3}") };
    if unit.is_empty() { number } else { format!("{number} {unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn met(figure: Option<f64>, bar: Bar) -> bool {
        Row::new("x", figure, bar, "s").is_met()
    }

    #[test]
    fn a_figure_on_the_bar_misses_under_and_meets_at_most() {
        assert!(met(Some(2.999), Bar::Under(3.0)) && !met(Some(3.0), Bar::Under(3.0)));
        assert!(met(Some(0.0), Bar::AtMost(0.0)) && met(Some(16.0), Bar::AtMost(16.0)));
        assert!(!met(Some(1.0), Bar::AtMost(0.0)));
        assert!(met(Some(40.0), Bar::AtLeast(40.0)) && !met(Some(39.999), Bar::AtLeast(40.0)));
        assert!(met(Some(0.0), Bar::Reported));
    }

    #[test]
    fn missing_and_meaningless_figures_miss() {
        for bar in [Bar::Under(f64::MAX), Bar::AtMost(f64::MAX), Bar::AtLeast(f64::MIN), Bar::Reported] {
            assert!(!met(None, bar) && !met(Some(f64::NAN), bar));
        }
    }

    #[test]
    fn the_worst_of_several_runs_counts_and_a_lost_run_is_the_worst() {
        assert_eq!(worst(&[Some(1.0), Some(3.0), Some(2.0)]), Some(3.0));
        assert_eq!(worst(&[Some(1.0), None]), None);
        assert_eq!(worst(&[]), None);
    }

    #[test]
    fn what_only_a_gpu_can_tell_is_neither_kept_nor_missed_without_one() {
        let row = Row::new("x", None, Bar::NeedsGpu(2.0), "ms");
        assert_eq!(row.cells(), ["not measured", "under 2 ms", "needs a GPU"]);
        assert!(row.is_met() && !met(Some(1.0), Bar::NeedsGpu(2.0)), "a figure wants a bar that judges it");
    }

    #[test]
    fn rows_show_figure_bar_and_verdict() {
        let cells = Row::new("x", Some(2.5), Bar::Under(3.0), "s").cells();
        assert_eq!(cells, ["2.500 s", "under 3 s", "ok"]);
        let cells = Row::new("x", None, Bar::AtMost(0.0), "").cells();
        assert_eq!(cells, ["missing", "at most 0", "MISSED"]);
        let cells = Row::new("x", Some(41.0), Bar::AtLeast(40.0), "x").cells();
        assert_eq!(cells, ["41 x", "at least 40 x", "ok"]);
        assert_eq!(Row::new("x", Some(1.0), Bar::Reported, "").cells(), ["1", "reported", "ok"]);
    }
}
