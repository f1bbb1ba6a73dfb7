//! Refusals: a closed list of kinds, told as RFC 9457 problem documents and counted by kind.
//!
//! The `type` of a problem is a reference into the OpenAPI document, where each kind has an example
//! under its name.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::json;

/// Why a request was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Nothing is served under this path.
    NoRoute,
    /// The path exists, but not for this method.
    WrongMethod,
    /// Numbers that are none, or a path that is no text.
    Malformed,
    /// No such chunk or place.
    OutsideWorld,
    /// The digest is another world's.
    WrongWorld,
    /// The token is missing or wrong.
    Unauthorised,
    /// `If-Match` names none of the representations.
    PreconditionFailed,
    /// Not a request that may become a WebSocket.
    NotAnUpgrade,
    /// An upgrade that breaks RFC 6455 or names no known subprotocol.
    BadHandshake,
    /// Chunks are asked for faster than they can be made.
    Overloaded,
    /// A chunk could not be made.
    Failed,
    /// Too many tiles of the map are asked for at once.
    MapBusy,
    /// Every session is taken, or the server drains.
    NoSession,
    /// The address has its share of sessions.
    AddressFull,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 14] = [
        Self::NoRoute,
        Self::WrongMethod,
        Self::Malformed,
        Self::OutsideWorld,
        Self::WrongWorld,
        Self::Unauthorised,
        Self::PreconditionFailed,
        Self::NotAnUpgrade,
        Self::BadHandshake,
        Self::Overloaded,
        Self::Failed,
        Self::MapBusy,
        Self::NoSession,
        Self::AddressFull,
    ];

    /// Its place in [`Kind::ALL`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// A short fixed name: the end of the problem's `type`, and the label in the metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NoRoute => "no-route",
            Self::WrongMethod => "wrong-method",
            Self::Malformed => "malformed",
            Self::OutsideWorld => "outside-world",
            Self::WrongWorld => "wrong-world",
            Self::Unauthorised => "unauthorised",
            Self::PreconditionFailed => "precondition-failed",
            Self::NotAnUpgrade => "not-an-upgrade",
            Self::BadHandshake => "bad-handshake",
            Self::Overloaded => "overloaded",
            Self::Failed => "failed",
            Self::MapBusy => "map-busy",
            Self::NoSession => "no-session",
            Self::AddressFull => "address-full",
        }
    }

    /// The same for people, without anything of the occasion.
    #[must_use]
    pub const fn title(self) -> &'static str {
        match self {
            Self::NoRoute => "No such route",
            Self::WrongMethod => "Method not allowed",
            Self::Malformed => "Malformed address",
            Self::OutsideWorld => "Outside the world",
            Self::WrongWorld => "Another world",
            Self::Unauthorised => "Token required",
            Self::PreconditionFailed => "Precondition failed",
            Self::NotAnUpgrade => "Not a WebSocket request",
            Self::BadHandshake => "Bad WebSocket handshake",
            Self::Overloaded => "Overloaded",
            Self::Failed => "Generation failed",
            Self::MapBusy => "Map is busy",
            Self::NoSession => "No free session",
            Self::AddressFull => "Too many sessions from this address",
        }
    }

    /// The status that it is told with.
    #[must_use]
    pub const fn status(self) -> StatusCode {
        match self {
            Self::NoRoute | Self::OutsideWorld | Self::WrongWorld => StatusCode::NOT_FOUND,
            Self::WrongMethod => StatusCode::METHOD_NOT_ALLOWED,
            Self::Malformed | Self::BadHandshake => StatusCode::BAD_REQUEST,
            Self::Unauthorised => StatusCode::UNAUTHORIZED,
            Self::PreconditionFailed => StatusCode::PRECONDITION_FAILED,
            Self::NotAnUpgrade => StatusCode::UPGRADE_REQUIRED,
            Self::Overloaded | Self::Failed | Self::MapBusy | Self::NoSession | Self::AddressFull => {
                StatusCode::SERVICE_UNAVAILABLE
            }
        }
    }

    /// Seconds after which it is worth trying again.
    const fn retry_after(self) -> Option<&'static str> {
        match self {
            Self::Overloaded | Self::Failed | Self::MapBusy => Some("1"),
            Self::NoSession | Self::AddressFull => Some("2"),
            _ => None,
        }
    }
}

/// A refusal with the sentence that tells this occasion.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Why.
    pub kind: Kind,
    /// One sentence: cause and mend.
    pub detail: String,
}

impl Problem {
    /// A refusal.
    #[must_use]
    pub fn new(kind: Kind, detail: impl Into<String>) -> Self {
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
        // A refusal is of the moment; heuristic caching (RFC 9111, section 4.2.2) would keep a 404.
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if let Some(seconds) = kind.retry_after() {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static(seconds));
        }
        match kind {
            // RFC 9110, sections 11.6.1 and 15.5.22: each of these statuses must say what would be
            // accepted.
            Kind::Unauthorised => {
                headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            }
            Kind::NotAnUpgrade => {
                headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
                headers.insert(header::CONNECTION, HeaderValue::from_static("upgrade"));
            }
            _ => {}
        }
        // For whoever counts.
        response.extensions_mut().insert(kind);
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_knows_its_place_and_no_two_share_a_name() {
        for (index, kind) in Kind::ALL.into_iter().enumerate() {
            assert_eq!(kind.index(), index);
            assert_eq!(Kind::ALL.iter().filter(|other| other.name() == kind.name()).count(), 1);
            assert!(kind.status().is_client_error() || kind.status().is_server_error());
            let is_temporary = kind.status() == StatusCode::SERVICE_UNAVAILABLE;
            assert_eq!(kind.retry_after().is_some(), is_temporary, "{}", kind.name());
        }
    }
}
