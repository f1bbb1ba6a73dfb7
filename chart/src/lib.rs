//! Charts: panels of curves with their axes, Pareto fronts of choices, and traces over time.

mod chart;
mod draw;
mod labels;
mod picture;
mod scale;

pub use chart::Chart;

use std::ops::Range;

/// Width of a line that covers no other, and what it gains with every line that it would vanish
/// under, pixels.
const LINE: (u32, u32) = (2, 4);

/// Lines nearer than this share of the axis cannot be distinguished.
const COINCIDES: f64 = 0.004;

/// How numbers map to pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// By their decimal logarithm; values that are not positive are left out.
    Log,
}

/// One axis: what it counts, with its unit.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    /// Quantity and unit.
    pub label: &'static str,
    /// How its numbers map to pixels.
    pub scale: Scale,
}

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    /// A line with a dot at each measured value.
    Measured,
    /// A line without dots. A value that the axes cannot show is a gap; one between two gaps has a
    /// dot.
    Trace,
    /// A dashed line without dots: a bound or a bar.
    Stated,
    /// Grey dots: choices for which another one is better in both respects.
    Dominated,
    /// Grey crosses: controls.
    Control,
    /// Rings around dots of other series: the default.
    Shipped,
}

/// One curve.
#[derive(Clone, Debug)]
pub struct Series {
    /// Its name in the legend.
    pub label: String,
    /// Measured or stated.
    pub stroke: Stroke,
    /// Values, in order of x.
    pub points: Vec<(f64, f64)>,
    /// Labels of the points; there may be fewer labels than points.
    pub names: Vec<String>,
}

/// One setting of a knob: its cost and its error, of both of which less is better.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Its name, written beside its dot.
    pub name: String,
    /// Its place in the diagram.
    pub at: (f64, f64),
    /// Whether it is the default.
    pub is_shipped: bool,
}

/// A range of x with a background and a name.
#[derive(Clone, Debug)]
pub struct Band {
    /// Its name, at its left end.
    pub name: String,
    /// From and to.
    pub range: Range<f64>,
}

/// One diagram.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Above the plot.
    pub title: String,
    /// From left to right.
    pub x: Axis,
    /// From bottom to top.
    pub y: Axis,
    /// At most six curves.
    pub series: Vec<Series>,
    /// Behind the curves.
    pub bands: Vec<Band>,
    /// Range of x if it does not follow from the curves; such a panel may be empty.
    x_range: Option<Range<f64>>,
    /// Whether a linear y axis begins at 0.
    is_from_zero: bool,
}

/// A linear axis.
pub const fn linear(label: &'static str) -> Axis {
    Axis { label, scale: Scale::Linear }
}

/// A logarithmic axis.
pub const fn log(label: &'static str) -> Axis {
    Axis { label, scale: Scale::Log }
}

fn series(label: impl Into<String>, stroke: Stroke, points: impl IntoIterator<Item = (f64, f64)>) -> Series {
    Series { label: label.into(), stroke, points: points.into_iter().collect(), names: Vec::new() }
}

fn named(label: &str, stroke: Stroke, choices: impl IntoIterator<Item = Choice>) -> Series {
    let (points, names) = choices.into_iter().map(|choice| (choice.at, choice.name)).unzip();
    Series { label: label.into(), stroke, points, names }
}

/// The Pareto front joined by a line, dominated choices in grey, a ring around the default. Choices
/// that could not be measured are left out.
fn front(choices: &[Choice]) -> Vec<Series> {
    let known = |choice: &&Choice| choice.at.0.is_finite() && choice.at.1.is_finite();
    let choices: Vec<&Choice> = choices.iter().filter(known).collect();
    let is_dominated = |choice: &&Choice| {
        let (x, y) = choice.at;
        choices.iter().any(|other| {
            let (a, b) = other.at;
            a <= x && b <= y && (a < x || b < y)
        })
    };
    let (dominated, mut best): (Vec<&Choice>, Vec<&Choice>) =
        choices.iter().partition(|choice| is_dominated(choice));
    best.sort_by(|one, two| one.at.0.total_cmp(&two.at.0));
    let best = best.into_iter().cloned();
    let mut all = vec![named("nothing is better in both respects", Stroke::Measured, best)];
    if !dominated.is_empty() {
        all.push(named("dominated", Stroke::Dominated, dominated.into_iter().cloned()));
    }
    let shipped: Vec<_> = choices.iter().filter(|choice| choice.is_shipped).map(|choice| choice.at).collect();
    if !shipped.is_empty() {
        all.push(series("the default", Stroke::Shipped, shipped));
    }
    all
}

