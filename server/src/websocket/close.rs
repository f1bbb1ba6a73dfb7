//! Close frames (RFC 6455, sections 5.5.1 and 7.4): which codes may be sent, and their payload.

use super::frame::{FrameError, MAX_CONTROL_PAYLOAD};
use bytes::Bytes;

/// The connection ended as intended.
pub const NORMAL_CLOSURE: u16 = 1000;

/// The peer violated RFC 6455.
pub const PROTOCOL_ERROR: u16 = 1002;

/// A text is not UTF-8.
pub const INVALID_PAYLOAD: u16 = 1007;

/// A message is longer than the limit.
pub const MESSAGE_TOO_BIG: u16 = 1009;

/// The content of a peer's Close frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Close<'a> {
    /// Its code, one of those that may be sent; none if the payload is empty.
    pub code: Option<u16>,
    /// Text for people, at most 123 bytes.
    pub reason: &'a str,
}

impl<'a> Close<'a> {
    /// Reads the payload of a Close frame.
    ///
    /// # Errors
    /// A payload of one byte, a code that may not be sent, or a reason that is not UTF-8.
    pub fn parse(payload: &'a [u8]) -> Result<Self, FrameError> {
        let Some((code, reason)) = payload.split_first_chunk() else {
            return match payload {
                [] => Ok(Self { code: None, reason: "" }),
                _ => Err(FrameError::BadCloseLength),
            };
        };
        let code = u16::from_be_bytes(*code);
        if !may_be_sent(code) {
            return Err(FrameError::BadCloseCode(code));
        }
        let reason = std::str::from_utf8(reason).map_err(|_| FrameError::NotUtf8)?;
        Ok(Self { code: Some(code), reason })
    }

    /// The code that answers this frame: the same, and [`NORMAL_CLOSURE`] where there is none.
    #[must_use]
    pub fn answer(&self) -> u16 {
        self.code.unwrap_or(NORMAL_CLOSURE)
    }
}

impl FrameError {
    /// The code of the Close frame that answers the violation.
    #[must_use]
    pub const fn close_code(&self) -> u16 {
        match self {
            Self::TooLong(_) => MESSAGE_TOO_BIG,
            Self::NotUtf8 => INVALID_PAYLOAD,
            _ => PROTOCOL_ERROR,
        }
    }
}

/// Whether an endpoint may put a code into a Close frame. 1004 is reserved, 1005, 1006 and 1015
/// name events without a frame, 1012 to 1014 are registered with IANA, 3000 to 4999 belong to
/// libraries and applications, and no other code is assigned.
#[must_use]
pub const fn may_be_sent(code: u16) -> bool {
    matches!(code, 1000..=1003 | 1007..=1014 | 3000..=4999)
}

/// The payload of a Close frame. A reason that does not fit is cut between two characters.
#[must_use]
pub fn payload(code: u16, reason: &str) -> Bytes {
    let reason = &reason[..reason.floor_char_boundary(MAX_CONTROL_PAYLOAD - 2)];
    [&code.to_be_bytes(), reason.as_bytes()].concat().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_accepted_as_the_registry_assigns_them() {
        let accepted: Vec<u16> = (0..=u16::MAX).filter(|code| may_be_sent(*code)).collect();
        let ranges = [1000..=1003, 1007..=1014, 3000..=4999];
        assert_eq!(accepted, ranges.into_iter().flatten().collect::<Vec<_>>());
        assert!([3000, 4999].into_iter().all(may_be_sent));
        let rejected = [999, 1004, 1005, 1006, 1015, 1016, 2999, 5000];
        assert!(!rejected.into_iter().any(may_be_sent));
    }

    #[test]
    fn payloads_are_parsed_or_rejected_with_their_fault() {
        assert_eq!(Close::parse(b""), Ok(Close { code: None, reason: "" }));
        assert_eq!(Close::parse(&[3, 0xe9]), Ok(Close { code: Some(1001), reason: "" }));
        assert_eq!(Close::parse(b"\x0f\xa0bye"), Ok(Close { code: Some(4000), reason: "bye" }));
        assert_eq!(Close::parse(&[3]), Err(FrameError::BadCloseLength));
        assert_eq!(Close::parse(&[3, 0xed]), Err(FrameError::BadCloseCode(1005)));
        assert_eq!(Close::parse(b"\x03\xe8\xff"), Err(FrameError::NotUtf8));
    }

    #[test]
    fn long_reasons_are_cut_between_characters() {
        let sent = payload(1002, &"ä".repeat(100));
        assert_eq!(sent.len(), 2 + 122);
        assert_eq!(Close::parse(&sent).unwrap().reason, "ä".repeat(61));
        assert_eq!(payload(1002, "short"), &b"\x03\xeashort"[..]);
    }
}
