//! Whether a read from the store saves time: what reads take against what making a chunk takes, and
//! how much time reads without a result have cost.

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use terrain::ChunkKey;
use terrain::constants::TOP_LEVEL;

/// Window of the moving averages.
const WINDOW: u64 = 8;

/// Taken for the time to make a chunk of a level of which none was made yet.
const UNKNOWN: Duration = Duration::from_millis(20);

/// Time between two reads of a store that has been too slow, to see whether it still is.
const RETRY: Duration = Duration::from_secs(5);

/// Reads without a result may take this part of the time that making chunks takes.
const LOSS_PART: i64 = 8;

/// Longest time that reads without a result may take ahead of that, nanoseconds.
const MAX_LOSS: i64 = 100_000_000;

/// Moving averages of times. Relaxed atomics: a lost update changes little.
#[derive(Debug)]
pub struct Pace {
    least_wait: Duration,
    /// By level, nanoseconds; 0 is unknown.
    made: [AtomicU64; TOP_LEVEL as usize + 1],
    /// Nanoseconds; 0 is unknown.
    read: AtomicU64,
    /// Nanoseconds that reads without a result may still take, at most [`MAX_LOSS`].
    budget: AtomicI64,
    tried: Mutex<Option<Instant>>,
}

impl Pace {
    /// Nothing is known yet. Every chunk may wait for this time, whatever it takes to make.
    #[must_use]
    pub fn new(least_wait: Duration) -> Self {
        let made = std::array::from_fn(|_| AtomicU64::new(0));
        let (read, budget) = (AtomicU64::new(0), AtomicI64::new(MAX_LOSS));
        Self { least_wait, made, read, budget, tried: Mutex::new(None) }
    }

    /// The time to wait for a chunk; none if its answer would likely come later than that, or if reads
    /// without a result have used up their time. Then one read every 5 s is worth a try all the
    /// same.
    pub fn wait(&self, key: ChunkKey, now: Instant) -> Option<Duration> {
        let wait = self.longest_wait(key);
        if self.is_quick(wait) && self.budget.load(Ordering::Relaxed) > 0 {
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
        Duration::from_nanos(self.read.load(Ordering::Relaxed)) <= wait
    }

    /// A chunk was made in this time.
    pub fn made(&self, key: ChunkKey, took: Duration) {
        add(&self.made[usize::from(key.level())], took);
        self.earn(took);
    }

    /// A read brought a chunk. It saved about what the chunk takes to make, which counts as if it had
    /// been made.
    pub fn useful(&self, key: ChunkKey) {
        self.earn(Duration::from_nanos(self.made[usize::from(key.level())].load(Ordering::Relaxed)));
    }

    /// A thread has waited this time for a read that brought no chunk.
    pub fn useless(&self, waited: Duration) {
        self.budget.fetch_sub(nanoseconds(waited) as i64, Ordering::Relaxed);
    }

    fn earn(&self, took: Duration) {
        let earned = nanoseconds(took) as i64 / LOSS_PART;
        let before = self.budget.fetch_add(earned, Ordering::Relaxed);
        if before + earned > MAX_LOSS {
            self.budget.store(MAX_LOSS, Ordering::Relaxed);
        }
    }

    /// A read was answered, or failed, in this time.
    pub fn read(&self, took: Duration) {
        add(&self.read, took);
    }

    /// A read was not answered within this time: it takes longer, by how much is not known.
    pub fn late(&self, waited: Duration, now: Instant) {
        self.read.fetch_max(nanoseconds(waited.saturating_mul(2)), Ordering::Relaxed);
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

    const MS: fn(u64) -> Duration = Duration::from_millis;

    #[test]
    fn a_chunk_waits_as_long_as_it_takes_to_make_if_answers_come_sooner() {
        let (pace, now) = (Pace::new(Duration::ZERO), Instant::now());
        let [expensive, cheap] = [5, 2].map(|level| ChunkKey::new(level, 0, 0).unwrap());
        assert_eq!(pace.wait(expensive, now), Some(UNKNOWN));
        pace.made(expensive, MS(30));
        pace.made(cheap, MS(1));
        pace.read(MS(10));
        assert_eq!(pace.wait(expensive, now), Some(MS(30)));
        assert!(pace.is_worth_writing(expensive) && !pace.is_worth_writing(cheap));
        assert_eq!(pace.wait(cheap, now), Some(MS(1)), "once, to see how long it takes");
        assert_eq!(pace.wait(cheap, now), None);
        assert_eq!(pace.wait(cheap, now + RETRY), Some(MS(1)));
    }

    /// The bound of 1.5 times the latency without a store follows from this: whatever a store does,
    /// its reads take an eighth more than making the chunks.
    #[test]
    fn reads_without_a_result_take_an_eighth_of_the_time_of_making() {
        let (pace, now) = (Pace::new(Duration::ZERO), Instant::now());
        let key = ChunkKey::new(3, 0, 0).unwrap();
        let (mut made, mut lost) = (Duration::ZERO, Duration::ZERO);
        for _ in 0..10_000 {
            if pace.wait(key, now).is_some() {
                pace.read(MS(2));
                pace.useless(MS(2));
                lost += MS(2);
            }
            pace.made(key, MS(3));
            made += MS(3);
        }
        assert!(lost <= made / 8 + Duration::from_nanos(MAX_LOSS as u64) + 2 * MS(2), "{lost:?} of {made:?}");
        assert!(lost >= made / 9, "the control: reads go on, to see whether they bring something");
        // They bring something again: after few of them none is left out.
        let read = |_: &u32| pace.wait(key, now).is_some();
        for _ in 0..1000 {
            if read(&0) {
                pace.useful(key);
            } else {
                pace.made(key, MS(3));
            }
        }
        assert_eq!((0..1000).filter(read).count(), 1000);
    }

    #[test]
    fn one_late_answer_stops_waiting_and_quick_ones_begin_it_again() {
        let (pace, now) = (Pace::new(MS(5)), Instant::now());
        let key = ChunkKey::new(3, 0, 0).unwrap();
        pace.made(key, MS(1));
        assert_eq!(pace.wait(key, now), Some(MS(5)), "the least wait");
        pace.late(MS(5), now);
        assert_eq!(pace.wait(key, now), None);
        assert_eq!(pace.wait(key, now + RETRY), Some(MS(5)), "once");
        assert_eq!(pace.wait(key, now + RETRY), None);
        (0..20).for_each(|_| pace.read(MS(1)));
        assert_eq!(pace.wait(key, now), Some(MS(5)));
    }
}
