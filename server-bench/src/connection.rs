//! A client connection with as little work per chunk as possible.
//!
//! The clients of the load test decode and verify every chunk and would be slower than the server.
//! Here frames are compared byte for byte where a benchmark knows what must come.

use anyhow::{Context, Result, bail, ensure};
use protocol::limits::MAX_CREDITS;
use protocol::message::{ClientMessage, Hello, ServerMessage, WireKey};
use protocol::{Delivery, SUBPROTOCOL, chunk_codec, control};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use terrain::ChunkKey;
use tls_client::Transport;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio_util::either::Either;

/// Name and version, sent to the server in the Hello message.
const SOFTWARE: &str = concat!("tombolo-server-bench ", env!("CARGO_PKG_VERSION"));

/// Bytes read at once.
const READ_BUFFER: usize = 256 * 1024;

/// A chunk or a message from the server.
#[derive(Debug)]
pub enum Received<'a> {
    /// A chunk frame.
    Chunk(&'a [u8]),
    /// A control message.
    Message(ServerMessage),
}

impl Received<'_> {
    /// The key of a chunk frame.
    pub fn key(&self) -> Option<ChunkKey> {
        let Self::Chunk(frame) = self else { return None };
        chunk_codec::kind_and_key(frame).ok().map(|(_, key)| key)
    }

    /// The key of the request that it answers, by a chunk or by a refusal.
    pub fn answers(&self) -> Option<ChunkKey> {
        match self {
            Self::Message(ServerMessage::Refused(refused)) => refused.key.and_then(|key| key.check().ok()),
            _ => self.key(),
        }
    }
}

/// A session over a bare socket or TLS.
#[derive(Debug)]
pub struct Connection {
    stream: Transport,
    /// The incomplete frame at the end of the bytes read so far.
    rest: Vec<u8>,
    /// Chunks that the server may still send.
    credits: u32,
    next_request: u32,
}

impl Connection {
    /// Connects, sends Hello and the maximal credit, and waits for the Welcome.
    pub async fn connect(address: SocketAddr) -> Result<Self> {
        Self::over(Either::Left(open(address).await?), address).await
    }

    /// As [`Connection::connect`], from an address of this machine.
    pub async fn connect_from(source: IpAddr, address: SocketAddr) -> Result<Self> {
        Self::over(Either::Left(open_from(source, address, None).await?), address).await
    }

