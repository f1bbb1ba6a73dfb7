//! What one address may cost: a bucket of work that fills at a rate.
//!
//! Turns by cost share the threads between those who wait; they slow nobody who is alone. Where a
//! server's time or traffic is paid for, or the machine has other work, an address can be bounded
//! besides: by the microseconds of generation that it causes and the bytes that it is sent, in one
//! currency. Whoever has spent what it has waits until there is something again: views for as long
//! as it takes, requests as long as the deadline allows, and what would wait longer is refused as
//! overloaded at once.
//!
//! By address, since sessions are free: a limit on one would be a limit on none. An address may
//! overdraw by one chunk, so that any chunk can be had at any rate.

use crate::addresses::group;
use rustc_hash::FxHashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// What a purse holds when full, as time of filling: a first view at once, seconds after nothing
/// was asked for.
const DEPTH_S: f64 = 10.0;

/// Microseconds that sending a KiB counts. One server thread writes some GB a second of processor
/// time.
const US_PER_KIB: f64 = 1.0;

/// Addresses with something spent before those that have it back are looked for.
const SWEEP_AT: usize = 1024;

/// Weight of the past against one chunk: a mean over about the last 16.
const MEMORY: f64 = 16.0;

/// The purses of all addresses.
#[derive(Clone, Debug)]
pub struct Purses {
    shared: Option<Arc<Shared>>,
}

#[derive(Debug)]
struct Shared {
    /// Microseconds of work a second.
    rate: f64,
    /// Only of addresses whose purse is not full, and of those not yet swept out: at most twice as
    /// many as spent anything within [`DEPTH_S`], and [`SWEEP_AT`].
    accounts: Mutex<Accounts>,
}

#[derive(Debug, Default)]
struct Accounts {
    by_address: FxHashMap<IpAddr, Account>,
    sweep_at: usize,
}

/// Microseconds of work, at a moment.
#[derive(Clone, Copy, Debug)]
struct Account {
    balance: f64,
    at: Instant,
    /// Mean of what a chunk took out; 0 before there was one.
    mean: f64,
}

/// One address's purse. All purses of an address are one.
#[derive(Clone, Debug, Default)]
pub struct Purse {
    /// None where nothing is counted.
    of: Option<(IpAddr, Arc<Shared>)>,
}

impl Purses {
    /// Purses that fill at a rate, milliseconds of work a second; none for no limit.
    #[must_use]
    pub fn new(ms_per_second: Option<u64>) -> Self {
        let shared = |ms| {
            let accounts = Accounts { by_address: FxHashMap::default(), sweep_at: SWEEP_AT };
            Arc::new(Shared { rate: ms as f64 * 1000.0, accounts: Mutex::new(accounts) })
        };
        Self { shared: ms_per_second.map(shared) }
    }

    /// That of an address. A peer without an address is not limited.
    #[must_use]
    pub fn of(&self, address: Option<IpAddr>) -> Purse {
        Purse { of: address.zip(self.shared.clone()).map(|(address, shared)| (group(address), shared)) }
    }
}

impl Purse {
    /// Whether anything is counted at all.
    #[must_use]
    pub const fn is_limited(&self) -> bool {
        self.of.is_some()
    }

    /// Among how many a thread would have to be shared for each to get what this purse is filled
    /// with; 1 where nothing is counted.
    #[must_use]
    pub fn sharers(&self) -> usize {
        self.of.as_ref().map_or(1, |(_, shared)| (1e6 / shared.rate).ceil().max(1.0) as usize)
    }

    /// Takes out what a chunk costs to make, microseconds.
    pub fn pay_work(&self, us: i64, now: Instant) {
        self.with(now, |account, _| {
            let known = if account.mean > 0.0 { account.mean } else { us as f64 };
            account.mean = known + (us as f64 - known) / MEMORY;
            account.balance -= us as f64;
        });
    }

    /// Takes out the time that the selection of a view took, microseconds. The mean cost of a chunk
    /// does not change.
    pub fn pay_view(&self, us: i64, now: Instant) {
        self.with(now, |account, _| account.balance -= us as f64);
    }

    /// Takes out what it costs to send bytes.
    pub fn pay_bytes(&self, bytes: usize, now: Instant) {
        self.with(now, |account, _| account.balance -= bytes as f64 / 1024.0 * US_PER_KIB);
    }

    /// Until there is something in it; none if there is.
    #[must_use]
    pub fn wait(&self, now: Instant) -> Option<Duration> {
        let (balance, rate) = self.with(now, |account, rate| (account.balance, rate))?;
        if balance > 0.0 {
            return None;
        }
        // A whole microsecond of work more, so that rounding never leaves it just empty.
        Some(Duration::from_secs_f64((1.0 - balance) / rate) + Duration::from_nanos(1))
    }

    /// Chunks that it can pay for within a time, by what the last ones cost.
    #[must_use]
    pub fn affords(&self, time: Duration, now: Instant) -> usize {
        let affords = |account: &mut Account, rate: f64| {
            let means = (account.balance + rate * time.as_secs_f64()).max(0.0);
            // As a cast of more than fits does, what costs nothing can be had as often as one
            // likes.
            (means / account.mean.max(1.0)) as usize
        };
        self.with(now, affords).unwrap_or(usize::MAX)
    }

