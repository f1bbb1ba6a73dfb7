//! Concurrent sessions or connections per client network.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Counts permits by client network. Holds at most one entry per permit.
///
/// A network may hold no more permits than its limit, and, where the limit is a fair share, no more
/// than remain free (dynamic thresholds: Choudhury and Hahne, IEEE/ACM Transactions on Networking
/// 6(2), 1998, with factor 1). One greedy network gets half of all, each of two a third, and some
/// always remain for others.
///
/// The standard hasher is keyed at random: peers choose the addresses.
#[derive(Clone, Debug)]
pub struct PerIpLimiter {
    limit: usize,
    is_fair_share: bool,
    counts: Arc<Mutex<HashMap<IpAddr, usize>>>,
}

/// Permission for one session or connection; released on drop.
#[derive(Debug)]
pub struct IpPermit {
    network: Option<IpAddr>,
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
    pub fn try_acquire(&self, address: Option<IpAddr>, free: usize) -> Option<IpPermit> {
        let network = address.map(client_network);
        if let Some(network) = network {
            let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
            let held = counts.get(&network).copied().unwrap_or_default();
            if held >= self.limit || (self.is_fair_share && held > free) {
                return None;
            }
            counts.insert(network, held + 1);
        }
        Some(IpPermit { network, limiter: self.clone() })
    }
}

impl Drop for IpPermit {
    fn drop(&mut self) {
        let Some(network) = self.network else { return };
        let mut counts = self.limiter.counts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&network) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&network);
            }
        }
    }
}

/// The unit that limits apply to: one IPv4 address or one IPv6 /64 network, the least that a
/// provider assigns to a customer (RFC 6177). An IPv4-mapped IPv6 address counts as IPv4.
pub fn client_network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(six) => IpAddr::V6((u128::from(six) >> 64 << 64).into()),
        four => four,
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
        assert!(limiter.try_acquire(one, 0).is_some());
        assert!(limiter.counts.lock().unwrap().is_empty());
    }

    /// Networks that take what they can, one after the other; permits of each.
    fn greedy(limiter: &PerIpLimiter, total: usize, networks: u8) -> Vec<usize> {
        let mut permits = Vec::new();
        (1..=networks)
            .map(|number| {
                let address = Some(IpAddr::from([10, 0, 0, number]));
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
        assert_eq!(greedy(&PerIpLimiter::fair_share(usize::MAX), 1024, 4), [512, 256, 128, 64]);
        assert_eq!(greedy(&PerIpLimiter::fair_share(100), 1024, 2), [100, 100]);
        assert_eq!(greedy(&PerIpLimiter::fair_share(usize::MAX), 1, 1), [1]);
        // The control: a limit of all.
        assert_eq!(greedy(&PerIpLimiter::new(1024), 1024, 2), [1024, 0]);
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

    #[test]
    fn an_ipv6_64_network_counts_as_one_address() {
        let parse = |text: &str| client_network(text.parse().unwrap());
        assert_eq!(parse("2001:db8:1:2::1"), parse("2001:db8:1:2:ffff::9"));
        assert_ne!(parse("2001:db8:1:2::1"), parse("2001:db8:1:3::1"));
        assert_eq!(parse("::ffff:10.0.0.1"), parse("10.0.0.1"));
        assert_ne!(parse("10.0.0.1"), parse("10.0.0.2"));
    }
}
