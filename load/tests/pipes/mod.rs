//! A server at the other end of pipes in memory, on a clock that only moves when everybody waits:
//! what a test sees does not depend on the machine. It answers each request after a fixed time,
//! except while it stalls.

use bytes::Bytes;
use futures_util::{SinkExt, StreamExt};
use http_body_util::Full;
use hyper::header::{ETAG, IF_NONE_MATCH, RETRY_AFTER};
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use load::dial::Dial;
use protocol::server::{ServerOffer, ServerSession};
use protocol::{Delivery, Incoming, SUBPROTOCOL, chunk_codec};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;
use std::ops::Range;
use std::sync::Mutex;
use std::time::Duration;
use terrain::constants::GENERATOR_VERSION;
use terrain::{ChunkKey, Land};
use tokio::io::{AsyncWriteExt, DuplexStream, duplex};
use tokio::time::{Instant, sleep, sleep_until};
use tokio_tungstenite::accept_hdr_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Response as Upgrade};

/// Time that an answer takes.
pub const SERVICE: Duration = Duration::from_millis(20);

/// What a pipe holds, bytes.
const PIPE: usize = 64 * 1024;

/// What is spoken over a pipe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Speaks {
    WebSocket,
    Http,
}

/// What is wrong with a server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lie {
    #[default]
    Nothing,
    /// One height is off by a unit, with everything else made to fit.
    Height,
    /// A bit of the frame is flipped.
    Bit,
    /// A chunk of another place, honest in itself.
    Place,
    /// A tag that is not the digest.
    Tag,
    /// Nothing changed, says an answer to somebody who has nothing.
    Unchanged,
    /// The announced digest is that of another seed.
    World,
    /// Every request is refused.
    Refusal,
    /// The connection ends after a few answers.
    HangUp,
}

/// See the module. Each connection is served by itself.
#[derive(Clone, Debug)]
pub struct Server {
    pub speaks: Speaks,
    pub lie: Lie,
    /// Nothing is answered from the first of these until the second.
    pub stall: Range<Instant>,
    pub land: Land,
}

impl Server {
    pub fn new(speaks: Speaks) -> Self {
        let never = Instant::now();
        Self { speaks, lie: Lie::Nothing, stall: never..never, land: Land::new(1) }
    }

    async fn take_time(&self) {
        sleep(SERVICE).await;
        if self.stall.contains(&Instant::now()) {
            sleep_until(self.stall.end).await;
        }
    }

    fn digest(&self) -> terrain::WorldDigest {
        if self.lie == Lie::World { Land::new(2).digest() } else { self.land.digest() }
    }

    /// Honest frames are made once for all runs of a test.
    fn frame(&self, key: ChunkKey) -> Bytes {
        static MADE: Mutex<BTreeMap<ChunkKey, Bytes>> = Mutex::new(BTreeMap::new());
        if self.lie == Lie::Nothing {
            let mut made = MADE.lock().expect("nobody panics with it");
            return made.entry(key).or_insert_with(|| self.make(key)).clone();
        }
        self.make(key)
    }

    fn make(&self, key: ChunkKey) -> Bytes {
        let key = match self.lie {
            Lie::Place => ChunkKey::new(0, -30_000, key.x()).expect("exists"),
            _ => key,
        };
        let mut chunk = self.land.chunk(key);
        if self.lie == Lie::Height {
            chunk.heights[2000] += 1;
            chunk = terrain::Chunk::from_parts(chunk.key, chunk.heights, chunk.error, chunk.grass);
        }
        let mut frame = chunk_codec::encode_for(Delivery::Exact, &chunk, &self.land.digest()).to_vec();
        if self.lie == Lie::Bit {
            frame[30] ^= 1;
        }
        frame.into()
    }

    async fn serve(self, stream: DuplexStream) {
        match self.speaks {
            Speaks::WebSocket => self.serve_websocket(stream).await,
            Speaks::Http => {
                let answer = service_fn(|request| self.answer(request));
                // A client that hangs up at the end of a run is no fault.
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
            let digest = chunk_codec::digest(&frame).expect("a frame");
            let digest = if self.lie == Lie::Tag { [0; 16] } else { digest };
            let tag = digest.iter().fold(String::from("\""), |text, byte| format!("{text}{byte:02x}")) + "\"";
            let is_known = request.headers().get(IF_NONE_MATCH).is_some_and(|known| known == tag.as_str());
            let answer = Response::builder().header(ETAG, tag);
            let built = match self.lie {
                Lie::Refusal => answer
                    .status(StatusCode::SERVICE_UNAVAILABLE)
                    .header(RETRY_AFTER, "1")
                    .body(Full::new("try later".into())),
                Lie::Unchanged => answer.status(StatusCode::NOT_MODIFIED).body(Full::default()),
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
            while let Some(frame) = session.poll_transmit() {
                if socket.send(Message::Binary(frame)).await.is_err() {
                    return;
                }
            }
            if let Some((wanted, _)) = session.next_chunk() {
                answered += 1;
                if self.lie == Lie::HangUp && answered > 5 {
                    let _ = socket.into_inner().shutdown().await;
                    return;
                }
                self.take_time().await;
                session.deliver(wanted, self.frame(wanted.key));
                continue;
            }
            let Some(Ok(message)) = socket.next().await else { return };
            match message {
                Message::Binary(bytes) if session.receive(Incoming::Binary(&bytes)).is_ok() => {}
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
        let (ours, theirs) = duplex(holds);
        tokio::spawn(self.clone().serve(theirs));
        Ok(ours)
    }
}
