//! Limits on what one peer may take, by its [`networks`]: connections and sessions ([`per_ip`]),
//! work ([`rate_limit`], [`site_turns`]), guesses of tokens ([`guesses`]), the time to accept a
//! write ([`write_timeout`]), what the system keeps for it ([`system_buffers`]) and lines of the
//! log ([`peer_log`]).

pub mod guesses;
pub mod networks;
pub mod peer_log;
pub mod per_ip;
pub mod rate_limit;
pub mod site_turns;
pub mod system_buffers;
pub mod write_timeout;
