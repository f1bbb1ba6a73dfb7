//! The chunks of a session: which one is next, and how it ends.

use super::ServerSession;
use crate::chunk_codec;
use crate::delivery::Delivery;
use crate::message::RefusalReason;
use bytes::Bytes;
use std::borrow::Cow;
use terrain::ChunkKey;

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

impl ServerSession {
    /// Whether a chunk is needed that the client has credit for. If none is needed, this may
    /// announce that the view is complete.
    pub fn has_next_chunk(&mut self) -> bool {
        if !self.credit.allows_one() {
            return false;
        }
        let Self { requests, views, held, in_flight, .. } = &mut *self;
        let is_known = |key, needed| held.contains(key) || in_flight.wait_for(key, needed);
        let has_next = !requests.is_empty() || views.has_next(is_known);
        if !has_next {
            // The client may hold all pending chunks.
            self.settle();
        }
        has_next
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
        self.credit.reserve();
        let delivery = self.delivery_of(request.key);
        if let Some(frame) = ready(request.key, delivery) {
            self.send_chunk(request.key, frame);
            return Next::Delivered;
        }
        self.in_flight.begin(request.key, request.request);
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
        let view = self.in_flight.end(request.key);
        let is_refined =
            chunk_codec::kind_and_key(&frame).is_ok_and(|(kind, _)| kind == chunk_codec::KIND_REFINED);
        if is_refined && self.delivery_of(request.key) != Delivery::Refined {
            // The parent left the reference window in the meantime: generate again, exact.
            self.credit.give_back();
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
        self.credit.charge(frame.len());
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
        let view = self.in_flight.end(request.key);
        self.credit.give_back();
        self.requeue_for_view(view, request.key);
        self.counts.cancelled += u64::from(request.request.is_some());
        self.settle();
    }

    /// Ends a request whose generation failed: the client gets a refusal, its credit is returned.
    pub fn fail(
        &mut self,
        request: ChunkRequest,
        reason: RefusalReason,
        detail: impl Into<Cow<'static, str>>,
    ) {
        let view = self.in_flight.end(request.key);
        self.credit.give_back();
        // The refusal of a view's own request names the view.
        self.requeue_for_view(view.filter(|_| request.request.is_some()), request.key);
        let id = request.request.or(self.view().map(|view| view.id)).unwrap_or(0);
        self.refuse(id, Some(request.key.into()), reason, detail);
        self.settle();
    }
}
