//! Sessions over bad networks: slow, sliced, cut, reset, silent. No chunk is wrong, and both ends
//! recover.

use client::native::stream::{ServerStream, Settings};
use client::stream::{ChunkStream, StreamEvent};
use protocol::client::Event;
use server::ServerConfig;
use std::collections::HashSet;
use std::time::{Duration, Instant};
use terrain::{Chunk, ChunkKey, Land};
use tests::RunningServer;
use tests::peer::{TestClient, view};
use tests::running::quick_config;
use tests::toxic_proxy::{Toxic, ToxicProxy};

/// Timeout of every wait.
const TEST_TIMEOUT: Duration = Duration::from_secs(60);

/// Bytes from the server after which a stream ends: within a chunk of the view.
const WITHIN_A_FRAME: usize = 30_000;

/// View distance, metres.
const DISTANCE_M: u32 = 1200;

/// The view's chunks without a proxy.
async fn expected(server: &RunningServer) -> HashSet<ChunkKey> {
    chunks(&server.stream_url()).await.iter().map(|chunk| chunk.key).collect()
}

async fn chunks(url: &str) -> Vec<Chunk> {
    let mut client = TestClient::connect(url).await;
    let settled = client.settle(view(1, DISTANCE_M));
    let events = tokio::time::timeout(TEST_TIMEOUT, settled).await.expect("the view settles");
    let chunk = |event| if let Event::Chunk { chunk, .. } = event { Some(*chunk) } else { None };
    events.into_iter().filter_map(chunk).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn slow_and_sliced_networks_change_no_chunk() {
    // A slow client must not be closed for it; writes have the default timeout.
    let config = ServerConfig { write_timeout: ServerConfig::default().write_timeout, ..quick_config() };
    let server = RunningServer::start_with(config).await;
    let (expected, land) = (expected(&server).await, Land::new(1));
    assert!(expected.len() > 3);
    for toxic in [
        Toxic::None,
        Toxic::Latency(Duration::from_millis(40)),
        Toxic::BytesPerSecond(56_000),
        Toxic::SingleBytes,
    ] {
        let proxy = ToxicProxy::start(server.address, toxic).await;
        let chunks = chunks(&proxy.stream_url()).await;
        assert_eq!(chunks.iter().map(|chunk| chunk.key).collect::<HashSet<_>>(), expected, "{toxic:?}");
        assert!(chunks.iter().all(|chunk| *chunk == land.chunk(chunk.key)), "{toxic:?}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_that_ends_in_a_frame_is_resumed_and_gives_every_chunk() {
    let server = RunningServer::start().await;
    let (expected, land) = (expected(&server).await, Land::new(1));
    for toxic in [Toxic::CutAfter(WITHIN_A_FRAME), Toxic::ResetAfter(WITHIN_A_FRAME)] {
        let proxy = ToxicProxy::start(server.address, toxic).await;
        let settings = Settings::new(proxy.stream_url().parse().unwrap());
        let (received, lost) = tokio::task::block_in_place(|| resumed(settings));
        assert_eq!(received.iter().map(|chunk| chunk.key).collect::<HashSet<_>>(), expected, "{toxic:?}");
        assert!(received.iter().all(|chunk| *chunk == land.chunk(chunk.key)), "{toxic:?}");
        assert!((lost, proxy.connections()) == (1, 2), "{toxic:?}: {lost} lost");
    }
    server.stop().await;
}

/// The chunks of a view over all sessions until it is settled, and the sessions that were lost.
fn resumed(settings: Settings) -> (Vec<Chunk>, usize) {
    let mut stream = ServerStream::connect(settings).unwrap();
    let (end, mut chunks, mut lost) = (Instant::now() + TEST_TIMEOUT, Vec::<Chunk>::new(), 0);
    while Instant::now() < end {
        match stream.poll() {
            Some(StreamEvent::Connected { .. }) => {
                let keys: Vec<_> = chunks.iter().map(|chunk| chunk.key).collect();
                stream.holding(&keys);
                stream.set_view(view(1, DISTANCE_M));
            }
            Some(StreamEvent::Chunk(chunk)) => chunks.push(*chunk),
            Some(StreamEvent::Settled { .. }) => return (chunks, lost),
            Some(StreamEvent::Disconnected { cause, retry }) => {
                assert!(retry.is_some(), "{cause}");
                lost += 1;
            }
            Some(_) => {}
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    }
    panic!("the view does not settle: {} chunks", chunks.len());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_in_a_black_hole_ends_and_others_go_on() {
    let config = ServerConfig { ping_interval: Duration::from_millis(300), ..quick_config() };
    let server = RunningServer::start_with(config).await;
    let expected = expected(&server).await;
    let sessions = || async {
        let address = server.url("/metrics");
        let get = move || ureq::get(address).call().unwrap().body_mut().read_to_string().unwrap();
        let text = tokio::task::spawn_blocking(get).await.unwrap();
        let line = text.lines().find_map(|line| line.strip_prefix("tombolo_sessions ")).unwrap();
        line.parse::<u32>().unwrap()
    };
    let start = Instant::now();
    // The session of the expected chunks.
    while sessions().await > 0 {
        assert!(start.elapsed() < TEST_TIMEOUT, "the first session ends");
    }
    let hole = ToxicProxy::start(server.address, Toxic::BlackHoleAfter(WITHIN_A_FRAME)).await;
    let url = hole.stream_url();
    let stuck = tokio::spawn(async move {
        let mut client = TestClient::connect(&url).await;
        client.settle(view(1, DISTANCE_M)).await
    });
    while sessions().await == 0 {
        assert!(start.elapsed() < TEST_TIMEOUT, "the session begins");
    }
    while sessions().await > 0 {
        assert!(start.elapsed() < TEST_TIMEOUT, "the session ends");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // The client of the hole knows nothing of it, and another one is served.
    assert!(!stuck.is_finished());
    stuck.abort();
    let good = ToxicProxy::start(server.address, Toxic::None).await;
    assert_eq!(chunks(&good.stream_url()).await.len(), expected.len());
    server.stop().await;
}
