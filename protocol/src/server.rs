//! The server's side of a session, without IO.
//!
//! Feed it frames with [`ServerSession::receive`]; ask [`ServerSession::next_chunk`] what to make next and hand the
//! result to [`ServerSession::deliver`]; send what [`ServerSession::poll_transmit`] yields. It never asks for more
//! chunks than the client granted credits, and nothing in it grows beyond the limits.

use crate::Incoming;
use crate::control;
use crate::delivery::Delivery;
use crate::error::{ControlError, PeerFault};
use crate::limits::{MAX_CREDITS, MAX_HELD, MAX_PENDING_REQUESTS, MAX_TEXT, MAX_VIEW_CHUNKS};
use crate::message::{
    ClientMessage, Hello, RefusalReason, Refused, Rejection, ServerMessage, Welcome, WireKey,
};
use crate::view::View;
use bytes::Bytes;
use rustc_hash::{FxHashMap, FxHashSet};
use std::collections::VecDeque;
use terrain::constants::GENERATOR_VERSION;
use terrain::{ChunkKey, Land, WorldDigest, lod};

/// What a server offers to every session.
#[derive(Clone, Debug)]
pub struct ServerOffer {
    /// The world.
    pub land: Land,
    /// Its digest, computed once.
    pub digest: WorldDigest,
    /// Token that clients must present; none admits everybody.
    pub token: Option<String>,
    /// Name and version of the server.
    pub software: String,
}

/// A chunk to make and deliver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// The chunk.
    pub key: ChunkKey,
    /// The request that asked for it; none if the view needs it.
    pub request: Option<u32>,
    /// How urgent, larger is sooner; explicit requests rank above views.
    pub priority: u64,
}

/// Counts of what happened in a session, for metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionCounts {
    /// Chunks delivered.
    pub chunks: u64,
    /// Bytes of their frames.
    pub chunk_bytes: u64,
    /// Refusals sent.
    pub refusals: u64,
    /// Views accepted.
    pub views: u64,
}

/// One session, from the first frame to the close.
#[derive(Debug)]
pub struct ServerSession {
    offer: ServerOffer,
    session: u64,
    welcomed: bool,
    delivery: Delivery,
    credits: u32,
    /// Explicit requests that wait for credit, oldest first. At most [`MAX_PENDING_REQUESTS`]; more are refused.
    requests: VecDeque<(u32, ChunkKey)>,
    view: Option<ActiveView>,
    /// What the client has. At most [`MAX_HELD`]; dropped whole when full.
    held: FxHashSet<ChunkKey>,
    /// Asked for by [`ServerSession::next_chunk`] and not yet delivered, by the number of askings.
    in_flight: FxHashMap<ChunkKey, u32>,
    outbox: VecDeque<Bytes>,
    counts: SessionCounts,
}

/// The latest view and what it still needs.
#[derive(Debug)]
struct ActiveView {
    view: View,
    /// Chunks of the whole selection.
    chunks: u32,
    /// Not yet asked for, most urgent last.
    pending: Vec<(u64, ChunkKey)>,
    /// In how many views each pending chunk has been waiting.
    waited: FxHashMap<ChunkKey, u32>,
    settled: bool,
}

impl ServerSession {
    /// A session that waits for its handshake. `session` names it in logs and in the Welcome.
    #[must_use]
    pub fn new(offer: ServerOffer, session: u64) -> Self {
        Self {
            offer,
            session,
            welcomed: false,
            delivery: Delivery::default(),
            credits: 0,
            requests: VecDeque::new(),
            view: None,
            held: FxHashSet::default(),
            in_flight: FxHashMap::default(),
            outbox: VecDeque::new(),
            counts: SessionCounts::default(),
        }
    }

