//! The control messages. Field order and variant order are the wire order: see `docs/protocol.md`
//! and the frozen bytes under `fixtures/` before a change of either.

use crate::close::CloseCode;
use crate::delivery::Delivery;
use crate::error::ControlError;
use crate::limits::{MAX_KEYS, MAX_TEXT};
use crate::view::View;
use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::borrow::Cow;
use std::fmt;
use terrain::{ChunkKey, InvalidKey, WorldDigest};

/// A chunk key as it travels: any numbers, checked by [`WireKey::check`] where they are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WireKey {
    /// Level of detail.
    pub level: u8,
    /// Chunk coordinate east.
    pub x: i32,
    /// Chunk coordinate south.
    pub z: i32,
}

impl WireKey {
    /// The key, if such a chunk exists.
    pub fn check(self) -> Result<ChunkKey, InvalidKey> {
        ChunkKey::new(self.level, self.x, self.z)
    }
}

impl From<ChunkKey> for WireKey {
    fn from(key: ChunkKey) -> Self {
        Self { level: key.level(), x: key.x(), z: key.z() }
    }
}

/// Reads a list of keys. Serde's own reader allocates up to 1 MiB for the length field of a frame
/// of 20 bytes.
fn read_keys<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<WireKey>, D::Error> {
    struct Keys;

    impl<'de> Visitor<'de> for Keys {
        type Value = Vec<WireKey>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a list of keys")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
            let mut keys = Vec::with_capacity(list.size_hint().unwrap_or(0).min(MAX_KEYS));
            while let Some(key) = list.next_element()? {
                keys.push(key);
            }
            Ok(keys)
        }
    }

    from.deserialize_seq(Keys)
}

/// Messages of a client.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClientMessage {
    /// The handshake; must be the first message, once.
    Hello(Hello),
    /// The client's current view; replaces the previous one.
    View(View),
    /// Allows the server to send this many more chunks.
    Credit {
        /// Chunks.
        chunks: u32,
    },
    /// Requests chunks by key, independent of the view; each costs one credit.
    Request {
        /// Chosen by the client, repeated in refusals.
        id: u32,
        /// At most [`MAX_KEYS`].
        #[serde(deserialize_with = "read_keys")]
        keys: Vec<WireKey>,
    },
    /// The client dropped these chunks and may need them again.
    Release {
        /// At most [`MAX_KEYS`].
        #[serde(deserialize_with = "read_keys")]
        keys: Vec<WireKey>,
    },
    /// The client already has these chunks, from an earlier connection to the same world.
    Holding {
        /// At most [`MAX_KEYS`].
        #[serde(deserialize_with = "read_keys")]
        keys: Vec<WireKey>,
    },
    /// Allows the server to send chunk frames of this many bytes more. The first one in a session
    /// adds a bound on bytes to the one on chunks; without any, only chunks are counted.
    CreditBytes {
        /// Bytes of chunk frames.
        bytes: u32,
    },
    /// Chunks of a request that have not been sent yet are no longer needed.
    Cancel {
        /// The request's id.
        id: u32,
    },
}

/// The client's half of the handshake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// The world that the client requires; none accepts any.
    pub digest: Option<[u8; 32]>,
    /// The delivery of chunks, for the whole session.
    pub delivery: Delivery,
    /// Access token, if the server requires one.
    pub token: Option<String>,
    /// Name and version of the client, for logs.
    pub software: String,
}

/// Messages of a server.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ServerMessage {
    /// The handshake succeeded.
    Welcome(Welcome),
    /// The handshake failed; the connection closes.
    Rejected(Rejection),
    /// Every chunk of a view has been sent (or was held, or refused).
    Settled(Settled),
    /// A request, a chunk or a view is refused; the session continues.
    Refused(Refused),
    /// The server is shutting down and will close the connection.
    Draining {
        /// Delay before reconnecting, milliseconds; jittered by the server.
        reconnect_after_ms: u32,
    },
}

/// The end of a view's delivery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settled {
    /// The view's id.
    pub view: u32,
    /// Chunks that the view needs.
    pub chunks: u32,
}

/// The server's half of the handshake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Welcome {
    /// Identifies the session in the server's logs.
    pub session: u64,
    /// Seed of the world.
    pub world_seed: u64,
    /// Version of the height formula.
    pub generator_version: u32,
    /// Digest of the world.
    pub digest: [u8; 32],
    /// Largest credit that may be outstanding.
    pub max_credits: u32,
    /// Largest view distance that is served, metres.
    pub max_view_distance_m: u32,
    /// Name and version of the server.
    pub software: String,
}

/// Why a handshake failed. Carries the values of both sides, so that an operator can see which one
/// to change.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Rejection {
    /// The protocol versions differ.
    WrongVersion {
        /// The client's version.
        client: u16,
        /// The server's version.
        server: u16,
    },
    /// The client requires another world.
    WrongWorld {
        /// The digest that the client requires.
        client: [u8; 32],
        /// The digest of the world that is served.
        server: [u8; 32],
    },
    /// The token is missing or wrong.
    Unauthorised,
}

