//! Close codes: why a connection ended, as a number that software can act on.

use std::fmt;

/// The WebSocket close codes that this protocol uses (RFC 6455, section 7.4; 4000 and up are ours).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u16)]
pub enum CloseCode {
    /// The session ended as intended.
    Normal = 1000,
    /// The server shuts down, or is full; reconnect after the delay of Draining or a few seconds.
    GoingAway = 1001,
    /// The peer violated RFC 6455.
    ProtocolError = 1002,
    /// A text frame arrived; this protocol is binary only.
    TextFrame = 1003,
    /// A text frame, or the reason of a close frame, is not UTF-8.
    NotUtf8 = 1007,
    /// A frame exceeded the size limit.
    TooLarge = 1009,
    /// The server failed; reconnecting may help.
    Internal = 1011,
    /// A frame could not be decoded.
    Malformed = 4400,
    /// The token is missing or wrong; reconnecting with the same one will not help.
    Unauthorised = 4401,
    /// A valid message at the wrong time, for example before the handshake.
    OutOfOrder = 4402,
    /// The handshake did not arrive in time.
    HandshakeTimeout = 4408,
    /// The peers speak different protocol versions.
    WrongVersion = 4409,
    /// The peers disagree about the world.
    WrongWorld = 4410,
    /// The peer went silent, or did not finish a message in time.
    Unresponsive = 4411,
}

impl CloseCode {
    /// The number on the wire.
    #[must_use]
    pub const fn code(self) -> u16 {
        self as u16
    }

    /// The code of a number, if this protocol uses it.
    #[must_use]
    pub fn from_code(code: u16) -> Option<Self> {
        use CloseCode::{
            GoingAway, HandshakeTimeout, Internal, Malformed, Normal, NotUtf8, OutOfOrder, ProtocolError,
            TextFrame, TooLarge, Unauthorised, Unresponsive, WrongVersion, WrongWorld,
        };
        [
            Normal,
            GoingAway,
            ProtocolError,
            TextFrame,
            NotUtf8,
            TooLarge,
            Internal,
            Malformed,
            Unauthorised,
            OutOfOrder,
            HandshakeTimeout,
            WrongVersion,
            WrongWorld,
            Unresponsive,
        ]
        .into_iter()
        .find(|known| known.code() == code)
    }

    /// Whether the same client may succeed by connecting again later.
    #[must_use]
    pub const fn is_retryable(self) -> bool {
        matches!(self, Self::GoingAway | Self::Internal | Self::Unresponsive | Self::HandshakeTimeout)
    }
}

impl fmt::Display for CloseCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = match self {
            Self::Normal => "session ended",
            Self::GoingAway => "session ended by the server",
            Self::ProtocolError => "violation of RFC 6455",
            Self::NotUtf8 => "text is not UTF-8",
            Self::TextFrame => "text frames are not part of this protocol",
            Self::TooLarge => "frame exceeds the size limit",
            Self::Internal => "server failure",
            Self::Malformed => "malformed frame",
            Self::Unauthorised => "missing or wrong token",
            Self::OutOfOrder => "message out of order",
            Self::HandshakeTimeout => "handshake timed out",
            Self::WrongVersion => "protocol versions differ",
            Self::WrongWorld => "worlds differ",
            Self::Unresponsive => "peer unresponsive",
        };
        write!(f, "{words} ({})", self.code())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_round_trip_and_unknown_codes_are_none() {
        for code in 0..5000 {
            if let Some(known) = CloseCode::from_code(code) {
                assert_eq!(known.code(), code);
            }
        }
        assert_eq!(CloseCode::from_code(4409), Some(CloseCode::WrongVersion));
        assert_eq!(CloseCode::from_code(4999), None);
    }

    #[test]
    fn permanent_failures_are_not_retryable() {
        assert!(CloseCode::GoingAway.is_retryable() && CloseCode::Internal.is_retryable());
        for fatal in
            [CloseCode::WrongVersion, CloseCode::WrongWorld, CloseCode::Unauthorised, CloseCode::Malformed]
        {
            assert!(!fatal.is_retryable());
        }
    }

    #[test]
    fn a_code_is_shown_in_words_with_its_number() {
        assert_eq!(CloseCode::WrongWorld.to_string(), "worlds differ (4410)");
        assert_eq!(CloseCode::GoingAway.to_string(), "session ended by the server (1001)");
    }
}
