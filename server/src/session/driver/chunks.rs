//! Chunks of a session: requested from the generation service, collected, cancelled.

use super::{Delay, Driver};
use crate::generation::{Completion, GenerationError};
use crate::mechanism::Mechanism;
use crate::memory::room::ViewRoom;
use protocol::message::RefusalReason;
use protocol::server::{Next, ViewSelection};
use std::time::Duration;
use terrain::ChunkKey;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;

/// Chunks of one session in generation at once. A larger window would order chunks by an outdated
/// view; a smaller one would not fill the session's turns.
pub(super) const JOB_WINDOW: usize = 16;

/// Cached chunks collected before a flush: about 300 KiB of exact frames, one write.
pub(super) const BATCH: u32 = 64;

/// Chunks of a step of a view that is selected at once.
const SELECTION_STEP: usize = 4096;

/// Time until a session looks again whether there is memory for its view and its chunks.
const MEMORY_PAUSE: Duration = Duration::from_millis(100);

impl<S: AsyncRead + AsyncWrite + Unpin> Driver<'_, S> {
    /// Requests chunks from the generation service; cached ones go straight to the session. True if
    /// it stopped only to let a full batch be written.
    pub(super) fn request_chunks(&mut self) -> bool {
        let (before, now) = (self.batch, Instant::now());
        let mut more = false;
        // Nothing is delayed in an idle session, which needs no timer.
        self.delay = None;
        if self.state.memory.is_exceeded() {
            // The tables of a view and chunks that wait for a write take memory.
            let waits = self.session.has_waiting_view() || self.session.has_next_chunk();
            self.delay = waits.then(|| (now + MEMORY_PAUSE, Delay::Memory));
            return false;
        }
        match self.flow.bucket().delay(now) {
            None if self.session.has_waiting_view() => {
                if let Some(room) = self.state.memory.room_for_view(self.stats.site()) {
                    if let Some(selection) = self.session.take_view() {
                        self.select_view(selection, room);
                    }
                } else {
                    self.delay = Some((now + MEMORY_PAUSE, Delay::Memory));
                }
            }
            Some(delay) if self.session.has_waiting_view() => {
                self.delay = Some((now + delay, Delay::RateLimit));
            }
            _ => {}
        }
        while self.flow.in_flight() < JOB_WINDOW {
            if self.batch == BATCH {
                more = true;
                break;
            }
            if let Some(delay) = self.flow.bucket().delay(now) {
                if self.session.has_next_chunk() {
                    self.delay = Some((now + delay, Delay::RateLimit));
                }
                break;
            }
            match self.session.next_chunk_with(|key, delivery| self.flow.cached(key, delivery)) {
                Next::Nothing => break,
                Next::Delivered => self.batch += 1,
                Next::Generate(chunk, delivery) => {
                    self.in_generation.push((chunk.key, now));
                    let span = self.traces.begin(&self.state.traces, chunk.key, delivery);
                    span.in_scope(|| self.flow.request(chunk, delivery));
                }
            }
        }
        let delivered = self.batch - before;
        if delivered > 0 {
            self.unwritten.push((now, u64::from(delivered)));
        }
        more
    }

    /// Selects a view's chunks in turns on the generation threads, or at once where a measurement
    /// asks what that would cost.
    pub(super) fn select_view(&mut self, mut selection: ViewSelection, room: ViewRoom) {
        let land = self.state.offer.land;
        if self.state.config.without != Some(Mechanism::ViewTurns) {
            return self.flow.select(selection, land, Some(room));
        }
        while !selection.step(&land, SELECTION_STEP) {}
        self.apply_view(selection);
    }

    /// Applies a finished selection and cancels what only the previous view needed.
    pub(super) fn apply_view(&mut self, selection: ViewSelection) {
        self.stats.set_view(selection.view());
        self.session.apply_view(selection);
        self.cancel_stale();
    }

    pub(super) fn cancel_stale(&mut self) {
        for key in self.session.take_stale() {
            for chunk in self.flow.cancel(key) {
                self.end_generation(chunk.key);
                self.traces.end(chunk.key, "cancelled");
                self.session.withdraw(chunk);
            }
        }
    }

    /// Requests chunks; true if the window is full afterwards.
    pub(super) fn fill_window(&mut self) -> bool {
        // A full batch of cached chunks is no sign of overload.
        !self.request_chunks() && self.flow.in_flight() >= JOB_WINDOW
    }

    pub(super) fn finish(&mut self, (chunk, result): Completion) {
        let since = self.end_generation(chunk.key);
        match result {
            Ok(frame) => {
                self.session.deliver(chunk, frame);
                self.traces.deliver(chunk.key);
                self.unwritten.extend(since.map(|since| (since, 1)));
            }
            Err(error) => {
                let (reason, outcome) = match error {
                    GenerationError::Overloaded => (RefusalReason::Overloaded, "overloaded"),
                    GenerationError::Failed => (RefusalReason::Failed, "failed"),
                };
                self.session.fail(chunk, reason, error.to_string());
                self.traces.end(chunk.key, outcome);
            }
        }
    }

    /// Removes a chunk from those in generation; returns its start time.
    pub(super) fn end_generation(&mut self, key: ChunkKey) -> Option<Instant> {
        let index = self.in_generation.iter().position(|(other, _)| *other == key)?;
        Some(self.in_generation.swap_remove(index).1)
    }
}
