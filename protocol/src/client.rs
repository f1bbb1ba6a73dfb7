//! The client's side of a session, without IO.
//!
//! A driver feeds received frames to [`ClientSession::receive`], handles the events, and sends the
//! frames of [`ClientSession::poll_transmit`]. The session grants credits itself: a fixed window,
//! refilled when half of it is used, so that at most one window of chunks is in flight and grants
//! cost little.

use crate::DataFrame;
use crate::chunk_codec;
use crate::chunk_codec::{quantised, refined, seed_only};
use crate::control;
use crate::delivery::Delivery;
use crate::error::{ChunkError, ControlError};
use crate::fault::PeerFault;
use crate::limits::{MAX_CREDITS, MAX_KEYS, MAX_TEXT};
use crate::message::{ClientMessage, Hello, Refused, Rejection, ServerMessage, Settled, Welcome, WireKey};
use crate::reference_window::ReferenceWindow;
use crate::view::View;
use bytes::Bytes;
use std::collections::VecDeque;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// The configuration of a client session.
#[derive(Clone, Debug)]
pub struct ClientConfig {
    /// The required world; none accepts any.
    pub digest: Option<WorldDigest>,
    /// The delivery of chunks.
    pub delivery: Delivery,
    /// Access token, if the server requires one.
    pub token: Option<String>,
    /// Name and version for the server's logs; cut to [`MAX_TEXT`] bytes.
    pub software: String,
    /// Chunks that may be in flight at once, 1 to [`MAX_CREDITS`].
    pub window: u32,
}

/// A received message, decoded and verified.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The handshake succeeded.
    Welcome(Welcome),
    /// A chunk was decoded from its frame, or generated here, and verified against the digest in
    /// the frame.
    Chunk {
        /// The chunk.
        chunk: Box<Chunk>,
        /// Bytes of its frame.
        bytes: usize,
        /// The delivery of its frame: [`Delivery::SeedOnly`] means that the chunk was generated
        /// here.
        delivery: Delivery,
    },
    /// Every chunk of a view has been sent.
    Settled(Settled),
    /// A request, a chunk or a view is refused.
    Refused(Refused),
    /// The server is about to close.
    Draining {
        /// Delay before reconnecting, milliseconds.
        reconnect_after_ms: u32,
    },
}

/// The world of a session, fixed by the Welcome.
#[derive(Clone, Debug)]
struct World {
    digest: WorldDigest,
    /// In seed-only delivery: the generator of the chunks, of the digest above.
    land: Option<Land>,
}

/// One session, from the first frame to the close.
#[derive(Debug)]
pub struct ClientSession {
    /// Set by the Welcome; before it only the handshake may arrive.
    world: Option<World>,
    expected: Option<WorldDigest>,
    delivery: Delivery,
    window: u32,
    /// Granted and not yet used.
    credits: u32,
    next_request: u32,
    /// In refined delivery: heights of the parents that later frames may refer to.
    references: ReferenceWindow<Box<[i32; VERTEX_COUNT]>>,
    /// Frames to send. Bounded by the calls between two polls.
    outbox: VecDeque<Bytes>,
}

impl ClientSession {
    /// Starts a session: the handshake and the first credits are ready to send.
    #[must_use]
    pub fn new(config: ClientConfig) -> Self {
        let window = config.window.clamp(1, MAX_CREDITS);
        let mut session = Self {
            world: None,
            expected: config.digest,
            delivery: config.delivery,
            window,
            credits: window,
            next_request: 0,
            references: ReferenceWindow::default(),
            outbox: VecDeque::new(),
        };
        session.send(&ClientMessage::Hello(Hello {
            digest: config.digest.map(|digest| digest.0),
            delivery: config.delivery,
            token: config.token.map(cut),
            software: cut(config.software),
        }));
        session.send(&ClientMessage::Credit { chunks: window });
        session
    }

