//! The server's side of a session, without IO.
//!
//! Feed it frames with [`ServerSession::receive`]; ask [`ServerSession::next_chunk`] what to make
//! next and hand the result to [`ServerSession::deliver`]; send what
//! [`ServerSession::poll_transmit`] yields. It never asks for more chunks than the client granted
//! credits, and nothing in it grows beyond the limits.

use crate::Incoming;
use crate::chunk_codec;
use crate::control;
use crate::delivery::Delivery;
use crate::error::{ControlError, PeerFault};
use crate::limits::{
    MAX_CHUNK_FRAME, MAX_CREDIT_BYTES, MAX_CREDITS, MAX_HELD, MAX_PENDING_REQUESTS, MAX_TEXT,
    MAX_VIEW_ESTIMATE, SEED_ONLY_FRAME,
};
use crate::message::{
    ClientMessage, Hello, RefusalReason, Refused, Rejection, ServerMessage, Welcome, WireKey,
};
use crate::parents::Parents;
use crate::view::View;
use crate::view_selection::{Selected, ViewSelection};
use bytes::Bytes;
use rustc_hash::{FxHashMap, FxHashSet};
use std::borrow::Cow;
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

/// What a session does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Nothing is wanted, or there is no credit for it.
    Nothing,
    /// A ready chunk was queued for the client.
    Delivered,
    /// A chunk is to be made, and its frame for this delivery: that of the session, or exact where
    /// the session's cannot serve.
    Make(Wanted, Delivery),
}

/// Counts of what happened in a session, for metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionCounts {
    /// Chunks delivered.
    pub chunks: u64,
    /// Bytes of their frames.
    pub chunk_bytes: u64,
    /// Refusals sent, by [`RefusalReason::index`].
    pub refusals: [u64; RefusalReason::ALL.len()],
    /// Views selected.
    pub views: u64,
    /// Views replaced by a newer one before they were selected.
    pub superseded_views: u64,
}

/// One session, from the first frame to the close.
#[derive(Debug)]
pub struct ServerSession {
    offer: ServerOffer,
    session: u64,
    welcomed: bool,
    delivery: Delivery,
    credits: u32,
    /// Bytes of chunk frames that the client still allows, less what is reserved for chunks under
    /// way; none while it counts chunks only.
    credit_bytes: Option<u32>,
    /// Explicit requests that wait for credit, oldest first. At most [`MAX_PENDING_REQUESTS`], more
    /// are refused; and what was put back.
    requests: VecDeque<(u32, ChunkKey)>,
    view: Option<ActiveView>,
    /// The newest view that is not selected yet. A newer one replaces it.
    queued_view: Option<View>,
    /// Whether a selection was taken and not given back.
    is_selecting: bool,
    /// What the client has. At most [`MAX_HELD`]; dropped whole when full.
    held: FxHashSet<ChunkKey>,
    /// In refined delivery: what the client remembers, and what may be refined for it.
    parents: Parents<()>,
    /// Asked for by [`ServerSession::next_chunk`] and not yet delivered.
    in_flight: FxHashMap<ChunkKey, UnderWay>,
    /// Of these, what no view or request wants any more since the last
    /// [`ServerSession::take_stale`].
    stale: Vec<ChunkKey>,
    outbox: VecDeque<Bytes>,
    counts: SessionCounts,
}

/// What was asked for and is being made.
#[derive(Clone, Copy, Debug)]
struct UnderWay {
    /// How often: a view and several requests may want the same chunk.
    askings: u32,
    /// The request that asked last; none if it was the view.
    request: Option<u32>,
}

/// The latest view and what it still needs.
#[derive(Debug)]
struct ActiveView {
    view: View,
    /// Chunks of the whole selection.
    chunks: u32,
    /// Not yet requested, most urgent last. May hold chunks that the client has or that are in
    /// flight.
    pending: Vec<(u64, ChunkKey)>,
    /// Not needed yet but soon, most urgent last; requested when the view is settled.
    ahead: Vec<(u64, ChunkKey)>,
    /// In how many views each pending chunk has been waiting.
    waited: FxHashMap<ChunkKey, u32>,
    settled: bool,
}

