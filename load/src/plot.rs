//! A plot of a run: latency above, throughput below, over the same seconds, with the phases marked.
//!
//! Text uses the font that the viewer embeds; system fonts are not needed.

use crate::report::Report;
use crate::timeline::Second;
use anyhow::{Context, Result, anyhow};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, RGBColor, register_font};
use std::io::Write;
use std::ops::Range;
use std::sync::Once;

/// Width and height of the picture, pixels.
const SIZE: (u32, u32) = (1280, 960);

/// Height of the title, and of the line above each panel, pixels.
const HEADS: (u32, u32) = (92, 40);

/// Free at the left and right edge, and where the axes begin within: pixels from the left, and from
/// the right for the scale of data.
const MARGIN: u32 = 18;
const SIDES: (u32, u32) = (84, 78);

/// Pixels below each panel for its axis.
const FOOT: u32 = 58;

const FONT: &str = "load";
const INK: RGBColor = RGBColor(40, 44, 52);
const FAINT: RGBColor = RGBColor(226, 229, 234);
/// Background of the phases; the pause between them is white.
const PART: RGBColor = RGBColor(246, 247, 250);

// Distinguishable for colour-blind readers too (Okabe and Ito, "Color Universal Design", 2008).
const BLUE: RGBColor = RGBColor(0, 114, 178);
const ORANGE: RGBColor = RGBColor(213, 94, 0);
const GREEN: RGBColor = RGBColor(0, 158, 115);
const PURPLE: RGBColor = RGBColor(204, 121, 167);
/// Lies under the others, so it is wide and light.
const GREY: RGBColor = RGBColor(190, 195, 203);

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

type Chart<'a, 'b, X, Y> = ChartContext<'a, BitMapBackend<'b>, Cartesian2d<X, Y>>;

/// A line and its name.
struct Line<'a> {
    name: &'a str,
    colour: RGBColor,
    width: u32,
    /// Pieces without a gap. A second without a value is a gap.
    pieces: Vec<Vec<(f64, f64)>>,
}

impl Line<'_> {
    /// Its pieces as drawn. A second between two gaps has no line, so each piece starts with a dot.
    fn series(&self) -> impl Iterator<Item = LineSeries<BitMapBackend<'static>, (f64, f64)>> {
        let style = self.colour.stroke_width(self.width).filled();
        self.pieces.iter().map(move |piece| {
            let size = if piece.len() == 1 { self.width / 2 + 2 } else { 0 };
            LineSeries::new(piece.iter().copied(), style).point_size(size)
        })
    }
}

/// Draws a report and writes the PNG.
///
/// # Errors
/// The picture cannot be drawn or written.
pub fn write(into: impl Write, report: &Report) -> Result<()> {
    let pixels = draw(report).context("--plot: cannot draw")?;
    let mut encoder = png::Encoder::new(into, SIZE.0, SIZE.1);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().context("--plot: cannot write the picture")?;
    writer.write_image_data(&pixels).context("--plot: cannot write the picture")?;
    writer.finish().context("--plot: cannot write the picture")
}

/// The picture, three bytes a pixel.
fn draw(report: &Report) -> Result<Vec<u8>> {
    static FONTS: Once = Once::new();
    FONTS.call_once(|| {
        // Fails only for a file that is no font; drawing text then reports it.
        let _ = register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT);
    });
    let mut pixels = vec![255; (SIZE.0 * SIZE.1 * 3) as usize];
    {
        let root = BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area();
        let (head, body) = root.split_vertically(HEADS.0);
        text(&head, &title(report), (30, 20), 30)?;
        text(&head, &subtitle(report), (30, 58), 19)?;
        let [above, below] = &body.split_evenly((2, 1))[..] else { return Err(anyhow!("no room")) };
        let seconds = span(report);
        latency(above, report, seconds.clone())?;
        throughput(below, report, seconds)?;
        root.present().map_err(|cause| anyhow!("{cause}"))?;
    }
    Ok(pixels)
}

fn title(report: &Report) -> String {
    let pace = report.rate.map_or("closed loop".into(), |rate| format!("open loop, {rate} a second"));
    format!("{} clients, {} mode, path {}, {pace}", report.clients, report.mode, report.path)
}

