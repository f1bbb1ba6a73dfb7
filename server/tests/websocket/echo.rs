//! A peer that sends every message back, built from the WebSocket layer. The example `echo` serves
//! it for test suites of others.

use bytes::Bytes;
use server::websocket::frame::Opcode;
use server::websocket::inbox::Message;
use server::websocket::socket::WebSocket;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};

/// Time for the peer to end the connection after the Close frame.
const END_TIMEOUT: Duration = Duration::from_secs(2);

/// Serves one connection to its end. Pongs contain what `pong` makes of a ping's content: RFC 6455,
/// section 5.5.3, asks for the same.
pub async fn serve<S: AsyncRead + AsyncWrite + Unpin>(mut socket: WebSocket<S>, pong: fn(&[u8]) -> &[u8]) {
    let (code, reason) = loop {
        let (opcode, payload) = match socket.next_message() {
            Ok(None) => {
                if socket.flush().await.is_err() || socket.read().await.is_err() {
                    return;
                }
                continue;
            }
            Ok(Some(Message::Binary(bytes))) => (Opcode::Binary, bytes),
            Ok(Some(Message::Text(text))) => (Opcode::Text, text.as_bytes()),
            Ok(Some(Message::Ping(payload))) => (Opcode::Pong, pong(payload)),
            Ok(Some(Message::Pong)) => continue,
            Ok(Some(Message::Close(close))) => break (close.answer(), String::new()),
            Err(fault) => break (fault.close_code(), fault.to_string()),
        };
        let payload = Bytes::copy_from_slice(payload);
        socket.queue_as(opcode, payload);
    };
    socket.queue_close(code, &reason);
    if socket.flush().await.is_ok() {
        let _ = tokio::time::timeout(END_TIMEOUT, socket.end()).await;
    }
}
