//! The load test against small servers with known faults: the correct server must pass, every
//! faulty one must fail.
//!
//! The servers run the server state machine of the `protocol` crate over TCP on port 0.

use futures_util::{SinkExt, StreamExt};
use load::config::stream_address;
use load::{LoadConfig, PathKind, Report};
use protocol::control;
use protocol::message::{RefusalReason, ServerMessage, Settled};
use protocol::server::{ServerOffer, ServerSession, TokenCheck};
use protocol::{DataFrame, Delivery, SUBPROTOCOL, Tolerance};
use std::sync::Arc;
use terrain::Land;
use test_support::{ChunkFault, chunk_fault};
use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::accept_hdr_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Request, Response};

/// The fault of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    Nothing,
    /// Every chunk is wrong.
    Chunk(ChunkFault),
    /// The announced digest is that of another seed.
    World,
    /// The connection is cut after some chunks.
    HangUp,
    /// Every chunk is refused.
    Refusal,
    /// The generation of every chunk fails.
    Failure,
    /// One chunk of a view is lost.
    Loss,
    /// After some chunks nothing is read or sent.
    Stalled,
    /// There is no Welcome.
    NoWelcome,
    /// A view is settled that was not sent.
    Settled,
}

impl Fault {
    fn of_chunks(self) -> Option<ChunkFault> {
        match self {
            Self::Chunk(fault) => Some(fault),
            _ => None,
        }
    }
}

#[expect(clippy::result_large_err, reason = "the library fixes the type of this callback")]
fn accept_subprotocol(_: &Request, mut response: Response) -> Result<Response, ErrorResponse> {
    response.headers_mut().insert("sec-websocket-protocol", SUBPROTOCOL.parse().expect("a header value"));
    Ok(response)
}

async fn serve(socket: TcpStream, offer: ServerOffer, fault: Fault) {
    let Ok(mut socket) = accept_hdr_async(socket, accept_subprotocol).await else { return };
    if fault == Fault::NoWelcome {
        return std::future::pending().await;
    }
    let land = offer.land;
    let mut session = ServerSession::new(offer, 1);
    let mut sent = 0;
    loop {
        // Without workers the server selects the chunks of a view here.
        while let Some(mut selection) = session.take_view() {
            selection.step(&land, usize::MAX);
            session.apply_view(selection);
        }
        let next = session.next_chunk();
        while let Some(frame) = session.poll_transmit() {
            if socket.send(Message::Binary(frame)).await.is_err() {
                return;
            }
        }
        if let Some((wanted, delivery)) = next {
            sent += 1;
            match fault {
                Fault::Settled if sent == 3 => {
                    let settled = ServerMessage::Settled(Settled { view: u32::MAX, chunks: 1 });
                    let frame = control::encode(&settled).expect("a message");
                    let _ = socket.send(Message::Binary(frame)).await;
                    session.deliver(wanted, chunk_fault::frame(None, &land, wanted.key, delivery));
                }
                Fault::HangUp if sent > 5 => return,
                Fault::Stalled if sent > 5 => return std::future::pending().await,
                Fault::Failure => session.fail(wanted, RefusalReason::Failed, "it panicked"),
                Fault::Loss if sent == 3 => {
                    let frame = chunk_fault::frame(None, &land, wanted.key, delivery);
                    session.deliver(wanted, frame);
                    while session.poll_transmit().is_some() {}
                }
                Fault::Refusal => {
                    session.fail(wanted, RefusalReason::Overloaded, "try later");
                }
                _ => {
                    let frame = chunk_fault::frame(fault.of_chunks(), &land, wanted.key, delivery);
                    session.deliver(wanted, frame);
                }
            }
            continue;
        }
        match socket.next().await {
            Some(Ok(Message::Binary(bytes))) => {
                if session.receive(DataFrame::Binary(&bytes)).is_err() {
                    while let Some(frame) = session.poll_transmit() {
                        let _ = socket.send(Message::Binary(frame)).await;
                    }
                    return;
                }
            }
            Some(Ok(Message::Close(_)) | Err(_)) | None => return,
            Some(Ok(_)) => {}
        }
    }
}

