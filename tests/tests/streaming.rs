//! The stream of a correct client over real sockets.

use protocol::client::Event;
use std::collections::HashSet;
use terrain::{Chunk, ChunkKey, Land};
use tests::RunningServer;
use tests::peer::{TestClient, view};

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
    let mut client = TestClient::connect(&server.stream_url()).await;
    let events = client.settle(view(1, 1200)).await;
    let land = Land::new(1);
    let streamed = chunks(&events);
    assert!(streamed.len() > 30, "{}", streamed.len());
    for chunk in &streamed {
        assert_eq!(**chunk, land.chunk(chunk.key));
    }
    // Control: another seed's land is not equal.
    let other = Land::new(2);
    assert!(streamed.iter().any(|chunk| **chunk != other.chunk(chunk.key)));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_moving_view_sends_new_chunks_only() {
    let server = RunningServer::start().await;
    let mut client = TestClient::connect(&server.stream_url()).await;
    let mut seen = HashSet::new();
    for step in 0..4 {
        let mut moved = view(step, 800);
        moved.eye[0] = step as i32 * 1000 * 256;
        let before = seen.len();
        for chunk in chunks(&client.settle(moved).await) {
            assert!(seen.insert(chunk.key), "{} was sent twice", chunk.key);
        }
        assert!(seen.len() > before, "step {step} brought no chunk");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reconnect_with_held_chunks_gets_only_the_rest() {
    let server = RunningServer::start().await;
    let mut client = TestClient::connect(&server.stream_url()).await;
    let first: Vec<_> = chunks(&client.settle(view(1, 800)).await).iter().map(|chunk| chunk.key).collect();
    drop(client);
    let mut again = TestClient::connect(&server.stream_url()).await;
    again.session.holding(&first[..first.len() - 2]);
    let rest: HashSet<_> = chunks(&again.settle(view(1, 800)).await).iter().map(|chunk| chunk.key).collect();
    assert_eq!(rest, first[first.len() - 2..].iter().copied().collect());
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_with_equal_views_share_one_generation_per_chunk() {
    let server = RunningServer::start().await;
    let url = server.stream_url();
    let clients = (0..12).map(|_| {
        let url = url.clone();
        tokio::spawn(async move { chunks(&TestClient::connect(&url).await.settle(view(1, 600)).await).len() })
    });
    let mut counts = HashSet::new();
    for client in clients.collect::<Vec<_>>() {
        counts.insert(client.await.unwrap());
    }
    assert_eq!(counts.len(), 1, "all got the same view: {counts:?}");
    let metrics = tokio::task::spawn_blocking(move || {
        ureq::get(server.url("/metrics")).call().unwrap().body_mut().read_to_string().unwrap()
    })
    .await
    .unwrap();
    let generated = format!(
        "tombolo_generation_jobs_total{{outcome=\"completed\"}} {}\n",
        counts.into_iter().next().unwrap()
    );
    assert!(metrics.contains(&generated), "{metrics}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn explicit_requests_are_served_without_a_view() {
    let server = RunningServer::start().await;
    let mut client = TestClient::connect(&server.stream_url()).await;
    let corner = [ChunkKey::new(0, 32_767, -32_768).unwrap(), ChunkKey::new(16, 0, 0).unwrap()];
    client.session.request(&corner);
    let mut got = HashSet::new();
    while got.len() < 2 {
        if let Event::Chunk { chunk, .. } = client.event().await.unwrap() {
            got.insert(chunk.key);
        }
    }
    assert_eq!(got, corner.into());
    server.stop().await;
}
