//! The memory mark.

use crate::client::Server;
use server::ServerConfig;
use server::mechanism::Mechanism;
use server::memory::MemoryLimit;
use std::time::Duration;
use test_support::MemoryGroup;
use tokio::time::timeout;

const MIB: u64 = 1 << 20;

/// A server with a limit of 800 MiB, whose use of memory the test sets: 100 MiB.
async fn server_in_group() -> (Server, MemoryGroup) {
    let group = MemoryGroup::new(100 * MIB).unwrap();
    let memory = Some(MemoryLimit::of_group(group.folder().to_owned(), 800 * MIB));
    // The sessions of the tests send no hello.
    let handshake_timeout = Duration::from_secs(3600);
    let config = ServerConfig { threads: 1, memory, handshake_timeout, ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    (server, group)
}

/// Sets the memory in use, and waits until the server has seen it.
async fn use_memory(server: &Server, group: &MemoryGroup, used_mib: u64) {
    group.set_used(used_mib * MIB).unwrap();
    while server.metric("tombolo_memory_used_bytes").await != (used_mib * MIB) as f64 {
        tokio::task::yield_now().await;
    }
}

/// Near the mark the sessions of one address leave the last room to others, and make place for
/// them: before, an address that held the memory just below the mark kept out all others for ever.
#[tokio::test]
async fn a_site_that_holds_the_memory_makes_place_for_a_client_of_another_one() {
    let (server, group) = server_in_group().await;
    let (many, few, new) = ([127, 0, 0, 2], [127, 0, 0, 3], [127, 0, 0, 4]);
    let mut open = Vec::new();
    for source in [many; 6] {
        let (status, stream) = server.open_session_from(source).await;
        assert_eq!(status, 101);
        open.push(stream);
    }
    use_memory(&server, &group, 590).await;
    assert_eq!(server.open_session_from(many).await.0, 503, "of 5 sessions that have room");
    let (status, stream) = server.open_session_from(few).await;
    assert_eq!(status, 101);
    open.push(stream);
    assert_eq!(server.metric("tombolo_sessions_ended_total{reason=\"displaced\"}").await, 0.0);
    assert_eq!(server.get("/readyz").await.status, 200);

    use_memory(&server, &group, 599).await;
    while server.get("/readyz").await.status != 503 {
        tokio::task::yield_now().await;
    }
    assert_eq!(server.open_session_from(new).await.0, 503);
    let ended = async {
        while server.metric("tombolo_sessions_ended_total{reason=\"displaced\"}").await == 0.0 {
            tokio::task::yield_now().await;
        }
    };
    timeout(Duration::from_secs(10), ended).await.expect("a session of the first site ends");
    // Nearly as much is in use as before.
    use_memory(&server, &group, 599).await;
    assert_eq!(server.open_session_from(many).await.0, 503, "its place is not for the same site");
    let (status, stream) = server.open_session_from(new).await;
    assert_eq!(status, 101);
    open.push(stream);
    drop(open);
    server.stop().await;
}

/// A server that may use `bytes` bytes.
async fn server_with(bytes: u64, without: Option<Mechanism>) -> Server {
    let memory = Some(MemoryLimit::of_machine(bytes));
    Server::start_with(ServerConfig { threads: 1, memory, without, ..ServerConfig::default() }).await
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn beyond_the_mark_open_sessions_end_the_newest_first() {
    use server::memory::reclaim::Reclaim;
    use server::memory::{MemoryMark, mark};
    use server::open_sessions::OpenSessions;
    use std::sync::Arc;
    let open = OpenSessions::default();
    let sessions: Vec<_> = (1..=16).map(|number| open.register(number, None)).collect();
    let has_to_end =
        async |index: usize| timeout(Duration::from_millis(1), sessions[index].evicted()).await.is_ok();
    assert!(!has_to_end(15).await);
    struct Nothing;
    impl Reclaim for Nothing {
        fn stop_views(&self, _is_stopped: bool) {}
        fn clear_caches(&self) {}
        fn return_pages(&self) {}
    }
    let full = Arc::new(MemoryMark::new(Some(MemoryLimit::of_machine(1 << 20))));
    let watching = tokio::spawn(mark::watch(full, Arc::default(), open.clone(), Arc::new(Nothing)));
    while !has_to_end(15).await {
        tokio::task::yield_now().await;
    }
    assert!(!has_to_end(0).await, "the oldest one ends last");
    watching.abort();
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn beyond_the_mark_no_session_begins_and_the_server_is_not_ready() {
    // Less than this process has.
    let full = server_with(1 << 20, None).await;
    while full.metric("tombolo_memory_used_bytes").await == 0.0 {
        tokio::task::yield_now().await;
    }
    assert!(full.metric("tombolo_memory_used_bytes").await > full.metric("tombolo_memory_limit_bytes").await);
    let refused = full.upgrade(&[]).await;
    assert_eq!((refused.status, refused.problem().as_str()), (503, "no-session"));
    assert!(!refused.header("retry-after").is_empty());
    assert_eq!(full.get("/readyz").await.status, 503);
    assert!(full.metric("tombolo_memory_cache_clears_total").await > 0.0);
    assert_eq!(full.get("/livez").await.status, 200);
    assert_eq!(full.get(&full.path("chunk/0/0/0")).await.status, 200, "who is connected is served");
    full.stop().await;

    let unlimited = server_with(1 << 20, Some(Mechanism::MemoryMark)).await;
    assert_eq!(unlimited.upgrade(&[]).await.status, 101);
    assert_eq!(unlimited.get("/readyz").await.status, 200);
    unlimited.stop().await;

    let free = server_with(1 << 40, None).await;
    while free.metric("tombolo_memory_used_bytes").await == 0.0 {
        tokio::task::yield_now().await;
    }
    assert_eq!(free.metric("tombolo_memory_cache_clears_total").await, 0.0);
    assert_eq!(free.upgrade(&[]).await.status, 101);
    assert_eq!(free.get("/readyz").await.status, 200);
}