    fn with<T>(&self, now: Instant, act: impl FnOnce(&mut Account, f64) -> T) -> Option<T> {
        let (address, shared) = self.of.as_ref()?;
        let (rate, full) = (shared.rate, shared.rate * DEPTH_S);
        // Nothing panics under the lock.
        let mut accounts = shared.accounts.lock().unwrap_or_else(PoisonError::into_inner);
        let Accounts { by_address, sweep_at } = &mut *accounts;
        if by_address.len() >= *sweep_at {
            by_address.retain(|_, account| account.filled(rate, full, now).balance < full);
            *sweep_at = (2 * by_address.len()).max(SWEEP_AT);
        }
        let fresh = Account { balance: full, at: now, mean: 0.0 };
        let account = by_address.entry(*address).or_insert(fresh);
        *account = account.filled(rate, full, now);
        Some(act(account, rate))
    }
}

impl Account {
    /// What it has become by a moment. Moments may come in any order: threads read the clock before
    /// they have the lock.
    fn filled(self, rate: f64, full: f64, now: Instant) -> Self {
        let gained = rate * now.saturating_duration_since(self.at).as_secs_f64();
        Self { balance: (self.balance + gained).min(full), at: self.at.max(now), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(text: &str) -> Option<IpAddr> {
        Some(text.parse().unwrap())
    }

    /// Asks for chunks of a cost whenever it may, for some seconds. Returns how many it had.
    fn greedy(purse: &Purse, start: Instant, seconds: u64, cost_us: i64) -> u64 {
        let (mut now, mut had) = (start, 0);
        while now < start + Duration::from_secs(seconds) {
            match purse.wait(now) {
                Some(wait) => now += wait,
                None => {
                    purse.pay_work(cost_us, now);
                    had += 1;
                    // It is made.
                    now += Duration::from_micros(cost_us as u64);
                }
            }
        }
        had
    }

    #[test]
    fn who_asks_for_the_dearest_only_gets_the_rate_however_idle_the_server_is() {
        let start = Instant::now();
        let seconds = 200;
        for cost_us in [20, 3000, 900_000] {
            // 50 ms a second; 5 % of one thread.
            let purse = Purses::new(Some(50)).of(address("10.0.0.1"));
            let spent = greedy(&purse, start, seconds, cost_us) * cost_us as u64;
            // What came; besides, what was in it and one chunk on credit.
            let came = 50_000 * seconds;
            let most = came + 500_000 + cost_us as u64;
            assert!(spent <= most && spent > came * 9 / 10, "{spent} of {came} by {cost_us}");
        }
        // The control: nobody limits.
        let free = Purses::new(None).of(address("10.0.0.1"));
        assert_eq!(greedy(&free, start, 10, 1000), 10_000);
    }

    #[test]
    fn all_sessions_of_an_address_share_one_purse_and_other_addresses_have_their_own() {
        let (purses, now) = (Purses::new(Some(1)), Instant::now());
        let [one, same, other] = ["10.0.0.1", "10.0.0.1", "10.0.0.2"].map(|text| purses.of(address(text)));
        one.pay_work(60_000, now);
        let wait = same.wait(now).unwrap();
        assert!((50.0..50.1).contains(&wait.as_secs_f64()), "{wait:?}");
        assert_eq!(same.wait(now + wait), None);
        assert_eq!(other.wait(now), None);
        let nobody = purses.of(None);
        nobody.pay_work(i64::MAX, now);
        assert_eq!((nobody.wait(now), nobody.is_limited()), (None, false));
        assert_eq!(nobody.affords(Duration::ZERO, now), usize::MAX);
    }

    #[test]
    fn bytes_cost_too() {
        let (purse, now) = (Purses::new(Some(1)).of(address("10.0.0.1")), Instant::now());
        purse.pay_bytes(9 << 20, now);
        assert_eq!(purse.wait(now), None);
        purse.pay_bytes(9 << 20, now);
        assert!(purse.wait(now) > Some(Duration::from_secs(8)));
    }

    #[test]
    fn what_can_be_paid_within_the_deadline_is_told_by_what_chunks_cost_lately() {
        let (purse, now) = (Purses::new(Some(10)).of(address("10.0.0.1")), Instant::now());
        for _ in 0..100 {
            purse.pay_work(1000, now);
        }
        // All of it is spent. In half a second come five milliseconds.
        let second = Duration::from_millis(500);
        assert!((5..=6).contains(&purse.affords(second, now)), "{}", purse.affords(second, now));
        purse.pay_work(50_000, now);
        assert_eq!(purse.affords(second, now), 0);
        assert!(purse.affords(second, now + Duration::from_secs(60)) > 10);
    }

    #[test]
    fn who_has_everything_back_is_forgotten() {
        let (purses, start) = (Purses::new(Some(10)), Instant::now());
        let Some(shared) = &purses.shared else { panic!("a limit") };
        let visit = |from: u32, now| {
            for number in from..from + 5000 {
                purses.of(Some(IpAddr::from(number.to_be_bytes()))).pay_work(1000, now);
            }
            shared.accounts.lock().unwrap().by_address.len()
        };
        assert_eq!(visit(0, start), 5000, "none of them has it back");
        assert!(visit(100_000, start + Duration::from_secs(60)) <= 2 * 5000 + SWEEP_AT);
        assert!(visit(200_000, start + Duration::from_secs(120)) <= 2 * 5000 + SWEEP_AT);
    }

    #[test]
    fn a_clock_read_before_another_does_not_take_time_back() {
        let (purse, now) = (Purses::new(Some(10)).of(address("10.0.0.1")), Instant::now());
        purse.pay_work(200_000, now + Duration::from_secs(5));
        let before = purse.wait(now + Duration::from_secs(5));
        assert_eq!(purse.wait(now), before);
        assert_eq!(purse.wait(now + Duration::from_secs(5)), before);
    }
}
