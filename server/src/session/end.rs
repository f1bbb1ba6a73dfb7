//! Why sessions end.

use crate::open_sessions::Eviction;
use protocol::CloseCode;
use std::io;
use std::time::Duration;
use tokio::time::timeout;

/// The reason of an end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndReason {
    /// The peer closed the connection.
    Closed,
    /// The server drains.
    Drained,
    /// Reading failed.
    ReadFailed,
    /// Writing failed.
    WriteFailed,
    /// The peer did not read in time.
    WriteTimeout,
    /// The Hello did not come in time.
    HandshakeTimeout,
    /// The peer began a message and did not finish it in time.
    MessageTimeout,
    /// The peer did not answer pings.
    KeepaliveTimeout,
    /// The server had too little memory.
    MemoryShed,
    /// A client of a site with fewer sessions had none.
    Displaced,
    /// A violation of RFC 6455.
    ProtocolError,
    /// A text that is not UTF-8.
    NotUtf8,
    /// A message that cannot be decoded.
    Malformed,
    /// A text message.
    TextFrame,
    /// A message above the size limit.
    TooLarge,
    /// A valid message at the wrong time.
    OutOfOrder,
    /// Another protocol version.
    WrongVersion,
    /// Another world.
    WrongWorld,
    /// A missing or wrong token.
    Unauthorised,
    /// Another close code.
    Other,
}

impl EndReason {
    /// All of them.
    pub const ALL: [Self; 20] = [
        Self::Closed,
        Self::Drained,
        Self::ReadFailed,
        Self::WriteFailed,
        Self::WriteTimeout,
        Self::HandshakeTimeout,
        Self::MessageTimeout,
        Self::KeepaliveTimeout,
        Self::MemoryShed,
        Self::Displaced,
        Self::ProtocolError,
        Self::NotUtf8,
        Self::Malformed,
        Self::TextFrame,
        Self::TooLarge,
        Self::OutOfOrder,
        Self::WrongVersion,
        Self::WrongWorld,
        Self::Unauthorised,
        Self::Other,
    ];

    /// Label in metrics and logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Closed => "closed",
            Self::Drained => "drained",
            Self::ReadFailed => "read_failed",
            Self::WriteFailed => "write_failed",
            Self::WriteTimeout => "write_timeout",
            Self::HandshakeTimeout => "handshake_timeout",
            Self::MessageTimeout => "message_timeout",
            Self::KeepaliveTimeout => "keepalive_timeout",
            Self::MemoryShed => "memory",
            Self::Displaced => "displaced",
            Self::ProtocolError => "protocol_error",
            Self::NotUtf8 => "not_utf8",
            Self::Malformed => "malformed",
            Self::TextFrame => "text_frame",
            Self::TooLarge => "too_large",
            Self::OutOfOrder => "out_of_order",
            Self::WrongVersion => "wrong_version",
            Self::WrongWorld => "wrong_world",
            Self::Unauthorised => "unauthorised",
            Self::Other => "other",
        }
    }

    /// Whether the peer takes none of what was written: the system need not keep it.
    #[must_use]
    pub const fn leaves_unread_bytes(self) -> bool {
        matches!(self, Self::WriteTimeout | Self::MemoryShed)
    }

    /// Whether the peer broke rules, in contrast to a session that was closed, was drained, was
    /// rejected, or lost its network.
    #[must_use]
    pub const fn is_breach(self) -> bool {
        match self {
            Self::WriteTimeout
            | Self::HandshakeTimeout
            | Self::MessageTimeout
            | Self::ProtocolError
            | Self::NotUtf8
            | Self::Malformed
            | Self::TextFrame
            | Self::TooLarge
            | Self::OutOfOrder => true,
            Self::Closed
            | Self::Drained
            | Self::ReadFailed
            | Self::WriteFailed
            | Self::KeepaliveTimeout
            | Self::MemoryShed
            | Self::Displaced
            | Self::WrongVersion
            | Self::WrongWorld
            | Self::Unauthorised
            | Self::Other => false,
        }
    }
}

