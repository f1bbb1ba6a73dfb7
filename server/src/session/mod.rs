//! Sessions: one task per WebSocket client around the sans-IO session of the `protocol` crate.
//!
//! [`driver`] is the loop, `chunk_traces` its traced chunks, [`end`] the reasons for which a
//! session ends, [`keepalive`] the timeout of inactive peers, [`refusal_backoff`] the pause after
//! many rejected requests.

mod chunk_traces;
pub mod driver;
pub mod end;
pub mod keepalive;
pub mod message_deadline;
pub mod refusal_backoff;
