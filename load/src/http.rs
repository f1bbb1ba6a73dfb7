//! A client that asks over HTTP, as a browser's cache or a proxy does: one kept connection, one GET
//! at a time, and what it has had before it asks for conditionally.

mod connection;

use crate::agenda::{Agenda, Errand};
use crate::client::{End, GRACE, HANDSHAKE_TIMEOUT, Task};
use crate::dial::Dial;
use crate::inspection::Inspection;
use crate::keys::Keys;
use crate::path::FlightPath;
use crate::verify;
use bytes::Bytes;
use connection::{Answer, Connection};
use hyper::StatusCode;
use protocol::{Delivery, chunk_codec};
use rustc_hash::FxHashMap;
use serde::Deserialize;
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};
use tokio::time::{Instant, sleep, sleep_until, timeout, timeout_at};

/// Chunks whose tags a client remembers, about 200 KiB. When it is full no more are added, and
/// those are asked for afresh.
const MAX_VISITED: usize = 4096;

/// Longest pause that a refusal can ask a closed loop for. An open loop makes none.
const MAX_PAUSE: Duration = Duration::from_secs(5);

/// What a client has had before, with the digest that is its tag.
pub type Visited = FxHashMap<ChunkKey, [u8; 16]>;

/// What `GET /v1/world` says, as far as it matters here.
#[derive(Debug, Deserialize)]
struct World {
    world_seed: u64,
    generator_version: u32,
    digest: String,
}

/// Asks from connect to the end of the run or of the connection.
pub async fn browse<D: Dial>(task: &Task<'_, D>, agenda: &mut Agenda, visited: &mut Visited) -> End {
    let mut browser = match timeout_at(task.end, Browser::admit(task)).await {
        Ok(Ok(browser)) => browser,
        Ok(Err(end)) => return end,
        // The run ended while the server took its time; that is no session lost.
        Err(_) => return End::Finished,
    };
    browser.run(agenda, visited).await
}

/// A connected client that knows the world.
struct Browser<'t, 'a, D: Dial> {
    task: &'t Task<'a, D>,
    connection: Connection,
    digest: WorldDigest,
    inspection: Inspection,
    keys: Keys,
}

impl<'t, 'a, D: Dial> Browser<'t, 'a, D> {
    /// Connects and asks for the world.
    async fn admit(task: &'t Task<'a, D>) -> Result<Self, End> {
        let config = task.config;
        let opening = async {
            let mut connection = Connection::open(task).await?;
            let answer = connection.get("/v1/world", None).await?;
            Ok::<_, String>((connection, answer))
        };
        let (connection, answer) = match timeout(HANDSHAKE_TIMEOUT, opening).await {
            Ok(Ok(both)) => both,
            Ok(Err(problem)) => {
                return Err(End::not_admitted(format!("cannot connect to {}: {problem}", config.connect)));
            }
            Err(_) => {
                return Err(End::not_admitted(format!(
                    "no answer from {} within {HANDSHAKE_TIMEOUT:?}",
                    config.connect
                )));
            }
        };
        if answer.status != StatusCode::OK {
            return Err(End::not_admitted(format!("GET /v1/world: {}", answer.problem())));
        }
        let wrong = |problem: String| End::Wrong(format!("GET /v1/world: {problem}"));
        let world: World = serde_json::from_slice(&answer.body).map_err(|error| wrong(error.to_string()))?;
        let digest = WorldDigest::from_hex(&world.digest)
            .ok_or_else(|| wrong("the digest is not 64 hexadecimal digits".into()))?;
        let land = verify::announced(world.world_seed, world.generator_version, digest)
            .map_err(|mismatch| End::Wrong(mismatch.to_string()))?;
        task.counters.admitted();
        let path = FlightPath::new(config.path, config.seed, task.index);
        let sample = (config.verify_every, task.index);
        Ok(Self {
            task,
            connection,
            digest,
            inspection: Inspection::new(land, Delivery::Exact, sample, task.counters, task.regeneration),
            keys: Keys::new(config.path, config.seed, task.index, path),
        })
    }

