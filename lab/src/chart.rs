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
const PANEL: (u32, u32) = (860, 620);

/// Pixels above the panels for the title.
const TITLE: u32 = 64;

const FONT: &str = "lab";
const INK: RGBColor = RGBColor(40, 44, 52);
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
        let above = if panel.series.len() > 1 { 0.3 } else { 0.08 };
        let x = range(panel, panel.x.scale, 0.0, |point| point.0)?;
        let y = range(panel, panel.y.scale, above, |point| point.1)?;
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
    let mut chart = ChartBuilder::on(area)
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
        .x_label_formatter(&|value| number(*value))
        .y_label_formatter(&|value| number(*value))
        .label_style(text(18))
        .axis_desc_style(text(20))
        .axis_style(INK)
        .bold_line_style(FAINT)
        .light_line_style(TRANSPARENT)
        .draw()
        .map_err(|e| told(&e))?;
    for (series, colour) in panel.series.iter().zip(COLOURS) {
        let shown: Vec<(f64, f64)> =
            series.points.iter().copied().filter(|point| panel.shows(*point)).collect();
        let drawn = match series.stroke {
            Stroke::Measured => {
                chart
                    .draw_series(shown.iter().map(|point| Circle::new(*point, 4, colour.filled())))
                    .map_err(|e| told(&e))?;
                chart.draw_series(LineSeries::new(shown, colour.stroke_width(2))).map_err(|e| told(&e))?
            }
            Stroke::Stated => chart
                .draw_series(DashedLineSeries::new(shown, 9, 6, colour.stroke_width(2)))
                .map_err(|e| told(&e))?,
        };
        let is_measured = series.stroke == Stroke::Measured;
        drawn.label(series.label.clone()).legend(move |(x, y)| {
            let gap = if is_measured { 0 } else { 5 };
            EmptyElement::at((x, y))
                + PathElement::new(vec![(0, 0), (11 - gap, 0)], colour.stroke_width(2))
                + PathElement::new(vec![(11 + gap, 0), (24, 0)], colour.stroke_width(2))
                + Circle::new((12, 0), if is_measured { 4 } else { 0 }, colour.filled())
        });
    }
    if panel.series.len() > 1 {
        chart
            .configure_series_labels()
            .label_font(text(18))
            .legend_area_size(34)
            .margin(12)
            .background_style(WHITE.mix(0.88))
            .border_style(FAINT)
            .position(panel.legend_corner())
            .draw()
            .map_err(|e| told(&e))?;
    }
    Ok(())
}

impl Panel {
    fn shows(&self, (x, y): (f64, f64)) -> bool {
        let fits = |value: f64, scale: Scale| value.is_finite() && (scale == Scale::Linear || value > 0.0);
        fits(x, self.x.scale) && fits(y, self.y.scale)
    }

    /// The corner that the curves leave most room in.
    fn legend_corner(&self) -> SeriesLabelPosition {
        let place = |scale: Scale, value: f64| if scale == Scale::Log { value.log10() } else { value };
        let points: Vec<(f64, f64)> = self
            .series
            .iter()
            .flat_map(|series| series.points.iter().copied())
            .filter(|point| self.shows(*point))
            .map(|(x, y)| (place(self.x.scale, x), place(self.y.scale, y)))
            .collect();
        let span = |pick: fn(&(f64, f64)) -> f64| {
            points.iter().map(pick).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)))
        };
        let (x, y) = (span(|point| point.0), span(|point| point.1));
        let share = |value: f64, (low, high): (f64, f64)| (value - low) / (high - low).max(f64::MIN_POSITIVE);
        let crowd = |right: bool, top: bool| {
            let near =
                |share: f64, high: bool, reach: f64| if high { share > 1.0 - reach } else { share < reach };
            points.iter().filter(|p| near(share(p.0, x), right, 0.5) && near(share(p.1, y), top, 0.4)).count()
        };
        let corners = [
            (crowd(true, true), SeriesLabelPosition::UpperRight),
            (crowd(false, true), SeriesLabelPosition::UpperLeft),
            (crowd(true, false), SeriesLabelPosition::LowerRight),
            (crowd(false, false), SeriesLabelPosition::LowerLeft),
        ];
        // A linear range is kept free above its curves.
        let candidates = if self.y.scale == Scale::Linear { 2 } else { corners.len() };
        corners
            .into_iter()
            .take(candidates)
            .min_by_key(|(crowd, _)| *crowd)
            .map_or(SeriesLabelPosition::UpperRight, |(_, at)| at)
    }
}

/// The range of an axis: whole decades or a little air around the values; `above` is the share of a linear range that is kept free
/// above them, for the legend.
fn range(panel: &Panel, scale: Scale, above: f64, pick: impl Fn(&(f64, f64)) -> f64) -> Result<Range<f64>> {
    let shown = panel.series.iter().flat_map(|series| &series.points).filter(|point| panel.shows(**point));
    let (low, high) = shown.map(pick).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return Err(anyhow!("`{}` has nothing to show", panel.title));
    }
    Ok(match scale {
        Scale::Log if above > 0.0 => {
            10f64.powf(low.log10().floor())..10f64.powf((high * 1.0001).log10().ceil())
        }
        Scale::Log => low / 1.2..high * 1.2,
        Scale::Linear => {
            let low = if low >= 0.0 && low < 0.5 * high { low.min(0.0) } else { low - (high - low) * 0.06 };
            low..high + ((high - low) * above.max(0.04)).max(1e-9)
        }
    })
}

/// A number as short as it stays exact enough for an axis.
fn number(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude != 0.0 && !(1e-4..1e6).contains(&magnitude) {
        let power = magnitude.log10().floor();
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
            assert_eq!(number(value), text);
        }
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
