//! Control frames: a six-byte header and a bincode body.
//!
//! The only module that names bincode. Its encoding (fixed-width little-endian integers, u32
//! variant index, u64 lengths) is frozen by the fixtures and written down in `docs/protocol.md`, so
//! that it can be replaced by hand-written code without a change on the wire.

use crate::PROTOCOL_VERSION;
use crate::error::ControlError;
use crate::limits::MAX_CONTROL_FRAME;
use crate::message::Limited;
use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use bincode::error::{DecodeError, EncodeError};
use bytes::Bytes;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::cell::RefCell;

/// First bytes of every control frame.
pub const MAGIC: [u8; 4] = *b"TMBM";

thread_local! {
    /// Buffer in which frames are encoded, so that each frame takes one allocation of exactly its
    /// length: a server under load refuses a hundred thousand requests a second. Grows to the
    /// longest message of this thread.
    static SCRATCH: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

const CONFIG: Configuration<LittleEndian, Fixint, Limit<MAX_CONTROL_FRAME>> =
    bincode::config::standard().with_fixed_int_encoding().with_limit::<MAX_CONTROL_FRAME>();

/// Encodes a message as one frame.
///
/// # Errors
/// A message beyond the protocol's limits; the sessions of this crate never build one.
pub fn encode<M: Serialize + Limited>(message: &M) -> Result<Bytes, ControlError> {
    message.check_limits()?;
    SCRATCH.with_borrow_mut(|frame| {
        frame.clear();
        frame.extend_from_slice(&MAGIC);
        frame.extend_from_slice(&PROTOCOL_VERSION.to_le_bytes());
        bincode::serde::encode_into_std_write(message, frame, CONFIG)
            .map_err(|error| encode_fault(&error))?;
        match frame.len() {
            ..=MAX_CONTROL_FRAME => Ok(Bytes::copy_from_slice(frame)),
            length => Err(ControlError::TooLong(length)),
        }
    })
}

/// Decodes one whole frame. Never allocates more than the frame limit, never panics.
///
/// # Errors
/// See [`ControlError`]; trailing bytes are an error.
pub fn decode<M: DeserializeOwned + Limited>(frame: &[u8]) -> Result<M, ControlError> {
    if frame.len() > MAX_CONTROL_FRAME {
        return Err(ControlError::TooLong(frame.len()));
    }
    let (magic, rest) = frame.split_first_chunk().ok_or(ControlError::Truncated)?;
    if *magic != MAGIC {
        return Err(ControlError::BadMagic);
    }
    let (version, body) = rest.split_first_chunk().ok_or(ControlError::Truncated)?;
    let theirs = u16::from_le_bytes(*version);
    if theirs != PROTOCOL_VERSION {
        return Err(ControlError::Version { theirs, ours: PROTOCOL_VERSION });
    }
    let (message, used): (M, usize) =
        bincode::serde::decode_from_slice(body, CONFIG).map_err(|error| decode_fault(&error))?;
    if used != body.len() {
        return Err(ControlError::Trailing(body.len() - used));
    }
    message.check_limits()?;
    Ok(message)
}

fn encode_fault(error: &EncodeError) -> ControlError {
    ControlError::Invalid(error.to_string())
}

fn decode_fault(error: &DecodeError) -> ControlError {
    match error {
        DecodeError::UnexpectedEnd { .. } => ControlError::Truncated,
        DecodeError::LimitExceeded => ControlError::Invalid("a length field exceeds the frame limit".into()),
        DecodeError::Utf8 { .. } => ControlError::Invalid("a text is not UTF-8".into()),
        // Of our own types. Short enough for a close frame.
        DecodeError::OtherString(text) => ControlError::Invalid(text.chars().take(80).collect()),
        // Texts of the library name its types.
        _ => ControlError::Invalid("a field has a value without meaning".into()),
    }
}
