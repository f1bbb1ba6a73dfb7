//! How clients request chunks.

use clap::ValueEnum;

/// How clients request chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Mode {
    /// Poses over WebSocket; the server chooses the chunks
    View,
    /// Requests by key over WebSocket
    Explicit,
    /// GETs of the chunk route over one persistent connection per client, conditionally for chunks
    /// that the client has received before
    Http,
}

impl Mode {
    /// As on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Explicit => "explicit",
            Self::Http => "http",
        }
    }

    /// The two events between which a latency is measured.
    #[must_use]
    pub const fn measures(self, is_open: bool) -> &'static str {
        match (self, is_open) {
            (Self::View, true) => "pose to settled view",
            (Self::View, false) | (Self::Explicit, _) => "request to chunk",
            (Self::Http, _) => "GET to chunk",
        }
    }
}
