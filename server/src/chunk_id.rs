//! Names of chunks inside one world: key and edition.

use std::fmt;
use terrain::ChunkKey;

/// Which state of a chunk: the land that the seed makes, or what changes made of it.
///
/// A chunk has one content in one edition, for ever. So a cache may lack a chunk but cannot be
/// stale, and all replicas agree without a message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Edition(Option<[u8; 16]>);

impl Edition {
    /// The land that the seed makes.
    pub const BASE: Self = Self(None);

    /// The state after changes, named by a hash of all of them.
    #[must_use]
    pub const fn changed(hash: [u8; 16]) -> Self {
        Self(Some(hash))
    }

    /// Whether it is the land that the seed makes.
    #[must_use]
    pub const fn is_base(self) -> bool {
        self.0.is_none()
    }
}

impl fmt::Display for Edition {
    /// `base`, or the hash in hexadecimal digits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("base"),
            Some(hash) => hash.iter().try_for_each(|byte| write!(f, "{byte:02x}")),
        }
    }
}

/// The name of a chunk in one world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChunkId {
    /// Where it lies.
    pub key: ChunkKey,
    /// Which of its states.
    pub edition: Edition,
}

impl ChunkId {
    /// The chunk as the seed makes it.
    #[must_use]
    pub const fn base(key: ChunkKey) -> Self {
        Self { key, edition: Edition::BASE }
    }
}

impl fmt::Display for ChunkId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.edition.is_base() { self.key.fmt(f) } else { write!(f, "{}@{}", self.key, self.edition) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn editions_have_names_of_their_own() {
        let [one, other] = [[1; 16], [2; 16]].map(Edition::changed);
        assert_eq!(Edition::BASE.to_string(), "base");
        assert_eq!(one.to_string(), "01".repeat(16));
        assert!(one != other && one.to_string() != other.to_string() && !one.is_base());
        let key = ChunkKey::new(2, -1, 3).unwrap();
        assert_eq!(ChunkId::base(key).to_string(), key.to_string());
        assert_eq!(ChunkId { key, edition: one }.to_string(), format!("{key}@{one}"));
    }
}
