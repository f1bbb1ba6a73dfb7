//! The memory mark.

use crate::client::Server;
use server::ServerConfig;
use server::mechanism::Mechanism;
use server::memory::MemoryLimit;

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
    use std::time::Duration;
    use tokio::time::timeout;
    let open = OpenSessions::default();
    let sessions: Vec<_> = (1..=16).map(|number| open.register(number, None)).collect();
    let has_to_end =
        async |index: usize| timeout(Duration::from_millis(1), sessions[index].ends()).await.is_ok();
    assert!(!has_to_end(15).await);
    struct Nothing;
    impl Reclaim for Nothing {
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
