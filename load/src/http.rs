//! A client over HTTP, like a browser cache or a proxy: one persistent connection, one GET at a
//! time, conditional for chunks that it has received before.

mod connection;

use crate::checker::ChunkChecker;
use crate::dial::Dial;
use crate::keys::Keys;
use crate::schedule::{Action, Schedule};
use crate::session::MIN_ABANDONED_WAIT;
use crate::task::{GRACE, HANDSHAKE_TIMEOUT, STALL_TIMEOUT, SessionEnd, Task};
use bytes::Bytes;
use connection::{Connection, Response};
use hyper::StatusCode;
use protocol::Delivery;
use protocol::chunk_codec::{self, seed_only};
use rustc_hash::FxHashMap;
use serde::Deserialize;
use std::future::pending;
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};
use tokio::time::{Instant, sleep, timeout};

/// Maximum of ETags that a client remembers, about 200 KiB. Further chunks are requested without
/// condition.
const MAX_ETAGS: usize = 4096;

/// Upper bound of a Retry-After in a closed loop. An open loop ignores it.
const MAX_PAUSE: Duration = Duration::from_secs(5);

/// Digests, which are the ETags, of chunks that a client has received.
pub type EtagCache = FxHashMap<ChunkKey, [u8; 16]>;

/// The fields of `GET /v1/world` that matter here.
#[derive(Debug, Deserialize)]
struct World {
    world_seed: u64,
    generator_version: u32,
    digest: String,
}

/// Runs from connect to the end of the phase or of the connection.
pub async fn run<D: Dial>(task: &Task<'_, D>, schedule: &mut Schedule, etags: &mut EtagCache) -> SessionEnd {
    let started = Instant::now();
    let mut client = match task.until(task.end, HttpClient::admit(task)).await {
        Some(Ok(client)) => client,
        Some(Err(end)) => return end,
        // The phase ended during admission; no session was lost.
        None => {
            task.ended_in_admission(started);
            return SessionEnd::Finished;
        }
    };
    client.run(schedule, etags).await
}

/// A connected client.
struct HttpClient<'t, 'a, D: Dial> {
    task: &'t Task<'a, D>,
    connection: Connection,
    digest: WorldDigest,
    checker: ChunkChecker,
    keys: Keys,
}

impl<'t, 'a, D: Dial> HttpClient<'t, 'a, D> {
    /// Connects and requests the world's description.
    async fn admit(task: &'t Task<'a, D>) -> Result<Self, SessionEnd> {
        let config = task.config;
        let opening = async {
            let mut connection = Connection::open(task).await?;
            let answer = connection.get("/v1/world", None).await?;
            Ok::<_, String>((connection, answer))
        };
        let (connection, answer) = match timeout(HANDSHAKE_TIMEOUT, opening).await {
            Ok(Ok(both)) => both,
            Ok(Err(problem)) => {
                return Err(SessionEnd::Unreachable(format!(
                    "cannot connect to {}: {problem}",
                    config.connect
                )));
            }
            Err(_) => {
                return Err(SessionEnd::Unreachable(format!(
                    "no answer from {} within {HANDSHAKE_TIMEOUT:?}",
                    config.connect
                )));
            }
        };
        if answer.status != StatusCode::OK {
            return Err(SessionEnd::not_admitted(format!("GET /v1/world: {}", answer.problem())));
        }
        let wrong = |problem: String| SessionEnd::Wrong(format!("GET /v1/world: {problem}"));
        let world: World = serde_json::from_slice(&answer.body).map_err(|error| wrong(error.to_string()))?;
        let digest = WorldDigest::from_hex(&world.digest)
            .ok_or_else(|| wrong("the digest is not 64 hexadecimal digits".into()))?;
        let land = task
            .world
            .check(world.world_seed, world.generator_version, digest)
            .map_err(|mismatch| SessionEnd::wrong_world(&mismatch))?;
        task.admitted();
        let path = task.path(&land);
        let sample = (config.verify_every, task.index);
        Ok(Self {
            task,
            connection,
            digest,
            checker: ChunkChecker::new(land, Delivery::Exact, sample, task.counters, task.regeneration),
            keys: Keys::new(config.path, config.seed, task.index, path),
        })
    }

