//! Log lines about peers that break rules: one for the first event of a client network and reason,
//! then one a minute with the number of further events.

use crate::limits::networks::client_site;
use std::collections::HashMap;
use std::mem;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::sleep;

/// Time between two lines about a network and reason.
const INTERVAL: Duration = Duration::from_secs(60);

/// Networks and reasons in the table at most. Events of others are counted together, in a line
/// without an address.
const MAX_ENTRIES: usize = 1024;

/// See the module.
#[derive(Debug, Default)]
pub struct PeerLog {
    table: Mutex<Table>,
}

/// The standard hasher is keyed at random: peers choose the addresses.
#[derive(Debug, Default)]
struct Table {
    entries: HashMap<(IpAddr, &'static str), Entry>,
    /// Events without an entry since the last lines.
    without_entry: u64,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    /// Address of the latest event.
    address: IpAddr,
    /// Events since the last line.
    events: u64,
}

/// A log line about a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Line {
    /// An address of the network.
    pub address: IpAddr,
    /// The rule that it breaks.
    pub reason: &'static str,
    /// Events that the line stands for.
    pub events: u64,
}

impl PeerLog {
    /// Reports an event. A peer without an address is not logged.
    pub fn report(&self, address: Option<IpAddr>, reason: &'static str) {
        let Some(address) = address.map(|address| address.to_canonical()) else { return };
        let is_first = self.table().count(address, reason);
        if is_first {
            Line { address, reason, events: 1 }.write();
        }
    }

    /// Writes lines about further events once a minute.
    pub async fn run(self: Arc<Self>) {
        loop {
            sleep(INTERVAL).await;
            self.write();
        }
    }

    /// Writes lines about the events since the last ones.
    pub fn write(&self) {
        let (lines, events) = self.take();
        lines.iter().for_each(Line::write);
        if events > 0 {
            tracing::warn!(events, "more peers break the rules than the log can name");
        }
    }

    /// The lines about the events since the last ones, and the number of events without an address.
    pub fn take(&self) -> (Vec<Line>, u64) {
        self.table().take()
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        // Nothing under the lock panics in the middle of a change.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    /// Counts an event. Whether it is the first of a new entry, whose line is due at once.
    fn count(&mut self, address: IpAddr, reason: &'static str) -> bool {
        let key = (client_site(address), reason);
        if let Some(entry) = self.entries.get_mut(&key) {
            *entry = Entry { address, events: entry.events + 1 };
            return false;
        }
        let has_room = self.entries.len() < MAX_ENTRIES;
        if has_room {
            self.entries.insert(key, Entry { address, events: 0 });
        } else {
            self.without_entry += 1;
        }
        has_room
    }

    /// See [`PeerLog::take`]. An entry without events is removed.
    fn take(&mut self) -> (Vec<Line>, u64) {
        self.entries.retain(|_, entry| entry.events > 0);
        let line = |((_, reason), entry): (&(IpAddr, &'static str), &mut Entry)| Line {
            address: entry.address,
            reason,
            events: mem::take(&mut entry.events),
        };
        let lines = self.entries.iter_mut().map(line).collect();
        let without_entry = mem::take(&mut self.without_entry);
        if without_entry > 0 {
            // Those that have entries must not keep others out.
            self.entries.clear();
        }
        (lines, without_entry)
    }
}

impl Line {
    fn write(&self) {
        let Self { address, reason, events } = self;
        let address = address.to_string();
        tracing::warn!(address, reason, events, "peer breaks the rules");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    fn taken(table: &mut Table) -> (Vec<Line>, u64) {
        let (mut lines, without_entry) = table.take();
        lines.sort_unstable();
        (lines, without_entry)
    }

    #[test]
    fn each_address_and_reason_has_a_line_at_once_and_then_one_with_the_number_of_events() {
        let mut table = Table::default();
        let [one, other] = ["10.0.0.1", "10.0.0.2"].map(address);
        let at_once = (0..1000).filter(|_| table.count(one, "a")).count();
        assert_eq!(at_once, 1);
        assert!(table.count(one, "b") && table.count(other, "a"));
        assert!(!table.count(one, "b"));
        // No event is lost if no further one follows, and no line has the events of another.
        let line = |reason, events| Line { address: one, reason, events };
        assert_eq!(taken(&mut table), (vec![line("a", 999), line("b", 1)], 0));
        assert!(!table.count(one, "a"), "it is counted: it had a line");
        assert!(table.count(other, "a"), "it had no event since its line");
        assert_eq!(taken(&mut table), (vec![line("a", 1)], 0));
        assert_eq!(taken(&mut table), (vec![], 0));
        assert!(table.entries.is_empty());
    }

    #[test]
    fn addresses_of_one_network_have_one_line_with_the_latest() {
        let mut table = Table::default();
        let [first, latest] = ["2001:db8:1:2::1", "2001:db8:1:3:ffff::9"].map(address);
        assert!(table.count(first, "a") && !table.count(latest, "a"));
        assert_eq!(table.take().0, [Line { address: latest, reason: "a", events: 1 }]);
    }

    #[test]
    fn the_lines_of_many_addresses_are_bounded_and_the_events_of_others_counted() {
        let mut table = Table::default();
        let at_once = |from: u32, table: &mut Table| {
            let addresses = (from..from + 10_000).map(|number| IpAddr::from(number.to_be_bytes()));
            addresses.filter(|address| table.count(*address, "a")).count()
        };
        assert_eq!(at_once(1, &mut table), MAX_ENTRIES);
        assert_eq!(table.entries.len(), MAX_ENTRIES);
        assert_eq!(at_once(1, &mut table), 0);
        let others = 2 * (10_000 - MAX_ENTRIES as u64);
        let (lines, without_entry) = table.take();
        assert_eq!((lines.len(), without_entry), (MAX_ENTRIES, others));
        assert!(lines.iter().all(|line| line.events == 1), "no address has the events of others");
        assert_eq!(at_once(20_000, &mut table), MAX_ENTRIES, "none keeps its entry before others");
    }

    #[tokio::test(start_paused = true)]
    async fn events_are_written_once_a_minute() {
        let log = Arc::<PeerLog>::default();
        (0..3).for_each(|_| log.report(Some(address("::ffff:10.0.0.1")), "a"));
        assert!(tokio::time::timeout(INTERVAL * 3 / 2, Arc::clone(&log).run()).await.is_err());
        assert_eq!(log.take(), (vec![], 0), "they are written");
        assert_eq!(log.table().entries.len(), 0, "and it was quiet since");
        log.report(None, "a");
        assert_eq!(log.table().entries.len(), 0);
    }
}
