//! Limits on what one peer may take: connections and sessions ([`per_ip`]), work ([`rate_limit`])
//! and the time to accept a write ([`write_timeout`]).

pub mod per_ip;
pub mod rate_limit;
pub mod write_timeout;
