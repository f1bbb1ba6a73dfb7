//! Messages to the client, up to the last one.

use super::Driver;
use crate::session::end::{EndReason, SessionEnd, write_within};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;

/// Least number of bytes that a peer must take within
/// [`crate::config::ServerConfig::write_timeout`]: a reader of 6.5 KB a second keeps its session,
/// whatever the length of a batch.
const WRITE_PROGRESS: usize = 64 * 1024;

/// Bounds of the reconnect delay sent on shutdown, milliseconds. Random, so that clients do not all
/// return at once.
const RECONNECT_MS: (u32, u32) = (500, 2000);

impl<S: AsyncRead + AsyncWrite + Unpin> Driver<'_, S> {
    /// An end after what is queued is written: the last message may explain it. A peer that takes
    /// none of it gets no Close frame, either.
    pub(super) async fn ended(&mut self, end: SessionEnd) -> SessionEnd {
        match self.flush().await {
            // The first reason stays. Without a Close frame, whose answer would keep the memory.
            Err(failed) if failed.reason == EndReason::MemoryShed => SessionEnd::without_code(end.reason),
            Err(failed) if failed.reason.leaves_unread_bytes() => failed,
            _ => end,
        }
    }

    /// Writes all messages of the session in one flush.
    pub(super) async fn flush(&mut self) -> Result<(), SessionEnd> {
        let mut bytes = 0;
        while let Some(frame) = self.session.poll_transmit() {
            bytes += frame.len() as u64;
            self.socket.queue(frame);
        }
        if !self.socket.has_queued() {
            return Ok(());
        }
        let write = async {
            while !write_within(self.state.config.write_timeout, self.socket.flush_part(WRITE_PROGRESS))
                .await?
            {}
            Ok(())
        };
        let result = tokio::select! {
            biased;
            written = write => written,
            eviction = self.stats.evicted() => Err(SessionEnd::by_server(eviction)),
            // A slow reader must not miss the announcement.
            () = self.state.draining.cancelled(), if !self.is_draining => {
                self.socket.drop_unwritten();
                self.unwritten.clear();
                bytes = 0;
                Ok(())
            }
        };
        self.batch = 0;
        self.traces.flushed(result.is_ok());
        if result.is_ok() {
            self.state.metrics.sessions.sent_bytes.inc_by(bytes);
            let now = Instant::now();
            for (since, count) in self.unwritten.drain(..) {
                self.state.metrics.sessions.latency.observe(now - since, count);
            }
        }
        self.update_metrics();
        result
    }

    /// Announces the shutdown with a reconnect delay.
    pub(super) async fn drain(&mut self) -> SessionEnd {
        let (min_ms, max_ms) = RECONNECT_MS;
        let jitter_ms = terrain::hash::mix(self.stats.number() as u32) % (max_ms - min_ms);
        self.session.drain(min_ms + jitter_ms);
        self.is_draining = true;
        self.ended(SessionEnd::going_away(EndReason::Drained, "server is shutting down")).await
    }
}
