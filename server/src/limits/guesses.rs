//! Wrong access tokens per client network: each takes one of a few places, which become free again
//! at a fixed rate.
//!
//! An IPv6 client counts for its /64, /56 and /48, whichever of them is its owner's: the owner of a
//! /48 has 65,536 of the least networks.

use crate::limits::networks::{Network, client_networks};
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// The limits of a client's networks, the least first: a single client, and up to four and sixteen
/// of those that share a network.
const LIMITS: [Limit; 3] = [
    Limit { burst: 10, refill: Duration::from_secs(6) },
    Limit { burst: 40, refill: Duration::from_millis(1500) },
    Limit { burst: 160, refill: Duration::from_millis(375) },
];

/// Networks in a generation of the table at most: what 32,768 buckets hold. Both take some 3 MiB.
const GENERATION: usize = 28_672;

/// The wrong tokens of a network.
#[derive(Clone, Copy, Debug)]
struct Limit {
    /// So many at once.
    burst: u32,
    /// Time until one more is allowed; 6 s are 14,400 a day.
    refill: Duration,
}

/// See the module. The standard hasher is keyed at random: peers choose the addresses.
///
/// The table is bounded by two generations: when the recent one is full, it takes the place of the
/// older one, whose networks are forgotten. A guess enters three networks at most and one that is
/// refused none, so that only a peer with thousands of the largest networks has its own forgotten.
/// Further networks are not refused, as their tokens may be valid.
#[derive(Debug, Default)]
pub struct GuessLimiter {
    table: Mutex<Table>,
}

#[derive(Debug, Default)]
struct Table {
    recent: HashMap<Network, Guesses>,
    older: HashMap<Network, Guesses>,
}

impl Table {
    fn get(&self, network: &Network) -> Option<&Guesses> {
        self.recent.get(network).or_else(|| self.older.get(network))
    }

    /// Whether the token is the latest wrong one of the client's least network.
    fn is_repeated(&self, address: IpAddr, token: TokenHash) -> bool {
        let least = client_networks(address).next();
        least.and_then(|least| self.get(&least)).is_some_and(|guesses| guesses.last == token)
    }

    fn insert(&mut self, network: Network, guesses: Guesses) {
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
    /// Whether one of the client's networks has no place left for this token. A peer without an
    /// address is not limited.
    #[must_use]
    pub fn is_exhausted(&self, address: Option<IpAddr>, token: TokenHash, now: Instant) -> bool {
        let Some(address) = address else { return false };
        let table = self.table();
        let is_full = |(network, limit): (Network, Limit)| {
            let guesses = table.get(&network);
            guesses.is_some_and(|guesses| guesses.free_at > now + limit.refill * (limit.burst - 1))
        };
        !table.is_repeated(address, token) && client_networks(address).zip(LIMITS).any(is_full)
    }

    /// Takes a place in each network for a wrong token.
    pub fn charge(&self, address: Option<IpAddr>, token: TokenHash, now: Instant) {
        let Some(address) = address else { return };
        let mut table = self.table();
        if table.is_repeated(address, token) {
            return;
        }
        for (network, limit) in client_networks(address).zip(LIMITS) {
            let known = table.get(&network).map_or(now, |guesses| guesses.free_at.max(now));
            table.insert(network, Guesses { free_at: known + limit.refill, last: token });
        }
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
        let neighbour = Some("2001:db8:0:1::1".parse().unwrap());
        assert!(!limiter.is_exhausted(neighbour, 1, start + Duration::from_secs(72)));
        limiter.charge(None, 1, start);
        assert!(!limiter.is_exhausted(None, 2, start));
    }

    #[test]
    fn the_owner_of_a_short_prefix_has_a_few_times_as_many_guesses() {
        let (limiter, start) = (GuessLimiter::default(), Instant::now());
        let mut token = 0;
        // One guess from each /64 of a prefix.
        let mut guesses = |prefix: u128, networks: u128, now| {
            let mut count = 0;
            for network in 0..networks {
                let address = Some(IpAddr::from((prefix | network << 64).to_be_bytes()));
                token += 1;
                if !limiter.is_exhausted(address, token, now) {
                    limiter.charge(address, token, now);
                    count += 1;
                }
            }
            count
        };
        let [small, large] = [0x2001_0db8_0001_u128, 0x2001_0db8_0002].map(|prefix| prefix << 80);
        assert_eq!(guesses(small, 1 << 8, start), 40, "from a /56");
        assert_eq!(guesses(small, 1 << 8, start + Duration::from_secs(3)), 2);
        assert_eq!(guesses(large, 1 << 16, start), 160, "from a /48");
        assert_eq!(guesses(large, 1 << 16, start), 0, "nothing is forgotten");
        assert_eq!(guesses(large, 1 << 16, start + Duration::from_secs(3)), 8);
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
