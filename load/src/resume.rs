//! The state that one client carries from a lost session into the next: its chunks, and since when
//! it waits.

use crate::counters::Counters;
use crate::held::HeldChunks;
use std::time::Duration;
use terrain::WorldDigest;
use tokio::time::Instant;

/// State of one client over its sessions.
#[derive(Debug, Default)]
pub struct Resumption {
    /// The chunks that it holds.
    pub held: HeldChunks,
    /// The last chunk or complete view of the present session.
    delivered: Option<Instant>,
    /// The same of the lost session, until a successor delivers.
    lost: Option<Instant>,
    /// Bytes held at the begin of the present session.
    held_bytes: usize,
    /// Delay before reconnecting that the server announced.
    hint: Option<Duration>,
}

impl Resumption {
    /// A session of this world begins. True if it follows a lost one and the client holds chunks.
    pub fn begin(&mut self, world: WorldDigest) -> bool {
        self.held.enter(world);
        self.held_bytes = self.held.bytes();
        self.lost.is_some() && !self.held.is_empty()
    }

    /// A chunk or a complete view arrived.
    pub fn delivered(&mut self, now: Instant, counters: &Counters) {
        self.delivered = Some(now);
        if let Some(lost) = self.lost.take() {
            counters.resumed(now.saturating_duration_since(lost), self.held_bytes);
        }
    }

    /// The session is lost. One that had delivered nothing only prolongs the wait.
    pub fn lost(&mut self, counters: &Counters) {
        if let Some(delivered) = self.delivered.take() {
            counters.lost_delivery();
            self.lost.get_or_insert(delivered);
        }
    }

    /// The server announced its end and a delay before reconnecting.
    pub fn announced(&mut self, delay: Duration) {
        self.hint = Some(delay);
    }

    /// A Close frame ended the session.
    pub fn closed(&self, counters: &Counters) {
        if self.hint.is_some() {
            counters.closed_as_announced();
        }
    }

    /// The announced delay, once.
    pub fn take_hint(&mut self) -> Option<Duration> {
        self.hint.take()
    }

    /// The phase ends. A client that still waits counts with its wait, a lower bound of the gap.
    pub fn end(self, now: Instant, counters: &Counters) {
        if let Some(lost) = self.lost {
            counters.unresumed(now.saturating_duration_since(lost));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::ResumeReport;
    use terrain::ChunkKey;
    use tokio::time::advance;

    const WORLD: WorldDigest = WorldDigest([1; 32]);

    fn report(counters: &Counters) -> ResumeReport {
        ResumeReport::of(&[counters])
    }

    #[tokio::test(start_paused = true)]
    async fn the_gap_is_from_the_last_delivery_to_the_next_over_failed_sessions() {
        let (mut client, counters) = (Resumption::default(), Counters::default());
        assert!(!client.begin(WORLD), "the first session");
        client.held.insert(ChunkKey::new(0, 0, 0).unwrap(), 700);
        client.delivered(Instant::now(), &counters);
        advance(Duration::from_millis(300)).await;
        client.lost(&counters);
        assert!(client.begin(WORLD), "reports its chunks");
        client.lost(&counters);
        advance(Duration::from_millis(200)).await;
        assert!(client.begin(WORLD));
        client.delivered(Instant::now(), &counters);
        client.delivered(Instant::now(), &counters);
        let report = report(&counters);
        assert_eq!((report.lost, report.resumed, report.held_bytes), (1, 1, 700));
        assert!(report.gap_ms.max.is_some_and(|max| (max - 500.0).abs() < 1.0), "{report:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_without_a_successor_is_not_resumed_and_its_wait_counts() {
        let (mut client, counters) = (Resumption::default(), Counters::default());
        client.delivered(Instant::now(), &counters);
        client.lost(&counters);
        advance(Duration::from_secs(9)).await;
        client.end(Instant::now(), &counters);
        let report = report(&counters);
        assert_eq!((report.lost, report.resumed), (1, 0));
        // Three significant digits.
        assert!(report.gap_ms.max.is_some_and(|max| (max - 9000.0).abs() < 10.0), "{report:?}");
    }

    #[test]
    fn an_announced_delay_is_used_once() {
        let mut client = Resumption::default();
        client.announced(Duration::from_millis(700));
        assert_eq!(client.take_hint(), Some(Duration::from_millis(700)));
        assert_eq!(client.take_hint(), None);
    }
}
