//! The opening handshake of RFC 6455, section 4.2.
//!
//! A request that is no valid handshake is rejected with one sentence before the upgrade.

use crate::limits::write_timeout::WriteTimeoutStream;
use crate::tls::PeerStream;
use crate::websocket::socket::WebSocket;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Version, header};
use axum::response::{IntoResponse, Response};
use data_encoding::BASE64;
use hyper::upgrade::{OnUpgrade, Upgraded};
use hyper_util::rt::TokioIo;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;

/// The version of WebSocket that this server speaks.
pub const VERSION: HeaderValue = HeaderValue::from_static("13");

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
        if request.version() < Version::HTTP_11 {
            return Err((StatusCode::UPGRADE_REQUIRED, "a session begins with HTTP/1.1"));
        }
        // RFC 9112, section 3.2.
        if single(headers, &header::HOST).is_none() {
            return Err((StatusCode::BAD_REQUEST, "a request has exactly one `Host`"));
        }
        if single(headers, &header::SEC_WEBSOCKET_VERSION).is_none_or(|version| version != VERSION) {
            return Err((StatusCode::BAD_REQUEST, "`Sec-WebSocket-Version` must be 13"));
        }
        let accept = match single(headers, &header::SEC_WEBSOCKET_KEY) {
            Some(key) if is_valid_key(key) => derive_accept_key(key.as_bytes()),
            _ => return Err((StatusCode::BAD_REQUEST, "`Sec-WebSocket-Key` must be 16 bytes in base64")),
        };
        let on_upgrade = request.extensions_mut().remove::<OnUpgrade>().ok_or((
            StatusCode::UPGRADE_REQUIRED,
            "this connection cannot be upgraded: use HTTP/1.1 and a proxy that forwards upgrades",
        ))?;
        Ok(Self { accept, on_upgrade })
    }

    /// The response that switches protocols, with the selected subprotocol.
    #[must_use]
    pub fn response(&self, subprotocol: Option<&'static str>) -> Response {
        let mut response = StatusCode::SWITCHING_PROTOCOLS.into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONNECTION, HeaderValue::from_static("upgrade"));
        headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
        if let Some(name) = subprotocol {
            headers.insert(header::SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(name));
        }
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

/// The value of a header that a request must have exactly once.
fn single<'a>(headers: &'a HeaderMap, header: &header::HeaderName) -> Option<&'a HeaderValue> {
    let mut values = headers.get_all(header).iter();
    values.next().filter(|_| values.next().is_none())
}

/// Whether a key is 16 bytes in base64 (section 4.2.1). Its content is of no use to a server.
fn is_valid_key(key: &HeaderValue) -> bool {
    BASE64.decode(key.as_bytes()).is_ok_and(|bytes| bytes.len() == 16)
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
