//! Token-bucket rate limit per client network.
//!
//! A token is one microsecond of work: generation, view selection and bytes sent, in one unit. A
//! bucket refills at a fixed rate and holds at most 10 seconds of it. While a bucket is
//! empty, views are delayed, requests are delayed up to their deadline, and requests that would
//! exceed the deadline are rejected as overloaded at once.
//!
//! Fair queueing alone does not bound the work of a single client on an idle server. The limit
//! applies to networks because a client can open any number of sessions.
//!
//! A chunk may start while the bucket holds any token, so that one of any cost can be served at any
//! rate. The balance can become negative, by the cost of started chunks, by a view selection and by
//! sent bytes. Sessions of a network check the bucket independently, and several can overdraw it at
//! once. Nothing new starts until the debt is repaid.

use crate::limits::networks::client_network;
use crate::metrics::Metrics;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Capacity of a bucket, seconds of refill.
const CAPACITY_S: f64 = 10.0;

/// Tokens (microseconds) charged per KiB sent. One server thread writes some GB per second of
/// processor time.
const US_PER_KIB: f64 = 1.0;

/// Buckets in the table before full ones are removed.
const MIN_SWEEP_SIZE: usize = 1024;

/// Window of the moving average of a chunk's cost, chunks.
const EWMA_WINDOW: f64 = 16.0;

/// The buckets of all client networks.
#[derive(Clone, Debug)]
pub struct RateLimiter {
    table: Option<Arc<BucketTable>>,
}

#[derive(Debug)]
struct BucketTable {
    /// Tokens per second.
    rate: f64,
    /// Buckets by network. Full ones are removed when the table reaches twice the number that the
    /// last sweep left, and not below [`MIN_SWEEP_SIZE`].
    buckets: Mutex<Buckets>,
}

/// The standard hasher is keyed at random: peers choose the addresses.
#[derive(Debug, Default)]
struct Buckets {
    by_network: HashMap<IpAddr, Bucket>,
    sweep_at: usize,
}

/// The tokens of a network at a moment.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    tokens: f64,
    at: Instant,
    /// Moving average of a chunk's cost; 0 before the first chunk.
    mean_cost: f64,
}

/// Handle to the bucket of one network; every handle of a network shares one bucket. The default
/// is unlimited.
#[derive(Clone, Debug, Default)]
pub struct TokenBucket {
    target: Option<(IpAddr, Arc<BucketTable>)>,
}

impl RateLimiter {
    /// Buckets that refill with `ms_per_second` milliseconds of work per second; none for no limit.
    #[must_use]
    pub fn new(ms_per_second: Option<u64>) -> Self {
        let table = |ms| {
            let buckets = Buckets { by_network: HashMap::new(), sweep_at: MIN_SWEEP_SIZE };
            Arc::new(BucketTable { rate: ms as f64 * 1000.0, buckets: Mutex::new(buckets) })
        };
        Self { table: ms_per_second.map(table) }
    }

    /// The bucket of an address's network. A peer without an address is not limited.
    #[must_use]
    pub fn bucket(&self, address: Option<IpAddr>) -> TokenBucket {
        TokenBucket {
            target: address.zip(self.table.clone()).map(|(address, table)| (client_network(address), table)),
        }
    }
}

impl TokenBucket {
    /// Whether a limit applies.
    #[must_use]
    pub const fn is_limited(&self) -> bool {
        self.target.is_some()
    }

    /// Into how many equal shares a thread is divided if the rate of this bucket is one share.
    /// Rounded up. 1 without a limit.
    #[must_use]
    pub fn thread_shares(&self) -> usize {
        self.target.as_ref().map_or(1, |(_, table)| (1e6 / table.rate).ceil().max(1.0) as usize)
    }

    /// Charges the generation of a chunk, microseconds.
    pub fn charge_chunk(&self, us: i64, now: Instant) {
        self.with(now, |bucket, _| {
            let known = if bucket.mean_cost > 0.0 { bucket.mean_cost } else { us as f64 };
            bucket.mean_cost = known + (us as f64 - known) / EWMA_WINDOW;
            bucket.tokens -= us as f64;
        });
    }