fn subtitle(report: &Report) -> String {
    let quantile = |value: Option<f64>| value.map_or("-".into(), |ms| format!("{ms:.1} ms"));
    let megabytes = report.bytes as f64 / 1e6;
    format!(
        "{} chunks, {megabytes:.1} MB in {:.0} s; {} p50 {}, p99 {}, max {}; {} mismatches, \
         {} dropped, {} refused",
        report.chunks,
        report.seconds,
        report.measures,
        quantile(report.latency_ms.p50),
        quantile(report.latency_ms.p99),
        quantile(report.latency_ms.max),
        report.mismatches,
        report.dropped,
        report.refused,
    )
}

/// Range of the time axis.
fn span(report: &Report) -> Range<f64> {
    let ends = report.phases.iter().map(|phase| phase.begins_s + phase.seconds);
    0.0..ends.fold(1.0, f64::max)
}

/// Whether a whole second lies in a phase: arrivals of a fraction would look like a drop.
fn is_whole(report: &Report, second: &Second) -> bool {
    let (from, to) = (second.second as f64, second.second as f64 + 1.0);
    report.phases.iter().any(|phase| phase.begins_s <= from && to <= phase.begins_s + phase.seconds + 1e-9)
}

fn latency(area: &Area<'_>, report: &Report, seconds: Range<f64>) -> Result<()> {
    // The seconds after the end, with the last answers of an open loop, are not part of the lines.
    let late = |pick: fn(&Second) -> Option<f64>| {
        let end = seconds.end;
        move |second: &Second| {
            pick(second).filter(|_| !is_whole(report, second) && second.second as f64 + 0.5 <= end)
        }
    };
    let line = |name, colour, width, pick: fn(&Second) -> Option<f64>| Line {
        name,
        colour,
        width,
        pieces: pieces(&report.timeline, |second| pick(second).filter(|_| is_whole(report, second)))
            .into_iter()
            .chain(pieces(&report.timeline, late(pick)))
            .collect(),
    };
    let lines = [
        line("longest", GREY, 6, |second| second.max_ms),
        line("p99", ORANGE, 2, |second| second.p99_ms),
        line("p50", BLUE, 2, |second| second.p50_ms),
    ];
    let values = lines.iter().flat_map(|line| &line.pieces).flatten().map(|(_, ms)| *ms);
    let ms = decades(values);
    let ticks = ticks(&ms);
    let panel = head(area, &format!("Latency, {}, of the answers of each second", report.measures), &lines)?;
    let mut chart = ChartBuilder::on(&panel)
        .margin_left(MARGIN)
        .margin_right(MARGIN + SIDES.1)
        .x_label_area_size(FOOT)
        .y_label_area_size(SIDES.0)
        .build_cartesian_2d(seconds, ms.clone().log_scale().with_key_points(ticks))
        .map_err(|cause| anyhow!("{cause}"))?;
    mark(report, |phase| {
        let bar = Rectangle::new([(phase.start, ms.start), (phase.end, ms.end)], PART.filled());
        chart.draw_series([bar]).map(|_| ()).map_err(|cause| anyhow!("{cause}"))
    })?;
    axes(&mut chart, None, "milliseconds")?;
    for line in &lines {
        for series in line.series() {
            chart.draw_series(series).map_err(|cause| anyhow!("{cause}"))?;
        }
    }
    if report.phases.len() > 1 {
        let names = report.phases.iter().map(|phase| {
            let style = (FONT, 18).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Top));
            EmptyElement::at((phase.begins_s, ms.end)) + Text::new(phase.name, (8, 6), style)
        });
        chart.draw_series(names).map_err(|cause| anyhow!("{cause}"))?;
    }
    Ok(())
}

