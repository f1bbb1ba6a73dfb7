//! Viewer and load test over TLS: with the server's certificate, without it, and with the wrong
//! scheme.

use client::native::stream::{ServerStream, Settings};
use client::stream::{ChunkStream, StreamEvent};
use load::{LoadConfig, Report};
use server::ServerConfig;
use server::tls::Tls;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use tests::RunningServer;
use tests::peer::view;
use tests::running::quick_config;
use tls_client::TlsClient;

/// Certificates of localhost and 127.0.0.1, and their keys, for tests only.
const FIRST: [&str; 2] = [
    include_str!("../../server/tests/http/tls/first.crt"),
    include_str!("../../server/tests/http/tls/first.key"),
];
const OTHER: &str = include_str!("../../server/tests/http/tls/second.crt");

/// Timeout of every wait.
const TEST_TIMEOUT: Duration = Duration::from_secs(20);

/// A file, removed when dropped.
struct File(PathBuf);

impl File {
    fn new(name: &str, content: &str) -> Self {
        let path = std::env::temp_dir().join(format!("tombolo-{}-{name}", std::process::id()));
        std::fs::write(&path, content).unwrap();
        Self(path)
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A server that speaks TLS, and its certificate. `name` is different in each test.
async fn secure_server(name: &str) -> (RunningServer, File) {
    let [certificate, key] = [0, 1].map(|index| File::new(&format!("{name}-{index}.pem"), FIRST[index]));
    let tls = Tls::of_options(Some(certificate.0.clone()), Some(key.0.clone())).unwrap();
    (RunningServer::start_with(ServerConfig { tls, ..quick_config() }).await, certificate)
}

fn trusting(file: &File) -> TlsClient {
    TlsClient::new(Some(&file.0)).unwrap()
}

async fn load(server: &RunningServer, scheme: &str, tls: Option<TlsClient>) -> Report {
    let address = format!("{scheme}://{}/v1/stream", server.address).parse().unwrap();
    let config = LoadConfig { clients: 2, seconds: 2, tls, ..LoadConfig::new(address) };
    tokio::time::timeout(TEST_TIMEOUT, load::run(config)).await.expect("the run ends")
}

/// The number of chunks until a view is complete, or why there is no session.
fn chunks_of(mut stream: ServerStream) -> Result<usize, String> {
    let (end, mut chunks) = (Instant::now() + TEST_TIMEOUT, 0);
    while Instant::now() < end {
        match stream.poll() {
            Some(StreamEvent::Connected { .. }) => stream.set_view(view(1, 600)),
            Some(StreamEvent::Chunk(_)) => chunks += 1,
            Some(StreamEvent::Settled { .. }) => return Ok(chunks),
            Some(StreamEvent::Disconnected { cause, .. } | StreamEvent::Refused { detail: cause, .. }) => {
                return Err(cause);
            }
            Some(StreamEvent::Missed { .. }) => {}
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    }
    // No reason to end is no refusal.
    panic!("nothing arrived");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_load_test_verifies_chunks_over_tls() {
    let (server, certificate) = secure_server("load").await;
    let report = load(&server, "wss", Some(trusting(&certificate))).await;
    assert!(
        report.counts.chunks > 10 && report.counts.mismatches == 0 && report.counts.dropped == 0,
        "{report:?}"
    );
    // The control: another certificate, and no TLS.
    let other = File::new("load-other.pem", OTHER);
    for (scheme, tls) in [("wss", Some(trusting(&other))), ("ws", None)] {
        let report = load(&server, scheme, tls).await;
        assert_eq!((report.counts.chunks, report.counts.refused > 0), (0, true), "{report:?}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_viewer_gets_its_view_over_tls_and_says_why_it_does_not() {
    let (server, certificate) = secure_server("view").await;
    let plain = RunningServer::start().await;
    let other = File::new("view-other.pem", OTHER);
    let connect = |server: &RunningServer, scheme: &str, tls: Option<TlsClient>| {
        let url = format!("{scheme}://{}/v1/stream", server.address).parse().unwrap();
        let stream = ServerStream::connect(Settings { tls, ..Settings::new(url) }).unwrap();
        tokio::task::block_in_place(|| chunks_of(stream))
    };
    assert!(connect(&server, "wss", Some(trusting(&certificate))).unwrap() > 3);
    let cause = connect(&server, "wss", Some(trusting(&other))).unwrap_err();
    assert!(cause.contains("--ca-file") && !cause.contains("start a server"), "{cause}");
    let cause = connect(&plain, "wss", Some(trusting(&certificate))).unwrap_err();
    assert!(cause.contains("speaks no TLS"), "{cause}");
    assert!(connect(&server, "ws", None).is_err());
    server.stop().await;
    plain.stop().await;
}
