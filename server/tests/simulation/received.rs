//! What the clients of a simulation received and when: two runs of a seed have the same.

use std::hash::{DefaultHasher, Hash, Hasher};
use tokio::time::Instant;

/// Messages of the server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Received {
    pub messages: u64,
    /// Of all messages so far, each with the virtual time since the one before.
    digest: u64,
    last: Option<Instant>,
}

impl Received {
    /// A message arrived now.
    pub fn message(&mut self, bytes: &[u8]) {
        let now = Instant::now();
        self.messages += 1;
        self.mix((self.last.map(|last| now - last), bytes));
        self.last = Some(now);
    }

    /// Adds what another client received.
    pub fn add(&mut self, other: &Self) {
        self.messages += other.messages;
        self.mix(other.digest);
        self.last = None;
    }

    fn mix(&mut self, part: impl Hash) {
        // Its keys are constants.
        let mut hasher = DefaultHasher::new();
        (self.digest, part).hash(&mut hasher);
        self.digest = hasher.finish();
    }
}
