//! Servers that go away, and clients that reconnect.

use client::native::stream::{ServerStream, Settings};
use client::scene::Scene;
use client::stream::streamer::{Link, WorldStreamer};
use client::view::ViewParams;
use protocol::CloseCode;
use protocol::client::Event;
use std::time::{Duration, Instant};
use tests::RunningServer;
use tests::peer::{TestClient, view};
use tests::program::ServerProgram;
use tests::running::quick_config;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_draining_server_announces_the_end_and_closes_sessions() {
    let server = RunningServer::start().await;
    let mut clients = Vec::new();
    for _ in 0..5 {
        let mut client = TestClient::connect(&server.stream_url()).await;
        client.settle(view(1, 300)).await;
        clients.push(client);
    }
    let stopped = tokio::spawn(server.stop());
    for mut client in clients {
        let Event::Draining { reconnect_after_ms } = client.event().await.unwrap() else {
            panic!("no Draining message")
        };
        assert!((500..2000).contains(&reconnect_after_ms));
        let close = client.event().await.unwrap_err().expect("a close frame");
        assert_eq!(u16::from(close.code), CloseCode::GoingAway.code());
    }
    stopped.await.unwrap();
}

fn shot(tolerance_px: f64) -> ViewParams {
    tests::view_at(&Scene::Island.start().to_string(), (160, 90), 1500, tolerance_px)
}

/// Updates the streamer, with a tolerance, until the condition holds.
/// Returns the number of chunks drawn last.
fn until(
    streamer: &mut WorldStreamer<ServerStream>,
    tolerance_px: f64,
    mut condition: impl FnMut(&WorldStreamer<ServerStream>) -> bool,
) -> usize {
    let started = Instant::now();
    loop {
        let drawn = streamer.update(&shot(tolerance_px), started.elapsed(), usize::MAX, |_| {}).drawn.len();
        if condition(streamer) {
            return drawn;
        }
        assert!(started.elapsed() < Duration::from_secs(30), "{:?}", streamer.link());
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_viewer_keeps_its_chunks_and_resumes_after_a_restart() {
    let server = ServerProgram::start(&["--threads", "1"]);
    let address = server.address.clone();
    let settings = Settings::new(server.stream_url().parse().unwrap());
    let mut streamer = WorldStreamer::new(ServerStream::connect(settings).unwrap(), 512);
    // As soon as the coarsest chunks cover the view.
    let viewer = shot(4.0).viewer();
    let (tops, top) = (viewer.tops().len(), viewer.top_level());
    let covers = |streamer: &WorldStreamer<ServerStream>| {
        streamer.cache().level_histogram()[usize::from(top)] as usize >= tops
    };
    until(&mut streamer, 4.0, covers);
    server.signal("KILL");
    let had = streamer.cache().len();
    let drawn = until(&mut streamer, 4.0, |streamer| matches!(streamer.link(), Link::Waiting { .. }));
    assert!(drawn > 0 && streamer.cache().len() >= had, "the land is still there");
    drop(server);

    let _again = ServerProgram::start_at(&address, &[]);
    // A finer view, which needs the server.
    until(&mut streamer, 0.5, |streamer| {
        matches!(streamer.link(), Link::Connected(_)) && streamer.is_settled()
    });
    assert!(streamer.cache().len() > had);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_server_of_another_world_replaces_the_land() {
    let server = RunningServer::start().await;
    let (address, url) = (server.address, server.stream_url());
    let driven = tokio::task::spawn_blocking(move || {
        let settings = Settings::new(url.parse().unwrap());
        let mut streamer = WorldStreamer::new(ServerStream::connect(settings).unwrap(), 512);
        until(&mut streamer, 4.0, WorldStreamer::is_settled);
        streamer
    });
    let mut streamer = driven.await.unwrap();
    server.stop().await;
    let config = server::ServerConfig { world_seed: 2, ..quick_config() };
    let server = RunningServer::start_at(address, config).await;
    tokio::task::spawn_blocking(move || {
        let other = terrain::Land::new(2);
        until(&mut streamer, 4.0, |streamer| {
            let settled = streamer.is_settled() && matches!(streamer.link(), Link::Connected(_));
            settled
                && streamer.cache().keys().next().is_some_and(|key| {
                    streamer.cache().get(key).is_some_and(|chunk| chunk.heights == other.chunk_heights(key))
                })
        });
        for key in streamer.cache().keys().collect::<Vec<_>>() {
            assert_eq!(
                streamer.cache().get(key).unwrap().heights,
                other.chunk_heights(key),
                "{key} is of the old world"
            );
        }
    })
    .await
    .unwrap();
    server.stop().await;
}
