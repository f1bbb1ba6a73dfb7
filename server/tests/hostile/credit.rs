//! Grants of zero, of too much, and sums over the limit (protocol.md, section 2).

use crate::client::{Received, Server, Session, config, request, value};
use protocol::limits::{MAX_CREDIT_BYTES, MAX_CREDITS, MAX_KEYS};
use protocol::message::{ClientMessage, RefusalReason, ServerMessage};
use server::ServerConfig;
use std::time::Duration;

#[tokio::test]
async fn invalid_grants_are_refused_and_allow_no_chunk() {
    let server = Server::start(config()).await;
    let mut session = Session::open(&server).await;
    session.send(&request(7, 1)).await;
    let invalid = [
        ClientMessage::Credit { chunks: 0 },
        ClientMessage::Credit { chunks: MAX_CREDITS + 1 },
        ClientMessage::Credit { chunks: u32::MAX },
        ClientMessage::CreditBytes { bytes: 0 },
        ClientMessage::CreditBytes { bytes: MAX_CREDIT_BYTES + 1 },
        ClientMessage::CreditBytes { bytes: u32::MAX },
    ];
    for message in &invalid {
        session.send(message).await;
        match session.receive().await {
            Received::Message(ServerMessage::Refused(refused)) => {
                assert_eq!((refused.id, refused.reason), (0, RefusalReason::InvalidCredit), "{message:?}");
            }
            other => panic!("{message:?}: {other:?}"),
        }
        session.has_nothing().await;
    }
    let name = "tombolo_requests_rejected_total{transport=\"websocket\",reason=\"invalid_credit\"}";
    let metrics = server.metrics().await;
    assert_eq!(value(&metrics, name), invalid.len() as u64);
    assert!(!metrics.contains("tombolo_chunks_sent_total{"), "no chunk was sent: {metrics}");
    server.serves().await;
    // The control: one credit, one chunk of the request that waits.
    session.send(&ClientMessage::Credit { chunks: 1 }).await;
    session.receive_chunks(1).await;
    session.has_nothing().await;
    drop(session);
    server.is_empty().await;
    server.stop().await;
}

#[tokio::test]
async fn sums_of_grants_over_the_limit_are_cut_to_it() {
    // No chunk is rejected as late.
    let server = Server::start(ServerConfig { deadline: Duration::from_secs(60), ..config() }).await;
    let mut session = Session::open(&server).await;
    for _ in 0..20 {
        session.send(&ClientMessage::Credit { chunks: MAX_CREDITS }).await;
        session.send(&ClientMessage::CreditBytes { bytes: MAX_CREDIT_BYTES }).await;
    }
    session.has_nothing().await;
    for id in 0..MAX_CREDITS / MAX_KEYS as u32 {
        session.send(&request(id, MAX_KEYS)).await;
        session.receive_chunks(MAX_KEYS).await;
    }
    session.send(&request(100, 2)).await;
    session.has_nothing().await;
    session.send(&ClientMessage::Credit { chunks: 1 }).await;
    session.receive_chunks(1).await;
    session.has_nothing().await;
    assert_eq!(value(&server.metrics().await, "tombolo_chunks_sent_total{delivery=\"exact\"}"), 4097);
    drop(session);
    server.is_empty().await;
    server.stop().await;
}
