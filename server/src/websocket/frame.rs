//! Frame headers of RFC 6455 on the server side, and unmasking. No IO, no state.
//!
//! A frame that a client may not send (section 5) is rejected with a [`FrameError`] before its
//! payload is read.

use thiserror::Error;

/// Longest header of a client's frame, bytes: two, a length of eight and a mask of four.
pub const MAX_CLIENT_HEADER: usize = 14;

/// Longest payload of a control frame, bytes (section 5.5).
pub const MAX_CONTROL_PAYLOAD: usize = 125;

/// Type of a frame (section 5.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Opcode {
    /// A further fragment of a message.
    Continuation,
    /// Text, or its first fragment.
    Text,
    /// Binary data, or its first fragment.
    Binary,
    /// The closing handshake.
    Close,
    /// A request for a pong.
    Ping,
    /// The answer to a ping.
    Pong,
}

impl Opcode {
    fn from_bits(bits: u8) -> Option<Self> {
        Some(match bits {
            0 => Self::Continuation,
            1 => Self::Text,
            2 => Self::Binary,
            8 => Self::Close,
            9 => Self::Ping,
            10 => Self::Pong,
            _ => return None,
        })
    }

    const fn bits(self) -> u8 {
        match self {
            Self::Continuation => 0,
            Self::Text => 1,
            Self::Binary => 2,
            Self::Close => 8,
            Self::Ping => 9,
            Self::Pong => 10,
        }
    }

    /// Whether it is a control frame: short, unfragmented, and allowed between the fragments of a
    /// message.
    #[must_use]
    pub const fn is_control(self) -> bool {
        matches!(self, Self::Close | Self::Ping | Self::Pong)
    }
}

/// Why a client's bytes are no valid frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum FrameError {
    /// A reserved bit is set without an extension.
    #[error("a reserved bit of a frame is set")]
    Reserved,
    /// An opcode that RFC 6455 does not define.
    #[error("frame opcode {0} is unknown")]
    UnknownOpcode(u8),
    /// A client must mask every frame.
    #[error("a client's frame is not masked")]
    Unmasked,
    /// A control frame that is fragmented or longer than 125 bytes.
    #[error("a control frame is fragmented or longer than {MAX_CONTROL_PAYLOAD} bytes")]
    BadControl,
    /// A continuation without a message, or a new message inside an unfinished one.
    #[error("a continuation frame without a message, or a new message inside an unfinished one")]
    BadSequence,
    /// A length that is not in its shortest form, or of 2^63 bytes or more.
    #[error("the length of a frame is not in its shortest form")]
    BadLength,
    /// A close frame whose payload is one byte: half of a code.
    #[error("the payload of a close frame is one byte")]
    BadCloseLength,
    /// A close frame with a code that no endpoint may send (section 7.4).
    #[error("close code {0} may not be sent")]
    BadCloseCode(u16),
    /// A text message, or the reason of a close frame, that is not UTF-8.
    #[error("text is not UTF-8")]
    NotUtf8,
    /// A message beyond the limit.
    #[error("a message is longer than {0} bytes")]
    TooLong(usize),
}

/// The header of a client's frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Whether the message ends with this frame.
    pub is_last: bool,
    /// Type of the frame.
    pub opcode: Opcode,
    /// Masking key of the payload.
    pub mask: [u8; 4],
    /// Bytes of the header itself.
    pub header_length: usize,
    /// Bytes of the payload that follows.
    pub payload_length: usize,
}

/// Reads a client's frame header from the start of `bytes`; none while it is incomplete.
///
/// # Errors
/// A frame that a client may not send, or a payload longer than `limit` bytes.
pub fn read_header(bytes: &[u8], limit: usize) -> Result<Option<Header>, FrameError> {
    let [first, second, rest @ ..] = bytes else { return Ok(None) };
    if first & 0x70 != 0 {
        return Err(FrameError::Reserved);
    }
    let opcode = Opcode::from_bits(first & 15).ok_or(FrameError::UnknownOpcode(first & 15))?;
    if second & 0x80 == 0 {
        return Err(FrameError::Unmasked);
    }
    let is_last = first & 0x80 != 0;
    let short = second & 0x7f;
    if opcode.is_control() && (!is_last || usize::from(short) > MAX_CONTROL_PAYLOAD) {
        return Err(FrameError::BadControl);
    }
    // Each form holds the lengths that no shorter form holds.
    let (length, range, rest) = match short {
        126 => match rest.split_first_chunk() {
            Some((length, rest)) => (u64::from(u16::from_be_bytes(*length)), 126..1 << 16, rest),
            None => return Ok(None),
        },
        127 => match rest.split_first_chunk() {
            Some((length, rest)) => (u64::from_be_bytes(*length), 1 << 16..1 << 63, rest),
            None => return Ok(None),
        },
        short => (u64::from(short), 0..126, rest),
    };
    if !range.contains(&length) {
        return Err(FrameError::BadLength);
    }
    // Checked before the payload arrives, so that no rejected payload is buffered.
    let payload_length =
        usize::try_from(length).ok().filter(|length| *length <= limit).ok_or(FrameError::TooLong(limit))?;
    let Some(mask) = rest.first_chunk() else { return Ok(None) };
    let header_length = bytes.len() - rest.len() + mask.len();
    Ok(Some(Header { is_last, opcode, mask: *mask, header_length, payload_length }))
}

