//! Places of connections: in all and by client network, and the connection that ends where they
//! lack.

use crate::config::{EXTRA_CONNECTIONS, ServerConfig};
use crate::connections::{ConnectionFailure, ConnectionState, OpenConnection, OpenConnections};
use crate::limits::per_ip::{IpPermit, PerIpLimiter};
use crate::state::ServerState;
use std::net::IpAddr;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// When fewer permits are free, each connection that is accepted displaces one
/// ([`OpenConnections::displace_for`]). Its place becomes free when it has finished its request, or
/// by a time limit; until then the permits suffice for the next ones. Without a permit a connection
/// is closed: accepting never waits.
const RESERVED_CONNECTIONS: usize = EXTRA_CONNECTIONS / 4;

/// Places of connections: in all, by client network, and the open connections of clients.
#[derive(Clone)]
pub struct Places {
    permits: Arc<Semaphore>,
    per_ip: PerIpLimiter,
    open: OpenConnections,
}

/// The place of a connection, released on drop.
pub struct HeldPlace {
    places: Places,
    #[expect(dead_code, reason = "held for its drop")]
    permit: OwnedSemaphorePermit,
    /// None of a proxy.
    client: Option<ClientPlace>,
}

/// The part of a client in a place, released on drop.
struct ClientPlace {
    connection: OpenConnection,
    #[expect(dead_code, reason = "held for its drop")]
    ip_permit: IpPermit,
}

impl Places {
    /// The places of a server. A session releases its connection's place when it starts, so these
    /// count requests, downloads, and connections that have sent nothing yet.
    pub fn new(config: &ServerConfig) -> Self {
        Self {
            permits: Arc::new(Semaphore::new(config.max_connections())),
            per_ip: config.connections_per_ip(),
            open: OpenConnections::default(),
        }
    }

    /// The place of a connection; none if there is none, or if the client's network has all of its
    /// own.
    pub fn take(&self, peer: IpAddr, is_proxy: bool, state: &ServerState) -> Option<HeldPlace> {
        let permit = Arc::clone(&self.permits).try_acquire_owned().ok();
        let ip_permit = if is_proxy { None } else { Some(self.permit_of(peer, state)?) };
        if self.permits.available_permits() < RESERVED_CONNECTIONS && self.open.displace_for(peer) {
            let reason = ConnectionFailure::Displaced.name();
            state.metrics.limits.connection_failed(reason);
        }
        let Some(permit) = permit else {
            state.metrics.limits.connections_rejected.inc();
            return None;
        };
        let client = ip_permit.map(|ip_permit| self.client_place(peer, ip_permit));
        Some(HeldPlace { places: self.clone(), permit, client })
    }

    /// The permit of a client; none if its network has all of its own.
    fn permit_of(&self, client: IpAddr, state: &ServerState) -> Option<IpPermit> {
        let permit = self.per_ip.try_acquire(Some(client), self.permits.available_permits());
        if permit.is_none() {
            state.metrics.limits.connections_rejected.inc();
            // Where few are free, a share is small: a network with few breaks no rule.
            if self.per_ip.held(client) > RESERVED_CONNECTIONS {
                state.peer_log.report(Some(client), "too many connections");
            }
        }
        permit
    }

    fn client_place(&self, client: IpAddr, ip_permit: IpPermit) -> ClientPlace {
        ClientPlace { connection: self.open.add(client), ip_permit }
    }
}

impl HeldPlace {
    /// Adds the client that a proxy names. False if its network has all places of its own.
    pub fn add_client(&mut self, client: IpAddr, state: &ServerState) -> bool {
        let ip_permit = self.places.permit_of(client, state);
        self.client = ip_permit.map(|ip_permit| self.places.client_place(client, ip_permit));
        self.client.is_some()
    }

    /// The state of the connection; of a proxy's one that nothing displaces.
    pub fn state(&self) -> Arc<ConnectionState> {
        self.client.as_ref().map(|client| client.connection.state()).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Before, the log named clients with one connection where others held all places.
    #[test]
    fn a_network_that_is_refused_is_named_only_if_it_has_many() {
        let config = ServerConfig { threads: 1, max_sessions: 1, ..ServerConfig::default() };
        let (places, state) = (Places::new(&config), ServerState::new(config).unwrap());
        let clients = [[10, 0, 0, 1], [10, 0, 0, 2], [10, 0, 0, 3]].map(IpAddr::from);
        let mut held = Vec::new();
        // Each takes half of what remains. The second refusal is counted for a line.
        let taken = clients.map(|client| {
            let before = held.len();
            while let Some(place) = places.take(client, false, &state) {
                held.push(place);
            }
            assert!(places.take(client, false, &state).is_none());
            held.len() - before
        });
        assert_eq!(taken, [129, 64, 32]);
        let (lines, without_entry) = state.peer_log.take();
        let lines: Vec<_> = lines.iter().map(|line| (line.address, line.reason, line.events)).collect();
        assert_eq!((lines, without_entry), (vec![(clients[0], "too many connections", 1)], 0));
        assert_eq!(state.metrics.limits.connections_rejected.get(), 6);
    }
}
