//! Frames as a client sends them, valid or not, and frames as they are read from a server.

/// Opcodes (RFC 6455, section 5.2).
pub const CONTINUATION: u8 = 0;
pub const TEXT: u8 = 1;
pub const BINARY: u8 = 2;
pub const CLOSE: u8 = 8;
pub const PING: u8 = 9;
pub const PONG: u8 = 10;

/// The form of a frame's length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Length {
    /// The shortest, the only valid one.
    Shortest,
    /// 16 bits.
    Medium,
    /// 64 bits.
    Long,
    /// 64 bits with a value that is not the payload's length.
    False(u64),
}

/// A frame of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    pub is_last: bool,
    /// Reserved bits, 0 to 7.
    pub reserved: u8,
    pub opcode: u8,
    pub is_masked: bool,
    pub length: Length,
    pub payload: Vec<u8>,
    /// Bytes of the frame that are sent; all without a limit.
    pub cut: Option<usize>,
}

impl Frame {
    /// A valid, unfragmented frame.
    pub fn new(opcode: u8, payload: impl AsRef<[u8]>) -> Self {
        Self {
            is_last: true,
            reserved: 0,
            opcode,
            is_masked: true,
            length: Length::Shortest,
            payload: payload.as_ref().to_vec(),
            cut: None,
        }
    }

    /// A fragment that is not the last one.
    pub fn part(opcode: u8, payload: impl AsRef<[u8]>) -> Self {
        Self { is_last: false, ..Self::new(opcode, payload) }
    }

    /// A Close frame.
    pub fn close(code: u16, reason: impl AsRef<[u8]>) -> Self {
        Self::new(CLOSE, [&code.to_be_bytes(), reason.as_ref()].concat())
    }

    /// The bytes on the wire.
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![u8::from(self.is_last) << 7 | self.reserved << 4 | self.opcode];
        let mask_bit = u8::from(self.is_masked) << 7;
        let length = match self.length {
            Length::False(length) => length,
            _ => self.payload.len() as u64,
        };
        match (self.length, length) {
            (Length::Shortest, 0..126) => bytes.push(mask_bit | length as u8),
            (Length::Shortest, 126..0x1_0000) | (Length::Medium, _) => {
                bytes.push(mask_bit | 126);
                bytes.extend((length as u16).to_be_bytes());
            }
            _ => {
                bytes.push(mask_bit | 127);
                bytes.extend(length.to_be_bytes());
            }
        }
        let mask = [0x37, 0xfa, 0x21, 0x3d].map(|byte| if self.is_masked { byte } else { 0 });
        if self.is_masked {
            bytes.extend(mask);
        }
        bytes.extend(self.payload.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
        bytes.truncate(self.cut.unwrap_or(usize::MAX));
        bytes
    }
}

/// Splits a server's bytes into opcodes and payloads. A frame that a server may not send, and an
/// incomplete one, is an error.
pub fn parse(mut bytes: &[u8]) -> Result<Vec<(u8, Vec<u8>)>, String> {
    let mut frames = Vec::new();
    while let [first, second, rest @ ..] = bytes {
        if first & 0xf0 != 0x80 || second & 0x80 != 0 {
            return Err(format!("the server sent a frame that begins with {first:02x} {second:02x}"));
        }
        let (length, rest) = match second {
            126 => rest.split_first_chunk().map(|(length, rest)| (u16::from_be_bytes(*length).into(), rest)),
            127 => rest.split_first_chunk().map(|(length, rest)| (u64::from_be_bytes(*length), rest)),
            short => Some((u64::from(*short), rest)),
        }
        .ok_or("an incomplete header")?;
        let payload = rest.get(..length as usize).ok_or("an incomplete payload")?;
        frames.push((first & 15, payload.to_vec()));
        bytes = &rest[length as usize..];
    }
    if bytes.is_empty() { Ok(frames) } else { Err("an incomplete header".into()) }
}
