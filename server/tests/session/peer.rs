//! One end of a pipe whose other end is a session; frames of RFC 6455 by hand, so that nothing is
//! answered unless a test says so.

use protocol::control;
use protocol::message::{ClientMessage, Hello, ServerMessage};
use server::listener::Shared;
use server::purse::Purse;
use server::socket::{self, READ_LIMIT};
use server::websocket::WebSocket;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};

pub const BINARY: u8 = 2;
pub const CLOSE: u8 = 8;
pub const PING: u8 = 9;
pub const PONG: u8 = 10;

pub struct Peer {
    io: DuplexStream,
    shared: Arc<Shared>,
}

impl Peer {
    /// A session of a server, which has not said Hello.
    pub fn new(shared: &Arc<Shared>, purse: Purse) -> Self {
        let (io, theirs) = tokio::io::duplex(1 << 20);
        let serving = Arc::clone(shared);
        tokio::spawn(async move {
            socket::serve(WebSocket::new(theirs, &[], READ_LIMIT), &serving, 1, purse).await;
        });
        Self { io, shared: Arc::clone(shared) }
    }

    /// A session that is welcome.
    pub async fn welcome(shared: &Arc<Shared>, purse: Purse) -> Self {
        let mut peer = Self::new(shared, purse);
        peer.hello().await;
        peer
    }

    pub async fn hello(&mut self) {
        let hello = Hello {
            digest: Some(self.shared.offer.digest.0),
            delivery: protocol::Delivery::Exact,
            token: None,
            software: "test".into(),
        };
        self.say(&ClientMessage::Hello(hello)).await;
        let (opcode, welcome) = self.next().await.unwrap();
        assert_eq!(opcode, BINARY);
        assert!(matches!(control::decode(&welcome), Ok(ServerMessage::Welcome(_))));
    }

    pub async fn say(&mut self, message: &ClientMessage) {
        self.send(BINARY, &control::encode(message).unwrap()).await;
    }

    /// One frame, masked by zeros.
    pub async fn send(&mut self, opcode: u8, payload: &[u8]) {
        // The shortest form of a length is the only one: section 5.2.
        let length = match u8::try_from(payload.len()) {
            Ok(length @ 0..126) => vec![0x80 | length],
            _ => [&[0x80 | 126][..], &u16::try_from(payload.len()).unwrap().to_be_bytes()].concat(),
        };
        self.io.write_all(&[&[0x80 | opcode], &length[..], &[0; 4], payload].concat()).await.unwrap();
    }

    /// The next frame; none at the end of the connection, or when an hour has passed.
    pub async fn next(&mut self) -> Option<(u8, Vec<u8>)> {
        let read = async {
            let opcode = self.io.read_u8().await.ok()? & 15;
            let length = match self.io.read_u8().await.ok()? {
                126 => usize::from(self.io.read_u16().await.ok()?),
                127 => usize::try_from(self.io.read_u64().await.ok()?).ok()?,
                short => usize::from(short),
            };
            let mut payload = vec![0; length];
            self.io.read_exact(&mut payload).await.ok()?;
            Some((opcode, payload))
        };
        tokio::time::timeout(Duration::from_secs(3600), read).await.ok().flatten()
    }
}
