//! Clients of one address that take memory and read nothing, and one of another address that opens
//! a session again and again: the others must not keep it out, neither at the memory mark nor
//! below.

use super::mark::{LENGTH, SESSION, is_marked, unread};
use crate::clients::other_thread;
use crate::connection::{Connection, Received, loopback};
use crate::server_process::ServerProcess;
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::{at, fill};
use protocol::message::ClientMessage;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use terrain::ChunkKey;

/// Clients of the address: more than its share of the sessions.
const CLIENTS: usize = 600;

/// Time between two attempts of each of them, and of the other client.
const INTERVAL: Duration = Duration::from_millis(200);

/// Time between two sessions of the other client.
const PAUSE: Duration = Duration::from_secs(1);

/// View distance of the other client, m.
const VIEW_M: u32 = 1000;

/// Longest time for the chunks of a session.
const CHUNK_WAIT: Duration = Duration::from_secs(10);

/// Time until the clients have taken the memory.
const FILL: Duration = Duration::from_secs(10);

/// What the other client found.
#[derive(Debug, Default)]
struct Found {
    sessions: u32,
    rejected: u32,
    /// Longest time from the first attempt to the chunks of a session.
    longest: Duration,
}

/// Applies the load, and opens sessions from another address meanwhile.
pub async fn load(server: &ServerProcess, keys: &Arc<[ChunkKey]>) -> Result<Value> {
    let (address, start) = (server.address, Instant::now());
    let end = start + LENGTH;
    let begun = Arc::new(AtomicU64::new(0));
    let clients = other_thread()?;
    for index in 0..CLIENTS {
        let (keys, begun) = (Arc::clone(keys), Arc::clone(&begun));
        clients.spawn(async move {
            while Instant::now() < end {
                let until = end.min(Instant::now() + SESSION);
                let ended = unread(loopback(0), index, address, &keys, until).await;
                begun.fetch_add(u64::from(ended.is_ok()), Ordering::Relaxed);
                tokio::time::sleep(INTERVAL).await;
            }
        });
    }
    tokio::time::sleep(FILL).await;
    let found = other(address, keys, end).await;
    // Before an error ends this task: a runtime must not be dropped in another one.
    clients.shutdown_background();
    let (found, marked_share) = found?;
    Ok(json!({
        "clients": CLIENTS,
        "begun": begun.load(Ordering::Relaxed),
        "sessions": found.sessions,
        "rejected": found.rejected,
        "longest_s": found.longest.as_secs_f64(),
        "marked_share": marked_share,
    }))
}

/// Opens sessions until the end, each for two chunks; what it found, and in what share of its
/// attempts the server was not ready for lack of memory.
async fn other(address: SocketAddr, keys: &[ChunkKey], end: Instant) -> Result<(Found, f64)> {
    let (mut found, mut samples, mut marked) = (Found::default(), 0_u32, 0_u32);
    // From the end of the list: not those of the clients.
    let mut keys = keys.iter().rev();
    let mut waiting_since = Instant::now();
    while Instant::now() < end {
        samples += 1;
        marked += u32::from(is_marked(address).await?);
        let key = *keys.next().context("the run is too long for the list of keys")?;
        let chunk = tokio::time::timeout(CHUNK_WAIT, one_chunk(address, key)).await;
        found.longest = found.longest.max(waiting_since.elapsed());
        if let Ok(Ok(())) = chunk {
            found.sessions += 1;
            tokio::time::sleep(PAUSE).await;
            waiting_since = Instant::now();
        } else {
            found.rejected += 1;
            tokio::time::sleep(INTERVAL).await;
        }
    }
    Ok((found, f64::from(marked) / f64::from(samples)))
}

/// A session with a view that ends when it has a requested chunk and one of the view.
async fn one_chunk(address: SocketAddr, key: ChunkKey) -> Result<()> {
    let mut connection = Connection::connect(address).await?;
    connection.send(&[ClientMessage::View(test_support::view(1, VIEW_M))]).await?;
    connection.request([key], true).await?;
    let (mut has_requested, mut has_other) = (false, false);
    while !(has_requested && has_other) {
        let take = |received: Received<'_>| {
            has_requested |= received.key() == Some(key);
            has_other |= received.key().is_some_and(|received| received != key);
        };
        connection.receive(take).await?;
    }
    Ok(())
}

/// The bars of this load.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let is_running = figures.pointer("/is_running").and_then(Value::as_bool) == Some(true);
    // Otherwise the address did not take the memory.
    let was_full = at(figures, "marked_share") > Some(0.0);
    vec![
        Bar::none(
            "192 MiB and 600 clients of one address that never read, 1 min: processes killed",
            at(figures, "killed").filter(|_| is_running),
        ),
        Bar::at_most(
            "the same: longest time until a client of another address has chunks",
            at(figures, "longest_s").filter(|_| was_full),
            "s",
            10.0,
        )
        .with_note(
            "each session has a view and a request, and ends with a chunk of each; from the first attempt; \
             counts only if no session had room",
        ),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "One address: {begun:.0} sessions of its {clients:.0} clients began; another client had \
                {sessions:.0} sessions and {rejected:.0} rejected attempts; /readyz named the memory in \
                {marked_share*100:.0} % of them.";
    vec![fill(line, figures)]
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::test_bars::check;

    /// Figures that meet every bar.
    pub fn good() -> Value {
        json!({ "is_running": true, "killed": 0, "longest_s": 1.0, "marked_share": 0.5 })
    }

    #[test]
    fn each_bar_can_be_missed() {
        let bad = [
            ("/killed", json!(1)),
            ("/is_running", json!(false)),
            ("/longest_s", json!(10.1)),
            ("/marked_share", json!(0.0)),
        ];
        check(bars, &good(), &bad);
    }
}
