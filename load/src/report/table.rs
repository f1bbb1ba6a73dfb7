//! The report as a text table.

use super::{BackgroundClients, PhaseReport, Report, ResumeReport};
use crate::latency::LatencyMs;
use std::fmt;

fn ms(value: Option<f64>) -> String {
    value.map_or("-".into(), |value| format!("{value:.1}"))
}

fn rate(count: f64, seconds: f64) -> f64 {
    count / seconds.max(f64::MIN_POSITIVE)
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let megabytes = self.counts.bytes as f64 / 1e6;
        let LatencyMs { p50, p90, p99, p999, max } = self.latency_ms;
        let pace = match self.rate {
            Some(rate) if self.mode == "view" => format!("open loop, {rate} poses a second"),
            Some(rate) => format!("open loop, {rate} requests a second"),
            None if self.mode == "view" => "fixed intervals".into(),
            None => "closed loop".into(),
        };
        let requests = match self.counts.unsent {
            0 => format!("{} ({} unanswered)", self.counts.requests, self.counts.unanswered),
            unsent => format!(
                "{} ({} unanswered), {unsent} more never sent",
                self.counts.requests, self.counts.unanswered
            ),
        };
        let mut rows = vec![
            (
                "clients",
                format!(
                    "{} for {:.1} s{}",
                    self.clients,
                    self.seconds,
                    if self.interrupted { ", interrupted" } else { "" }
                ),
            ),
            ("load", format!("{} mode, path {}, {pace}", self.mode, self.path)),
            ("delivery", self.delivery.to_owned()),
            (
                "chunks",
                format!(
                    "{} ({:.0} a second)",
                    self.counts.chunks,
                    rate(self.counts.chunks as f64, self.seconds)
                ),
            ),
            ("data", format!("{megabytes:.1} MB ({:.2} MB/s)", rate(megabytes, self.seconds))),
            (
                "views settled",
                format!("{} ({} checked for missing chunks)", self.views_settled, self.views_checked),
            ),
            ("unchanged", self.counts.not_modified.to_string()),
            ("requests", requests),
            ("latency", format!("{}, in ms", self.measures)),
            ("latency p50", format!("{} ms", ms(p50))),
            ("latency p90", format!("{} ms", ms(p90))),
            ("latency p99", format!("{} ms", ms(p99))),
            ("latency p99.9", format!("{} ms", ms(p999))),
            ("latency max", format!("{} ms", ms(max))),
            ("sent late p99", format!("{} ms", ms(self.sent_late_ms.p99))),
            ("settle p50", format!("{} ms", ms(self.settle_ms.p50))),
            ("settle p99", format!("{} ms", ms(self.settle_ms.p99))),
            ("regenerated", self.regenerated.to_string()),
            ("refused", self.counts.refused.to_string()),
            ("no session", self.never_connected.to_string()),
            ("dropped", self.counts.dropped.to_string()),
            ("resumed", resumed(&self.resume)),
            ("mismatches", self.counts.mismatches.to_string()),
            ("world", self.world_changed.clone().unwrap_or_default()),
        ];
        // Rows that a mode does not have are left out.
        rows.retain(|(name, _)| match *name {
            "unchanged" => self.mode == "http",
            "views settled" => self.mode == "view",
            "resumed" => self.resume.lost > 0,
            "world" => self.world_changed.is_some(),
            "sent late p99" => self.rate.is_some(),
            "settle p50" | "settle p99" => self.mode == "view" && self.rate.is_none(),
            _ => true,
        });
        for (name, value) in rows {
            writeln!(f, "{name:<14} {value}")?;
        }
        if self.phases.len() > 1 {
            phases(&self.phases, f)?;
        }
        for (name, background) in [("slow", &self.slow), ("silent", &self.silent)] {
            if let Some(background) = background {
                background_row(name, background, f)?;
            }
        }
        self.problems.iter().try_for_each(|problem| writeln!(f, "  ! {problem}"))?;
        for (name, background) in [("slow", &self.slow), ("silent", &self.silent)] {
            let problems = background.iter().flat_map(|background| &background.problems);
            problems.into_iter().try_for_each(|problem| writeln!(f, "  ! {name}: {problem}"))?;
        }
        Ok(())
    }
}

fn resumed(resume: &ResumeReport) -> String {
    let ResumeReport { lost, resumed, held_bytes, bytes_again, .. } = resume;
    let again = 100.0 * *bytes_again as f64 / (*held_bytes).max(1) as f64;
    let gap = ms(resume.gap_ms.p99);
    format!("{resumed} of {lost} lost, gap p99 {gap} ms, {again:.1} % of held bytes sent again")
}

fn phases(phases: &[PhaseReport], f: &mut fmt::Formatter<'_>) -> fmt::Result {
    writeln!(
        f,
        "{:<14} {:>8} {:>10} {:>9} {:>9} {:>9} {:>9} {:>9} {:>9}",
        "part", "seconds", "chunks/s", "MB/s", "p50 ms", "p90 ms", "p99 ms", "p99.9 ms", "max ms"
    )?;
    for phase in phases {
        let LatencyMs { p50, p90, p99, p999, max } = phase.latency_ms;
        let [p50, p90, p99, p999, max] = [p50, p90, p99, p999, max].map(ms);
        let (chunks, megabytes) = (phase.counts.chunks as f64, phase.counts.bytes as f64 / 1e6);
        writeln!(
            f,
            "{:<14} {:>8.1} {:>10.0} {:>9.2} {p50:>9} {p90:>9} {p99:>9} {p999:>9} {max:>9}",
            phase.name,
            phase.seconds,
            rate(chunks, phase.seconds),
            rate(megabytes, phase.seconds),
        )?;
    }
    Ok(())
}

fn background_row(name: &str, background: &BackgroundClients, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    let BackgroundClients { clients, admitted, stayed, closed, chunks, .. } = background;
    write!(f, "{name:<14} {clients} clients, {admitted} admitted, {chunks} chunks; ")?;
    writeln!(
        f,
        "{} closed by the server, {stayed} still connected at the end",
        closed.values().sum::<u64>()
    )?;
    closed.iter().try_for_each(|(why, count)| writeln!(f, "{:<14} {count} x {why}", ""))
}

#[cfg(test)]
mod tests {
    use crate::{LoadConfig, Report, RunStats};
    use std::time::Duration;

    fn report(warm_up_s: u64, slow: u32) -> Report {
        let address = "ws://127.0.0.1:1/v1/stream".parse().unwrap();
        let config = LoadConfig { warm_up_s, slow, ..LoadConfig::new(address) };
        let stats = RunStats::new(&config);
        stats.phases[0].1.chunk(1000);
        stats.slow.closed("too slow");
        Report::new(&config, &stats, Duration::from_secs(3600))
    }

    #[test]
    fn the_table_has_rates_units_and_the_loop() {
        let table = report(0, 0).to_string();
        assert!(table.contains("1 (0 a second)") && table.contains("MB/s"), "{table}");
        assert!(table.contains("latency p99.9  - ms"), "no answer is not zero: {table}");
        assert!(table.contains("0 (0 checked for missing chunks)"), "{table}");
        assert!(table.contains("fixed intervals") && !table.contains("part"), "{table}");
    }

    #[test]
    fn phases_and_slow_clients_have_rows() {
        let table = report(3, 2).to_string();
        let rows = |name: &str| table.lines().filter(|line| line.starts_with(name)).count();
        assert_eq!(["part", "cold", "warm", "slow"].map(rows), [1; 4], "{table}");
        assert!(table.contains("1 x too slow"), "{table}");
    }
}
