//! Clients that take memory and read nothing, more than a server with a hard limit of memory has
//! room for: it must reject sessions at its mark, live, and accept sessions again when they are
//! gone.

use crate::clients::other_thread;
use crate::connection::{Connection, answer, loopback, open_from};
use crate::polite;
use crate::server_process::ServerProcess;
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::{at, fill};
use protocol::limits::{MAX_CREDITS, MAX_VIEW_ESTIMATE, MAX_VIEWPORT};
use protocol::message::ClientMessage;
use protocol::view::View;
use serde_json::{Value, json};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use terrain::lod::{self, MAX_VIEW_DISTANCE_M};
use tokio_util::either::Either;

/// The limit, bytes: a server with the default settings is far below the mark without clients.
pub const LIMIT: u64 = 192 * 1024 * 1024;

/// The options of the control.
pub const WITHOUT: [&str; 2] = ["--measure-without", "memory-mark"];

/// Clients, fewer than the sessions that the server accepts by default, each with an own address.
const CLIENTS: usize = 900;

/// Keys in one request.
const TOGETHER: usize = 256;

/// The receive buffer of a client, bytes.
const RECEIVE_BUFFER: u32 = 4096;

/// Length of the load, of a session that the server does not end, and between two samples of
/// `/readyz`.
pub const LENGTH: Duration = Duration::from_secs(60);
pub const SESSION: Duration = Duration::from_secs(15);
const INTERVAL: Duration = Duration::from_millis(200);

/// Time between two attempts to begin a session at the end of the load.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Longest time beyond the length until the server rejects a session, so that the load ends there.
const MARK_WAIT: Duration = Duration::from_secs(10);

/// Longest time until the server is ready again.
const RECOVERY: Duration = Duration::from_secs(60);

/// Polite clients before and after, the time between two requests, and the length.
const POLITE: usize = 4;
const POLITE_INTERVAL: Duration = Duration::from_millis(20);
const POLITE_LENGTH: Duration = Duration::from_secs(5);

/// The counts of the clients.
#[derive(Debug, Default)]
struct Counts {
    accepted: AtomicU64,
    rejected: AtomicU64,
}

/// Applies the load, and polite clients before and after.
pub async fn load(server: &ServerProcess, keys: &Arc<[ChunkKey]>) -> Result<Value> {
    let address = server.address;
    let (for_before, rest) = keys.split_at(2048);
    let (for_after, requested) = rest.split_at(2048);
    let polite = |keys, end| polite::several(address, keys, POLITE, POLITE_INTERVAL, end);
    let before = polite(for_before, Instant::now() + POLITE_LENGTH).await?;

    let end = Instant::now() + LENGTH;
    let (counts, requested): (Arc<Counts>, Arc<[ChunkKey]>) = (Arc::default(), requested.into());
    let clients = other_thread()?;
    for index in 0..CLIENTS {
        let (counts, requested) = (Arc::clone(&counts), Arc::clone(&requested));
        clients.spawn(async move {
            while Instant::now() < end + MARK_WAIT {
                let until = (end + MARK_WAIT).min(Instant::now() + SESSION);
                match unread(loopback(index), index, address, &requested, until).await {
                    Ok(()) => _ = counts.accepted.fetch_add(1, Ordering::Relaxed),
                    Err(error) if format!("{error:#}").contains(" 503 ") => {
                        counts.rejected.fetch_add(1, Ordering::Relaxed);
                    }
                    // The client's own machine failed, or the session ended in its handshake.
                    Err(_) => {}
                }
                tokio::time::sleep(INTERVAL).await;
            }
        });
    }
    let sampling = async {
        let (mut samples, mut marked) = (0_u32, 0_u32);
        while Instant::now() < end {
            samples += 1;
            marked += u32::from(is_marked(address).await?);
            tokio::time::sleep(INTERVAL).await;
        }
        // The load ends while the server rejects sessions.
        let mut ends_marked = is_rejected(address).await;
        while !ends_marked && Instant::now() < end + MARK_WAIT {
            tokio::time::sleep(POLL_INTERVAL).await;
            ends_marked = is_rejected(address).await;
        }
        anyhow::Ok((samples, marked, ends_marked))
    };
    let sampled = sampling.await;
    // Before an error ends this task: a runtime must not be dropped in another one.
    clients.shutdown_background();
    let (samples, marked, ends_marked) = sampled?;
    let ended = Instant::now();
    let recovery_s = loop {
        if Connection::connect(address).await.is_ok() {
            break Some(ended.elapsed().as_secs_f64()).filter(|_| ends_marked);
        }
        if ended.elapsed() > RECOVERY {
            break None;
        }
        tokio::time::sleep(INTERVAL).await;
    };
    // Sessions whose clients are gone end when a write fails.
    tokio::time::sleep(SESSION).await;
    let after = polite(for_after, Instant::now() + POLITE_LENGTH).await?;
    Ok(json!({
        "clients": CLIENTS,
        "accepted": counts.accepted.load(Ordering::Relaxed),
        "rejected": counts.rejected.load(Ordering::Relaxed),
        "marked_share": f64::from(marked) / f64::from(samples),
        "recovery_s": recovery_s,
        "chunks_share_after": after.chunks as f64 / before.chunks as f64,
    }))
}