    /// Charges work that is no job of a chunk, microseconds: the selection of a view, the rendering
    /// of a tile, a further encoding. The mean cost of a chunk does not change.
    pub fn charge_work(&self, us: i64, now: Instant) {
        self.with(now, |bucket, _| bucket.tokens -= us as f64);
    }

    /// Replaces the estimate that was charged for a chunk by its measured cost, microseconds.
    pub fn settle_chunk(&self, charged_us: i64, spent_us: i64, now: Instant) {
        self.with(now, |bucket, _| {
            let more = spent_us as f64 - charged_us as f64;
            if bucket.mean_cost > 0.0 {
                bucket.mean_cost = (bucket.mean_cost + more / EWMA_WINDOW).max(1.0);
            }
            bucket.tokens -= more;
        });
    }

    /// Returns what was charged for a chunk that was not generated, microseconds.
    pub fn refund(&self, us: i64, now: Instant) {
        // The next refill limits the tokens to the capacity.
        self.with(now, |bucket, _| bucket.tokens += us as f64);
    }

    /// Charges bytes sent.
    pub fn charge_bytes(&self, bytes: usize, now: Instant) {
        self.with(now, |bucket, _| bucket.tokens -= bytes as f64 / 1024.0 * US_PER_KIB);
    }

    /// Time until the bucket is no longer empty; none if it is not.
    #[must_use]
    pub fn delay(&self, now: Instant) -> Option<Duration> {
        let (tokens, rate) = self.with(now, |bucket, rate| (bucket.tokens, rate))?;
        if tokens > 0.0 {
            return None;
        }
        // One whole token more, so that rounding never leaves the bucket just empty.
        Some(Duration::from_secs_f64((1.0 - tokens) / rate) + Duration::from_nanos(1))
    }

    /// Waits until the bucket is not empty, and counts the delays. False, counted as a rejection,
    /// if that would be after `by`.
    #[must_use]
    pub async fn wait(&self, by: Instant, metrics: &Metrics) -> bool {
        loop {
            let now = Instant::now();
            // Of several requests that wait for the same moment, the first takes the tokens; the
            // others wait again.
            let Some(delay) = self.delay(now) else { return true };
            if now + delay > by {
                metrics.limits.rate_limit_rejections.inc();
                return false;
            }
            metrics.limits.rate_limit_delays.inc();
            sleep(delay).await;
        }
    }

    /// Chunks that the bucket can pay for within a time, at the recent mean cost.
    #[must_use]
    pub fn affordable_chunks(&self, time: Duration, now: Instant) -> usize {
        let affordable = |bucket: &mut Bucket, rate: f64| {
            let tokens = (bucket.tokens + rate * time.as_secs_f64()).max(0.0);
            // The cast saturates.
            (tokens / bucket.mean_cost.max(1.0)) as usize
        };
        self.with(now, affordable).unwrap_or(usize::MAX)
    }

    /// The tokens left, microseconds; 0 without a limit.
    #[cfg(test)]
    pub fn tokens(&self) -> f64 {
        self.with(Instant::now(), |bucket, _| bucket.tokens).unwrap_or(0.0)
    }

    fn with<T>(&self, now: Instant, act: impl FnOnce(&mut Bucket, f64) -> T) -> Option<T> {
        let (network, table) = self.target.as_ref()?;
        let (rate, capacity) = (table.rate, table.rate * CAPACITY_S);
        // Nothing panics under the lock.
        let mut buckets = table.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        let Buckets { by_network, sweep_at } = &mut *buckets;
        if by_network.len() >= *sweep_at {
            by_network.retain(|_, bucket| bucket.refilled(rate, capacity, now).tokens < capacity);
            *sweep_at = (2 * by_network.len()).max(MIN_SWEEP_SIZE);
        }
        let full = Bucket { tokens: capacity, at: now, mean_cost: 0.0 };
        let bucket = by_network.entry(*network).or_insert(full);
        *bucket = bucket.refilled(rate, capacity, now);
        Some(act(bucket, rate))
    }
}

