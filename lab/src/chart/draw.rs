//! Charts as one PNG, with the fonts that the viewer embeds; no system fonts.

use super::{Panel, Scale, Series, Stroke};
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

/// Radius of the ring around the default, pixels.
const RING: i32 = 10;

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
    let legend = legend(panel, area)?;
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
        let marks = shown.iter().filter_map(|point| mark(series.stroke, *point, colour, width));
        chart.draw_series(marks).or_text()?;
        let style = colour.stroke_width(width);
        match series.stroke {
            Stroke::Measured => drop(chart.draw_series(LineSeries::new(shown, style)).or_text()?),
            Stroke::Stated => drop(chart.draw_series(DashedLineSeries::new(shown, 9, 6, style)).or_text()?),
            Stroke::Dominated | Stroke::Control | Stroke::Shipped => {}
        }
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
            // A measured line is whole, a stated one has a gap.
            let gap = match series.stroke {
                Stroke::Measured => Some(0),
                Stroke::Stated => Some(4),
                Stroke::Dominated | Stroke::Control | Stroke::Shipped => None,
            };
            for (from, to) in gap.into_iter().flat_map(|gap| [(0, 13 - gap), (13 + gap, 26)]) {
                let piece = vec![(left + from, middle), (left + to, middle)];
                below.draw(&PathElement::new(piece, colour.stroke_width(width))).or_text()?;
            }
            if let Some(mark) = mark(series.stroke, (left + 13, middle), colour, width) {
                below.draw(&mark).or_text()?;
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

/// The lines of the legend, below the plot: there it covers no curve. A single curve is named by
/// its axis.
fn legend(panel: &Panel, area: &Area<'_>) -> Result<Vec<Vec<Entry>>> {
    let mut rows: Vec<Vec<Entry>> = Vec::new();
    if panel.series.len() < 2 {
        return Ok(rows);
    }
    let font = (FONT, 18).into_font().into_text_style(area);
    let mut left = i32::MAX;
    for (series, Series { label, .. }) in panel.series.iter().enumerate().take(COLOURS.len()) {
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

type Mark<'a, C> = DynElement<'static, BitMapBackend<'a>, C>;

/// The mark of a value, in a plot and in its legend; a stated line has none.
fn mark<'a, C: Clone + 'static>(stroke: Stroke, at: C, colour: RGBColor, width: u32) -> Option<Mark<'a, C>> {
    Some(match stroke {
        Stroke::Measured => Circle::new(at, width / 2 + 3, colour.filled()).into_dyn(),
        Stroke::Stated => return None,
        Stroke::Dominated => Circle::new(at, 5, GREY.filled()).into_dyn(),
        Stroke::Control => Cross::new(at, 5, GREY.stroke_width(3)).into_dyn(),
        Stroke::Shipped => Circle::new(at, RING, INK.stroke_width(2)).into_dyn(),
    })
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
    use crate::chart::{linear, log};

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
        let anchors = [(150, 150), (152, 160), (290, 8), (150, 120)];
        let mut taken = anchors.map(Bounds::around).to_vec();
        let size = (60, 16);
        for anchor in anchors {
            let corner = free(anchor, size, &frame, &mut taken);
            let name = Bounds { low: corner, high: (corner.0 + size.0, corner.1 + size.1) };
            assert!(frame.holds(&name), "{anchor:?} {name:?}");
            let (_, others) = taken.split_last().unwrap();
            assert!(!others.iter().any(|other| other.meets(&name)), "{anchor:?} {name:?}");
        }
        assert!(Bounds::around((5, 5)).meets(&Bounds::around((10, 10))), "the control");
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