    /// The next frame to send, if any. Grants new credit when half of the window is used. Credit
    /// counts from here, because the server cannot use an unsent grant.
    pub fn poll_transmit(&mut self) -> Option<Bytes> {
        if self.credits <= self.window / 2 && self.world.is_some() {
            let chunks = self.window - self.credits;
            self.credits = self.window;
            self.send(&ClientMessage::Credit { chunks });
        }
        self.outbox.pop_front()
    }

    /// Processes one frame from the server, with a chunk of any key.
    ///
    /// # Errors
    /// A protocol violation or a rejected handshake: close with the fault's code. After
    /// [`PeerFault::Chunk`] the session may go on: the frame has used its credit, and in refined
    /// delivery its chunk has its place in the reference window, without heights. Until the chunk
    /// has come again, refined frames of its children are rejected with [`ChunkError::Parent`].
    /// Where the frame named no valid key, the windows may differ: then only a new session has all
    /// chunks.
    pub fn receive(&mut self, frame: DataFrame<'_>) -> Result<Event, PeerFault> {
        self.receive_expected(frame, |_| true)
    }

    /// [`ClientSession::receive`] for a client that does not trust its server: a chunk whose key is
    /// not expected is neither decoded nor generated.
    ///
    /// # Errors
    /// As [`ClientSession::receive`]; for an unexpected key [`ChunkError::Unexpected`].
    pub fn receive_expected(
        &mut self,
        frame: DataFrame<'_>,
        is_expected: impl FnOnce(ChunkKey) -> bool,
    ) -> Result<Event, PeerFault> {
        let DataFrame::Binary(bytes) = frame else { return Err(PeerFault::Text) };
        if bytes.starts_with(&chunk_codec::MAGIC) {
            return self.receive_chunk(bytes, is_expected);
        }
        let message = control::decode(bytes).map_err(|error| match error {
            ControlError::Version { theirs, ours } => {
                PeerFault::Rejected(Rejection::WrongVersion { client: ours, server: theirs })
            }
            other => other.into(),
        })?;
        match (message, &self.world) {
            (ServerMessage::Welcome(welcome), None) => {
                let digest = WorldDigest(welcome.digest);
                if let Some(expected) = self.expected.filter(|expected| *expected != digest) {
                    return Err(PeerFault::Rejected(Rejection::WrongWorld {
                        client: expected.0,
                        server: digest.0,
                    }));
                }
                let land = match self.delivery {
                    Delivery::Exact | Delivery::Quantised(_) | Delivery::Refined => None,
                    Delivery::SeedOnly => Some(own_land(&welcome)?),
                };
                self.world = Some(World { digest, land });
                Ok(Event::Welcome(welcome))
            }
            (ServerMessage::Welcome(_), Some(_)) => Err(PeerFault::OutOfOrder("a second Welcome")),
            (ServerMessage::Rejected(rejection), None) => Err(PeerFault::Rejected(rejection)),
            (ServerMessage::Draining { reconnect_after_ms }, _) => Ok(Event::Draining { reconnect_after_ms }),
            (_, None) => Err(PeerFault::OutOfOrder("a message before the Welcome")),
            (ServerMessage::Rejected(_), _) => Err(PeerFault::OutOfOrder("a rejection after the Welcome")),
            (ServerMessage::Settled(settled), _) => Ok(Event::Settled(settled)),
            (ServerMessage::Refused(refused), _) => Ok(Event::Refused(refused)),
        }
    }

    fn receive_chunk(
        &mut self,
        frame: &[u8],
        is_expected: impl FnOnce(ChunkKey) -> bool,
    ) -> Result<Event, PeerFault> {
        let world = self.world.as_ref().ok_or(PeerFault::OutOfOrder("a chunk before the Welcome"))?;
        self.credits = self.credits.checked_sub(1).ok_or(PeerFault::CreditOverrun)?;
        let (kind, key) = chunk_codec::kind_and_key(frame)?;
        let decoded = if is_expected(key) {
            self.decode(world, kind, key, frame)
        } else {
            Err(ChunkError::Unexpected(key))
        };
        if self.delivery == Delivery::Refined {
            let heights = || decoded.as_ref().ok().map(|(chunk, _)| chunk.heights.clone());
            self.references.insert(key, heights);
        }
        let (chunk, delivery) = decoded?;
        Ok(Event::Chunk { chunk: Box::new(chunk), bytes: frame.len(), delivery })
    }

