//! Concurrent sessions or connections per client network.
//!
//! An IPv6 client counts for its /64, /56 and /48, whichever of them is its owner's.

use crate::limits::networks::{Network, client_networks};
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Counts permits by client network. Holds at most three entries per permit.
///
/// A client's least network may hold no more permits than the limit; a larger one no more than the
/// limit or than remain free, whichever is more. Where the limit is a fair share, none of its
/// networks may hold more than remain free (dynamic thresholds: Choudhury and Hahne, IEEE/ACM
/// Transactions on Networking 6(2), 1998, with factor 1). One greedy network gets half of all, each
/// of two a third, and some remain for others.
///
/// The standard hasher is keyed at random: peers choose the addresses.
#[derive(Clone, Debug)]
pub struct PerIpLimiter {
    limit: usize,
    is_fair_share: bool,
    counts: Arc<Mutex<HashMap<Network, usize>>>,
}

/// Permission for one session or connection; released on drop.
#[derive(Debug)]
pub struct IpPermit {
    client: Option<IpAddr>,
    limiter: PerIpLimiter,
}

impl PerIpLimiter {
    /// At most `limit` permits per client network.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self { limit, is_fair_share: false, counts: Arc::default() }
    }

    /// At most `limit` permits per client network, and no more than remain free.
    #[must_use]
    pub fn fair_share(limit: usize) -> Self {
        Self { is_fair_share: true, ..Self::new(limit) }
    }

    /// A permit, or none if the network holds its limit already. `free` permits remain for others
    /// after this one. A peer without an address is not limited.
    #[must_use]
    pub fn try_acquire(&self, client: Option<IpAddr>, free: usize) -> Option<IpPermit> {
        if let Some(client) = client {
            let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
            for (index, network) in client_networks(client).enumerate() {
                let held = counts.get(&network).copied().unwrap_or_default();
                let (is_full, exceeds_share) = (held >= self.limit, held > free);
                let is_refused = match index {
                    0 => is_full || (self.is_fair_share && exceeds_share),
                    _ => exceeds_share && (self.is_fair_share || is_full),
                };
                if is_refused {
                    return None;
                }
            }
            client_networks(client).for_each(|network| *counts.entry(network).or_default() += 1);
        }
        Some(IpPermit { client, limiter: self.clone() })
    }

    /// Permits of that network of a client that has the most.
    #[must_use]
    pub fn held(&self, client: IpAddr) -> usize {
        let counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        client_networks(client).filter_map(|network| counts.get(&network).copied()).max().unwrap_or_default()
    }
}

impl Drop for IpPermit {
    fn drop(&mut self) {
        let Some(client) = self.client else { return };
        let mut counts = self.limiter.counts.lock().unwrap_or_else(PoisonError::into_inner);
        for network in client_networks(client) {
            if let Some(count) = counts.get_mut(&network) {
                *count -= 1;
                if *count == 0 {
                    counts.remove(&network);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_released_permit_can_be_acquired_again() {
        let limiter = PerIpLimiter::new(2);
        let [one, other] = ["10.0.0.1", "10.0.0.2"].map(|text| Some(text.parse().unwrap()));
        let permits = [limiter.try_acquire(one, 0), limiter.try_acquire(one, 0)];
        assert!(permits.iter().all(Option::is_some));
        assert!(
            limiter.try_acquire(one, 9).is_none()
                && limiter.try_acquire(other, 0).is_some()
                && limiter.try_acquire(None, 0).is_some()
        );
        drop(permits);
        let held = |address: &str| limiter.held(address.parse().unwrap());
        let permits = ["2001:db8:1:1::1", "2001:db8:1:2::1"]
            .map(|text| limiter.try_acquire(Some(text.parse().unwrap()), 9).unwrap());
        assert_eq!((held("2001:db8:1:1::9"), held("2001:db8:2::1"), held("10.0.0.1")), (2, 0, 0));
        drop(permits);
        assert!(limiter.try_acquire(one, 0).is_some());
        assert!(limiter.counts.lock().unwrap().is_empty());
    }

    /// Clients that take what they can, one after the other; permits of each.
    fn greedy(limiter: &PerIpLimiter, total: usize, clients: &[&str]) -> Vec<usize> {
        let mut permits = Vec::new();
        clients
            .iter()
            .map(|client| {
                let address = Some(client.parse().unwrap());
                let before = permits.len();
                while permits.len() < total
                    && let Some(permit) = limiter.try_acquire(address, total - permits.len() - 1)
                {
                    permits.push(permit);
                }
                permits.len() - before
            })
            .collect()
    }

    #[test]
    fn a_fair_share_leaves_permits_for_every_further_network() {
        let clients = ["10.0.0.1", "10.0.0.2", "10.0.0.3", "10.0.0.4"];
        let limiters = [usize::MAX, 100, usize::MAX].map(PerIpLimiter::fair_share);
        assert_eq!(greedy(&limiters[0], 1024, &clients), [512, 256, 128, 64]);
        assert_eq!(greedy(&limiters[1], 1024, &clients[..2]), [100, 100]);
        assert_eq!(greedy(&limiters[2], 1, &clients[..1]), [1]);
        // The control: a limit of all.
        assert_eq!(greedy(&PerIpLimiter::new(1024), 1024, &clients[..2]), [1024, 0]);
    }

    #[test]
    fn networks_below_one_prefix_have_one_share() {
        let clients = ["2001:db8:1:1::1", "2001:db8:1:2::1", "2001:db8:1:aa00::1", "2001:db8:2::1"];
        assert_eq!(greedy(&PerIpLimiter::fair_share(usize::MAX), 1024, &clients), [512, 0, 0, 256]);
        let many: Vec<String> = (1..=20).map(|subnet| format!("2001:db8:1:{subnet:x}00::1")).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).chain(["2001:db8:2::1"]).collect();
        let counts = greedy(&PerIpLimiter::new(100), 1024, &many);
        let of_site: usize = counts[..20].iter().sum();
        assert_eq!((counts[0], of_site, counts[20]), (100, 512, 100), "{counts:?}");
        let limiter = PerIpLimiter::fair_share(100);
        assert_eq!(greedy(&limiter, 1024, &clients), [100, 100, 100, 100], "the limit is that of a /64");
        assert!(limiter.counts.lock().unwrap().is_empty(), "no permit is left");
    }

    #[test]
    fn greedy_networks_that_compete_get_equal_shares() {
        let (limiter, total, mut permits) = (PerIpLimiter::fair_share(usize::MAX), 1024, Vec::new());
        let addresses = [[10, 0, 0, 1], [10, 0, 0, 2]].map(|address| Some(IpAddr::from(address)));
        loop {
            let got: Vec<_> = addresses
                .iter()
                .filter_map(|address| limiter.try_acquire(*address, total - permits.len() - 1))
                .collect();
            if got.is_empty() {
                break;
            }
            permits.extend(got);
        }
        let counts: Vec<usize> = limiter.counts.lock().unwrap().values().copied().collect();
        assert!(counts.iter().all(|count| (341..=342).contains(count)), "{counts:?}");
    }
}
