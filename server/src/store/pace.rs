//! Whether a read from the store saves time: what reads take against what making a chunk takes, how
//! much time reads without a result have cost, and whether the store answers at all.
//!
//! Everything that holds reads back shares one clock for tries: every 5 s one read is sent all the
//! same, and one answer is enough to begin again.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use terrain::constants::TOP_LEVEL;

/// Window of the moving averages.
const WINDOW: u64 = 8;

/// Taken for the time to make a chunk of a level of which none was made yet.
const UNKNOWN: Duration = Duration::from_millis(20);

/// Time between two tries of a store that is held back, to see whether it still has to be.
const RETRY: Duration = Duration::from_secs(5);

/// Reads without a result may take an eighth of the time that chunks may wait.
const LOSS_PART: i64 = 8;

/// Largest budget of reads without a result, and largest deficit, nanoseconds.
const MAX_LOSS: i64 = 100_000_000;

/// One late answer among this many in time stops nothing: it is beyond the 99th percentile.
const LATE_PART: u32 = 256;

/// Failures in a row after which the store counts as failing.
const FAILURES: u32 = 5;

/// Invalid objects in a row after which the store counts as damaged. Fewer than failures: an
/// overload that passes explains a failure and no invalid object. One alone may be a stray object.
const INVALID: u32 = 3;

/// A sample counts for at most this multiple of the average: one answer out of line, as a late one
/// that was forgiven, does not hold reads back.
const MAX_OUTLIER: u64 = 4;

/// Taken for the time of a read while the store fails.
const FAILING: u64 = u64::MAX;

/// Moving averages of times, and counts of failures. Relaxed atomics: a lost update changes little.
#[derive(Debug)]
pub struct Pace {
    least_wait: Duration,
    /// By level, nanoseconds; 0 is unknown.
    made: [AtomicU64; TOP_LEVEL as usize + 1],
    /// Of answers, nanoseconds; 0 is unknown. An answer in less than half of the larger of this
    /// and `presumed` replaces it.
    read: AtomicU64,
    /// The least time of a read, from reads that had no answer in time, nanoseconds; 0 is none. An
    /// answer in less than half of the larger of this and `read` ends it.
    presumed: AtomicU64,
    /// Answers in time since the last late one that stopped nothing, at most [`LATE_PART`].
    in_time: AtomicU32,
    /// Failures in a row.
    failures: AtomicU32,
    /// Invalid objects since the last valid one, at most [`INVALID`]: then the store is damaged.
    invalid: AtomicU32,
    /// Whether its damage was reported, and no valid object since.
    is_damage_reported: AtomicBool,
    /// Nanoseconds that reads without a result may still take, at most [`MAX_LOSS`].
    budget: AtomicI64,
    tried: Mutex<Option<Instant>>,
}

impl Pace {
    /// Nothing is known yet. Every chunk may wait for this time, whatever it takes to make.
    #[must_use]
    pub fn new(least_wait: Duration) -> Self {
        Self {
            least_wait,
            made: std::array::from_fn(|_| AtomicU64::new(0)),
            read: AtomicU64::new(0),
            presumed: AtomicU64::new(0),
            in_time: AtomicU32::new(0),
            failures: AtomicU32::new(0),
            invalid: AtomicU32::new(0),
            is_damage_reported: AtomicBool::new(false),
            budget: AtomicI64::new(MAX_LOSS),
            tried: Mutex::new(None),
        }
    }

    /// The time to wait for a chunk; none if its answer would likely come later than that, if the
    /// store is damaged, or if reads without a result have used up their time and the chunk is not
    /// known to be in the store (`is_stored`). Then one read every 5 s is worth a try all the same.
    pub fn wait(&self, key: ChunkKey, is_stored: bool, now: Instant) -> Option<Duration> {
        let wait = self.longest_wait(key);
        let is_whole = self.invalid.load(Ordering::Relaxed) < INVALID;
        if is_whole && self.is_quick(wait) && (is_stored || self.budget.load(Ordering::Relaxed) > 0) {
            return Some(wait);
        }
        let mut tried = self.tried.lock().unwrap_or_else(PoisonError::into_inner);
        let is_due = tried.is_none_or(|tried| now.saturating_duration_since(tried) >= RETRY);
        is_due.then(|| {
            *tried = Some(now);
            wait
        })
    }

