//! What a connected client that does nothing costs in memory.

use super::Plan;
use super::host::Host;
use super::wire::Wire;
use anyhow::Result;
use serde_json::{Value, json};
use std::time::Duration;

/// Clients, after as many as warm the server up.
const CLIENTS: usize = 1000;
const WARM_UP: usize = 50;

/// Runs the benchmark once.
///
/// # Errors
/// The server fails.
pub async fn run(plan: &Plan) -> Result<Value> {
    let host = Host::start(&plan.launch, &[])?;
    // What the first clients make the server allocate for all is not the price of one.
    let mut wires = connect(&host, WARM_UP).await?;
    tokio::time::sleep(Duration::from_secs(1)).await;
    let before = host.process.rss_bytes()?;
    wires.extend(connect(&host, CLIENTS).await?);
    tokio::time::sleep(Duration::from_secs(1)).await;
    let after = host.process.rss_bytes()?;
    let sessions = host.metric("tombolo_sessions").await?;
    Ok(json!({
        "clients": CLIENTS,
        "sessions": sessions,
        "rss_before_bytes": before,
        "rss_after_bytes": after,
        "rss_kib_per_client": (after.saturating_sub(before)) as f64 / 1024.0 / CLIENTS as f64,
    }))
}

async fn connect(host: &Host, count: usize) -> Result<Vec<Wire>> {
    let mut wires = Vec::new();
    for _ in 0..count {
        wires.push(Wire::connect(host.address).await?);
    }
    Ok(wires)
}
