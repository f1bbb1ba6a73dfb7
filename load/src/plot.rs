//! A plot of a run: latency, answers and data of each second, with the phases in the background.

use crate::report::{PhaseReport, Report};
use crate::timeline::Second;
use anyhow::{Context, Result};
use chart::{Axis, Band, Chart, Panel, linear, log};
use std::io::Write;
use std::ops::Range;

/// Draws a report and writes the PNG.
///
/// # Errors
/// The picture cannot be drawn or written.
pub fn write(into: impl Write, report: &Report) -> Result<()> {
    chart(report).write(into).context("--plot")
}

fn chart(report: &Report) -> Chart {
    Chart::column(title(report), subtitle(report), vec![latency(report), answers(report), data(report)])
}

fn title(report: &Report) -> String {
    let schedule = match report.rate {
        Some(rate) => format!("open loop, {rate} requests a second"),
        None if report.mode == "view" => "fixed intervals".into(),
        None => "closed loop".into(),
    };
    format!("{} clients, {} mode, path {}, {schedule}", report.clients, report.mode, report.path)
}

fn subtitle(report: &Report) -> String {
    let quantile = |value: Option<f64>| value.map_or("-".into(), |ms| format!("{ms:.1} ms"));
    let megabytes = report.counts.bytes as f64 / 1e6;
    format!(
        "{} chunks, {megabytes:.1} MB in {:.0} s; {} p50 {}, p99 {}, max {}; {} mismatches, \
         {} dropped, {} refused",
        report.counts.chunks,
        report.seconds,
        report.measures,
        quantile(report.latency_ms.p50),
        quantile(report.latency_ms.p99),
        quantile(report.latency_ms.max),
        report.counts.mismatches,
        report.counts.dropped,
        report.counts.refused,
    )
}

fn latency(report: &Report) -> Panel {
    let title = format!("Latency, {}, of the answers of each second", report.measures);
    // The seconds after the end, with the last answers of an open loop, are not part of the lines.
    let end = time_axis(report).end;
    let points = |pick: fn(&Second) -> Option<f64>| {
        points(report, move |second, _| pick(second).filter(|_| second.second as f64 + 0.5 <= end))
    };
    panel(report, title, log("milliseconds"))
        .trace("longest", points(|second| second.max_ms))
        .trace("p99", points(|second| second.p99_ms))
        .trace("p50", points(|second| second.p50_ms))
}

fn answers(report: &Report) -> Panel {
    // A 304 is an answer, but no chunk.
    let (label, count): (_, fn(&Second) -> u64) = match report.mode {
        "http" => ("answers a second", |second| second.answers),
        _ => ("chunks a second", |second| second.chunks),
    };
    let points = points(report, |second, is_whole| is_whole.then_some(count(second) as f64));
    panel(report, "Throughput".into(), linear(label)).from_zero().trace(label, points)
}

fn data(report: &Report) -> Panel {
    let points = points(report, |second, is_whole| is_whole.then_some(second.bytes as f64 / 1e6));
    panel(report, "Data".into(), linear("MB a second")).from_zero().trace("MB a second", points)
}

/// A panel over the whole run, with its phases if there are several.
fn panel(report: &Report, title: String, y: Axis) -> Panel {
    let band = |phase: &PhaseReport| Band {
        name: phase.name.into(),
        range: phase.begins_s..phase.begins_s + phase.seconds,
    };
    let phases = if report.phases.len() > 1 { &report.phases[..] } else { &[] };
    let bands = phases.iter().map(band);
    Panel::new(title, linear("seconds since the start of the run"), y).over(time_axis(report)).bands(bands)
}

/// Range of the time axis.
fn time_axis(report: &Report) -> Range<f64> {
    let ends = report.phases.iter().map(|phase| phase.begins_s + phase.seconds);
    0.0..ends.fold(1.0, f64::max)
}

/// Whether a second lies in a phase from begin to end. The counts of a part of a second would look
/// like a drop.
fn is_whole(report: &Report, second: &Second) -> bool {
    let (from, to) = (second.second as f64, second.second as f64 + 1.0);
    report.phases.iter().any(|phase| phase.begins_s <= from && to <= phase.begins_s + phase.seconds + 1e-9)
}

/// Points of a line: the value that `pick` returns for each second, at the middle of the second.
/// `pick` also gets whether the second lies in a phase ([`is_whole`]). A second without a value is
/// a gap, and so is a boundary between seconds inside and outside the phases.
fn points(report: &Report, pick: impl Fn(&Second, bool) -> Option<f64>) -> Vec<(f64, f64)> {
    let mut points = Vec::new();
    let mut was_whole = true;
    for second in &report.timeline {
        let is_whole = is_whole(report, second);
        if is_whole != was_whole {
            points.push((second.second as f64, f64::NAN));
        }
        was_whole = is_whole;
        points.push((second.second as f64 + 0.5, pick(second, is_whole).unwrap_or(f64::NAN)));
    }
    points
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

    #[test]
    fn a_plot_shows_the_values_of_the_run() {
        let of = |ms: f64| {
            let timeline = (0..10).map(|index| second(index, Some(ms * (index + 1) as f64))).collect();
            chart(&report(timeline)).pixels().unwrap()
        };
        assert_ne!(of(3.0), of(4.0));
        assert_eq!(of(3.0), of(3.0), "the control");
        let mut file = Vec::new();
        write(&mut file, &report(vec![second(0, Some(1.0))])).unwrap();
        assert!(file.starts_with(b"\x89PNG"));
    }

    #[test]
    fn a_run_without_an_answer_has_a_plot() {
        assert!(chart(&report(vec![second(0, None), second(1, None)])).pixels().is_ok());
        assert!(chart(&report(Vec::new())).pixels().is_ok());
    }

    #[test]
    fn a_second_without_a_value_and_an_end_of_a_phase_are_gaps() {
        let values = [Some(1.0), None, Some(3.0)];
        let timeline = values.into_iter().zip(0..).map(|(value, index)| second(index, value)).collect();
        let mut report = report(timeline);
        let all = |report: &Report| points(report, |second, _| second.p50_ms);
        let is_gap = |(_, value): &(f64, f64)| value.is_nan();
        let known = all(&report);
        assert_eq!(known.iter().filter(|point| !is_gap(point)).count(), 2);
        assert!(is_gap(&known[known.len() - 2]) && known.last() == Some(&(2.5, 3.0)), "{known:?}");
        let phase = report.phases.first_mut().unwrap();
        (phase.begins_s, phase.seconds) = (0.0, 2.0);
        let gaps: Vec<f64> = all(&report).iter().filter(|point| is_gap(point)).map(|(at, _)| *at).collect();
        assert_eq!(gaps, [1.5, 2.0]);
    }
}
