//! Charts: panels of curves as one PNG, with the fonts that the viewer embeds. No system font is looked for.

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

/// Height of a line of the legend, width of the stroke that it shows, and what is free around its text, pixels.
const LEGEND: (u32, i32, i32) = (28, 30, 14);

/// Distance from the left end of a panel to its legend: that of the axis.
const LEGEND_LEFT: i32 = 108;

/// Width of a line that covers no other, and what it gains with every line that it would vanish under, pixels.
const LINE: (u32, u32) = (2, 4);

/// Lines that are nearer than this share of the axis cannot be told apart.
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
#[must_use]
pub const fn linear(label: &'static str) -> Axis {
    Axis { label, scale: Scale::Linear }
}

/// A logarithmic axis.
#[must_use]
pub const fn log(label: &'static str) -> Axis {
    Axis { label, scale: Scale::Log }
}

/// A measured curve.
pub fn measured(label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Series {
    Series { label: label.into(), stroke: Stroke::Measured, points: points.into_iter().collect() }
}

/// A stated bound or bar.
pub fn stated(label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64)>) -> Series {
    Series { label: label.into(), stroke: Stroke::Stated, points: points.into_iter().collect() }
}

/// Choices of which less is better on both axes: the front that none beats, joined by a line, and the others in grey.
pub fn front(label: impl Into<String>, points: &[(f64, f64)]) -> Vec<Series> {
    let beaten = |&(x, y): &(f64, f64)| points.iter().any(|&(a, b)| a <= x && b <= y && (a < x || b < y));
    let (dominated, mut best): (Vec<_>, Vec<_>) = points.iter().copied().partition(beaten);
    best.sort_by(|one, two| one.0.total_cmp(&two.0));
    let mut series = vec![measured(label, best)];
    if !dominated.is_empty() {
        series.push(Series { label: "dominated".into(), stroke: Stroke::Dominated, points: dominated });
    }
    series
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

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

fn draw(root: &Area<'_>, title: &str, panels: &[Panel], (rows, columns): (usize, usize)) -> Result<()> {
    let (head, body) = root.split_vertically(TITLE);
    // Axes of plotters borrow the backend's error type; as text they can travel.
    let told = |cause: &dyn std::fmt::Display| anyhow!("{cause}");
    head.draw(&Text::new(title.to_owned(), (34, 22), (FONT, 30).into_font().color(&INK)))
        .map_err(|e| told(&e))?;
    for (panel, area) in panels.iter().zip(body.split_evenly((rows, columns))) {
        let x = range(panel, panel.x.scale, false, |point| point.0)?;
        let y = range(panel, panel.y.scale, true, |point| point.1)?;
        match (panel.x.scale, panel.y.scale) {
            (Scale::Linear, Scale::Linear) => draw_panel(&area, panel, x, y),
            (Scale::Linear, Scale::Log) => draw_panel(&area, panel, x, y.log_scale()),
            (Scale::Log, Scale::Linear) => draw_panel(&area, panel, x.log_scale(), y),
            (Scale::Log, Scale::Log) => draw_panel(&area, panel, x.log_scale(), y.log_scale()),
        }?;
    }
    root.present().map_err(|e| told(&e))
}

fn draw_panel<X, Y>(area: &Area<'_>, panel: &Panel, x: X, y: Y) -> Result<()>
where
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let told = |cause: &dyn std::fmt::Display| anyhow!("{cause}");
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
        .map_err(|e| told(&e))?;
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
        .map_err(|e| told(&e))?;
    for (index, (series, colour)) in panel.series.iter().zip(COLOURS).enumerate() {
        let shown: Vec<(f64, f64)> =
            series.points.iter().copied().filter(|point| panel.shows(*point)).collect();
        let width = panel.width(index);
        match series.stroke {
            Stroke::Measured => {
                let dots = shown.iter().map(|point| Circle::new(*point, width / 2 + 3, colour.filled()));
                chart.draw_series(dots).map_err(|e| told(&e))?;
                chart.draw_series(LineSeries::new(shown, colour.stroke_width(width)))
            }
            Stroke::Stated => {
                chart.draw_series(DashedLineSeries::new(shown, 9, 6, colour.stroke_width(width)))
            }
            Stroke::Dominated => {
                chart.draw_series(shown.iter().map(|point| Circle::new(*point, 5, GREY.filled())))
            }
        }
        .map_err(|e| told(&e))?;
    }
    for (row, entries) in legend.iter().enumerate() {
        let middle = (LEGEND.0 * row as u32 + LEGEND.0 / 2) as i32 - 6;
        for Entry { series: index, left } in entries {
            let (series, colour, width) = (&panel.series[*index], COLOURS[*index], panel.width(*index));
            let label = Text::new(series.label.clone(), (left + LEGEND.1 + 4, middle - 7), text(18));
            below.draw(&label).map_err(|e| told(&e))?;
            if series.stroke == Stroke::Dominated {
                below.draw(&Circle::new((left + 13, middle), 5, GREY.filled())).map_err(|e| told(&e))?;
                continue;
            }
            let is_measured = series.stroke == Stroke::Measured;
            let gap = if is_measured { 0 } else { 4 };
            let style = colour.stroke_width(width);
            let piece = |from: i32, to: i32| {
                PathElement::new(vec![(left + from, middle), (left + to, middle)], style)
            };
            below.draw(&piece(0, 13 - gap)).map_err(|e| told(&e))?;
            below.draw(&piece(13 + gap, 26)).map_err(|e| told(&e))?;
            if is_measured {
                below
                    .draw(&Circle::new((left + 13, middle), width / 2 + 3, colour.filled()))
                    .map_err(|e| told(&e))?;
            }
        }
    }
    Ok(())
}

/// A series in the legend, and how far right it begins.
struct Entry {
    series: usize,
    left: i32,
}

impl Panel {
    fn shows(&self, (x, y): (f64, f64)) -> bool {
        let fits = |value: f64, scale: Scale| value.is_finite() && (scale == Scale::Linear || value > 0.0);
        fits(x, self.x.scale) && fits(y, self.y.scale)
    }

    /// The lines of the legend, below the plot: there it covers no curve. A single curve is named by its axis.
    fn legend(&self, area: &Area<'_>) -> Result<Vec<Vec<Entry>>> {
        let mut rows: Vec<Vec<Entry>> = Vec::new();
        if self.series.len() < 2 {
            return Ok(rows);
        }
        let font = (FONT, 18).into_font().into_text_style(area);
        let mut left = i32::MAX;
        for (series, Series { label, .. }) in self.series.iter().enumerate().take(COLOURS.len()) {
            let text = area.estimate_text_size(label, &font).map_err(|cause| anyhow!("{cause}"))?;
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

/// The range of an axis: whole decades upwards, else a little air around the values, a little more above them.
fn range(panel: &Panel, scale: Scale, is_up: bool, pick: impl Fn(&(f64, f64)) -> f64) -> Result<Range<f64>> {
    let shown = panel.series.iter().flat_map(|series| &series.points).filter(|point| panel.shows(**point));
    let (low, high) = shown.map(pick).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return Err(anyhow!("`{}` has nothing to show", panel.title));
    }
    Ok(match scale {
        Scale::Log if is_up => 10f64.powf(low.log10().floor())..10f64.powf((high * 1.0001).log10().ceil()),
        Scale::Log => low / 1.2..high * 1.2,
        Scale::Linear => {
            let low = if low >= 0.0 && low < 0.5 * high { low.min(0.0) } else { low - (high - low) * 0.06 };
            low..high + ((high - low) * if is_up { 0.08 } else { 0.04 }).max(1e-9)
        }
    })
}

/// A number on an axis. On a logarithmic one, plain from 0.01 to 10,000 and else by its power of ten, so that neighbours look alike.
fn tick(scale: Scale, value: f64) -> String {
    let magnitude = value.abs();
    // Computed powers of ten are off by their last bits.
    let plain = match scale {
        Scale::Log => 0.009_999..10_001.0,
        Scale::Linear => 1e-4..1e6,
    };
    if magnitude != 0.0 && !plain.contains(&magnitude) {
        let power = (magnitude.log10() + 1e-9).floor();
        let lead = value / 10f64.powf(power);
        return if (lead - 1.0).abs() < 1e-6 { format!("1e{power}") } else { format!("{lead:.1}e{power}") };
    }
    let text = format!("{value:.4}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_on_axes_are_short() {
        for (value, text) in
            [(0.0, "0"), (1.0, "1"), (0.25, "0.25"), (0.0001, "0.0001"), (1e-6, "1e-6"), (4.2e6, "4.2e6")]
        {
            assert_eq!(tick(Scale::Linear, value), text);
        }
        let decades: Vec<String> = (-5..=6).map(|power| tick(Scale::Log, 10f64.powi(power))).collect();
        let texts = ["1e-5", "1e-4", "1e-3", "0.01", "0.1", "1", "10", "100", "1000", "10000", "1e5", "1e6"];
        assert_eq!(decades, texts);
    }

    #[test]
    fn the_front_is_what_nothing_beats_in_both_respects() {
        let series = front("knob", &[(3.0, 1.0), (1.0, 3.0), (2.0, 2.0), (2.5, 2.0), (3.0, 3.0)]);
        assert_eq!(series[0].points, [(1.0, 3.0), (2.0, 2.0), (3.0, 1.0)]);
        assert_eq!((series[1].stroke, series[1].points.len()), (Stroke::Dominated, 2));
        assert_eq!(front("one", &[(1.0, 1.0)]).len(), 1, "nothing is beaten");
    }

    #[test]
    fn a_line_under_another_is_wider_than_it() {
        let line = |label: &str, last: f64| measured(label, [(0.0, 1.0), (1.0, 2.0), (2.0, last)]);
        let series = vec![line("under", 3.0), line("over", 4.0), measured("apart", [(0.0, 9.0), (2.0, 8.0)])];
        let panel = Panel { title: "test", x: linear("x"), y: linear("y"), series };
        assert_eq!([0, 1, 2].map(|index| panel.width(index)), [6, 2, 2]);
    }

    #[test]
    fn a_chart_has_its_size_and_ink_and_an_empty_one_is_refused() {
        let path = std::env::temp_dir().join(format!("tombolo-chart-{}.png", std::process::id()));
        let panel = |points: Vec<(f64, f64)>| Panel {
            title: "test",
            x: log("x, m"),
            y: linear("y"),
            series: vec![measured("one", points.clone()), stated("bar", points)],
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
