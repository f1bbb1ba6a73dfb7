//! The generation service: one job per chunk for any number of requests, on a pool of compute
//! threads behind a bounded, fair queue.
//!
//! A chunk has one frame per delivery. A job generates the chunk once and encodes only the
//! requested frames: a server whose clients all regenerate spends neither time nor cache on exact
//! frames of a hundred times the size. A later request for another delivery of a cached chunk
//! generates the heights again but takes the error, the expensive part, from the cached frame.
//!
//! Clients of the service are [`Flow`]s: one per session, one per download. A thread takes one
//! flow's turn at a time, which is several cheap chunks or one expensive one, and completes it as a
//! whole, so that a session wakes and writes once per turn. A job belongs to the service, not to a
//! flow, so a flow that ends does not affect others; a queued job without requests is dropped. A
//! job looks on disk first ([`crate::cache::disk`]). Finished frames enter the cache before the job
//! is removed, so a chunk is never generated twice at the same time.
//!
//! A chunk is a key in an edition ([`crate::chunk_id`]). A request gets the edition that the source
//! offers at its time; one for the base gets the land that the seed makes.
//!
//! Modules from the bottom up: [`result`], [`cost`] (estimates), `work_time`, [`views`] (view
//! selection), [`queue`] (scheduling), `threads` (lock and threads), `active` (active flows and
//! their shares), `shared` (state of the service), `runner` (execution), [`flow`] (requests of one
//! client), [`service`] (the public handle).

mod active;
pub mod cost;
#[cfg(test)]
mod edition_tests;
pub mod flow;
pub mod queue;
pub mod result;
mod runner;
#[cfg(all(test, shuttle))]
mod schedules;
pub mod service;
mod shared;
#[cfg(test)]
mod test_source;
mod threads;
pub mod views;
mod work_time;

pub use flow::{Flow, FlowEvent};
pub use result::{Completion, FrameResult, GenerationError};
pub use service::Generation;
pub use shared::Limits;
pub use threads::{Executor, Turns};
pub use work_time::WorkClock;
