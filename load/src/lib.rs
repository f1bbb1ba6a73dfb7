//! The load test: many sessions on flight paths, every chunk verified.
//!
//! [`run()`] is the whole of it: a checked [`LoadConfig`] goes in, a [`Report`] comes out, and
//! [`Report::verdict`] says whether the server passed. Reading order: [`config`], [`phases`] (the
//! parts of a run), [`path`] (where a client flies), [`keys`] (which chunks it asks for),
//! [`arrivals`] and [`agenda`] (when it does what), [`client`] (one client through one part),
//! [`session`] (over WebSocket) and [`http`], [`slow`] and [`silent`] (the unpleasant ones);
//! [`interest`] (what may be sent), [`verify`] (what a chunk must satisfy), [`inspection`] and
//! [`regeneration`] (who looks); [`counters`], [`latency`], [`timeline`] and [`tally`] (what is
//! counted), [`report`] and [`plot`]. Apart from all that, [`mod@bench`] measures a server's
//! promises one by one.
//!
//! What it refuses: drawing the land (no GPU crate is in its dependency tree), keeping chunks (a
//! verified chunk is dropped), and deciding for itself what the wire looks like (the `protocol`
//! crate's client machine does).

#![forbid(unsafe_code)]

pub mod agenda;
pub mod arrivals;
pub mod bench;
pub mod client;
pub mod config;
pub mod counters;
pub mod dial;
pub mod http;
pub mod inspection;
pub mod interest;
pub mod keys;
pub mod latency;
pub mod mode;
pub mod path;
pub mod phases;
pub mod plot;
pub mod regeneration;
pub mod report;
pub mod run;
pub mod session;
pub mod silent;
pub mod slow;
pub mod tally;
pub mod throttle;
pub mod timeline;
pub mod verify;

pub use config::{Args, LoadConfig};
pub use mode::Mode;
pub use path::PathKind;
pub use report::Report;
pub use run::{run, run_counting};
pub use tally::Tally;

/// Name and version, as told to servers.
pub const SOFTWARE: &str = concat!("tombolo-load ", env!("CARGO_PKG_VERSION"));
