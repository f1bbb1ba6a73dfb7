//! The processors of a replica: short work of sessions first, then turns of generation.

use std::collections::VecDeque;

/// Which work waits, and how many processors are free.
#[derive(Debug)]
pub struct Processors<W> {
    free: usize,
    waiting: VecDeque<W>,
    /// Turns of generation that run; there are no more than processors.
    generating: usize,
    processors: usize,
}

/// What a processor does next.
#[derive(Debug, PartialEq, Eq)]
pub enum Begun<W> {
    /// This work.
    Work(W),
    /// A turn of generation.
    Turn,
}

impl<W> Processors<W> {
    /// All are free.
    #[must_use]
    pub const fn new(processors: usize) -> Self {
        Self { free: processors, waiting: VecDeque::new(), generating: 0, processors }
    }

    /// Adds work.
    pub fn add(&mut self, work: W) {
        self.waiting.push_back(work);
    }

    /// What a free processor begins; none if all are busy or nothing waits.
    pub fn begin(&mut self, may_generate: bool) -> Option<Begun<W>> {
        if self.free == 0 {
            return None;
        }
        let begun = match self.waiting.pop_front() {
            Some(work) => Begun::Work(work),
            None if may_generate && self.generating < self.processors => {
                self.generating += 1;
                Begun::Turn
            }
            None => return None,
        };
        self.free -= 1;
        Some(begun)
    }

    /// Work has ended.
    pub const fn end(&mut self) {
        self.free += 1;
    }

    /// A turn of generation has ended.
    pub const fn end_turn(&mut self) {
        self.free += 1;
        self.generating -= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_come_before_generation_and_no_processor_does_two_things() {
        let mut processors = Processors::new(2);
        processors.add("a");
        assert_eq!(processors.begin(true), Some(Begun::Work("a")));
        assert_eq!(processors.begin(true), Some(Begun::Turn));
        processors.add("b");
        assert_eq!(processors.begin(true), None);
        processors.end_turn();
        assert_eq!(processors.begin(true), Some(Begun::Work("b")));
        processors.end();
        assert_eq!(processors.begin(false), None);
    }
}
