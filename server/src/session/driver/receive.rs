//! Messages of the client.

use super::Driver;
use crate::session::end::{EndReason, SessionEnd};
use crate::websocket::frame::Opcode;
use crate::websocket::inbox::Message;
use bytes::Bytes;
use protocol::limits::MAX_CONTROL_FRAME;
use protocol::{CloseCode, DataFrame};
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::task::yield_now;
use tokio::time::{Instant, timeout};

impl<S: AsyncRead + AsyncWrite + Unpin> Driver<'_, S> {
    /// Handles the bytes of a read, or its error.
    pub(super) async fn read_ended(&mut self, read: io::Result<()>) -> Result<(), SessionEnd> {
        let received = match read {
            Ok(()) => self.receive().await,
            Err(error) => Err(SessionEnd::read_failed(&error)),
        };
        let Err(end) = received else { return Ok(()) };
        Err(self.ended(end).await)
    }

    /// Ends the session if its unfinished message is overdue. Reads once more before: a long write
    /// may have kept the session from bytes that had arrived.
    pub(super) async fn enforce_message_deadline(&mut self) -> Result<(), SessionEnd> {
        if let Some(read) = self.read_now().await {
            self.read_ended(read).await?;
        }
        if self.message_deadline.has_passed(Instant::now()) {
            return Err(SessionEnd::with_code(EndReason::MessageTimeout, CloseCode::Unresponsive));
        }
        Ok(())
    }

    /// Reads what has arrived; none if nothing has.
    pub(super) async fn read_now(&mut self) -> Option<io::Result<()>> {
        timeout(Duration::ZERO, self.socket.read()).await.ok()
    }

    /// Handles all messages read, cancels outdated requests, and rejects requests that cannot be
    /// served in time.
    pub(super) async fn receive(&mut self) -> Result<(), SessionEnd> {
        let admitted = self.session.waiting_requests();
        let mut message_ended = false;
        while let Some(is_data) = self.receive_message().await? {
            // A Ping or Pong between the fragments of a message does not end it. Bytes after any
            // other one belong to a new message, whose deadline begins.
            message_ended |= is_data || !self.socket.is_fragmented();
            yield_now().await;
        }
        if self.session.is_welcomed() {
            self.stats.set_welcomed();
        }
        let by = Instant::now() + self.state.config.message_timeout;
        self.message_deadline.record(message_ended, self.socket.is_in_message(), by);
        self.cancel_stale();
        // With a full window, waiting requests wait for the service, not for credit.
        if self.fill_window() {
            // Requests admitted before stay: a rejection is useful only if it comes at once.
            self.session.shed(self.state.generation.allowance(&self.flow).max(admitted));
        }
        if self.flow.bucket().is_limited() {
            let (waiting, deadline) = (self.session.waiting_requests(), self.state.config.deadline);
            let affordable = self.flow.bucket().affordable_chunks(deadline, Instant::now());
            self.session.shed(affordable.max(admitted));
            let rejected = waiting - self.session.waiting_requests();
            self.state.metrics.limits.rate_limit_rejections.inc_by(rejected as u64);
        }
        // Views may be superseded without anything to write.
        if self.session.counts() != self.counted {
            self.update_metrics();
        }
        Ok(())
    }

    /// Handles the next message. True for a data message, false for a Ping, Pong or Close; none if
    /// no whole one has arrived.
    pub(super) async fn receive_message(&mut self) -> Result<Option<bool>, SessionEnd> {
        let incoming = match self.socket.next_message() {
            Ok(None) => return Ok(None),
            Ok(Some(Message::Binary(bytes))) if bytes.len() > MAX_CONTROL_FRAME => {
                return Err(SessionEnd::with_code(EndReason::TooLarge, CloseCode::TooLarge));
            }
            Ok(Some(Message::Binary(bytes))) => DataFrame::Binary(bytes),
            Ok(Some(Message::Text(_))) => DataFrame::Text,
            Ok(Some(Message::Ping(payload))) => {
                let payload = Bytes::copy_from_slice(payload);
                self.socket.queue_as(Opcode::Pong, payload);
                return Ok(Some(false));
            }
            Ok(Some(Message::Pong)) => return Ok(Some(false)),
            Ok(Some(Message::Close(close))) => return Err(SessionEnd::answered(close.answer())),
            Err(fault) => {
                let code = CloseCode::from_code(fault.close_code()).unwrap_or(CloseCode::ProtocolError);
                return Err(SessionEnd::protocol_error(code, fault.to_string()));
            }
        };
        self.session
            .receive(incoming)
            .map(|()| Some(true))
            .map_err(|fault| SessionEnd::protocol_error(fault.close_code(), fault.to_string()))
    }
}
