//! The client's side of a session, without IO.
//!
//! Feed it frames with [`ClientSession::receive`], send what [`ClientSession::poll_transmit`]
//! yields, and act on the events. It grants credits by itself: a fixed window, refilled when half
//! of it is used, so that the server never owes more than the window and grants cost little.

use crate::Incoming;
use crate::chunk_codec;
use crate::chunk_codec::{quantised, refined, seed_only};
use crate::control;
use crate::delivery::Delivery;
use crate::error::{ChunkError, ControlError, PeerFault};
use crate::limits::{MAX_CREDITS, MAX_KEYS, MAX_TEXT};
use crate::message::{ClientMessage, Hello, Refused, Rejection, ServerMessage, Welcome, WireKey};
use crate::parents::Parents;
use crate::view::View;
use bytes::Bytes;
use std::collections::VecDeque;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

/// What a client brings to a session.
#[derive(Clone, Debug)]
pub struct ClientConfig {
    /// The world to insist on; none accepts any.
    pub digest: Option<WorldDigest>,
    /// How chunks are to come.
    pub delivery: Delivery,
    /// Access token, where the server asks for one.
    pub token: Option<String>,
    /// Name and version for the server's logs; cut to [`MAX_TEXT`] bytes.
    pub software: String,
    /// Chunks that may be under way at once, 1 to [`MAX_CREDITS`].
    pub window: u32,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The handshake succeeded.
    Welcome(Welcome),
    /// A chunk arrived, or was generated from what arrived, and was verified against the digest in
    /// its frame.
    Chunk {
        /// The chunk.
        chunk: Box<Chunk>,
        /// Bytes of its frame.
        bytes: usize,
        /// What its frame was: [`Delivery::SeedOnly`] means that the chunk was generated here.
        delivery: Delivery,
    },
    /// Every chunk of a view has been sent.
    Settled {
        /// The view's id.
        view: u32,
        /// Chunks that the view needs.
        chunks: u32,
    },
    /// Something asked for is not delivered.
    Refused(Refused),
    /// The server is about to close.
    Draining {
        /// Delay before reconnecting, milliseconds.
        reconnect_after_ms: u32,
    },
}

/// What the Welcome fixes for the rest of a session.
#[derive(Clone, Debug)]
struct World {
    digest: WorldDigest,
    /// In seed-only delivery: what generates the chunks here. Its digest is the one above.
    land: Option<Land>,
}

/// One session, from the first frame to the close.
#[derive(Debug)]
pub struct ClientSession {
    /// Set by the Welcome; before it nothing but the handshake may arrive.
    world: Option<World>,
    expected: Option<WorldDigest>,
    delivery: Delivery,
    window: u32,
    /// Granted and not yet used.
    credits: u32,
    next_request: u32,
    /// In refined delivery: heights of what later frames may refine.
    parents: Parents<Box<[i32; VERTEX_COUNT]>>,
    /// Frames to send. Bounded by what the caller asks between two polls.
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
            parents: Parents::default(),
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

    /// The next frame to send, if any. Grants new credit when half of the window is used: it counts
    /// from here, since a server cannot use what was never sent.
    pub fn poll_transmit(&mut self) -> Option<Bytes> {
        if self.credits <= self.window / 2 && self.world.is_some() {
            let chunks = self.window - self.credits;
            self.credits = self.window;
            self.send(&ClientMessage::Credit { chunks });
        }
        self.outbox.pop_front()
    }

    /// Takes one frame from the server.
    ///
    /// # Errors
    /// The server broke the protocol or refused the session: close with the fault's code.
    pub fn receive(&mut self, frame: Incoming<'_>) -> Result<Event, PeerFault> {
        let Incoming::Binary(bytes) = frame else { return Err(PeerFault::Text) };
        if bytes.starts_with(&chunk_codec::MAGIC) {
            return self.receive_chunk(bytes);
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
            (ServerMessage::Settled { view, chunks }, _) => Ok(Event::Settled { view, chunks }),
            (ServerMessage::Refused(refused), _) => Ok(Event::Refused(refused)),
        }
    }

    fn receive_chunk(&mut self, frame: &[u8]) -> Result<Event, PeerFault> {
        let World { digest, land } =
            self.world.as_ref().ok_or(PeerFault::OutOfOrder("a chunk before the Welcome"))?;
        self.credits = self.credits.checked_sub(1).ok_or(PeerFault::CreditOverrun)?;
        let (kind, key) = chunk_codec::kind_and_key(frame)?;
        // What a client has not asked for the exact decoder refuses by kind; a land of its own it
        // has only for seed-only frames.
        let (chunk, delivery) = match (self.delivery, land) {
            (Delivery::SeedOnly, Some(land)) if kind == chunk_codec::KIND_SEED_ONLY => {
                (seed_only::decode(frame, land, digest)?, Delivery::SeedOnly)
            }
            (Delivery::Quantised(asked), _) if kind == chunk_codec::KIND_QUANTISED => {
                let chunk = quantised::decode(frame, digest, asked)?;
                (chunk, Delivery::Quantised(quantised::tolerance(frame).unwrap_or(asked)))
            }
            (Delivery::Refined, _) if kind == chunk_codec::KIND_REFINED => {
                let parent = self.parents.of(key).ok_or(ChunkError::Parent(key))?;
                (refined::decode_over(frame, digest, parent)?, Delivery::Refined)
            }
            _ => (chunk_codec::decode(frame, digest)?, Delivery::Exact),
        };
        if self.delivery == Delivery::Refined {
            self.parents.remember(key, || chunk.heights.clone());
        }
        Ok(Event::Chunk { chunk: Box::new(chunk), bytes: frame.len(), delivery })
    }

    /// Says what the client sees now.
    pub fn set_view(&mut self, view: View) {
        self.send(&ClientMessage::View(view));
    }

    /// Asks for chunks by key. Returns the id of the first of the requests made: one for every
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

    /// Says that chunks were dropped and may be needed again.
    pub fn release(&mut self, keys: &[ChunkKey]) {
        for part in keys.chunks(MAX_KEYS) {
            self.send(&ClientMessage::Release { keys: wire(part) });
        }
    }

    /// Says that chunks of this world are already here, so that a new session does not send them
    /// again.
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
        // Cannot fail: texts are cut and key lists are split before they get here.
        if let Ok(frame) = control::encode(message) {
            self.outbox.push_back(frame);
        }
    }
}

/// The announced land, if generation here makes the announced world of it. Takes about a
/// millisecond.
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
