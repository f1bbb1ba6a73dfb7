//! Sessions without a network, in virtual time: the clock advances when all tasks wait.
//!
//! | module | subject |
//! | --- | --- |
//! | `batches` | many cached chunks for one client |
//! | `endless` | a client whose next message is always there |
//! | `ends` | why and how sessions end |
//! | `keepalive` | pings and the timeout of idle sessions |
//! | `message_deadline` | messages that are begun and not finished |
//! | `rate_limit` | the token bucket of an address |
//! | `refusal_backoff` | pauses after many rejections |
//! | `waiting` | chunks and views that wait for the generation thread |

mod batches;
mod endless;
mod ends;
mod keepalive;
mod message_deadline;
mod peer;
mod rate_limit;
mod refusal_backoff;
mod waiting;
