//! Wrong tokens per client network: a token bucket that each wrong one takes a place of.

use crate::limits::per_ip::client_network;
use std::collections::HashMap;
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

/// What networks share that are not in a full table.
const OTHERS: IpAddr = IpAddr::V4(Ipv4Addr::UNSPECIFIED);

/// See the module. The standard hasher is keyed at random: peers choose the addresses.
#[derive(Debug, Default)]
pub struct GuessLimiter {
    /// For each network with recent wrong tokens, when all its places are free again.
    free_at: Mutex<HashMap<IpAddr, Instant>>,
}

impl GuessLimiter {
    /// Whether the network has no place left. A peer without an address is not limited.
    #[must_use]
    pub fn is_exhausted(&self, address: Option<IpAddr>, now: Instant) -> bool {
        let Some(network) = address.map(client_network) else { return false };
        let free_at = self.free_at.lock().unwrap_or_else(PoisonError::into_inner);
        let busy =
            |network| free_at.get(network).is_some_and(|free_at| *free_at > now + REFILL * (BURST - 1));
        match free_at.contains_key(&network) {
            true => busy(&network),
            false => free_at.len() >= MAX_NETWORKS && busy(&OTHERS),
        }
    }

    /// Takes a place.
    pub fn charge(&self, address: Option<IpAddr>, now: Instant) {
        let Some(network) = address.map(client_network) else { return };
        let mut free_at = self.free_at.lock().unwrap_or_else(PoisonError::into_inner);
        if free_at.len() >= MAX_NETWORKS && !free_at.contains_key(&network) {
            free_at.retain(|_, free_at| *free_at > now);
        }
        let is_full = free_at.len() >= MAX_NETWORKS && !free_at.contains_key(&network);
        let free = free_at.entry(if is_full { OTHERS } else { network }).or_insert(now);
        *free = (*free).max(now) + REFILL;
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
        let guesses_at = |now| {
            let mut count = 0;
            while !limiter.is_exhausted(one, now) {
                limiter.charge(same_network, now);
                count += 1;
            }
            count
        };
        assert_eq!(guesses_at(start), 10);
        assert_eq!(guesses_at(start + Duration::from_secs(60)), 10);
        assert_eq!(guesses_at(start + Duration::from_secs(72)), 2);
        assert!(!limiter.is_exhausted(Some("2001:db8:0:1::1".parse().unwrap()), start));
        limiter.charge(None, start);
        assert!(!limiter.is_exhausted(None, start));
    }

    #[test]
    fn the_table_is_bounded_and_forgets_networks_without_guesses() {
        let (limiter, start) = (GuessLimiter::default(), Instant::now());
        let address = |number: u32| Some(IpAddr::from(number.to_be_bytes()));
        for number in 1..=MAX_NETWORKS as u32 + 100 {
            limiter.charge(address(number), start);
        }
        assert_eq!(limiter.free_at.lock().unwrap().len(), MAX_NETWORKS + 1);
        assert!(limiter.is_exhausted(address(1 << 24), start), "those without a place share one");
        assert!(!limiter.is_exhausted(address(7), start));
        let later = start + Duration::from_secs(3600);
        assert!(!limiter.is_exhausted(address(1 << 24), later));
        limiter.charge(address(1 << 24), later);
        assert_eq!(limiter.free_at.lock().unwrap().len(), 1);
    }
}
