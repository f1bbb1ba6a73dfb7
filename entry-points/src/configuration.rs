//! A configuration file of a server.

use clap::Parser;
use server::config::Args;
use std::path::PathBuf;
use std::sync::LazyLock;

/// The file, in a folder of temporary files; one input at a time and process.
static FILE: LazyLock<PathBuf> =
    LazyLock::new(|| std::env::temp_dir().join(format!("tombolo-entry-{}.toml", std::process::id())));

/// Reads a configuration. An error is one line.
///
/// # Panics
/// It has several lines, or the folder of temporary files cannot be written.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    // A file named in the input would be read, and a device without an end to its end.
    if bytes.windows(4).any(|part| part == b"file") {
        return false;
    }
    std::fs::write(&*FILE, bytes).expect("a temporary file");
    let args = ["tombolo-server".as_ref(), "--config".as_ref(), FILE.as_os_str()];
    match Args::try_parse_from(args).expect("valid arguments").resolve() {
        Ok(_) => true,
        Err(error) => {
            assert_eq!(error.to_string().lines().count(), 1, "{error}");
            false
        }
    }
}

/// Files with every kind of value.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    vec![
        b"listen = \"127.0.0.1:7580\"\nworld-seed = 7\nthreads = 2\ncache-mb = 64\n".into(),
        b"disk-cache = \"/tmp/x\"\ndisk-mb = 64\nlog = \"info\"\nlog-json = true\n".into(),
        b"max-sessions = 100\nmax-sessions-per-address = 10\nrate-limit-ms = 50\ndeadline-ms = 500\n".into(),
        b"store = \"file:///tmp/store\"\nstore-wait-ms = 20\n".into(),
    ]
}
