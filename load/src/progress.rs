//! What is said while a run goes on: one line that is rewritten every second where a person
//! watches, else a line every ten seconds.

use indicatif::{ProgressBar, ProgressStyle};
use load::tally::Progress;
use std::io::IsTerminal;
use std::time::Duration;

/// Time between two lines where nobody watches.
const LINE_EVERY_S: u64 = 10;

/// See the module.
pub enum Live {
    /// A bar on a terminal.
    Bar(ProgressBar),
    /// Lines, and the second of the last.
    Lines {
        /// Length of the run, seconds.
        lasts: u64,
        /// Second of the last line.
        said: u64,
    },
    /// Nothing.
    Quiet,
}

impl Live {
    /// For a run of this length.
    pub fn new(quiet: bool, lasts: Duration) -> Self {
        let lasts = lasts.as_secs();
        if quiet {
            return Self::Quiet;
        }
        if !std::io::stderr().is_terminal() {
            return Self::Lines { lasts, said: 0 };
        }
        let style = ProgressStyle::with_template("{bar:20} {pos}/{len} s  {msg}");
        // The template is fixed; were it wrong, the bar would look otherwise.
        Self::Bar(ProgressBar::new(lasts).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())))
    }

    /// Says where the run is, if it is time to.
    pub fn say(&mut self, progress: &Progress) {
        let second = progress.elapsed.as_secs();
        match self {
            Self::Bar(bar) => {
                bar.set_position(second);
                bar.set_message(words(progress));
            }
            Self::Lines { lasts, said } if second >= *said + LINE_EVERY_S && second < *lasts => {
                *said = second;
                eprintln!("tombolo-load: {second} of {lasts} s, {}", words(progress));
            }
            Self::Lines { .. } | Self::Quiet => {}
        }
    }

    /// The run is over.
    pub fn finish(&self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

fn words(progress: &Progress) -> String {
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
    fn the_line_names_part_rates_latencies_and_faults() {
        let progress =
            Progress { elapsed: Duration::from_secs(3), phase: "cold", chunks: 77, faults: 2, last: None };
        let line = words(&progress);
        for part in ["cold", "77 chunks", "p99 - ms", "2 faults"] {
            assert!(line.contains(part), "{line}");
        }
    }

    #[test]
    fn lines_come_every_ten_seconds_and_not_at_the_end() {
        let mut live = Live::Lines { lasts: 30, said: 0 };
        let mut at = |second| {
            let elapsed = Duration::from_secs(second);
            live.say(&Progress { elapsed, phase: "run", chunks: 0, faults: 0, last: None });
            let Live::Lines { said, .. } = live else { panic!("lines") };
            said
        };
        assert_eq!([at(9), at(11), at(12), at(21), at(30), at(40)], [0, 11, 11, 21, 21, 21]);
    }
}
