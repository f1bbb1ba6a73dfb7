//! Error responses: RFC 9457 problem documents of a closed list of kinds.
//!
//! The `type` of a problem refers to the example of its kind in the OpenAPI document.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::json;

/// Why a request was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProblemKind {
    /// No route has this path.
    NoRoute,
    /// The route does not support the method.
    WrongMethod,
    /// Invalid numbers or encoding in the path, or a query that the route does not have.
    Malformed,
    /// A chunk or position outside the world.
    OutsideWorld,
    /// The digest of another world.
    WrongWorld,
    /// Another style of the map than this server's.
    WrongStyle,
    /// The token is missing, wrong or expired.
    Unauthorised,
    /// The address has presented too many wrong tokens.
    TooManyGuesses,
    /// The host name of the request is not one of this server.
    UnknownHost,
    /// A page of another origin opens a session.
    ForeignOrigin,
    /// `If-Match` does not match the representation.
    PreconditionFailed,
    /// Not a WebSocket handshake.
    NotAnUpgrade,
    /// A handshake that violates RFC 6455 or offers no supported subprotocol.
    BadHandshake,
    /// Chunks are requested faster than they can be generated.
    Overloaded,
    /// The rate limit of the client network is exceeded.
    OverRate,
    /// The server answers as many requests as it may at once.
    TooManyRequests,
    /// The generation of a chunk failed.
    Failed,
    /// Too many map tiles are requested at once.
    MapBusy,
    /// All sessions are in use, or the server is draining.
    NoSession,
    /// The client network has its maximum of sessions or of requests.
    AddressFull,
}

impl ProblemKind {
    /// Every kind.
    pub const ALL: [Self; 20] = [
        Self::NoRoute,
        Self::WrongMethod,
        Self::Malformed,
        Self::OutsideWorld,
        Self::WrongWorld,
        Self::WrongStyle,
        Self::Unauthorised,
        Self::TooManyGuesses,
        Self::UnknownHost,
        Self::ForeignOrigin,
        Self::PreconditionFailed,
        Self::NotAnUpgrade,
        Self::BadHandshake,
        Self::Overloaded,
        Self::OverRate,
        Self::TooManyRequests,
        Self::Failed,
        Self::MapBusy,
        Self::NoSession,
        Self::AddressFull,
    ];