impl Panel {
    /// A panel without curves.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Self {
        Self {
            title: title.into(),
            x,
            y,
            series: Vec::new(),
            bands: Vec::new(),
            x_range: None,
            is_from_zero: false,
        }
    }

    /// Sets the range of x. The panel may then be empty.
    pub fn over(self, x_range: Range<f64>) -> Self {
        Self { x_range: Some(x_range), ..self }
    }

    /// Begins a linear y axis at 0.
    pub fn from_zero(self) -> Self {
        Self { is_from_zero: true, ..self }
    }

    /// Adds named backgrounds.
    pub fn bands(mut self, bands: impl IntoIterator<Item = Band>) -> Self {
        self.bands.extend(bands);
        self
    }

    /// Adds a line without dots, with gaps; see [`Stroke::Trace`].
    pub fn trace(self, label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with([series(label, Stroke::Trace, points)])
    }

    /// Adds a measured curve.
    pub fn line(self, label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with([series(label, Stroke::Measured, points)])
    }

    /// Adds a stated bound or bar.
    pub fn bound(self, label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with([series(label, Stroke::Stated, points)])
    }

    /// Adds the Pareto front of choices, dominated choices in grey, a ring around the default.
    pub fn front(self, choices: &[Choice]) -> Self {
        self.with(front(choices))
    }

    /// Adds controls, which are no choices.
    pub fn controls(self, choices: impl IntoIterator<Item = Choice>) -> Self {
        self.with([named("controls", Stroke::Control, choices)])
    }

    fn with(mut self, series: impl IntoIterator<Item = Series>) -> Self {
        self.series.extend(series);
        self
    }

    /// Whether the axes can show a point.
    fn shows(&self, (x, y): (f64, f64)) -> bool {
        let fits = |value: f64, scale: Scale| value.is_finite() && (scale == Scale::Linear || value > 0.0);
        fits(x, self.x.scale) && fits(y, self.y.scale)
    }

    /// Width of a line: it shows on both sides of every later one that lies on it.
    fn width(&self, index: usize) -> u32 {
        let over =
            self.series.iter().skip(index + 1).filter(|later| self.coincide(&self.series[index], later));
        LINE.0 + LINE.1 * over.count() as u32
    }

    /// Whether two curves are one over two measured values or more.
    fn coincide(&self, one: &Series, other: &Series) -> bool {
        let place = |value: f64| if self.y.scale == Scale::Log { value.log10() } else { value };
        let heights = |series: &Series| -> Vec<(f64, f64)> {
            let shown = series.points.iter().copied().filter(|point| self.shows(*point));
            shown.map(|(x, y)| (x, place(y))).collect()
        };
        let all: Vec<f64> = self.series.iter().flat_map(heights).map(|(_, y)| y).collect();
        let (low, high) = all.iter().fold((f64::MAX, f64::MIN), |(low, high), y| (low.min(*y), high.max(*y)));
        let near = (high - low) * COINCIDES;
        let other = heights(other);
        let meets =
            |(x, y): &(f64, f64)| other.iter().any(|(its_x, its_y)| its_x == x && (its_y - y).abs() <= near);
        heights(one).iter().filter(|point| meets(point)).count() >= 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_has_the_choices_that_none_dominates() {
        let choice = |at: (f64, f64)| Choice { name: format!("{at:?}"), at, is_shipped: at == (2.5, 2.0) };
        let choices =
            [(3.0, 1.0), (1.0, 3.0), (2.0, 2.0), (2.5, 2.0), (3.0, 3.0), (f64::NAN, 0.0)].map(choice);
        let series = front(&choices);
        assert_eq!(series[0].points, [(1.0, 3.0), (2.0, 2.0), (3.0, 1.0)]);
        assert_eq!(series[0].names, ["(1.0, 3.0)", "(2.0, 2.0)", "(3.0, 1.0)"], "names stay with their dots");
        assert_eq!((series[1].stroke, series[1].points.len()), (Stroke::Dominated, 2));
        assert_eq!(
            (series[2].stroke, series[2].points.as_slice()),
            (Stroke::Shipped, [(2.5, 2.0)].as_slice())
        );
        assert_eq!(front(&[choice((1.0, 1.0))]).len(), 1, "nothing is beaten, nothing ships");
    }

    #[test]
    fn a_line_under_another_is_wider_than_it() {
        let points = |last: f64| [(0.0, 1.0), (1.0, 2.0), (2.0, last)];
        let panel = Panel::new("test", linear("x"), linear("y"))
            .line("under", points(3.0))
            .line("over", points(4.0))
            .line("apart", [(0.0, 9.0), (2.0, 8.0)]);
        assert_eq!([0, 1, 2].map(|index| panel.width(index)), [6, 2, 2]);
    }
}