fn throughput(area: &Area<'_>, report: &Report, seconds: Range<f64>) -> Result<()> {
    let line = |name, colour, width, pick: fn(&Second) -> f64| Line {
        name,
        colour,
        width,
        pieces: pieces(&report.timeline, |second| is_whole(report, second).then(|| pick(second))),
    };
    // A 304 is an answer, but no chunk.
    let (left, count): (_, fn(&Second) -> f64) = match report.mode {
        "http" => ("answers a second", |second| second.answers as f64),
        _ => ("chunks a second", |second| second.chunks as f64),
    };
    let name = format!("{left} (left)");
    // The two often go together; the lower one shows beside the upper.
    let lines = [
        line(&name, GREEN, 5, count),
        line("MB a second (right)", PURPLE, 2, |second| second.bytes as f64 / 1e6),
    ];
    let most = |line: &Line<'_>| {
        let values = line.pieces.iter().flatten().map(|(_, value)| *value);
        // Without values the scale is 1.
        values.fold(0.0, f64::max).max(1e-3) * 1.08
    };
    let (counts, megabytes) = (most(&lines[0]), most(&lines[1]));
    let panel = head(area, "Throughput", &lines)?;
    let mut chart = ChartBuilder::on(&panel)
        .margin_left(MARGIN)
        .margin_right(MARGIN)
        .x_label_area_size(FOOT)
        .y_label_area_size(SIDES.0)
        .right_y_label_area_size(SIDES.1)
        .build_cartesian_2d(seconds.clone(), 0.0..counts)
        .map_err(|cause| anyhow!("{cause}"))?
        .set_secondary_coord(seconds, 0.0..megabytes);
    mark(report, |phase| {
        let bar = Rectangle::new([(phase.start, 0.0), (phase.end, counts)], PART.filled());
        chart.draw_series([bar]).map(|_| ()).map_err(|cause| anyhow!("{cause}"))
    })?;
    axes(&mut chart, Some("seconds since the start of the run"), left)?;
    chart
        .configure_secondary_axes()
        .y_desc("MB a second")
        .y_label_formatter(&|value| plain(*value))
        .label_style((FONT, 17).into_font().color(&INK))
        .axis_desc_style((FONT, 19).into_font().color(&INK))
        .axis_style(INK)
        .draw()
        .map_err(|cause| anyhow!("{cause}"))?;
    for series in lines[0].series() {
        chart.draw_series(series).map_err(|cause| anyhow!("{cause}"))?;
    }
    for series in lines[1].series() {
        chart.draw_secondary_series(series).map_err(|cause| anyhow!("{cause}"))?;
    }
    Ok(())
}

/// Draws the axes of a panel and its grid.
fn axes<X, Y>(chart: &mut Chart<'_, '_, X, Y>, below: Option<&str>, left: &str) -> Result<()>
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    let mut mesh = chart.configure_mesh();
    below.into_iter().for_each(|below| _ = mesh.x_desc(below));
    mesh.y_desc(left)
        .y_label_formatter(&|value| plain(*value))
        .x_label_formatter(&|second| plain(*second))
        .label_style((FONT, 17).into_font().color(&INK))
        .axis_desc_style((FONT, 19).into_font().color(&INK))
        .axis_style(INK)
        .bold_line_style(FAINT)
        .light_line_style(TRANSPARENT)
        .draw()
        .map_err(|cause| anyhow!("{cause}"))
}

/// Writes the line above a panel, its name at the left and its legend at the right. Returns the
/// rest of the area.
fn head<'a>(area: &Area<'a>, name: &str, lines: &[Line<'_>]) -> Result<Area<'a>> {
    let (head, rest) = area.split_vertically(HEADS.1);
    text(&head, name, ((MARGIN + SIDES.0) as i32, 12), 21)?;
    let font = (FONT, 18).into_font().color(&INK);
    let mut right = (SIZE.0 - SIDES.1 - MARGIN) as i32;
    for line in lines.iter().rev() {
        let size = head.estimate_text_size(line.name, &font).map_err(|cause| anyhow!("{cause}"))?;
        let left = right - size.0 as i32;
        text(&head, line.name, (left, 14), 18)?;
        let stroke =
            PathElement::new([(left - 38, 18), (left - 8, 18)], line.colour.stroke_width(line.width));
        head.draw(&stroke).map_err(|cause| anyhow!("{cause}"))?;
        right = left - 62;
    }
    Ok(rest)
}

fn text(area: &Area<'_>, words: &str, at: (i32, i32), size: u32) -> Result<()> {
    let text = Text::new(words.to_owned(), at, (FONT, size).into_font().color(&INK));
    area.draw(&text).map_err(|cause| anyhow!("{cause}"))
}

/// Draws a background behind each phase, if there are several.
fn mark(report: &Report, mut draw: impl FnMut(Range<f64>) -> Result<()>) -> Result<()> {
    if report.phases.len() < 2 {
        return Ok(());
    }
    report.phases.iter().try_for_each(|phase| draw(phase.begins_s..phase.begins_s + phase.seconds))
}

/// A value at the middle of each second, in pieces between the seconds that have none.
fn pieces(seconds: &[Second], pick: impl Fn(&Second) -> Option<f64>) -> Vec<Vec<(f64, f64)>> {
    let points: Vec<_> =
        seconds.iter().map(|second| pick(second).map(|value| (second.second as f64 + 0.5, value))).collect();
    points
        .split(Option::is_none)
        .map(|piece| piece.iter().copied().flatten().collect())
        .filter(|piece: &Vec<_>| !piece.is_empty())
        .collect()
}

/// Whole powers of ten around positive values, at least one; from 1 to 10 around none.
fn decades(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values
        .filter(|value| *value > 0.0)
        .fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return 1.0..10.0;
    }
    let low = (low.log10() + 1e-6).floor();
    10f64.powf(low)..10f64.powf((high.log10() - 1e-6).ceil().max(low + 1.0))
}