/// Removes a mask from the start of a payload (section 5.3).
pub fn unmask(payload: &mut [u8], mask: [u8; 4]) {
    // Whole words first: the compiler vectorises this loop.
    let word = u32::from_ne_bytes(mask);
    let mut words = payload.chunks_exact_mut(4);
    for chunk in &mut words {
        let plain = u32::from_ne_bytes([chunk[0], chunk[1], chunk[2], chunk[3]]) ^ word;
        chunk.copy_from_slice(&plain.to_ne_bytes());
    }
    for (byte, mask) in words.into_remainder().iter_mut().zip(mask) {
        *byte ^= mask;
    }
}

/// The header of an unfragmented, unmasked frame, as a server sends it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServerHeader {
    bytes: [u8; 10],
    length: u8,
}

impl ServerHeader {
    /// The header for a payload of `payload` bytes, in the shortest form.
    #[must_use]
    pub fn new(opcode: Opcode, payload: usize) -> Self {
        let mut bytes = [0; 10];
        bytes[0] = 0x80 | opcode.bits();
        let length = if let Ok(short @ 0..=125) = u8::try_from(payload) {
            bytes[1] = short;
            2
        } else if let Ok(medium) = u16::try_from(payload) {
            bytes[1] = 126;
            bytes[2..4].copy_from_slice(&medium.to_be_bytes());
            4
        } else {
            bytes[1] = 127;
            bytes[2..10].copy_from_slice(&(payload as u64).to_be_bytes());
            10
        };
        Self { bytes, length }
    }

    /// The bytes on the wire.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: usize = 70_000;

    /// A client's frame as bytes, with the length in its shortest form.
    fn frame(first: u8, payload: &[u8], mask: [u8; 4]) -> Vec<u8> {
        let mut bytes = vec![first];
        match payload.len() {
            short @ 0..=125 => bytes.push(0x80 | short as u8),
            medium @ 126..=0xffff => {
                bytes.push(0x80 | 126);
                bytes.extend((medium as u16).to_be_bytes());
            }
            long => {
                bytes.push(0x80 | 127);
                bytes.extend((long as u64).to_be_bytes());
            }
        }
        bytes.extend(mask);
        let mut masked = payload.to_vec();
        unmask(&mut masked, mask);
        bytes.extend(masked);
        bytes
    }

    #[test]
    fn headers_are_read_in_every_length_form_and_truncation() {
        for length in [0, 1, 125, 126, 65_535, 65_536] {
            let bytes = frame(0x82, &vec![7; length], [1, 2, 3, 4]);
            let header = read_header(&bytes, LIMIT).unwrap().unwrap();
            assert_eq!((header.opcode, header.is_last, header.mask), (Opcode::Binary, true, [1, 2, 3, 4]));
            assert_eq!(
                (header.header_length + header.payload_length, header.payload_length),
                (bytes.len(), length)
            );
            for cut in 0..header.header_length {
                assert_eq!(read_header(&bytes[..cut], LIMIT), Ok(None), "{length} cut to {cut}");
            }
        }
    }

    #[test]
    fn invalid_client_frames_are_rejected_with_their_fault() {
        let cases: [(&[u8], FrameError); 11] = [
            (&[0xc2, 0x80], FrameError::Reserved),
            (&[0x92, 0x80], FrameError::Reserved),
            (&[0x83, 0x80], FrameError::UnknownOpcode(3)),
            (&[0x8f, 0x80], FrameError::UnknownOpcode(15)),
            (&[0x82, 0x05], FrameError::Unmasked),
            (&[0x09, 0x80], FrameError::BadControl),
            (&[0x89, 0xfe], FrameError::BadControl),
            (&[0x82, 0xfe, 0, 125], FrameError::BadLength),
            (&[0x82, 0xff, 0, 0, 0, 0, 0, 0, 0xff, 0xff], FrameError::BadLength),
            (&[0x82, 0xff, 0x80, 0, 0, 0, 0, 0, 0, 0], FrameError::BadLength),
            (&[0x82, 0xff, 0x7f, 0, 0, 0, 0, 0, 0, 0], FrameError::TooLong(LIMIT)),
        ];
        for (bytes, fault) in cases {
            assert_eq!(read_header(bytes, LIMIT), Err(fault), "{bytes:02x?}");
        }
        let at_limit = frame(0x82, &vec![0; LIMIT], [0; 4]);
        assert!(read_header(&at_limit, LIMIT).is_ok() && read_header(&at_limit, LIMIT - 1).is_err());
    }

    #[test]
    fn unmasking_is_its_own_inverse_and_changes_every_byte() {
        for length in 0..40 {
            let plain: Vec<u8> = (0..length).collect();
            let mut bytes = plain.clone();
            unmask(&mut bytes, [0x11, 0x22, 0x44, 0x88]);
            for (index, (masked, plain)) in bytes.iter().zip(&plain).enumerate() {
                assert_eq!(masked ^ plain, [0x11, 0x22, 0x44, 0x88][index % 4]);
            }
            unmask(&mut bytes, [0x11, 0x22, 0x44, 0x88]);
            assert_eq!(bytes, plain);
        }
    }

    #[test]
    fn server_headers_have_the_shortest_form() {
        let bytes = |length| ServerHeader::new(Opcode::Binary, length).as_bytes().to_vec();
        assert_eq!(bytes(125), [0x82, 125]);
        assert_eq!(bytes(126), [0x82, 126, 0, 126]);
        assert_eq!(bytes(0xffff), [0x82, 126, 0xff, 0xff]);
        assert_eq!(bytes(0x1_0000), [0x82, 127, 0, 0, 0, 0, 0, 1, 0, 0]);
        assert_eq!(ServerHeader::new(Opcode::Pong, 0).as_bytes(), [0x8a, 0]);
    }
}
