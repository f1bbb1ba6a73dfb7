//! A session with a server that is not trusted, without IO: the protocol's session machine, what
//! may arrive, and what is requested again.
//!
//! A bad chunk is dropped. While it is missing, the viewer draws its coarser ancestor in its place,
//! as it does for every chunk that has not arrived. The chunk is requested again with growing
//! delays; a server that sends several bad ones is given up ([`Trust`]).

use crate::lod::error;
use crate::stream::chunk_stream::StreamEvent;
use crate::stream::expected::{ExpectedChunks, check_ranges};
use crate::stream::retries::Retries;
use crate::stream::trust::{Trust, Untrusted};
use bytes::Bytes;
use protocol::chunk_codec::kind_and_key;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::message::{RefusalReason, Refused, WireKey};
use protocol::peer_text::one_line;
use protocol::view::View;
use protocol::{ChunkError, DataFrame, Delivery, PeerFault};
use std::collections::BTreeSet;
use std::iter::successors;
use std::time::Duration;
use terrain::{ChunkKey, WorldDigest};

/// Longest delay before reconnecting that a server can ask for.
const MAX_RECONNECT: Duration = Duration::from_secs(60);

/// Content of a frame.
#[derive(Debug)]
pub enum Received {
    /// An event for the viewer.
    Event(StreamEvent),
    /// The server is about to close and asks for this delay before the next session.
    Draining(Duration),
    /// Nothing to act on.
    Nothing,
}

/// Why a session must end.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SessionFault {
    /// A violation of the protocol, or a rejected handshake.
    #[error(transparent)]
    Peer(#[from] PeerFault),
    /// The server is given up.
    #[error(transparent)]
    Untrusted(#[from] Untrusted),
    /// A chunk is missing whose key is unknown: a new session reports the chunks that are held, and
    /// the server sends the others.
    #[error("a bad chunk named no key of this view: the session starts again")]
    Restart,
}

/// Counters of bad and refused chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rejects {
    /// Chunks that were wrong or not asked for.
    pub bad: u64,
    /// Chunks that the server refused.
    pub refused: u64,
    /// Requests for such chunks.
    pub retried: u64,
}

/// See the module. Times count from the start of the session.
#[derive(Debug)]
pub struct GuardedSession {
    session: ClientSession,
    expected: ExpectedChunks,
    retries: Retries,
    /// Whether chunks refine their parents.
    is_refined: bool,
    /// Whether the latest view is not settled.
    is_open: bool,
    /// Whether a chunk is missing that cannot be requested by its key.
    lost_key: bool,
    /// Whether the server has announced its end.
    is_draining: bool,
    rejects: Rejects,
}

impl GuardedSession {
    /// A session before its handshake. `delays` are the first and the longest delay of a retry,
    /// `retry_seed` is the seed of their jitter.
    #[must_use]
    pub fn new(config: ClientConfig, delays: (Duration, Duration), retry_seed: u64) -> Self {
        Self {
            is_refined: config.delivery == Delivery::Refined,
            session: ClientSession::new(config),
            expected: ExpectedChunks::default(),
            retries: Retries::new(delays, retry_seed),
            is_open: false,
            lost_key: false,
            is_draining: false,
            rejects: Rejects::default(),
        }
    }

    /// The next frame to send, if any.
    pub fn poll_transmit(&mut self) -> Option<Bytes> {
        self.session.poll_transmit()
    }

    /// Sends a view.
    pub fn set_view(&mut self, view: View) {
        self.expected.add_view(&view);
        self.is_open = true;
        self.session.set_view(view);
    }

    /// Releases evicted chunks.
    pub fn release(&mut self, keys: &[ChunkKey]) {
        self.expected.release(keys);
        self.session.release(keys);
    }

    /// Reports chunks that are held already.
    pub fn holding(&mut self, keys: &[ChunkKey]) {
        for key in keys {
            self.expected.hold(*key);
        }
        self.session.holding(keys);
    }

    /// Whether the handshake is done.
    #[must_use]
    pub fn is_welcomed(&self) -> bool {
        self.session.world().is_some()
    }

    /// Chunks that the server may still send.
    #[must_use]
    pub const fn credits(&self) -> u32 {
        self.session.credits()
    }

    /// Whether the server owes a chunk or the end of a view.
    #[must_use]
    pub fn awaits_data(&self) -> bool {
        self.is_open || !self.retries.is_empty()
    }

    /// Bad and refused chunks since the last call.
    pub fn take_rejects(&mut self) -> Rejects {
        std::mem::take(&mut self.rejects)
    }

