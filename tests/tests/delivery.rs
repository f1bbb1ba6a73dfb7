//! The deliveries: equal land, equal pictures, and faulty servers.

use client::gpu::Image;
use client::native::stream::{ServerStream, Settings};
use client::scene::Scene;
use client::stats::Stats;
use client::stream::{ChunkStream, StreamEvent};
use protocol::chunk_codec::{encode_for, quantised};
use protocol::client::{ClientConfig, Event};
use protocol::limits::SEED_ONLY_FRAME;
use protocol::{Delivery, Tolerance};
use std::time::{Duration, Instant};
use terrain::{Chunk, Land, WorldDigest};
use tests::RunningServer;
use tests::faulty_server::{FaultyServer, Frames};
use tests::golden::{self, Difference};
use tests::peer::{TestClient, client_config, view};
use tests::running::quick_config;

/// The lossless deliveries.
const DELIVERIES: [Delivery; 3] = [Delivery::Exact, Delivery::Refined, Delivery::SeedOnly];

fn config(delivery: Delivery) -> ClientConfig {
    ClientConfig { delivery, ..client_config() }
}

/// The chunks of a view by key, and the bytes of their frames.
async fn received(url: &str, delivery: Delivery) -> (Vec<Chunk>, usize) {
    let mut client = TestClient::connect_as(url, config(delivery)).await;
    let (mut chunks, mut total) = (Vec::new(), 0);
    for event in client.settle(view(1, 1200)).await {
        if let Event::Chunk { chunk, bytes, delivery: received } = event {
            // Chunks without a parent in the reference window are exact.
            assert!(
                received == delivery || (delivery, received) == (Delivery::Refined, Delivery::Exact),
                "{received}"
            );
            chunks.push(*chunk);
            total += bytes;
        }
    }
    chunks.sort_by_key(|chunk| chunk.key);
    (chunks, total)
}

