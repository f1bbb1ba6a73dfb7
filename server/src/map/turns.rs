//! Turns of client networks at the rendering of tiles.
//!
//! Each network has as many tiles in line as can be rendered at once; its further tiles wait behind
//! them. A network with many tiles therefore delays one of another by a few renderings, not by all.

use crate::limits::networks::client_site;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The site of a client; peers without an address are one.
type Network = Option<IpAddr>;

/// See the module.
#[derive(Debug)]
pub struct RenderTurns {
    /// Tiles that are rendered at once.
    at_once: usize,
    line: Arc<Semaphore>,
    networks: Arc<Mutex<Networks>>,
}

/// Networks with a tile that waits or is rendered, with the number of those tiles, and the permits of
/// those in line.
type Networks = HashMap<Network, (usize, Arc<Semaphore>)>;

/// Permission to render one tile; released on drop.
#[derive(Debug)]
pub struct RenderTurn {
    _turn: OwnedSemaphorePermit,
    _place: OwnedSemaphorePermit,
    _queue: NetworkQueue,
}

/// A tile of a network, removed from the table on drop.
#[derive(Debug)]
struct NetworkQueue {
    network: Network,
    semaphore: Arc<Semaphore>,
    networks: Arc<Mutex<Networks>>,
}

impl RenderTurns {
    /// Turns of `at_once` tiles.
    #[must_use]
    pub fn new(at_once: usize) -> Self {
        Self { at_once, line: Arc::new(Semaphore::new(at_once)), networks: Arc::default() }
    }

    /// Waits for the turn of a client. None if the server ends.
    pub async fn acquire(&self, client: Option<IpAddr>) -> Option<RenderTurn> {
        let queue = self.queue(client.map(client_site));
        let place = Arc::clone(&queue.semaphore).acquire_owned().await.ok()?;
        let turn = Arc::clone(&self.line).acquire_owned().await.ok()?;
        Some(RenderTurn { _turn: turn, _place: place, _queue: queue })
    }

    fn queue(&self, network: Network) -> NetworkQueue {
        let mut networks = lock(&self.networks);
        let new = || (0, Arc::new(Semaphore::new(self.at_once)));
        let (tiles, semaphore) = networks.entry(network).or_insert_with(new);
        *tiles += 1;
        NetworkQueue { network, semaphore: Arc::clone(semaphore), networks: Arc::clone(&self.networks) }
    }

    /// Tiles that could begin now.
    #[cfg(test)]
    pub fn free(&self) -> usize {
        self.line.available_permits()
    }
}

impl Drop for NetworkQueue {
    fn drop(&mut self) {
        let mut networks = lock(&self.networks);
        if let Some((tiles, _)) = networks.get_mut(&self.network) {
            *tiles -= 1;
            if *tiles == 0 {
                networks.remove(&self.network);
            }
        }
    }
}

fn lock(networks: &Mutex<Networks>) -> MutexGuard<'_, Networks> {
    // Nothing under the lock panics in the middle of a change.
    networks.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::mpsc;

    fn network(number: u8) -> Network {
        Some(IpAddr::from([10, 0, 0, number]))
    }

    #[tokio::test]
    async fn networks_take_turns_and_are_forgotten() {
        let turns = Arc::new(RenderTurns::new(1));
        let (sender, mut order) = mpsc::unbounded_channel();
        let first = turns.acquire(network(1)).await.unwrap();
        for client in [1, 1, 1, 2, 3, 2] {
            let (turns, sender) = (Arc::clone(&turns), sender.clone());
            tokio::spawn(async move {
                let turn = turns.acquire(network(client)).await.unwrap();
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
        assert_eq!((lock(&turns.networks).len(), turns.free()), (0, 1));
    }

    #[tokio::test]
    async fn a_wait_that_is_given_up_leaves_its_place() {
        let turns = RenderTurns::new(2);
        let held = (turns.acquire(network(1)).await, turns.acquire(network(1)).await);
        assert!(futures_util::FutureExt::now_or_never(turns.acquire(network(1))).is_none());
        assert!(futures_util::FutureExt::now_or_never(turns.acquire(network(2))).is_none());
        assert_eq!(lock(&turns.networks).len(), 1);
        drop(held);
        assert_eq!((lock(&turns.networks).len(), turns.free()), (0, 2));
        assert!(turns.acquire(None).await.is_some());
    }
}
