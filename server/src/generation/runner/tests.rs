//! Jobs on the generation threads: shared, expired, failed, encoded again, read from disk.

use super::*;
use crate::cache::disk::{Disk, DiskConfig};
use crate::generation::test_source::{
    MEASURED, chunk_request, fixture, fixture_with_deadline, flat_frame_bytes, key, request,
    request_delivery, view_selection,
};
use crate::generation::work_time::SystemClock;
use crate::generation::{FlowEvent, Generation, Limits};
use crate::limits::rate_limit::RateLimiter;
use crate::metrics::Metrics;
use crate::source::{ChunkSource, ProceduralSource};
use protocol::delivery::Tolerance;
use protocol::limits::SEED_ONLY_FRAME;
use protocol::server::ChunkRequest;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use terrain::{ChunkKey, Land, WorldDigest};

#[tokio::test]
async fn deliveries_of_a_key_share_a_job_and_only_requested_ones_are_encoded() {
    let fixture = fixture(1 << 20, 10);
    let exact = request(&fixture.service, key(1), 1).await;
    let seed = request_delivery(&fixture.service, key(1), Delivery::SeedOnly, 1).await;
    fixture.permit.send(()).unwrap();
    assert_eq!(exact.await.unwrap().unwrap().len(), flat_frame_bytes());
    assert_eq!(seed.await.unwrap().unwrap().len(), SEED_ONLY_FRAME);
    assert_eq!(fixture.metrics.generation.jobs_completed.get(), 1);
    assert_eq!(fixture.metrics.generation.coalesced.get(), 1);

    fixture.permit.send(()).unwrap();
    fixture.service.flow().frame(chunk_request(key(2), 1), Delivery::SeedOnly).await.unwrap();
    assert!(fixture.service.cached(key(2), Delivery::SeedOnly).is_some());
    assert!(fixture.service.cached(key(2), Delivery::Exact).is_none());
}

#[tokio::test]
async fn another_delivery_takes_the_error_from_the_cached_frame() {
    let fixture = fixture(1 << 20, 10);
    for (x, first, second) in
        [(1, Delivery::Exact, Delivery::SeedOnly), (2, Delivery::SeedOnly, Delivery::Exact)]
    {
        for (delivery, error) in [(first, MEASURED), (second, MEASURED + 1)] {
            fixture.permit.send(()).unwrap();
            let frame = fixture.service.flow().frame(chunk_request(key(x), 1), delivery).await.unwrap();
            assert_eq!(chunk_codec::error(&frame), Some(error), "{delivery} of {x}");
            // Until the job is removed, a further request would share its chunk.
            while fixture.service.load() > 0.0 {
                tokio::task::yield_now().await;
            }
        }
    }
}

#[tokio::test]
async fn an_expired_request_is_rejected_and_not_generated() {
    let fixture = fixture_with_deadline(1 << 20, 10, Duration::ZERO);
    let mut flow = fixture.service.flow();
    // A request of a view has no deadline, and occupies the thread.
    flow.request(chunk_request(key(0), 9), Delivery::Exact);
    while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
        tokio::task::yield_now().await;
    }
    flow.request(ChunkRequest { request: Some(7), ..chunk_request(key(1), 9) }, Delivery::Exact);
    fixture.permit.send(()).unwrap();
    assert_eq!(flow.completions().await[0].0.key, key(0));
    assert_eq!(flow.completions().await[0].1, Err(GenerationError::Overloaded));
    assert_eq!((fixture.generated.try_iter().count(), fixture.metrics.generation.jobs_expired.get()), (1, 1));
}

#[tokio::test]
async fn an_idle_server_encodes_a_fast_encoded_frame_again() {
    let fixture = fixture(1 << 20, 1000);
    let mut flow = fixture.service.flow();
    // By the initial estimate, work for some twenty milliseconds.
    for x in 0..200 {
        flow.request(chunk_request(key(x), 1), Delivery::Exact);
    }
    (0..200).for_each(|_| fixture.permit.send(()).unwrap());
    while flow.in_flight() > 0 {
        flow.completions().await;
    }
    let (fast, completed) =
        (fixture.metrics.generation.encoded_fast.get(), fixture.metrics.generation.jobs_completed.get());
    assert!((1..200).contains(&fast), "{fast}");
    let idle = async || {
        while fixture.service.load() > 0.0 {
            tokio::task::yield_now().await;
        }
    };
    idle().await;

    // The tenth was encoded under backlog and is fast-encoded; the last is not. While another
    // job runs, both are served from the cache.
    let blocker = request(&fixture.service, key(1000), 1).await;
    for x in [10, 199] {
        assert!(fixture.service.cached(key(x), Delivery::Exact).is_some());
    }
    fixture.permit.send(()).unwrap();
    blocker.await.unwrap().unwrap();
    idle().await;
    assert!(fixture.service.cached(key(199), Delivery::Exact).is_some());
    for _ in 0..2 {
        // A permit for the one expected job.
        fixture.permit.send(()).unwrap();
        fixture.service.flow().frame(chunk_request(key(10), 1), Delivery::Exact).await.unwrap();
        idle().await;
    }
    assert_eq!(
        (fixture.metrics.generation.encoded_fast.get(), fixture.metrics.generation.jobs_completed.get()),
        (fast, completed + 2)
    );
}

