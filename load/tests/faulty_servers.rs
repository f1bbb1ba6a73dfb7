//! The load test against small servers of known honesty: it must pass the honest one and catch
//! every liar.
//!
//! The servers run the protocol's own server machine over real sockets on port 0.

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use load::config::stream_address;
use load::{LoadConfig, PathKind, Report};
use protocol::server::{ServerOffer, ServerSession, Wanted};
use protocol::{Delivery, Incoming, SUBPROTOCOL, Tolerance, chunk_codec};
use terrain::{Chunk, ChunkKey, Land};
use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::accept_hdr_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Request, Response};

/// What is wrong with a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Lie {
    Nothing,
    /// One height is off by one unit; digest, extremes and pyramids are made to fit.
    Height,
    /// The measured error is off by one unit.
    Error,
    /// A bit of the header is flipped.
    Bit,
    /// A chunk of another place, honest in itself.
    Place,
    /// The announced digest is that of another seed.
    World,
    /// The connection is cut after some chunks.
    HangUp,
    /// Every chunk is refused.
    Refusal,
}

/// The frame that a server of this honesty sends for a wanted chunk.
fn frame(lie: Lie, land: &Land, wanted: Wanted, delivery: Delivery) -> Bytes {
    let world = land.digest();
    let mut chunk = match lie {
        Lie::Place => land.chunk(ChunkKey::new(0, -30_000, wanted.key.x()).expect("exists")),
        _ => land.chunk(wanted.key),
    };
    match lie {
        Lie::Height => {
            chunk.heights[2000] += 1;
            chunk = Chunk::from_parts(chunk.key, chunk.heights, chunk.error, chunk.grass);
        }
        Lie::Error => chunk.error += 1,
        _ => {}
    }
    let frame = chunk_codec::encode_for(delivery, &chunk, &world);
    if lie != Lie::Bit {
        return frame;
    }
    let mut damaged = frame.to_vec();
    damaged[30] ^= 1;
    damaged.into()
}

#[expect(clippy::result_large_err, reason = "the library fixes the type of this callback")]
fn accept_subprotocol(_: &Request, mut response: Response) -> Result<Response, ErrorResponse> {
    response.headers_mut().insert("sec-websocket-protocol", SUBPROTOCOL.parse().expect("a header value"));
    Ok(response)
}

