//! A client of a session over a pipe. It writes and reads frames of RFC 6455 directly, so that
//! nothing is answered automatically.

use protocol::control;
use protocol::message::{ClientMessage, Hello, ServerMessage};
use protocol::view::View;
use server::limits::rate_limit::TokenBucket;
use server::session::driver::{self, READ_LIMIT};
use server::state::ServerState;
use server::websocket::socket::WebSocket;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, DuplexStream};

pub const BINARY: u8 = 2;
pub const CLOSE: u8 = 8;
pub const PING: u8 = 9;
pub const PONG: u8 = 10;

/// The address of all peers.
pub const ADDRESS: IpAddr = IpAddr::V4(Ipv4Addr::new(192, 0, 2, 1));

/// A view of 1 km from the start of the coordinates.
pub fn view(id: u32) -> View {
    View { tolerance_q4: 16, ..test_support::view(id, 1000) }
}

/// The Hello of a client without a token.
pub fn hello(digest: [u8; 32]) -> ClientMessage {
    ClientMessage::Hello(Hello {
        digest: Some(digest),
        delivery: protocol::Delivery::Exact,
        token: None,
        software: "test".into(),
    })
}

/// One frame, masked by zeros.
pub fn frame(opcode: u8, payload: &[u8]) -> Vec<u8> {
    // Section 5.2 allows the shortest form only.
    let length = match u8::try_from(payload.len()) {
        Ok(length @ 0..126) => vec![0x80 | length],
        _ => [&[0x80 | 126][..], &u16::try_from(payload.len()).unwrap().to_be_bytes()].concat(),
    };
    [&[0x80 | opcode], &length[..], &[0; 4], payload].concat()
}

pub struct Peer {
    io: DuplexStream,
    state: Arc<ServerState>,
}

impl Peer {
    /// A session before its hello.
    pub fn new(state: &Arc<ServerState>, bucket: TokenBucket) -> Self {
        Self::over_pipe(state, bucket, 1 << 20)
    }

    /// As [`Peer::new`], over a pipe that holds so many bytes.
    pub fn over_pipe(state: &Arc<ServerState>, bucket: TokenBucket, bytes: usize) -> Self {
        let (io, theirs) = tokio::io::duplex(bytes);
        Self::over(state, bucket, io, theirs)
    }

    /// As [`Peer::new`], with the server's end of a connection and the other one.
    pub fn over(
        state: &Arc<ServerState>,
        bucket: TokenBucket,
        io: DuplexStream,
        theirs: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    ) -> Self {
        let server = Arc::clone(state);
        let number = state.next_session.fetch_add(1, Ordering::Relaxed);
        tokio::spawn(async move {
            let socket = WebSocket::new(theirs, &[], READ_LIMIT);
            let open = server.open_sessions.register(number, Some(ADDRESS));
            driver::serve(socket, &server, server.offer.clone(), open, bucket, None).await;
        });
        Self { io, state: Arc::clone(state) }
    }

    /// A session after its hello.
    pub async fn connect(state: &Arc<ServerState>, bucket: TokenBucket) -> Self {
        let mut peer = Self::new(state, bucket);
        peer.hello().await;
        peer
    }

    pub async fn hello(&mut self) {
        self.send_message(&hello(self.state.offer.digest.0)).await;
        let (opcode, welcome) = self.next().await.unwrap();
        assert_eq!(opcode, BINARY);
        assert!(matches!(control::decode(&welcome), Ok(ServerMessage::Welcome(_))));
    }

    pub async fn send_message(&mut self, message: &ClientMessage) {
        self.send(BINARY, &control::encode(message).unwrap()).await;
    }

    /// One frame, masked by zeros.
    pub async fn send(&mut self, opcode: u8, payload: &[u8]) {
        self.io.write_all(&frame(opcode, payload)).await.unwrap();
    }

    /// Bytes that need not be a frame.
    pub async fn write(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.io.write_all(bytes).await
    }

    /// The next frame; none at the end of the connection, or when an hour has passed.
    pub async fn next(&mut self) -> Option<(u8, Vec<u8>)> {
        self.next_within(Duration::from_secs(3600)).await
    }

    /// As [`Peer::next`], within a time. Frames of the server arrive whole.
    pub async fn next_within(&mut self, limit: Duration) -> Option<(u8, Vec<u8>)> {
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
        tokio::time::timeout(limit, read).await.ok().flatten()
    }
}
