//! Faults that end a session, with their close codes.

use crate::close::CloseCode;
use crate::error::{ChunkError, ControlError};
use crate::message::Rejection;
use terrain::WorldDigest;
use thiserror::Error;

/// Why a peer must be disconnected.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PeerFault {
    /// A control frame could not be accepted.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// A chunk frame could not be accepted.
    #[error(transparent)]
    Chunk(#[from] ChunkError),
    /// A text frame arrived.
    #[error("a text frame arrived; this protocol is binary only")]
    Text,
    /// A valid message at the wrong time.
    #[error("out of order: {0}")]
    OutOfOrder(&'static str),
    /// More chunks arrived than credits were granted.
    #[error("the server sent a chunk without credit")]
    CreditOverrun,
    /// Seed-only delivery: the announced seed does not generate the announced world here.
    #[error(
        "the server serves world {server} (seed {seed}, generator version {generator}), generation here \
         gives {client}: use exact delivery"
    )]
    OtherGenerator {
        /// The announced seed.
        seed: u64,
        /// The announced version of the height formula.
        generator: u32,
        /// The announced digest.
        server: WorldDigest,
        /// The digest of that seed here.
        client: WorldDigest,
    },
    /// The handshake was refused.
    #[error("refused: {0}")]
    Rejected(Rejection),
}

impl PeerFault {
    /// The close code for the peer.
    #[must_use]
    pub fn close_code(&self) -> CloseCode {
        match self {
            Self::Control(ControlError::Version { .. }) => CloseCode::WrongVersion,
            Self::Control(ControlError::TooLong(_)) | Self::Chunk(ChunkError::TooLong(_)) => {
                CloseCode::TooLarge
            }
            Self::Control(_) | Self::Chunk(_) => CloseCode::Malformed,
            Self::Text => CloseCode::TextFrame,
            Self::OutOfOrder(_) | Self::CreditOverrun => CloseCode::OutOfOrder,
            Self::OtherGenerator { .. } => CloseCode::WrongWorld,
            Self::Rejected(rejection) => rejection.close_code(),
        }
    }
}
