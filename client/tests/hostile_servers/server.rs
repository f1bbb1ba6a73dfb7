//! Servers that misbehave, over real sockets on a free loopback port.

use bytes::Bytes;
use protocol::chunk_codec;
use protocol::control;
use protocol::message::{RefusalReason, ServerMessage, Welcome};
use protocol::server::{ServerOffer, ServerSession};
use protocol::{DataFrame, Delivery, SUBPROTOCOL};
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use terrain::constants::GENERATOR_VERSION;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tokio_tungstenite::tungstenite::{Message, WebSocket, accept_hdr};

/// How a server treats a connection, whose number counts from 0.
pub type Behaviour = Arc<dyn Fn(TcpStream, usize) + Send + Sync>;

/// A server; stopped when dropped.
pub struct HostileServer {
    address: SocketAddr,
    stopped: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl HostileServer {
    pub fn start(behaviour: Behaviour) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a loopback port is free");
        let address = listener.local_addr().expect("a bound listener has an address");
        let stopped = Arc::new(AtomicBool::new(false));
        let is_stopped = Arc::clone(&stopped);
        let accept = move || {
            for (number, stream) in listener.incoming().enumerate() {
                if is_stopped.load(Ordering::Relaxed) {
                    return;
                }
                let Ok(stream) = stream else { continue };
                // No thread of a connection outlives its test for long.
                let limit = Some(Duration::from_secs(20));
                stream.set_read_timeout(limit).and(stream.set_write_timeout(limit)).expect("a limit");
                let behaviour = Arc::clone(&behaviour);
                std::thread::spawn(move || behaviour(stream, number));
            }
        };
        Self { address, stopped, thread: Some(std::thread::spawn(accept)) }
    }

    pub fn url(&self) -> String {
        format!("ws://{}/v1/stream", self.address)
    }
}

impl Drop for HostileServer {
    fn drop(&mut self) {
        self.stopped.store(true, Ordering::Relaxed);
        // Wakes the accepting thread.
        drop(TcpStream::connect(self.address));
        if let Some(thread) = self.thread.take() {
            thread.join().expect("the accepting thread ends without a panic");
        }
    }
}

/// Shakes hands.
pub fn websocket(stream: TcpStream) -> Option<WebSocket<TcpStream>> {
    #[expect(clippy::result_large_err, reason = "the library fixes the type of this callback")]
    let subprotocol = |_: &Request, mut response: Response| -> Result<Response, ErrorResponse> {
        response.headers_mut().insert("sec-websocket-protocol", SUBPROTOCOL.parse().expect("a value"));
        Ok(response)
    };
    accept_hdr(stream, subprotocol).ok()
}

/// The world that all of them serve.
pub fn land() -> Land {
    Land::new(1)
}

/// Bytes that a server sends in place of a chunk; none refuses it.
pub type Answers = dyn Fn(ChunkKey) -> Option<Bytes> + Send + Sync;

/// Follows the protocol with other answers.
pub fn serve(stream: TcpStream, answers: &Answers) {
    if let Some(socket) = websocket(stream) {
        serve_on(socket, answers);
    }
}

/// [`serve`] after the handshake of WebSocket.
pub fn serve_on(mut socket: WebSocket<TcpStream>, answers: &Answers) {
    let land = land();
    let offer = ServerOffer { land, digest: land.digest(), token: None, software: "hostile".into() };
    let mut session = ServerSession::new(offer, 1);
    loop {
        while let Some(selection) = session.take_view() {
            session.apply_view(selection);
        }
        let next = session.next_chunk();
        if let Some((request, _)) = next {
            match answers(request.key) {
                Some(frame) => session.deliver(request, frame),
                None => session.fail(request, RefusalReason::Overloaded, "later\n"),
            }
        }
        while let Some(frame) = session.poll_transmit() {
            if socket.send(Message::Binary(frame)).is_err() {
                return;
            }
        }
        if next.is_some() {
            continue;
        }
        match socket.read() {
            Ok(Message::Binary(bytes)) => {
                if session.receive(DataFrame::Binary(&bytes)).is_err() {
                    // The last message says why.
                    while let Some(frame) = session.poll_transmit() {
                        let _ = socket.send(Message::Binary(frame));
                    }
                    return;
                }
            }
            Ok(Message::Ping(_) | Message::Pong(_)) => {}
            _ => return,
        }
    }
}

