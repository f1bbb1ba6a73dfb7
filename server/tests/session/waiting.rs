//! Chunks and views that wait for the generation thread, which stands still.

use crate::peer::{BINARY, PING, PONG, Peer, view};
use protocol::message::{ClientMessage, RefusalReason, ServerMessage, WireKey};
use protocol::server::ChunkRequest;
use protocol::{Delivery, control};
use server::ServerConfig;
use server::chunk_id::ChunkId;
use server::generation::{Flow, Generation, Limits};
use server::limits::rate_limit::TokenBucket;
use server::mechanism::Mechanism;
use server::memory::{MemoryLimit, mark};
use server::source::ChunkSource;
use server::state::ServerState;
use std::ops::Range;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};
use test_support::MemoryGroup;
use tokio::time::sleep;
use tokio_util::task::AbortOnDropHandle;

/// Chunks of one session in generation at once.
const WINDOW: i64 = 16;

/// Chunks of another client: one in which the thread stands, one that waits.
const OTHERS: i64 = 2;

/// So long that nothing is rejected.
const HOUR: Duration = Duration::from_secs(3600);

/// A source that says when a chunk begins, and finishes none before the end of the test.
struct StandingSource {
    begun: Sender<()>,
    end: Mutex<Receiver<()>>,
}

impl ChunkSource for StandingSource {
    fn world(&self) -> WorldDigest {
        Land::new(1).digest()
    }

    fn chunk(&self, id: ChunkId, _known_error: Option<u32>) -> Chunk {
        let _ = self.begun.send(());
        let _ = self.end.lock().unwrap().recv();
        Land::new(1).chunk(id.key)
    }
}

/// A server whose only generation thread stands still.
struct Standing {
    state: Arc<ServerState>,
    _others: Flow,
    /// Dropped at the end of the test.
    _end: Sender<()>,
}

impl Standing {
    fn new(deadline: Duration, without: Option<Mechanism>) -> Self {
        let config = ServerConfig { threads: 1, memory: None, without, ..ServerConfig::default() };
        let mut state = ServerState::new(config).unwrap();
        let ((begun, has_begun), (end, has_ended)) = (channel(), channel());
        let source = StandingSource { begun, end: Mutex::new(has_ended) };
        let limits = Limits { threads: 1, cache_bytes: 1 << 20, jobs: 1000, deadline, without };
        state.generation = Generation::new(source, limits, Arc::clone(&state.metrics)).unwrap();
        let mut others = state.generation.flow();
        let mut request = |x| {
            let chunk = ChunkRequest { key: ChunkKey::new(0, x, 0).unwrap(), request: None, priority: 0 };
            others.request(chunk, Delivery::Exact);
        };
        request(1000);
        // The thread takes both if both are there.
        has_begun.recv().unwrap();
        request(1001);
        Self { state: Arc::new(state), _others: others, _end: end }
    }

    async fn connect(&self) -> Peer {
        Peer::connect(&self.state, TokenBucket::default()).await
    }
}

fn request(id: u32, xs: Range<i32>) -> ClientMessage {
    ClientMessage::Request { id, keys: xs.map(|x| WireKey { level: 0, x, z: 0 }).collect() }
}

/// The requests that are rejected as overloaded until a ping is answered; nothing else is received.
async fn rejected(peer: &mut Peer) -> usize {
    // Not in the same read as the requests.
    sleep(Duration::from_millis(1)).await;
    peer.send(PING, b"?").await;
    for rejected in 0.. {
        match peer.next().await.expect("a frame") {
            (PONG, _) => return rejected,
            (BINARY, message) => match control::decode(&message) {
                Ok(ServerMessage::Refused(refused)) => assert_eq!(refused.reason, RefusalReason::Overloaded),
                other => panic!("{other:?}"),
            },
            (opcode, _) => panic!("a frame of opcode {opcode}"),
        }
    }
    unreachable!("counting has no end")
}

#[tokio::test(start_paused = true)]
async fn a_session_has_sixteen_chunks_in_generation_until_they_are_cancelled() {
    let server = Standing::new(HOUR, None);
    let mut peer = server.connect().await;
    peer.send_message(&ClientMessage::Credit { chunks: 1000 }).await;
    peer.send_message(&request(7, 0..100)).await;
    assert_eq!(rejected(&mut peer).await, 0);
    let generation = &server.state.metrics.generation;
    assert_eq!(generation.pending_jobs.get(), OTHERS + WINDOW);
    peer.send_message(&ClientMessage::Cancel { id: 7 }).await;
    assert_eq!(rejected(&mut peer).await, 0);
    assert_eq!(generation.jobs_cancelled.get(), WINDOW as u64);
}