    /// Whether a chunk is worth a write: it would be read.
    pub fn is_worth_writing(&self, key: ChunkKey) -> bool {
        self.is_quick(self.longest_wait(key))
    }

    fn longest_wait(&self, key: ChunkKey) -> Duration {
        let made = match self.made[usize::from(key.level())].load(Ordering::Relaxed) {
            0 => UNKNOWN,
            nanoseconds => Duration::from_nanos(nanoseconds),
        };
        made.max(self.least_wait)
    }

    fn is_quick(&self, wait: Duration) -> bool {
        let read = self.read.load(Ordering::Relaxed).max(self.presumed.load(Ordering::Relaxed));
        Duration::from_nanos(read) <= wait
    }

    /// A chunk was made in this time.
    pub fn made(&self, key: ChunkKey, took: Duration) {
        add(&self.made[usize::from(key.level())], took);
        self.earn(key);
    }

    /// A read brought a chunk, which counts as if it had been made. Whether that ends a damage that
    /// was reported.
    pub fn useful(&self, key: ChunkKey) -> bool {
        self.earn(key);
        self.invalid.store(0, Ordering::Relaxed);
        self.is_damage_reported.swap(false, Ordering::Relaxed)
    }

    /// A read brought an object that is no chunk. Whether the store counts as damaged since then,
    /// once until a valid object: each wait for such an object delays its chunk, by far more than
    /// making it takes where the least wait is long.
    pub fn invalid(&self, now: Instant) -> bool {
        let before = self.invalid.load(Ordering::Relaxed);
        self.invalid.store(INVALID.min(before + 1), Ordering::Relaxed);
        let is_damaged = before + 1 >= INVALID;
        if is_damaged {
            self.hold_back(now);
        }
        is_damaged && !self.is_damage_reported.swap(true, Ordering::Relaxed)
    }

    /// The store does not have a chunk. If it was damaged, it may have been emptied: reads go on
    /// until the next invalid object.
    pub fn missing(&self) {
        self.invalid.fetch_min(INVALID - 1, Ordering::Relaxed);
    }

    /// A read was answered while its thread waited, with a chunk or without.
    pub fn in_time(&self) {
        let in_time = self.in_time.load(Ordering::Relaxed);
        self.in_time.store(LATE_PART.min(in_time + 1), Ordering::Relaxed);
    }

    /// A thread has waited this time for a read that brought no chunk.
    pub fn useless(&self, waited: Duration) {
        self.change_budget(-(nanoseconds(waited) as i64));
    }

    fn earn(&self, key: ChunkKey) {
        self.change_budget(nanoseconds(self.longest_wait(key)) as i64 / LOSS_PART);
    }

    fn change_budget(&self, by: i64) {
        let before = self.budget.load(Ordering::Relaxed);
        self.budget.store((before + by).clamp(-MAX_LOSS, MAX_LOSS), Ordering::Relaxed);
    }

    /// A read was answered in this time. Whether the store had failed before.
    pub fn answered(&self, took: Duration) -> bool {
        let took_ns = nanoseconds(took).max(1);
        let (presumed, read) = (self.presumed.load(Ordering::Relaxed), self.read.load(Ordering::Relaxed));
        if took_ns < presumed.max(read) / 2 {
            // The times presumed or measured before are out of date.
            self.presumed.store(0, Ordering::Relaxed);
            self.read.store(took_ns, Ordering::Relaxed);
        } else {
            let most = if read == 0 { u64::MAX } else { read.saturating_mul(MAX_OUTLIER) };
            add(&self.read, Duration::from_nanos(took_ns.min(most)));
        }
        self.failures.store(0, Ordering::Relaxed);
        presumed == FAILING
    }

    /// A read failed or had no answer within its timeout. True once, when the store
    /// begins to count as failing.
    pub fn failed(&self, now: Instant) -> bool {
        let failures = self.failures.fetch_add(1, Ordering::Relaxed).saturating_add(1);
        if failures < FAILURES {
            return false;
        }
        self.failures.store(FAILURES, Ordering::Relaxed);
        let begins = self.presumed.swap(FAILING, Ordering::Relaxed) != FAILING;
        if begins {
            self.hold_back(now);
        }
        begins
    }

