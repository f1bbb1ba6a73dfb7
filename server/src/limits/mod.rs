//! Limits on what one peer may take: connections and sessions ([`per_ip`]), work ([`rate_limit`]),
//! guesses of tokens ([`guesses`]), the time to accept a write ([`write_timeout`]) and lines of the
//! log ([`peer_log`]).

pub mod guesses;
pub mod peer_log;
pub mod per_ip;
pub mod rate_limit;
pub mod write_timeout;
