//! Memory of the server for each idle connection.

use crate::Plan;
use crate::at;
use crate::connection::Connection;
use crate::server_process::{ServerProcess, series};
use anyhow::Result;
use bars::{Bar, Limit};
use serde_json::{Value, json};
use std::time::Duration;

/// Measured clients, and clients that connect before the first measurement.
const CLIENTS: usize = 1000;
const WARM_UP: usize = 50;

/// Runs the benchmark once.
///
/// # Errors
/// The server fails.
pub async fn run(plan: &Plan) -> Result<Value> {
    let server = ServerProcess::start(&plan.launch, &[])?;
    // The first clients cause allocations that all later ones share.
    let mut connections = connect(&server, WARM_UP).await?;
    tokio::time::sleep(Duration::from_secs(1)).await;
    let before = server.process.rss_bytes()?;
    connections.extend(connect(&server, CLIENTS).await?);
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

async fn connect(server: &ServerProcess, count: usize) -> Result<Vec<Connection>> {
    let mut connections = Vec::new();
    for _ in 0..count {
        connections.push(Connection::connect(server.address).await?);
    }
    Ok(connections)
}

/// The bars of this benchmark.
#[must_use]
pub fn bars(figures: &Value) -> Vec<Bar> {
    // A figure counts only if all clients were really connected.
    let all_connected = at(figures, "/sessions") >= at(figures, "/clients").or(Some(f64::INFINITY));
    let figure = at(figures, "/rss_kib_per_client").filter(|_| all_connected);
    vec![Bar::new("memory of an idle client", figure, "KiB", Limit::AtMost(48.0)).with_note(
        "growth of the resident set over 1,000 connections after 50, measured once; the kernel \
             grows it in huge pages of 2 MiB, 2 KiB a client",
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