    /// Requests the chunks that are due.
    pub fn retry(&mut self, now: Duration) {
        let expected = &self.expected;
        let needed = |key: &ChunkKey| expected.is_in_latest_view(*key);
        // Ancestors are needed by what refines them, and before it.
        let ancestors = |key: ChunkKey| successors(key.parent(), |key| key.parent());
        let refined: BTreeSet<_> = self.retries.keys().filter(needed).flat_map(ancestors).collect();
        let due = self.retries.take_due(now, |key| needed(&key) || refined.contains(&key), self.is_refined);
        if !due.is_empty() {
            self.rejects.retried += due.len() as u64;
            self.session.request(&due);
        }
    }

    /// When [`GuardedSession::retry`] is to be called.
    #[must_use]
    pub fn next_retry(&self) -> Option<Duration> {
        self.retries.next(self.is_refined)
    }

    /// Processes one frame.
    ///
    /// # Errors
    /// The session must end.
    pub fn receive(
        &mut self,
        frame: DataFrame<'_>,
        trust: &mut Trust,
        now: Duration,
    ) -> Result<Received, SessionFault> {
        let (expected, retries) = (&self.expected, &self.retries);
        let is_expected = |key: ChunkKey| expected.is_in_view(key) || retries.contains(key);
        let event = match self.session.receive_expected(frame, is_expected) {
            Ok(event) => event,
            Err(PeerFault::Chunk(fault)) => {
                let DataFrame::Binary(bytes) = frame else { return Ok(Received::Nothing) };
                let key = kind_and_key(bytes).ok().map(|(_, key)| key).filter(|key| is_expected(*key));
                return self.bad(key, &fault, trust, now);
            }
            Err(fault) => return Err(fault.into()),
        };
        match event {
            Event::Welcome(welcome) => Ok(Received::Event(StreamEvent::Connected {
                world: WorldDigest(welcome.digest),
                world_seed: welcome.world_seed,
                server: one_line(&welcome.software),
            })),
            Event::Chunk { mut chunk, delivery, .. } => {
                if let Err(rule) = check_ranges(&chunk) {
                    return self.bad(Some(chunk.key), &ChunkError::Content(rule), trust, now);
                }
                chunk.error = error::without_rounding(chunk.error, delivery);
                self.retries.remove(chunk.key);
                if self.expected.hold(chunk.key) {
                    trust.good();
                } else {
                    trust.surplus()?;
                }
                Ok(Received::Event(StreamEvent::Chunk(chunk)))
            }
            Event::Settled(settled) => self.settled(settled.view, trust),
            Event::Refused(refused) => self.refused(&refused, trust, now),
            Event::Draining { reconnect_after_ms } => {
                // Once is enough.
                if std::mem::replace(&mut self.is_draining, true) {
                    trust.surplus()?;
                }
                let delay = Duration::from_millis(reconnect_after_ms.into());
                Ok(Received::Draining(delay.min(MAX_RECONNECT)))
            }
        }
    }

    /// Drops a bad chunk. `key` is none if no view may need it.
    fn bad(
        &mut self,
        key: Option<ChunkKey>,
        fault: &ChunkError,
        trust: &mut Trust,
        now: Duration,
    ) -> Result<Received, SessionFault> {
        self.rejects.bad += 1;
        let detail = fault.to_string();
        // Until a bad parent has come again, all chunks that refine it are missed, of which the
        // server does not know.
        let parent = if let ChunkError::Parent(key) = fault { key.parent() } else { None };
        match parent.filter(|parent| self.retries.contains(*parent)) {
            Some(_) => trust.surplus()?,
            None => trust.bad(&detail)?,
        }
        self.lost_key |= !parent.is_none_or(|parent| self.ensure_requested(parent, now));
        Ok(self.missed(key, detail, now))
    }

    /// Requests a chunk unless it is requested already; false if there are too many.
    fn ensure_requested(&mut self, key: ChunkKey, now: Duration) -> bool {
        self.retries.contains(key) || self.retries.add(key, now)
    }

    /// Notes a chunk that did not come.
    fn missed(&mut self, key: Option<ChunkKey>, detail: String, now: Duration) -> Received {
        self.lost_key |= !key.is_some_and(|key| self.retries.add(key, now));
        Received::Event(StreamEvent::Missed { key, detail })
    }

    fn settled(&mut self, view: u32, trust: &mut Trust) -> Result<Received, SessionFault> {
        if !self.expected.settle(view) {
            trust.surplus()?;
            return Ok(Received::Nothing);
        }
        if self.lost_key {
            return Err(SessionFault::Restart);
        }
        self.is_open &= !self.expected.is_latest(view);
        Ok(Received::Event(StreamEvent::Settled { view }))
    }