    /// Takes one frame from the client. Even after an error the outbox may hold a last message to send.
    ///
    /// # Errors
    /// The client broke the protocol or is not admitted: close with the fault's code.
    pub fn receive(&mut self, frame: Incoming<'_>) -> Result<(), PeerFault> {
        let Incoming::Binary(bytes) = frame else { return Err(PeerFault::Text) };
        let message = match control::decode(bytes) {
            Ok(message) => message,
            Err(ControlError::Version { theirs, ours }) => {
                return Err(self.reject(Rejection::WrongVersion { client: theirs, server: ours }));
            }
            Err(other) => return Err(other.into()),
        };
        match (message, self.welcomed) {
            (ClientMessage::Hello(hello), false) => self.welcome(&hello),
            (ClientMessage::Hello(_), true) => Err(PeerFault::OutOfOrder("a second Hello")),
            (_, false) => Err(PeerFault::OutOfOrder("a message before the Hello")),
            (ClientMessage::View(view), true) => {
                self.set_view(view);
                Ok(())
            }
            (ClientMessage::Credit { chunks }, true) => {
                self.credits = self.credits.saturating_add(chunks).min(MAX_CREDITS);
                Ok(())
            }
            (ClientMessage::Request { id, keys }, true) => {
                self.request(id, &keys);
                Ok(())
            }
            (ClientMessage::Release { keys }, true) => {
                for key in keys.into_iter().filter_map(|key| key.check().ok()) {
                    self.held.remove(&key);
                }
                Ok(())
            }
            (ClientMessage::Holding { keys }, true) => {
                for key in keys.into_iter().filter_map(|key| key.check().ok()) {
                    self.hold(key);
                }
                Ok(())
            }
        }
    }

    fn welcome(&mut self, hello: &Hello) -> Result<(), PeerFault> {
        let offer = &self.offer;
        if let Some(client) = hello.digest.filter(|digest| *digest != offer.digest.0) {
            let server = offer.digest.0;
            return Err(self.reject(Rejection::WrongWorld { client, server }));
        }
        if !token_matches(offer.token.as_deref(), hello.token.as_deref()) {
            return Err(self.reject(Rejection::Unauthorised));
        }
        let welcome = Welcome {
            session: self.session,
            world_seed: offer.land.world_seed(),
            generator_version: GENERATOR_VERSION,
            digest: offer.digest.0,
            max_credits: MAX_CREDITS,
            max_view_distance_m: lod::MAX_VIEW_DISTANCE_M,
            software: offer.software.clone(),
        };
        self.welcomed = true;
        self.delivery = hello.delivery;
        self.send(&ServerMessage::Welcome(welcome));
        Ok(())
    }

    fn reject(&mut self, rejection: Rejection) -> PeerFault {
        self.send(&ServerMessage::Rejected(rejection.clone()));
        PeerFault::Rejected(rejection)
    }

    fn set_view(&mut self, view: View) {
        if let Err(detail) = view.check() {
            self.refuse(view.id, None, RefusalReason::InvalidView, detail);
            return;
        }
        self.counts.views += 1;
        let waited_before = self.view.take().map(|old| old.waited).unwrap_or_default();
        let selection = lod::select(&self.offer.land, &view.viewer(), MAX_VIEW_CHUNKS);
        let chunks = selection.len() as u32;
        let mut waited = FxHashMap::default();
        let mut pending = Vec::new();
        for needed in selection {
            if self.held.contains(&needed.key) || self.in_flight.contains_key(&needed.key) {
                continue;
            }
            let views = waited_before.get(&needed.key).map_or(0, |views| views.saturating_add(1));
            waited.insert(needed.key, views);
            pending.push((view.priority(&needed, views), needed.key));
        }
        pending.sort_unstable();
        self.view = Some(ActiveView { view, chunks, pending, waited, settled: false });
        self.settle();
    }

    fn request(&mut self, id: u32, keys: &[WireKey]) {
        if self.requests.len() + keys.len() > MAX_PENDING_REQUESTS {
            let detail = format!(
                "{} requested chunks are waiting already, the limit is {MAX_PENDING_REQUESTS}",
                self.requests.len()
            );
            self.refuse(id, None, RefusalReason::TooManyRequests, detail);
            return;
        }
        for key in keys {
            match key.check() {
                Ok(valid) => self.requests.push_back((id, valid)),
                Err(error) => self.refuse(id, Some(*key), RefusalReason::OutsideWorld, error.to_string()),
            }
        }
    }