/// Runs a small load against a server and returns what it found.
async fn load_on(fault: Fault, delivery: Delivery, token: Option<&str>) -> Report {
    load_with(fault, token, |config| LoadConfig { delivery, ..config }).await
}

/// As [`load_on`], with changed options. On a busy machine nothing may arrive in a short run, which
/// says nothing of the server: then a longer one follows.
async fn load_with(fault: Fault, token: Option<&str>, change: impl Fn(LoadConfig) -> LoadConfig) -> Report {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    let land = Land::new(1);
    let announced = if fault == Fault::World { Land::new(2) } else { land };
    let offer = ServerOffer {
        land,
        digest: announced.digest(),
        token: token.map(|token| Arc::new(token.to_owned()) as Arc<dyn TokenCheck>),
        software: "test server".into(),
    };
    let server = tokio::spawn(async move {
        while let Ok((socket, _)) = listener.accept().await {
            tokio::spawn(serve(socket, offer.clone(), fault));
        }
    });
    let address = stream_address(&format!("ws://{address}/v1/stream")).expect("a stream");
    let run = |seconds| {
        load::run(change(LoadConfig {
            clients: 3,
            seconds,
            view_distance_m: 500,
            verify_every: 1,
            ..LoadConfig::new(address.clone())
        }))
    };
    let mut report = run(2).await;
    // Neither a complete view (or a chunk of another mode) nor a fault: then the machine is busy,
    // and no server is judged.
    let faults = |report: &Report| {
        let counts = &report.counts;
        counts.mismatches + counts.refused + counts.dropped + counts.stalled
    };
    let served = if report.mode == "view" { report.views_settled } else { report.counts.chunks };
    if faults(&report) == 0 && (served == 0 || report.never_connected > 0) {
        report = run(30).await;
    }
    server.abort();
    report
}

