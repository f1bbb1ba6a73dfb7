//! A client connection with as little work per chunk as possible.
//!
//! The clients of the load test decode and verify every chunk and would be slower than the server.
//! Here frames are compared byte for byte where a benchmark knows what must come.

use anyhow::{Context, Result, bail};
use protocol::limits::MAX_CREDITS;
use protocol::message::{ClientMessage, Hello, ServerMessage, WireKey};
use protocol::{Delivery, SUBPROTOCOL, chunk_codec, control};
use std::cell::RefCell;
use std::io::ErrorKind;
use std::net::SocketAddr;
use terrain::ChunkKey;
use tokio::net::TcpStream;

/// Bytes read at once.
const READ_BUFFER: usize = 256 * 1024;

thread_local! {
    static SCRATCH: RefCell<Vec<u8>> = RefCell::new(vec![0; READ_BUFFER]);
}

/// What the server sent.
#[derive(Debug)]
pub enum Received<'a> {
    /// A chunk frame.
    Chunk(&'a [u8]),
    /// A control message.
    Message(ServerMessage),
}

/// A session over a bare socket.
#[derive(Debug)]
pub struct Connection {
    stream: TcpStream,
    /// The incomplete frame at the end of the bytes read so far.
    rest: Vec<u8>,
    /// Chunks that the server may still send.
    credits: u32,
    next_request: u32,
}

impl Connection {
    /// Connects, sends Hello and the maximal credit, and waits for the Welcome.
    ///
    /// # Errors
    /// The server cannot be reached or does not admit.
    pub async fn connect(address: SocketAddr) -> Result<Self> {
        let stream =
            TcpStream::connect(address).await.with_context(|| format!("cannot connect to {address}"))?;
        stream.set_nodelay(true)?;
        let mut connection = Self { stream, rest: Vec::new(), credits: MAX_CREDITS, next_request: 0 };
        let request = format!(
            "GET /v1/stream HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
             Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n"
        );
        connection.write(request.as_bytes()).await?;
        let head = loop {
            connection.read().await?;
            if let Some(end) = connection.rest.windows(4).position(|four| four == b"\r\n\r\n") {
                break connection.rest.drain(..end + 4).collect::<Vec<_>>();
            }
        };
        if !head.starts_with(b"HTTP/1.1 101 ") {
            bail!(
                "expected an upgrade from the server, got {}",
                String::from_utf8_lossy(&head).lines().next().unwrap_or_default()
            );
        }
        let hello =
            Hello { digest: None, delivery: Delivery::Exact, token: None, software: crate::SOFTWARE.into() };
        let mut bytes = Vec::new();
        push(&mut bytes, &ClientMessage::Hello(hello))?;
        push(&mut bytes, &ClientMessage::Credit { chunks: MAX_CREDITS })?;
        connection.write(&bytes).await?;
        let mut welcomed = false;
        while !welcomed {
            connection
                .receive(|received| {
                    welcomed |= matches!(received, Received::Message(ServerMessage::Welcome(_)));
                })
                .await?;
        }
        Ok(connection)
    }

    /// Requests chunks, one request for each key. Sends more credit when little is left.
    ///
    /// # Errors
    /// The connection broke.
    pub async fn request(&mut self, keys: impl IntoIterator<Item = ChunkKey>) -> Result<()> {
        let mut bytes = Vec::new();
        for key in keys {
            push_request(&mut bytes, self.next_request, vec![key.into()])?;
            self.next_request = self.next_request.wrapping_add(1);
        }
        self.refill(&mut bytes)?;
        self.write(&bytes).await
    }

    /// Requests different chunks in one message.
    ///
    /// # Errors
    /// The connection broke, or there are more than 512 keys.
    pub async fn request_together(&mut self, keys: impl IntoIterator<Item = ChunkKey>) -> Result<()> {
        let mut bytes = Vec::new();
        push_request(&mut bytes, self.next_request, keys.into_iter().map(WireKey::from).collect())?;
        self.next_request = self.next_request.wrapping_add(1);
        self.refill(&mut bytes)?;
        self.write(&bytes).await
    }

    fn refill(&mut self, bytes: &mut Vec<u8>) -> Result<()> {
        if self.credits < MAX_CREDITS / 2 {
            push(bytes, &ClientMessage::Credit { chunks: MAX_CREDITS - self.credits })?;
            self.credits = MAX_CREDITS;
        }
        Ok(())
    }

    /// Waits for bytes and passes on every complete message among them.
    ///
    /// # Errors
    /// The connection ended, or the bytes are no frame of this protocol.
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

