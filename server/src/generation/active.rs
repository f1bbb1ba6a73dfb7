//! Flows that share the threads, counted by site, and the numbers of client networks.

use super::queue::{FlowId, FlowPath, SiteId};
use super::threads::{Mutex, MutexGuard};
use crate::limits::networks::{client_network, client_site};
use std::collections::HashMap;
use std::hash::{BuildHasher, Hash, RandomState};
use std::net::IpAddr;
use std::sync::PoisonError;

/// See the module. At most one entry for each session and connection.
#[derive(Debug, Default)]
pub struct ActiveFlows {
    /// Numbers networks. Keyed at random: peers choose the addresses.
    numbers: RandomState,
    table: Mutex<Table>,
}

#[derive(Debug, Default)]
struct Table {
    /// Requests of each active flow that open and close one by one.
    flows: HashMap<FlowPath, usize>,
    /// Active flows of each site.
    sites: HashMap<SiteId, usize>,
}

impl ActiveFlows {
    /// The site of a client.
    pub fn site_of(&self, client: IpAddr) -> SiteId {
        self.number(client_site(client))
    }

    /// The turns of the HTTP requests of a client network: all take those of one flow, since a
    /// client must not have more turns because it asks by more requests.
    pub fn downloads_of(&self, client: IpAddr) -> FlowPath {
        FlowPath { site: self.site_of(client), flow: self.number(client_network(client)) }
    }

    /// A number that no session is counted by.
    fn number(&self, network: IpAddr) -> FlowId {
        self.numbers.hash_one(network) >> 1 | 1 << 62
    }

    /// Counts a session with requests, or an HTTP request.
    pub fn add(&self, path: FlowPath) {
        let mut table = self.table();
        let requests = table.flows.entry(path).or_default();
        *requests += 1;
        if *requests == 1 {
            *table.sites.entry(path.site).or_default() += 1;
        }
    }

    /// Ends what was counted.
    pub fn remove(&self, path: FlowPath) {
        let mut table = self.table();
        if !decrement(&mut table.flows, &path) {
            decrement(&mut table.sites, &path.site);
        }
    }

    /// Equal shares of the threads of which a flow has one; at least 1. No more than there are
    /// flows: sites with few leave most of their turns to others.
    pub fn shares(&self, path: FlowPath) -> usize {
        let table = self.table();
        let of_site = table.sites.get(&path.site).copied().unwrap_or_default();
        (table.sites.len() * of_site.max(1)).min(table.flows.len()).max(1)
    }

    /// Active flows.
    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.table().flows.len()
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        // Nothing under the lock panics in the middle of a change.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Decrements a count; whether something is left of it.
fn decrement<K: Hash + Eq>(counts: &mut HashMap<K, usize>, key: &K) -> bool {
    let Some(count) = counts.get_mut(key) else { return false };
    *count -= 1;
    let is_left = *count > 0;
    if !is_left {
        counts.remove(key);
    }
    is_left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flow_has_a_share_of_its_site_or_of_all_flows() {
        let active = ActiveFlows::default();
        let path = |site, flow| FlowPath { site, flow };
        assert_eq!(active.shares(path(1, 1)), 1);
        for flow in 0..10 {
            active.add(path(1, flow));
        }
        active.add(path(2, 10));
        active.add(path(2, 10));
        assert_eq!((active.shares(path(1, 3)), active.shares(path(2, 10))), (11, 2));
        active.remove(path(2, 10));
        assert_eq!((active.len(), active.shares(path(2, 10))), (11, 2));
        active.remove(path(2, 10));
        assert_eq!((active.len(), active.shares(path(1, 3))), (10, 10));
        (0..10).for_each(|flow| active.remove(path(1, flow)));
        assert_eq!(active.len(), 0);
    }

    #[test]
    fn networks_of_a_site_have_one_number_and_networks_their_own() {
        let active = ActiveFlows::default();
        let of = |text: &str| active.downloads_of(text.parse().unwrap());
        let [one, other] = ["2001:db8:1:1::1", "2001:db8:1:2::1"].map(of);
        assert!(one.site == other.site && one.flow != other.flow);
        assert_eq!(one, of("2001:db8:1:1::2"));
        assert_ne!(of("10.0.0.1").site, of("10.0.0.2").site);
    }
}
