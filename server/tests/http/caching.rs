//! Validators, conditional requests and `Cache-Control`: RFC 9110 and RFC 9111.

use crate::client::{Server, TEST_TIMEOUT, UPGRADE, request_over};
use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use protocol::chunk_codec::{self, seed_only};
use protocol::control;
use protocol::message::{ClientMessage, Hello, ServerMessage, WireKey};
use server::ServerConfig;
use server::access::tokens::TokenSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use terrain::constants::TOP_LEVEL;
use terrain::{ChunkKey, Land};
use tokio::net::TcpStream;
use tokio::sync::mpsc::UnboundedSender;
use tokio::task::JoinSet;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::Role;

const IMMUTABLE: &str = "public, max-age=31536000, immutable";

#[tokio::test]
async fn immutable_resources_have_a_strong_validator() {
    let server = Server::start().await;
    for path in [server.path("chunk/2/-3/1"), server.path("map/3/0/-1.png?style=1")] {
        let first = server.get(&path).await;
        let etag = first.header("etag").to_owned();
        assert_eq!((first.status, first.header("cache-control")), (200, IMMUTABLE), "{path}");
        assert!(etag.starts_with('"') && etag.ends_with('"') && etag.len() == 34, "{etag}");
        for known in [etag.as_str(), &format!("W/{etag}"), &format!("\"x\", {etag}"), "*", " * "] {
            let again = server.request("GET", &path, &[("If-None-Match", known)]).await;
            assert_eq!((again.status, again.body.len()), (304, 0), "{known}");
            // RFC 9110, section 15.4.5: the headers of the corresponding 200.
            assert_eq!((again.header("etag"), again.header("cache-control")), (etag.as_str(), IMMUTABLE));
        }
        let two_lines = [("If-None-Match", "\"x\""), ("If-None-Match", etag.as_str())];
        assert_eq!(server.request("GET", &path, &two_lines).await.status, 304);
        assert_eq!(server.request("GET", &path, &[("If-None-Match", "\"x\"")]).await.status, 200);
        assert_eq!(server.request("GET", &path, &[("If-Match", &etag)]).await.status, 200);
        let failed = server.request("GET", &path, &[("If-Match", "\"x\"")]).await;
        assert_eq!((failed.status, failed.problem().as_str()), (412, "precondition-failed"));
        // `If-Match` takes precedence: RFC 9110, section 13.2.2.
        let both = [("If-Match", "\"x\""), ("If-None-Match", etag.as_str())];
        assert_eq!(server.request("GET", &path, &both).await.status, 412);
        assert_eq!(server.get(&path).await.body, first.body, "the same bytes under the same validator");
    }
    let (one, other) = (server.path("chunk/0/0/0"), server.path("chunk/0/0/1"));
    assert_ne!(server.get(&one).await.header("etag"), server.get(&other).await.header("etag"));
}

/// Replicas behind one cache agree on every address, whatever else they are doing.
#[tokio::test]
async fn the_etag_is_the_digest_of_the_content_on_every_server() {
    let (idle, busy) = (Server::start().await, Server::start().await);
    let land = Land::new(ServerConfig::default().world_seed);
    // Chunks that no one else requests, eight at a time, until the checks are done.
    let loaded = AtomicU32::new(0);
    let load = futures_util::stream::iter(0..)
        .map(|n| busy.path(&format!("chunk/0/{}/{}", n % 1000 - 500, n / 1000 + 1)))
        .map(async |path| busy.get(&path).await.status)
        .buffer_unordered(8)
        .for_each(async |status| {
            assert!([200, 503].contains(&status));
            loaded.fetch_add(u32::from(status == 200), Ordering::Relaxed);
        });
    let checks = async {
        for level in 0..=TOP_LEVEL {
            let key = ChunkKey::new(level, 0, 0).unwrap();
            let content = seed_only::digest(&land.chunk(key), &land.digest());
            let etag: String = content.iter().map(|byte| format!("{byte:02x}")).collect();
            let before = loaded.load(Ordering::Relaxed);
            for server in [&idle, &busy, &idle] {
                let reply = server.get(&server.path(&format!("chunk/{level}/0/0"))).await;
                assert_eq!(
                    (reply.status, reply.header("etag")),
                    (200, format!("\"{etag}\"").as_str()),
                    "{key}"
                );
                // The control: the digest in the frame is another one, of the encoded bytes.
                assert!(!reply.body.windows(16).any(|bytes| bytes == content), "{key}");
                assert_eq!(chunk_codec::decode(&reply.body, &land.digest()).unwrap(), land.chunk(key));
            }
            while loaded.load(Ordering::Relaxed) == before {
                tokio::task::yield_now().await;
            }
        }
    };
    tokio::select! {
        () = load => unreachable!("the load has no end"),
        () = checks => {}
    }
}

/// Sessions that load a server, and keys of each of their requests, of which each has two.
const SESSIONS: i32 = 16;
const KEYS: i32 = 512;

