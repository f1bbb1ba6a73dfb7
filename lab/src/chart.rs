//! Charts: panels of curves as one PNG, with the fonts that the viewer embeds; no system fonts.

use anyhow::{Context, Result, anyhow};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use std::ops::Range;
use std::path::Path;
use std::sync::Once;

/// Width and height of one panel, pixels.
const PANEL: (u32, u32) = (860, 660);

/// Pixels above the panels for the title.
const TITLE: u32 = 64;

/// Height of a line of the legend, width of the stroke that it shows, and what is free around its
/// text, pixels.
const LEGEND: (u32, i32, i32) = (28, 30, 14);

/// Distance from the left end of a panel to its legend: that of the axis.
const LEGEND_LEFT: i32 = 108;

/// Width of a line that covers no other, and what it gains with every line that it would vanish
/// under, pixels.
const LINE: (u32, u32) = (2, 4);

/// Radius of the ring around the default, pixels.
const RING: i32 = 10;

/// Lines nearer than this share of the axis cannot be distinguished.
const COINCIDES: f64 = 0.004;

const FONT: &str = "lab";
const INK: RGBColor = RGBColor(40, 44, 52);
const GREY: RGBColor = RGBColor(178, 182, 190);
const FAINT: RGBColor = RGBColor(226, 229, 234);

/// Distinguishable for colour-blind readers too (Okabe and Ito, "Color Universal Design", 2008).
const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(120, 120, 120),
];

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
    /// Linear or logarithmic.
    pub scale: Scale,
}

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    /// A line with a dot at each measured value.
    Measured,
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

/// One diagram.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Its title.
    pub title: &'static str,
    /// Across.
    pub x: Axis,
    /// Up.
    pub y: Axis,
    /// At most six curves.
    pub series: Vec<Series>,
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

