//! Wrong access tokens per client network: each takes one of a few places, which become free again
//! at a fixed rate.

use crate::limits::per_ip::client_network;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Wrong tokens that an address may present at once.
const BURST: u32 = 10;

/// Time until one more is allowed: 14,400 guesses a day.
const REFILL: Duration = Duration::from_secs(6);

/// Networks in the table at most, some 3 MiB. Further ones share one bucket.
const MAX_NETWORKS: usize = 65_536;

/// Least time between two sweeps of a full table: a sweep looks at all networks under the lock that
/// every token check takes.
const SWEEP_INTERVAL: Duration = Duration::from_secs(1);

/// What networks share that are not in a full table.
const OTHERS: IpAddr = IpAddr::V4(Ipv4Addr::UNSPECIFIED);

/// See the module. The standard hasher is keyed at random: peers choose the addresses.
#[derive(Debug, Default)]
pub struct GuessLimiter {
    table: Mutex<Table>,
}

#[derive(Debug, Default)]
struct Table {
    /// Networks with recent wrong tokens, and others since the last sweep.
    networks: HashMap<IpAddr, Guesses>,
    /// When the table was full and was swept for the last time.
    swept: Option<Instant>,
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
        let networks = &self.table.lock().unwrap_or_else(PoisonError::into_inner).networks;
        let others = || networks.get(&OTHERS).filter(|_| networks.len() >= MAX_NETWORKS);
        networks
            .get(&network)
            .or_else(others)
            .is_some_and(|guesses| guesses.last != token && guesses.free_at > now + REFILL * (BURST - 1))
    }

    /// Takes a place for a wrong token.
    pub fn charge(&self, address: Option<IpAddr>, token: TokenHash, now: Instant) {
        let Some(network) = address.map(client_network) else { return };
        let mut table = self.table.lock().unwrap_or_else(PoisonError::into_inner);
        let Table { networks, swept } = &mut *table;
        let mut is_full = networks.len() >= MAX_NETWORKS && !networks.contains_key(&network);
        if is_full && swept.is_none_or(|swept| now.saturating_duration_since(swept) >= SWEEP_INTERVAL) {
            *swept = Some(now);
            networks.retain(|_, guesses| guesses.free_at > now);
            is_full = networks.len() >= MAX_NETWORKS;
        }
        let guesses = match networks.entry(if is_full { OTHERS } else { network }) {
            Entry::Occupied(entry) if entry.get().last == token => return,
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(Guesses { free_at: now, last: token }),
        };
        *guesses = Guesses { free_at: guesses.free_at.max(now) + REFILL, last: token };
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
    fn the_table_is_bounded_and_forgets_networks_without_guesses() {
        let (limiter, start) = (GuessLimiter::default(), Instant::now());
        let address = |number: u32| Some(IpAddr::from(number.to_be_bytes()));
        for number in 1..=MAX_NETWORKS as u32 + 100 {
            limiter.charge(address(number), number.into(), start);
        }
        assert_eq!(limiter.table.lock().unwrap().networks.len(), MAX_NETWORKS + 1);
        assert!(limiter.is_exhausted(address(1 << 24), 1, start), "those without a place share one");
        assert!(!limiter.is_exhausted(address(7), 1, start));
        let later = start + Duration::from_secs(3600);
        assert!(!limiter.is_exhausted(address(1 << 24), 1, later));
        limiter.charge(address(1 << 24), 1, later);
        assert_eq!(limiter.table.lock().unwrap().networks.len(), 1);
    }

    #[test]
    fn a_full_table_is_swept_once_a_second() {
        let (limiter, start) = (GuessLimiter::default(), Instant::now());
        let address = |number: u32| Some(IpAddr::from(number.to_be_bytes()));
        for number in 1..=MAX_NETWORKS as u32 {
            limiter.charge(address(number), number.into(), start);
        }
        let len_after = |number: u32, after: Duration| {
            limiter.charge(address(number), number.into(), start + after);
            limiter.table.lock().unwrap().networks.len()
        };
        // The first sweep comes just before all of them have their places again.
        let first = REFILL - SWEEP_INTERVAL / 2;
        assert_eq!(len_after(1 << 24, first), MAX_NETWORKS + 1, "that of the others");
        assert_eq!(len_after(2 << 24, REFILL), MAX_NETWORKS + 1);
        assert_eq!(len_after(3 << 24, first + SWEEP_INTERVAL), 2);
    }
}