impl ActiveView {
    /// The next chunk to request: one that is needed, and once all of those were sent, one that
    /// will be.
    fn next(&mut self, is_known: impl Fn(&ChunkKey) -> bool) -> Option<(u64, ChunkKey)> {
        while let Some((priority, key)) = self.pending.pop() {
            if !is_known(&key) {
                return Some((priority, key));
            }
        }
        while self.settled
            && let Some((_, key)) = self.ahead.pop()
        {
            if !is_known(&key) {
                return Some((0, key));
            }
        }
        None
    }
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
            credit_bytes: None,
            stale: Vec::new(),
            requests: VecDeque::new(),
            view: None,
            queued_view: None,
            is_selecting: false,
            held: FxHashSet::default(),
            parents: Parents::default(),
            in_flight: FxHashMap::default(),
            outbox: VecDeque::new(),
            counts: SessionCounts::default(),
        }
    }

    /// Takes one frame from the client. Even after an error the outbox may hold a last message to
    /// send.
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
                if self.is_valid_credit(chunks, MAX_CREDITS) {
                    self.credits = self.credits.saturating_add(chunks).min(MAX_CREDITS);
                }
                Ok(())
            }
            (ClientMessage::CreditBytes { bytes }, true) => {
                if self.is_valid_credit(bytes, MAX_CREDIT_BYTES) {
                    self.grant_bytes(bytes);
                }
                Ok(())
            }
            (ClientMessage::Cancel { id }, true) => {
                self.cancel(id);
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
                self.settle();
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
        let estimate = lod::estimated_chunks(&view.viewer());
        if estimate > MAX_VIEW_ESTIMATE {
            let detail = format!(
                "the view needs about {estimate} chunks, the limit is {MAX_VIEW_ESTIMATE}; raise the tolerance or \
                 lower the view distance"
            );
            self.refuse(view.id, None, RefusalReason::InvalidView, detail);
            return;
        }
        self.counts.superseded_views += u64::from(self.queued_view.replace(view).is_some());
    }

    /// Whether a view waits for its selection.
    #[must_use]
    pub const fn has_queued_view(&self) -> bool {
        self.queued_view.is_some()
    }

    /// The selection of the newest view, to be run by a worker; none if no view waits or one is
    /// being selected. It must come back through [`ServerSession::apply_view`].
    pub fn take_view(&mut self) -> Option<ViewSelection> {
        if self.is_selecting {
            return None;
        }
        let view = self.queued_view.take()?;
        self.is_selecting = true;
        let waited = self.view.as_mut().map(|old| std::mem::take(&mut old.waited)).unwrap_or_default();
        Some(ViewSelection::new(&self.offer.land, view, waited))
    }

    /// Takes back a selection: its view replaces the active one. A selection that is not done is
    /// finished here.
    pub fn apply_view(&mut self, selection: ViewSelection) {
        self.is_selecting = false;
        self.counts.views += 1;
        let (view, selected) = selection.finish(&self.offer.land);
        let Selected { chunks, keys, needed, ahead, waited } = selected;
        self.find_stale(|key, request| request.is_none() && !keys.contains(&key));
        self.view = Some(ActiveView { view, chunks, pending: needed, ahead, waited, settled: false });
        self.settle();
    }

    /// Judges a grant; refuses one of nothing and one beyond what may be outstanding.
    fn is_valid_credit(&mut self, granted: u32, most: u32) -> bool {
        let is_valid = (1..=most).contains(&granted);
        if !is_valid {
            self.refuse(
                0,
                None,
                RefusalReason::InvalidCredit,
                format!("a grant of {granted} is not within 1 to {most}"),
            );
        }
        is_valid
    }

    fn grant_bytes(&mut self, bytes: u32) {
        let before = match self.credit_bytes {
            Some(bytes) => bytes,
            // From here on bytes are counted, and what is under way already counts too.
            None => {
                let askings = self.in_flight.values().map(|under_way| under_way.askings).sum::<u32>();
                let under_way = askings.saturating_mul(self.frame_bound());
                self.credit_bytes = Some(bytes.saturating_sub(under_way));
                return;
            }
        };
        self.credit_bytes = Some(before.saturating_add(bytes).min(MAX_CREDIT_BYTES));
    }

    /// Bytes reserved for a chunk whose frame is not made yet.
    const fn frame_bound(&self) -> u32 {
        match self.delivery {
            Delivery::SeedOnly => SEED_ONLY_FRAME as u32,
            _ => MAX_CHUNK_FRAME as u32,
        }
    }

    fn cancel(&mut self, id: u32) {
        self.requests.retain(|(request, _)| *request != id);
        self.find_stale(|_, request| request == Some(id));
    }

    /// Notes what is under way for one asking only, of which `is_stale` says that it is not wanted
    /// any more.
    fn find_stale(&mut self, is_stale: impl Fn(ChunkKey, Option<u32>) -> bool) {
        let stale =
            self.in_flight.iter().filter(|(key, asked)| asked.askings == 1 && is_stale(**key, asked.request));
        self.stale.extend(stale.map(|(key, _)| *key));
    }

    /// Chunks under way that are no longer wanted, each once. Whoever makes them may stop, and says
    /// so by [`ServerSession::withdraw`]; what is made all the same must be delivered.
    pub fn take_stale(&mut self) -> Vec<ChunkKey> {
        std::mem::take(&mut self.stale)
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
        let mut seen = FxHashSet::default();
        for key in keys {
            match key.check() {
                Ok(valid) if keys.len() > 1 && !seen.insert(valid) => {
                    self.refuse(id, Some(*key), RefusalReason::Duplicate, "named twice in one request");
                }
                Ok(valid) => self.requests.push_back((id, valid)),
                Err(error) => self.refuse(id, Some(*key), RefusalReason::OutsideWorld, error.to_string()),
            }
        }
    }

    /// Refuses waiting requests as overloaded until at most `keep` are left, the latest first:
    /// those that came first have the best chance to be answered in time. Requests that wait for
    /// credit alone should not be shed; see [`ServerSession::credits`].
    pub fn shed(&mut self, keep: usize) {
        while self.requests.len() > keep {
            let Some((id, key)) = self.requests.pop_back() else { return };
            self.refuse(
                id,
                Some(key.into()),
                RefusalReason::Overloaded,
                "too much is waiting, ask again later",
            );
        }
    }

    /// Requested chunks that wait for credit or for their turn.
    #[must_use]
    pub fn waiting_requests(&self) -> usize {
        self.requests.len()
    }

    /// Whether the client allows one more chunk.
    fn has_credit(&self) -> bool {
        self.credits > 0 && self.credit_bytes.is_none_or(|bytes| bytes >= self.frame_bound())
    }

    /// The next chunk to make, if there is credit for one, and for which delivery its frame is to
    /// be: that of the session, or exact where the session's cannot serve. Every chunk named here
    /// must come back through [`ServerSession::deliver`], [`ServerSession::fail`] or
    /// [`ServerSession::withdraw`].
    pub fn next_chunk(&mut self) -> Option<(Wanted, Delivery)> {
        match self.next_chunk_with(|_, _| None) {
            Next::Make(wanted, delivery) => Some((wanted, delivery)),
            Next::Nothing | Next::Delivered => None,
        }
    }

    /// As [`ServerSession::next_chunk`], but first looks whether the chunk's frame is `ready`, made
    /// for the delivery that it is asked with; if so, queues it for the client.
    pub fn next_chunk_with(&mut self, ready: impl FnOnce(ChunkKey, Delivery) -> Option<Bytes>) -> Next {
        if !self.has_credit() {
            return Next::Nothing;
        }
        let wanted = match self.requests.pop_front() {
            Some((id, key)) => Wanted { key, request: Some(id), priority: u64::MAX },
            None => {
                let Self { view, held, in_flight, .. } = &mut *self;
                let is_known = |key: &ChunkKey| held.contains(key) || in_flight.contains_key(key);
                match view.as_mut().and_then(|active| active.next(is_known)) {
                    Some((priority, key)) => Wanted { key, request: None, priority },
                    None => {
                        // The client may hold what was pending.
                        self.settle();
                        return Next::Nothing;
                    }
                }
            }
        };
        self.credits -= 1;
        let bound = self.frame_bound();
        if let Some(bytes) = &mut self.credit_bytes {
            *bytes -= bound;
        }
        let form = self.form_of(wanted.key);
        if let Some(frame) = ready(wanted.key, form) {
            self.send_chunk(wanted.key, frame);
            return Next::Delivered;
        }
        let under_way =
            self.in_flight.entry(wanted.key).or_insert(UnderWay { askings: 0, request: wanted.request });
        under_way.askings += 1;
        under_way.request = wanted.request;
        Next::Make(wanted, form)
    }

    /// How a chunk is to go: in the delivery of the session, but in refined delivery exact if the
    /// client does not remember its parent.
    fn form_of(&self, key: ChunkKey) -> Delivery {
        match self.delivery {
            Delivery::Refined if self.parents.of(key).is_none() => Delivery::Exact,
            delivery => delivery,
        }
    }

    /// Takes a finished chunk frame, made for the delivery that it was asked with, and queues it
    /// for the client.
    pub fn deliver(&mut self, wanted: Wanted, frame: Bytes) {
        self.land(wanted.key);
        let is_refined =
            chunk_codec::kind_and_key(&frame).is_ok_and(|(kind, _)| kind == chunk_codec::KIND_REFINED);
        if is_refined && self.form_of(wanted.key) != Delivery::Refined {
            // While it was made the client has forgotten the parent: once more, exact.
            self.return_credit();
            self.put_back(wanted);
        } else {
            self.send_chunk(wanted.key, frame);
        }
    }

    /// Wants a chunk again, before all others that wait.
    fn put_back(&mut self, wanted: Wanted) {
        match (wanted.request, &mut self.view) {
            (Some(id), _) => self.requests.push_front((id, wanted.key)),
            (None, Some(active)) => active.pending.push((wanted.priority, wanted.key)),
            // No view is ever taken back.
            (None, None) => {}
        }
    }

    /// Queues a chunk whose credit is taken.
    fn send_chunk(&mut self, key: ChunkKey, frame: Bytes) {
        self.return_bytes(self.frame_bound().saturating_sub(frame.len() as u32));
        self.hold(key);
        if self.delivery == Delivery::Refined {
            self.parents.remember(key, || ());
        }
        self.counts.chunks += 1;
        self.counts.chunk_bytes += frame.len() as u64;
        self.outbox.push_back(frame);
        self.settle();
    }

    /// Takes back a stale chunk that nobody makes; its credit is returned, and the client is told
    /// nothing.
    pub fn withdraw(&mut self, wanted: Wanted) {
        self.land(wanted.key);
        self.return_credit();
        self.settle();
    }

    fn return_credit(&mut self) {
        self.credits = self.credits.saturating_add(1).min(MAX_CREDITS);
        self.return_bytes(self.frame_bound());
    }

    fn return_bytes(&mut self, unused: u32) {
        if let Some(bytes) = &mut self.credit_bytes {
            *bytes = bytes.saturating_add(unused).min(MAX_CREDIT_BYTES);
        }
    }

    /// Reports that a wanted chunk cannot be had now; its credit is returned.
    pub fn fail(&mut self, wanted: Wanted, reason: RefusalReason, detail: impl Into<Cow<'static, str>>) {
        self.land(wanted.key);
        self.return_credit();
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

    /// What the client sees, by its latest accepted view; none until it says.
    #[must_use]
    pub fn view(&self) -> Option<&View> {
        self.view.as_ref().map(|active| &active.view)
    }

    /// Whether the handshake is done.
    #[must_use]
    pub const fn is_welcomed(&self) -> bool {
        self.welcomed
    }

    /// How the client wants its chunks: one choice for the whole session, exact before the
    /// handshake.
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
        if let Some(under_way) = self.in_flight.get_mut(&key) {
            under_way.askings -= 1;
            if under_way.askings == 0 {
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

    /// Announces a view once nothing of it is pending or in flight.
    fn settle(&mut self) {
        let Some(active) = &mut self.view else { return };
        if active.settled || !self.in_flight.is_empty() {
            return;
        }
        while let Some((_, key)) = active.pending.last() {
            if !self.held.contains(key) {
                return;
            }
            active.pending.pop();
        }
        active.settled = true;
        let (view, chunks) = (active.view.id, active.chunks);
        self.send(&ServerMessage::Settled { view, chunks });
    }

    fn refuse(
        &mut self,
        id: u32,
        key: Option<WireKey>,
        reason: RefusalReason,
        detail: impl Into<Cow<'static, str>>,
    ) {
        self.counts.refusals[reason.index()] += 1;
        let mut detail = detail.into();
        if detail.len() > MAX_TEXT {
            let end = detail.floor_char_boundary(MAX_TEXT);
            detail.to_mut().truncate(end);
        }
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
/// Compares without stopping at the first difference, so that timing tells nothing about the
/// secret.
#[must_use]
pub fn token_matches(required: Option<&str>, presented: Option<&str>) -> bool {
    let Some(required) = required else { return true };
    // blake3 hashes compare in constant time.
    presented.is_some_and(|presented| blake3::hash(presented.as_bytes()) == blake3::hash(required.as_bytes()))
}
