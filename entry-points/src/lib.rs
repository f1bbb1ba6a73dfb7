//! Places where bytes of a peer or of a file, or numbers of a view, come in, as functions for
//! fuzzing: every decoder of this project. What a library decodes into a few fields has none: the
//! JSON of a store's regions and of problem documents, and the PNG files of textures.
//!
//! A function accepts any bytes. It panics if they violate an invariant, and otherwise says whether
//! they were accepted. The targets of the package `fuzz` call it under libFuzzer; the test `smoke`
//! calls it with random bytes and with mutations of valid ones.
//!
//! | module | bytes of |
//! | --- | --- |
//! | [`control`], [`chunk`] | one frame, either direction |
//! | [`client_session`], [`server_session`] | the frames of a whole session |
//! | [`websocket`] | a WebSocket connection |
//! | [`http`] | an HTTP connection |
//! | [`configuration`] | a configuration file |
//! | [`proxy`] | the PROXY header of a connection, forwarded addresses and traces of a request |
//! | [`tokens`] | a file of access tokens |
//! | [`pack`], [`address`] | a pack of the store, the store's URL |
//! | [`uniforms`] | the numbers of a view and its settings |

#![forbid(unsafe_code)]

pub mod address;
pub mod chunk;
pub mod client_session;
pub mod configuration;
pub mod control;
pub mod http;
pub mod pack;
pub mod proxy;
pub mod server_session;
pub mod tokens;
pub mod uniforms;
pub mod websocket;
mod world;

/// One entry point.
#[derive(Clone, Copy, Debug)]
pub struct EntryPoint {
    /// Also the name of its fuzz target.
    pub name: &'static str,
    /// Passes bytes in. Returns whether they were accepted.
    pub run: fn(&[u8]) -> bool,
    /// Valid inputs to start from.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Relative cost of a call; cheap ones are 1.
    pub cost: u32,
}

/// All entry points.
pub const ALL: [EntryPoint; 12] = [
    EntryPoint { name: "control", run: control::run, seeds: control::seeds, cost: 1 },
    EntryPoint { name: "chunk", run: chunk::run, seeds: chunk::seeds, cost: 10 },
    EntryPoint { name: "client_session", run: client_session::run, seeds: client_session::seeds, cost: 20 },
    EntryPoint { name: "server_session", run: server_session::run, seeds: server_session::seeds, cost: 20 },
    EntryPoint { name: "websocket", run: websocket::run, seeds: websocket::seeds, cost: 1 },
    EntryPoint { name: "http", run: http::run, seeds: http::seeds, cost: 10 },
    EntryPoint { name: "configuration", run: configuration::run, seeds: configuration::seeds, cost: 5 },
    EntryPoint { name: "proxy", run: proxy::run, seeds: proxy::seeds, cost: 1 },
    EntryPoint { name: "tokens", run: tokens::run, seeds: tokens::seeds, cost: 5 },
    EntryPoint { name: "pack", run: pack::run, seeds: pack::seeds, cost: 5 },
    EntryPoint { name: "address", run: address::run, seeds: address::seeds, cost: 1 },
    EntryPoint { name: "uniforms", run: uniforms::run, seeds: uniforms::seeds, cost: 1 },
];

/// Whether an operator's input was accepted. An error is one line, as programs print it.
///
/// # Panics
/// The error has several lines.
fn is_accepted<T>(read: &Result<T, impl std::fmt::Display>) -> bool {
    if let Err(error) = read {
        assert_eq!(error.to_string().lines().count(), 1, "{error}");
    }
    read.is_ok()
}

/// Frames of a session in one input: each behind its length as u16, little-endian.
fn frames(mut bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let (length, rest) = bytes.split_first_chunk()?;
        let (frame, rest) = rest.split_at(usize::from(u16::from_le_bytes(*length)).min(rest.len()));
        bytes = rest;
        Some(frame)
    })
}

/// The input that [`frames`] splits.
fn join<'a>(frames: impl IntoIterator<Item = &'a [u8]>) -> Vec<u8> {
    let behind_length = |frame: &[u8]| [&(frame.len() as u16).to_le_bytes(), frame].concat();
    frames.into_iter().flat_map(behind_length).collect()
}
