//! How many sessions each address has: one machine should not take every place.

use rustc_hash::FxHashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// Counts sessions by address. At most one entry a session.
#[derive(Clone, Debug)]
pub struct Addresses {
    limit: usize,
    counts: Arc<Mutex<FxHashMap<IpAddr, usize>>>,
}

/// One session's place; given back when dropped.
#[derive(Debug)]
pub struct Place {
    address: Option<IpAddr>,
    of: Addresses,
}

impl Addresses {
    /// At most `limit` sessions an address.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self { limit, counts: Arc::default() }
    }

    /// A place for one more session from an address; none if it has its share. A peer without an
    /// address is not limited.
    #[must_use]
    pub fn enter(&self, address: Option<IpAddr>) -> Option<Place> {
        let address = address.map(group);
        if let Some(address) = address {
            let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
            let count = counts.entry(address).or_default();
            if *count >= self.limit {
                return None;
            }
            *count += 1;
        }
        Some(Place { address, of: self.clone() })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let Some(address) = self.address else { return };
        let mut counts = self.of.counts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&address);
            }
        }
    }
}

/// What counts as one address: an IPv6 customer is given at least a /64 (RFC 6177), so that is one;
/// IPv4 in IPv6 is IPv4.
pub fn group(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(six) => IpAddr::V6((u128::from(six) >> 64 << 64).into()),
        four => four,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_gets_its_share_and_a_place_can_be_taken_again() {
        let addresses = Addresses::new(2);
        let [one, other] = ["10.0.0.1", "10.0.0.2"].map(|text| Some(text.parse().unwrap()));
        let places = [addresses.enter(one), addresses.enter(one)];
        assert!(places.iter().all(Option::is_some));
        assert!(
            addresses.enter(one).is_none()
                && addresses.enter(other).is_some()
                && addresses.enter(None).is_some()
        );
        drop(places);
        assert!(addresses.enter(one).is_some());
        assert!(addresses.counts.lock().unwrap().is_empty());
    }

    #[test]
    fn a_customers_whole_network_is_one_address() {
        let parse = |text: &str| group(text.parse().unwrap());
        assert_eq!(parse("2001:db8:1:2::1"), parse("2001:db8:1:2:ffff::9"));
        assert_ne!(parse("2001:db8:1:2::1"), parse("2001:db8:1:3::1"));
        assert_eq!(parse("::ffff:10.0.0.1"), parse("10.0.0.1"));
        assert_ne!(parse("10.0.0.1"), parse("10.0.0.2"));
    }
}
