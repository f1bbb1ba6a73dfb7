//! Progress on standard error: a bar that is updated every second on a terminal, otherwise a line
//! every ten seconds.

use indicatif::{ProgressBar, ProgressStyle};
use load::run_stats::Progress;
use std::io::IsTerminal;
use std::time::Duration;

/// Seconds between two lines without a terminal.
const LINE_EVERY_S: u64 = 10;

/// See the module.
pub enum ProgressReporter {
    /// A progress bar.
    Bar(ProgressBar),
    /// Lines.
    Lines {
        /// Length of the run, seconds.
        total_s: u64,
        /// Second of the last line.
        last_line_s: u64,
    },
    /// No output.
    Quiet,
}

impl ProgressReporter {
    /// A reporter for a run of this length.
    pub fn new(quiet: bool, total_s: Duration) -> Self {
        let total_s = total_s.as_secs();
        if quiet {
            return Self::Quiet;
        }
        if !std::io::stderr().is_terminal() {
            return Self::Lines { total_s, last_line_s: 0 };
        }
        let style = ProgressStyle::with_template("{bar:20} {pos}/{len} s  {msg}");
        // The template is constant; an invalid one would fall back to the default.
        Self::Bar(
            ProgressBar::new(total_s).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())),
        )
    }

    /// Shows the progress; lines only at their interval.
    pub fn update(&mut self, progress: &Progress) {
        let second = progress.elapsed.as_secs();
        match self {
            Self::Bar(bar) => {
                bar.set_position(second);
                bar.set_message(line(progress));
            }
            Self::Lines { total_s, last_line_s }
                if second >= *last_line_s + LINE_EVERY_S && second < *total_s =>
            {
                *last_line_s = second;
                eprintln!("tombolo-load: {second} of {total_s} s, {}", line(progress));
            }
            Self::Lines { .. } | Self::Quiet => {}
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

fn line(progress: &Progress) -> String {
    let ms = |value: Option<f64>| value.map_or("-".into(), |ms| format!("{ms:.1}"));
    let last = progress.last.unwrap_or_default();
    format!(
        "{}: {} chunks; last second {} chunks, {:.2} MB, p50 {} ms, p99 {} ms; {} faults",
        progress.phase,
        progress.chunks,
        last.chunks,
        last.bytes as f64 / 1e6,
        ms(last.p50_ms),
        ms(last.p99_ms),
        progress.faults,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_has_phase_rates_latencies_and_faults() {
        let progress =
            Progress { elapsed: Duration::from_secs(3), phase: "cold", chunks: 77, faults: 2, last: None };
        let shown = line(&progress);
        for part in ["cold", "77 chunks", "p99 - ms", "2 faults"] {
            assert!(shown.contains(part), "{shown}");
        }
    }

    #[test]
    fn lines_appear_every_ten_seconds_but_not_at_the_end() {
        let mut reporter = ProgressReporter::Lines { total_s: 30, last_line_s: 0 };
        let mut at = |second| {
            let elapsed = Duration::from_secs(second);
            reporter.update(&Progress { elapsed, phase: "run", chunks: 0, faults: 0, last: None });
            let ProgressReporter::Lines { last_line_s, .. } = reporter else { panic!("lines") };
            last_line_s
        };
        assert_eq!([at(9), at(11), at(12), at(21), at(30), at(40)], [0, 11, 11, 21, 21, 21]);
    }
}
