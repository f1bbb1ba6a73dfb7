//! Servers that go away, and clients that live on.

use client::camera::Lens;
use client::frame::Shot;
use client::native::stream::{Settings, SocketFeed};
use client::scene::Scene;
use client::voyage::{Link, Voyage};
use protocol::CloseCode;
use protocol::client::Event;
use std::time::{Duration, Instant};
use tests::RunningServer;
use tests::peer::{Guest, view};
use tests::program::ServerProgram;
use tests::running::quick_config;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_draining_server_says_when_to_return_and_closes_every_session() {
    let server = RunningServer::start().await;
    let mut guests = Vec::new();
    for _ in 0..5 {
        let mut guest = Guest::connect(&server.stream_url()).await;
        guest.settle(view(1, 300)).await;
        guests.push(guest);
    }
    let stopped = tokio::spawn(server.stop());
    for mut guest in guests {
        let Event::Draining { reconnect_after_ms } = guest.event().await.unwrap() else {
            panic!("no notice")
        };
        assert!((500..2000).contains(&reconnect_after_ms));
        let close = guest.event().await.unwrap_err().expect("a close frame");
        assert_eq!(u16::from(close.code), CloseCode::GoingAway.code());
    }
    stopped.await.unwrap();
}

fn shot(tolerance_px: f64) -> Shot {
    Shot {
        pose: Scene::Island.start(),
        lens: Lens { fov_deg: 60.0, width: 160, height: 90 },
        view_distance_m: 1500,
        tolerance_px,
        time_s: 0.0,
        looks: client::looks::Looks::default(),
    }
}

/// Updates the voyage, seen with a tolerance, until the condition holds; gives what was drawn last.
fn until(
    voyage: &mut Voyage<SocketFeed>,
    tolerance_px: f64,
    mut condition: impl FnMut(&Voyage<SocketFeed>) -> bool,
) -> usize {
    let started = Instant::now();
    loop {
        let drawn = voyage.update(&shot(tolerance_px), started.elapsed(), usize::MAX, |_| {}).drawn.len();
        if condition(voyage) {
            return drawn;
        }
        assert!(started.elapsed() < Duration::from_secs(30), "{:?}", voyage.link());
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn the_viewer_keeps_what_it_has_while_the_server_is_gone_and_goes_on_when_it_returns() {
    let server = ServerProgram::start(&["--threads", "1"]);
    let address = server.address.clone();
    let settings = Settings::new(server.stream_url().parse().unwrap());
    let mut voyage = Voyage::new(SocketFeed::connect(settings).unwrap(), 512);
    // As soon as the coarsest chunks cover the view.
    let viewer = shot(4.0).viewer();
    let (tops, top) = (viewer.tops().len(), viewer.top_level());
    let covers =
        |voyage: &Voyage<SocketFeed>| voyage.world().level_histogram()[usize::from(top)] as usize >= tops;
    until(&mut voyage, 4.0, covers);
    server.signal("KILL");
    let had = voyage.world().len();
    let drawn = until(&mut voyage, 4.0, |voyage| matches!(voyage.link(), Link::Waiting { .. }));
    assert!(drawn > 0 && voyage.world().len() >= had, "the land is still there");
    drop(server);

    let _again = ServerProgram::start_at(&address, &[]);
    // A finer view, which only a server can fill.
    until(&mut voyage, 0.5, |voyage| matches!(voyage.link(), Link::Connected(_)) && voyage.is_settled());
    assert!(voyage.world().len() > had);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_server_of_another_world_replaces_the_land() {
    let server = RunningServer::start().await;
    let (address, url) = (server.address, server.stream_url());
    let driven = tokio::task::spawn_blocking(move || {
        let settings = Settings::new(url.parse().unwrap());
        let mut voyage = Voyage::new(SocketFeed::connect(settings).unwrap(), 512);
        until(&mut voyage, 4.0, Voyage::is_settled);
        voyage
    });
    let mut voyage = driven.await.unwrap();
    server.stop().await;
    let config = server::ServerConfig { world_seed: 2, ..quick_config() };
    let server = RunningServer::start_at(address, config).await;
    tokio::task::spawn_blocking(move || {
        let other = terrain::Land::new(2);
        until(&mut voyage, 4.0, |voyage| {
            let settled = voyage.is_settled() && matches!(voyage.link(), Link::Connected(_));
            settled
                && voyage.world().keys().next().is_some_and(|key| {
                    voyage.world().get(key).is_some_and(|chunk| chunk.heights == other.chunk_heights(key))
                })
        });
        for key in voyage.world().keys().collect::<Vec<_>>() {
            assert_eq!(
                voyage.world().get(key).unwrap().heights,
                other.chunk_heights(key),
                "{key} is of the old world"
            );
        }
    })
    .await
    .unwrap();
    server.stop().await;
}
