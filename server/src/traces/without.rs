//! A server without the feature `traces`: peers' traces are not read, and nothing is exported.

use super::config::TraceConfig;
use axum::http::HeaderMap;
use tracing::Span;
use tracing_subscriber::layer::Identity;

/// No span of a peer.
#[derive(Clone, Debug)]
pub enum Parent {}

impl Parent {
    /// None, whatever the headers.
    #[must_use]
    pub fn of(_: &HeaderMap) -> Option<Self> {
        None
    }

    /// Never called: there is no value.
    pub fn adopt(&self, _: &Span) {
        match *self {}
    }
}

/// No exporter.
#[derive(Debug)]
pub enum Exporter {}

impl Exporter {
    /// Never called: there is no value.
    pub fn close(self) {
        match self {}
    }
}

/// No layer.
///
/// # Errors
/// Always: why nothing is exported.
pub fn layer(_: &TraceConfig, _: String) -> Result<(Identity, Exporter), &'static str> {
    Err("this server was built without them; build it with the feature `traces`, or remove otlp")
}
