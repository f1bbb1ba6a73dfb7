//! Drawing of sheets with the fonts that the viewer embeds; no system fonts.

use crate::labels::{Bounds, free};
use crate::scale::{log_ticks, ranges, tick};
use crate::{Chart, Panel, Scale, Series, Stroke};
use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use std::ops::Range;
use std::sync::Once;

/// Height of a line of the legend, width of the stroke that it shows, and what is free around its
/// text, pixels.
const LEGEND: (u32, i32, i32) = (28, 30, 14);

/// Distance from the left end of a panel to its legend: that of the axis.
const LEGEND_LEFT: i32 = 108;

/// Radius of the ring around the default, pixels.
const RING: i32 = 10;

const FONT: &str = "chart";
const INK: RGBColor = RGBColor(40, 44, 52);
const GREY: RGBColor = RGBColor(178, 182, 190);
/// Background of bands.
const BAND: RGBColor = RGBColor(246, 247, 250);
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

/// Draws a picture; three bytes a pixel.
///
/// # Errors
/// A panel has nothing that its axes can show.
pub(crate) fn pixels(picture: &Chart) -> Result<Vec<u8>> {
    static FONTS: Once = Once::new();
    FONTS.call_once(|| {
        // The only failure is a file that is no font; text would then be reported missing below.
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
    let (width, height) = picture.size();
    let mut pixels = vec![255; (width * height * 3) as usize];
    let root = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
    draw(&root, picture)?;
    drop(root);
    Ok(pixels)
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

fn draw(root: &Area<'_>, picture: &Chart) -> Result<()> {
    let (head, body) = root.split_vertically(picture.head());
    let title = Text::new(picture.title.clone(), (34, 22), (FONT, 30).into_font().color(&INK));
    head.draw(&title).or_text()?;
    let subtitle = Text::new(picture.subtitle.clone(), (34, 60), (FONT, 19).into_font().color(&INK));
    head.draw(&subtitle).or_text()?;
    let rows = picture.panels.len().div_ceil(picture.columns).max(1);
    for (panel, area) in picture.panels.iter().zip(body.split_evenly((rows, picture.columns))) {
        let (x, y) = ranges(panel)?;
        let log = |range: Range<f64>| {
            let ticks = log_ticks(&range);
            range.log_scale().with_key_points(ticks)
        };
        let bottom = y.start;
        match (panel.x.scale, panel.y.scale) {
            (Scale::Linear, Scale::Linear) => draw_panel(&area, panel, x, y, bottom),
            (Scale::Linear, Scale::Log) => draw_panel(&area, panel, x, log(y), bottom),
            (Scale::Log, Scale::Linear) => draw_panel(&area, panel, log(x), y, bottom),
            (Scale::Log, Scale::Log) => draw_panel(&area, panel, log(x), log(y), bottom),
        }?;
    }
    root.present().or_text()
}

fn draw_panel<X, Y>(area: &Area<'_>, panel: &Panel, x: X, y: Y, bottom: f64) -> Result<()>
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
        .caption(&panel.title, text(24))
        .x_label_area_size(58)
        .y_label_area_size(92)
        .build_cartesian_2d(x, y)
        .or_text()?;
    let (across, up) = chart.plotting_area().get_pixel_range();
    let (left, top) = area.get_base_pixel();
    for band in &panel.bands {
        let [from, to] =
            [band.range.start, band.range.end].map(|x| chart.backend_coord(&(x, bottom)).0 - left);
        let corners = [(from, up.start - top), (to, up.end - top)];
        area.draw(&Rectangle::new(corners, BAND.filled())).or_text()?;
    }
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
            Stroke::Trace => {
                for piece in series.points.split(|point| !panel.shows(*point)) {
                    let dot = if piece.len() == 1 { width / 2 + 2 } else { 0 };
                    let line = LineSeries::new(piece.iter().copied(), style.filled()).point_size(dot);
                    chart.draw_series(line).or_text()?;
                }
            }
            Stroke::Measured => drop(chart.draw_series(LineSeries::new(shown, style)).or_text()?),
            Stroke::Stated => drop(chart.draw_series(DashedLineSeries::new(shown, 9, 6, style)).or_text()?),
            Stroke::Dominated | Stroke::Control | Stroke::Shipped => {}
        }
    }
    // Over the grid and the curves, which would cross them out.
    for band in &panel.bands {
        let corner = (chart.backend_coord(&(band.range.start, bottom)).0 - left + 8, up.start - top + 6);
        area.draw(&Text::new(band.name.clone(), corner, text(18))).or_text()?;
    }
    let place = |point: &(f64, f64)| chart.backend_coord(point);
    let shown = panel.series.iter().flat_map(|series| &series.points).filter(|point| panel.shows(**point));
    let mut taken: Vec<Bounds> = shown.map(|point| Bounds::around(place(point))).collect();
    let frame = Bounds { low: (across.start, up.start), high: (across.end, up.end) };
    let font = (FONT, 16).into_font().color(&INK);
    for series in &panel.series {
        for (point, name) in series.points.iter().zip(&series.names).filter(|(point, _)| panel.shows(**point))
        {
            let size = area.estimate_text_size(name, &font).or_text()?;
            let corner = free(place(point), (size.0 as i32, size.1 as i32), &frame, &mut taken);
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
                Stroke::Measured | Stroke::Trace => Some(0),
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
        if left.saturating_add(width) > area.dim_in_pixel().0 as i32 {
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
        Stroke::Stated | Stroke::Trace => return None,
        Stroke::Dominated => Circle::new(at, 5, GREY.filled()).into_dyn(),
        Stroke::Control => Cross::new(at, 5, GREY.stroke_width(3)).into_dyn(),
        Stroke::Shipped => Circle::new(at, RING, INK.stroke_width(2)).into_dyn(),
    })
}
