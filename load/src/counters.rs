//! Counters that all clients of one kind share during one phase.

use crate::latency::Latencies;
use crate::timeline::Timeline;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Distinct problems whose text is kept; all of them are counted.
pub const MAX_PROBLEMS: usize = 8;

/// The kind of a problem, most serious first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum ProblemKind {
    /// Invalid data.
    Mismatch,
    /// A lost session.
    Drop,
    /// A silent server.
    Stall,
    /// A refusal.
    Refusal,
}

/// Live counters. Relaxed atomics: nothing is ordered by them.
#[derive(Debug, Default)]
pub struct Counters {
    /// The timeline that gets the same events; none for slow and silent clients.
    timeline: Option<Arc<Timeline>>,
    /// Sessions admitted, or HTTP connections that received the world's description.
    pub(crate) admitted: AtomicU64,
    pub(crate) chunks: AtomicU64,
    pub(crate) bytes: AtomicU64,
    pub(crate) not_modified: AtomicU64,
    pub(crate) mismatches: AtomicU64,
    pub(crate) dropped: AtomicU64,
    pub(crate) refused: AtomicU64,
    pub(crate) regenerated: AtomicU64,
    pub(crate) views_settled: AtomicU64,
    pub(crate) views_checked: AtomicU64,
    pub(crate) requests: AtomicU64,
    pub(crate) unanswered: AtomicU64,
    pub(crate) unsent: AtomicU64,
    /// Clients that waited at their end for a server that had sent nothing for long.
    pub(crate) stalled: AtomicU64,
    /// Time of the last chunk, microseconds since the start of the run.
    last_chunk_us: AtomicU64,
    pub(crate) lost_deliveries: AtomicU64,
    pub(crate) resumed: AtomicU64,
    pub(crate) held_bytes: AtomicU64,
    pub(crate) chunks_again: AtomicU64,
    pub(crate) bytes_again: AtomicU64,
    pub(crate) announced: AtomicU64,
    pub(crate) closed_as_announced: AtomicU64,
    /// Time of the last of these, microseconds since the start of the run.
    last_close_us: AtomicU64,
    /// Of slow and silent clients: still connected at the end of the run.
    pub(crate) stayed: AtomicU64,
    /// A mutex suffices: some thousand records a second, and nothing awaits while it is held.
    latencies: Mutex<Latencies>,
    settling: Mutex<Latencies>,
    lateness: Mutex<Latencies>,
    gaps: Mutex<Latencies>,
    /// Of slow and silent clients: why their connections were closed, and how often.
    closed: Mutex<BTreeMap<String, u64>>,
    /// The first distinct ones of each kind.
    problems: Mutex<BTreeMap<ProblemKind, Vec<String>>>,
    /// The first report of a world that is not the first one.
    world_changed: Mutex<Option<String>>,
}

impl Counters {
    /// Counters that feed a timeline too.
    #[must_use]
    pub fn with_timeline(timeline: Arc<Timeline>) -> Self {
        Self { timeline: Some(timeline), ..Self::default() }
    }

    /// A client was admitted.
    pub fn admitted(&self) {
        add(&self.admitted);
    }

    /// A chunk arrived, correct or not.
    pub fn chunk(&self, bytes: usize) {
        add(&self.chunks);
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        if let Some(timeline) = &self.timeline {
            timeline.chunk(bytes);
            self.last_chunk_us.fetch_max(micros(timeline.elapsed()), Ordering::Relaxed);
        }
    }

    /// Time of the last chunk since the start of the run.
    pub(crate) fn last_chunk(&self) -> Duration {
        Duration::from_micros(get(&self.last_chunk_us))
    }

    /// The server answered that a known chunk has not changed.
    pub fn not_modified(&self) {
        add(&self.not_modified);
    }

    /// A chunk is compared with local generation.
    pub fn regenerated(&self) {
        add(&self.regenerated);
    }

    /// Something invalid arrived.
    pub fn mismatch(&self, problem: &str) {
        add(&self.mismatches);
        self.note(ProblemKind::Mismatch, problem);
    }

    /// The server changed its world during the run.
    pub fn world_changed(&self, problem: &str) {
        lock(&self.world_changed).get_or_insert_with(|| problem.to_owned());
    }

    /// The report of a changed world, if there was one.
    pub(crate) fn world_change(&self) -> Option<String> {
        lock(&self.world_changed).clone()
    }

    /// A session was lost before the end of the phase.
    pub fn dropped(&self, problem: &str) {
        add(&self.dropped);
        self.note(ProblemKind::Drop, problem);
    }

    /// A session was not admitted, or a request was refused.
    pub fn refused(&self, problem: &str) {
        add(&self.refused);
        self.note(ProblemKind::Refusal, problem);
    }

    /// A client waited at its end for a server that had sent nothing for [`STALL_TIMEOUT`].
    ///
    /// [`STALL_TIMEOUT`]: crate::task::STALL_TIMEOUT
    pub fn stalled(&self, problem: &str) {
        add(&self.stalled);
        self.note(ProblemKind::Stall, problem);
    }

    /// A view was reported complete.
    pub fn view_settled(&self) {
        add(&self.views_settled);
    }

    /// A view that was reported complete is checked for missing chunks.
    pub fn view_checked(&self) {
        add(&self.views_checked);
    }

    /// A pose's view, or a newer one, was complete after this time.
    pub fn settled(&self, latency: Duration) {
        lock(&self.settling).record(latency);
    }

    /// A request, or a measured pose, was sent so long after it was due.
    pub fn request(&self, late: Duration) {
        add(&self.requests);
        lock(&self.lateness).record(late);
    }

    /// A request was answered after this time.
    pub fn answered(&self, latency: Duration) {
        lock(&self.latencies).record(latency);
        if let Some(timeline) = &self.timeline {
            timeline.answered(latency);
        }
    }

