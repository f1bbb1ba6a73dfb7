//! The deliveries: equal land, equal pictures, and servers that lie.

use client::camera::Lens;
use client::feed::{Feed, FeedEvent};
use client::headless::{self, HeadlessError, Options};
use client::native::stream::{Settings, SocketFeed};
use client::render::Picture;
use client::scene::Scene;
use client::stats::Stats;
use protocol::chunk_codec::{encode_for, quantised};
use protocol::client::{ClientConfig, Event};
use protocol::limits::SEED_ONLY_FRAME;
use protocol::{Delivery, Tolerance};
use std::time::{Duration, Instant};
use terrain::{Chunk, Land, WorldDigest};
use tests::RunningServer;
use tests::golden::{self, Difference};
use tests::liar::{Frames, Liar};
use tests::peer::{Guest, guest_config, view};
use tests::running::quick_config;

/// Those that bring every height as it is.
const DELIVERIES: [Delivery; 3] = [Delivery::Exact, Delivery::Refined, Delivery::SeedOnly];

fn config(delivery: Delivery) -> ClientConfig {
    ClientConfig { delivery, ..guest_config() }
}

/// The chunks of a view by key, and the bytes that they came as.
async fn received(url: &str, delivery: Delivery) -> (Vec<Chunk>, usize) {
    let mut guest = Guest::connect_as(url, config(delivery)).await;
    let (mut chunks, mut total) = (Vec::new(), 0);
    for event in guest.settle(view(1, 1200)).await {
        if let Event::Chunk { chunk, bytes, delivery: came } = event {
            // What can refine nothing comes exact.
            assert!(came == delivery || (delivery, came) == (Delivery::Refined, Delivery::Exact), "{came}");
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
async fn both_deliveries_bring_the_land_and_seed_only_at_36_bytes_a_chunk() {
    let server = RunningServer::start().await;
    let (exact, exact_bytes) = received(&server.stream_url(), Delivery::Exact).await;
    let (seed, seed_bytes) = received(&server.stream_url(), Delivery::SeedOnly).await;
    assert!(exact == seed && exact.len() > 30, "{} and {}", exact.len(), seed.len());
    assert_eq!(seed_bytes, seed.len() * SEED_ONLY_FRAME);
    assert!(exact_bytes > 20 * seed_bytes, "{exact_bytes} against {seed_bytes}");
    let (land, other) = (Land::new(1), Land::new(2));
    assert!(seed.iter().all(|chunk| *chunk == land.chunk(chunk.key)));
    // The control: another seed's land is not equal.
    assert!(seed.iter().any(|chunk| *chunk != other.chunk(chunk.key)));

    let text = metrics(&server).await;
    for (name, delivery, count) in [
        ("chunks", "exact", exact.len()),
        ("chunks", "seed", seed.len()),
        ("chunk_bytes", "exact", exact_bytes),
        ("chunk_bytes", "seed", seed_bytes),
    ] {
        let line = format!("tombolo_{name}_delivered_total{{delivery=\"{delivery}\"}} {count}\n");
        assert!(text.contains(&line), "{line}{text}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn quantised_delivery_brings_every_height_within_the_tolerance_for_fewer_bytes() {
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
    // Within the tolerance, and not exact after all.
    assert!((1..=u32::from(tolerance.units())).contains(&farthest), "{farthest} units");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn refined_delivery_brings_the_land_in_fewer_bytes() {
    let server = RunningServer::start().await;
    let (exact, exact_bytes) = received(&server.stream_url(), Delivery::Exact).await;
    let (refined, bytes) = received(&server.stream_url(), Delivery::Refined).await;
    assert!(exact == refined && exact.len() > 30, "{} and {}", exact.len(), refined.len());
    assert!(bytes * 10 < exact_bytes * 9, "{bytes} against {exact_bytes}");
    let text = metrics(&server).await;
    let line = format!("tombolo_chunk_bytes_delivered_total{{delivery=\"refined\"}} {bytes}\n");
    assert!(text.contains(&line), "{line}{text}");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_of_all_deliveries_at_once_get_the_same_land() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    let guests: Vec<_> = (0..9)
        .map(|index| {
            let url = url.clone();
            tokio::spawn(async move { received(&url, DELIVERIES[index % DELIVERIES.len()]).await.0 })
        })
        .collect();
    let first = received(&url, Delivery::Exact).await.0;
    for guest in guests {
        assert!(guest.await.unwrap() == first);
    }
    server.stop().await;
}

/// One unit more at one vertex, signed as if it were so.
const RAISED: Frames = |land, key, delivery| {
    let honest = land.chunk(key);
    let mut heights = honest.heights;
    heights[2000] += 1;
    let lie = Chunk::from_parts(key, heights, honest.error, honest.grass);
    encode_for(delivery, &lie, &land.digest())
};

const HONEST: Frames = |land, key, delivery| encode_for(delivery, &land.chunk(key), &land.digest());

/// What ends a viewer's session with a server: the cause and whether it tries again. None if the
/// view settles.
fn viewers_fate(url: &str, change: impl FnOnce(&mut Settings)) -> Option<(String, bool)> {
    let mut settings = Settings::new(url.parse().unwrap());
    change(&mut settings);
    let mut feed = SocketFeed::connect(settings).unwrap();
    let started = Instant::now();
    while started.elapsed() < Duration::from_secs(20) {
        match feed.poll() {
            Some(FeedEvent::Connected { .. }) => feed.set_view(view(1, 300)),
            Some(FeedEvent::Settled { .. }) => return None,
            Some(FeedEvent::Disconnected { cause, retry }) => return Some((cause, retry.is_some())),
            Some(_) => {}
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    }
    panic!("nothing happened");
}

/// As [`viewers_fate`], off the runtime's threads.
async fn fate(url: &str, delivery: Delivery) -> Option<(String, bool)> {
    let url = url.to_owned();
    let watch = move || viewers_fate(&url, |settings| settings.delivery = delivery);
    tokio::task::spawn_blocking(watch).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_viewer_that_regenerates_notices_a_lying_server() {
    let world = Land::new(1).digest();
    let liar = Liar::start(world, RAISED).await;
    let (cause, retry) = fate(&liar.stream_url, Delivery::SeedOnly).await.expect("noticed");
    assert!(cause.contains("generated here") && !retry, "{cause}");
    // The controls: the same frames pass where nobody regenerates, and honest ones pass in both
    // deliveries.
    assert_eq!(fate(&liar.stream_url, Delivery::Exact).await, None);
    let honest = Liar::start(world, HONEST).await;
    for delivery in DELIVERIES {
        assert_eq!(fate(&honest.stream_url, delivery).await, None);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_world_that_is_not_made_here_is_refused_in_seed_only_delivery() {
    // As if the server's generator were another one: its digest is not what its seed makes here.
    let theirs = WorldDigest([0xcd; 32]);
    let stranger = Liar::start(theirs, |land, key, delivery| {
        encode_for(delivery, &land.chunk(key), &WorldDigest([0xcd; 32]))
    })
    .await;
    let (cause, retry) = fate(&stranger.stream_url, Delivery::SeedOnly).await.expect("refused");
    let ours = Land::new(1).digest().to_string();
    assert!(cause.contains(&ours) && cause.contains(&theirs.to_string()) && !retry, "{cause}");
    assert!(cause.contains("use exact delivery") && cause.lines().count() == 1, "{cause}");
    assert_eq!(fate(&stranger.stream_url, Delivery::Exact).await, None, "exact delivery needs no generator");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_viewer_that_insists_on_a_world_refuses_another_with_both_digests() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    let watch = move || {
        let (served, other) = (Land::new(1).digest(), Land::new(2).digest());
        let (cause, retry) = viewers_fate(&url, |settings| settings.digest = Some(other)).expect("refused");
        assert!(cause.contains(&served.to_string()) && cause.contains(&other.to_string()), "{cause}");
        assert!(!retry && cause.lines().count() == 1, "{cause}");
        assert_eq!(viewers_fate(&url, |settings| settings.digest = Some(served)), None);
    };
    tokio::task::spawn_blocking(watch).await.unwrap();
    server.stop().await;
}

fn options() -> Options {
    Options {
        pose: Scene::Island.start(),
        lens: Lens { width: 256, height: 144, ..Options::default().lens },
        // One sample: where edges are sampled is the driver's choice.
        samples: 1,
        ..Options::default()
    }
}

/// Draws from a server; none, visibly, where there is no adapter and none is required.
fn drawn(url: &str, delivery: Delivery) -> Option<(Picture, Stats)> {
    let settings = Settings { delivery, ..Settings::new(url.parse().unwrap()) };
    let feed = SocketFeed::connect(settings).unwrap();
    match headless::render(&options(), feed, Instant::now(), |_| {}) {
        Ok(drawn) => Some(drawn),
        Err(HeadlessError::Gpu(error)) if !tests::gpu_is_required() => {
            eprintln!("SKIPPED: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn all_deliveries_draw_the_same_picture_and_the_stats_show_the_saving() {
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
        // The control: another world, regenerated as well, looks otherwise.
        let (stranger, _) = drawn(&other_url, Delivery::SeedOnly).unwrap();
        assert!(!Difference::between(&seed, &stranger).is_tolerable());
        golden::check("start", &seed).unwrap();
    };
    tokio::task::spawn_blocking(compare).await.unwrap();
    server.stop().await;
    other.stop().await;
}
