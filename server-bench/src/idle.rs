//! Memory of the server for each idle connection.

use crate::Plan;
use crate::server_process::{ServerProcess, series};
use anyhow::Result;
use bars::Bar;
use bars::figures::at;
use serde_json::{Value, json};
use std::time::Duration;

/// Measured clients, and clients that connect before the first measurement.
const CLIENTS: usize = 1000;
const WARM_UP: usize = 50;

/// Runs the benchmark once.
pub async fn run(plan: &Plan) -> Result<Value> {
    let server = ServerProcess::start(&plan.launch, &[])?;
    // The first clients cause allocations that all later ones share.
    let _first = server.connect(WARM_UP).await?;
    tokio::time::sleep(Duration::from_secs(1)).await;
    let before = server.process.rss_bytes()?;
    let _measured = server.connect(CLIENTS).await?;
    tokio::time::sleep(Duration::from_secs(1)).await;
    let after = server.process.rss_bytes()?;
    let sessions = server.metric(series::SESSIONS).await?;
    Ok(json!({
        "clients": CLIENTS,
        "sessions": sessions,
        "rss_before_bytes": before,
        "rss_after_bytes": after,
        "rss_kib_per_client": (after.saturating_sub(before)) as f64 / 1024.0 / CLIENTS as f64,
    }))
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    // A figure counts only if all clients were really connected.
    let all_connected = at(figures, "sessions") >= at(figures, "clients").or(Some(f64::INFINITY));
    let figure = at(figures, "rss_kib_per_client").filter(|_| all_connected);
    vec![Bar::at_most("memory of an idle client", figure, "KiB", 48.0).with_note(
        "growth of the resident set over 1,000 connections after 50, measured once; the kernel grows it in \
         huge pages of 2 MiB, 2 KiB a client",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({ "rss_kib_per_client": 5.0, "sessions": 1050.0, "clients": 1000 });
        check(bars, &good, &[("/rss_kib_per_client", json!(49)), ("/sessions", json!(999))]);
        check_absent(bars, &good, &[("", "sessions", 1), ("", "clients", 1), ("", "rss_kib_per_client", 1)]);
    }
}