impl From<CloseCode> for EndReason {
    fn from(code: CloseCode) -> Self {
        match code {
            CloseCode::ProtocolError => Self::ProtocolError,
            CloseCode::NotUtf8 => Self::NotUtf8,
            CloseCode::Malformed => Self::Malformed,
            CloseCode::TextFrame => Self::TextFrame,
            CloseCode::TooLarge => Self::TooLarge,
            CloseCode::OutOfOrder => Self::OutOfOrder,
            CloseCode::WrongVersion => Self::WrongVersion,
            CloseCode::WrongWorld => Self::WrongWorld,
            CloseCode::Unauthorised => Self::Unauthorised,
            _ => Self::Other,
        }
    }
}

/// Why a session ended, and what is sent to the peer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionEnd {
    /// The reason.
    pub reason: EndReason,
    /// Close frame to send, if the socket may still accept one: code and reason.
    pub close: Option<(u16, String)>,
}

impl SessionEnd {
    /// The end of a session that has done nothing wrong.
    pub fn by_server(eviction: Eviction) -> Self {
        match eviction {
            // Without a Close frame, whose answer would keep the memory.
            Eviction::Memory => Self::without_code(EndReason::MemoryShed),
            Eviction::Displaced => {
                Self::going_away(EndReason::Displaced, "server is full, and another site has fewer sessions")
            }
        }
    }

    /// An end with a close frame.
    #[must_use]
    pub fn with_code(reason: EndReason, code: CloseCode) -> Self {
        Self { reason, close: Some((code.code(), code.to_string())) }
    }

    /// An end by the server that is no fault of the peer.
    pub fn going_away(reason: EndReason, text: &str) -> Self {
        Self { reason, close: Some((CloseCode::GoingAway.code(), text.into())) }
    }

    /// An end without a close frame: the connection is gone, or the peer has closed it.
    #[must_use]
    pub const fn without_code(reason: EndReason) -> Self {
        Self { reason, close: None }
    }

    /// The end after a failed read.
    #[must_use]
    pub fn read_failed(error: &io::Error) -> Self {
        let is_closed = error.kind() == io::ErrorKind::UnexpectedEof;
        Self::without_code(if is_closed { EndReason::Closed } else { EndReason::ReadFailed })
    }

    /// The end after a message that breaks the protocol.
    #[must_use]
    pub fn protocol_error(code: CloseCode, text: String) -> Self {
        Self { reason: code.into(), close: Some((code.code(), text)) }
    }

    /// The end after the peer's Close frame, which is answered by one with the same code (RFC 6455,
    /// section 5.5.1).
    #[must_use]
    pub const fn answered(code: u16) -> Self {
        Self { reason: EndReason::Closed, close: Some((code, String::new())) }
    }
}

/// Runs a write under a deadline. A peer that does not read in time gets no close frame: it would
/// not read that either.
pub async fn write_within<T>(
    deadline: Duration,
    write: impl Future<Output = io::Result<T>>,
) -> Result<T, SessionEnd> {
    match timeout(deadline, write).await {
        Ok(Ok(written)) => Ok(written),
        Ok(Err(_)) => Err(SessionEnd::without_code(EndReason::WriteFailed)),
        Err(_) => Err(SessionEnd::without_code(EndReason::WriteTimeout)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_displaced_session_does_not_announce_a_shutdown() {
        let (code, text) = SessionEnd::by_server(Eviction::Displaced).close.unwrap();
        assert_eq!(code, CloseCode::GoingAway.code());
        assert!(text.contains("another site") && !text.contains("shutting down"), "{text}");
    }

    #[test]
    fn every_close_code_of_a_session_has_its_reason() {
        for (code, reason) in [
            (CloseCode::ProtocolError, EndReason::ProtocolError),
            (CloseCode::NotUtf8, EndReason::NotUtf8),
            (CloseCode::Malformed, EndReason::Malformed),
            (CloseCode::TextFrame, EndReason::TextFrame),
            (CloseCode::TooLarge, EndReason::TooLarge),
            (CloseCode::OutOfOrder, EndReason::OutOfOrder),
            (CloseCode::WrongVersion, EndReason::WrongVersion),
            (CloseCode::WrongWorld, EndReason::WrongWorld),
            (CloseCode::Unauthorised, EndReason::Unauthorised),
        ] {
            assert_eq!(EndReason::from(code), reason);
        }
    }
}
