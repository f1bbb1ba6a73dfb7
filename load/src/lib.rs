//! The load test: many sessions on flight paths, every chunk verified.
//!
//! [`run()`] takes a checked [`LoadConfig`] and returns a [`Report`]; [`Report::verdict`] says
//! whether the server passed. Reading order:
//!
//! - options and plan: [`config`], [`phases`] (parts of a run), [`path`] (where a client is),
//!   [`keys`] (which chunks it requests), [`arrivals`] and [`schedule`] (when it does what);
//! - clients: [`task`] (what a client gets, how a session ends), [`client`] (one client through one
//!   phase), [`session`] (WebSocket), [`held`] and [`resume`] (what outlives a session),
//!   [`request_pause`] (what follows a refusal), [`http`],
//!   [`slow`] and [`silent`] (background clients);
//! - verification: [`expected`] (which chunks may arrive), [`verify`] (what a chunk must satisfy),
//!   [`released`] (what views may lack), [`world`] (which world it is), [`checker`] and
//!   [`regeneration`] (who checks);
//! - results: [`counters`], [`latency`], [`timeline`], [`run_stats`], [`report`], [`plot`].
//!
//! The load test has no GPU crate in its dependencies, keeps no verified chunk, and speaks the
//! protocol only through the client state machine of the `protocol` crate. Benchmarks of single
//! properties of a server are in the package `server-bench`.

#![forbid(unsafe_code)]

pub mod arrivals;
pub mod checker;
pub mod client;
pub mod config;
pub mod counters;
pub mod dial;
pub mod expected;
pub mod held;
pub mod http;
pub mod keys;
pub mod latency;
pub mod mode;
pub mod path;
pub mod phases;
pub mod plot;
mod refusal;
pub mod regeneration;
pub mod released;
pub mod report;
pub mod request_pause;
pub mod resume;
pub mod run;
pub mod run_stats;
pub mod schedule;
pub mod session;
pub mod silent;
pub mod slow;
pub mod task;
pub mod throttle;
pub mod timeline;
pub mod verify;
pub mod world;

pub use config::{Args, LoadConfig};
pub use mode::Mode;
pub use path::PathKind;
pub use report::{Counts, Report};
pub use run::{run, run_counting};
pub use run_stats::RunStats;

/// Name and version, sent to servers.
pub const SOFTWARE: &str = concat!("tombolo-load ", env!("CARGO_PKG_VERSION"));