    /// A session that had delivered was lost.
    pub fn lost_delivery(&self) {
        add(&self.lost_deliveries);
    }

    /// The successor of a lost session delivered, this time after the last delivery of the lost
    /// one. It began with `held_bytes` bytes of chunks held.
    pub fn resumed(&self, gap: Duration, held_bytes: usize) {
        add(&self.resumed);
        self.held_bytes.fetch_add(held_bytes as u64, Ordering::Relaxed);
        lock(&self.gaps).record(gap);
    }

    /// No session followed a lost one within this time, to the end of the phase.
    pub fn unresumed(&self, waited: Duration) {
        lock(&self.gaps).record(waited);
    }

    /// A view's chunk arrived that the client held already.
    pub fn sent_again(&self, bytes: usize) {
        add(&self.chunks_again);
        self.bytes_again.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// The server announced that it shuts down.
    pub fn announced(&self) {
        add(&self.announced);
    }

    /// A Close frame followed the announcement.
    pub fn closed_as_announced(&self) {
        add(&self.closed_as_announced);
        if let Some(timeline) = &self.timeline {
            self.last_close_us.fetch_max(micros(timeline.elapsed()), Ordering::Relaxed);
        }
    }

    /// Time of the last such Close frame since the start of the run.
    pub(crate) fn last_close(&self) -> Duration {
        Duration::from_micros(get(&self.last_close_us))
    }

    /// This many requests had no answer when their session ended.
    pub fn unanswered(&self, requests: usize) {
        self.unanswered.fetch_add(requests as u64, Ordering::Relaxed);
    }

    /// A request had no answer after this time, at the end of the run or of its session. It counts
    /// with this time, a lower bound of its latency.
    pub fn abandoned(&self, waited: Duration) {
        add(&self.unanswered);
        lock(&self.latencies).record(waited);
    }

    /// As [`Counters::abandoned`], for a request that was due and never sent.
    pub fn unsent(&self, waited: Duration) {
        add(&self.unsent);
        lock(&self.latencies).record(waited);
    }

    /// A request that was never sent and has not waited.
    pub fn skipped(&self) {
        add(&self.unsent);
    }

    /// The server closed the connection of a slow or silent client.
    pub fn closed(&self, why: &str) {
        let mut closed = lock(&self.closed);
        // Bounded, in case a server gives a new reason each time.
        let why = if closed.len() < MAX_PROBLEMS || closed.contains_key(why) { why } else { "other reasons" };
        *closed.entry(why.into()).or_default() += 1;
    }

    /// A slow or silent client was still connected at the end of the run.
    pub fn stayed(&self) {
        add(&self.stayed);
    }

    pub(crate) fn latencies(&self) -> Latencies {
        lock(&self.latencies).clone()
    }

    pub(crate) fn settling(&self) -> Latencies {
        lock(&self.settling).clone()
    }

    pub(crate) fn lateness(&self) -> Latencies {
        lock(&self.lateness).clone()
    }

    pub(crate) fn gaps(&self) -> Latencies {
        lock(&self.gaps).clone()
    }

    pub(crate) fn closes(&self) -> BTreeMap<String, u64> {
        lock(&self.closed).clone()
    }

    /// The first distinct problems, most serious first, so that many of one kind hide no other.
    pub(crate) fn problems(&self) -> Vec<(ProblemKind, String)> {
        let problems = lock(&self.problems);
        let all = problems.iter().flat_map(|(kind, texts)| texts.iter().map(|text| (*kind, text.clone())));
        all.collect()
    }

    fn note(&self, kind: ProblemKind, problem: &str) {
        let mut problems = lock(&self.problems);
        let problems = problems.entry(kind).or_default();
        if problems.len() < MAX_PROBLEMS && !problems.iter().any(|known| known == problem) {
            problems.push(problem.into());
        }
    }
}

/// The current count.
pub(crate) fn get(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

fn add(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_problem_is_listed_once_and_always_counted() {
        let counters = Counters::default();
        for index in 0..100 {
            counters.dropped("gone");
            counters.refused(&format!("refusal {index}"));
        }
        assert_eq!((get(&counters.dropped), get(&counters.refused)), (100, 100));
        let problems = counters.problems();
        assert_eq!(problems.len(), 1 + MAX_PROBLEMS);
        assert_eq!(problems[0], (ProblemKind::Drop, "gone".into()));
    }

    #[test]
    fn refusals_hide_no_mismatch() {
        let counters = Counters::default();
        for index in 0..100 {
            counters.refused(&format!("refusal {index}"));
        }
        counters.stalled("silent");
        counters.mismatch("wrong");
        let kinds: Vec<_> = counters.problems().into_iter().take(2).map(|(kind, _)| kind).collect();
        assert_eq!(kinds, [ProblemKind::Mismatch, ProblemKind::Stall]);
    }

    #[test]
    fn close_reasons_are_counted_separately_and_bounded() {
        let counters = Counters::default();
        for index in 0..100 {
            counters.closed("silent");
            counters.closed(&format!("reason {index}"));
        }
        let closed = counters.closes();
        assert_eq!(
            (closed["silent"], closed.len(), closed.values().sum::<u64>()),
            (100, MAX_PROBLEMS + 1, 200)
        );
    }

    #[test]
    fn missing_answers_of_an_open_loop_count_with_their_wait() {
        let counters = Counters::default();
        counters.answered(Duration::from_millis(1));
        counters.abandoned(Duration::from_secs(2));
        counters.unsent(Duration::from_secs(3));
        assert_eq!((get(&counters.unanswered), get(&counters.unsent), counters.latencies().len()), (1, 1, 3));
    }
}
