//! The order of turns, in rounds. Those that had no work for a round are first.

use std::collections::VecDeque;

/// Turns of sites, or of the flows of a site. Each is in it at most once; the caller sees to that.
///
/// Those that were idle have their first turn before all others (the new queues of FQ-CoDel, RFC
/// 8290, section 4.2), so that a light client does not wait for a round of heavy ones. Those that
/// come while a round lasts are first too, but no more of them than half of the turns with work in
/// the round before: those that come without end must not keep the others from theirs.
#[derive(Debug)]
pub struct Rotation<Id> {
    /// Those that were idle and have had no turn since.
    new: VecDeque<Id>,
    /// The others, next turn first.
    others: VecDeque<Id>,
    round: Round,
}

/// Turns that are left in a round.
#[derive(Debug, Default)]
struct Round {
    first: usize,
    others: usize,
    /// Turns of this round that had work.
    worked: usize,
}

impl<Id> Default for Rotation<Id> {
    fn default() -> Self {
        Self { new: VecDeque::new(), others: VecDeque::new(), round: Round::default() }
    }
}

impl<Id: Copy + PartialEq> Rotation<Id> {
    /// Adds one that was idle.
    pub fn push_new(&mut self, id: Id) {
        self.new.push_back(id);
    }

    /// Adds one behind the others.
    pub fn push(&mut self, id: Id) {
        self.others.push_back(id);
    }

    /// Adds one whose turn goes on, before the others.
    pub fn push_front(&mut self, id: Id) {
        self.others.push_front(id);
        self.round.others += 1;
    }

    /// Removes one.
    pub fn remove(&mut self, id: Id) {
        self.new.retain(|other| *other != id);
        self.others.retain(|other| *other != id);
    }

    /// Removes all.
    pub fn clear(&mut self) {
        self.new.clear();
        self.others.clear();
    }

    /// Turns that wait.
    pub fn len(&self) -> usize {
        self.new.len() + self.others.len()
    }

    /// Those that were idle and wait for their first turn.
    #[cfg(test)]
    pub fn new_len(&self) -> usize {
        self.new.len()
    }

    /// Counts a turn that had work.
    pub const fn count_work(&mut self) {
        self.round.worked += 1;
    }

    /// Whether one that was idle has the next turn.
    pub fn is_next_new(&self) -> bool {
        let begins_round = self.round.others == 0 || self.others.is_empty();
        !self.new.is_empty() && (self.round.first > 0 || begins_round)
    }

    /// Takes the next turn.
    pub fn next(&mut self) -> Option<Id> {
        if self.len() == 0 {
            return None;
        }
        loop {
            if self.round.first > 0
                && let Some(id) = self.new.pop_front()
            {
                self.round.first -= 1;
                return Some(id);
            }
            // Those that have been removed have no turn.
            self.round.others = self.round.others.min(self.others.len());
            if self.round.others > 0
                && let Some(id) = self.others.pop_front()
            {
                self.round.others -= 1;
                return Some(id);
            }
            // One of the two has a turn for the one that waits.
            let first = self.new.len() + self.round.worked.div_ceil(2);
            self.round = Round { first, others: self.others.len(), ..Round::default() };
        }
    }
}
