//! The server: chunks made on demand, streamed to many.
//!
//! [`run`] is the whole of it: a bound listener, a checked configuration and a shutdown signal go
//! in, and it returns when the last session is gone. Reading order: [`config`], [`listener`] (over
//! [`patient`] connections), [`http`], [`socket`] (one task per client around the sans-IO session
//! of the `protocol` crate, over a [`websocket`]), [`generation`] (one job per key however many
//! ask), [`disk`] (what outlives the process), [`source`] (where chunks come from), [`map`]
//! (pictures of them), [`live`] (what happens at the moment), [`addresses`] and [`purse`] (what one
//! address may take), [`silence`] and [`heed`] (who is not heard, and who is not listened to),
//! [`latency`], [`metrics`].
//!
//! What it refuses: drawing (no GPU crate is in its dependency tree) and state that a reconnect
//! cannot rebuild.

#![forbid(unsafe_code)]

pub mod addresses;
pub mod config;
pub mod disk;
pub mod generation;
pub mod heed;
pub mod http;
pub mod latency;
pub mod listener;
pub mod live;
pub mod map;
pub mod metrics;
pub mod patient;
pub mod purse;
pub mod silence;
pub mod socket;
pub mod source;
pub mod upgrade;
pub mod websocket;

pub use config::ServerConfig;
pub use listener::run;

/// Name and version, as told to peers.
pub const SOFTWARE: &str = concat!("tombolo-server ", env!("CARGO_PKG_VERSION"));
