//! Wrong access tokens per client network: each takes one of a few places, which become free again
//! at a fixed rate.

use crate::limits::networks::client_network;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Wrong tokens that an address may present at once.
const BURST: u32 = 10;

/// Time until one more is allowed: 14,400 guesses a day.
const REFILL: Duration = Duration::from_secs(6);

/// Networks in a generation of the table at most: what 32,768 buckets hold. Both take some 3 MiB.
const GENERATION: usize = 28_672;

/// See the module. The standard hasher is keyed at random: peers choose the addresses.
///
/// The table is bounded by two generations: when the recent one is full, it takes the place of the
/// older one, whose networks are forgotten. A peer with this many networks has ten guesses from
/// each in any case. Further networks are not refused, as their tokens may be valid.
#[derive(Debug, Default)]
pub struct GuessLimiter {
    table: Mutex<Table>,
}

#[derive(Debug, Default)]
struct Table {
    recent: HashMap<IpAddr, Guesses>,
    older: HashMap<IpAddr, Guesses>,
}

impl Table {
    fn get(&self, network: &IpAddr) -> Option<&Guesses> {
        self.recent.get(network).or_else(|| self.older.get(network))
    }

    fn insert(&mut self, network: IpAddr, guesses: Guesses) {
        if self.recent.len() >= GENERATION && !self.recent.contains_key(&network) {
            self.older = std::mem::take(&mut self.recent);
        }
        self.recent.insert(network, guesses);
    }
}

#[derive(Clone, Copy, Debug)]
struct Guesses {
    /// When all places are free again.
    free_at: Instant,
    /// The latest wrong token.
    last: TokenHash,
}

/// A hash of a token. The same wrong token again is no guess: a page with an old token repeats it.
pub type TokenHash = u64;

impl GuessLimiter {
    /// Whether the network has no place left for this token. A peer without an address is not
    /// limited.
    #[must_use]
    pub fn is_exhausted(&self, address: Option<IpAddr>, token: TokenHash, now: Instant) -> bool {
        let Some(network) = address.map(client_network) else { return false };
        self.table()
            .get(&network)
            .is_some_and(|guesses| guesses.last != token && guesses.free_at > now + REFILL * (BURST - 1))
    }

    /// Takes a place for a wrong token.
    pub fn charge(&self, address: Option<IpAddr>, token: TokenHash, now: Instant) {
        let Some(network) = address.map(client_network) else { return };
        let mut table = self.table();
        let known = table.get(&network);
        if known.is_some_and(|guesses| guesses.last == token) {
            return;
        }
        let free_at = known.map_or(now, |guesses| guesses.free_at.max(now)) + REFILL;
        table.insert(network, Guesses { free_at, last: token });
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        // Nothing under the lock panics in the middle of a change.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_ten_guesses_and_then_ten_a_minute() {
        let (limiter, start) = (GuessLimiter::default(), Instant::now());
        let one = Some("2001:db8::1".parse().unwrap());
        let same_network = Some("2001:db8::2".parse().unwrap());
        let mut token = 0;
        let mut guesses_at = |now| {
            let mut count = 0;
            while !limiter.is_exhausted(one, token + 1, now) {
                token += 1;
                limiter.charge(same_network, token, now);
                count += 1;
            }
            count
        };
        assert_eq!(guesses_at(start), 10);
        assert_eq!(guesses_at(start + Duration::from_secs(60)), 10);
        assert_eq!(guesses_at(start + Duration::from_secs(72)), 2);
        assert!(!limiter.is_exhausted(Some("2001:db8:0:1::1".parse().unwrap()), 1, start));
        limiter.charge(None, 1, start);
        assert!(!limiter.is_exhausted(None, 2, start));
    }

    #[test]
    fn the_same_wrong_token_again_is_no_guess() {
        let (limiter, start) = (GuessLimiter::default(), Instant::now());
        let one = Some("10.0.0.1".parse().unwrap());
        for _ in 0..1000 {
            assert!(!limiter.is_exhausted(one, 7, start));
            limiter.charge(one, 7, start);
        }
        for token in 8..17 {
            assert!(!limiter.is_exhausted(one, token, start), "{token} of nine more");
            limiter.charge(one, token, start);
        }
        assert!(limiter.is_exhausted(one, 7, start), "it is no longer the latest");
        assert!(!limiter.is_exhausted(one, 16, start));
    }

    #[test]
    fn the_table_is_bounded_and_forgets_the_networks_without_recent_guesses() {
        let (limiter, start) = (GuessLimiter::default(), Instant::now());
        let address = |number: u32| Some(IpAddr::from(number.to_be_bytes()));
        let charge = |number: u32, tokens: std::ops::Range<u64>| {
            tokens.for_each(|token| limiter.charge(address(number), token, start));
        };
        charge(1, 1..11);
        charge(2, 1..6);
        for number in 3..GENERATION as u32 + 10 {
            charge(number, 0..1);
        }
        assert!(limiter.is_exhausted(address(1), 0, start), "of the older generation");
        charge(2, 6..11);
        assert!(limiter.is_exhausted(address(2), 0, start), "five guesses of either generation");
        assert!(!limiter.is_exhausted(address(1 << 24), 0, start), "a further network is not refused");
        for number in 1..3 * GENERATION as u32 {
            charge(number + (1 << 24), 0..1);
            let table = limiter.table();
            assert!(table.recent.len() <= GENERATION && table.older.len() <= GENERATION);
        }
        assert!(!limiter.is_exhausted(address(1), 0, start), "forgotten");
    }
}