#[tokio::test]
async fn a_panic_fails_its_own_job_only() {
    let fixture = fixture(1 << 20, 10);
    let bad = request(&fixture.service, key(666), 2).await;
    let good = request(&fixture.service, key(1), 1).await;
    fixture.permit.send(()).unwrap();
    fixture.permit.send(()).unwrap();
    assert_eq!(bad.await.unwrap(), Err(GenerationError::Failed));
    assert!(good.await.unwrap().is_ok());
    assert_eq!(fixture.metrics.generation.jobs_failed.get(), 1);
}

#[test]
fn a_turn_pays_for_processor_time_but_not_for_a_long_interruption() {
    let time = |clock, processor| WorkTime {
        clock: Duration::from_micros(clock),
        processor: Duration::from_micros(processor),
    };
    let charge = |clock, processor| turn_charge_us(100, time(clock, processor));
    assert_eq!(charge(90, 80), 90);
    assert_eq!(charge(900, 100), 900);
    assert_eq!(charge(7000, 100), 100 * MAX_OUTLIER as i64 + QUANTUM_US, "interrupted, or waits for a disk");
    assert_eq!(charge(7000, 6900), 6900, "a costly chunk among cheap ones");
    assert_eq!(charge(7_000_000, 6_900_000), 1_000_000);
    assert_eq!(turn_charge_us(i64::MAX, time(7000, 0)), 7000);
}

#[cfg(target_os = "linux")]
#[test]
fn the_time_of_a_sleeping_thread_is_no_processor_time() {
    let least = Duration::from_millis(5);
    let clock = SystemClock::default();
    let started = WorkTime::now(&clock);
    std::thread::sleep(least);
    let slept = started.elapsed(&clock);
    assert!(slept.clock >= least && slept.processor < slept.clock, "{slept:?}");
    while started.elapsed(&clock).processor < least {
        std::hint::spin_loop();
    }
    let worked = started.elapsed(&clock);
    assert!(worked.processor >= least && worked.clock > slept.clock, "{worked:?}, {slept:?}");
}

/// The terrain, with a count of measured errors.
struct CountingSource(ProceduralSource, Arc<AtomicUsize>);

impl ChunkSource for CountingSource {
    fn world(&self) -> WorldDigest {
        self.0.world()
    }

    fn chunk(&self, id: ChunkId, known_error: Option<u32>) -> Chunk {
        self.1.fetch_add(usize::from(known_error.is_none()), Ordering::Relaxed);
        self.0.chunk(id, known_error)
    }
}

/// A service over a folder, as after a restart.
fn restarted(folder: &Path) -> (Generation, Arc<Metrics>, Arc<AtomicUsize>) {
    let measured = Arc::new(AtomicUsize::new(0));
    let source = CountingSource(ProceduralSource::new(Land::new(1)), Arc::clone(&measured));
    let (service, metrics) = over_folder(folder, source);
    (service, metrics, measured)
}

/// A service of a source over a folder.
fn over_folder(folder: &Path, source: impl ChunkSource) -> (Generation, Arc<Metrics>) {
    let metrics = Arc::new(Metrics::default());
    let config = DiskConfig { folder: folder.into(), bytes: 64 << 20 };
    let disk = Disk::new(config, &source.world(), Arc::clone(&metrics)).unwrap();
    let limits = Limits {
        threads: 1,
        cache_bytes: 1 << 20,
        jobs: 10,
        deadline: Duration::from_secs(3600),
        without: None,
    };
    let service = Generation::with_disk(source, limits, Some(disk), Arc::clone(&metrics)).unwrap();
    (service, metrics)
}

#[tokio::test]
async fn a_panic_fails_its_own_view_only() {
    let land = Land::new(1);
    let limits =
        Limits { threads: 1, cache_bytes: 1 << 20, jobs: 10, deadline: Duration::ZERO, without: None };
    let metrics = Arc::new(Metrics::default());
    let service = Generation::new(ProceduralSource::new(land), limits, Arc::clone(&metrics)).unwrap();
    let (mut bad, mut good) = (service.flow(), service.flow());
    bad.select(view_selection(666), land, None);
    good.select(view_selection(1), land, None);
    assert!(matches!(bad.next_event().await, FlowEvent::ViewFailed));
    assert!(matches!(good.next_event().await, FlowEvent::View(_)));
    assert_eq!(metrics.generation.jobs_failed.get(), 1);
    // The session of the failed view goes on.
    bad.select(view_selection(2), land, None);
    assert!(matches!(bad.next_event().await, FlowEvent::View(_)));
}