    /// A read was not answered within this time: it takes longer, by how much is not known.
    pub fn late(&self, waited: Duration, now: Instant) {
        if self.in_time.swap(0, Ordering::Relaxed) == LATE_PART {
            return;
        }
        self.presumed.fetch_max(nanoseconds(waited.saturating_mul(2)), Ordering::Relaxed);
        self.hold_back(now);
    }

    /// The next try is one pause from now.
    fn hold_back(&self, now: Instant) {
        *self.tried.lock().unwrap_or_else(PoisonError::into_inner) = Some(now);
    }
}

/// At most an hour, so that no sum overflows.
fn nanoseconds(time: Duration) -> u64 {
    time.min(Duration::from_secs(3600)).as_nanos() as u64
}

fn add(mean: &AtomicU64, took: Duration) {
    let before = mean.load(Ordering::Relaxed);
    let took = nanoseconds(took);
    let after = if before == 0 { took } else { before - before / WINDOW + took / WINDOW };
    mean.store(after.max(1), Ordering::Relaxed);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    const MS: fn(u64) -> Duration = Duration::from_millis;

    #[test]
    fn a_chunk_waits_as_long_as_it_takes_to_make_if_answers_come_sooner() {
        let (pace, now) = (Pace::new(Duration::ZERO), Instant::now());
        let [expensive, cheap] = [5, 2].map(|level| ChunkKey::new(level, 0, 0).unwrap());
        assert_eq!(pace.wait(expensive, false, now), Some(UNKNOWN));
        pace.made(expensive, MS(30));
        pace.made(cheap, MS(1));
        pace.answered(MS(10));
        assert_eq!(pace.wait(expensive, false, now), Some(MS(30)));
        assert!(pace.is_worth_writing(expensive) && !pace.is_worth_writing(cheap));
        assert_eq!(pace.wait(cheap, false, now), Some(MS(1)), "once, to see how long it takes");
        assert_eq!(pace.wait(cheap, false, now), None);
        assert_eq!(pace.wait(cheap, false, now + RETRY), Some(MS(1)));
    }

    /// The bound of 1.5 times the latency without a store follows from this: without a least wait,
    /// reads that find nothing take an eighth of the time of making the chunks.
    #[test]
    fn reads_without_a_result_take_an_eighth_of_the_time_of_making() {
        let (pace, now) = (Pace::new(Duration::ZERO), Instant::now());
        let key = ChunkKey::new(3, 0, 0).unwrap();
        let (mut made, mut lost) = (Duration::ZERO, Duration::ZERO);
        for _ in 0..10_000 {
            if pace.wait(key, false, now).is_some() {
                pace.answered(MS(2));
                pace.useless(MS(2));
                lost += MS(2);
            }
            pace.made(key, MS(3));
            made += MS(3);
        }
        assert!(lost <= made / 8 + Duration::from_nanos(MAX_LOSS as u64) + 2 * MS(2), "{lost:?} of {made:?}");
        assert!(lost >= made / 9, "the control: reads go on, to see whether they bring something");
        // Objects known to be in the store are read all the same.
        while pace.wait(key, false, now).is_some() {
            pace.useless(MS(2));
        }
        assert_eq!(pace.wait(key, true, now), Some(MS(3)));
        // They bring something again: after few of them none is left out.
        let read = |_: &u32| pace.wait(key, false, now).is_some();
        for _ in 0..1000 {
            if read(&0) {
                pace.useful(key);
            } else {
                pace.made(key, MS(3));
            }
        }
        assert_eq!((0..1000).filter(read).count(), 1000);
    }

    /// Every wait of a damaged store is as long as a read, which takes ten times as long as making
    /// the chunk: few chunks of a thousand pay for it. Writes go on, since they repair it.
    #[test]
    fn invalid_objects_in_a_row_stop_reads_until_a_valid_one() {
        let (pace, now) = (Pace::new(MS(100)), Instant::now());
        let key = ChunkKey::new(3, 0, 0).unwrap();
        let mut begun = 0;
        let reads = (0..1000).filter(|_| {
            let is_read = pace.wait(key, true, now).is_some();
            if is_read {
                pace.answered(MS(10));
                begun += usize::from(pace.invalid(now));
                pace.useless(MS(10));
            }
            pace.made(key, MS(1));
            is_read
        });
        assert_eq!(reads.count(), INVALID as usize);
        assert_eq!(begun, 1);
        assert!(pace.is_worth_writing(key));
        assert!(pace.wait(key, true, now + RETRY).is_some(), "one try");
        assert!(!pace.invalid(now + RETRY), "known");
        assert_eq!(pace.wait(key, true, now + RETRY), None);
        assert!(pace.wait(key, true, now + 2 * RETRY).is_some());
        assert!(pace.useful(key), "reported once");
        assert!(!pace.useful(key));
        assert!(pace.wait(key, true, now + 2 * RETRY).is_some());
    }

    /// An operator empties a damaged store: one try finds that, and all reads follow. The control
    /// is a store with as many damaged objects as missing ones: two reads in 5 s.
    #[test]
    fn reads_of_an_emptied_store_go_on() {
        let key = ChunkKey::new(3, 0, 0).unwrap();
        for (missing_in, reads_in_5_s) in [(1, 5000), (2, 2)] {
            let (pace, start) = (Pace::new(MS(100)), Instant::now());
            let warnings = (0..INVALID).filter(|_| pace.invalid(start)).count();
            let (mut reads, mut later_warnings) = (0_u32, 0);
            for ms in 0..10_000 {
                let now = start + MS(ms);
                if pace.wait(key, true, now).is_none() {
                    continue;
                }
                reads += 1;
                if reads % missing_in == 0 {
                    pace.missing();
                } else {
                    later_warnings += u32::from(pace.invalid(now));
                }
            }
            assert_eq!((warnings, later_warnings), (1, 0));
            assert!(reads <= reads_in_5_s && reads + 1 >= reads_in_5_s, "{missing_in}: {reads}");
        }
    }

    /// The control: one damaged object of four holds no read back.
    #[test]
    fn some_invalid_objects_stop_no_reads() {
        let (pace, now) = (Pace::new(MS(100)), Instant::now());
        let key = ChunkKey::new(3, 0, 0).unwrap();
        let is_read = |number: &u32| {
            let is_read = pace.wait(key, true, now).is_some();
            if number.is_multiple_of(4) {
                pace.invalid(now);
            } else {
                pace.useful(key);
            }
            is_read
        };
        assert_eq!((0..1000).filter(is_read).count(), 1000);
    }

    /// One of twenty chunks is missing in a store for which every chunk may wait: the others are
    /// read. The control is a chunk that may wait only as long as it takes to make, less than a
    /// read.
    #[test]
    fn few_missing_chunks_hold_back_no_read_of_a_chunk_that_may_wait() {
        let read = |least_wait| {
            let (pace, now) = (Pace::new(least_wait), Instant::now());
            let key = ChunkKey::new(3, 0, 0).unwrap();
            let admitted = (0..1200).filter(|number| {
                let is_read = pace.wait(key, false, now).is_some();
                match (is_read, number % 20) {
                    (true, 0) => {
                        pace.answered(MS(6));
                        pace.useless(MS(6));
                        pace.made(key, MS(1));
                    }
                    (true, _) => {
                        pace.answered(MS(6));
                        pace.useful(key);
                    }
                    (false, _) => pace.made(key, MS(1)),
                }
                is_read
            });
            admitted.count()
        };
        assert_eq!(read(MS(2000)), 1200);
        assert!(read(Duration::ZERO) < 100);
    }

    #[test]
    fn a_late_answer_stops_reads_and_one_in_time_begins_them_again() {
        let (pace, now) = (Pace::new(MS(5)), Instant::now());
        let key = ChunkKey::new(3, 0, 0).unwrap();
        let wait = |now| pace.wait(key, false, now);
        pace.made(key, MS(1));
        assert_eq!(wait(now), Some(MS(5)), "the least wait");
        pace.late(MS(5), now);
        assert_eq!(wait(now), None);
        assert_eq!(wait(now + RETRY), Some(MS(5)), "once");
        assert_eq!(wait(now + RETRY), None);
        // The late answer comes, and says nothing new.
        pace.answered(MS(9));
        assert_eq!(wait(now + RETRY), None);
        pace.answered(MS(2));
        assert_eq!(wait(now + RETRY), Some(MS(5)));
        assert!(pace.is_worth_writing(key));
    }

    #[test]
    fn one_late_answer_of_many_stops_nothing() {
        let (pace, now) = (Pace::new(MS(5)), Instant::now());
        let key = ChunkKey::new(3, 0, 0).unwrap();
        pace.made(key, MS(1));
        for answers in [LATE_PART, LATE_PART - 1] {
            for _ in 0..answers {
                pace.answered(MS(1));
                pace.in_time();
            }
            pace.late(MS(5), now);
            pace.answered(MS(200));
            assert_eq!(pace.wait(key, false, now).is_some(), answers == LATE_PART, "{answers}");
        }
    }

    #[test]
    fn failures_in_a_row_stop_reads_and_an_answer_begins_them_again() {
        let (pace, now) = (Pace::new(MS(5)), Instant::now());
        let key = ChunkKey::new(3, 0, 0).unwrap();
        let begins = || (0..FAILURES).map(|_| pace.failed(now)).collect::<Vec<_>>();
        assert_eq!(begins(), [false, false, false, false, true]);
        assert_eq!(begins(), [false; 5], "it fails already");
        assert_eq!(pace.wait(key, false, now), None);
        assert!(!pace.is_worth_writing(key));
        assert_eq!(pace.wait(key, false, now + RETRY), Some(UNKNOWN));
        assert!(pace.answered(MS(1)) && !pace.answered(MS(1)));
        assert_eq!(pace.wait(key, false, now + RETRY), Some(UNKNOWN));
        (1..FAILURES).for_each(|_| _ = pace.failed(now));
        pace.answered(MS(1));
        (1..FAILURES).for_each(|_| _ = pace.failed(now));
        assert!(pace.wait(key, false, now + RETRY).is_some(), "the control: not in a row");
    }

    /// A store hangs, or takes 1.5 s, for a minute under steady load, and may answer once more
    /// after 1.5 s. Meanwhile few reads are sent; two pauses after that all are.
    #[test]
    fn a_store_that_comes_back_is_read_again() {
        const TIMEOUT: Duration = Duration::from_secs(2);
        let key = ChunkKey::new(3, 0, 0).unwrap();
        const SLOW: Duration = Duration::from_millis(1500);
        for (slow, returns_slowly) in [(None, false), (None, true), (Some(SLOW), false)] {
            let mut is_first_after = returns_slowly;
            let (pace, start) = (Pace::new(Duration::ZERO), Instant::now());
            let mut pending: VecDeque<(u64, Option<Duration>)> = VecDeque::new();
            let (mut during, mut after, mut requests) = (0, 0, 0);
            // A request a millisecond; making takes 3 ms, and a quick read 1 ms.
            for ms in 0..120_000 {
                let now = start + MS(ms);
                while pending.front().is_some_and(|(end, _)| *end <= ms) {
                    match pending.pop_front() {
                        Some((_, Some(took))) => _ = pace.answered(took),
                        _ => _ = pace.failed(now),
                    }
                }
                let admitted = pace.wait(key, false, now);
                let was_bad = (10_000..70_000).contains(&ms);
                let is_slow_once = ms >= 70_000 && admitted.is_some() && std::mem::take(&mut is_first_after);
                let (is_bad, slow) = (was_bad || is_slow_once, slow.or(is_slow_once.then_some(SLOW)));
                during += u32::from(is_bad && admitted.is_some());
                requests += u32::from(ms >= 80_000);
                after += u32::from(ms >= 80_000 && admitted.is_some());
                match (admitted, is_bad) {
                    (Some(_), false) => {
                        pace.answered(MS(1));
                        pace.in_time();
                        pace.useful(key);
                    }
                    (Some(wait), true) => {
                        pending.push_back((ms + slow.unwrap_or(TIMEOUT).as_millis() as u64, slow));
                        pace.late(wait, now + wait);
                        pace.useless(wait);
                        pace.made(key, MS(3));
                    }
                    (None, _) => pace.made(key, MS(3)),
                }
            }
            assert!(during <= 16, "{slow:?}: {during} reads");
            assert_eq!(after, requests, "{slow:?} {returns_slowly}");
        }
    }
}
