//! Log lines about peers that break rules: one for each client network, then one a minute with the
//! number of events.

use crate::limits::networks::client_network;
use std::collections::HashMap;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Time between two lines about a network.
const INTERVAL: Duration = Duration::from_secs(60);

/// Networks in the table at most. The others share a line.
const MAX_NETWORKS: usize = 1024;

/// The shared key of networks that are not in a full table.
const OTHERS: IpAddr = IpAddr::V4(Ipv4Addr::UNSPECIFIED);

/// See the module. The standard hasher is keyed at random: peers choose the addresses.
#[derive(Debug, Default)]
pub struct PeerLog {
    networks: Mutex<HashMap<IpAddr, Entry>>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    logged: Instant,
    /// Events since then.
    events: u64,
}

impl PeerLog {
    /// Reports an event. A peer without an address is not logged.
    pub fn report(&self, address: Option<IpAddr>, reason: &'static str) {
        let Some(address) = address else { return };
        if let Some((network, events)) = self.record(address, Instant::now()) {
            let address =
                if network == OTHERS { "others".into() } else { address.to_canonical().to_string() };
            tracing::warn!(address, reason, events, "peer breaks the rules");
        }
    }

    /// Counts an event; if a line is due, the network and its events since the last one.
    fn record(&self, address: IpAddr, now: Instant) -> Option<(IpAddr, u64)> {
        let mut network = client_network(address);
        let mut networks = self.networks.lock().unwrap_or_else(PoisonError::into_inner);
        if networks.len() >= MAX_NETWORKS && !networks.contains_key(&network) {
            networks.retain(|_, entry| now.saturating_duration_since(entry.logged) < INTERVAL);
            if networks.len() >= MAX_NETWORKS {
                network = OTHERS;
            }
        }
        let Some(entry) = networks.get_mut(&network) else {
            networks.insert(network, Entry { logged: now, events: 0 });
            return Some((network, 1));
        };
        entry.events += 1;
        if now.saturating_duration_since(entry.logged) < INTERVAL {
            return None;
        }
        let events = entry.events;
        *entry = Entry { logged: now, events: 0 };
        Some((network, events))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_one_line_a_minute_with_the_number_of_events() {
        let (log, start) = (PeerLog::default(), Instant::now());
        let [one, other, third] = ["10.0.0.1", "10.0.0.2", "10.0.0.3"].map(|text| text.parse().unwrap());
        assert_eq!(log.record(one, start), Some((one, 1)));
        let soon = (0..1000).filter_map(|ms| log.record(one, start + Duration::from_millis(ms))).count();
        assert_eq!(soon, 0);
        assert_eq!(log.record(other, start), Some((other, 1)));
        // A further network does not remove those whose line is due.
        assert_eq!(log.record(third, start + INTERVAL), Some((third, 1)));
        assert_eq!(log.record(one, start + INTERVAL), Some((one, 1001)));
        assert_eq!(log.record(one, start + INTERVAL), None);
    }

    #[test]
    fn the_lines_of_many_addresses_are_bounded() {
        let (log, start) = (PeerLog::default(), Instant::now());
        let lines = |from: u32, now| {
            (from..from + 10_000)
                .filter_map(|number| log.record(IpAddr::from(number.to_be_bytes()), now))
                .count()
        };
        assert_eq!(lines(1, start), MAX_NETWORKS + 1);
        assert_eq!(log.networks.lock().unwrap().len(), MAX_NETWORKS + 1);
        assert_eq!(lines(20_000, start + INTERVAL), MAX_NETWORKS + 1, "as many again");
    }
}
