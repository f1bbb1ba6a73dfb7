//! The WebSocket under a session: opening, writing under a deadline, closing, and why it ended in
//! words.

use crate::client::{End, HANDSHAKE_TIMEOUT, Task};
use crate::dial::Dial;
use crate::throttle::Throttled;
use futures_util::{SinkExt, StreamExt};
use protocol::client::ClientSession;
use protocol::limits::MAX_SERVER_FRAME;
use protocol::{CloseCode, SUBPROTOCOL};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::protocol::frame::CloseFrame;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

/// Time that a server may take to accept what a client writes.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

/// Time for the answer to a good-bye.
const GOODBYE: Duration = Duration::from_secs(1);

/// Buffers of one connection, bytes. The library's 128 KiB each would be 50 MiB for 200 clients.
const BUFFER: usize = 16 * 1024;

/// What the system takes in for a slow reader, bytes: little, or its slowness would not be noticed
/// for a while.
const SLOW_RECEIVE_BUFFER: u32 = 4096;

/// A WebSocket over any stream.
pub type Socket<S> = WebSocketStream<Throttled<S>>;

/// Opens the WebSocket.
///
/// # Errors
/// Not admitted, and why.
pub async fn connect<D: Dial>(task: &Task<'_, D>) -> Result<Socket<D::Stream>, End> {
    let address = &task.config.connect;
    let request = ClientRequestBuilder::new(address.clone()).with_sub_protocol(SUBPROTOCOL);
    let limits = WebSocketConfig::default()
        .max_message_size(Some(MAX_SERVER_FRAME))
        .max_frame_size(Some(MAX_SERVER_FRAME))
        .read_buffer_size(BUFFER)
        .write_buffer_size(BUFFER);
    let opening = async {
        let stream = task.dial.dial(task.reads.map(|_| SLOW_RECEIVE_BUFFER)).await?;
        client_async_with_config(request, Throttled::new(stream, task.reads), Some(limits)).await
    };
    match timeout(HANDSHAKE_TIMEOUT, opening).await {
        Ok(Ok((socket, _))) => Ok(socket),
        Ok(Err(error)) => Err(End::not_admitted(format!("cannot connect to {address}: {}", explain(error)))),
        Err(_) => Err(End::not_admitted(format!("no answer from {address} within {HANDSHAKE_TIMEOUT:?}"))),
    }
}

/// Writes everything that the session has to say, in one flush.
///
/// # Errors
/// The connection broke or the server does not read, in words.
pub async fn transmit<S>(socket: &mut Socket<S>, machine: &mut ClientSession) -> Result<(), String>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let Some(first) = machine.poll_transmit() else { return Ok(()) };
    let write = async {
        let mut next = Some(first);
        while let Some(frame) = next {
            socket.feed(Message::Binary(frame)).await?;
            next = machine.poll_transmit();
        }
        socket.flush().await
    };
    match timeout(WRITE_TIMEOUT, write).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error)) => Err(format!("the connection broke: {}", explain(error))),
        Err(_) => Err(format!("the server read nothing for {WRITE_TIMEOUT:?}")),
    }
}

/// Says good-bye and gives the server a moment to answer.
pub(super) async fn close<S: AsyncRead + AsyncWrite + Unpin>(socket: &mut Socket<S>, code: CloseCode) {
    let frame = CloseFrame { code: code.code().into(), reason: "".into() };
    let goodbye = async {
        socket.close(Some(frame)).await?;
        while let Some(Ok(_)) = socket.next().await {}
        Ok::<_, Error>(())
    };
    // A server that does not answer a good-bye has lost nothing of this session.
    let _ = timeout(GOODBYE, goodbye).await;
}

/// Why a stream of frames ended.
pub(super) fn lost(last: Option<Result<Message, Error>>) -> String {
    match last {
        Some(Ok(Message::Close(Some(frame)))) => match CloseCode::from_code(frame.code.into()) {
            Some(code) if frame.reason.is_empty() => format!("the server closed: {code}"),
            // A close code says its number in its words.
            Some(code) if frame.reason.as_str() == code.to_string() => format!("the server closed: {code}"),
            _ => format!("the server closed: {} ({})", frame.reason, u16::from(frame.code)),
        },
        Some(Ok(_)) => "the server closed without a reason".into(),
        Some(Err(error)) => format!("the connection broke: {}", explain(error)),
        None => "the connection ended without a close frame".into(),
    }
}

/// A library error in one line; what an HTTP refusal says is in its body.
fn explain(error: Error) -> String {
    let Error::Http(response) = error else {
        return match error {
            Error::Io(error) => error.to_string(),
            other => other.to_string(),
        };
    };
    let body = response.body().as_deref().map(String::from_utf8_lossy).unwrap_or_default();
    let line: String = body.lines().next().unwrap_or_default().chars().take(200).collect();
    if line.is_empty() { response.status().to_string() } else { format!("{}: {line}", response.status()) }
}