    /// Its index in [`ProblemKind::ALL`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// A fixed name: the end of the problem's `type`, and the label in the metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NoRoute => "no-route",
            Self::WrongMethod => "wrong-method",
            Self::Malformed => "malformed",
            Self::OutsideWorld => "outside-world",
            Self::WrongWorld => "wrong-world",
            Self::WrongStyle => "wrong-style",
            Self::Unauthorised => "unauthorised",
            Self::TooManyGuesses => "too-many-guesses",
            Self::UnknownHost => "unknown-host",
            Self::ForeignOrigin => "foreign-origin",
            Self::PreconditionFailed => "precondition-failed",
            Self::NotAnUpgrade => "not-an-upgrade",
            Self::BadHandshake => "bad-handshake",
            Self::Overloaded => "overloaded",
            Self::OverRate => "over-rate",
            Self::TooManyRequests => "too-many-requests",
            Self::Failed => "failed",
            Self::MapBusy => "map-busy",
            Self::NoSession => "no-session",
            Self::AddressFull => "address-full",
        }
    }

    /// The title, without details of the request.
    #[must_use]
    pub const fn title(self) -> &'static str {
        match self {
            Self::NoRoute => "No such route",
            Self::WrongMethod => "Method not allowed",
            Self::Malformed => "Malformed address",
            Self::OutsideWorld => "Outside the world",
            Self::WrongWorld => "Another world",
            Self::WrongStyle => "Another style of the map",
            Self::Unauthorised => "Token required",
            Self::TooManyGuesses => "Too many wrong tokens from this address",
            Self::UnknownHost => "Unknown host name",
            Self::ForeignOrigin => "Page of another origin",
            Self::PreconditionFailed => "Precondition failed",
            Self::NotAnUpgrade => "Not a WebSocket request",
            Self::BadHandshake => "Bad WebSocket handshake",
            Self::Overloaded => "Overloaded",
            Self::OverRate => "Rate limit exceeded",
            Self::TooManyRequests => "Too many requests at once",
            Self::Failed => "Generation failed",
            Self::MapBusy => "Map is busy",
            Self::NoSession => "No free session",
            Self::AddressFull => "Too many sessions or requests from this address",
        }
    }

    /// The HTTP status.
    #[must_use]
    pub const fn status(self) -> StatusCode {
        match self {
            Self::NoRoute | Self::OutsideWorld | Self::WrongWorld | Self::WrongStyle => StatusCode::NOT_FOUND,
            Self::WrongMethod => StatusCode::METHOD_NOT_ALLOWED,
            Self::Malformed | Self::BadHandshake => StatusCode::BAD_REQUEST,
            Self::Unauthorised => StatusCode::UNAUTHORIZED,
            Self::TooManyGuesses => StatusCode::TOO_MANY_REQUESTS,
            Self::UnknownHost => StatusCode::MISDIRECTED_REQUEST,
            Self::ForeignOrigin => StatusCode::FORBIDDEN,
            Self::PreconditionFailed => StatusCode::PRECONDITION_FAILED,
            Self::NotAnUpgrade => StatusCode::UPGRADE_REQUIRED,
            Self::Overloaded
            | Self::OverRate
            | Self::TooManyRequests
            | Self::Failed
            | Self::MapBusy
            | Self::NoSession
            | Self::AddressFull => StatusCode::SERVICE_UNAVAILABLE,
        }
    }

    /// `Retry-After`, seconds.
    const fn retry_after(self) -> Option<&'static str> {
        match self {
            Self::Overloaded | Self::OverRate | Self::TooManyRequests | Self::Failed | Self::MapBusy => {
                Some("1")
            }
            Self::NoSession | Self::AddressFull => Some("2"),
            Self::TooManyGuesses => Some("60"),
            _ => None,
        }
    }
}

/// An error response.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The kind.
    pub kind: ProblemKind,
    /// One sentence: the cause and what to do.
    pub detail: String,
}

impl Problem {
    /// A problem with its details.
    #[must_use]
    pub fn new(kind: ProblemKind, detail: impl Into<String>) -> Self {
        Self { kind, detail: detail.into() }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let Self { kind, detail } = self;
        let body = json!({
            "type": format!("/openapi.json#/components/examples/{}", kind.name()),
            "title": kind.title(),
            "status": kind.status().as_u16(),
            "detail": detail,
        });
        let mut response = (kind.status(), Json(body)).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        // Errors are temporary; heuristic caching (RFC 9111, section 4.2.2) would store a 404.
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if let Some(seconds) = kind.retry_after() {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static(seconds));
        }
        match kind {
            // RFC 9110, sections 11.6.1 and 15.5.22: these statuses require a header that names
            // what is accepted.
            ProblemKind::Unauthorised => {
                headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            }
            ProblemKind::NotAnUpgrade => {
                headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
                headers.insert(header::CONNECTION, HeaderValue::from_static("upgrade"));
            }
            _ => {}
        }
        // For the metrics.
        response.extensions_mut().insert(kind);
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_have_unique_names_and_their_index() {
        for (index, kind) in ProblemKind::ALL.into_iter().enumerate() {
            assert_eq!(kind.index(), index);
            assert_eq!(ProblemKind::ALL.iter().filter(|other| other.name() == kind.name()).count(), 1);
            assert!(kind.status().is_client_error() || kind.status().is_server_error());
            let is_temporary =
                [StatusCode::SERVICE_UNAVAILABLE, StatusCode::TOO_MANY_REQUESTS].contains(&kind.status());
            assert_eq!(kind.retry_after().is_some(), is_temporary, "{}", kind.name());
        }
    }
}
