//! Sessions without a network, in virtual time: the clock advances when all tasks wait.
//!
//! | module | subject |
//! | --- | --- |
//! | `batches` | many cached chunks for one client |
//! | `keepalive` | pings and the timeout of idle sessions |
//! | `message_deadline` | messages that are begun and not finished |
//! | `rate_limit` | the token bucket of an address |
//! | `refusal_backoff` | pauses after many rejections |

mod batches;
mod keepalive;
mod message_deadline;
mod peer;
mod rate_limit;
mod refusal_backoff;