#[tokio::test(flavor = "multi_thread")]
async fn a_correct_server_passes_with_every_chunk_compared() {
    let quantised = Delivery::Quantised(Tolerance::COARSEST);
    for delivery in [Delivery::Exact, Delivery::SeedOnly, quantised, Delivery::Refined] {
        let report = load_on(Fault::Nothing, delivery, None).await;
        assert_eq!(report.verdict(), Ok(()), "{report}");
        // The number of chunks depends on the machine.
        assert!(report.counts.chunks > 0 && report.regenerated == report.counts.chunks, "{report}");
        assert!(report.counts.requests > 0, "{report}");
        assert_eq!(
            (report.counts.mismatches, report.counts.dropped, report.counts.refused),
            (0, 0, 0),
            "{report}"
        );
        match delivery {
            Delivery::Exact | Delivery::Quantised(_) | Delivery::Refined => {
                assert!(report.counts.bytes > report.counts.chunks * 60, "{report}");
            }
            Delivery::SeedOnly => assert_eq!(report.counts.bytes, report.counts.chunks * 36, "{report}"),
        }
        assert_eq!(report.delivery, delivery.name());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_wrong_chunk_is_a_mismatch_in_the_verdict() {
    for (fault, delivery, word) in [
        (Fault::Chunk(ChunkFault::Height), Delivery::Exact, "vertex"),
        (Fault::Chunk(ChunkFault::Error), Delivery::Exact, "error"),
        (Fault::Chunk(ChunkFault::Error), Delivery::Quantised(Tolerance::COARSEST), "error"),
        (Fault::Chunk(ChunkFault::Bit), Delivery::Exact, "digest"),
        (Fault::Chunk(ChunkFault::Place), Delivery::Exact, "neither requested nor needed"),
        (Fault::World, Delivery::Exact, "announces world"),
        (Fault::Chunk(ChunkFault::Bit), Delivery::Refined, "digest"),
        (Fault::Chunk(ChunkFault::Error), Delivery::Refined, "error"),
        (Fault::Chunk(ChunkFault::Height), Delivery::SeedOnly, "generated here"),
        (Fault::Chunk(ChunkFault::Error), Delivery::SeedOnly, "error"),
        (Fault::Chunk(ChunkFault::Bit), Delivery::SeedOnly, "generated here"),
        (Fault::Chunk(ChunkFault::Place), Delivery::SeedOnly, "neither requested nor needed"),
        (Fault::World, Delivery::SeedOnly, "use exact delivery"),
        (Fault::Settled, Delivery::Exact, "which was not sent"),
    ] {
        let report = load_on(fault, delivery, None).await;
        assert!(report.counts.mismatches > 0, "{fault:?}, {delivery}: {report}");
        let verdict = report.verdict().expect_err("a faulty server passed");
        assert!(verdict.contains("mismatches") && verdict.contains(word), "{fault:?}, {delivery}: {verdict}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_hangs_up_drops_sessions() {
    let report = load_on(Fault::HangUp, Delivery::Exact, None).await;
    assert!(report.counts.dropped > 0, "{report}");
    assert_eq!(report.counts.mismatches, 0, "{report}");
    assert!(report.verdict().expect_err("dropped").contains("before their time"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_reconnects_gets_only_what_it_lacks() {
    // Reconnecting takes a second and more on a busy machine.
    let longer = |config: LoadConfig| LoadConfig { seconds: 4 * config.seconds, ..config };
    let report = load_with(Fault::HangUp, None, longer).await;
    assert!(report.resume.lost > 0 && report.resume.resumed > 0, "{report}");
    assert!(report.resume.held_bytes > 0 && report.resume.chunks_again == 0, "{report}");
    // The control: who reports nothing gets the chunks of its view again.
    let report =
        load_with(Fault::HangUp, None, |config| LoadConfig { resume: false, ..longer(config) }).await;
    assert!(report.resume.chunks_again > 0 && report.resume.bytes_again > 0, "{report}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_token_is_refused_once_and_fails_the_run() {
    let report = load_on(Fault::Nothing, Delivery::Exact, Some("secret")).await;
    assert_eq!((report.counts.refused, report.counts.chunks, report.counts.dropped), (3, 0, 0), "{report}");
    assert_eq!(report.never_connected, 3, "{report}");
    assert!(report.verdict().expect_err("nothing arrived").contains("token"));
}

#[tokio::test(flavor = "multi_thread")]
async fn rejected_chunks_are_refusals_and_no_faults() {
    let report = load_on(Fault::Refusal, Delivery::Exact, None).await;
    assert!(
        report.counts.refused > 0 && report.counts.mismatches == 0 && report.counts.dropped == 0,
        "{report}"
    );
    assert!(report.verdict().expect_err("nothing arrived").contains("try later"));
}

#[tokio::test(flavor = "multi_thread")]
async fn chunks_that_cannot_be_made_fail_the_run() {
    let report = load_on(Fault::Failure, Delivery::Exact, None).await;
    assert!(report.counts.mismatches > 0, "{report}");
    assert!(report.verdict().expect_err("a fault").contains("it panicked"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_view_that_is_settled_without_a_chunk_fails_the_run() {
    let report = load_on(Fault::Loss, Delivery::Exact, None).await;
    assert!(report.counts.mismatches > 0, "{report}");
    assert!((1..=report.views_settled).contains(&report.views_checked), "{report}");
    assert!(report.verdict().expect_err("a fault").contains("neither sent nor refused"), "{report}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_falls_silent_fails_the_run() {
    for (fault, chunks) in [(Fault::Stalled, 15), (Fault::NoWelcome, 0)] {
        let report = load_with(fault, None, |config| LoadConfig { seconds: 7, ..config }).await;
        assert_eq!((report.counts.stalled, report.counts.chunks), (3, chunks), "{report}");
        assert!(report.verdict().expect_err("a fault").contains("silent"), "{report}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_missing_server_is_a_one_line_error() {
    let free = TcpListener::bind("127.0.0.1:0").await.expect("a free port").local_addr().expect("bound");
    let config = LoadConfig {
        clients: 1,
        seconds: 1,
        path: PathKind::Walk,
        ..LoadConfig::new(stream_address(&format!("ws://{free}/v1/stream")).expect("a stream"))
    };
    let verdict = load::run(config).await.verdict().expect_err("there is no server");
    assert!(verdict.contains(&free.to_string()) && verdict.lines().count() == 1, "{verdict}");
}
