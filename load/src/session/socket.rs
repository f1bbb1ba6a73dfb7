//! The WebSocket of a session: opening, writing with a timeout, closing, and error messages.

use crate::dial::Dial;
use crate::refusal::refusal;
use crate::task::{HANDSHAKE_TIMEOUT, SessionEnd, Task};
use crate::throttle::Throttled;
use futures_util::{SinkExt, StreamExt};
use protocol::client::ClientSession;
use protocol::limits::MAX_SERVER_FRAME;
use protocol::peer_text::one_line;
use protocol::{CloseCode, SUBPROTOCOL};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::protocol::frame::CloseFrame;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

/// Timeout of a write.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

/// Timeout of the closing handshake.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// Buffers of one connection, bytes. The library's 128 KiB each would be 50 MiB for 200 clients.
const BUFFER: usize = 16 * 1024;

/// Receive buffer of a slow client, bytes: small, so that the server notices the slow reader soon.
const SLOW_RECEIVE_BUFFER: u32 = 4096;

/// A WebSocket over any stream.
pub type Socket<S> = WebSocketStream<Throttled<S>>;

/// Opens the WebSocket.
///
/// # Errors
/// Not reached or not admitted, with the reason.
pub async fn connect<D: Dial>(task: &Task<'_, D>) -> Result<Socket<D::Stream>, SessionEnd> {
    let address = &task.config.connect;
    let request = ClientRequestBuilder::new(address.clone()).with_sub_protocol(SUBPROTOCOL);
    let limits = WebSocketConfig::default()
        .max_message_size(Some(MAX_SERVER_FRAME))
        .max_frame_size(Some(MAX_SERVER_FRAME))
        .read_buffer_size(BUFFER)
        .write_buffer_size(BUFFER);
    let opening = async {
        let stream = task.dial.dial(task.read_rate.map(|_| SLOW_RECEIVE_BUFFER)).await?;
        client_async_with_config(request, Throttled::new(stream, task.read_rate), Some(limits)).await
    };
    match timeout(HANDSHAKE_TIMEOUT, opening).await {
        Ok(Ok((socket, _))) => Ok(socket),
        Ok(Err(error)) => {
            // An HTTP response is one of a server, or of a proxy in front of it.
            let is_answer = matches!(error, Error::Http(_));
            let problem = format!("cannot connect to {address}: {}", explain(error));
            Err(if is_answer { SessionEnd::not_admitted(problem) } else { SessionEnd::Unreachable(problem) })
        }
        Err(_) => {
            Err(SessionEnd::Unreachable(format!("no answer from {address} within {HANDSHAKE_TIMEOUT:?}")))
        }
    }
}

/// Writes all pending frames of the session, with one flush.
///
/// # Errors
/// A message: the connection broke, or the server does not read.
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

/// Sends a close frame and waits for the server's, up to a timeout.
pub(super) async fn close<S: AsyncRead + AsyncWrite + Unpin>(socket: &mut Socket<S>, code: CloseCode) {
    let frame = CloseFrame { code: code.code().into(), reason: "".into() };
    let closing = async {
        socket.close(Some(frame)).await?;
        while let Some(Ok(_)) = socket.next().await {}
        Ok::<_, Error>(())
    };
    // A missing answer to the close frame loses no data.
    let _ = timeout(CLOSE_TIMEOUT, closing).await;
}

/// Message for the end of a stream of frames.
pub(super) fn lost(last: Option<Result<Message, Error>>) -> String {
    match last {
        Some(Ok(Message::Close(Some(frame)))) => match CloseCode::from_code(frame.code.into()) {
            Some(code) if frame.reason.is_empty() => format!("the server closed: {code}"),
            // The text of a close code includes its number.
            Some(code) if frame.reason.as_str() == code.to_string() => format!("the server closed: {code}"),
            _ => format!("the server closed: {} ({})", one_line(&frame.reason), u16::from(frame.code)),
        },
        Some(Ok(_)) => "the server closed without a reason".into(),
        Some(Err(error)) => format!("the connection broke: {}", explain(error)),
        None => "the connection ended without a close frame".into(),
    }
}

/// A library error in one line.
fn explain(error: Error) -> String {
    let Error::Http(response) = error else {
        return match error {
            Error::Io(error) => error.to_string(),
            other => other.to_string(),
        };
    };
    let body = response.body().as_deref().unwrap_or_default();
    refusal(response.status(), body)
}
