//! What a well-behaved client gets, over real sockets.

use protocol::client::Event;
use std::collections::HashSet;
use terrain::{Chunk, ChunkKey, Land};
use tests::RunningServer;
use tests::peer::{Guest, view};

fn chunks(events: &[Event]) -> Vec<&Chunk> {
    fn chunk(event: &Event) -> Option<&Chunk> {
        match event {
            Event::Chunk { chunk, .. } => Some(chunk),
            _ => None,
        }
    }
    events.iter().filter_map(chunk).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_streamed_chunk_equals_local_generation() {
    let server = RunningServer::start().await;
    let mut guest = Guest::connect(&server.stream_url()).await;
    let events = guest.settle(view(1, 1200)).await;
    let land = Land::new(1);
    let streamed = chunks(&events);
    assert!(streamed.len() > 30, "{}", streamed.len());
    for chunk in &streamed {
        assert_eq!(**chunk, land.chunk(chunk.key));
    }
    // The control: another seed's land is not equal.
    let other = Land::new(2);
    assert!(streamed.iter().any(|chunk| **chunk != other.chunk(chunk.key)));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_moving_view_sends_only_what_is_new() {
    let server = RunningServer::start().await;
    let mut guest = Guest::connect(&server.stream_url()).await;
    let mut seen = HashSet::new();
    for step in 0..4 {
        let mut moved = view(step, 800);
        moved.eye[0] = step as i32 * 100 * 256;
        for chunk in chunks(&guest.settle(moved).await) {
            assert!(seen.insert(chunk.key), "{} was sent twice", chunk.key);
        }
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reconnect_that_names_what_it_holds_gets_only_the_rest() {
    let server = RunningServer::start().await;
    let mut guest = Guest::connect(&server.stream_url()).await;
    let first: Vec<_> = chunks(&guest.settle(view(1, 800)).await).iter().map(|chunk| chunk.key).collect();
    drop(guest);
    let mut again = Guest::connect(&server.stream_url()).await;
    again.session.holding(&first[..first.len() - 2]);
    let rest: HashSet<_> = chunks(&again.settle(view(1, 800)).await).iter().map(|chunk| chunk.key).collect();
    assert_eq!(rest, first[first.len() - 2..].iter().copied().collect());
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn many_clients_of_one_place_cost_one_generation_per_chunk() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    let guests = (0..12).map(|_| {
        let url = url.clone();
        tokio::spawn(async move { chunks(&Guest::connect(&url).await.settle(view(1, 600)).await).len() })
    });
    let mut counts = HashSet::new();
    for guest in guests.collect::<Vec<_>>() {
        counts.insert(guest.await.unwrap());
    }
    assert_eq!(counts.len(), 1, "all got the same view: {counts:?}");
    let metrics = tokio::task::spawn_blocking(move || {
        ureq::get(server.url("/metrics")).call().unwrap().body_mut().read_to_string().unwrap()
    })
    .await
    .unwrap();
    let generated = format!("tombolo_generated_total {}\n", counts.into_iter().next().unwrap());
    assert!(metrics.contains(&generated), "{metrics}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn explicit_requests_are_answered_whatever_the_view() {
    let server = RunningServer::start().await;
    let mut guest = Guest::connect(&server.stream_url()).await;
    let corner = [ChunkKey::new(0, 32_767, -32_768).unwrap(), ChunkKey::new(16, 0, 0).unwrap()];
    guest.session.request(&corner);
    let mut got = HashSet::new();
    while got.len() < 2 {
        if let Event::Chunk { chunk, .. } = guest.event().await.unwrap() {
            got.insert(chunk.key);
        }
    }
    assert_eq!(got, corner.into());
    server.stop().await;
}
