//! Concurrent sessions or connections per client network.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Counts permits by client network. Holds at most one entry per permit.
///
/// The standard hasher is keyed at random: peers choose the addresses.
#[derive(Clone, Debug)]
pub struct PerIpLimiter {
    limit: usize,
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
        Self { limit, counts: Arc::default() }
    }

    /// A permit, or none if the network holds `limit` already. A peer without an address is not
    /// limited.
    #[must_use]
    pub fn try_acquire(&self, address: Option<IpAddr>) -> Option<IpPermit> {
        let network = address.map(client_network);
        if let Some(network) = network {
            let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
            let count = counts.entry(network).or_default();
            if *count >= self.limit {
                return None;
            }
            *count += 1;
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
        let permits = [limiter.try_acquire(one), limiter.try_acquire(one)];
        assert!(permits.iter().all(Option::is_some));
        assert!(
            limiter.try_acquire(one).is_none()
                && limiter.try_acquire(other).is_some()
                && limiter.try_acquire(None).is_some()
        );
        drop(permits);
        assert!(limiter.try_acquire(one).is_some());
        assert!(limiter.counts.lock().unwrap().is_empty());
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