    async fn run(&mut self, agenda: &mut Agenda, visited: &mut Visited) -> End {
        let task = self.task;
        let stop = if agenda.is_open() { task.end + GRACE } else { task.end };
        while !agenda.is_done() && Instant::now() < stop {
            let Errand::Ask(since, _) = agenda.next(0).await else { continue };
            let seconds = since.saturating_duration_since(task.epoch).as_secs_f64();
            let key = self.keys.key(agenda.number(), seconds);
            task.counters.request(since.elapsed());
            let (end, pause) = match timeout_at(stop, self.fetch(key, visited)).await {
                Ok(Ok(Fetched::Answered)) => {
                    task.counters.answered(since.elapsed());
                    continue;
                }
                Ok(Ok(Fetched::Refused(pause))) => (None, pause),
                Ok(Err(end)) => (Some(end), Duration::ZERO),
                Err(_) => (Some(End::Finished), Duration::ZERO),
            };
            if let Some(end) = end {
                if agenda.is_open() {
                    task.counters.abandoned(since.elapsed());
                } else {
                    task.counters.unanswered(1);
                }
                return end;
            }
            if !agenda.is_open() && timeout_at(stop, sleep(pause.min(MAX_PAUSE))).await.is_err() {
                break;
            }
        }
        // An open loop that has nothing more to do is not over before its time.
        sleep_until(task.end).await;
        End::Finished
    }

    /// One GET, verified.
    async fn fetch(&mut self, key: ChunkKey, visited: &mut Visited) -> Result<Fetched, End> {
        if !self.connection.is_usable().await {
            // A server may end an idle connection at any time; a client opens another and says
            // nothing.
            let address = &self.task.config.connect;
            let lost = |problem| End::Lost(format!("cannot connect to {address} again: {problem}"));
            self.connection = Connection::open(self.task).await.map_err(lost)?;
        }
        let known = visited.get(&key).copied();
        let path = format!("/v1/{}/chunk/{}/{}/{}", self.digest, key.level(), key.x(), key.z());
        let answer = self.connection.get(&path, known).await.map_err(End::Lost)?;
        let counters = self.task.counters;
        match answer.status {
            StatusCode::OK => {
                let tag = self.take(key, &answer).await?;
                if visited.len() < MAX_VISITED {
                    visited.insert(key, tag);
                }
                Ok(Fetched::Answered)
            }
            StatusCode::NOT_MODIFIED if known.is_some() && answer.tag == known => {
                counters.not_modified();
                Ok(Fetched::Answered)
            }
            StatusCode::SERVICE_UNAVAILABLE => {
                counters.refused(&format!("refused by the server: {}", answer.problem()));
                Ok(Fetched::Refused(answer.retry_after))
            }
            StatusCode::UNAUTHORIZED => Err(End::NotAdmitted { problem: answer.problem(), retry: false }),
            _ => Err(End::Wrong(format!("GET {path}: {}", answer.problem()))),
        }
    }

    /// Verifies a chunk and lets it go. Returns its tag.
    async fn take(&mut self, key: ChunkKey, answer: &Answer) -> Result<[u8; 16], End> {
        let counters = self.task.counters;
        let frame: &Bytes = &answer.body;
        counters.chunk(frame.len());
        let wrong = |problem: String| End::Wrong(format!("GET of chunk {key}: {problem}"));
        let chunk = chunk_codec::decode(frame, &self.digest).map_err(|error| wrong(error.to_string()))?;
        if chunk.key != key {
            return Err(wrong(format!("chunk {} came", chunk.key)));
        }
        let tag = chunk_codec::digest(frame).filter(|digest| answer.tag == Some(*digest));
        let tag = tag.ok_or_else(|| wrong("the ETag is not the digest of the frame".into()))?;
        self.inspection.inspect(Box::new(chunk), Delivery::Exact).await;
        Ok(tag)
    }
}

/// How a GET went that did not end the session.
enum Fetched {
    /// The chunk, or that it is unchanged.
    Answered,
    /// Come back after this time.
    Refused(Duration),
}