/// Whether the server rejects a session.
async fn is_rejected(address: SocketAddr) -> bool {
    let connected = Connection::connect(address).await;
    connected.is_err_and(|error| format!("{error:#}").contains(" 503 "))
}

/// Whether the server says that it is not ready for lack of memory.
pub async fn is_marked(address: SocketAddr) -> Result<bool> {
    let (_, body) = answer(address, "/readyz").await.context("/readyz")?;
    Ok(String::from_utf8_lossy(&body).contains("memory"))
}

/// One session from an address that sends the largest view, requests all that it may and reads
/// nothing. Sessions of different numbers request different chunks.
///
/// # Errors
/// There is no session; ` 503 ` is in the text of a rejected one.
pub async fn unread(
    source: IpAddr,
    index: usize,
    address: SocketAddr,
    keys: &[ChunkKey],
    until: Instant,
) -> Result<()> {
    let stream = open_from(source, address, Some(RECEIVE_BUFFER)).await?;
    // There are more attempts a minute than ports, and one that ended otherwise would keep its port
    // for so long.
    stream.set_zero_linger()?;
    let mut connection = Connection::over(Either::Left(stream), address).await?;
    let start = index * TOGETHER % keys.len();
    let own: Vec<_> = keys.iter().copied().cycle().skip(start).take(MAX_CREDITS as usize / 4).collect();
    let send = async {
        connection.send(&[ClientMessage::View(largest_view(index as u32))]).await?;
        for keys in own.chunks(TOGETHER) {
            connection.request(keys.iter().copied(), true).await?;
        }
        std::future::pending::<Result<()>>().await
    };
    // It ends at its time, or when the server ends it.
    let _ = tokio::time::timeout_at(until.into(), send).await;
    Ok(())
}

/// The view with the smallest tolerance that the server accepts.
fn largest_view(id: u32) -> View {
    let mut view = View {
        id,
        eye: [0, 25_600, 0],
        velocity: [0; 3],
        yaw_mdeg: 0,
        pitch_mdeg: 0,
        fov_mdeg: 60_000,
        viewport: [MAX_VIEWPORT; 2],
        tolerance_q4: 1,
        distance_m: MAX_VIEW_DISTANCE_M,
    };
    while lod::estimated_chunks(&view.viewer()) > MAX_VIEW_ESTIMATE {
        view.tolerance_q4 += 1;
    }
    view
}

/// The bars of this load.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let is_running = figures.pointer("/is_running").and_then(Value::as_bool) == Some(true);
    vec![
        Bar::at_least(
            "192 MiB and 900 clients that never read, 1 min: sessions rejected",
            at(figures, "rejected").filter(|_| at(figures, "marked_share") > Some(0.0)),
            "",
            1.0,
        )
        .with_note("counts only if the server was not ready for lack of memory while the load ran"),
        Bar::none("the same: processes killed at the mark", at(figures, "killed").filter(|_| is_running)),
        Bar::reported("the same: most memory at the mark", at(figures, "peak_mib"), "MiB"),
        Bar::at_most("the same: time until sessions begin again", at(figures, "recovery_s"), "s", 60.0)
            .with_note("until a session is accepted, from a moment at which one is rejected"),
        Bar::at_least(
            "the same: polite clients' chunks after over before",
            at(figures, "chunks_share_after"),
            "",
            0.95,
        ),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Memory mark: of {clients:.0} clients that read nothing {accepted:.0} sessions were \
                accepted and {rejected:.0} rejected; /readyz named the memory in \
                {marked_share*100:.0} % of the samples.";
    vec![fill(line, figures)]
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::test_bars::check;

    /// Figures that meet every bar.
    pub fn good() -> Value {
        json!({
            "is_running": true, "killed": 0, "peak_mib": 160.0, "rejected": 100, "marked_share": 0.5,
            "recovery_s": 2.0, "chunks_share_after": 1.0,
        })
    }

    #[test]
    fn each_bar_can_be_missed() {
        let good = good();
        let bad = [
            ("/killed", json!(1)),
            ("/is_running", json!(false)),
            ("/rejected", json!(0)),
            ("/marked_share", json!(0.0)),
            ("/recovery_s", json!(null)),
            ("/recovery_s", json!(61.0)),
            ("/chunks_share_after", json!(0.9)),
        ];
        check(bars, &good, &bad);
    }
}
