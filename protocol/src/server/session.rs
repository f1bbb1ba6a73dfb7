mod chunks;
mod credit;
mod in_flight;

pub use chunks::{ChunkRequest, Next};

use super::ServerOffer;
use super::view_queue::ViewQueue;
use super::view_selection::ViewSelection;
use crate::DataFrame;
use crate::control;
use crate::delivery::Delivery;
use crate::error::ControlError;
use crate::fault::PeerFault;
use crate::held_chunks::HeldChunks;
use crate::limits::{MAX_CREDIT_BYTES, MAX_CREDITS, MAX_PENDING_REQUESTS, MAX_TEXT, MAX_VIEW_ESTIMATE};
use crate::message::{
    ClientMessage, Hello, RefusalReason, Refused, Rejection, ServerMessage, Settled, Welcome, WireKey,
};
use crate::reference_window::ReferenceWindow;
use crate::view::View;
use bytes::Bytes;
use credit::Credit;
use in_flight::ChunksInFlight;
use std::borrow::Cow;
use std::collections::{HashSet, VecDeque};
use terrain::constants::GENERATOR_VERSION;
use terrain::{ChunkKey, lod};

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
    credit: Credit,
    /// Explicit requests that wait for credit, oldest first: at most [`MAX_PENDING_REQUESTS`] and
    /// the requeued ones. Further ones are refused.
    requests: VecDeque<(u32, ChunkKey)>,
    views: ViewQueue,
    /// Chunks that the client has; cleared when full.
    held: HeldChunks,
    /// In refined delivery: the parents that frames may refer to.
    references: ReferenceWindow<()>,
    /// Returned by [`ServerSession::next_chunk`] and not yet delivered.
    in_flight: ChunksInFlight,
    outbox: VecDeque<Bytes>,
    counts: SessionCounts,
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
            credit: Credit::of(Delivery::default()),
            requests: VecDeque::new(),
            views: ViewQueue::default(),
            held: HeldChunks::default(),
            references: ReferenceWindow::default(),
            in_flight: ChunksInFlight::default(),
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
                    self.credit.grant_chunks(chunks);
                }
                Ok(())
            }
            (ClientMessage::CreditBytes { bytes }, true) => {
                if self.is_valid_credit(bytes, MAX_CREDIT_BYTES) {
                    self.credit.grant_bytes(bytes, self.in_flight.requests());
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
        self.credit = Credit::of(hello.delivery);
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

    /// The selection of the newest view, for a worker to run; none if no view waits or a selection
    /// is running. It must end in [`ServerSession::apply_view`] or [`ServerSession::fail_view`].
    pub fn take_view(&mut self) -> Option<ViewSelection> {
        self.views.take(&self.offer.land, &self.held)
    }

    /// Applies a selection: its view replaces the active one. An unfinished selection is finished
    /// here.
    pub fn apply_view(&mut self, selection: ViewSelection) {
        self.counts.views += 1;
        let keys = self.views.apply(selection, &self.offer.land);
        self.in_flight.forget_view();
        self.in_flight.find_stale(|key, request| request.is_none() && !keys.contains(&key));
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

    fn cancel(&mut self, id: u32) {
        self.requests.retain(|(request, _)| *request != id);
        self.in_flight.find_stale(|_, request| request == Some(id));
    }

    /// Chunks in flight that are no longer needed, each once. Their generation may be cancelled and
    /// reported by [`ServerSession::withdraw`]; a chunk that was generated must be delivered.
    pub fn take_stale(&mut self) -> Vec<ChunkKey> {
        self.in_flight.take_stale()
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
        self.credit.chunks()
    }

    /// The counters so far.
    #[must_use]
    pub const fn counts(&self) -> SessionCounts {
        self.counts
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