    /// Decodes a chunk frame by its kind, as far as the delivery allows it.
    fn decode(
        &self,
        World { digest, land }: &World,
        kind: u8,
        key: ChunkKey,
        frame: &[u8],
    ) -> Result<(Chunk, Delivery), ChunkError> {
        // The exact decoder rejects every other kind. A generator exists in seed-only delivery
        // only.
        Ok(match (self.delivery, land) {
            (Delivery::SeedOnly, Some(land)) if kind == chunk_codec::KIND_SEED_ONLY => {
                (seed_only::decode(frame, land, digest)?, Delivery::SeedOnly)
            }
            (Delivery::Quantised(tolerance), _) if kind == chunk_codec::KIND_QUANTISED => {
                let chunk = quantised::decode(frame, digest, tolerance)?;
                (chunk, Delivery::Quantised(quantised::tolerance(frame).unwrap_or(tolerance)))
            }
            (Delivery::Refined, _) if kind == chunk_codec::KIND_REFINED => {
                let parent = self.references.parent_of(key).ok_or(ChunkError::Parent(key))?;
                (refined::decode_over(frame, digest, parent)?, Delivery::Refined)
            }
            _ => (chunk_codec::decode(frame, digest)?, Delivery::Exact),
        })
    }

    /// Sends a view.
    pub fn set_view(&mut self, view: View) {
        self.send(&ClientMessage::View(view));
    }

    /// Requests chunks by key. Returns the id of the first request: one is sent for every
    /// [`MAX_KEYS`] keys.
    pub fn request(&mut self, keys: &[ChunkKey]) -> u32 {
        let first = self.next_request;
        for part in keys.chunks(MAX_KEYS) {
            let id = self.next_request;
            self.next_request = self.next_request.wrapping_add(1);
            self.send(&ClientMessage::Request { id, keys: wire(part) });
        }
        first
    }

    /// Reports chunks that were dropped and may be needed again.
    pub fn release(&mut self, keys: &[ChunkKey]) {
        for part in keys.chunks(MAX_KEYS) {
            self.send(&ClientMessage::Release { keys: wire(part) });
        }
    }

    /// Reports chunks of this world that the client holds already, so that a new session does not
    /// send them again.
    pub fn holding(&mut self, keys: &[ChunkKey]) {
        for part in keys.chunks(MAX_KEYS) {
            self.send(&ClientMessage::Holding { keys: wire(part) });
        }
    }

    /// The world of the session, once welcomed.
    #[must_use]
    pub fn world(&self) -> Option<WorldDigest> {
        self.world.as_ref().map(|world| world.digest)
    }

    /// Chunks that the server may still send.
    #[must_use]
    pub const fn credits(&self) -> u32 {
        self.credits
    }

    fn send(&mut self, message: &ClientMessage) {
        // Cannot fail: texts were cut and key lists split to their limits.
        if let Ok(frame) = control::encode(message) {
            self.outbox.push_back(frame);
        }
    }
}

/// The announced land, if its digest here is the announced one. Takes some 30 milliseconds.
fn own_land(welcome: &Welcome) -> Result<Land, PeerFault> {
    let land = Land::new(welcome.world_seed);
    let (server, client) = (WorldDigest(welcome.digest), land.digest());
    if server != client {
        let (seed, generator) = (welcome.world_seed, welcome.generator_version);
        return Err(PeerFault::OtherGenerator { seed, generator, server, client });
    }
    Ok(land)
}

fn wire(keys: &[ChunkKey]) -> Vec<WireKey> {
    keys.iter().copied().map(WireKey::from).collect()
}

/// Cuts a text to the limit at a character border.
fn cut(mut text: String) -> String {
    text.truncate(text.floor_char_boundary(MAX_TEXT));
    text
}
