//! Live statistics.

use crate::client::{Server, TEST_TIMEOUT};
use futures_util::{SinkExt, StreamExt};
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::view::View;
use protocol::{DataFrame, Delivery, SUBPROTOCOL};
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_session_is_listed_with_position_and_counts_only() {
    let server = Server::start().await;
    let empty = server.get("/v1/live").await.json();
    assert_eq!((&empty["sessions"]["open"], &empty["sent"]), (&0.into(), &serde_json::Value::Null));

    let mut request = format!("ws://{}/v1/stream", server.address).into_client_request().unwrap();
    request.headers_mut().insert("Sec-WebSocket-Protocol", SUBPROTOCOL.parse().unwrap());
    let (mut socket, _) = connect_async(request).await.unwrap();
    let config = ClientConfig {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: "suite".into(),
        window: 64,
    };
    let mut session = ClientSession::new(config);
    let eye = [-1500 * 256, 90 * 256, 700 * 256];
    session.set_view(View { eye, yaw_mdeg: 450_000, ..test_support::view(1, 600) });
    let settle = async {
        let (mut chunks, mut settled) = (0u64, false);
        while !settled {
            while let Some(frame) = session.poll_transmit() {
                socket.send(Message::Binary(frame)).await.unwrap();
            }
            let Some(Ok(Message::Binary(frame))) = socket.next().await else { panic!("the session ended") };
            match session.receive(DataFrame::Binary(&frame)).unwrap() {
                Event::Chunk { .. } => chunks += 1,
                Event::Settled(_) => settled = true,
                _ => {}
            }
        }
        chunks
    };
    let chunks = tokio::time::timeout(TEST_TIMEOUT, settle).await.expect("the view settles in time");
    assert!(chunks > 5, "{chunks}");

    // Until a snapshot contains all chunks; snapshots are about a second apart.
    let listed = async {
        loop {
            let live = server.get("/v1/live").await;
            assert!(!String::from_utf8_lossy(&live.body).contains("127.0.0.1"));
            let live = live.json();
            if live["sessions"]["listed"][0]["chunks"] == chunks {
                return live;
            }
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    };
    let live = tokio::time::timeout(TEST_TIMEOUT, listed).await.expect("the session is listed in time");
    assert_eq!(live["sessions"]["open"], 1);
    let view = &live["sessions"]["listed"][0]["view"];
    assert_eq!(
        (view["x_m"].as_f64(), view["z_m"].as_f64(), view["heading_deg"].as_f64()),
        (Some(-1500.0), Some(700.0), Some(90.0))
    );
    let metrics = String::from_utf8(server.get("/metrics").await.body).unwrap();
    let counted = format!("tombolo_chunk_latency_seconds_count {chunks}");
    assert!(metrics.lines().any(|line| line == counted), "{counted} is not in {metrics}");

    drop(socket);
    let gone = async {
        while server.get("/v1/live").await.json()["sessions"]["listed"] != serde_json::json!([]) {
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(TEST_TIMEOUT, gone).await.expect("a session that ended is not listed");
}