/// Requests chunks of level 0 that no other session requests, without end, and passes on the
/// frames.
async fn load(server: &Server, session: i32, frames: UnboundedSender<Bytes>) {
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    assert_eq!(request_over(&mut stream, "GET", "/v1/stream", &UPGRADE).await.status, 101);
    let mut socket = WebSocketStream::from_raw_socket(stream, Role::Client, None).await;
    // Rows from the middle of the world outwards.
    let request = |number: i32| {
        let row = session + number * SESSIONS;
        let x = if row % 2 == 0 { row / 2 } else { -(row + 1) / 2 };
        let keys = (0..KEYS).map(|n| WireKey { level: 0, x, z: n - KEYS / 2 }).collect();
        ClientMessage::Request { id: number as u32, keys }
    };
    let encoded = |message| Message::Binary(control::encode(&message).unwrap());
    let software = "load".into();
    let hello = Hello { digest: None, delivery: protocol::Delivery::Exact, token: None, software };
    let credit = || ClientMessage::Credit { chunks: KEYS as u32 };
    for message in [ClientMessage::Hello(hello), credit(), request(0), credit(), request(1)] {
        socket.send(encoded(message)).await.unwrap();
    }
    let (mut answers, mut requests) = (0, 2);
    while let Some(Ok(message)) = socket.next().await {
        let Message::Binary(bytes) = message else { continue };
        // What is no chunk is the Welcome.
        if control::decode::<ServerMessage>(&bytes).is_ok() {
            continue;
        }
        answers += 1;
        if answers % KEYS == 0 {
            socket.send(encoded(credit())).await.unwrap();
            socket.send(encoded(request(requests))).await.unwrap();
            requests += 1;
        }
        if frames.send(bytes).is_err() {
            return;
        }
    }
}

/// A chunk that a session has just got in the fast encoding is the same bytes over HTTP as from an
/// idle server.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_chunk_has_one_body_whatever_the_sessions_of_its_server_request() {
    const COMPARED: u32 = 20;
    let idle = Server::start_with(ServerConfig { threads: 1, ..ServerConfig::default() }).await;
    let patient = Duration::from_secs(60);
    let config = ServerConfig { threads: 1, deadline: patient, memory: None, ..ServerConfig::default() };
    let busy = Arc::new(Server::start_with(config).await);
    let (sender, mut frames) = tokio::sync::mpsc::unbounded_channel();
    let mut loads = JoinSet::new();
    for session in 0..SESSIONS {
        let (busy, sender) = (Arc::clone(&busy), sender.clone());
        loads.spawn(async move { load(&busy, session, sender).await });
    }
    let digest = Land::new(1).digest();
    let compare = async {
        let mut compared = 0;
        while compared < COMPARED {
            // The newest: the cache still has it.
            let mut frame = frames.recv().await.unwrap();
            while let Ok(newer) = frames.try_recv() {
                frame = newer;
            }
            let key = chunk_codec::decode(&frame, &digest).unwrap().key;
            let path = busy.path(&format!("chunk/0/{}/{}", key.x(), key.z()));
            let (of_busy, of_idle) = (busy.get(&path).await, idle.get(&path).await);
            assert_eq!((of_busy.status, of_idle.status), (200, 200), "{key}");
            assert!(of_busy.body == of_idle.body, "{key}: other bytes from the busy server");
            compared += u32::from(frame != of_idle.body);
        }
    };
    tokio::time::timeout(TEST_TIMEOUT * 2, compare).await.expect("sessions get frames in the fast encoding");
    loads.shutdown().await;
}

#[tokio::test]
async fn a_head_response_is_a_get_response_without_its_body() {
    let server = Server::start().await;
    for path in [
        server.path("chunk/0/1/1"),
        server.path("map/5/0/0.png"),
        server.path("height/3/4"),
        "/".into(),
        "/page/main.js".into(),
        "/openapi.json".into(),
        "/v1/world".into(),
        "/livez".into(),
        "/readyz".into(),
    ] {
        let (get, head) = (server.get(&path).await, server.request("HEAD", &path, &[]).await);
        assert_eq!((get.status, head.status, head.body.len()), (200, 200, 0), "{path}");
        assert_eq!(head.header("content-length"), get.body.len().to_string(), "{path}");
        for name in ["etag", "content-type", "cache-control", "x-content-type-options"] {
            assert_eq!(head.header(name), get.header(name), "{path} {name}");
        }
        assert_eq!(get.header("x-content-type-options"), "nosniff");
    }
    let path = server.path("chunk/0/1/1");
    let etag = server.get(&path).await.header("etag").to_owned();
    assert_eq!(server.request("HEAD", &path, &[("If-None-Match", &etag)]).await.status, 304);
    assert_eq!(server.request("HEAD", &server.path("chunk/17/0/0"), &[]).await.status, 404);
}

#[tokio::test]
async fn resources_that_require_a_token_are_private() {
    let config =
        ServerConfig { tokens: Some(TokenSet::one("sesame")), threads: 1, ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    for path in [
        server.path("chunk/0/0/0"),
        server.path("map/0/0/0.png"),
        server.path("height/0/0"),
        "/v1/live".into(),
    ] {
        let locked = server.get(&path).await;
        assert_eq!((locked.status, locked.problem().as_str()), (401, "unauthorised"), "{path}");
        assert_eq!(locked.header("www-authenticate"), "Bearer");
        assert_eq!(server.request("GET", &path, &[("Authorization", "Bearer other")]).await.status, 401);
        // The scheme is case-insensitive, the token is not.
        assert_eq!(server.request("GET", &path, &[("Authorization", "Bearer SESAME")]).await.status, 401);
        for scheme in ["Bearer", "bearer", "BEARER"] {
            let given = format!("{scheme} sesame");
            let open = server.request("GET", &path, &[("Authorization", &given)]).await;
            assert_eq!(open.status, 200, "{path} {scheme}");
            // `public` would let a shared cache serve it without the token: RFC 9111, section 3.5.
            assert!(!open.header("cache-control").contains("public"), "{}", open.header("cache-control"));
        }
        // A conditional request reveals nothing without the token.
        assert_eq!(server.request("GET", &path, &[("If-None-Match", "*")]).await.status, 401);
    }
    assert_eq!(server.get("/v1/world").await.json()["takes_token"], true);
}
