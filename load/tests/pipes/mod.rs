//! A server behind pipes in memory, on a paused clock that advances only when all tasks wait, so
//! results do not depend on the machine. It answers each request after a fixed time, except during
//! a stall.

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use http_body_util::Full;
use hyper::header::{ETAG, IF_NONE_MATCH, RETRY_AFTER};
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use load::dial::Dial;
use protocol::chunk_codec::{self, seed_only};
use protocol::message::RefusalReason;
use protocol::server::{ServerOffer, ServerSession};
use protocol::{DataFrame, Delivery, SUBPROTOCOL};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use terrain::constants::GENERATOR_VERSION;
use terrain::{ChunkKey, Land};
use test_support::{ChunkFault, chunk_fault};
use tokio::io::{AsyncWriteExt, DuplexStream, duplex};
use tokio::time::{Instant, sleep, sleep_until};
use tokio_tungstenite::accept_hdr_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Response as Upgrade};

/// Time of an answer.
pub const SERVICE: Duration = Duration::from_millis(20);

/// Capacity of a pipe, bytes.
const PIPE: usize = 64 * 1024;

/// Protocol over a pipe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    WebSocket,
    Http,
}

/// The fault of a server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fault {
    #[default]
    Nothing,
    /// Every chunk is wrong.
    Chunk(ChunkFault),
    /// An ETag that is not the digest.
    Tag,
    /// 304 to a request without condition.
    Unchanged,
    /// The announced digest is that of another seed.
    World,
    /// Every request is refused.
    Refusal,
    /// The connection ends after a few answers.
    HangUp,
    /// As [`Fault::HangUp`], and later connections find the server of another seed.
    OtherWorld,
    /// No connection is accepted.
    Absent,
    /// No connection is accepted in the first seconds.
    Late,
    /// No connection but the first is accepted.
    Full,
}

/// Time without accepted connections under [`Fault::Late`].
const LATE: Duration = Duration::from_secs(5);

/// See the module. Connections are independent.
#[derive(Clone, Debug)]
pub struct Server {
    pub transport: Transport,
    pub fault: Fault,
    /// No answers during this time.
    pub stall: Range<Instant>,
    pub land: Land,
    /// Requests that were answered or refused, over all connections.
    pub requests: Arc<AtomicU64>,
    /// Connections so far.
    pub connections: Arc<AtomicU64>,
    pub started: Instant,
}

impl Server {
    pub fn new(transport: Transport) -> Self {
        let never = Instant::now();
        Self {
            transport,
            fault: Fault::Nothing,
            stall: never..never,
            land: Land::new(1),
            requests: Arc::default(),
            connections: Arc::default(),
            started: never,
        }
    }

    async fn take_time(&self) {
        sleep(SERVICE).await;
        if self.stall.contains(&Instant::now()) {
            sleep_until(self.stall.end).await;
        }
    }

    fn digest(&self) -> terrain::WorldDigest {
        if self.fault == Fault::World { Land::new(2).digest() } else { self.land.digest() }
    }

    /// Correct frames are generated once for all runs of a test.
    fn frame(&self, key: ChunkKey) -> Bytes {
        static FRAMES: Mutex<BTreeMap<ChunkKey, Bytes>> = Mutex::new(BTreeMap::new());
        if self.fault == Fault::Nothing {
            let mut frames = FRAMES.lock().expect("no panic while locked");
            return frames.entry(key).or_insert_with(|| self.generate(key)).clone();
        }
        self.generate(key)
    }

    fn generate(&self, key: ChunkKey) -> Bytes {
        let fault = match self.fault {
            Fault::Chunk(fault) => Some(fault),
            _ => None,
        };
        chunk_fault::frame(fault, &self.land, key, Delivery::Exact)
    }

    async fn serve(self, stream: DuplexStream) {
        match self.transport {
            Transport::WebSocket => self.serve_websocket(stream).await,
            Transport::Http => {
                let answer = service_fn(|request| self.answer(request));
                // Clients disconnect at the end of a run.
                let _ = hyper::server::conn::http1::Builder::new()
                    .serve_connection(TokioIo::new(stream), answer)
                    .await;
            }
        }
    }