/// Ticks of a logarithmic axis over whole decades: with their halves and fifths where there are
/// few.
fn ticks(range: &Range<f64>) -> Vec<f64> {
    let (low, high) = (range.start.log10().round() as i32, range.end.log10().round() as i32);
    let leads: &[f64] = if high - low > 2 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let all = (low..=high).flat_map(|power| leads.iter().map(move |lead| lead * 10f64.powi(power)));
    all.filter(|tick| *tick <= range.end * 1.000_001).collect()
}

/// A number on an axis.
fn plain(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LoadConfig, RunStats};
    use std::time::Duration;

    fn second(second: u64, p50_ms: Option<f64>) -> Second {
        Second {
            second,
            chunks: 10 * second,
            bytes: 1000,
            p50_ms,
            p99_ms: p50_ms,
            max_ms: p50_ms,
            ..Second::default()
        }
    }

    fn report(timeline: Vec<Second>) -> Report {
        let config = LoadConfig::new("ws://127.0.0.1:1/v1/stream".parse().unwrap());
        Report { timeline, ..Report::new(&config, &RunStats::new(&config), Duration::from_secs(10)) }
    }

    fn has(pixels: &[u8], colour: RGBColor) -> bool {
        pixels.chunks_exact(3).filter(|pixel| *pixel == [colour.0, colour.1, colour.2]).count() > 20
    }

    #[test]
    fn a_picture_has_its_size_and_its_lines() {
        let timeline = (0..10).map(|index| second(index, Some(3.0 * (index + 1) as f64))).collect();
        let report = report(timeline);
        let mut file = Vec::new();
        write(&mut file, &report).unwrap();
        let mut decoded = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        assert_eq!((decoded.info().width, decoded.info().height), SIZE);
        let mut pixels = vec![0; decoded.output_buffer_size().unwrap()];
        decoded.next_frame(&mut pixels).unwrap();
        assert!([BLUE, GREEN, PURPLE].into_iter().all(|colour| has(&pixels, colour)));
    }

    #[test]
    fn a_run_without_an_answer_has_a_picture_without_latencies() {
        let pixels = draw(&report(vec![second(0, None), second(1, None)])).unwrap();
        // The line appears only in the legend.
        let blue = pixels.chunks_exact(3).filter(|pixel| *pixel == [BLUE.0, BLUE.1, BLUE.2]).count();
        assert!(blue < 150 && has(&pixels, GREEN), "{blue}");
        assert!(draw(&report(Vec::new())).is_ok());
    }

    #[test]
    fn a_second_without_a_value_is_a_gap() {
        let seconds: Vec<_> = [Some(1.0), Some(2.0), None, Some(3.0), None]
            .into_iter()
            .enumerate()
            .map(|(index, value)| second(index as u64, value))
            .collect();
        assert_eq!(
            pieces(&seconds, |second| second.p50_ms),
            [vec![(0.5, 1.0), (1.5, 2.0)], vec![(3.5, 3.0)]]
        );
    }

    #[test]
    fn axes_of_latency_are_whole_decades() {
        assert_eq!(decades([0.7, 120.0].into_iter()), 0.1..1000.0);
        assert_eq!(decades([10.0, 100.0].into_iter()), 10.0..100.0);
        assert_eq!(decades(std::iter::empty()), 1.0..10.0);
        assert_eq!(ticks(&(1.0..100.0)), [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]);
        assert_eq!(ticks(&(0.1..1000.0)).len(), 5);
        assert_eq!(["0", "0.5", "20", "100"].map(str::to_owned), [0.0, 0.5, 20.0, 100.0].map(plain));
    }
}
