//! Open connections of clients, by site: where places lack, a connection of the site that has the
//! most ends for one of a site that has fewer. So accepting never stops, whichever clients hold the
//! places.

use crate::limits::networks::client_site;
use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct OpenConnections {
    table: Arc<Mutex<Table>>,
}

#[derive(Debug, Default)]
struct Table {
    /// Number of the next connection.
    next: u64,
    /// Connections that were not chosen to end, the oldest first.
    connections: BTreeMap<u64, (IpAddr, Arc<ConnectionState>)>,
    /// Connections of each site among them.
    sites: HashMap<IpAddr, usize>,
}

/// Why a connection ended before a request, or for another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConnectionFailure {
    /// The first request did not come in time.
    OpeningTimeout,
    /// A trusted proxy sent no valid header.
    ProxyHeader,
    /// The handshake of TLS failed.
    TlsHandshake,
    /// A client of a site with fewer connections had none.
    Displaced,
}

impl ConnectionFailure {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::OpeningTimeout, Self::ProxyHeader, Self::TlsHandshake, Self::Displaced];

    /// Label in metrics and logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OpeningTimeout => "opening_timeout",
            Self::ProxyHeader => "proxy_header",
            Self::TlsHandshake => "tls_handshake",
            Self::Displaced => "displaced",
        }
    }
}

/// State of a connection, shared with the table.
#[derive(Debug, Default)]
pub struct ConnectionState {
    /// Whether a request is being answered.
    is_busy: AtomicBool,
    displaced: Notify,
}

/// An open connection; leaves the table on drop.
#[derive(Debug)]
pub struct OpenConnection {
    number: u64,
    state: Arc<ConnectionState>,
    connections: OpenConnections,
}

impl OpenConnections {
    /// Adds a connection of a client.
    #[must_use]
    pub fn add(&self, client: IpAddr) -> OpenConnection {
        let (site, state) = (client_site(client), Arc::<ConnectionState>::default());
        let mut table = self.table();
        let number = table.next;
        table.next += 1;
        table.connections.insert(number, (site, Arc::clone(&state)));
        *table.sites.entry(site).or_default() += 1;
        OpenConnection { number, state, connections: self.clone() }
    }

    /// Chooses a connection to end for one of a client that has not been added: of the site with
    /// the most, first without a request, then the oldest. Only of a site that has more than the
    /// client's, and only where that site has two more, one with a request. False if there is none.
    #[must_use]
    pub fn displace_for(&self, client: IpAddr) -> bool {
        let mut table = self.table();
        let own = table.sites.get(&client_site(client)).copied().unwrap_or_default();
        let rank = |(number, (site, state)): (&u64, &(IpAddr, Arc<ConnectionState>))| {
            let of_site = table.sites.get(site).copied().unwrap_or_default();
            let is_idle = !state.is_busy.load(Ordering::Relaxed);
            let is_allowed = of_site > own && (is_idle || of_site > own + 1);
            is_allowed.then_some((of_site, is_idle, std::cmp::Reverse(*number)))
        };
        let Some((.., std::cmp::Reverse(number))) = table.connections.iter().filter_map(rank).max() else {
            return false;
        };
        let Some(state) = table.remove(number) else { return false };
        state.displaced.notify_one();
        true
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        // Nothing under the lock panics in the middle of a change.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    fn remove(&mut self, number: u64) -> Option<Arc<ConnectionState>> {
        let (site, state) = self.connections.remove(&number)?;
        if let Some(count) = self.sites.get_mut(&site) {
            *count -= 1;
            if *count == 0 {
                self.sites.remove(&site);
            }
        }
        Some(state)
    }
}

impl OpenConnection {
    /// Its state.
    #[must_use]
    pub fn state(&self) -> Arc<ConnectionState> {
        Arc::clone(&self.state)
    }
}

impl ConnectionState {
    /// Notes whether a request is being answered.
    pub fn set_busy(&self, is_busy: bool) {
        self.is_busy.store(is_busy, Ordering::Relaxed);
    }

    /// Waits until the connection has to end for another one.
    pub async fn displaced(&self) {
        self.displaced.notified().await;
    }
}

impl Drop for OpenConnection {
    fn drop(&mut self) {
        self.connections.table().remove(self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::FutureExt;

    fn client(number: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, number])
    }

    fn is_displaced(connection: &OpenConnection) -> bool {
        connection.state.displaced().now_or_never().is_some()
    }

    #[test]
    fn the_oldest_idle_connection_of_the_site_with_the_most_ends() {
        let open = OpenConnections::default();
        let few: Vec<_> = (0..2).map(|_| open.add(client(1))).collect();
        let many: Vec<_> = (0..4).map(|_| open.add(client(2))).collect();
        many[0].state().set_busy(true);
        assert!(open.displace_for(client(3)));
        assert!(open.displace_for(client(3)));
        let ended: Vec<bool> = many.iter().map(is_displaced).collect();
        assert_eq!(ended, [false, true, true, false]);
        assert!(few.iter().all(|connection| !is_displaced(connection)));
        drop(many);
        assert!(!open.displace_for(client(1)), "no site has more than the client's");
        assert!(open.displace_for(client(3)) && is_displaced(&few[0]));
        drop(few);
        assert!(!open.displace_for(client(3)), "there is none");
        let table = open.table();
        assert!(table.connections.is_empty() && table.sites.is_empty());
    }

    #[test]
    fn a_request_goes_on_unless_its_site_has_two_more() {
        let open = OpenConnections::default();
        let one = open.add(client(1));
        one.state().set_busy(true);
        assert!(!open.displace_for(client(2)));
        let other = open.add(client(1));
        other.state().set_busy(true);
        assert!(open.displace_for(client(2)) && is_displaced(&one));
    }

    #[test]
    fn networks_of_one_site_count_together() {
        let open = OpenConnections::default();
        let site = ["2001:db8:1:1::1", "2001:db8:1:2::1"].map(|text| open.add(text.parse().unwrap()));
        assert!(!open.displace_for("2001:db8:1:3::1".parse().unwrap()));
        assert!(open.displace_for("2001:db8:2::1".parse().unwrap()) && is_displaced(&site[0]));
    }
}
