//! Open connections of clients, by site: when places run short, a connection of the site that has
//! the most ends for one of a site that has fewer. So accepting never stops, whichever clients hold
//! the places.

use crate::limits::networks::client_site;
use crate::site_index::SiteIndex;
use std::collections::HashMap;
use std::net::IpAddr;
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
    /// Site and signal of each connection that was not chosen to end.
    connections: HashMap<u64, (IpAddr, Arc<Notify>)>,
    /// The same by site; busy while a request is answered.
    sites: SiteIndex<IpAddr>,
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

/// State of a connection. The default is one that nothing displaces.
#[derive(Debug, Default)]
pub struct ConnectionState {
    displaced: Arc<Notify>,
    entry: Option<TableEntry>,
}

/// An entry of the table.
#[derive(Debug)]
struct TableEntry {
    site: IpAddr,
    number: u64,
    connections: OpenConnections,
}

/// An open connection; leaves the table on drop.
#[derive(Debug)]
pub struct OpenConnection {
    state: Arc<ConnectionState>,
}

impl OpenConnections {
    /// Adds a connection of a client.
    #[must_use]
    pub fn add(&self, client: IpAddr) -> OpenConnection {
        let (site, displaced) = (client_site(client), Arc::<Notify>::default());
        let mut table = self.table();
        let number = table.next;
        table.next += 1;
        table.connections.insert(number, (site, Arc::clone(&displaced)));
        table.sites.insert(site, number);
        drop(table);
        let entry = TableEntry { site, number, connections: self.clone() };
        OpenConnection { state: Arc::new(ConnectionState { displaced, entry: Some(entry) }) }
    }

    /// Chooses a connection to end for one of a client that has not been added
    /// ([`SiteIndex::displaced_by`]): only of a site that has more than the client's, and with a
    /// request only where that site has two more. False if there is none.
    #[must_use]
    pub fn displace_for(&self, client: IpAddr) -> bool {
        let mut table = self.table();
        let number = table.sites.displaced_by(client_site(client));
        let Some(displaced) = number.and_then(|number| table.remove(number)) else { return false };
        displaced.notify_one();
        true
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        // Nothing under the lock panics in the middle of a change.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    fn remove(&mut self, number: u64) -> Option<Arc<Notify>> {
        let (site, displaced) = self.connections.remove(&number)?;
        self.sites.remove(site, number);
        Some(displaced)
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
        if let Some(TableEntry { site, number, connections }) = &self.entry {
            connections.table().sites.set_busy(*site, *number, is_busy);
        }
    }

    /// Waits until the connection has to end for another one.
    pub async fn displaced(&self) {
        self.displaced.notified().await;
    }
}

impl Drop for OpenConnection {
    fn drop(&mut self) {
        if let Some(TableEntry { number, connections, .. }) = &self.state.entry {
            connections.table().remove(*number);
        }
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
        assert!(table.connections.is_empty() && table.sites.newest_of_largest().is_none());
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
