//! The counts of a session in the metrics of the server.

use super::Driver;
use crate::mechanism::Mechanism;
use crate::session::refusal_backoff::Rejections;
use protocol::message::RefusalReason;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::Instant;

impl<S: AsyncRead + AsyncWrite + Unpin> Driver<'_, S> {
    /// Adds the session's new counts to the server's metrics.
    pub(super) fn update_metrics(&mut self) {
        let state = self.state;
        let (now, before, metrics) = (self.session.counts(), self.counted, &state.metrics);
        if now.chunks > before.chunks {
            let (chunks, bytes) = (now.chunks - before.chunks, now.chunk_bytes - before.chunk_bytes);
            metrics.sessions.count_chunks(self.session.delivery(), chunks, bytes);
        }
        let superseded = now.superseded_views - before.superseded_views;
        let rejections = Rejections::since(&before, &now);
        if rejections != Rejections::default() {
            // A rate limit bounds the work of rejections as well.
            let by_rate = self.flow.bucket().thread_shares();
            let sharers = self.state.generation.sharers(&self.flow).max(by_rate);
            let backs_off = self.state.config.without != Some(Mechanism::RefusalBackoff);
            let begins = backs_off && self.backoff.record(rejections, sharers, Instant::now());
            self.count_pause(begins);
            for reason in RefusalReason::ALL {
                let count = now.refusals[reason.index()] - before.refusals[reason.index()];
                metrics.limits.request_rejected(reason, count);
            }
        }
        metrics.generation.views_selected.inc_by(now.views - before.views);
        metrics.generation.views_superseded.inc_by(superseded);
        self.stats.set_sent(now.chunks, now.chunk_bytes);
        self.counted = now;
    }

    /// Counts a pause of the refusal back-off, if one begins. A client that causes one after the
    /// other is named in the log.
    pub(super) fn count_pause(&mut self, begins: bool) {
        self.state.metrics.limits.refusal_backoffs.inc_by(u64::from(begins));
        if begins && self.backoff.take_excess() {
            self.state.peer_log.report(self.stats.client(), "requests or views without end");
        }
    }
}
