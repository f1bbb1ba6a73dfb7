use super::ServerOffer;
use super::view_queue::ViewQueue;
use super::view_selection::ViewSelection;
use crate::DataFrame;
use crate::chunk_codec;
use crate::control;
use crate::delivery::Delivery;
use crate::error::ControlError;
use crate::fault::PeerFault;
use crate::held_chunks::HeldChunks;
use crate::limits::{
    MAX_CHUNK_FRAME, MAX_CREDIT_BYTES, MAX_CREDITS, MAX_PENDING_REQUESTS, MAX_TEXT, MAX_VIEW_ESTIMATE,
    SEED_ONLY_FRAME,
};
use crate::message::{
    ClientMessage, Hello, RefusalReason, Refused, Rejection, ServerMessage, Settled, Welcome, WireKey,
};
use crate::reference_window::ReferenceWindow;
use crate::view::View;
use bytes::Bytes;
use std::borrow::Cow;
use std::collections::{HashMap, HashSet, VecDeque};
use terrain::constants::GENERATOR_VERSION;
use terrain::{ChunkKey, lod};

/// A chunk to generate and deliver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkRequest {
    /// The chunk.
    pub key: ChunkKey,
    /// The id of the client's explicit request; none if the view needs the chunk.
    pub request: Option<u32>,
    /// Priority, larger is sooner; explicit requests rank above views.
    pub priority: u64,
}

/// The next action of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// No chunk is needed, or there is no credit for one.
    Nothing,
    /// A ready chunk was queued for the client.
    Delivered,
    /// A chunk must be generated and encoded for this delivery: that of the session, or exact where
    /// the session's is not possible.
    Generate(ChunkRequest, Delivery),
}

/// Counters of a session, for metrics.
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
    /// Chunks of explicit requests whose generation was cancelled.
    pub cancelled: u64,
}

/// One session, from the first frame to the close.
#[derive(Debug)]
pub struct ServerSession {
    offer: ServerOffer,
    session: u64,
    welcomed: bool,
    delivery: Delivery,
    credits: u32,
    /// Bytes of chunk frames that the client still allows, less the reservations of chunks in
    /// flight: below 0 where the first grant did not cover these. None while it counts chunks only.
    credit_bytes: Option<i64>,
    /// Explicit requests that wait for credit, oldest first: at most [`MAX_PENDING_REQUESTS`] and
    /// the requeued ones. Further ones are refused.
    requests: VecDeque<(u32, ChunkKey)>,
    views: ViewQueue,
    /// Chunks that the client has; cleared when full.
    held: HeldChunks,
    /// In refined delivery: the parents that frames may refer to.
    references: ReferenceWindow<()>,
    /// Returned by [`ServerSession::next_chunk`] and not yet delivered.
    in_flight: HashMap<ChunkKey, InFlight>,
    /// Chunks in flight that no view or request needs any more, since the last
    /// [`ServerSession::take_stale`].
    stale: Vec<ChunkKey>,
    outbox: VecDeque<Bytes>,
    counts: SessionCounts,
}

/// A chunk in flight.
#[derive(Clone, Copy, Debug)]
struct InFlight {
    /// Number of requests: a view and several explicit requests may need the same chunk.
    requests: u32,
    /// The latest explicit request; none if the latest was the view.
    latest: Option<u32>,
    /// Whether it was reported as stale since the latest request.
    is_stale: bool,
    /// The priority of the chunk in the active view, if the view waits for these requests instead of
    /// requesting it. If they end without the chunk, the view does.
    view: Option<u64>,
}

