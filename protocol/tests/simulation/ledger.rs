//! Requests and received chunks of one connection's client: every chunk is paid by a credit,
//! requested, and sent once.

use crate::truth;
use protocol::message::{ClientMessage, RefusalReason, Refused, WireKey};
use protocol::view::View;
use std::collections::{BTreeMap, BTreeSet};
use terrain::ChunkKey;

/// Ids from here on are views. The client machine numbers requests from 0.
pub const FIRST_VIEW: u32 = 1 << 20;

/// Ids from here on are requests of keys outside the world.
pub const FIRST_INVALID: u32 = 1 << 24;

/// Counts of one chunk on one connection.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    /// Requests by key, of these cancelled.
    asked: u32,
    cancelled: u32,
    /// Times that a view may bring it: once, and once more after each release.
    by_view: u32,
    arrived: u32,
    refused: u32,
}

#[derive(Debug, Default)]
pub struct Ledger {
    granted: u64,
    chunks: u64,
    /// Keys of each request.
    requests: BTreeMap<u32, Vec<ChunkKey>>,
    counts: BTreeMap<ChunkKey, Count>,
    /// Reported as held at the start of the connection, and not released.
    reported: BTreeSet<ChunkKey>,
    /// Needed by any view so far.
    seen: BTreeSet<ChunkKey>,
}

impl Ledger {
    /// The client sends a message.
    pub fn sent(&mut self, message: &ClientMessage) {
        let valid =
            |keys: &[WireKey]| -> Vec<ChunkKey> { keys.iter().filter_map(|key| key.check().ok()).collect() };
        match message {
            ClientMessage::Credit { chunks } => self.granted += u64::from(*chunks),
            ClientMessage::View(view) => self.view(view),
            ClientMessage::Request { id, keys } if *id < FIRST_INVALID => {
                let keys = valid(keys);
                for key in &keys {
                    self.counts.entry(*key).or_default().asked += 1;
                }
                self.requests.insert(*id, keys);
            }
            ClientMessage::Cancel { id } => {
                for key in self.requests.get(id).into_iter().flatten() {
                    self.counts.entry(*key).or_default().cancelled += 1;
                }
            }
            ClientMessage::Release { keys } => {
                for key in valid(keys) {
                    self.reported.remove(&key);
                    if self.seen.contains(&key) {
                        self.counts.entry(key).or_default().by_view += 1;
                    }
                }
            }
            ClientMessage::Holding { keys } => self.reported.extend(valid(keys)),
            _ => {}
        }
    }

    fn view(&mut self, view: &View) {
        for key in truth::needed(view) {
            if self.seen.insert(key) && !self.reported.contains(&key) {
                self.counts.entry(key).or_default().by_view += 1;
            }
        }
    }

    /// A chunk arrives.
    pub fn arrived(&mut self, key: ChunkKey) -> Result<(), String> {
        self.chunks += 1;
        if self.chunks > self.granted {
            return Err(format!("chunk {} of {} granted", self.chunks, self.granted));
        }
        let is_seen = self.seen.contains(&key);
        let count = self.counts.entry(key).or_default();
        count.arrived += 1;
        let most = count.asked + if is_seen { count.by_view } else { 0 };
        if count.arrived > most {
            return Err(format!("chunk {key} arrives {} times and was wanted {most} times", count.arrived));
        }
        Ok(())
    }

    /// A refusal arrives.
    pub fn refused(&mut self, refused: &Refused) -> Result<(), String> {
        if refused.reason == RefusalReason::InvalidCredit {
            return Err(format!("a grant is refused: {}", refused.detail));
        }
        if refused.id >= FIRST_VIEW {
            return Ok(());
        }
        let named = refused.key.and_then(|key| key.check().ok());
        let whole = self.requests.get(&refused.id).cloned().unwrap_or_default();
        for key in named.map_or(whole, |key| vec![key]) {
            self.counts.entry(key).or_default().refused += 1;
        }
        Ok(())
    }

    /// At rest, every request that was not cancelled has its answer.
    pub fn check_answers(&self) -> Result<(), String> {
        for (key, count) in &self.counts {
            if count.arrived + count.refused + count.cancelled < count.asked {
                return Err(format!("chunk {key} was requested and never answered: {count:?}"));
            }
        }
        Ok(())
    }
}