async fn metrics(server: &RunningServer) -> String {
    let url = server.url("/metrics");
    let get = move || ureq::get(url).call().unwrap().body_mut().read_to_string().unwrap();
    tokio::task::spawn_blocking(get).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn seed_only_delivery_yields_the_land_in_36_bytes_per_chunk() {
    let server = RunningServer::start().await;
    let (exact, exact_bytes) = received(&server.stream_url(), Delivery::Exact).await;
    let (seed, seed_bytes) = received(&server.stream_url(), Delivery::SeedOnly).await;
    assert!(exact == seed && exact.len() > 30, "{} and {}", exact.len(), seed.len());
    assert_eq!(seed_bytes, seed.len() * SEED_ONLY_FRAME);
    assert!(exact_bytes > 20 * seed_bytes, "{exact_bytes} against {seed_bytes}");
    let (land, other) = (Land::new(1), Land::new(2));
    assert!(seed.iter().all(|chunk| *chunk == land.chunk(chunk.key)));
    // Control: another seed's land is not equal.
    assert!(seed.iter().any(|chunk| *chunk != other.chunk(chunk.key)));

    let text = metrics(&server).await;
    for (name, delivery, count) in [
        ("chunks_sent", "exact", exact.len()),
        ("chunks_sent", "seed", seed.len()),
        ("chunk_sent_bytes", "exact", exact_bytes),
        ("chunk_sent_bytes", "seed", seed_bytes),
    ] {
        let line = format!("tombolo_{name}_total{{delivery=\"{delivery}\"}} {count}\n");
        assert!(text.contains(&line), "{line}{text}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn quantised_heights_stay_within_the_tolerance() {
    let server = RunningServer::start().await;
    let tolerance = Tolerance::within_m(0.0625).unwrap();
    let (exact, exact_bytes) = received(&server.stream_url(), Delivery::Exact).await;
    let (coarse, bytes) = received(&server.stream_url(), Delivery::Quantised(tolerance)).await;
    assert!(bytes * 4 < exact_bytes * 3, "{bytes} against {exact_bytes}");
    assert_eq!(exact.len(), coarse.len());
    let mut farthest = 0;
    for (exact, coarse) in exact.iter().zip(&coarse) {
        assert_eq!(Some(coarse), quantised::quantise(exact, tolerance).as_ref());
        let apart = exact.heights.iter().zip(&coarse.heights[..]).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        farthest = farthest.max(apart);
    }
    // Within the tolerance, and not exact.
    assert!((1..=u32::from(tolerance.units())).contains(&farthest), "{farthest} units");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn refined_delivery_yields_the_land_in_fewer_bytes() {
    let server = RunningServer::start().await;
    let (exact, exact_bytes) = received(&server.stream_url(), Delivery::Exact).await;
    let (refined, bytes) = received(&server.stream_url(), Delivery::Refined).await;
    assert!(exact == refined && exact.len() > 30, "{} and {}", exact.len(), refined.len());
    assert!(bytes * 10 < exact_bytes * 9, "{bytes} against {exact_bytes}");
    let text = metrics(&server).await;
    let line = format!("tombolo_chunk_sent_bytes_total{{delivery=\"refined\"}} {bytes}\n");
    assert!(text.contains(&line), "{line}{text}");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_of_all_deliveries_at_once_get_the_same_land() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    let clients: Vec<_> = (0..9)
        .map(|index| {
            let url = url.clone();
            tokio::spawn(async move { received(&url, DELIVERIES[index % DELIVERIES.len()]).await.0 })
        })
        .collect();
    let first = received(&url, Delivery::Exact).await.0;
    for client in clients {
        assert!(client.await.unwrap() == first);
    }
    server.stop().await;
}

/// One vertex raised by one unit, with a digest that matches.
const RAISED: Frames = |land, key, delivery| {
    let correct = land.chunk(key);
    let mut heights = correct.heights;
    heights[2000] += 1;
    let raised = Chunk::from_parts(key, heights, correct.error, correct.grass);
    encode_for(delivery, &raised, &land.digest())
};

const CORRECT: Frames = |land, key, delivery| encode_for(delivery, &land.chunk(key), &land.digest());

/// The end of a viewer's session: the cause, and whether the viewer retries. None if the view
/// settles.
fn viewer_outcome(url: &str, change: impl FnOnce(&mut Settings)) -> Option<(String, bool)> {
    let mut settings = Settings::new(url.parse().unwrap());
    change(&mut settings);
    let mut feed = ServerStream::connect(settings).unwrap();
    let started = Instant::now();
    while started.elapsed() < Duration::from_secs(20) {
        match feed.poll() {
            Some(StreamEvent::Connected { .. }) => feed.set_view(view(1, 300)),
            Some(StreamEvent::Settled { .. }) => return None,
            Some(StreamEvent::Disconnected { cause, retry }) => return Some((cause, retry.is_some())),
            Some(_) => {}
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    }
    panic!("neither settled nor disconnected");
}

/// As [`viewer_outcome`], off the runtime's threads.
async fn outcome(url: &str, delivery: Delivery) -> Option<(String, bool)> {
    let url = url.to_owned();
    let watch = move || viewer_outcome(&url, |settings| settings.delivery = delivery);
    tokio::task::spawn_blocking(watch).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn seed_only_delivery_detects_wrong_chunks() {
    let world = Land::new(1).digest();
    let faulty = FaultyServer::start(world, RAISED).await;
    let (cause, retry) = outcome(&faulty.stream_url, Delivery::SeedOnly).await.expect("detected");
    assert!(cause.contains("generated here") && !retry, "{cause}");
    // Controls: exact delivery accepts the same frames, and every delivery accepts correct ones.
    assert_eq!(outcome(&faulty.stream_url, Delivery::Exact).await, None);
    let correct = FaultyServer::start(world, CORRECT).await;
    for delivery in DELIVERIES {
        assert_eq!(outcome(&correct.stream_url, delivery).await, None);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn seed_only_delivery_rejects_another_generator() {
    // A server with another generator: its digest is not that of its seed here.
    let theirs = WorldDigest([0xcd; 32]);
    let other = FaultyServer::start(theirs, |land, key, delivery| {
        encode_for(delivery, &land.chunk(key), &WorldDigest([0xcd; 32]))
    })
    .await;
    let (cause, retry) = outcome(&other.stream_url, Delivery::SeedOnly).await.expect("refused");
    let ours = Land::new(1).digest().to_string();
    assert!(cause.contains(&ours) && cause.contains(&theirs.to_string()) && !retry, "{cause}");
    assert!(cause.contains("use exact delivery") && cause.lines().count() == 1, "{cause}");
    assert_eq!(outcome(&other.stream_url, Delivery::Exact).await, None, "exact delivery needs no generator");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_viewer_rejects_a_world_that_it_does_not_require() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    let watch = move || {
        let (served, other) = (Land::new(1).digest(), Land::new(2).digest());
        let (cause, retry) = viewer_outcome(&url, |settings| settings.digest = Some(other)).expect("refused");
        assert!(cause.contains(&served.to_string()) && cause.contains(&other.to_string()), "{cause}");
        assert!(!retry && cause.lines().count() == 1, "{cause}");
        assert_eq!(viewer_outcome(&url, |settings| settings.digest = Some(served)), None);
    };
    tokio::task::spawn_blocking(watch).await.unwrap();
    server.stop().await;
}

/// Renders the start view from a server.
fn drawn(url: &str, delivery: Delivery) -> Option<(Image, Stats)> {
    let settings = Settings { delivery, ..Settings::new(url.parse().unwrap()) };
    let feed = ServerStream::connect(settings).unwrap();
    let options = tests::options_at(&Scene::Island.start().to_string(), (256, 144));
    tests::render_or_skip(feed, &options)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn all_deliveries_draw_the_same_picture() {
    let server = RunningServer::start().await;
    let other = RunningServer::start_with(server::ServerConfig { world_seed: 2, ..quick_config() }).await;
    let (url, other_url) = (server.stream_url(), other.stream_url());
    let compare = move || {
        let Some((exact, exact_stats)) = drawn(&url, Delivery::Exact) else { return };
        let (seed, seed_stats) = drawn(&url, Delivery::SeedOnly).unwrap();
        assert!(exact.rgba == seed.rgba, "{:?}", Difference::between(&exact, &seed));
        assert_eq!((exact_stats.delivery, seed_stats.delivery), ("exact", "seed"));
        assert_eq!(exact_stats.chunks_resident, seed_stats.chunks_resident);
        assert!(seed_stats.bytes_received >= (seed_stats.chunks_resident * SEED_ONLY_FRAME) as u64);
        assert!(
            exact_stats.bytes_received > 20 * seed_stats.bytes_received,
            "{exact_stats:?} {seed_stats:?}"
        );
        let (refined, refined_stats) = drawn(&url, Delivery::Refined).unwrap();
        assert!(exact.rgba == refined.rgba, "{:?}", Difference::between(&exact, &refined));
        assert!(
            refined_stats.bytes_received < exact_stats.bytes_received,
            "{refined_stats:?} {exact_stats:?}"
        );
        // Control: another world, also regenerated, looks different.
        let (different, _) = drawn(&other_url, Delivery::SeedOnly).unwrap();
        assert!(!Difference::between(&seed, &different).is_tolerable());
        golden::check("start", &seed).unwrap();
    };
    tokio::task::spawn_blocking(compare).await.unwrap();
    server.stop().await;
    other.stop().await;
}