impl ServerSession {
    /// A session before its handshake. `session` is its id in logs and in the Welcome.
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
            views: ViewQueue::default(),
            held: HeldChunks::default(),
            references: ReferenceWindow::default(),
            in_flight: HashMap::default(),
            outbox: VecDeque::new(),
            counts: SessionCounts::default(),
        }
    }

    /// Processes one frame from the client. After an error the outbox may still hold a last message
    /// to send.
    ///
    /// # Errors
    /// A protocol violation or a rejected handshake: close with the fault's code.
    pub fn receive(&mut self, frame: DataFrame<'_>) -> Result<(), PeerFault> {
        let DataFrame::Binary(bytes) = frame else { return Err(PeerFault::Text) };
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
                    self.held.remove(key);
                }
                Ok(())
            }
            (ClientMessage::Holding { keys }, true) => {
                for key in keys.into_iter().filter_map(|key| key.check().ok()) {
                    self.held.insert(key);
                }
                self.settle();
                Ok(())
            }
        }
    }

    fn welcome(&mut self, hello: &Hello) -> Result<(), PeerFault> {
        let offer = &self.offer;
        // First: a client without a token learns nothing, not even the world.
        if offer.token.as_ref().is_some_and(|token| !token.admits(hello.token.as_deref())) {
            return Err(self.reject(Rejection::Unauthorised));
        }
        if let Some(client) = hello.digest.filter(|digest| *digest != offer.digest.0) {
            let server = offer.digest.0;
            return Err(self.reject(Rejection::WrongWorld { client, server }));
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
                "the view needs about {estimate} chunks, the limit is {MAX_VIEW_ESTIMATE}; \
                 raise the tolerance or lower the view distance"
            );
            self.refuse(view.id, None, RefusalReason::InvalidView, detail);
            return;
        }
        self.counts.superseded_views += u64::from(self.views.queue(view));
    }

    /// Whether [`ServerSession::take_view`] would return a view.
    #[must_use]
    pub const fn has_waiting_view(&self) -> bool {
        self.views.can_take()
    }

    /// Whether a chunk is needed that the client has credit for. If none is needed, this may announce
    /// that the view is complete.
    pub fn has_next_chunk(&mut self) -> bool {
        if !self.has_credit() {
            return false;
        }
        let Self { requests, views, held, in_flight, .. } = &mut *self;
        let is_known = |key: ChunkKey, needed: Option<u64>| {
            if held.contains(key) {
                return true;
            }
            let Some(in_flight) = in_flight.get_mut(&key) else { return false };
            in_flight.view = in_flight.view.or(needed);
            true
        };
        let has_next = !requests.is_empty() || views.has_next(is_known);
        if !has_next {
            // The client may hold all pending chunks.
            self.settle();
        }
        has_next
    }

    /// The selection of the newest view, for a worker to run; none if no view waits or a selection
    /// is running. It must end in [`ServerSession::apply_view`] or [`ServerSession::fail_view`].
    pub fn take_view(&mut self) -> Option<ViewSelection> {
        self.views.take(&self.offer.land)
    }

    /// Applies a selection: its view replaces the active one. An unfinished selection is finished
    /// here.
    pub fn apply_view(&mut self, selection: ViewSelection) {
        self.counts.views += 1;
        let keys = self.views.apply(selection, &self.offer.land);
        // The chunks that the new view needs are all pending.
        self.in_flight.values_mut().for_each(|in_flight| in_flight.view = None);
        self.find_stale(|key, request| request.is_none() && !keys.contains(&key));
        self.settle();
    }

    /// Gives up the selection that is running: its view is refused as failed, and the view before
    /// it stays active.
    pub fn fail_view(&mut self, detail: impl Into<Cow<'static, str>>) {
        if let Some(id) = self.views.fail() {
            self.refuse(id, None, RefusalReason::Failed, detail);
        }
    }

    /// Checks a grant. Refuses zero, and more than may be outstanding.
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
        // Bytes are counted from the first grant on; chunks in flight count too.
        let before = self.credit_bytes.unwrap_or_else(|| {
            let requests: u32 = self.in_flight.values().map(|in_flight| in_flight.requests).sum();
            -(i64::from(requests) * i64::from(self.frame_bound()))
        });
        self.credit_bytes = Some((before + i64::from(bytes)).min(i64::from(MAX_CREDIT_BYTES)));
    }

    /// Bytes reserved for a chunk whose frame is not encoded yet.
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

    /// Marks the chunks in flight for a single request, and for no view beside it, that `is_stale`
    /// selects. Each is marked once, however often its request is cancelled: looking it up takes the
    /// lock of all sessions.
    fn find_stale(&mut self, is_stale: impl Fn(ChunkKey, Option<u32>) -> bool) {
        for (key, in_flight) in &mut self.in_flight {
            let is_single = in_flight.requests == 1 && in_flight.view.is_none();
            if is_single && !in_flight.is_stale && is_stale(*key, in_flight.latest) {
                in_flight.is_stale = true;
                self.stale.push(*key);
            }
        }
    }

    /// Chunks in flight that are no longer needed, each once. Their generation may be cancelled and
    /// reported by [`ServerSession::withdraw`]; a chunk that was generated must be delivered.
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
        let mut seen = HashSet::new();
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

    /// Load shedding: refuses waiting requests as overloaded until at most `keep` are left, the
    /// latest first, because the oldest are the most likely to be answered in time. Requests that
    /// wait for credit only should not be shed; see [`ServerSession::credits`].
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

    /// Explicit requests that wait for credit, or for a place among the chunks in generation.
    #[must_use]
    pub fn waiting_requests(&self) -> usize {
        self.requests.len()
    }

    /// Whether the client allows one more chunk.
    fn has_credit(&self) -> bool {
        self.credits > 0 && self.credit_bytes.is_none_or(|bytes| bytes >= i64::from(self.frame_bound()))
    }

    /// The next chunk to generate, if there is credit for one, and the delivery to encode it for:
    /// that of the session, or exact where the session's is not possible. Every chunk returned here
    /// must be completed by [`ServerSession::deliver`], [`ServerSession::fail`] or
    /// [`ServerSession::withdraw`].
    pub fn next_chunk(&mut self) -> Option<(ChunkRequest, Delivery)> {
        match self.next_chunk_with(|_, _| None) {
            Next::Generate(request, delivery) => Some((request, delivery)),
            Next::Nothing | Next::Delivered => None,
        }
    }

    /// As [`ServerSession::next_chunk`], but first calls `ready` for a frame that exists already in
    /// the given delivery; if there is one, queues it for the client.
    pub fn next_chunk_with(&mut self, ready: impl FnOnce(ChunkKey, Delivery) -> Option<Bytes>) -> Next {
        if !self.has_next_chunk() {
            return Next::Nothing;
        }
        let requested = self.requests.pop_front();
        let requested =
            requested.map(|(id, key)| ChunkRequest { key, request: Some(id), priority: u64::MAX });
        let pending = || {
            let (priority, key) = self.views.next()?;
            Some(ChunkRequest { key, request: None, priority })
        };
        let Some(request) = requested.or_else(pending) else { return Next::Nothing };
        self.credits -= 1;
        let bound = self.frame_bound();
        if let Some(bytes) = &mut self.credit_bytes {
            *bytes -= i64::from(bound);
        }
        let delivery = self.delivery_of(request.key);
        if let Some(frame) = ready(request.key, delivery) {
            self.send_chunk(request.key, frame);
            return Next::Delivered;
        }
        let (requests, view) =
            self.in_flight.get(&request.key).map_or((0, None), |known| (known.requests, known.view));
        let in_flight = InFlight { requests: requests + 1, latest: request.request, is_stale: false, view };
        self.in_flight.insert(request.key, in_flight);
        Next::Generate(request, delivery)
    }

    /// The delivery of one chunk: that of the session, but exact instead of refined if the chunk's
    /// parent is not in the reference window.
    fn delivery_of(&self, key: ChunkKey) -> Delivery {
        match self.delivery {
            Delivery::Refined if self.references.parent_of(key).is_none() => Delivery::Exact,
            delivery => delivery,
        }
    }

    /// Queues a finished chunk frame, encoded for the requested delivery, for the client.
    pub fn deliver(&mut self, request: ChunkRequest, frame: Bytes) {
        let view = self.complete(request.key);
        let is_refined =
            chunk_codec::kind_and_key(&frame).is_ok_and(|(kind, _)| kind == chunk_codec::KIND_REFINED);
        if is_refined && self.delivery_of(request.key) != Delivery::Refined {
            // The parent left the reference window in the meantime: generate again, exact.
            self.return_credit();
            self.requeue_for_view(view, request.key);
            self.requeue(request);
        } else {
            self.send_chunk(request.key, frame);
        }
    }

    /// Queues a request again, before all others.
    fn requeue(&mut self, request: ChunkRequest) {
        match request.request {
            Some(id) => self.requests.push_front((id, request.key)),
            None => self.views.requeue(request.priority, request.key),
        }
    }

    /// Queues a chunk for the active view, if that waited for a request which ended without it.
    fn requeue_for_view(&mut self, priority: Option<u64>, key: ChunkKey) {
        if let Some(priority) = priority {
            self.views.requeue(priority, key);
        }
    }

    /// Queues a chunk frame whose credit is already taken.
    fn send_chunk(&mut self, key: ChunkKey, frame: Bytes) {
        self.return_bytes(self.frame_bound().saturating_sub(frame.len() as u32));
        self.held.insert(key);
        if self.delivery == Delivery::Refined {
            self.references.insert(key, || Some(()));
        }
        self.counts.chunks += 1;
        self.counts.chunk_bytes += frame.len() as u64;
        self.outbox.push_back(frame);
        self.settle();
    }

    /// Ends a stale request whose generation was cancelled. Its credit is returned; the client gets
    /// no message.
    pub fn withdraw(&mut self, request: ChunkRequest) {
        let view = self.complete(request.key);
        self.return_credit();
        self.requeue_for_view(view, request.key);
        self.counts.cancelled += u64::from(request.request.is_some());
        self.settle();
    }

    fn return_credit(&mut self) {
        self.credits = self.credits.saturating_add(1).min(MAX_CREDITS);
        self.return_bytes(self.frame_bound());
    }

    fn return_bytes(&mut self, unused: u32) {
        if let Some(bytes) = &mut self.credit_bytes {
            *bytes = (*bytes + i64::from(unused)).min(i64::from(MAX_CREDIT_BYTES));
        }
    }

    /// Ends a request whose generation failed: the client gets a refusal, its credit is returned.
    pub fn fail(
        &mut self,
        request: ChunkRequest,
        reason: RefusalReason,
        detail: impl Into<Cow<'static, str>>,
    ) {
        let view = self.complete(request.key);
        self.return_credit();
        // The refusal of a view's own request names the view.
        self.requeue_for_view(view.filter(|_| request.request.is_some()), request.key);
        let id = request.request.or(self.view().map(|view| view.id)).unwrap_or(0);
        self.refuse(id, Some(request.key.into()), reason, detail);
        self.settle();
    }

    /// Queues the announcement that the server is about to close.
    pub fn drain(&mut self, reconnect_after_ms: u32) {
        self.send(&ServerMessage::Draining { reconnect_after_ms });
    }

    /// The next frame to send, if any.
    pub fn poll_transmit(&mut self) -> Option<Bytes> {
        self.outbox.pop_front()
    }

    /// The latest applied view of the client; none before the first.
    #[must_use]
    pub fn view(&self) -> Option<&View> {
        self.views.active()
    }

    /// Whether the handshake is done.
    #[must_use]
    pub const fn is_welcomed(&self) -> bool {
        self.welcomed
    }

    /// The delivery of the session, fixed by the handshake; exact before it.
    #[must_use]
    pub const fn delivery(&self) -> Delivery {
        self.delivery
    }

    /// Chunks that the client still allows.
    #[must_use]
    pub const fn credits(&self) -> u32 {
        self.credits
    }

    /// The counters so far.
    #[must_use]
    pub const fn counts(&self) -> SessionCounts {
        self.counts
    }

    /// Ends a request in flight. Returns the priority of its chunk in the view that waits for it, if
    /// no other request of the chunk is left.
    fn complete(&mut self, key: ChunkKey) -> Option<u64> {
        let in_flight = self.in_flight.get_mut(&key)?;
        in_flight.requests -= 1;
        if in_flight.requests > 0 {
            return None;
        }
        self.in_flight.remove(&key)?.view
    }

    /// Announces a view once nothing of it is pending and no chunk of the session is in flight.
    fn settle(&mut self) {
        if self.in_flight.is_empty()
            && let Some((view, chunks)) = self.views.settle(&self.held)
        {
            self.send(&ServerMessage::Settled(Settled { view, chunks }));
        }
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
        // Cannot fail: texts were cut to their limit.
        if let Ok(frame) = control::encode(message) {
            self.outbox.push_back(frame);
        }
    }
}
