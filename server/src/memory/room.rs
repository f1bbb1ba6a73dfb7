//! Room below the memory mark: which sessions begin, and which views are selected. Its unit is a
//! session: 2 MiB.
//!
//! A site gets no more room than remains for others, as with
//! [`crate::limits::per_ip::PerIpLimiter::fair_share`]. The last of it is for sites with few
//! sessions.

use crate::limits::networks::client_site;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Memory that a session may take before the server notices, and that of a large view.
const SESSION_BYTES: u64 = 2 << 20;

/// The share of the limit that is kept for others, as a divisor.
const KEPT_DIVISOR: u64 = 16;

/// Room, in sessions, that is kept for sites with few sessions. With a small limit less.
const RESERVED: u64 = 16;

/// Sessions that have room below the mark, whatever the caches hold: with less room the caches are
/// cleared.
const LEAST: u64 = 4;

/// The memory mark of a limit: three quarters of it, bytes.
pub(super) const fn mark(limit: u64) -> u64 {
    limit / 8 * 6
}

/// Sessions that have room below the mark where so many bytes are in use.
pub(super) const fn room_below(used: u64, limit: u64) -> u64 {
    mark(limit).saturating_sub(used) / SESSION_BYTES
}

/// The room below which the caches are cleared: with a small limit less.
pub(super) fn least(limit: u64) -> u64 {
    kept(limit, LEAST)
}