    async fn run(&mut self, schedule: &mut Schedule, etags: &mut EtagCache) -> SessionEnd {
        let task = self.task;
        let stop = if schedule.is_open() { task.end + GRACE } else { task.end };
        while !schedule.is_done() && Instant::now() < stop {
            let Some(action) = task.until(stop, schedule.next(0)).await else { break };
            let Action::Request(since, _) = action else { continue };
            let seconds = since.saturating_duration_since(task.epoch).as_secs_f64();
            let key = self.keys.key(schedule.next_number(), seconds);
            task.counters.request(since.elapsed());
            let sent = Instant::now();
            let (end, pause) = match task.until(stop, self.fetch(key, etags)).await {
                Some(Ok(FetchOutcome::Answered)) => {
                    task.counters.answered(since.elapsed());
                    continue;
                }
                Some(Ok(FetchOutcome::Refused(pause))) => (None, pause),
                Some(Err(end)) => (Some(end), Duration::ZERO),
                None => {
                    if sent.elapsed() >= STALL_TIMEOUT {
                        task.counters.stalled(&format!("no answer to a GET within {STALL_TIMEOUT:?}"));
                    }
                    (Some(SessionEnd::Finished), Duration::ZERO)
                }
            };
            if let Some(end) = end {
                // An interrupt cuts off an open loop too.
                let is_open = schedule.is_open() && !task.interrupt.is_cancelled();
                if is_open || since.elapsed() >= MIN_ABANDONED_WAIT {
                    task.counters.abandoned(since.elapsed());
                } else {
                    task.counters.unanswered(1);
                }
                return end;
            }
            if !schedule.is_open() && task.until(stop, sleep(pause.min(MAX_PAUSE))).await.is_none() {
                break;
            }
        }
        // An open loop without further actions still lasts until the end.
        task.until(task.end, pending::<()>()).await;
        SessionEnd::Finished
    }

    /// One GET, verified.
    async fn fetch(&mut self, key: ChunkKey, etags: &mut EtagCache) -> Result<FetchOutcome, SessionEnd> {
        if !self.connection.is_usable().await {
            // A server may close an idle connection at any time; that is no fault.
            let address = &self.task.config.connect;
            let lost = |problem| SessionEnd::Lost(format!("cannot connect to {address} again: {problem}"));
            self.connection = Connection::open(self.task).await.map_err(lost)?;
        }
        let known = etags.get(&key).copied();
        let path = format!("/v1/{}/chunk/{}/{}/{}", self.digest, key.level(), key.x(), key.z());
        let answer = self.connection.get(&path, known).await.map_err(SessionEnd::Lost)?;
        let counters = self.task.counters;
        match answer.status {
            StatusCode::OK => {
                let tag = self.take(key, &answer).await?;
                if etags.len() < MAX_ETAGS {
                    etags.insert(key, tag);
                }
                Ok(FetchOutcome::Answered)
            }
            StatusCode::NOT_MODIFIED if known.is_some() && answer.tag == known => {
                counters.not_modified();
                Ok(FetchOutcome::Answered)
            }
            StatusCode::SERVICE_UNAVAILABLE => {
                counters.refused(&format!("refused by the server: {}", answer.problem()));
                Ok(FetchOutcome::Refused(answer.retry_after))
            }
            // It was admitted before: its token has expired, or was removed.
            StatusCode::UNAUTHORIZED => Err(SessionEnd::Lost(answer.problem())),
            _ => Err(SessionEnd::Wrong(format!("GET {path}: {}", answer.problem()))),
        }
    }

    /// Verifies a chunk. Returns its ETag.
    async fn take(&mut self, key: ChunkKey, answer: &Response) -> Result<[u8; 16], SessionEnd> {
        let counters = self.task.counters;
        let frame: &Bytes = &answer.body;
        counters.chunk(frame.len());
        let wrong = |problem: String| SessionEnd::Wrong(format!("GET of chunk {key}: {problem}"));
        let chunk = chunk_codec::decode(frame, &self.digest).map_err(|error| wrong(error.to_string()))?;
        if chunk.key != key {
            return Err(wrong(format!("chunk {} came", chunk.key)));
        }
        let tag = seed_only::digest(&chunk, &self.digest);
        if answer.tag != Some(tag) {
            return Err(wrong("the ETag is not the digest of the chunk's heights and grass".into()));
        }
        self.checker.check(Box::new(chunk), Delivery::Exact).await;
        Ok(tag)
    }
}

/// Result of a GET that did not end the session.
enum FetchOutcome {
    /// A chunk or 304.
    Answered,
    /// Refused, with the time to wait.
    Refused(Duration),
}