#[tokio::test(start_paused = true)]
async fn requests_that_the_service_cannot_answer_in_time_are_rejected_at_once() {
    // Half of it is the work of 200 chunks, by the first estimate; for each of two clients 100.
    let server = Standing::new(Duration::from_millis(40), None);
    let mut peer = server.connect().await;
    peer.send_message(&request(1, 0..300)).await;
    assert_eq!(rejected(&mut peer).await, 0, "they wait for credit");
    peer.send_message(&ClientMessage::Credit { chunks: 1000 }).await;
    assert_eq!(rejected(&mut peer).await, 0, "they have waited before");
    peer.send_message(&request(2, 300..350)).await;
    assert_eq!(rejected(&mut peer).await, 50);
    // Of another client, all at once.
    let mut other = server.connect().await;
    other.send_message(&ClientMessage::Credit { chunks: 1000 }).await;
    other.send_message(&request(1, 400..700)).await;
    let expected = 300 - WINDOW as usize - 200 / 3;
    assert_eq!(rejected(&mut other).await, expected, "of three clients");
}

#[tokio::test(start_paused = true)]
async fn a_view_is_selected_on_the_generation_thread() {
    // The control: where a measurement turns that off, it does not wait for the thread.
    for (without, selected, requested) in [(None, 0, 0), (Some(Mechanism::ViewTurns), 1, WINDOW)] {
        let server = Standing::new(HOUR, without);
        let mut peer = server.connect().await;
        peer.send_message(&ClientMessage::Credit { chunks: 1000 }).await;
        peer.send_message(&ClientMessage::View(view(1))).await;
        for _ in 0..2 {
            assert_eq!(rejected(&mut peer).await, 0);
        }
        let generation = &server.state.metrics.generation;
        assert_eq!(generation.views_selected.get(), selected, "{without:?}");
        assert_eq!(generation.pending_jobs.get(), OTHERS + requested, "{without:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_superseded_view_is_counted_once_and_before_anything_is_written() {
    let server = Standing::new(HOUR, None);
    let mut peer = server.connect().await;
    for id in 1..=3 {
        peer.send_message(&ClientMessage::View(view(id))).await;
        // The first is being selected when the second comes.
        sleep(Duration::from_millis(1)).await;
    }
    let superseded = &server.state.metrics.generation.views_superseded;
    assert_eq!(superseded.get(), 1);
    for _ in 0..2 {
        assert_eq!(rejected(&mut peer).await, 0);
    }
    assert_eq!(superseded.get(), 1);
}

/// On the real clock: the memory is looked at and the view selected meanwhile.
#[tokio::test]
async fn a_view_waits_until_it_has_room_below_the_memory_mark() {
    const MIB: u64 = 1 << 20;
    let group = MemoryGroup::new(598 * MIB).unwrap();
    let memory = Some(MemoryLimit::of_group(group.folder().to_owned(), 800 * MIB));
    let config = ServerConfig { threads: 1, memory, ..ServerConfig::default() };
    let state = Arc::new(ServerState::new(config).unwrap());
    let watched = mark::watch(
        Arc::clone(&state.memory),
        Arc::clone(&state.metrics),
        state.open_sessions.clone(),
        Arc::clone(&state),
    );
    let _watched = AbortOnDropHandle::new(tokio::spawn(watched));
    while state.metrics.limits.memory_used_bytes.get() == 0 {
        sleep(Duration::from_millis(1)).await;
    }
    // That of another session takes the room.
    let other = state.memory.room_for_view(None).expect("room for one view");
    let mut peer = Peer::connect(&state, TokenBucket::default()).await;
    peer.send_message(&ClientMessage::Credit { chunks: 1 }).await;
    peer.send_message(&ClientMessage::View(view(1))).await;
    assert_eq!(peer.next_within(Duration::from_millis(300)).await, None);
    drop(other);
    let chunk = peer.next_within(Duration::from_secs(10)).await;
    assert!(chunk.is_some_and(|(opcode, _)| opcode == BINARY), "a chunk of the view");
    // Its own room is free again.
    assert!(state.memory.room_for_view(None).is_some());
}

/// On the real clock: the chunks are made on a thread, and a paused clock would run away meanwhile.
#[tokio::test]
async fn each_chunk_is_counted_once_with_its_bytes_and_its_latency() {
    let config = ServerConfig { threads: 1, memory: None, ..ServerConfig::default() };
    let state = Arc::new(ServerState::new(config).unwrap());
    let mut peer = Peer::connect(&state, TokenBucket::default()).await;
    peer.send_message(&ClientMessage::Credit { chunks: 10 }).await;
    let mut bytes = 0;
    for x in 0..3 {
        peer.send_message(&request(1, x..x + 1)).await;
        let (opcode, chunk) = peer.next().await.expect("a chunk");
        assert!(opcode == BINARY && control::decode::<ServerMessage>(&chunk).is_err());
        bytes += chunk.len();
        // Behind the end of the write.
        peer.send(PING, b"?").await;
        assert_eq!(peer.next().await.map(|(opcode, _)| opcode), Some(PONG));
    }
    let latencies: u64 = state.metrics.sessions.latency.counts().iter().sum();
    assert_eq!((latencies, state.metrics.sessions.chunks_sent.get()), (3, 3));
    let (text, name) = (state.metrics.render(), "tombolo_chunk_sent_bytes_total{delivery=\"exact\"}");
    assert!(text.lines().any(|line| line == format!("{name} {bytes}")), "{bytes} bytes: {text}");
}