/// Room for so many sessions, or a share of the limit if that is less.
fn kept(limit: u64, most: u64) -> u64 {
    (limit / KEPT_DIVISOR / SESSION_BYTES).clamp(1, most)
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Room {
    shares: Arc<Mutex<Shares>>,
}

#[derive(Debug)]
struct Shares {
    /// Room that was left at the last sample.
    left: u64,
    /// The part of it that is for sites with few sessions.
    reserved: u64,
    /// Sessions that may begin until the next interval.
    to_begin: u64,
    /// Those that began in it, by site. At most one entry for each.
    begun: HashMap<IpAddr, u64>,
    /// Views that are being selected, and those of each site. At most one for each session.
    views: u64,
    views_of: HashMap<Option<IpAddr>, u64>,
    /// The site that had the only view last.
    only: Option<Option<IpAddr>>,
    /// Another site whose view had no room since, in this interval: the next one is its own.
    refused: Option<Option<IpAddr>>,
}

impl Room {
    /// Room without an end, until a sample finds less.
    pub(super) fn unlimited() -> Self {
        let shares = Shares {
            left: u64::MAX,
            reserved: 0,
            to_begin: u64::MAX,
            begun: HashMap::new(),
            views: 0,
            views_of: HashMap::new(),
            only: None,
            refused: None,
        };
        Self { shares: Arc::new(Mutex::new(shares)) }
    }

    /// Records the memory in use and its limit, bytes. With `is_next` an interval begins in which
    /// as many sessions may begin as have room.
    pub(super) fn record(&self, used: u64, limit: u64, is_next: bool) {
        let mut shares = self.shares();
        shares.left = room_below(used, limit);
        shares.reserved = kept(limit, RESERVED);
        if is_next {
            // The tables of views that are being selected grow until the end. They take no room
            // that is reserved.
            let beside_views = shares.left.saturating_sub(shares.views);
            shares.to_begin = beside_views.max(shares.left.min(shares.reserved));
            shares.refused = None;
            shares.begun.clear();
        }
        // Room that is gone since the interval began.
        shares.to_begin = shares.to_begin.min(shares.left);
    }

    /// Takes the room of a session that begins, of a client whose site has `held` sessions. False
    /// if there is none.
    pub(super) fn begin_session(&self, client: Option<IpAddr>, held: usize) -> bool {
        let mut shares = self.shares();
        let Some(left) = shares.to_begin.checked_sub(1) else { return false };
        // Without a sample nothing clears the table.
        if let Some(client) = client.filter(|_| shares.left < u64::MAX) {
            let is_reserved = left < shares.reserved && held as u64 > left;
            let begun = shares.begun.entry(client_site(client)).or_default();
            if is_reserved || *begun > left {
                return false;
            }
            *begun += 1;
        }
        shares.to_begin = left;
        true
    }

    /// Whether no session had room at the last sample.
    pub(super) fn is_full(&self) -> bool {
        self.shares().left == 0
    }

    /// Takes the room of a view that a session of a site selects; none if there is none. One view
    /// has room always, of one site and then of another: below the mark sessions go on.
    pub(super) fn begin_view(&self, site: Option<IpAddr>) -> Option<ViewRoom> {
        let mut shares = self.shares();
        let left = shares.left.checked_sub(shares.views + 1);
        let own = shares.views_of.get(&site).copied().unwrap_or(0);
        let has_room = match left {
            Some(left) => own <= left,
            None => shares.views == 0 && shares.refused.is_none_or(|refused| refused == site),
        };
        if !has_room {
            if shares.refused.is_none() && shares.only != Some(site) {
                shares.refused = Some(site);
            }
            return None;
        }
        if shares.refused == Some(site) {
            shares.refused = None;
        }
        shares.only = Some(site);
        shares.views += 1;
        *shares.views_of.entry(site).or_default() += 1;
        Some(ViewRoom { room: self.clone(), site })
    }

    fn shares(&self) -> MutexGuard<'_, Shares> {
        // Nothing under the lock panics in the middle of a change.
        self.shares.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Room of a view that is being selected; free on drop.
#[derive(Debug)]
pub struct ViewRoom {
    room: Room,
    site: Option<IpAddr>,
}

impl Drop for ViewRoom {
    fn drop(&mut self) {
        let mut shares = self.room.shares();
        shares.views -= 1;
        if let Some(own) = shares.views_of.get_mut(&self.site) {
            *own -= 1;
            if *own == 0 {
                shares.views_of.remove(&self.site);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: u64 = 1 << 20;
    const LIMIT: u64 = 800 * MIB;

    /// Records room for so many sessions.
    fn record(room: &Room, left: u64, limit: u64, is_next: bool) {
        room.record(mark(limit) - left * SESSION_BYTES, limit, is_next);
    }

    fn site(last: u8) -> Option<IpAddr> {
        Some([10, 0, 0, last].into())
    }

    fn begun(room: &Room, client: Option<IpAddr>, held: usize) -> usize {
        (0..100).filter(|_| room.begin_session(client, held)).count()
    }

    #[test]
    fn four_sessions_have_room_or_a_sixteenth_of_the_limit_else_the_caches_are_cleared() {
        for (limit, most) in [(800, 592), (128, 88), (64, 44), (16, 10)] {
            let room = |used| room_below(used, limit * MIB);
            assert_eq!(room(most * MIB), least(limit * MIB), "{limit} MiB");
            assert_eq!(room(most * MIB + 1), least(limit * MIB) - 1, "{limit} MiB");
        }
        assert_eq!(room_below(LIMIT, LIMIT), 0);
    }

    #[test]
    fn as_many_sessions_begin_in_an_interval_as_have_room() {
        let room = Room::unlimited();
        assert_eq!(begun(&room, site(1), 1000), 100, "without a sample there is room");
        record(&room, 5, LIMIT, true);
        assert_eq!(begun(&room, None, 0), 5);
        record(&room, 5, LIMIT, false);
        assert_eq!(begun(&room, None, 0), 0, "the interval has not ended");
        record(&room, 5, LIMIT, true);
        record(&room, 0, LIMIT, false);
        assert_eq!(begun(&room, None, 0), 0, "the room is gone since");
        record(&room, 0, LIMIT, true);
        assert_eq!(begun(&room, None, 0), 0);
    }

    #[test]
    fn one_site_gets_no_more_room_than_remains_for_others() {
        let room = Room::unlimited();
        for _ in 0..2 {
            record(&room, 20, LIMIT, true);
            assert_eq!([1, 2, 1, 3].map(|last| begun(&room, site(last), 0)), [10, 5, 0, 3]);
        }
    }

    #[test]
    fn views_that_are_being_selected_take_no_room_that_is_reserved() {
        let room = Room::unlimited();
        let views: Vec<_> = (0..30).map_while(|number| room.begin_view(site(number))).collect();
        for (left, expected) in [(100, 70), (40, 16), (10, 10)] {
            record(&room, left, LIMIT, true);
            assert_eq!(begun(&room, None, 0), expected, "{left}");
        }
        drop(views);
    }

    #[test]
    fn the_last_room_is_of_sites_with_few_sessions() {
        let room = Room::unlimited();
        record(&room, 18, LIMIT, true);
        assert_eq!(begun(&room, site(1), 100), 2, "16 are reserved");
        assert_eq!(begun(&room, site(2), 12), 4);
        assert_eq!(begun(&room, site(3), 0), 6);
        // With a small limit less is.
        record(&room, 18, 64 << 20, true);
        assert_eq!(begun(&room, site(1), 100), 9);
        assert_eq!([begun(&room, site(2), 100), begun(&room, site(3), 100)], [5, 2]);
        assert_eq!([begun(&room, site(4), 100), begun(&room, site(4), 0)], [0, 1]);
    }

    #[test]
    fn as_many_views_are_selected_at_once_as_have_room_and_one_always() {
        let room = Room::unlimited();
        let begin =
            |last, count| -> Vec<_> { (0..count).map_while(|_| room.begin_view(site(last))).collect() };
        assert_eq!(begin(1, 100).len(), 100);
        record(&room, 20, LIMIT, false);
        let (first, second) = (begin(1, 100), begin(2, 100));
        assert_eq!([first.len(), second.len()], [10, 5], "a site leaves as many to others");
        record(&room, 0, LIMIT, true);
        assert!(room.begin_view(site(3)).is_none(), "other views take the room");
        drop((first, second));
        assert_eq!(begin(3, 100).len(), 1);
    }

    #[test]
    fn the_only_view_that_has_room_is_of_one_site_and_then_of_another() {
        let room = Room::unlimited();
        record(&room, 0, LIMIT, true);
        let first = room.begin_view(site(1)).expect("one has room");
        assert!(room.begin_view(site(1)).is_none() && room.begin_view(site(2)).is_none());
        drop(first);
        assert!(room.begin_view(site(1)).is_none(), "it asks more often");
        let second = room.begin_view(site(2)).expect("it was refused before");
        assert!(room.begin_view(site(1)).is_none());
        drop(second);
        assert!(room.begin_view(site(2)).is_none());
        // Where that session has ended, another one goes on in the next interval.
        record(&room, 0, LIMIT, true);
        assert!(room.begin_view(site(2)).is_some());
        assert_eq!(room.shares().views_of.len(), 0);
    }
}
