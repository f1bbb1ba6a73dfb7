//! The request coalescing in many schedules of its threads.
//!
//! Shuttle runs each test with every switch of threads at a lock, a spawn or a yield chosen by it:
//! at random, or by the method of Burckhardt et al., "A randomized scheduler with probabilistic
//! guarantees of finding bugs" (ASPLOS 2010), in which a bug of few switches is found with a known
//! probability. A failure prints its schedule, which `shuttle::replay` runs again.
//!
//!     RUSTFLAGS="--cfg shuttle" cargo test -p tombolo-server --lib schedules \
//!         --target-dir target/shuttle
//!     TOMBOLO_SCHEDULES=100000 ... the same with more of them
//!
//! Channels and caches are those of the product and change in one step. Only the order of such
//! steps between the threads may differ.

use super::flow::Flow;
use super::queue::FrameRequest;
use super::shared::Shared;
use super::{Generation, GenerationError, Limits};
use crate::chunk_id::ChunkId;
use crate::limits::rate_limit::TokenBucket;
use crate::metrics::Metrics;
use crate::source::ChunkSource;
use crate::traces::RequestTrace;
use bytes::Bytes;
use protocol::Delivery;
use protocol::server::ChunkRequest;
use rustc_hash::FxHashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey, GrassSeed, WorldDigest};
use tokio::time::Instant;

/// Schedules of each kind without the variable.
const SCHEDULES: usize = 2_000;

/// Switches of threads that a bug may need, for the method with a known probability.
const DEPTH: usize = 3;

/// Numbers of generation threads; each test runs with both.
const THREADS: [usize; 2] = [1, 2];

/// How often each chunk was generated.
type Counts = Arc<Mutex<FxHashMap<ChunkKey, u32>>>;

/// Flat chunks of which each takes two steps to generate.
struct CountingSource(Counts);

impl ChunkSource for CountingSource {
    fn world(&self) -> WorldDigest {
        WorldDigest([7; 32])
    }

    fn chunk(&self, ChunkId { key, .. }: ChunkId, _known_error: Option<u32>) -> Chunk {
        *self.0.lock().unwrap().entry(key).or_default() += 1;
        shuttle::thread::yield_now();
        assert_ne!(key, self::key(666), "this key panics");
        let grass = GrassSeed { seed: 0, palette: 0, density: Box::new([0; 256]) };
        Chunk::from_parts(key, Box::new([0; VERTEX_COUNT]), 0, grass)
    }
}

/// A key of a level that has one encoding, so that it is never encoded again.
fn key(x: i32) -> ChunkKey {
    ChunkKey::new(1, x, 0).unwrap()
}

fn chunk_request(key: ChunkKey) -> ChunkRequest {
    ChunkRequest { key, request: None, priority: 1 }
}

fn service(threads: usize) -> (Generation, Counts) {
    let counts = Counts::default();
    let deadline = Duration::from_secs(3600);
    let limits = Limits { threads, cache_bytes: 1 << 24, jobs: 16, deadline, without: None };
    let source = CountingSource(Arc::clone(&counts));
    (Generation::new(source, limits, Arc::new(Metrics::default())).unwrap(), counts)
}

/// A planted bug of the request coalescing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Bug {
    /// The cache is looked up before the lock of the queue is taken: a chunk that is finished in
    /// between is generated again.
    EarlyLookup,
    /// A thread that found no work is counted until it has released the lock: no caller starts
    /// another for a job that comes in between.
    LateLeave,
}

/// Requests a chunk, as [`Flow::request`] or as it would with the bug.
fn request(flow: &mut Flow, key: ChunkKey, bug: Option<Bug>) {
    let shared = Arc::clone(&flow.shared);
    let id = ChunkId::base(key);
    if bug == Some(Bug::EarlyLookup)
        && let Some(frame) = shared.frames.get(id, Delivery::Exact, || false)
    {
        return flow.sender.send(vec![(chunk_request(key), Ok(frame))]).unwrap();
    }
    if bug.is_none() {
        return flow.request(chunk_request(key), Delivery::Exact);
    }
    let mut queue = shared.lock();
    if bug != Some(Bug::EarlyLookup)
        && let Some(frame) = shared.frames.get(id, Delivery::Exact, || false)
    {
        return flow.sender.send(vec![(chunk_request(key), Ok(frame))]).unwrap();
    }
    let request = FrameRequest {
        flow: flow.id(),
        turns: flow.turns(),
        chunk: chunk_request(key),
        id,
        delivery: Delivery::Exact,
        must_be_compact: false,
        bucket: TokenBucket::default(),
        since: Instant::now(),
        sender: flow.sender.clone(),
        trace: RequestTrace::current(),
    };
    queue.enqueue(request, 1000);
    if queue.runners < shared.limits.threads {
        queue.runners += 1;
        let shared = Arc::clone(&shared);
        shuttle::thread::spawn(move || match bug {
            Some(Bug::LateLeave) => run_and_leave_late(&shared),
            _ => while shared.run_turn() {},
        });
    }
}

/// A generation thread with [`Bug::LateLeave`]; only what the tests need of one.
fn run_and_leave_late(shared: &Shared) {
    loop {
        let turn = shared.lock().take(1000, shared.limits.deadline, Instant::now());
        if turn.chunks.is_empty() {
            shared.lock().runners -= 1;
            return;
        }
        let finished: Vec<_> = turn.chunks.into_iter().map(|id| shared.run_job(id)).collect();
        shared.send_results(&finished, |queue| queue.end_turn(turn.path, 0, None));
    }
}