    fn refused(
        &mut self,
        refused: &Refused,
        trust: &mut Trust,
        now: Duration,
    ) -> Result<Received, SessionFault> {
        let detail = one_line(&refused.detail);
        match refused.key.map(WireKey::check) {
            Some(Ok(key)) if self.retries.is_requested(key) => {
                self.rejects.refused += 1;
                self.retries.add(key, now);
                Ok(Received::Nothing)
            }
            Some(Ok(key)) if !self.retries.contains(key) && self.expected.is_in_view(key) => {
                self.rejects.refused += 1;
                let missed = self.missed(Some(key), detail, now);
                // One that is not requested again may be refused again, without end.
                if !self.retries.contains(key) {
                    trust.surplus()?;
                }
                Ok(missed)
            }
            None if refused.reason == RefusalReason::InvalidCredit => {
                trust.surplus()?;
                Ok(Received::Event(StreamEvent::Refused { view: None, detail }))
            }
            // Ids of requests and of views are apart; a refused request of several chunks has
            // another reason.
            None if matches!(refused.reason, RefusalReason::InvalidView | RefusalReason::Failed)
                && self.expected.refuse(refused.id) =>
            {
                // Of an older view nothing is to be said: the latest one may be served.
                if !self.expected.is_latest(refused.id) {
                    return Ok(Received::Nothing);
                }
                // Nothing of it is to come.
                self.is_open = false;
                Ok(Received::Event(StreamEvent::Refused { view: Some(refused.id), detail }))
            }
            // A refused batch of retries among them: they are requested again without an answer.
            _ => {
                trust.surplus()?;
                Ok(Received::Nothing)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::trust::MAX_BAD;

    const NOW: Duration = Duration::ZERO;

    fn session() -> GuardedSession {
        let (digest, token, software) = (None, None, String::new());
        let config = ClientConfig { digest, delivery: Delivery::Refined, token, software, window: 16 };
        GuardedSession::new(config, (Duration::from_millis(100), Duration::from_secs(5)), 1)
    }

    /// One bad chunk of level 2 costs the chunks of two levels that refine it. The control is a
    /// server that sends refined chunks of parents that were never bad.
    #[test]
    fn chunks_that_refine_a_bad_one_are_requested_again_and_not_held_against_the_server() {
        let top = ChunkKey::new(2, 0, 0).unwrap();
        let children: Vec<_> = top.children().unwrap().into_iter().collect();
        let finest: Vec<_> = children.iter().flat_map(|child| child.children().unwrap()).collect();
        let (mut session, mut trust) = (session(), Trust::default());
        session.bad(Some(top), &ChunkError::Digest, &mut trust, NOW).unwrap();
        for key in children.iter().chain(&finest) {
            session.bad(Some(*key), &ChunkError::Parent(*key), &mut trust, NOW).unwrap();
        }
        assert_eq!((session.retries.len(), session.take_rejects().bad), (21, 21));
        assert!(!session.lost_key);
        // The bad chunk first, though only the finest are needed.
        let (later, mut requested) = (Duration::from_secs(60), Vec::new());
        while !session.retries.is_empty() {
            let refined: BTreeSet<_> =
                finest.iter().flat_map(|key| successors(key.parent(), |key| key.parent())).collect();
            let is_needed = |key: ChunkKey| key.level() == 0 || refined.contains(&key);
            let due = session.retries.take_due(later, is_needed, true);
            assert!(!due.is_empty());
            due.iter().for_each(|key| session.retries.remove(*key));
            requested.extend(due);
        }
        assert_eq!(
            requested.iter().map(|key| key.level()).collect::<Vec<_>>(),
            [&[2][..], &[1; 4], &[0; 16]].concat()
        );

        let (mut session, mut trust) = (self::session(), Trust::default());
        let unknown = (0..MAX_BAD as i32).map(|x| ChunkKey::new(1, 2 * x, 0).unwrap());
        let given_up =
            unknown.map(|key| session.bad(Some(key), &ChunkError::Parent(key), &mut trust, NOW).is_err());
        assert_eq!(given_up.filter(|given_up| *given_up).count(), 1);
    }

    #[test]
    fn only_a_refusal_of_the_latest_view_is_reported() {
        let (mut session, mut trust) = (session(), Trust::default());
        [1, 2].into_iter().for_each(|id| session.set_view(test_support::view(id, 2000)));
        let mut is_reported = |id| {
            let refused = Refused { id, key: None, reason: RefusalReason::Failed, detail: "no room".into() };
            let received = session.refused(&refused, &mut trust, NOW).unwrap();
            matches!(received, Received::Event(StreamEvent::Refused { view: Some(2), .. }))
        };
        assert_eq!([1, 2].map(&mut is_reported), [false, true]);
        assert!(!session.is_open);
    }
}
