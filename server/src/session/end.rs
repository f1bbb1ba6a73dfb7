//! Why sessions end.

use protocol::CloseCode;
use std::io;
use std::time::Duration;
use tokio::time::timeout;

/// Why a session ended, and what is sent to the peer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionEnd {
    /// Label in metrics and logs.
    pub reason: &'static str,
    /// Close frame to send, if the socket may still accept one.
    pub close: Option<(CloseCode, String)>,
}

impl SessionEnd {
    /// An end with a close frame.
    #[must_use]
    pub fn with_code(reason: &'static str, code: CloseCode) -> Self {
        Self { reason, close: Some((code, code.to_string())) }
    }

    /// An end without a close frame: the connection is gone, or the peer has closed it.
    #[must_use]
    pub const fn without_code(reason: &'static str) -> Self {
        Self { reason, close: None }
    }

    /// The end after a failed read.
    #[must_use]
    pub fn read_failed(error: &io::Error) -> Self {
        let is_closed = error.kind() == io::ErrorKind::UnexpectedEof;
        Self::without_code(if is_closed { "closed" } else { "read_failed" })
    }

    /// The end after a message that breaks the protocol.
    #[must_use]
    pub fn protocol_error(code: CloseCode, text: String) -> Self {
        Self { reason: reason(code), close: Some((code, text)) }
    }
}

/// Runs a write under a deadline. A peer that does not read in time gets no close frame: it would
/// not read that either.
pub async fn write_within(
    deadline: Duration,
    write: impl Future<Output = io::Result<()>>,
) -> Result<(), SessionEnd> {
    match timeout(deadline, write).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(SessionEnd::without_code("write_failed")),
        Err(_) => Err(SessionEnd::without_code("write_timeout")),
    }
}

/// Whether a session of this reason's end broke rules, in contrast to one that was closed, was
/// drained, or lost its network.
#[must_use]
pub fn is_breach(reason: &str) -> bool {
    matches!(
        reason,
        "protocol_error"
            | "not_utf8"
            | "malformed"
            | "text_frame"
            | "too_large"
            | "out_of_order"
            | "handshake_timeout"
            | "message_timeout"
            | "write_timeout"
    )
}

const fn reason(code: CloseCode) -> &'static str {
    match code {
        CloseCode::ProtocolError => "protocol_error",
        CloseCode::NotUtf8 => "not_utf8",
        CloseCode::Malformed => "malformed",
        CloseCode::TextFrame => "text_frame",
        CloseCode::TooLarge => "too_large",
        CloseCode::OutOfOrder => "out_of_order",
        CloseCode::WrongVersion => "wrong_version",
        CloseCode::WrongWorld => "wrong_world",
        CloseCode::Unauthorised => "unauthorised",
        _ => "other",
    }
}
