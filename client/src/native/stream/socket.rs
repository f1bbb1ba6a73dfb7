//! The WebSocket of a session: connecting, and the end of a connection as a sentence.

use protocol::limits::MAX_SERVER_FRAME;
use protocol::peer_text::one_line;
use protocol::{CloseCode, SUBPROTOCOL};
use std::io::ErrorKind;
use std::time::Duration;
use tls_client::{TlsClient, Transport, endpoint};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::error::ProtocolError;
use tokio_tungstenite::tungstenite::{self, ClientRequestBuilder, http::Uri, protocol as ws};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};
use tokio_util::either::Either;

/// A connected socket.
pub type Socket = WebSocketStream<Transport>;

/// Bytes read at once; also what an idle connection takes.
const READ_BUFFER: usize = 32 << 10;

/// Most bytes that wait for a server that does not read: views, credits and keys of a second.
const MAX_WRITE_BUFFER: usize = 1 << 20;

/// Why a session ended.
#[derive(Debug)]
pub enum SessionEnd {
    /// The viewer is closing.
    Closing,
    /// Anything else.
    Lost {
        /// One line: the cause and what to do.
        cause: String,
        /// Whether another attempt can help.
        retry: bool,
        /// Delay requested by the server.
        hint: Option<Duration>,
        /// Whether the server broke the rules of the transport.
        is_fault: bool,
    },
}

/// An end with a cause.
pub fn lost(cause: impl Into<String>, retry: bool) -> SessionEnd {
    SessionEnd::Lost { cause: cause.into(), retry, hint: None, is_fault: false }
}

/// Connects and shakes hands. Every buffer has a fixed size.
pub async fn connect(url: &Uri, tls: Option<&TlsClient>) -> Result<Socket, tungstenite::Error> {
    let (host, port) = endpoint(url.host(), url.port_u16(), tls.is_some());
    let stream = TcpStream::connect((host, port)).await?;
    // Small control frames must not be delayed.
    stream.set_nodelay(true)?;
    let stream = match tls {
        Some(tls) => tls.connect(host, stream).await?,
        None => Either::Left(stream),
    };
    let request = ClientRequestBuilder::new(url.clone()).with_sub_protocol(SUBPROTOCOL);
    let config = ws::WebSocketConfig::default()
        .read_buffer_size(READ_BUFFER)
        .max_write_buffer_size(MAX_WRITE_BUFFER)
        .max_message_size(Some(MAX_SERVER_FRAME))
        .max_frame_size(Some(MAX_SERVER_FRAME));
    Ok(client_async_with_config(request, stream, Some(config)).await?.0)
}

/// A failed attempt to connect.
pub fn not_connected(url: &Uri, error: &tungstenite::Error) -> SessionEnd {
    match error {
        tungstenite::Error::Http(response) => {
            let status = response.status();
            let retry = status.is_server_error() || status.as_u16() == 429;
            let said = response.body().as_deref().and_then(explanation);
            let said = said.unwrap_or_else(|| "is it the stream of a tombolo-server?".into());
            lost(format!("{url} answered {status}: {said}"), retry)
        }
        tungstenite::Error::Io(cause) => {
            let remedy = match cause.kind() {
                ErrorKind::ConnectionRefused => {
                    "; start a server with `tombolo-server` or name one with --connect"
                }
                _ => "",
            };
            // A failed TLS handshake, which says what to do and fails again.
            let retry = cause.kind() != ErrorKind::InvalidData;
            lost(format!("cannot connect to {url}: {cause}{remedy}"), retry)
        }
        // A full server, or a tunnel whose server restarts, accepts the connection and closes it.
        tungstenite::Error::ConnectionClosed
        | tungstenite::Error::Protocol(ProtocolError::HandshakeIncomplete) => {
            let cause =
                format!("{url} closed the connection before it answered; it may be full or restarting");
            lost(cause, true)
        }
        other => lost(format!("{url} is not a Tombolo stream: {}", one_line(&other.to_string())), false),
    }
}

/// Cause of an error response in one line: the detail of a problem document (RFC 9457).
fn explanation(body: &[u8]) -> Option<String> {
    let problem: serde_json::Value = serde_json::from_slice(body).ok()?;
    let detail = problem.get("detail")?.as_str().filter(|detail| !detail.is_empty())?;
    Some(one_line(detail))
}

/// A connection that the server closed.
pub fn closed(url: &Uri, frame: Option<&ws::CloseFrame>, hint: Option<Duration>) -> SessionEnd {
    let Some(frame) = frame else {
        let cause = format!("{url} closed the connection");
        return SessionEnd::Lost { cause, retry: true, hint, is_fault: false };
    };
    let number = u16::from(frame.code);
    let code = CloseCode::from_code(number);
    let words = code.map_or_else(|| format!("code {number}"), |code| code.to_string());
    let cause = match frame.reason.as_str() {
        "" => format!("{url} closed the connection: {words}"),
        reason => format!("{url} closed the connection: {words}: {}", one_line(reason)),
    };
    // An unknown code comes from an intermediary: another attempt may help.
    let retry = code.is_none_or(|code| code.is_retryable() || code == CloseCode::Normal);
    SessionEnd::Lost { cause, retry, hint, is_fault: false }
}

/// A connection that failed.
pub fn broken(url: &Uri, error: &tungstenite::Error, hint: Option<Duration>) -> SessionEnd {
    use tungstenite::Error as Failure;
    let is_fault = matches!(error, Failure::Capacity(_) | Failure::Protocol(_) | Failure::Utf8(_));
    // A connection that ends in mid-frame is a network's failure, and another attempt may help.
    let is_cut = matches!(error, Failure::Protocol(ProtocolError::ResetWithoutClosingHandshake));
    let cause = format!("lost {url}: {}", one_line(&error.to_string()));
    SessionEnd::Lost { cause, retry: true, hint, is_fault: is_fault && !is_cut }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::limits::MAX_TEXT;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    /// A full server closes connections without an answer.
    #[tokio::test]
    async fn a_connection_that_ends_before_the_answer_is_tried_again() {
        for greeting in [&b""[..], b"HTTP/1.1 101 Switching"] {
            let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
            let url: Uri = format!("ws://{}/", listener.local_addr().unwrap()).parse().unwrap();
            let server = async {
                let (mut stream, _) = listener.accept().await.unwrap();
                // With the request unread the end would be a reset.
                let mut request = [0; 4096];
                assert!(stream.read(&mut request).await.unwrap() > 0);
                stream.write_all(greeting).await.unwrap();
            };
            let (connected, ()) = tokio::join!(connect(&url, None), server);
            let end = not_connected(&url, &connected.unwrap_err());
            let SessionEnd::Lost { cause, retry: true, .. } = end else { panic!("{end:?}") };
            assert!(cause.contains("before it answered"), "{cause}");
        }
    }

    #[test]
    fn an_explanation_is_one_short_line() {
        assert_eq!(explanation(br#"{"detail":"allow\nit with x"}"#).as_deref(), Some("allow?it with x"));
        for none in [&b""[..], b"<html>", br#"{"detail":""}"#, br#"{"detail":7}"#, b"[]"] {
            assert_eq!(explanation(none), None);
        }
        let long = format!(r#"{{"detail":"{}"}}"#, "x".repeat(1000));
        assert_eq!(explanation(long.as_bytes()).map(|said| said.len()), Some(MAX_TEXT));
    }
}
