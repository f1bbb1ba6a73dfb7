//! A client's bytes on a new connection, by the routes of a server.

use crate::world::WORLD;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use server::ServerConfig;
use server::state::ServerState;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::runtime::{Builder, Runtime};
use tower::ServiceExt;

/// Bytes of a pipe, more than any response.
const PIPE: usize = 4 << 20;

/// Longest input, bytes. Longer ones hold nothing but more requests.
const LONGEST: usize = 4096;

/// A server without a socket. One input at a time.
static SERVER: LazyLock<Mutex<(Runtime, axum::Router)>> = LazyLock::new(|| {
    let runtime = Builder::new_current_thread().enable_all().build().expect("a runtime");
    let seed = WORLD.land.world_seed();
    let config = ServerConfig { threads: 1, world_seed: seed, ..ServerConfig::default() };
    let router = runtime.block_on(async {
        server::http::router(Arc::new(ServerState::new(config).expect("generation threads")))
    });
    Mutex::new((runtime, router))
});

/// Sends bytes and then the end of the connection; reads all responses.
///
/// # Panics
/// The answer is no response, or one of a failure (500).
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let server = SERVER.lock().unwrap_or_else(PoisonError::into_inner);
    let (runtime, router) = &*server;
    let answer = runtime.block_on(exchange(&bytes[..bytes.len().min(LONGEST)], router.clone()));
    assert!(answer.is_empty() || answer.starts_with(b"HTTP/1."), "{:?}", String::from_utf8_lossy(&answer));
    assert_ne!(answer.get(9..12), Some(&b"500"[..]), "{:?}", String::from_utf8_lossy(&answer));
    answer.get(9) == Some(&b'2')
}

async fn exchange(bytes: &[u8], router: axum::Router) -> Vec<u8> {
    let (mut client, server) = tokio::io::duplex(PIPE);
    let service =
        service_fn(move |request: hyper::Request<Incoming>| router.clone().oneshot(request.map(Body::new)));
    // A client that ends its side still reads the responses.
    let mut builder = http1::Builder::new();
    let serving = builder.half_close(true).serve_connection(TokioIo::new(server), service).with_upgrades();
    let talking = async {
        let mut answer = Vec::new();
        // The server may have ended the connection.
        let _ = client.write_all(bytes).await;
        let _ = client.shutdown().await;
        let _ = client.read_to_end(&mut answer).await;
        answer
    };
    let (_, answer) = tokio::join!(serving, talking);
    answer
}

/// A request of each route.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let world = format!("/v1/{}", WORLD.digest);
    let paths = [
        "/".to_owned(),
        "/page/map.js".into(),
        "/openapi.json".into(),
        "/v1/world".into(),
        format!("{world}/chunk/0/0/0"),
        format!("{world}/chunk/16/0/-1"),
        format!("{world}/map/0/0/0.png"),
        format!("{world}/height/12/-34"),
        "/livez".into(),
        "/readyz".into(),
        "/metrics".into(),
        "/nowhere?query=%FF".into(),
    ];
    let request = |path: &String| {
        format!(
            "GET {path} HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: W/\"x\", \"00\"\r\n\
             Origin: http://localhost\r\nAuthorization: Bearer t\r\n\r\n"
        )
    };
    let mut seeds: Vec<Vec<u8>> = paths.iter().map(|path| request(path).into_bytes()).collect();
    seeds.push(
        b"GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: upgrade\r\nUpgrade: websocket\r\n\
          Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
          Sec-WebSocket-Protocol: tombolo.v1\r\n\r\n"
            .to_vec(),
    );
    seeds.push(
        b"POST /livez HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n0\r\n\r\n"
            .into(),
    );
    seeds
}