    async fn answer<B>(&self, request: Request<B>) -> Result<Response<Full<Bytes>>, Infallible> {
        let path = request.uri().path();
        let answer = if path == "/v1/world" {
            let (digest, version) = (self.digest(), GENERATOR_VERSION);
            let world =
                format!(r#"{{"world_seed":1,"generator_version":{version},"digest":"{digest}","more":0}}"#);
            Response::new(Full::new(world.into()))
        } else {
            self.take_time().await;
            let numbers: Vec<i32> = path.split('/').filter_map(|part| part.parse().ok()).collect();
            let [level, x, z] = numbers[..] else { panic!("{path} names no chunk") };
            let frame = self.frame(ChunkKey::new(level as u8, x, z).expect("a key"));
            // A frame with a fault has no content; the client finds the fault before the ETag.
            let chunk = chunk_codec::decode(&frame, &self.land.digest()).ok();
            let digest = chunk
                .filter(|_| self.fault != Fault::Tag)
                .map_or([0; 16], |chunk| seed_only::digest(&chunk, &self.land.digest()));
            let tag = digest.iter().fold(String::from("\""), |text, byte| format!("{text}{byte:02x}")) + "\"";
            let is_known = request.headers().get(IF_NONE_MATCH).is_some_and(|known| known == tag.as_str());
            let answer = Response::builder().header(ETAG, tag);
            let built = match self.fault {
                Fault::Refusal => answer
                    .status(StatusCode::SERVICE_UNAVAILABLE)
                    .header(RETRY_AFTER, "1")
                    .body(Full::new("try later".into())),
                Fault::Unchanged => answer.status(StatusCode::NOT_MODIFIED).body(Full::default()),
                _ if is_known => answer.status(StatusCode::NOT_MODIFIED).body(Full::default()),
                _ => answer.body(Full::new(frame)),
            };
            built.expect("an answer")
        };
        Ok(answer)
    }

    async fn serve_websocket(&self, stream: DuplexStream) {
        #[expect(clippy::result_large_err, reason = "the library fixes the type of this callback")]
        let upgrade = |_: &_, mut response: Upgrade| -> Result<Upgrade, ErrorResponse> {
            response.headers_mut().insert("sec-websocket-protocol", SUBPROTOCOL.parse().expect("a value"));
            Ok(response)
        };
        let Ok(mut socket) = accept_hdr_async(stream, upgrade).await else { return };
        let offer = ServerOffer {
            land: self.land,
            digest: self.digest(),
            token: None,
            software: "test server".into(),
        };
        let mut session = ServerSession::new(offer, 1);
        let mut answered = 0;
        loop {
            // Without workers the server selects the chunks of a view here.
            while let Some(mut selection) = session.take_view() {
                selection.step(&self.land, usize::MAX);
                session.apply_view(selection);
            }
            let next = session.next_chunk();
            while let Some(frame) = session.poll_transmit() {
                if socket.send(Message::Binary(frame)).await.is_err() {
                    return;
                }
            }
            if let Some((wanted, _)) = next {
                answered += 1;
                self.requests.fetch_add(1, Ordering::Relaxed);
                if self.fault == Fault::Refusal {
                    // Refused at once: only the client can slow down.
                    session.fail(wanted, RefusalReason::Overloaded, "try later");
                    continue;
                }
                if matches!(self.fault, Fault::HangUp | Fault::OtherWorld) && answered > 5 {
                    let _ = socket.into_inner().shutdown().await;
                    return;
                }
                self.take_time().await;
                session.deliver(wanted, self.frame(wanted.key));
                continue;
            }
            let Some(Ok(message)) = socket.next().await else { return };
            match message {
                Message::Binary(bytes) if session.receive(DataFrame::Binary(&bytes)).is_ok() => {}
                Message::Binary(_) | Message::Close(_) => return,
                _ => {}
            }
        }
    }
}

impl Dial for Server {
    type Stream = DuplexStream;

    async fn dial(&self, receive_buffer: Option<u32>) -> io::Result<DuplexStream> {
        let holds = receive_buffer.map_or(PIPE, |bytes| bytes as usize);
        let is_late = self.fault == Fault::Late && self.started.elapsed() < LATE;
        if self.fault == Fault::Absent || is_late {
            return Err(io::ErrorKind::ConnectionRefused.into());
        }
        let is_first = self.connections.fetch_add(1, Ordering::Relaxed) == 0;
        if self.fault == Fault::Full && !is_first {
            return Err(io::ErrorKind::ConnectionRefused.into());
        }
        let (ours, theirs) = duplex(holds);
        let mut server = self.clone();
        if matches!(self.fault, Fault::Late | Fault::Full) {
            server.fault = Fault::Nothing;
        }
        if self.fault == Fault::OtherWorld && !is_first {
            (server.land, server.fault) = (Land::new(2), Fault::Nothing);
        }
        tokio::spawn(server.serve(theirs));
        Ok(ours)
    }
}
