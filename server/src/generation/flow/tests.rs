use super::*;
use crate::generation::test_source::{
    chunk_request, fixture, fixture_with_deadline, flat_frame_bytes, key, request,
};
use crate::generation::threads::Threads;
use crate::generation::work_time::WorkClock;
use crate::generation::{Generation, Limits};
use crate::limits::rate_limit::RateLimiter;
use crate::metrics::Metrics;
use crate::source::ChunkSource;
use protocol::delivery::Tolerance;
use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use terrain::{Chunk, WorldDigest};

#[tokio::test]
async fn the_highest_priority_comes_first_and_every_request_completes_once() {
    let fixture = fixture(1 << 20, 10);
    let mut flow = fixture.service.flow();
    flow.request(chunk_request(key(0), 0), Delivery::Exact);
    // The only thread takes the first job, so that the queue orders the rest.
    while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
        tokio::task::yield_now().await;
    }
    for (x, priority) in [(1, 10), (2, 30), (3, 20), (1, 40)] {
        flow.request(chunk_request(key(x), priority), Delivery::Exact);
    }
    assert_eq!(flow.in_flight(), 5);
    for _ in 0..4 {
        fixture.permit.send(()).unwrap();
    }
    let mut completed = Vec::new();
    while flow.in_flight() > 0 {
        for (chunk, result) in flow.completions().await {
            assert!(result.is_ok());
            completed.push(chunk.key.x());
        }
    }
    completed.sort_unstable();
    assert_eq!(completed, [0, 1, 1, 2, 3]);
    assert_eq!(fixture.generated.try_iter().collect::<Vec<_>>(), [0, 1, 2, 3].map(key));
}

#[tokio::test]
async fn a_hundred_thousand_dropped_flows_affect_no_other_flow() {
    let fixture = fixture(1 << 20, 10);
    let blocker = request(&fixture.service, key(0), 1).await;
    while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
        tokio::task::yield_now().await;
    }
    let mut kept = fixture.service.flow();
    kept.request(chunk_request(key(1), 1), Delivery::Exact);
    for _ in 0..100_000 {
        let mut flow = fixture.service.flow();
        flow.request(chunk_request(key(1), 1), Delivery::Exact);
        flow.request(chunk_request(key(2), 1), Delivery::Exact);
    }
    fixture.permit.send(()).unwrap();
    fixture.permit.send(()).unwrap();
    assert!(kept.completions().await[0].1.is_ok());
    assert!(blocker.await.unwrap().is_ok());
    assert_eq!(fixture.generated.try_iter().collect::<Vec<_>>(), [0, 1].map(key));
    assert_eq!(fixture.metrics.generation.jobs_cancelled.get(), 100_000);
    drop(kept);
    assert_eq!(fixture.service.shared.active.len(), 0);
}

/// The turns of a client that asks by HTTP are those of one session, whatever the number of its
/// requests.
#[tokio::test]
async fn all_downloads_of_a_network_take_the_turns_of_one_flow() {
    const SESSION: i32 = 20;
    let fixture = fixture(1 << 20, 1000);
    for client in [Some(IpAddr::from([10, 0, 0, 1])), None] {
        let x0 = if client.is_some() { 0 } else { 1000 };
        let blocker = request(&fixture.service, key(x0), 1).await;
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(x0))) {
            tokio::task::yield_now().await;
        }
        let mut session = fixture.service.flow();
        for x in 900..900 + SESSION {
            session.request(chunk_request(key(x0 + x), 1), Delivery::Exact);
        }
        let mut downloads: Vec<Flow> = (1..=64)
            .map(|x| {
                let mut flow = fixture.service.download(client, TokenBucket::default());
                flow.request(chunk_request(key(x0 + x), 1), Delivery::Exact);
                flow
            })
            .collect();
        let active = if client.is_some() { 3 } else { 66 };
        assert_eq!(fixture.service.shared.active.len(), active);
        // One that is dropped takes only its own request with it.
        drop(downloads.pop());
        for _ in 0..64 + SESSION {
            fixture.permit.send(()).unwrap();
        }
        assert!(blocker.await.unwrap().is_ok());
        while session.in_flight() > 0 {
            session.completions().await;
        }
        for mut flow in downloads {
            assert!(flow.completions().await[0].1.is_ok());
        }
        let generated: Vec<_> = fixture.generated.try_iter().collect();
        let last = generated.iter().rposition(|made| made.x() >= x0 + 900).unwrap();
        assert_eq!(generated.len(), 64 + SESSION as usize);
        // The control: requests without a network are flows of their own.
        assert_eq!(last < 50, client.is_some(), "{last}");
        assert_eq!(fixture.service.shared.active.len(), 0);
    }
}

