//! A polite client: one chunk at a time, at a fixed rate, whatever the server does.

use crate::connection::{Connection, Received};
use crate::rounds::quantile_ms;
use anyhow::{Context, Result};
use protocol::message::ServerMessage;
use rustc_hash::FxHashMap;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use terrain::ChunkKey;

/// The client waits so long after the end for chunks that it requested.
const GRACE: Duration = Duration::from_secs(2);

/// Time until a client that was rejected connects again.
const RETRY: Duration = Duration::from_millis(200);

/// The totals that one or several polite clients received.
#[derive(Clone, Debug)]
pub struct Polite {
    pub chunks: usize,
    /// Requests that were refused, and attempts to begin a session.
    pub refused: usize,
    /// Time of each request; one without a chunk counts with the time until the client gave up.
    pub latencies: Vec<Duration>,
}

impl Polite {
    /// The 99th percentile of all requests, milliseconds; not a number without requests.
    pub fn p99_ms(&self) -> f64 {
        self.quantile_ms(0.99)
    }

    /// The 90th, which a few stalls do not change.
    pub fn p90_ms(&self) -> f64 {
        self.quantile_ms(0.9)
    }

    fn quantile_ms(&self, quantile: f64) -> f64 {
        quantile_ms(self.latencies.clone(), quantile).unwrap_or(f64::NAN)
    }
}

/// Requests chunks in the order of `keys`, one each `interval`, until `end`.
pub async fn polite(
    address: SocketAddr,
    keys: Vec<ChunkKey>,
    interval: Duration,
    end: Instant,
) -> Result<Polite> {
    let begun = Instant::now();
    let Ok(connected) = tokio::time::timeout_at(end.into(), connect(address)).await else {
        return Ok(Polite { chunks: 0, refused: 0, latencies: vec![Duration::MAX] });
    };
    let (mut connection, mut refused) = connected?;
    let mut keys = keys.into_iter();
    // The first request waits for the session.
    let mut waits_since = Some(begun);
    let mut open: FxHashMap<ChunkKey, Instant> = FxHashMap::default();
    let mut latencies = Vec::new();
    let mut ticks = tokio::time::interval(interval);
    loop {
        let now = Instant::now();
        if now >= end + GRACE || (now >= end && open.is_empty()) {
            break;
        }
        let due = tokio::select! {
            _ = ticks.tick() => true,
            received = connection.receive(|received| match received {
                Received::Message(ServerMessage::Refused(_)) => refused += 1,
                received => {
                    let sent = received.key().and_then(|key| open.remove(&key));
                    latencies.extend(sent.map(|sent| sent.elapsed()));
                }
            }) => {
                received?;
                false
            }
        };
        if due && Instant::now() < end {
            let key = keys.next().context("the run is too long for the list of keys")?;
            open.insert(key, waits_since.take().unwrap_or_else(Instant::now));
            connection.request([key], false).await?;
        }
    }
    let chunks = latencies.len();
    latencies.extend(open.values().map(Instant::elapsed));
    Ok(Polite { chunks, refused, latencies })
}

/// Begins a session. As clients do, it connects again where the server answers that it has no room
/// for the moment; how often that was comes back with it.
async fn connect(address: SocketAddr) -> Result<(Connection, usize)> {
    let mut rejected = 0;
    loop {
        match Connection::connect(address).await {
            Err(error) if format!("{error:#}").contains(" 503 ") => {
                rejected += 1;
                tokio::time::sleep(RETRY).await;
            }
            connected => return Ok((connected?, rejected)),
        }
    }
}

/// Several polite clients at once, each with its own part of `keys`; what they received together.
pub async fn several(
    address: SocketAddr,
    keys: &[ChunkKey],
    count: usize,
    interval: Duration,
    end: Instant,
) -> Result<Polite> {
    let parts = keys.chunks(keys.len().div_ceil(count));
    let clients: Vec<_> =
        parts.map(|part| tokio::spawn(polite(address, part.to_vec(), interval, end))).collect();
    let mut all = Polite { chunks: 0, refused: 0, latencies: Vec::new() };
    for client in clients {
        let one = client.await.context("a client failed")??;
        all.chunks += one.chunks;
        all.refused += one.refused;
        all.latencies.extend(one.latencies);
    }
    Ok(all)
}