async fn serve(socket: TcpStream, offer: ServerOffer, lie: Lie) {
    let Ok(mut socket) = accept_hdr_async(socket, accept_subprotocol).await else { return };
    let land = offer.land;
    let mut session = ServerSession::new(offer, 1);
    let mut sent = 0;
    loop {
        while let Some(frame) = session.poll_transmit() {
            if socket.send(Message::Binary(frame)).await.is_err() {
                return;
            }
        }
        if let Some((wanted, delivery)) = session.next_chunk() {
            sent += 1;
            match lie {
                Lie::HangUp if sent > 5 => return,
                Lie::Refusal => {
                    session.fail(wanted, protocol::message::RefusalReason::Overloaded, "try later");
                }
                _ => {
                    let frame = frame(lie, &land, wanted, delivery);
                    session.deliver(wanted, frame);
                }
            }
            continue;
        }
        match socket.next().await {
            Some(Ok(Message::Binary(bytes))) => {
                if session.receive(Incoming::Binary(&bytes)).is_err() {
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
async fn load_on(lie: Lie, delivery: Delivery, token: Option<&str>) -> Report {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("bound");
    let land = Land::new(1);
    let announced = if lie == Lie::World { Land::new(2) } else { land };
    let offer = ServerOffer {
        land,
        digest: announced.digest(),
        token: token.map(String::from),
        software: "test server".into(),
    };
    let server = tokio::spawn(async move {
        while let Ok((socket, _)) = listener.accept().await {
            tokio::spawn(serve(socket, offer.clone(), lie));
        }
    });
    let report = load::run(LoadConfig {
        clients: 3,
        seconds: 2,
        delivery,
        view_distance_m: 500,
        verify_every: 1,
        ..LoadConfig::new(stream_address(&format!("ws://{address}/v1/stream")).expect("a stream"))
    })
    .await;
    server.abort();
    report
}

#[tokio::test(flavor = "multi_thread")]
async fn an_honest_server_passes_with_every_chunk_compared() {
    let quantised = Delivery::Quantised(Tolerance::COARSEST);
    for delivery in [Delivery::Exact, Delivery::SeedOnly, quantised, Delivery::Refined] {
        let report = load_on(Lie::Nothing, delivery, None).await;
        assert_eq!(report.verdict(), Ok(()), "{report}");
        // How many arrive depends on the machine; that all are counted and compared does not.
        assert!(report.chunks > 0 && report.regenerated == report.chunks, "{report}");
        assert!(report.requests > 0, "{report}");
        assert_eq!((report.mismatches, report.dropped, report.refused), (0, 0, 0), "{report}");
        match delivery {
            Delivery::Exact | Delivery::Quantised(_) | Delivery::Refined => {
                assert!(report.bytes > report.chunks * 60, "{report}");
            }
            Delivery::SeedOnly => assert_eq!(report.bytes, report.chunks * 36, "{report}"),
        }
        assert_eq!(report.delivery, delivery.name());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_falsified_chunk_is_a_mismatch_and_the_verdict_says_so() {
    for (lie, delivery, word) in [
        (Lie::Height, Delivery::Exact, "vertex"),
        (Lie::Error, Delivery::Exact, "error"),
        (Lie::Error, Delivery::Quantised(Tolerance::COARSEST), "error"),
        (Lie::Bit, Delivery::Exact, "digest"),
        (Lie::Place, Delivery::Exact, "neither requested nor needed"),
        (Lie::World, Delivery::Exact, "announces world"),
        (Lie::Bit, Delivery::Refined, "digest"),
        (Lie::Error, Delivery::Refined, "error"),
        (Lie::Height, Delivery::SeedOnly, "generated here"),
        (Lie::Error, Delivery::SeedOnly, "error"),
        (Lie::Bit, Delivery::SeedOnly, "generated here"),
        (Lie::Place, Delivery::SeedOnly, "neither requested nor needed"),
        (Lie::World, Delivery::SeedOnly, "use exact delivery"),
    ] {
        let report = load_on(lie, delivery, None).await;
        assert!(report.mismatches > 0, "{lie:?}, {delivery}: {report}");
        let verdict = report.verdict().expect_err("a liar passed");
        assert!(verdict.contains("mismatches") && verdict.contains(word), "{lie:?}, {delivery}: {verdict}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_hangs_up_drops_sessions() {
    let report = load_on(Lie::HangUp, Delivery::Exact, None).await;
    assert!(report.dropped > 0, "{report}");
    assert_eq!(report.mismatches, 0, "{report}");
    assert!(report.verdict().expect_err("dropped").contains("before their time"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_token_is_refused_once_and_no_chunk_is_no_pass() {
    let report = load_on(Lie::Nothing, Delivery::Exact, Some("secret")).await;
    assert_eq!((report.refused, report.chunks, report.dropped), (3, 0, 0), "{report}");
    assert!(report.verdict().expect_err("nothing arrived").contains("token"));
}

#[tokio::test(flavor = "multi_thread")]
async fn shed_chunks_are_refusals_and_no_faults() {
    let report = load_on(Lie::Refusal, Delivery::Exact, None).await;
    assert!(report.refused > 0 && report.mismatches == 0 && report.dropped == 0, "{report}");
    assert!(report.verdict().expect_err("nothing arrived").contains("try later"));
}

#[tokio::test(flavor = "multi_thread")]
async fn no_server_at_all_is_said_in_one_line() {
    let free = TcpListener::bind("127.0.0.1:0").await.expect("a free port").local_addr().expect("bound");
    let config = LoadConfig {
        clients: 1,
        seconds: 1,
        path: PathKind::Walk,
        ..LoadConfig::new(stream_address(&format!("ws://{free}/v1/stream")).expect("a stream"))
    };
    let verdict = load::run(config).await.verdict().expect_err("nobody is there");
    assert!(verdict.contains(&free.to_string()) && verdict.lines().count() == 1, "{verdict}");
}
