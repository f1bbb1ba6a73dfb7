//! Peers that violate the protocol: each gets a typed close code; other sessions are unaffected.

use futures_util::{SinkExt, StreamExt};
use protocol::message::{ClientMessage, Hello, RefusalReason, ServerMessage, WireKey};
use protocol::{CloseCode, Delivery, PROTOCOL_VERSION, SUBPROTOCOL, control, limits};
use server::access::tokens::TokenSet;
use std::time::Duration;
use tests::peer::{Peer, TestClient, view};
use tests::{RunningServer, running};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Error, Message};

fn hello() -> Vec<u8> {
    control::encode(&ClientMessage::Hello(Hello {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: "hostile".into(),
    }))
    .unwrap()
    .to_vec()
}

/// Sends one message after the handshake; returns the close code.
async fn outcome(server: &RunningServer, message: Message) -> Option<u16> {
    let mut peer = Peer::connect(&server.stream_url()).await;
    peer.send_bytes(hello()).await;
    peer.receive().await.expect("a welcome");
    peer.send(message).await;
    peer.closed().await
}

fn binary(bytes: &[u8]) -> Message {
    Message::Binary(bytes.to_vec().into())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn invalid_frames_get_typed_close_codes() {
    let server = RunningServer::start().await;
    let mut other_client = TestClient::connect(&server.stream_url()).await;
    other_client.settle(view(1, 300)).await;

    let credit = control::encode(&ClientMessage::Credit { chunks: 1 }).unwrap();
    let mut wrong_version = credit.to_vec();
    wrong_version[4] = 9;
    let cases = [
        ("truncated", binary(&credit[..credit.len() - 1]), CloseCode::Malformed),
        ("trailing", binary(&[&credit[..], b"x"].concat()), CloseCode::Malformed),
        ("garbage", binary(b"\xff\x00\xff\x00 nonsense"), CloseCode::Malformed),
        ("empty", binary(b""), CloseCode::Malformed),
        ("text", Message::Text("hello".into()), CloseCode::TextFrame),
        ("oversized", binary(&vec![0; limits::MAX_CONTROL_FRAME + 1]), CloseCode::TooLarge),
        ("far oversized", binary(&vec![0; 1 << 20]), CloseCode::TooLarge),
        ("second hello", binary(&hello()), CloseCode::OutOfOrder),
        ("other version", binary(&wrong_version), CloseCode::WrongVersion),
        // Clients may not send chunk frames.
        ("a chunk", binary(&[&b"TMBC\x01\x00\x01"[..], &[0; 29]].concat()), CloseCode::Malformed),
    ];
    for (name, message, code) in cases {
        assert_eq!(outcome(&server, message).await, Some(code.code()), "{name}");
    }
    other_client.settle(view(2, 500)).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn wrong_versions_and_worlds_are_rejected_with_both_values() {
    let server = RunningServer::start().await;
    let mut frame = hello();
    frame[4] = 42;
    let mut peer = Peer::connect(&server.stream_url()).await;
    peer.send_bytes(&frame).await;
    let answer = peer.receive().await.expect("a rejection");
    let ServerMessage::Rejected(rejection) = control::decode(&answer).unwrap() else { panic!("{answer:?}") };
    let ours = format!("server {PROTOCOL_VERSION}");
    assert!(rejection.to_string().contains("42") && rejection.to_string().contains(&ours), "{rejection}");
    assert_eq!(peer.closed().await, Some(CloseCode::WrongVersion.code()));

    // The Hello of a client of the first release, byte for byte.
    let mut old = b"TMBM\x01\x00".to_vec();
    old.extend([0; 4 + 1 + 1 + 8]);
    let mut peer = Peer::connect(&server.stream_url()).await;
    peer.send_bytes(&old).await;
    let answer = peer.receive().await.expect("a rejection");
    let ServerMessage::Rejected(rejection) = control::decode(&answer).unwrap() else { panic!("{answer:?}") };
    let both = format!("version 1, the server {PROTOCOL_VERSION}");
    assert!(rejection.to_string().contains(&both), "{rejection}");
    assert_eq!(peer.closed().await, Some(CloseCode::WrongVersion.code()));

    // A delivery of a later release: a malformed frame.
    let mut later = hello();
    later[4 + 2 + 4 + 1] = 9;
    let mut peer = Peer::connect(&server.stream_url()).await;
    peer.send_bytes(&later).await;
    assert_eq!(peer.closed().await, Some(CloseCode::Malformed.code()));

    let other_world = Hello {
        digest: Some([0xee; 32]),
        delivery: Delivery::Exact,
        token: None,
        software: "hostile".into(),
    };
    let mut peer = Peer::connect(&server.stream_url()).await;
    peer.send_bytes(control::encode(&ClientMessage::Hello(other_world)).unwrap()).await;
    let answer = peer.receive().await.expect("a rejection");
    let ServerMessage::Rejected(rejection) = control::decode(&answer).unwrap() else { panic!("{answer:?}") };
    let ours = terrain::Land::new(1).digest().to_string();
    assert!(
        rejection.to_string().contains(&"ee".repeat(32)) && rejection.to_string().contains(&ours),
        "{rejection}"
    );
    assert_eq!(peer.closed().await, Some(CloseCode::WrongWorld.code()));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_wrong_subprotocol_is_rejected_before_the_upgrade() {
    let server = RunningServer::start().await;
    for offered in [None, Some("chat"), Some("tombolo.v2")] {
        let Err(error) = Peer::try_connect(&server.stream_url(), offered).await else {
            panic!("{offered:?} was accepted")
        };
        let Error::Http(response) = *error else { panic!("{error}") };
        assert_eq!(response.status(), 400);
        let body = String::from_utf8(response.into_body().unwrap_or_default()).unwrap();
        assert!(body.contains(offered.unwrap_or("none")) && body.contains(SUBPROTOCOL), "{body}");
    }
    assert!(Peer::try_connect(&server.stream_url(), Some("chat, tombolo.v1")).await.is_ok());
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_without_a_hello_is_closed() {
    let server = RunningServer::start().await;
    let mut peer = Peer::connect(&server.stream_url()).await;
    assert_eq!(peer.closed().await, Some(CloseCode::HandshakeTimeout.code()));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_slow_request_head_ends_the_connection() {
    let server = RunningServer::start().await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(b"GET /livez HTTP/1.1\r\nHost: localhost").await.unwrap();
    let mut rest = Vec::new();
    let ended = tokio::time::timeout(Duration::from_secs(10), stream.read_to_end(&mut rest)).await;
    assert!(ended.is_ok(), "the connection is still open");
    // The control: a head in two parts is answered.
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n").await.unwrap();
    stream.write_all(b"Connection: close\r\n\r\n").await.unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_stops_reading_is_closed() {
    let server = RunningServer::start().await;
    let mut stalled = Peer::connect(&server.stream_url()).await;
    stalled.send_bytes(hello()).await;
    stalled.send_bytes(control::encode(&ClientMessage::Credit { chunks: 4096 }).unwrap()).await;
    let request = |id| {
        let keys = vec![WireKey { level: 0, x: 3, z: -7 }];
        control::encode(&ClientMessage::Request { id, keys }).unwrap()
    };
    // The Welcome and one chunk, which is cached from then on: further requests are answered at
    // once.
    stalled.send_bytes(request(0)).await;
    for _ in 0..2 {
        stalled.receive().await.expect("a frame");
    }
    for id in 1..4096 {
        stalled.send_bytes(request(id)).await;
    }
    let mut client = TestClient::connect(&server.stream_url()).await;
    client.settle(view(1, 500)).await;
    let gone = async {
        loop {
            let url = server.url("/metrics");
            let text = tokio::task::spawn_blocking(move || {
                ureq::get(url).call().unwrap().body_mut().read_to_string().unwrap()
            })
            .await
            .unwrap();
            if text.contains("sessions_ended_total{reason=\"write_timeout\"} 1") {
                return;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(15), gone).await.expect("the stalled client is closed");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn invalid_messages_are_refused_singly_and_counted() {
    let server = RunningServer::start().await;
    let mut other_client = TestClient::connect(&server.stream_url()).await;
    other_client.settle(view(1, 300)).await;

    let mut peer = Peer::connect(&server.stream_url()).await;
    peer.send_bytes(hello()).await;
    peer.receive().await.expect("a welcome");
    let far = WireKey { level: 0, x: i32::MIN, z: i32::MAX };
    let sea = WireKey { level: 0, x: 30_000, z: 30_000 };
    let messages = [
        ClientMessage::Credit { chunks: 0 },
        ClientMessage::Credit { chunks: u32::MAX },
        ClientMessage::CreditBytes { bytes: 0 },
        ClientMessage::Request { id: 1, keys: vec![far; 3] },
        ClientMessage::Request { id: 2, keys: vec![sea; 4] },
        ClientMessage::View(protocol::view::View { eye: [i32::MAX; 3], ..view(3, 300) }),
    ];
    for message in &messages {
        peer.send_bytes(control::encode(message).unwrap()).await;
    }
    // A million keys without credit: they wait or are refused.
    for id in 0..2000 {
        let keys = (0..limits::MAX_KEYS as i32).map(|x| WireKey { level: 0, x, z: 0 }).collect();
        peer.send_bytes(control::encode(&ClientMessage::Request { id: 10 + id, keys }).unwrap()).await;
    }
    let mut refused = Vec::new();
    while refused.len() < 3 + 3 + 3 + 1 + 1999 {
        match control::decode(&peer.receive().await.expect("the session stays open")).unwrap() {
            ServerMessage::Refused(refusal) => refused.push(refusal.reason),
            other => panic!("{other:?}"),
        }
    }
    let count = |reason| refused.iter().filter(|refused| **refused == reason).count();
    for (reason, expected) in [
        (RefusalReason::InvalidCredit, 3),
        (RefusalReason::OutsideWorld, 3),
        (RefusalReason::Duplicate, 3),
        (RefusalReason::InvalidView, 1),
        (RefusalReason::TooManyRequests, 1999),
    ] {
        assert_eq!(count(reason), expected, "{reason:?}");
    }
    other_client.settle(view(2, 500)).await;
    drop(peer);
    let url = server.url("/metrics");
    let text = tokio::task::spawn_blocking(move || {
        ureq::get(url).call().unwrap().body_mut().read_to_string().unwrap()
    })
    .await
    .unwrap();
    for line in [
        "tombolo_requests_rejected_total{transport=\"websocket\",reason=\"outside_world\"} 3",
        "tombolo_requests_rejected_total{transport=\"websocket\",reason=\"duplicate\"} 3",
        "tombolo_requests_rejected_total{transport=\"websocket\",reason=\"invalid_credit\"} 3",
        "tombolo_requests_rejected_total{transport=\"websocket\",reason=\"invalid_view\"} 1",
        "tombolo_requests_rejected_total{transport=\"websocket\",reason=\"too_many_requests\"} 1999",
    ] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sessions_per_address_are_limited() {
    let config = server::ServerConfig { max_sessions_per_address: Some(1), ..running::quick_config() };
    let server = RunningServer::start_with(config).await;
    let client = TestClient::connect(&server.stream_url()).await;
    let Err(error) = Peer::try_connect(&server.stream_url(), Some(SUBPROTOCOL)).await else {
        panic!("accepted")
    };
    let Error::Http(response) = *error else { panic!("{error}") };
    assert_eq!(response.status(), 503);
    let body = String::from_utf8(response.into_body().unwrap_or_default()).unwrap();
    assert!(body.contains("from this address"), "{body}");
    drop(client);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_server_responds_503_until_a_session_ends() {
    let config = server::ServerConfig { max_sessions: 1, ..running::quick_config() };
    let server = RunningServer::start_with(config).await;
    let client = TestClient::connect(&server.stream_url()).await;
    let Err(error) = Peer::try_connect(&server.stream_url(), Some(SUBPROTOCOL)).await else {
        panic!("accepted")
    };
    let Error::Http(response) = *error else { panic!("{error}") };
    assert_eq!(response.status(), 503);
    assert!(response.headers().contains_key("retry-after"));
    assert_eq!(status(&server, "/readyz").await, 200, "requests of chunks are still served");
    drop(client);
    let admitted = async {
        while Peer::try_connect(&server.stream_url(), Some(SUBPROTOCOL)).await.is_err() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(10), admitted).await.expect("a session becomes available");
    server.stop().await;
}

/// The status of a page.
async fn status(server: &RunningServer, path: &str) -> u16 {
    let url = server.url(path);
    let get = move || match ureq::get(url).call() {
        Ok(reply) => reply.status().as_u16(),
        Err(ureq::Error::StatusCode(status)) => status,
        Err(error) => panic!("{error}"),
    };
    tokio::task::spawn_blocking(get).await.unwrap()
}

fn address(server: &RunningServer) -> std::net::SocketAddr {
    server.url("").trim_start_matches("http://").parse().unwrap()
}

/// Only Linux has further addresses on the loopback device.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_per_address_are_limited() {
    let long_timeout = Duration::from_secs(60);
    let config = server::ServerConfig {
        max_sessions: 100,
        max_sessions_per_address: Some(1),
        handshake_timeout: long_timeout,
        ..running::quick_config()
    };
    let server = RunningServer::start_with(config).await;
    // More connections than the limit for all addresses.
    let mut idle = Vec::new();
    for _ in 0..400 {
        idle.push(TcpStream::connect(address(&server)).await.unwrap());
    }
    let elsewhere = TcpSocket::new_v4().unwrap();
    elsewhere.bind("127.0.0.2:0".parse().unwrap()).unwrap();
    let mut elsewhere = elsewhere.connect(address(&server)).await.unwrap();
    elsewhere
        .write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        .await
        .unwrap();
    let mut reply = String::new();
    let read = tokio::time::timeout(long_timeout / 2, elsewhere.read_to_string(&mut reply));
    read.await.expect("another address is served").unwrap();
    assert!(reply.starts_with("HTTP/1.1 200"), "{reply}");
    assert!(reply.contains("tombolo_connections_rejected_total 335\n"), "{reply}");
    assert!(reply.contains("tombolo_connections 66\n"), "{reply}");
    drop(idle);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn endless_requests_without_reading_end_the_connection() {
    let server = RunningServer::start().await;
    let mut stalled = TcpStream::connect(address(&server)).await.unwrap();
    // Megabytes of responses, more than all buffers hold.
    let requests = b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(2000);
    let requesting = async {
        // An error means that the server ended the connection, as expected.
        let _ = stalled.write_all(&requests).await;
        while stalled.writable().await.is_ok() && stalled.try_write(b"G").is_ok() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(30), requesting).await.expect("the connection ends");
    assert_eq!(status(&server, "/livez").await, 200);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_stream_and_http_require_the_token() {
    let config =
        server::ServerConfig { tokens: Some(TokenSet::one("open sesame")), ..running::quick_config() };
    let server = RunningServer::start_with(config).await;
    let mut peer = Peer::connect(&server.stream_url()).await;
    peer.send_bytes(hello()).await;
    assert_eq!(peer.closed().await, Some(CloseCode::Unauthorised.code()));
    let admitted = Hello {
        digest: None,
        delivery: Delivery::Exact,
        token: Some("open sesame".into()),
        software: String::new(),
    };
    let mut peer = Peer::connect(&server.stream_url()).await;
    peer.send_bytes(control::encode(&ClientMessage::Hello(admitted)).unwrap()).await;
    assert!(peer.receive().await.is_ok());
    let url = server.url(&format!("/v1/{}/chunk/0/60/60", terrain::Land::new(1).digest()));
    tokio::task::spawn_blocking(move || {
        let agent: ureq::Agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
        assert_eq!(agent.get(&url).call().unwrap().status(), 401);
        assert_eq!(
            agent.get(&url).header("Authorization", "Bearer open sesame").call().unwrap().status(),
            200
        );
    })
    .await
    .unwrap();
    server.stop().await;
}

/// Answers that the system buffers whole: no write of the server ever waits.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_whose_answers_stay_in_the_systems_buffer_is_closed() {
    // Far below the keep-alive's minute, which would end it too.
    const LIMIT: Duration = Duration::from_secs(20);
    let server = RunningServer::start().await;
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let mut stream = socket.connect(server.address).await.unwrap();
    let url = server.stream_url();
    let (mut session, _) = {
        let mut request = url.as_str().into_client_request().unwrap();
        request.headers_mut().insert("Sec-WebSocket-Protocol", SUBPROTOCOL.parse().unwrap());
        tokio_tungstenite::client_async(request, &mut stream).await.unwrap()
    };
    // Fewer than the bytes that the system holds unsent.
    let keys = (0..10).map(|n| WireKey { level: 0, x: n % 8 - 4, z: n / 8 - 4 }).collect();
    let credit = ClientMessage::Credit { chunks: 64 };
    session.send(binary(&hello())).await.unwrap();
    session.next().await.unwrap().unwrap();
    for message in [credit, ClientMessage::Request { id: 1, keys }] {
        session.send(binary(&control::encode(&message).unwrap())).await.unwrap();
    }
    // From here on nothing is read, and the socket stays open.
    let sessions = || async {
        let address = server.url("/metrics");
        let get = move || ureq::get(address).call().unwrap().body_mut().read_to_string().unwrap();
        let text = tokio::task::spawn_blocking(get).await.unwrap();
        let value = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)?.parse::<u32>().ok());
        (
            value("tombolo_sessions ").unwrap(),
            value("tombolo_sessions_ended_total{reason=\"write_timeout\"} "),
        )
    };
    let closed = async {
        while sessions().await.0 > 0 {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(LIMIT, closed).await.expect("the session ends");
    // It was not a write that waited: that is another limit.
    assert_eq!(sessions().await.1.unwrap_or(0), 0);
    drop(session);
    server.stop().await;
}