/// Twenty sessions of one client are worth as many turns as the one of another, at which the
/// twenty wait for their own.
#[tokio::test]
async fn all_sessions_of_a_site_have_together_the_share_of_one() {
    let fixture = fixture(1 << 20, 1000);
    for has_sites in [true, false] {
        let x0 = if has_sites { 0 } else { 10_000 };
        let client = |number| has_sites.then_some(IpAddr::from([10, 0, 0, number]));
        let blocker = request(&fixture.service, key(x0), 1).await;
        while !fixture.service.shared.lock().is_running(ChunkId::base(key(x0))) {
            tokio::task::yield_now().await;
        }
        let session = |number, xs: std::ops::Range<i32>| {
            let mut flow = fixture.service.session(client(number), TokenBucket::default());
            xs.for_each(|x| flow.request(chunk_request(key(x0 + x), 1), Delivery::Exact));
            flow
        };
        let mut flows: Vec<_> = (1..=20).map(|n| session(1, n * 10..n * 10 + 10)).collect();
        flows.push(session(2, 1000..1050));
        let shares = flows.last().map(|flow| fixture.service.shared.active.shares(flow.turns()));
        assert_eq!(shares, Some(if has_sites { 3 } else { 22 }), "the first request is a site, too");
        for _ in 0..251 {
            fixture.permit.send(()).unwrap();
        }
        assert!(blocker.await.unwrap().is_ok());
        for flow in &mut flows {
            while flow.in_flight() > 0 {
                flow.completions().await;
            }
        }
        let generated: Vec<_> = fixture.generated.try_iter().collect();
        let last = generated.iter().rposition(|made| made.x() >= x0 + 1000).unwrap();
        // The control: sessions that are sites of their own.
        assert_eq!(last < 220, has_sites, "{last} of {}", generated.len());
    }
}

#[tokio::test]
async fn a_paused_session_has_a_share_of_its_site() {
    let service = fixture(1 << 20, 10).service;
    let session = |site| service.session(Some(IpAddr::from([10, 0, 0, site])), TokenBucket::default());
    let mut many: Vec<_> = (0..10).map(|_| session(1)).collect();
    let mut other = session(2);
    assert_eq!(service.sharers(&other), 1);
    for _ in 0..2 {
        many.iter_mut().for_each(|flow| flow.set_paused(true));
        other.set_paused(true);
    }
    // Those of one site do not lengthen the pauses of another.
    assert_eq!((service.sharers(&many[0]), service.sharers(&other)), (11, 2));
    other.set_paused(false);
    assert_eq!((service.sharers(&many[0]), service.sharers(&other)), (10, 1));
    many.truncate(4);
    assert_eq!(service.sharers(&many[0]), 4, "an ended session is not paused");
    drop(many);
    assert_eq!(service.shared.paused.len(), 0);
}

#[tokio::test]
async fn a_cancelled_request_is_neither_completed_nor_generated() {
    let fixture = fixture(1 << 20, 10);
    let mut flow = fixture.service.flow();
    flow.request(chunk_request(key(0), 9), Delivery::Exact);
    while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
        tokio::task::yield_now().await;
    }
    flow.request(chunk_request(key(1), 1), Delivery::Exact);
    assert_eq!(flow.cancel(key(0)), [], "its job is running");
    assert_eq!(flow.cancel(key(1)), [chunk_request(key(1), 1)]);
    fixture.permit.send(()).unwrap();
    assert_eq!(flow.completions().await[0].0.key, key(0));
    assert_eq!((flow.in_flight(), flow.try_completions().is_none()), (0, true));
}

#[tokio::test]
async fn a_chunk_that_is_not_generated_costs_nothing() {
    let fixture = fixture_with_deadline(1 << 20, 100, Duration::ZERO);
    // It never refills.
    let bucket = RateLimiter::new(Some(0)).bucket(Some("10.0.0.1".parse().unwrap()));
    let blocker = request(&fixture.service, key(0), 9).await;
    while !fixture.service.shared.lock().is_running(ChunkId::base(key(0))) {
        tokio::task::yield_now().await;
    }
    let mut flow = fixture.service.session(None, bucket.clone());
    for x in 1..=4 {
        flow.request(ChunkRequest { request: Some(7), ..chunk_request(key(x), 1) }, Delivery::Exact);
    }
    let of_one = bucket.tokens() / 4.0;
    assert!(of_one < 0.0, "{of_one}");
    flow.cancel(key(1));
    assert!((bucket.tokens() - 3.0 * of_one).abs() < 1e-6, "a cancelled one");
    let mut other = fixture.service.session(None, bucket.clone());
    other.request(chunk_request(key(9), 1), Delivery::Exact);
    drop(other);
    assert!((bucket.tokens() - 3.0 * of_one).abs() < 1e-6, "one of a flow that ends");
    fixture.permit.send(()).unwrap();
    while flow.in_flight() > 0 {
        flow.completions().await;
    }
    assert_eq!(fixture.metrics.generation.jobs_expired.get(), 3);
    // The refund follows the rejection.
    while bucket.tokens() < 0.0 {
        tokio::task::yield_now().await;
    }
    assert!(bucket.tokens().abs() < 1e-6 && blocker.await.unwrap().is_ok());
}