#[tokio::test]
async fn a_view_that_is_stopped_goes_on_later_and_chunks_do_not_wait_for_it() {
    let land = Land::new(1);
    let limits =
        Limits { threads: 1, cache_bytes: 1 << 20, jobs: 10, deadline: Duration::MAX, without: None };
    let metrics = Arc::new(Metrics::default());
    let service = Generation::new(ProceduralSource::new(land), limits, Arc::clone(&metrics)).unwrap();
    let (mut stopped, mut other) = (service.flow(), service.flow());
    service.stop_views(true);
    stopped.select(view_selection(1), land, None);
    for x in 0..3 {
        let chunk = ChunkRequest { key: ChunkKey::new(0, x, 0).unwrap(), request: None, priority: 0 };
        for flow in [&mut stopped, &mut other] {
            flow.request(chunk, Delivery::Exact);
            assert!(matches!(flow.next_event().await, FlowEvent::Chunks(_)));
        }
    }
    assert_eq!(metrics.generation.view_busy_seconds.get(), 0.0);
    // That of a flow that has ended is dropped.
    let mut ended = service.flow();
    ended.select(view_selection(2), land, None);
    let count = || service.shared.lock().stopped_views();
    while count() < 2 {
        tokio::task::yield_now().await;
    }
    drop(ended);
    service.stop_views(true);
    assert_eq!(count(), 1);
    assert_eq!(service.stop_views(false), 1);
    assert!(matches!(stopped.next_event().await, FlowEvent::View(_)));
}

/// The bucket's rate is 0: what it lacks is all that was charged.
#[tokio::test]
async fn the_selection_of_a_view_is_charged_with_the_time_that_the_metric_counts() {
    let land = Land::new(1);
    let limits =
        Limits { threads: 1, cache_bytes: 1 << 20, jobs: 10, deadline: Duration::ZERO, without: None };
    let metrics = Arc::new(Metrics::default());
    let service = Generation::new(ProceduralSource::new(land), limits, Arc::clone(&metrics)).unwrap();
    let client = Some("10.0.0.1".parse().unwrap());
    let bucket = RateLimiter::new(Some(0)).bucket(client);
    let mut flow = service.session(client, bucket.clone());
    assert_eq!((bucket.tokens(), metrics.generation.view_busy_seconds.get()), (0.0, 0.0));
    flow.select(view_selection(1), land, None);
    assert!(matches!(flow.next_event().await, FlowEvent::View(_)));
    let (charged_us, busy_us) = (-bucket.tokens(), metrics.generation.view_busy_seconds.get() * 1e6);
    assert!(charged_us > 0.0 && busy_us > 0.0, "{charged_us}, {busy_us}");
    // The charge is in whole microseconds, and at most `MAX_CHARGE` for a turn.
    assert!(charged_us > busy_us / 10.0 && charged_us < busy_us + 1.0, "{charged_us}, {busy_us}");
}

/// The immutable address of a chunk has one representation, before, during and after load.
#[tokio::test]
async fn a_compact_flow_gets_the_same_bytes_whatever_the_load() {
    let land = Land::new(1);
    let limits = Limits {
        threads: 1,
        cache_bytes: 16 << 20,
        jobs: 10_000,
        deadline: Duration::from_secs(3600),
        without: None,
    };
    let keys: Vec<_> = (0..400).map(|n| ChunkKey::new(0, n % 20 - 10, n / 20 - 10).unwrap()).collect();
    let compact = |key: ChunkKey| chunk_codec::encode(&land.chunk(key), &land.digest());
    let (mut fast_differs, mut compared) = (0, 0);
    for _ in 0..2 {
        let metrics = Arc::new(Metrics::default());
        let service = Generation::new(ProceduralSource::new(land), limits, Arc::clone(&metrics)).unwrap();
        let mut flow = service.flow();
        keys.iter().for_each(|key| flow.request(chunk_request(*key, 1), Delivery::Exact));
        // During the load, of keys that are queued, running or cached in the fast encoding.
        for key in keys.iter().step_by(37) {
            let frame = service.flow().compact().frame(chunk_request(*key, 1), Delivery::Exact).await;
            assert_eq!(frame.unwrap(), compact(*key), "{key}");
            compared += 1;
        }
        while flow.in_flight() > 0 {
            for (chunk, frame) in flow.completions().await {
                fast_differs += u32::from(frame.unwrap() != compact(chunk.key));
            }
        }
        // After it.
        for key in keys.iter().step_by(41) {
            let frame = service.flow().compact().frame(chunk_request(*key, 1), Delivery::Exact).await;
            assert_eq!(frame.unwrap(), compact(*key), "{key}");
        }
    }
    assert!(compared > 20 && fast_differs > 0, "the control: the load used the fast encoding");
}

