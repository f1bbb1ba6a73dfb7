//! The server: generates chunks on demand and streams them to many clients.
//!
//! [`run`] takes a bound listener, a checked configuration and a shutdown signal, and returns after
//! the last session has ended. Modules in reading order:
//!
//! | module | job |
//! | --- | --- |
//! | [`config`] | options, environment, configuration file |
//! | [`access`] | host names, origins and tokens |
//! | [`proxy`], [`tls`] | clients behind trusted proxies; TLS of connections |
//! | [`reload`] | files that are read again |
//! | [`state`] | application state shared by all connections |
//! | [`listener`], [`connections`] | accept loop and shutdown; which connections end when places run short |
//! | [`http`] | routes |
//! | [`websocket`] | transport of sessions |
//! | [`session`] | one task per client |
//! | [`memory`] | what the process may use, and the mark beyond which no session begins |
//! | [`limits`] | limits per client network and per connection |
//! | [`generation`] | scheduling and execution of generation jobs and view selections |
//! | [`cache`] | encoded frames in memory and on disk |
//! | [`store`], [`bake`] | chunks that replicas share; making those of a region |
//! | [`source`], [`chunk_id`] | where chunks come from, and their names |
//! | [`open_files`] | the limit of open files |
//! | [`mechanism`] | what a measurement can turn off |
//! | [`map`] | map tiles rendered from chunks |
//! | [`stats`], [`latency`], [`metrics`], [`traces`] | figures, and spans of single chunks |
//!
//! The server has no GPU crate in its dependency tree, and keeps no state that a reconnect cannot
//! rebuild.

#![forbid(unsafe_code)]

pub mod access;
pub mod bake;
pub mod cache;
pub mod chunk_id;
pub mod config;
pub mod connections;
pub mod generation;
pub mod http;
pub mod latency;
pub mod limits;
pub mod listener;
pub mod map;
pub mod mechanism;
pub mod memory;
pub mod metrics;
pub mod open_files;
pub mod open_sessions;
pub mod proxy;
pub mod reload;
pub mod session;
pub mod site_index;
pub mod source;
pub mod state;
pub mod stats;
pub mod store;
pub mod tls;
pub mod traces;
pub mod websocket;

pub use config::ServerConfig;
pub use listener::run;
