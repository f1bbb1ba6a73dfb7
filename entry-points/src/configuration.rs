//! A configuration file of a server.

use crate::is_accepted;
use clap::Parser;
use server::ServerConfig;
use server::config::{Args, Options, parse_file};
use std::sync::LazyLock;

/// A program started without options.
static ARGS: LazyLock<Args> =
    LazyLock::new(|| Args::try_parse_from(["tombolo-server"]).expect("valid arguments"));

/// What a program takes for absent options.
static DEFAULTS: LazyLock<ServerConfig> = LazyLock::new(ServerConfig::default);

/// Resolves a configuration. An error is one line.
///
/// # Panics
/// It has several lines.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let resolved = parse_file(text, "input").and_then(|options| {
        // A named file would be read, and a device without an end to its end.
        let without_files = Options { token_file: None, tls_cert: None, tls_key: None, ..options };
        ARGS.clone().resolve_with(without_files, DEFAULTS.clone())
    });
    is_accepted(&resolved)
}

/// Files with every kind of value.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    vec![
        b"listen = \"127.0.0.1:7580\"\nworld-seed = 7\nthreads = 2\ncache-mb = 64\n".into(),
        b"disk-cache = \"/tmp/x\"\ndisk-mb = 64\nlog = \"info\"\nlog-json = true\n".into(),
        b"max-sessions = 100\nmax-sessions-per-address = 10\nrate-limit-ms = 50\ndeadline-ms = 500\n".into(),
        b"store = \"file:///tmp\"\nstore-wait-ms = 20\n".into(),
    ]
}