    /// As [`Connection::connect`], over an open stream.
    pub async fn over(mut stream: Transport, address: SocketAddr) -> Result<Self> {
        stream.write_all(upgrade(address).as_bytes()).await?;
        let mut connection = Self { stream, rest: Vec::new(), credits: MAX_CREDITS, next_request: 0 };
        let head = loop {
            connection.read().await?;
            if let Some(end) = connection.rest.windows(4).position(|four| four == b"\r\n\r\n") {
                break connection.rest.drain(..end + 4).collect::<Vec<_>>();
            }
        };
        if !head.starts_with(b"HTTP/1.1 101 ") {
            let head = String::from_utf8_lossy(&head);
            bail!("expected an upgrade from the server, got {}", head.lines().next().unwrap_or_default());
        }
        connection.send(&[hello(), ClientMessage::Credit { chunks: MAX_CREDITS }]).await?;
        let mut welcomed = false;
        while !welcomed {
            let note = |received: Received<'_>| {
                welcomed |= matches!(received, Received::Message(ServerMessage::Welcome(_)));
            };
            connection.receive(note).await?;
        }
        Ok(connection)
    }

    /// Requests chunks: all in one message, at most 512, or one message for each. Sends more credit
    /// when little is left.
    pub async fn request(
        &mut self,
        keys: impl IntoIterator<Item = ChunkKey>,
        are_together: bool,
    ) -> Result<()> {
        let keys: Vec<WireKey> = keys.into_iter().map(WireKey::from).collect();
        let size = if are_together { keys.len() } else { 1 };
        let mut messages = Vec::new();
        for keys in keys.chunks(size.max(1)) {
            messages.push(ClientMessage::Request { id: self.next_request, keys: keys.to_vec() });
            self.next_request = self.next_request.wrapping_add(1);
        }
        if self.credits < MAX_CREDITS / 2 {
            messages.push(ClientMessage::Credit { chunks: MAX_CREDITS - self.credits });
            self.credits = MAX_CREDITS;
        }
        self.send(&messages).await
    }

    /// Waits for bytes and passes on every complete message among them. Can be cancelled.
    pub async fn receive(&mut self, mut take: impl FnMut(Received<'_>)) -> Result<()> {
        self.read().await?;
        let mut used = 0;
        while let Some((opcode, start, end)) = next_frame(&self.rest[used..])? {
            let payload = &self.rest[used + start..used + end];
            used += end;
            match opcode {
                2 if payload.starts_with(&chunk_codec::MAGIC) => {
                    self.credits = self.credits.saturating_sub(1);
                    take(Received::Chunk(payload));
                }
                2 => take(Received::Message(control::decode(payload).context("a control frame")?)),
                8 => bail!(
                    "the server closed: {}",
                    String::from_utf8_lossy(payload.get(2..).unwrap_or_default())
                ),
                _ => {}
            }
        }
        self.rest.drain(..used);
        Ok(())
    }

    /// The stream below, for clients that do not go on with the protocol.
    pub fn into_stream(self) -> Transport {
        self.stream
    }

    async fn read(&mut self) -> Result<()> {
        // Pages of the buffer that nothing is read into take no memory.
        self.rest.reserve(READ_BUFFER);
        match self.stream.read_buf(&mut self.rest).await? {
            0 => bail!("the server ended the connection"),
            _ => Ok(()),
        }
    }

    /// Sends messages.
    pub async fn send(&mut self, messages: &[ClientMessage]) -> Result<()> {
        Ok(self.stream.write_all(&frames(messages)?).await?)
    }

    /// Sends messages and drops everything that arrives in between, so that neither end blocks.
    pub async fn send_while_reading(&mut self, messages: &[ClientMessage]) -> Result<()> {
        let bytes = frames(messages)?;
        let (mut reader, mut writer) = tokio::io::split(&mut self.stream);
        let mut dropped = vec![0; READ_BUFFER];
        let drop_all = async {
            while reader.read(&mut dropped).await? > 0 {}
            bail!("the server ended the connection")
        };
        tokio::select! {
            sent = writer.write_all(&bytes) => Ok(sent?),
            ended = drop_all => ended,
        }
    }
}

/// An open socket without Nagle's algorithm.
pub async fn open(address: SocketAddr) -> Result<TcpStream> {
    let stream = TcpStream::connect(address).await.with_context(|| format!("cannot connect to {address}"))?;
    stream.set_nodelay(true)?;
    Ok(stream)
}

/// As [`open`], from an address of this machine, with a receive buffer of `receive` bytes if given.
pub async fn open_from(source: IpAddr, address: SocketAddr, receive: Option<u32>) -> Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    receive.map_or(Ok(()), |bytes| socket.set_recv_buffer_size(bytes))?;
    socket.bind((source, 0).into()).with_context(|| format!("cannot bind {source}"))?;
    let stream = socket.connect(address).await;
    let stream = stream.with_context(|| format!("cannot connect from {source} to {address}"))?;
    stream.set_nodelay(true)?;
    Ok(stream)
}

/// Address number `index`, below 65,536, of the loopback network, so that clients of one machine
/// count as different ones. 127.0.0.1, that of [`Connection::connect`], is none of them.
pub fn loopback(index: usize) -> IpAddr {
    let [high, low] = (index as u16).to_be_bytes();
    Ipv4Addr::new(127, 1, high, low).into()
}