impl Rejection {
    /// The close code that follows.
    #[must_use]
    pub const fn close_code(&self) -> CloseCode {
        match self {
            Self::WrongVersion { .. } => CloseCode::WrongVersion,
            Self::WrongWorld { .. } => CloseCode::WrongWorld,
            Self::Unauthorised => CloseCode::Unauthorised,
        }
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WrongVersion { client, server } => {
                write!(
                    f,
                    "the client has protocol version {client}, the server {server}: update the older one"
                )
            }
            Self::WrongWorld { client, server } => {
                let (client, server) = (WorldDigest(*client), WorldDigest(*server));
                write!(
                    f,
                    "the client requires world {client}, the server serves {server}: \
                     connect to another server or accept the served world"
                )
            }
            Self::Unauthorised => write!(f, "the access token is missing or wrong"),
        }
    }
}

/// A refusal of a request, a chunk or a view.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// The id of the request or of the view.
    pub id: u32,
    /// The chunk, if the refusal concerns one.
    pub key: Option<WireKey>,
    /// Why.
    pub reason: RefusalReason,
    /// One sentence for people.
    pub detail: Cow<'static, str>,
}

/// The reason of a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum RefusalReason {
    /// The key names no chunk of this world.
    OutsideWorld,
    /// A view field is out of range.
    InvalidView,
    /// Too many requests are waiting already.
    TooManyRequests,
    /// The server is shedding load; request again later.
    Overloaded,
    /// The server failed to generate the chunk.
    Failed,
    /// The request names the key more than once; it is sent once.
    Duplicate,
    /// A grant of zero, or of more than may be outstanding. It has no effect.
    InvalidCredit,
}

impl RefusalReason {
    /// All of them, in the order of the wire.
    pub const ALL: [Self; 7] = [
        Self::OutsideWorld,
        Self::InvalidView,
        Self::TooManyRequests,
        Self::Overloaded,
        Self::Failed,
        Self::Duplicate,
        Self::InvalidCredit,
    ];

    /// Its index in [`Self::ALL`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Its name in metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OutsideWorld => "outside world",
            Self::InvalidView => "invalid view",
            Self::TooManyRequests => "too many requests",
            Self::Overloaded => "overloaded",
            Self::Failed => "failed",
            Self::Duplicate => "duplicate",
            Self::InvalidCredit => "invalid credit",
        }
    }
}

fn check_keys(keys: &[WireKey]) -> Result<(), ControlError> {
    if keys.len() > MAX_KEYS { Err(ControlError::TooManyKeys(keys.len())) } else { Ok(()) }
}

fn check_text(text: &str) -> Result<(), ControlError> {
    if text.len() > MAX_TEXT { Err(ControlError::TextTooLong(text.len())) } else { Ok(()) }
}

/// A message whose fields have limits beyond their types.
pub trait Limited {
    /// Rejects fields beyond the protocol's limits.
    fn check_limits(&self) -> Result<(), ControlError>;
}

impl Limited for ClientMessage {
    fn check_limits(&self) -> Result<(), ControlError> {
        match self {
            Self::Hello(hello) => {
                check_text(&hello.software)?;
                hello.token.as_deref().map_or(Ok(()), check_text)
            }
            Self::Request { keys, .. } | Self::Release { keys } | Self::Holding { keys } => check_keys(keys),
            // The session checks a view's ranges: it refuses the view without disconnecting.
            Self::View(_) | Self::Credit { .. } | Self::CreditBytes { .. } | Self::Cancel { .. } => Ok(()),
        }
    }
}

impl Limited for ServerMessage {
    fn check_limits(&self) -> Result<(), ControlError> {
        match self {
            Self::Welcome(welcome) => check_text(&welcome.software),
            Self::Refused(refused) => check_text(&refused.detail),
            Self::Rejected(_) | Self::Settled(_) | Self::Draining { .. } => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_of_any_message_has_at_most_the_longest_length() {
        let checked = |length: usize| {
            let text = || "t".repeat(length);
            let hello = |token, software| Hello { digest: None, delivery: Delivery::Exact, token, software };
            let welcome = Welcome {
                session: 1,
                world_seed: 1,
                generator_version: 1,
                digest: [0; 32],
                max_credits: 1,
                max_view_distance_m: 1,
                software: text(),
            };
            let refused = Refused { id: 1, key: None, reason: RefusalReason::Failed, detail: text().into() };
            [
                ClientMessage::Hello(hello(None, text())).check_limits(),
                ClientMessage::Hello(hello(Some(text()), String::new())).check_limits(),
                ServerMessage::Welcome(welcome).check_limits(),
                ServerMessage::Refused(refused).check_limits(),
            ]
        };
        assert!(checked(MAX_TEXT).iter().all(Result::is_ok));
        for length in [MAX_TEXT + 1, 2 * MAX_TEXT] {
            for result in checked(length) {
                assert_eq!(result, Err(ControlError::TextTooLong(length)));
            }
        }
    }

    #[test]
    fn refusal_reasons_are_numbered_in_their_order_and_named_by_the_words_of_their_variants() {
        for (index, reason) in RefusalReason::ALL.into_iter().enumerate() {
            assert_eq!(reason.index(), index);
            assert_eq!(reason.name().replace(' ', ""), format!("{reason:?}").to_lowercase());
        }
    }
}
