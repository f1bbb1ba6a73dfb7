//! Sessions without a network, in virtual time: the clock advances when all tasks wait.
//!
//! | module | subject |
//! | --- | --- |
//! | `keepalive` | pings and the timeout of idle sessions |
//! | `rate_limit` | the token bucket of an address |
//! | `refusal_backoff` | pauses after many rejections |

mod keepalive;
mod peer;
mod rate_limit;
mod refusal_backoff;