    /// The next chunk to make, if there is credit for one. Every chunk named here must come back through
    /// [`ServerSession::deliver`] or [`ServerSession::fail`].
    pub fn next_chunk(&mut self) -> Option<Wanted> {
        if self.credits == 0 {
            return None;
        }
        let wanted = match self.requests.pop_front() {
            Some((id, key)) => Wanted { key, request: Some(id), priority: u64::MAX },
            None => {
                let (priority, key) = self.view.as_mut()?.pending.pop()?;
                Wanted { key, request: None, priority }
            }
        };
        self.credits -= 1;
        *self.in_flight.entry(wanted.key).or_default() += 1;
        Some(wanted)
    }

    /// Takes a finished chunk frame, made for [`ServerSession::delivery`], and queues it for the client.
    pub fn deliver(&mut self, wanted: Wanted, frame: Bytes) {
        self.land(wanted.key);
        self.hold(wanted.key);
        self.counts.chunks += 1;
        self.counts.chunk_bytes += frame.len() as u64;
        self.outbox.push_back(frame);
        self.settle();
    }

    /// Reports that a wanted chunk cannot be had now; its credit is returned.
    pub fn fail(&mut self, wanted: Wanted, reason: RefusalReason, detail: String) {
        self.land(wanted.key);
        self.credits = self.credits.saturating_add(1).min(MAX_CREDITS);
        let id = wanted.request.or(self.view.as_ref().map(|active| active.view.id)).unwrap_or(0);
        self.refuse(id, Some(wanted.key.into()), reason, detail);
        self.settle();
    }

    /// Tells the client that the server is about to close.
    pub fn drain(&mut self, reconnect_after_ms: u32) {
        self.send(&ServerMessage::Draining { reconnect_after_ms });
    }

    /// The next frame to send, if any.
    pub fn poll_transmit(&mut self) -> Option<Bytes> {
        self.outbox.pop_front()
    }

    /// Whether the handshake is done.
    #[must_use]
    pub const fn is_welcomed(&self) -> bool {
        self.welcomed
    }

    /// How the client wants its chunks: one choice for the whole session, exact before the handshake.
    #[must_use]
    pub const fn delivery(&self) -> Delivery {
        self.delivery
    }

    /// Chunks that the client still allows.
    #[must_use]
    pub const fn credits(&self) -> u32 {
        self.credits
    }

    /// What happened so far.
    #[must_use]
    pub const fn counts(&self) -> SessionCounts {
        self.counts
    }

    fn land(&mut self, key: ChunkKey) {
        if let Some(count) = self.in_flight.get_mut(&key) {
            *count -= 1;
            if *count == 0 {
                self.in_flight.remove(&key);
            }
        }
    }

    fn hold(&mut self, key: ChunkKey) {
        if self.held.len() >= MAX_HELD {
            self.held.clear();
        }
        self.held.insert(key);
    }

    /// Announces a view once nothing of it is pending or under way.
    fn settle(&mut self) {
        let Some(active) = &mut self.view else { return };
        if active.settled || !active.pending.is_empty() || !self.in_flight.is_empty() {
            return;
        }
        active.settled = true;
        let (view, chunks) = (active.view.id, active.chunks);
        self.send(&ServerMessage::Settled { view, chunks });
    }

    fn refuse(&mut self, id: u32, key: Option<WireKey>, reason: RefusalReason, mut detail: String) {
        self.counts.refusals += 1;
        detail.truncate(detail.floor_char_boundary(MAX_TEXT));
        self.send(&ServerMessage::Refused(Refused { id, key, reason, detail }));
    }

    fn send(&mut self, message: &ServerMessage) {
        // Cannot fail: texts are cut before they get here.
        if let Ok(frame) = control::encode(message) {
            self.outbox.push_back(frame);
        }
    }
}

/// Whether a presented token satisfies a requirement; none required admits everybody.
///
/// Compares without stopping at the first difference, so that timing tells nothing about the secret.
#[must_use]
pub fn token_matches(required: Option<&str>, presented: Option<&str>) -> bool {
    let Some(required) = required else { return true };
    // blake3 hashes compare in constant time.
    presented.is_some_and(|presented| blake3::hash(presented.as_bytes()) == blake3::hash(required.as_bytes()))
}