impl Bucket {
    /// The bucket at a moment. Moments may come in any order: threads read the clock before they
    /// take the lock.
    fn refilled(self, rate: f64, capacity: f64, now: Instant) -> Self {
        let gained = rate * now.saturating_duration_since(self.at).as_secs_f64();
        Self { tokens: (self.tokens + gained).min(capacity), at: self.at.max(now), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(text: &str) -> Option<IpAddr> {
        Some(text.parse().unwrap())
    }

    /// Requests chunks of a cost whenever the bucket allows it, for some seconds. Returns the
    /// number of chunks.
    fn saturate(bucket: &TokenBucket, start: Instant, seconds: u64, cost_us: i64) -> u64 {
        let (mut now, mut chunks) = (start, 0);
        while now < start + Duration::from_secs(seconds) {
            match bucket.delay(now) {
                Some(delay) => now += delay,
                None => {
                    bucket.charge_chunk(cost_us, now);
                    chunks += 1;
                    // The time of its generation.
                    now += Duration::from_micros(cost_us as u64);
                }
            }
        }
        chunks
    }

    #[test]
    fn the_rate_holds_for_every_chunk_cost() {
        let start = Instant::now();
        let seconds = 200;
        for cost_us in [20, 3000, 900_000] {
            // 50 ms per second, 5 % of one thread.
            let bucket = RateLimiter::new(Some(50)).bucket(address("10.0.0.1"));
            let spent = saturate(&bucket, start, seconds, cost_us) * cost_us as u64;
            // The refill, the initial capacity, and one chunk of overdraft.
            let refill = 50_000 * seconds;
            let most = refill + 500_000 + cost_us as u64;
            assert!(spent <= most && spent > refill * 9 / 10, "{spent} of {refill} by {cost_us}");
        }
        // The control: no limit.
        let unlimited = RateLimiter::new(None).bucket(address("10.0.0.1"));
        assert_eq!(saturate(&unlimited, start, 10, 1000), 10_000);
    }

    #[test]
    fn sessions_of_one_address_share_a_bucket() {
        let (limiter, now) = (RateLimiter::new(Some(1)), Instant::now());
        let [one, same, other] =
            ["10.0.0.1", "10.0.0.1", "10.0.0.2"].map(|text| limiter.bucket(address(text)));
        one.charge_chunk(60_000, now);
        let delay = same.delay(now).unwrap();
        assert!((50.0..50.1).contains(&delay.as_secs_f64()), "{delay:?}");
        assert_eq!(same.delay(now + delay), None);
        assert_eq!(other.delay(now), None);
        let unlimited = limiter.bucket(None);
        unlimited.charge_chunk(i64::MAX, now);
        assert_eq!((unlimited.delay(now), unlimited.is_limited()), (None, false));
        assert_eq!(unlimited.affordable_chunks(Duration::ZERO, now), usize::MAX);
    }

    #[test]
    fn sent_bytes_are_charged() {
        let (bucket, now) = (RateLimiter::new(Some(1)).bucket(address("10.0.0.1")), Instant::now());
        bucket.charge_bytes(9 << 20, now);
        assert_eq!(bucket.delay(now), None);
        bucket.charge_bytes(9 << 20, now);
        assert!(bucket.delay(now) > Some(Duration::from_secs(8)));
    }

    #[test]
    fn affordable_chunks_follow_the_recent_mean_cost() {
        let (bucket, now) = (RateLimiter::new(Some(10)).bucket(address("10.0.0.1")), Instant::now());
        for _ in 0..100 {
            bucket.charge_chunk(1000, now);
        }
        // The bucket is empty. Half a second refills five milliseconds.
        let half = Duration::from_millis(500);
        assert!(
            (5..=6).contains(&bucket.affordable_chunks(half, now)),
            "{}",
            bucket.affordable_chunks(half, now)
        );
        bucket.charge_chunk(50_000, now);
        assert_eq!(bucket.affordable_chunks(half, now), 0);
        assert!(bucket.affordable_chunks(half, now + Duration::from_secs(60)) > 10);
    }

    #[test]
    fn each_charge_takes_what_it_names_and_a_refund_returns_it() {
        let (bucket, now) = (RateLimiter::new(Some(10)).bucket(address("10.0.0.1")), Instant::now());
        // Before the first chunk these are tokens.
        let left = || bucket.affordable_chunks(Duration::ZERO, now);
        assert_eq!(left(), 100_000, "ten seconds of refill");
        bucket.charge_work(30_000, now);
        bucket.refund(20_000, now);
        assert_eq!(left(), 90_000);
        bucket.charge_bytes(1000 * 1024, now);
        assert_eq!(left(), 89_000);
        bucket.settle_chunk(500, 1500, now);
        assert_eq!(left(), 88_000, "a bucket that was removed meanwhile has no mean cost");
        // The mean is that of the first chunk, and moves by a sixteenth of the difference.
        bucket.charge_chunk(1500, now);
        assert_eq!(left(), 86_500 / 1500);
        bucket.settle_chunk(1500, 3100, now);
        assert_eq!(left(), 84_900 / 1600);
        bucket.charge_chunk(3200, now);
        assert_eq!(left(), 81_700 / 1700);
    }

    #[test]
    fn an_empty_bucket_is_not_empty_after_its_delay_at_any_rate() {
        for ms in [1, 1000, 1_000_000] {
            let (bucket, now) = (RateLimiter::new(Some(ms)).bucket(address("10.0.0.1")), Instant::now());
            bucket.charge_work(ms as i64 * 10_000, now);
            let delay = bucket.delay(now).expect("it has no token");
            assert_eq!(bucket.delay(now + delay), None, "{ms} ms per second");
        }
    }

    #[test]
    fn a_rate_is_one_of_so_many_shares_of_a_thread() {
        for (ms, shares) in [(1, 1000), (3, 334), (1000, 1), (2000, 1)] {
            let bucket = RateLimiter::new(Some(ms)).bucket(address("10.0.0.1"));
            assert_eq!((bucket.thread_shares(), bucket.is_limited()), (shares, true), "{ms} ms");
        }
        assert_eq!(TokenBucket::default().thread_shares(), 1);
    }

    #[tokio::test(start_paused = true)]
    async fn a_wait_ends_with_a_token_or_is_rejected_at_once() {
        let (bucket, metrics) = (RateLimiter::new(Some(1)).bucket(address("10.0.0.1")), Metrics::default());
        let start = Instant::now();
        assert!(bucket.wait(start, &metrics).await, "the bucket is full");
        bucket.charge_work(15_000, start);
        let in_time = start + bucket.delay(start).unwrap();
        assert!(!bucket.wait(in_time - Duration::from_nanos(1), &metrics).await);
        assert_eq!(Instant::now(), start);
        assert!(bucket.wait(in_time, &metrics).await);
        assert!(Instant::now() >= in_time);
        let limits = &metrics.limits;
        assert_eq!((limits.rate_limit_delays.get(), limits.rate_limit_rejections.get()), (1, 1));
    }

    #[test]
    fn full_buckets_are_removed() {
        let (limiter, start) = (RateLimiter::new(Some(10)), Instant::now());
        let Some(table) = &limiter.table else { panic!("a limit") };
        let visit = |numbers: std::ops::Range<u32>, now| {
            for number in numbers {
                limiter.bucket(Some(IpAddr::from(number.to_be_bytes()))).charge_chunk(1000, now);
            }
            table.buckets.lock().unwrap().by_network.len()
        };
        let [second, third] = [60, 120].map(|seconds| start + Duration::from_secs(seconds));
        assert_eq!(visit(0..5000, start), 5000, "none of them is full");
        // To look through the table for every charge would take longer than the charge.
        assert_eq!(visit(100_000..101_000, second), 6000, "the table has not doubled");
        assert!(visit(101_000..105_000, second) <= 2 * 5000 + MIN_SWEEP_SIZE);
        assert!(visit(200_000..205_000, third) <= 2 * 5000 + MIN_SWEEP_SIZE);
    }

    #[test]
    fn an_earlier_clock_reading_does_not_drain_the_bucket() {
        let (bucket, now) = (RateLimiter::new(Some(10)).bucket(address("10.0.0.1")), Instant::now());
        bucket.charge_chunk(200_000, now + Duration::from_secs(5));
        let before = bucket.delay(now + Duration::from_secs(5));
        assert_eq!(bucket.delay(now), before);
        assert_eq!(bucket.delay(now + Duration::from_secs(5)), before);
    }
}