#[tokio::test]
async fn every_delivery_is_read_from_disk_with_one_measured_error() {
    let folder = std::env::temp_dir().join(format!("tombolo-runner-disk-{}", std::process::id()));
    let key = ChunkKey::new(3, 1, -1).unwrap();
    let quantised = Delivery::Quantised(Tolerance::COARSEST);
    let mut frames = Vec::new();
    // A restart before each: the first measures the error, the others read it.
    for (delivery, measurements) in [(Delivery::SeedOnly, 1), (Delivery::Exact, 0), (quantised, 0)] {
        let (service, metrics, measured) = restarted(&folder);
        let frame = service.flow().frame(chunk_request(key, 1), delivery).await.unwrap();
        assert_eq!(metrics.generation.jobs_completed.get(), 1, "{delivery}");
        assert_eq!(measured.load(Ordering::Relaxed), measurements, "{delivery}");
        service.close().await;
        frames.push((delivery, frame));
    }
    let (service, metrics, measured) = restarted(&folder);
    for (delivery, frame) in &frames {
        assert_eq!(
            &service.flow().frame(chunk_request(key, 1), *delivery).await.unwrap(),
            frame,
            "{delivery}"
        );
    }
    assert_eq!((metrics.generation.jobs_completed.get(), metrics.disk_cache.hits.get()), (0, 3));
    assert_eq!(measured.load(Ordering::Relaxed), 0);
    service.close().await;

    // The control: a seed-only frame with another error, which its digest does not cover, is
    // rejected.
    let seed = files(&folder).into_iter().find(|path| path.to_string_lossy().contains(".seed.")).unwrap();
    let mut bytes = std::fs::read(&seed).unwrap();
    bytes[16] ^= 1;
    std::fs::write(&seed, bytes).unwrap();
    let (service, metrics, _) = restarted(&folder);
    let again = service.flow().frame(chunk_request(key, 1), Delivery::SeedOnly).await.unwrap();
    assert_eq!(again, frames[0].1);
    assert_eq!((metrics.disk_cache.corrupt.get(), metrics.generation.jobs_completed.get()), (1, 1));
    service.close().await;
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A source whose first call makes its chunk many times, and how long that took.
struct SlowAtFirst(ProceduralSource, Arc<OnceLock<Duration>>);

impl ChunkSource for SlowAtFirst {
    fn world(&self) -> WorldDigest {
        self.0.world()
    }

    fn chunk(&self, id: ChunkId, known_error: Option<u32>) -> Chunk {
        if self.1.get().is_none() {
            let started = Instant::now();
            (0..50).for_each(|_| drop(self.0.chunk(id, None)));
            self.1.set(started.elapsed()).unwrap();
        }
        self.0.chunk(id, known_error)
    }
}

#[tokio::test]
async fn the_duration_of_a_generation_has_no_waits_for_the_disk() {
    let folder = std::env::temp_dir().join(format!("tombolo-runner-duration-{}", std::process::id()));
    let key = ChunkKey::new(3, 1, -1).unwrap();
    let (service, ..) = restarted(&folder);
    service.flow().frame(chunk_request(key, 1), Delivery::SeedOnly).await.unwrap();
    service.close().await;

    // The first call checks the frame on disk that has the error; the second one is the generation.
    let check = Arc::new(OnceLock::new());
    let source = SlowAtFirst(ProceduralSource::new(Land::new(1)), Arc::clone(&check));
    let (service, metrics) = over_folder(&folder, source);
    let started = Instant::now();
    service.flow().frame(chunk_request(key, 1), Delivery::Exact).await.unwrap();
    let without_check = started.elapsed() - *check.get().unwrap();
    service.close().await;
    std::fs::remove_dir_all(&folder).unwrap();
    assert_eq!(metrics.generation.jobs_completed.get(), 1);
    let text = metrics.render();
    let sum = text.lines().find_map(|line| line.strip_prefix("tombolo_generation_duration_seconds_sum "));
    let seconds: f64 = sum.unwrap().parse().unwrap();
    assert!(seconds > 0.0 && seconds <= without_check.as_secs_f64(), "{seconds} s, {without_check:?}");
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let shards = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let shards = shards.filter(|path| path.is_dir());
    shards.flat_map(|shard| std::fs::read_dir(shard).unwrap().map(|entry| entry.unwrap().path())).collect()
}
