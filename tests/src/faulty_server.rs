//! A server that follows the protocol and sends wrong chunks: the session machine over real
//! sockets, with frames from a function of the suite.

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use protocol::server::{ServerOffer, ServerSession};
use protocol::{DataFrame, Delivery, SUBPROTOCOL};
use terrain::{ChunkKey, Land, WorldDigest};
use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::accept_hdr_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Request, Response};

/// Encodes the frame of a chunk for a delivery.
pub type Frames = fn(&Land, ChunkKey, Delivery) -> Bytes;

/// A faulty server on a free port; it ends with the suite's runtime.
pub struct FaultyServer {
    /// The WebSocket URL of the stream endpoint.
    pub stream_url: String,
}

impl FaultyServer {
    /// Serves seed 1 under an announced digest.
    pub async fn start(announced: WorldDigest, frames: Frames) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a loopback port is free");
        let address = listener.local_addr().expect("a bound listener has an address");
        let offer = ServerOffer {
            land: Land::new(1),
            digest: announced,
            token: None,
            software: "faulty server".into(),
        };
        tokio::spawn(async move {
            while let Ok((socket, _)) = listener.accept().await {
                tokio::spawn(serve(socket, offer.clone(), frames));
            }
        });
        Self { stream_url: format!("ws://{address}/v1/stream") }
    }
}

#[expect(clippy::result_large_err, reason = "the library fixes the type of this callback")]
fn accept_subprotocol(_: &Request, mut response: Response) -> Result<Response, ErrorResponse> {
    response.headers_mut().insert("sec-websocket-protocol", SUBPROTOCOL.parse().expect("a header value"));
    Ok(response)
}

async fn serve(socket: TcpStream, offer: ServerOffer, frames: Frames) {
    let Ok(mut socket) = accept_hdr_async(socket, accept_subprotocol).await else { return };
    let land = offer.land;
    let mut session = ServerSession::new(offer, 1);
    loop {
        // Without workers the server selects the chunks of a view here.
        while let Some(selection) = session.take_view() {
            session.apply_view(selection);
        }
        let next = session.next_chunk();
        while let Some(frame) = session.poll_transmit() {
            if socket.send(Message::Binary(frame)).await.is_err() {
                return;
            }
        }
        if let Some((request, delivery)) = next {
            let frame = frames(&land, request.key, delivery);
            session.deliver(request, frame);
            continue;
        }
        match socket.next().await {
            Some(Ok(Message::Binary(bytes))) => {
                if session.receive(DataFrame::Binary(&bytes)).is_err() {
                    return;
                }
            }
            Some(Ok(Message::Close(_)) | Err(_)) | None => return,
            Some(Ok(_)) => {}
        }
    }
}
