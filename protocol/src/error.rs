//! Faults of a frame's bytes, one variant per fault that callers distinguish.

use crate::limits::{MAX_CHUNK_FRAME, MAX_CONTROL_FRAME, MAX_KEYS, MAX_TEXT};
use terrain::{ChunkKey, InvalidKey};
use thiserror::Error;

/// Why a control frame was not accepted.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ControlError {
    /// Longer than [`MAX_CONTROL_FRAME`].
    #[error("control frame of {0} bytes exceeds the limit of {MAX_CONTROL_FRAME}")]
    TooLong(usize),
    /// Shorter than its header, or cut off inside the body.
    #[error("control frame is truncated")]
    Truncated,
    /// The first four bytes are not the control magic.
    #[error("control frame does not start with the magic `TMBM`")]
    BadMagic,
    /// The sender has another protocol version.
    #[error("the peer has protocol version {theirs}, this side {ours}")]
    Version {
        /// The version in the frame.
        theirs: u16,
        /// [`crate::PROTOCOL_VERSION`].
        ours: u16,
    },
    /// The body names no known message, or a field has no valid value.
    #[error("control message is invalid: {0}")]
    Invalid(String),
    /// Bytes are left after the message.
    #[error("{0} trailing bytes after the control message")]
    Trailing(usize),
    /// A list holds more keys than allowed.
    #[error("message lists {0} chunk keys, the limit is {MAX_KEYS}")]
    TooManyKeys(usize),
    /// A text field is longer than allowed.
    #[error("text field of {0} bytes exceeds the limit of {MAX_TEXT}")]
    TextTooLong(usize),
}

/// Why a chunk frame was not accepted.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ChunkError {
    /// Shorter than its header says, or than the header itself.
    #[error("chunk frame is truncated: {got} bytes of {expected}")]
    Truncated {
        /// Bytes present.
        got: usize,
        /// Bytes needed.
        expected: usize,
    },
    /// Longer than its header says.
    #[error("{0} trailing bytes after the chunk")]
    Trailing(usize),
    /// Longer than any valid chunk.
    #[error("chunk frame of {0} bytes exceeds the limit of {MAX_CHUNK_FRAME}")]
    TooLong(usize),
    /// The first four bytes are not the chunk magic.
    #[error("chunk frame does not start with the magic `TMBC`")]
    BadMagic,
    /// A chunk format that this side does not know.
    #[error("chunk format version {0} is unknown")]
    UnknownVersion(u16),
    /// A kind that this side does not know, or one that its delivery does not allow.
    #[error("chunk kind {0} is unknown or not part of the delivery")]
    UnknownKind(u8),
    /// A chunk that the receiver has not asked for.
    #[error("chunk {0} was neither requested nor needed by a view")]
    Unexpected(ChunkKey),
    /// A key that names no chunk.
    #[error("chunk frame carries an invalid key: {0}")]
    Key(#[from] InvalidKey),
    /// A length field outside what any payload can have.
    #[error("chunk frame declares an impossible {field} length of {value}")]
    Length {
        /// Which length.
        field: &'static str,
        /// Its value.
        value: u32,
    },
    /// The payload ends inside a part, or a part is longer than what it stands for.
    #[error("chunk payload is cut off inside a part, or a part is longer than its content")]
    Part,
    /// A part is not a Zstandard frame of exactly the expected length.
    #[error("a part of the chunk payload does not decompress to the length that the header implies")]
    Compression,
    /// A quantised chunk is coarser than the requested tolerance.
    #[error("chunk is quantised to {theirs} units, the requested tolerance is {ours}")]
    Tolerance {
        /// The tolerance in the frame, units.
        theirs: u16,
        /// The requested tolerance, units.
        ours: u16,
    },
    /// The frame belongs to another world or another parent, or is damaged.
    #[error("chunk digest does not match its content in this world")]
    Digest,
    /// The chunk generated here does not have the digest in the frame.
    #[error("chunk {0} generated here does not have the digest that the server sent: use exact delivery")]
    Regenerated(ChunkKey),
    /// A refined frame came with the wrong chunk to refine.
    #[error("chunk {0} refines its parent, and another chunk was given")]
    Parent(ChunkKey),
    /// A decoded value breaks a rule that the header or the format states.
    #[error("chunk content breaks a rule: {0}")]
    Content(&'static str),
}
