//! Access control of the server: host names and origins of requests ([`hosts`]), tokens
//! ([`tokens`]) and their guesses ([`gate`]).

pub mod gate;
pub mod hosts;
pub mod tokens;

use clap::ValueEnum;
use serde::Deserialize;
use std::fmt;

/// A route that is open on a server with tokens, unless it is protected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProtectedRoute {
    /// `/metrics`
    Metrics,
    /// `/v1/world`
    World,
}

impl fmt::Display for ProtectedRoute {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Metrics => "metrics",
            Self::World => "world",
        })
    }
}
