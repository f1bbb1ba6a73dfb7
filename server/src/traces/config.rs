//! Where traces go, and how many chunks have one.

use url::Url;

/// Target of all spans, for the filters of log and export.
pub const TARGET: &str = "tombolo_trace";

/// The export of traces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TraceConfig {
    /// The collector's address for OTLP over HTTP.
    pub endpoint: Url,
    /// One requested chunk in this number is traced; 0 for only those whose peer names a trace.
    pub every: u64,
}
