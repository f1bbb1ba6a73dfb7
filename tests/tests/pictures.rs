//! The headless viewer against golden pictures.

use client::gpu::Image;
use client::headless::{self, Options};
use client::native::stream::{ServerStream, Settings};
use client::scene::Scene;
use client::stats::Stats;
use client::stream::LocalStream;
use std::time::Instant;
use tests::RunningServer;
use tests::golden::{self, Difference};

fn options(camera: &str) -> Options {
    tests::options_at(camera, (256, 144))
}

/// The start view of the island scene.
const START: &str = "-5200.0,160.0,1500.0,70.0,-8.0";

/// Renders local land.
fn drawn(options: &Options) -> Option<(Image, Stats)> {
    tests::render_or_skip(LocalStream::new(1), options)
}

#[test]
fn the_island_equals_its_golden_pictures() {
    assert_eq!(options(START).pose, Scene::Island.start());
    for (name, camera) in [
        ("start", START),
        ("shore", "4700,25,500,-60,-8"),
        ("summit", "300,420,900,20,-12"),
        ("below", "900,1500,4200,-20,-60"),
    ] {
        let Some((picture, _)) = drawn(&options(camera)) else { return };
        golden::check(name, &picture).unwrap();
    }
}

#[test]
fn blank_shifted_and_other_pictures_fail_the_comparison() {
    let Some((picture, _)) = drawn(&options(START)) else { return };
    let blank = Image { rgba: vec![0; picture.rgba.len()], ..picture.clone() };
    let mut shifted = picture.clone();
    shifted.rgba.rotate_right(4 * 8);
    let sky = Image { rgba: picture.rgba[..4].repeat(picture.rgba.len() / 4), ..picture.clone() };
    for (name, other) in [("blank", blank), ("shifted by 8 pixels", shifted), ("sky only", sky)] {
        let difference = Difference::between(&picture, &other);
        assert!(!difference.is_tolerable(), "{name} passed: {difference:?}");
    }
    assert!(Difference::between(&picture, &picture).is_tolerable());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn the_streamed_picture_equals_the_local_one_byte_for_byte() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    let compared = tokio::task::spawn_blocking(move || {
        let options = options(START);
        let Some((local, _)) = drawn(&options) else { return };
        let settings = Settings::new(url.parse().unwrap());
        let feed = ServerStream::connect(settings).unwrap();
        let (streamed, stats) = headless::render(&options, feed, Instant::now(), |_| {}).unwrap();
        assert!(local.rgba == streamed.rgba, "{:?}", Difference::between(&local, &streamed));
        assert!(stats.bytes_received > 100_000 && stats.chunks_drawn > 6, "{stats:?}");
    });
    compared.await.unwrap();
    server.stop().await;
}

#[test]
fn a_small_chunk_budget_costs_detail_and_leaves_no_holes() {
    // The least budget that the viewer's option allows.
    let small = Options { chunk_bytes: 8 << 20, ..options(START) };
    let (Some((coarse, stats)), Some((fine, _))) = (drawn(&small), drawn(&options(START))) else { return };
    assert!(stats.chunk_bytes_resident <= small.chunk_bytes, "{stats:?}");
    let difference = Difference::between(&coarse, &fine);
    assert!(difference.mean < 12.0, "coarser, but the same island: {difference:?}");
}