/// The correct frame of a chunk.
pub fn correct(key: ChunkKey) -> Bytes {
    frame_of(&land().chunk(key))
}

/// The frame of a chunk, with a digest that fits.
pub fn frame_of(chunk: &Chunk) -> Bytes {
    chunk_codec::encode_for(Delivery::Exact, chunk, &land().digest())
}

/// A correct frame with another payload, and length and digest that fit.
pub fn with_payload(frame: &[u8], payload: &[u8]) -> Bytes {
    const DIGEST_AT: usize = protocol::limits::CHUNK_HEADER - chunk_codec::DIGEST;
    let mut header = frame[..DIGEST_AT].to_vec();
    header[40..44].copy_from_slice(&(payload.len() as u32).to_le_bytes());
    let mut digest = blake3::Hasher::new();
    digest.update(&land().digest().0).update(&header).update(payload);
    header.extend_from_slice(&digest.finalize().as_bytes()[..chunk_codec::DIGEST]);
    [header, payload.to_vec()].concat().into()
}

/// Sends a message.
pub fn send(socket: &mut WebSocket<TcpStream>, message: &ServerMessage) -> bool {
    let frame = control::encode(message).expect("within the limits");
    socket.send(Message::Binary(frame)).is_ok()
}

/// A correct Welcome.
pub fn welcome() -> Welcome {
    Welcome {
        session: 1,
        world_seed: 1,
        generator_version: GENERATOR_VERSION,
        digest: land().digest().0,
        max_credits: 4096,
        max_view_distance_m: 65_536,
        software: "hostile".into(),
    }
}

/// Reads until the connection ends, and answers pings.
pub fn listen(socket: &mut WebSocket<TcpStream>) {
    while socket.read().is_ok() {}
}

/// Reads bytes until the connection ends.
pub fn swallow(mut stream: TcpStream) {
    let mut bytes = [0; 4096];
    while stream.read(&mut bytes).is_ok_and(|count| count > 0) {}
}

/// Reads the request of a handshake, writes an answer, and repeats its last part without end if
/// there is one.
pub fn answer_http(mut stream: TcpStream, answer: &str, without_end: &str) {
    let mut request = [0; 4096];
    if stream.read(&mut request).is_err() || stream.write_all(answer.as_bytes()).is_err() {
        return;
    }
    while !without_end.is_empty() && stream.write_all(without_end.as_bytes()).is_ok() {}
    swallow(stream);
}

/// Sends raw bytes, of which some may be a part of a frame, and ends the connection.
pub fn send_raw(socket: &WebSocket<TcpStream>, bytes: &[u8]) {
    let _ = socket.get_ref().write_all(bytes);
}

/// Answers that are wrong for the first so many chunks, over all connections.
pub fn wrong_at_first(
    count: usize,
    wrong: impl Fn(ChunkKey) -> Option<Bytes> + Send + Sync + 'static,
) -> Behaviour {
    let sent = AtomicUsize::new(0);
    let answers = move |key| {
        if sent.fetch_add(1, Ordering::Relaxed) < count { wrong(key) } else { Some(correct(key)) }
    };
    Arc::new(move |stream, _| serve(stream, &answers))
}

/// Answers that are always wrong.
pub fn always_wrong(wrong: impl Fn(ChunkKey) -> Option<Bytes> + Send + Sync + 'static) -> Behaviour {
    Arc::new(move |stream, _| serve(stream, &wrong))
}

/// A digest that no world has.
pub const NO_WORLD: WorldDigest = WorldDigest([9; 32]);