    async fn read(&mut self) -> Result<()> {
        loop {
            self.stream.readable().await?;
            let read = SCRATCH.with_borrow_mut(|scratch| {
                let count = self.stream.try_read(scratch)?;
                self.rest.extend_from_slice(&scratch[..count]);
                Ok(count)
            });
            match read {
                Ok(0) => bail!("the server ended the connection"),
                Ok(_) => return Ok(()),
                Err(error) if ErrorKind::WouldBlock == std::io::Error::kind(&error) => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Sends one message.
    ///
    /// # Errors
    /// The connection broke, or the message exceeds the protocol's limits.
    pub async fn send(&mut self, message: &ClientMessage) -> Result<()> {
        let mut bytes = Vec::new();
        push(&mut bytes, message)?;
        self.write(&bytes).await
    }

    /// Sends messages and drops everything that arrives in between, so that neither end blocks.
    ///
    /// # Errors
    /// As [`Connection::send`].
    pub async fn send_while_reading(&mut self, messages: &[ClientMessage]) -> Result<()> {
        let mut bytes = Vec::new();
        for message in messages {
            push(&mut bytes, message)?;
        }
        let mut written = 0;
        while written < bytes.len() {
            let ready =
                self.stream.ready(tokio::io::Interest::READABLE | tokio::io::Interest::WRITABLE).await?;
            if ready.is_readable() {
                let read = SCRATCH.with_borrow_mut(|scratch| self.stream.try_read(scratch));
                match read {
                    Ok(0) => bail!("the server ended the connection"),
                    Err(error) if error.kind() != ErrorKind::WouldBlock => return Err(error.into()),
                    _ => {}
                }
            }
            if ready.is_writable() {
                match self.stream.try_write(&bytes[written..]) {
                    Ok(count) => written += count,
                    Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                    Err(error) => return Err(error.into()),
                }
            }
        }
        Ok(())
    }

    async fn write(&mut self, bytes: &[u8]) -> Result<()> {
        write_all(&self.stream, bytes).await
    }
}

async fn write_all(stream: &TcpStream, mut bytes: &[u8]) -> Result<()> {
    while !bytes.is_empty() {
        stream.writable().await?;
        match stream.try_write(bytes) {
            Ok(count) => bytes = &bytes[count..],
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// Opcode, begin and end of the first frame's payload; none if the frame is incomplete.
fn next_frame(bytes: &[u8]) -> Result<Option<(u8, usize, usize)>> {
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

/// Appends a message as a frame. The mask is zero: masks protect proxies, not servers.
fn push(bytes: &mut Vec<u8>, message: &ClientMessage) -> Result<()> {
    push_frame(bytes, &control::encode(message)?);
    Ok(())
}

fn push_frame(bytes: &mut Vec<u8>, payload: &[u8]) {
    bytes.push(0x82);
    match u8::try_from(payload.len()) {
        Ok(short @ ..126) => bytes.push(0x80 | short),
        _ => {
            bytes.push(0x80 | 126);
            bytes.extend_from_slice(&(payload.len() as u16).to_be_bytes());
        }
    }
    bytes.extend_from_slice(&[0; 4]);
    bytes.extend_from_slice(payload);
}

fn push_request(bytes: &mut Vec<u8>, id: u32, keys: Vec<WireKey>) -> Result<()> {
    push(bytes, &ClientMessage::Request { id, keys })
}

/// The body of a GET, for metrics.
///
/// # Errors
/// The server does not answer.
pub async fn get(address: SocketAddr, path: &str) -> Result<String> {
    let stream = TcpStream::connect(address).await.with_context(|| format!("cannot connect to {address}"))?;
    let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    write_all(&stream, request.as_bytes()).await?;
    let mut all = Vec::new();
    loop {
        stream.readable().await?;
        let mut buffer = [0; 16 * 1024];
        match stream.try_read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => all.extend_from_slice(&buffer[..count]),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(error.into()),
        }
    }
    let text = String::from_utf8(all).context("the answer is no text")?;
    let (_, body) = text.split_once("\r\n\r\n").context("the answer has no body")?;
    Ok(body.to_owned())
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
        let mut bytes = Vec::new();
        let key = ChunkKey::new(3, -5, 7).unwrap();
        push_request(&mut bytes, 9, vec![key.into()]).unwrap();
        let length = usize::from(bytes[1] & 0x7f);
        assert_eq!(bytes.len(), 6 + length);
        let expected = ClientMessage::Request { id: 9, keys: vec![key.into()] };
        assert_eq!(control::decode(&bytes[6..]), Ok(expected));
    }
}
