//! Turns of sites at expensive work of requests: the rendering of tiles, handshakes of TLS.
//!
//! A semaphore of N permits grants them in order of arrival. A semaphore of each site lets at most
//! N pieces of its work wait for those. So work waits for at most N pieces of each other site.

use crate::limits::networks::client_site;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The site of a client; peers without an address are one.
type Site = Option<IpAddr>;

/// See the module.
#[derive(Debug)]
pub struct SiteTurns {
    /// Pieces of work that run at once.
    at_once: usize,
    /// Of all sites together.
    global: Arc<Semaphore>,
    sites: Arc<Mutex<Sites>>,
}

/// Sites with work that waits or runs, with the number of its pieces, and the permits to wait for a
/// global one. At most one entry for each request or connection.
type Sites = HashMap<Site, (usize, Arc<Semaphore>)>;

/// Permission for one piece of work; released on drop.
#[derive(Debug)]
pub struct SiteTurn {
    _turn: OwnedSemaphorePermit,
    _place: OwnedSemaphorePermit,
    _entry: SiteEntry,
}

/// A piece of work of a site, removed from the table on drop.
#[derive(Debug)]
struct SiteEntry {
    site: Site,
    semaphore: Arc<Semaphore>,
    sites: Arc<Mutex<Sites>>,
}

impl SiteTurns {
    /// Turns of `at_once` pieces of work.
    #[must_use]
    pub fn new(at_once: usize) -> Self {
        Self { at_once, global: Arc::new(Semaphore::new(at_once)), sites: Arc::default() }
    }

    /// Waits for the turn of a client. Never none: no semaphore is closed.
    pub async fn acquire(&self, client: Option<IpAddr>) -> Option<SiteTurn> {
        let entry = self.entry(client.map(client_site));
        let place = Arc::clone(&entry.semaphore).acquire_owned().await.ok()?;
        let turn = Arc::clone(&self.global).acquire_owned().await.ok()?;
        Some(SiteTurn { _turn: turn, _place: place, _entry: entry })
    }

    fn entry(&self, site: Site) -> SiteEntry {
        let mut sites = lock(&self.sites);
        let new = || (0, Arc::new(Semaphore::new(self.at_once)));
        let (pieces, semaphore) = sites.entry(site).or_insert_with(new);
        *pieces += 1;
        SiteEntry { site, semaphore: Arc::clone(semaphore), sites: Arc::clone(&self.sites) }
    }

    /// Sites with work that waits or runs.
    #[must_use]
    pub fn sites(&self) -> usize {
        lock(&self.sites).len()
    }

    /// Pieces of work that could begin now.
    #[cfg(test)]
    pub fn free(&self) -> usize {
        self.global.available_permits()
    }
}

impl Drop for SiteEntry {
    fn drop(&mut self) {
        let mut sites = lock(&self.sites);
        if let Some((pieces, _)) = sites.get_mut(&self.site) {
            *pieces -= 1;
            if *pieces == 0 {
                sites.remove(&self.site);
            }
        }
    }
}

fn lock(sites: &Mutex<Sites>) -> MutexGuard<'_, Sites> {
    // Nothing under the lock panics in the middle of a change.
    sites.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::mpsc;

    fn site(number: u8) -> Site {
        Some(IpAddr::from([10, 0, 0, number]))
    }

    #[tokio::test]
    async fn sites_take_turns_and_are_forgotten() {
        let turns = Arc::new(SiteTurns::new(1));
        let (sender, mut order) = mpsc::unbounded_channel();
        let first = turns.acquire(site(1)).await.unwrap();
        for client in [1, 1, 1, 2, 3, 2] {
            let (turns, sender) = (Arc::clone(&turns), sender.clone());
            tokio::spawn(async move {
                let turn = turns.acquire(site(client)).await.unwrap();
                sender.send(client).unwrap();
                drop(turn);
            });
            tokio::task::yield_now().await;
        }
        drop((first, sender));
        let mut got = Vec::new();
        while let Some(client) = order.recv().await {
            got.push(client);
        }
        assert_eq!(got, [2, 3, 1, 2, 1, 1]);
        assert_eq!((lock(&turns.sites).len(), turns.free()), (0, 1));
    }

    #[tokio::test]
    async fn a_wait_that_is_given_up_leaves_its_place() {
        let turns = SiteTurns::new(2);
        let held = (turns.acquire(site(1)).await, turns.acquire(site(1)).await);
        assert!(futures_util::FutureExt::now_or_never(turns.acquire(site(1))).is_none());
        assert!(futures_util::FutureExt::now_or_never(turns.acquire(site(2))).is_none());
        assert_eq!(lock(&turns.sites).len(), 1);
        drop(held);
        assert_eq!((lock(&turns.sites).len(), turns.free()), (0, 2));
        assert!(turns.acquire(None).await.is_some());
    }
}
