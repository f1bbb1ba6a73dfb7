//! Index of numbered members (connections, sessions) by the site of their client. A full server
//! looks for a member to end at each new client: a search takes logarithmic time.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap};
use std::hash::Hash;

/// See the module.
#[derive(Debug)]
pub struct SiteIndex<S> {
    sites: HashMap<S, Members>,
    /// All sites, the one to displace from last.
    ranks: BTreeSet<(Rank, S)>,
}

/// Order in which sites give up a member: most members, then any idle one, then the oldest.
type Rank = (usize, bool, Reverse<u64>);

/// The members of a site; one set is not empty.
#[derive(Debug, Default)]
struct Members {
    idle: BTreeSet<u64>,
    busy: BTreeSet<u64>,
}

impl Members {
    fn count(&self) -> usize {
        self.idle.len() + self.busy.len()
    }

    /// None without members.
    fn rank(&self) -> Option<Rank> {
        let oldest = self.idle.first().or_else(|| self.busy.first())?;
        Some((self.count(), !self.idle.is_empty(), Reverse(*oldest)))
    }
}

impl<S> Default for SiteIndex<S> {
    fn default() -> Self {
        Self { sites: HashMap::new(), ranks: BTreeSet::new() }
    }
}

impl<S: Copy + Ord + Hash> SiteIndex<S> {
    /// Adds a member, idle. Numbers increase with time.
    pub fn insert(&mut self, site: S, number: u64) {
        self.change(site, |members| {
            members.idle.insert(number);
        });
    }

    /// Removes a member. No effect if it is not there.
    pub fn remove(&mut self, site: S, number: u64) {
        self.change(site, |members| {
            let _ = members.idle.remove(&number) || members.busy.remove(&number);
        });
    }

    /// Notes whether a member is busy. No effect if it is not there.
    pub fn set_busy(&mut self, site: S, number: u64, is_busy: bool) {
        self.change(site, |Members { idle, busy }| {
            let (from, to) = if is_busy { (idle, busy) } else { (busy, idle) };
            if from.remove(&number) {
                to.insert(number);
            }
        });
    }

    /// Members of a site.
    #[must_use]
    pub fn count(&self, site: S) -> usize {
        self.sites.get(&site).map_or(0, Members::count)
    }

    /// The member to end for a new one of `site`: of the site with the most, the oldest idle one,
    /// or the oldest if all are busy. None unless that site has more members than `site`, and two
    /// more where all of its members are busy.
    #[must_use]
    pub fn displaced_by(&self, site: S) -> Option<u64> {
        let own = self.count(site);
        let ((count, has_idle, Reverse(oldest)), _) = *self.ranks.last()?;
        (count > own + usize::from(!has_idle)).then_some(oldest)
    }

    /// The newest member of the site with the most members, and their number.
    #[must_use]
    pub fn newest_of_largest(&self) -> Option<(u64, usize)> {
        let (_, site) = self.ranks.last()?;
        let Members { idle, busy } = self.sites.get(site)?;
        let newest = idle.last().max(busy.last())?;
        Some((*newest, idle.len() + busy.len()))
    }

    fn change(&mut self, site: S, change: impl FnOnce(&mut Members)) {
        let members = self.sites.entry(site).or_default();
        let before = members.rank();
        change(members);
        let after = members.rank();
        if after.is_none() {
            self.sites.remove(&site);
        }
        if before != after {
            before.map(|rank| self.ranks.remove(&(rank, site)));
            after.map(|rank| self.ranks.insert((rank, site)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// The rule of [`SiteIndex::displaced_by`] over a list of (number, (site, is busy)).
    fn displaced_of_all(members: &BTreeMap<u64, (u8, bool)>, site: u8) -> Option<u64> {
        let count = |site| members.values().filter(|(other, _)| *other == site).count();
        let own = count(site);
        let rank = |(number, (site, is_busy)): (&u64, &(u8, bool))| {
            let count = count(*site);
            (count > own + usize::from(*is_busy)).then_some((count, !is_busy, Reverse(*number)))
        };
        members.iter().filter_map(rank).max().map(|(.., Reverse(number))| number)
    }

    proptest! {
        #[test]
        fn the_index_finds_what_a_look_at_all_members_finds(
            changes in prop::collection::vec((0..4_u8, 0..5_u8, 0..20_u64), 1..200),
        ) {
            let (mut index, mut members) = (SiteIndex::default(), BTreeMap::new());
            for (change, site, number) in changes {
                match change {
                    0 if !members.contains_key(&number) => {
                        index.insert(site, number);
                        members.insert(number, (site, false));
                    }
                    1 => {
                        let site = members.remove(&number).map_or(site, |(site, _)| site);
                        index.remove(site, number);
                    }
                    _ => {
                        let site = members.get_mut(&number).map_or(site, |member: &mut (u8, bool)| {
                            member.1 = change == 2;
                            member.0
                        });
                        index.set_busy(site, number, change == 2);
                    }
                }
                for site in 0..6 {
                    prop_assert_eq!(index.displaced_by(site), displaced_of_all(&members, site));
                }
                let largest = index.newest_of_largest();
                let counts = |site: u8| members.values().filter(|(other, _)| *other == site).count();
                prop_assert_eq!(largest.map(|(_, count)| count), (0..5).map(counts).filter(|n| *n > 0).max());
                if let Some((newest, count)) = largest {
                    let site = members[&newest].0;
                    prop_assert_eq!(counts(site), count);
                    prop_assert!(members.range(newest + 1..).all(|(_, (other, _))| *other != site));
                }
            }
            members.iter().for_each(|(number, (site, _))| index.remove(*site, *number));
            prop_assert!(index.sites.is_empty() && index.ranks.is_empty());
        }
    }
}