/// The request that opens a session.
pub fn upgrade(address: SocketAddr) -> String {
    format!(
        "GET /v1/stream HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n"
    )
}

/// The first message of a session.
pub fn hello() -> ClientMessage {
    ClientMessage::Hello(Hello {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: SOFTWARE.into(),
    })
}

/// Opcode, begin and end of the first frame's payload; none if the frame is incomplete.
pub fn next_frame(bytes: &[u8]) -> Result<Option<(u8, usize, usize)>> {
    let [first, second, rest @ ..] = bytes else { return Ok(None) };
    let (start, length) = match second {
        126 => match rest.first_chunk() {
            Some(length) => (4, usize::from(u16::from_be_bytes(*length))),
            None => return Ok(None),
        },
        127.. => bail!("the server sent a frame that is masked or longer than any of this protocol"),
        short => (2, usize::from(*short)),
    };
    let end = start + length;
    Ok((bytes.len() >= end).then_some((first & 15, start, end)))
}

/// Messages as frames. Masks are zero: they protect proxies, not servers.
pub fn frames(messages: &[ClientMessage]) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    for message in messages {
        let payload = control::encode(message)?;
        bytes.push(0x82);
        match u8::try_from(payload.len()) {
            Ok(short @ ..126) => bytes.push(0x80 | short),
            _ => {
                bytes.push(0x80 | 126);
                bytes.extend_from_slice(&(payload.len() as u16).to_be_bytes());
            }
        }
        bytes.extend_from_slice(&[0; 4]);
        bytes.extend_from_slice(&payload);
    }
    Ok(bytes)
}

/// The body of a GET as text, for metrics.
///
/// # Errors
/// The answer is not 200, or no text.
pub async fn get(address: SocketAddr, path: &str) -> Result<String> {
    String::from_utf8(get_bytes(address, path).await?).context("the answer is no text")
}

/// The body of a GET.
///
/// # Errors
/// The answer is not 200.
pub async fn get_bytes(address: SocketAddr, path: &str) -> Result<Vec<u8>> {
    let (is_ok, body) = answer(address, path).await?;
    ensure!(is_ok, "{path} was not answered with 200");
    Ok(body)
}

/// Whether a GET is answered with 200, and the body.
pub async fn answer(address: SocketAddr, path: &str) -> Result<(bool, Vec<u8>)> {
    let mut stream = open(address).await?;
    let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).await.context("the answer is incomplete")?;
    let end = answer.windows(4).position(|four| four == b"\r\n\r\n").context("the answer has no body")?;
    let is_ok = answer.starts_with(b"HTTP/1.1 200 ");
    Ok((is_ok, answer.split_off(end + 4)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incomplete_frames_are_waited_for() {
        let mut bytes = vec![0x82, 3, 1, 2, 3, 0x82, 126, 0, 200];
        bytes.extend([7; 200]);
        assert_eq!(next_frame(&bytes).unwrap(), Some((2, 2, 5)));
        assert_eq!(next_frame(&bytes[5..]).unwrap(), Some((2, 4, 204)));
        for cut in [0, 1, 2, 4] {
            assert_eq!(next_frame(&bytes[..cut]).unwrap(), None);
        }
        for cut in [6, 7, 8, 100] {
            assert_eq!(next_frame(&bytes[5..cut]).unwrap(), None);
        }
        assert!(next_frame(&[0x82, 127, 0]).is_err() && next_frame(&[0x82, 0x85, 0]).is_err());
    }

    #[test]
    fn requests_are_valid_protocol_frames() {
        let key = ChunkKey::new(3, -5, 7).unwrap();
        let request = ClientMessage::Request { id: 9, keys: vec![key.into()] };
        let bytes = frames(&[request.clone(), request.clone()]).unwrap();
        let length = 6 + usize::from(bytes[1] & 0x7f);
        assert_eq!(bytes.len(), 2 * length);
        assert_eq!(control::decode(&bytes[6..length]), Ok(request));
    }
}