/// The next result of a flow; with a bug there may never be one.
fn result(flow: &mut Flow, bug: Option<Bug>) -> Result<Bytes, GenerationError> {
    shuttle::future::block_on(async {
        // A planted request is not counted by its flow.
        match bug {
            None => flow.completions().await.pop().unwrap().1,
            Some(_) => flow.receiver.recv().await.unwrap().pop().unwrap().1,
        }
    })
}

/// Asserts that nothing is left when all requests have ended.
fn assert_idle(service: &Generation) {
    loop {
        let queue = service.shared.lock();
        if queue.runners == 0 {
            assert_eq!((queue.jobs(), queue.waiting()), (0, 0));
            break;
        }
        drop(queue);
        shuttle::thread::yield_now();
    }
    assert_eq!(service.shared.active.len(), 0);
}

/// Three clients request the same two chunks in different orders.
fn clients_share_chunks(threads: usize, bug: Option<Bug>) {
    let (service, counts) = service(threads);
    let clients: Vec<_> = [[1, 2], [2, 1], [1, 2]]
        .into_iter()
        .map(|keys| {
            let service = service.clone();
            shuttle::thread::spawn(move || {
                let mut flow = service.flow();
                keys.map(|x| {
                    request(&mut flow, key(x), bug);
                    result(&mut flow, bug).unwrap()
                })
            })
        })
        .collect();
    let frames: Vec<_> = clients.into_iter().map(|client| client.join().unwrap()).collect();
    assert_eq!(frames[0], frames[2]);
    assert_eq!(frames[0][0], frames[1][1]);
    assert_idle(&service);
    let counts = counts.lock().unwrap();
    assert_eq!((counts[&key(1)], counts[&key(2)]), (1, 1), "each chunk is generated once");
}

/// One client leaves at any time, another cancels, a third stays: it alone must be served, and each
/// request ends once.
fn clients_leave_and_cancel(threads: usize) {
    let (service, counts) = service(threads);
    let leaves = service.clone();
    let leaves = shuttle::thread::spawn(move || {
        let mut flow = leaves.flow();
        for x in [1, 2, 3] {
            flow.request(chunk_request(key(x)), Delivery::Exact);
        }
    });
    let cancels = service.clone();
    let cancels = shuttle::thread::spawn(move || {
        let mut flow = cancels.flow();
        for x in [1, 2] {
            flow.request(chunk_request(key(x)), Delivery::Exact);
        }
        shuttle::thread::yield_now();
        let cancelled = flow.cancel(key(1)).len();
        let mut completed = 0;
        while flow.in_flight() > 0 {
            let done = shuttle::future::block_on(flow.completions());
            assert!(done.iter().all(|(_, result)| result.is_ok()));
            completed += done.len();
        }
        assert_eq!(cancelled + completed, 2, "each request ends once");
        assert!(flow.try_completions().is_none());
    });
    let mut flow = service.flow();
    for x in [2, 1] {
        flow.request(chunk_request(key(x)), Delivery::Exact);
        result(&mut flow, None).unwrap();
    }
    drop(flow);
    leaves.join().unwrap();
    cancels.join().unwrap();
    assert_idle(&service);
    let counts = counts.lock().unwrap();
    assert!(counts.values().all(|count| *count == 1), "each chunk is generated at most once");
    assert!(counts.contains_key(&key(1)) && counts.contains_key(&key(2)));
}

/// A chunk whose generation panics fails for all who wait, and nothing else fails.
fn a_panic_fails_its_own_chunk(threads: usize) {
    let (service, _) = service(threads);
    let clients: Vec<_> = [[666, 1], [1, 666]]
        .into_iter()
        .map(|keys| {
            let service = service.clone();
            shuttle::thread::spawn(move || {
                let mut flow = service.flow();
                for x in keys {
                    request(&mut flow, key(x), None);
                    assert_eq!(result(&mut flow, None).is_ok(), x != 666);
                }
            })
        })
        .collect();
    clients.into_iter().for_each(|client| client.join().unwrap());
    assert_idle(&service);
}

/// Runs a test in all schedules of both kinds, with each number of threads.
fn check(test: impl Fn(usize) + Send + Sync + Copy + 'static) {
    let schedules = std::env::var("TOMBOLO_SCHEDULES").map_or(SCHEDULES, |n| n.parse().expect("a number"));
    for threads in THREADS {
        shuttle::check_random(move || test(threads), schedules);
        shuttle::check_pct(move || test(threads), schedules, DEPTH);
    }
    println!("schedules without a failure: {}", 2 * THREADS.len() * schedules);
}

#[test]
fn clients_that_request_the_same_chunks_share_one_generation() {
    check(|threads| clients_share_chunks(threads, None));
}

#[test]
fn clients_that_leave_or_cancel_affect_no_other() {
    check(clients_leave_and_cancel);
}

#[test]
fn a_panic_fails_one_chunk_for_all_who_wait() {
    check(a_panic_fails_its_own_chunk);
}

#[test]
fn planted_bugs_are_found() {
    for bug in [Bug::EarlyLookup, Bug::LateLeave] {
        let is_found = |threads| {
            let run = || shuttle::check_random(move || clients_share_chunks(threads, Some(bug)), SCHEDULES);
            catch_unwind(AssertUnwindSafe(run)).is_err()
        };
        assert!(THREADS.into_iter().any(is_found), "{bug:?} is not found");
    }
}
