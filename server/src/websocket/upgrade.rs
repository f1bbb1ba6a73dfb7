//! The opening handshake of RFC 6455, section 4.2.
//!
//! A request that is no valid handshake is rejected with one sentence before the upgrade.

use crate::limits::write_timeout::WriteTimeoutStream;
use crate::tls::PeerStream;
use crate::websocket::socket::WebSocket;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::upgrade::{OnUpgrade, Upgraded};
use hyper_util::rt::TokioIo;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;

/// A valid handshake request.
pub struct Upgrade {
    accept: String,
    on_upgrade: OnUpgrade,
}

impl Upgrade {
    /// Checks a request.
    ///
    /// # Errors
    /// Why it is no valid handshake, with the status of the response.
    pub fn of(request: &mut Request) -> Result<Self, (StatusCode, &'static str)> {
        if request.method() != Method::GET {
            return Err((StatusCode::METHOD_NOT_ALLOWED, "a session begins with GET"));
        }
        let headers = request.headers();
        if !contains_token(headers, header::CONNECTION, "upgrade")
            || !contains_token(headers, header::UPGRADE, "websocket")
        {
            return Err((
                StatusCode::UPGRADE_REQUIRED,
                "this path accepts WebSocket sessions only: \
                 send `Connection: upgrade` and `Upgrade: websocket`",
            ));
        }
        if headers.get(header::SEC_WEBSOCKET_VERSION).is_none_or(|version| version != "13") {
            return Err((StatusCode::BAD_REQUEST, "`Sec-WebSocket-Version` must be 13"));
        }
        let accept = match headers.get(header::SEC_WEBSOCKET_KEY) {
            Some(key) => derive_accept_key(key.as_bytes()),
            None => return Err((StatusCode::BAD_REQUEST, "`Sec-WebSocket-Key` is missing")),
        };
        let on_upgrade = request.extensions_mut().remove::<OnUpgrade>().ok_or((
            StatusCode::UPGRADE_REQUIRED,
            "this connection cannot be upgraded: use HTTP/1.1 and a proxy that forwards upgrades",
        ))?;
        Ok(Self { accept, on_upgrade })
    }

    /// The response that switches protocols.
    #[must_use]
    pub fn response(&self, subprotocol: &'static str) -> Response {
        let mut response = StatusCode::SWITCHING_PROTOCOLS.into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONNECTION, HeaderValue::from_static("upgrade"));
        headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
        headers.insert(header::SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(subprotocol));
        // Base64 is always a header value.
        if let Ok(accept) = HeaderValue::from_str(&self.accept) {
            headers.insert(header::SEC_WEBSOCKET_ACCEPT, accept);
        }
        response
    }

    /// The WebSocket after the response is written; none if the connection failed before. Messages
    /// longer than `limit` bytes are rejected.
    pub async fn socket(self, limit: usize) -> Option<WebSocket<PeerStream>> {
        let upgraded: Upgraded = self.on_upgrade.await.ok()?;
        // The accept loop serves no other type of stream.
        let parts = upgraded.downcast::<TokioIo<WriteTimeoutStream<PeerStream>>>().ok()?;
        // Sessions have their own write deadline.
        Some(WebSocket::new(parts.io.into_inner().into_inner(), &parts.read_buf, limit))
    }
}

/// Whether a comma-separated header contains a token, in any case.
fn contains_token(headers: &HeaderMap, header: header::HeaderName, token: &str) -> bool {
    headers
        .get_all(header)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|item| item.trim().eq_ignore_ascii_case(token))
}