/// A clock that stands still, microseconds, but for [`SlowSource`].
#[derive(Clone, Default)]
struct Stopped(Arc<AtomicU64>);

impl WorkClock for Stopped {
    fn clock(&self) -> Duration {
        Duration::from_micros(self.0.load(Ordering::Relaxed))
    }

    fn processor(&self) -> Duration {
        self.clock()
    }
}

/// A source whose chunks take 20 ms by a clock.
struct SlowSource {
    clock: Stopped,
    land: Land,
}

impl ChunkSource for SlowSource {
    fn world(&self) -> WorldDigest {
        self.land.digest()
    }

    fn chunk(&self, id: ChunkId, _known_error: Option<u32>) -> Chunk {
        self.clock.0.fetch_add(20_000, Ordering::Relaxed);
        self.land.chunk(id.key)
    }
}

#[tokio::test]
async fn a_chunk_costs_what_it_took() {
    let (clock, land, threads) = (Stopped::default(), Land::new(1), Arc::new(Threads::start(1).unwrap()));
    let source = SlowSource { clock: clock.clone(), land };
    let limits = Limits {
        threads: 1,
        cache_bytes: 1 << 20,
        jobs: 100,
        deadline: Duration::from_secs(3600),
        without: None,
    };
    let service = Generation::on(threads, clock, source, limits, Arc::new(Metrics::default()));
    // It never refills.
    let bucket = RateLimiter::new(Some(0)).bucket(Some("10.0.0.1".parse().unwrap()));
    let mut flow = service.session(None, bucket.clone());
    flow.request(chunk_request(key(0), 1), Delivery::Exact);
    flow.completions().await;
    let charged_us = -bucket.tokens();
    // The bytes of the frame are a few more.
    assert!((20_000.0..20_010.0).contains(&charged_us), "{charged_us}");
}

#[tokio::test]
async fn a_frame_from_the_cache_is_charged_by_its_bytes() {
    let fixture = fixture(1 << 20, 100);
    fixture.permit.send(()).unwrap();
    request(&fixture.service, key(0), 1).await.await.unwrap().unwrap();
    // It never refills.
    let bucket = RateLimiter::new(Some(0)).bucket(Some("10.0.0.1".parse().unwrap()));
    let mut flow = fixture.service.session(None, bucket.clone());
    let of_frame = flat_frame_bytes() as f64 / 1024.0;
    flow.request(chunk_request(key(0), 1), Delivery::Exact);
    flow.completions().await;
    assert!((bucket.tokens() + of_frame).abs() < 1e-6, "{} of {of_frame}", bucket.tokens());
    assert!(flow.cached(key(0), Delivery::Exact).is_some());
    assert!((bucket.tokens() + 2.0 * of_frame).abs() < 1e-6, "{} of {of_frame}", bucket.tokens());
    assert!(flow.cached(key(1), Delivery::Exact).is_none());
    assert!((bucket.tokens() + 2.0 * of_frame).abs() < 1e-6, "what is not cached is free");
}

#[tokio::test]
async fn a_further_encoding_is_charged_to_the_flow_that_asks_for_it() {
    let fixture = fixture(1 << 20, 100);
    let limiter = RateLimiter::new(Some(0));
    let [one, other] = ["10.0.0.1", "10.0.0.2"].map(|address| limiter.bucket(Some(address.parse().unwrap())));
    let mut first = fixture.service.session(None, one);
    first.request(chunk_request(key(0), 1), Delivery::Exact);
    let mut second = fixture.service.session(None, other.clone());
    let mut charges = Vec::new();
    for delivery in [Delivery::Exact, Delivery::Quantised(Tolerance::COARSEST)] {
        second.request(chunk_request(key(0), 1), delivery);
        charges.push(other.tokens());
    }
    assert_eq!(charges, [0.0, 0.0]);
    fixture.permit.send(()).unwrap();
    while other.tokens() == 0.0 {
        tokio::task::yield_now().await;
    }
    assert_eq!(second.in_flight(), 2, "no bytes are charged yet");
    assert_eq!(fixture.metrics.generation.coalesced.get(), 2);
}
