//! Texts of options: the URL of a store, the digest of a world.

use server::store::address::StoreAddress;
use terrain::WorldDigest;

/// Parses a text. An error is one line; a digest is written as it was read.
///
/// # Panics
/// The error has several lines, or the digest is written otherwise.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let digest = WorldDigest::from_hex(text);
    if let Some(digest) = digest {
        assert_eq!(digest.to_string(), text.to_ascii_lowercase());
    }
    match StoreAddress::parse(text) {
        Ok(_) => true,
        Err(error) => {
            assert_eq!(error.lines().count(), 1, "{error}");
            digest.is_some()
        }
    }
}

/// Addresses of each engine, and a digest.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let texts = ["file:///tmp/x", "s3://bucket/path", "gs://bucket", "az://container/x", "/tmp/x"];
    texts.iter().map(|text| text.as_bytes().to_vec()).chain([vec![b'0'; 64]]).collect()
}
