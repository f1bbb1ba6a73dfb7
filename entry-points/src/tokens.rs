//! A file of access tokens.

use crate::is_accepted;
use server::access::tokens::{Known, TokenDigest, TokenFile};
use std::path::PathBuf;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::SystemTime;

/// A file of this process. One input at a time.
static FILE: LazyLock<Mutex<PathBuf>> = LazyLock::new(|| {
    Mutex::new(std::env::temp_dir().join(format!("tombolo-entry-points-tokens-{}", std::process::id())))
});

/// Reads a file. An error is one line.
///
/// # Panics
/// An error has several lines, the token of a file without a list is not its first line, or the
/// file cannot be written.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let path = FILE.lock().unwrap_or_else(PoisonError::into_inner);
    std::fs::write(&*path, bytes).expect("a file in the folder for temporary files");
    let read = TokenFile::new(path.clone()).read();
    let _ = std::fs::remove_file(&*path);
    if let Ok(tokens) = &read {
        let text = String::from_utf8_lossy(bytes);
        if !text.contains(['[', '#']) {
            let first = text.trim_start_matches('\u{feff}').lines().next().unwrap_or_default().trim();
            assert_eq!(tokens.len(), 1);
            let known = tokens.find(&TokenDigest::of(first), SystemTime::now());
            assert!(matches!(known, Known::Valid(_)), "{first:?}");
        }
    }
    is_accepted(&read)
}

/// A file with one token, and a list.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    vec![
        b"open sesame\n".into(),
        b"[[token]]\nname = \"a\"\ntoken = \"first\"\nexpires = 2027-01-31T18:00:00Z\n".into(),
        b"# a list\n[[token]]\nname = \"a\"\ntoken = \"x\"\n\n[[token]]\nname = \"b\"\ntoken = \"y\"\n"
            .into(),
        b"token = []\n".into(),
    ]
}