/// Draws panels, two in a row, and writes the PNG.
///
/// # Errors
/// The file cannot be written, or a curve has nothing that its axes can show.
pub fn write(path: &Path, title: &str, panels: &[Panel]) -> Result<()> {
    static FONTS: Once = Once::new();
    FONTS.call_once(|| {
        // The only failure is a file that is no font; text would then be reported missing below.
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
    let columns = panels.len().clamp(1, 2);
    let rows = panels.len().div_ceil(columns).max(1);
    let (width, height) = (PANEL.0 * columns as u32, PANEL.1 * rows as u32 + TITLE);
    let mut pixels = vec![255; (width * height * 3) as usize];
    {
        let root = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
        draw(&root, title, panels, (rows, columns))
            .map_err(|cause| anyhow!("cannot draw `{title}`: {cause}"))?;
    }
    image::save_buffer(path, &pixels, width, height, image::ColorType::Rgb8)
        .with_context(|| format!("--out: cannot write `{}`", path.display()))
}

/// Errors of plotters borrow the backend's error type; as text they are `'static`.
trait OrText<T> {
    fn or_text(self) -> Result<T>;
}

impl<T, E: std::fmt::Display> OrText<T> for std::result::Result<T, E> {
    fn or_text(self) -> Result<T> {
        self.map_err(|cause| anyhow!("{cause}"))
    }
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

fn draw(root: &Area<'_>, title: &str, panels: &[Panel], (rows, columns): (usize, usize)) -> Result<()> {
    let (head, body) = root.split_vertically(TITLE);
    head.draw(&Text::new(title.to_owned(), (34, 22), (FONT, 30).into_font().color(&INK))).or_text()?;
    for (panel, area) in panels.iter().zip(body.split_evenly((rows, columns))) {
        let x = range(panel, panel.x.scale, false, |point| point.0)?;
        let y = range(panel, panel.y.scale, true, |point| point.1)?;
        let log = |range: Range<f64>| {
            let ticks = log_ticks(&range);
            range.log_scale().with_key_points(ticks)
        };
        match (panel.x.scale, panel.y.scale) {
            (Scale::Linear, Scale::Linear) => draw_panel(&area, panel, x, y),
            (Scale::Linear, Scale::Log) => draw_panel(&area, panel, x, log(y)),
            (Scale::Log, Scale::Linear) => draw_panel(&area, panel, log(x), y),
            (Scale::Log, Scale::Log) => draw_panel(&area, panel, log(x), log(y)),
        }?;
    }
    root.present().or_text()
}

fn draw_panel<X, Y>(area: &Area<'_>, panel: &Panel, x: X, y: Y) -> Result<()>
where
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let text = |size: u32| (FONT, size).into_font().color(&INK);
    let legend = panel.legend(area)?;
    let height = area.dim_in_pixel().1.saturating_sub(LEGEND.0 * legend.len() as u32);
    let (plot, below) = area.split_vertically(height);
    let mut chart = ChartBuilder::on(&plot)
        .margin(16)
        .margin_right(34)
        .caption(panel.title, text(24))
        .x_label_area_size(58)
        .y_label_area_size(92)
        .build_cartesian_2d(x, y)
        .or_text()?;
    chart
        .configure_mesh()
        .x_desc(panel.x.label)
        .y_desc(panel.y.label)
        .x_label_formatter(&|value| tick(panel.x.scale, *value))
        .y_label_formatter(&|value| tick(panel.y.scale, *value))
        .label_style(text(18))
        .axis_desc_style(text(20))
        .axis_style(INK)
        .bold_line_style(FAINT)
        .light_line_style(TRANSPARENT)
        .draw()
        .or_text()?;
    for (index, (series, colour)) in panel.series.iter().zip(COLOURS).enumerate() {
        let shown: Vec<(f64, f64)> =
            series.points.iter().copied().filter(|point| panel.shows(*point)).collect();
        let width = panel.width(index);
        match series.stroke {
            Stroke::Measured => {
                let dots = shown.iter().map(|point| Circle::new(*point, width / 2 + 3, colour.filled()));
                chart.draw_series(dots).or_text()?;
                chart.draw_series(LineSeries::new(shown, colour.stroke_width(width)))
            }
            Stroke::Stated => {
                chart.draw_series(DashedLineSeries::new(shown, 9, 6, colour.stroke_width(width)))
            }
            Stroke::Dominated => {
                chart.draw_series(shown.iter().map(|point| Circle::new(*point, 5, GREY.filled())))
            }
            Stroke::Control => {
                chart.draw_series(shown.iter().map(|point| Cross::new(*point, 5, GREY.stroke_width(3))))
            }
            Stroke::Shipped => {
                chart.draw_series(shown.iter().map(|point| Circle::new(*point, RING, INK.stroke_width(2))))
            }
        }
        .or_text()?;
    }
    let place = |point: &(f64, f64)| chart.backend_coord(point);
    let shown = panel.series.iter().flat_map(|series| &series.points).filter(|point| panel.shows(**point));
    let mut taken: Vec<Bounds> = shown.map(|point| Bounds::around(place(point))).collect();
    let (across, up) = chart.plotting_area().get_pixel_range();
    let frame = Bounds { low: (across.start, up.start), high: (across.end, up.end) };
    let font = (FONT, 16).into_font().color(&INK);
    for series in &panel.series {
        for (point, name) in series.points.iter().zip(&series.names).filter(|(point, _)| panel.shows(**point))
        {
            let size = area.estimate_text_size(name, &font).or_text()?;
            let corner = free(place(point), (size.0 as i32, size.1 as i32), &frame, &mut taken);
            let (left, top) = area.get_base_pixel();
            let text = Text::new(name.clone(), (corner.0 - left, corner.1 - top), font.clone());
            area.draw(&text).or_text()?;
        }
    }
    for (row, entries) in legend.iter().enumerate() {
        let middle = (LEGEND.0 * row as u32 + LEGEND.0 / 2) as i32 - 6;
        for Entry { series: index, left } in entries {
            let (series, colour, width) = (&panel.series[*index], COLOURS[*index], panel.width(*index));
            let label = Text::new(series.label.clone(), (left + LEGEND.1 + 4, middle - 7), text(18));
            below.draw(&label).or_text()?;
            let alone = match series.stroke {
                Stroke::Dominated => Some(Circle::new((left + 13, middle), 5, GREY.filled())),
                Stroke::Shipped => Some(Circle::new((left + 13, middle), RING, INK.stroke_width(2))),
                Stroke::Measured | Stroke::Stated | Stroke::Control => None,
            };
            if let Some(circle) = alone {
                below.draw(&circle).or_text()?;
                continue;
            }
            if series.stroke == Stroke::Control {
                let cross = Cross::new((left + 13, middle), 5, GREY.stroke_width(3));
                below.draw(&cross).or_text()?;
                continue;
            }
            let is_measured = series.stroke == Stroke::Measured;
            let gap = if is_measured { 0 } else { 4 };
            let style = colour.stroke_width(width);
            let piece = |from: i32, to: i32| {
                PathElement::new(vec![(left + from, middle), (left + to, middle)], style)
            };
            below.draw(&piece(0, 13 - gap)).or_text()?;
            below.draw(&piece(13 + gap, 26)).or_text()?;
            if is_measured {
                below.draw(&Circle::new((left + 13, middle), width / 2 + 3, colour.filled())).or_text()?;
            }
        }
    }
    Ok(())
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Bounds {
    low: (i32, i32),
    high: (i32, i32),
}

impl Bounds {
    /// Bounds of a dot.
    const fn around((x, y): (i32, i32)) -> Self {
        Self { low: (x - 7, y - 7), high: (x + 7, y + 7) }
    }

    const fn meets(&self, other: &Self) -> bool {
        self.low.0 < other.high.0
            && other.low.0 < self.high.0
            && self.low.1 < other.high.1
            && other.low.1 < self.high.1
    }

    const fn holds(&self, other: &Self) -> bool {
        self.low.0 <= other.low.0
            && other.high.0 <= self.high.0
            && self.low.1 <= other.low.1
            && other.high.1 <= self.high.1
    }
}

/// Upper left corner of a label beside its dot where it covers neither dots nor labels, and
/// reserves it. Lines may pass under it. In a crowd the first corner is taken.
fn free(
    (x, y): (i32, i32),
    (width, height): (i32, i32),
    frame: &Bounds,
    taken: &mut Vec<Bounds>,
) -> (i32, i32) {
    let (right, left, above, below) = (x + 12, x - 12 - width, y - 6 - height, y + 6);
    let beside = y - height / 2;
    let corners =
        [(right, above), (right, beside), (right, below), (left, below), (left, beside), (left, above)];
    let boxed = |corner: (i32, i32)| Bounds { low: corner, high: (corner.0 + width, corner.1 + height) };
    let is_free = |name: &Bounds| frame.holds(name) && !taken.iter().any(|other| other.meets(name));
    let corner = corners.into_iter().find(|corner| is_free(&boxed(*corner))).unwrap_or(corners[0]);
    taken.push(boxed(corner));
    corner
}

/// A series in the legend, and how far right it begins.
struct Entry {
    series: usize,
    left: i32,
}

impl Panel {
    /// A panel without curves.
    pub fn new(title: &'static str, x: Axis, y: Axis) -> Self {
        Self { title, x, y, series: Vec::new() }
    }

    /// Adds a measured curve.
    pub fn line(self, label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with([series(label, Stroke::Measured, points)])
    }

    /// Adds a stated bound or bar.
    pub fn bound(self, label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with([series(label, Stroke::Stated, points)])
    }

    /// Adds the Pareto front of choices, see [`front`].
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

    fn shows(&self, (x, y): (f64, f64)) -> bool {
        let fits = |value: f64, scale: Scale| value.is_finite() && (scale == Scale::Linear || value > 0.0);
        fits(x, self.x.scale) && fits(y, self.y.scale)
    }

    /// The lines of the legend, below the plot: there it covers no curve. A single curve is named
    /// by its axis.
    fn legend(&self, area: &Area<'_>) -> Result<Vec<Vec<Entry>>> {
        let mut rows: Vec<Vec<Entry>> = Vec::new();
        if self.series.len() < 2 {
            return Ok(rows);
        }
        let font = (FONT, 18).into_font().into_text_style(area);
        let mut left = i32::MAX;
        for (series, Series { label, .. }) in self.series.iter().enumerate().take(COLOURS.len()) {
            let text = area.estimate_text_size(label, &font).or_text()?;
            let width = LEGEND.1 + text.0 as i32 + 2 * LEGEND.2;
            if left.saturating_add(width) > PANEL.0 as i32 {
                rows.push(Vec::new());
                left = LEGEND_LEFT;
            }
            rows.last_mut().into_iter().for_each(|row| row.push(Entry { series, left }));
            left += width;
        }
        Ok(rows)
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

/// Ticks of a logarithmic axis: decades over many of them, else their halves and fifths too.
fn log_ticks(range: &Range<f64>) -> Vec<f64> {
    let (low, high) = (range.start.log10(), range.end.log10());
    let leads: &[f64] = match high - low {
        span if span > 2.5 => &[1.0],
        span if span > 1.0 => &[1.0, 2.0, 5.0],
        _ => &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0],
    };
    // The ends of a range are computed and may be off by their last bits.
    let within = |value: &f64| (range.start * 0.999_999..=range.end * 1.000_001).contains(value);
    (low.floor() as i32..=high.ceil() as i32)
        .flat_map(|power| leads.iter().map(move |lead| lead * 10f64.powi(power)))
        .filter(within)
        .collect()
}

/// The range of an axis: whole decades upwards, else a little air around the values, a little more
/// above them.
fn range(panel: &Panel, scale: Scale, is_up: bool, pick: impl Fn(&(f64, f64)) -> f64) -> Result<Range<f64>> {
    let shown = panel.series.iter().flat_map(|series| &series.points).filter(|point| panel.shows(**point));
    let (low, high) = shown.map(pick).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    // Names stand to the right of their dots.
    let is_named = panel.series.iter().any(|series| !series.names.is_empty());
    if low > high {
        return Err(anyhow!("`{}` has nothing to show", panel.title));
    }
    Ok(match scale {
        Scale::Log if is_up => {
            let (low, high) = ((low.log10() + 1e-6).floor(), (high.log10() - 1e-6).ceil());
            10f64.powf(low)..10f64.powf(high.max(low + 1.0))
        }
        Scale::Log => low / 1.2..high * if is_named { 1.4 } else { 1.2 },
        Scale::Linear => {
            let low = if low >= 0.0 && low < 0.5 * high { low.min(0.0) } else { low - (high - low) * 0.06 };
            let air = if is_up {
                0.08
            } else if is_named {
                0.14
            } else {
                0.04
            };
            low..high + ((high - low) * air).max(1e-9)
        }
    })
}

/// A number on an axis. On a logarithmic one, plain from 0.001 to 10,000 and else by its power of
/// ten, so that neighbours look alike.
fn tick(scale: Scale, value: f64) -> String {
    let magnitude = value.abs();
    // Computed powers of ten are off by their last bits.
    let plain = match scale {
        Scale::Log => 0.000_999..10_001.0,
        Scale::Linear => 1e-4..1e6,
    };
    if magnitude != 0.0 && !plain.contains(&magnitude) {
        let power = (magnitude.log10() + 1e-9).floor();
        let lead = value / 10f64.powf(power);
        let lead = format!("{lead:.1}");
        return format!("{}e{power}", lead.trim_end_matches(".0"));
    }
    let text = format!("{value:.4}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_on_axes_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (1.0, "1"),
            (0.25, "0.25"),
            (0.0001, "0.0001"),
            (1e-6, "1e-6"),
            (4.2e6, "4.2e6"),
            (5e6, "5e6"),
        ] {
            assert_eq!(tick(Scale::Linear, value), text);
        }
        let decades: Vec<String> = (-5..=6).map(|power| tick(Scale::Log, 10f64.powi(power))).collect();
        let texts = ["1e-5", "1e-4", "0.001", "0.01", "0.1", "1", "10", "100", "1000", "10000", "1e5", "1e6"];
        assert_eq!(decades, texts);
    }

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
    fn a_logarithmic_axis_has_ticks_from_its_first_value_to_its_last() {
        assert_eq!(log_ticks(&(1e-3..1e3)).len(), 7);
        let tight = log_ticks(&(0.2..20.0));
        let expected = [0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];
        assert_eq!(tight.len(), expected.len(), "{tight:?}");
        assert!(
            tight.iter().zip(expected).all(|(tick, value)| (tick / value - 1.0).abs() < 1e-9),
            "{tight:?}"
        );
        assert_eq!(log_ticks(&(0.9..1.6)), [1.0, 1.5]);
    }

    #[test]
    fn labels_cover_neither_dots_nor_each_other() {
        let frame = Bounds { low: (0, 0), high: (300, 300) };
        let spots = [(150, 150), (152, 160), (290, 8), (150, 120)];
        let mut taken = spots.map(Bounds::around).to_vec();
        let size = (60, 16);
        for spot in spots {
            let corner = free(spot, size, &frame, &mut taken);
            let name = Bounds { low: corner, high: (corner.0 + size.0, corner.1 + size.1) };
            assert!(frame.holds(&name), "{spot:?} {name:?}");
            let (_, others) = taken.split_last().unwrap();
            assert!(!others.iter().any(|other| other.meets(&name)), "{spot:?} {name:?}");
        }
        assert!(Bounds::around((5, 5)).meets(&Bounds::around((10, 10))), "the control");
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

    #[test]
    fn a_chart_has_its_size_and_ink_and_an_empty_one_is_an_error() {
        let path = std::env::temp_dir().join(format!("tombolo-chart-{}.png", std::process::id()));
        let panel = |points: Vec<(f64, f64)>| {
            Panel::new("test", log("x, m"), linear("y")).line("one", points.clone()).bound("bar", points)
        };
        write(&path, "title", &[panel(vec![(1.0, 2.0), (100.0, 3.0)])]).unwrap();
        let picture = image::open(&path).unwrap().to_rgb8();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(picture.dimensions(), (PANEL.0, PANEL.1 + TITLE));
        let ink = picture.pixels().filter(|pixel| pixel.0 != [255; 3]).count();
        assert!(ink > 5_000, "{ink}");
        assert!(
            write(&path, "title", &[panel(vec![(-1.0, 2.0)])])
                .unwrap_err()
                .to_string()
                .contains("nothing to show")
        );
    }
}
