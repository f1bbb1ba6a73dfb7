//! From an HTTP request to a WebSocket: RFC 6455, section 4.2.
//!
//! What it refuses: everything that is no such request, in one sentence, before the connection
//! changes hands.

use crate::patient::Patient;
use crate::socket::READ_LIMIT;
use crate::websocket::WebSocket;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::upgrade::{OnUpgrade, Upgraded};
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::handshake::derive_accept_key;

/// A request that may become a WebSocket.
pub struct Upgrade {
    accept: String,
    on_upgrade: OnUpgrade,
}

impl Upgrade {
    /// Judges a request.
    ///
    /// # Errors
    /// Why it is no WebSocket request, with the status to answer.
    pub fn of(request: &mut Request) -> Result<Self, (StatusCode, &'static str)> {
        if request.method() != Method::GET {
            return Err((StatusCode::METHOD_NOT_ALLOWED, "a session begins with GET"));
        }
        let headers = request.headers();
        if !names(headers, header::CONNECTION, "upgrade") || !names(headers, header::UPGRADE, "websocket") {
            return Err((
                StatusCode::UPGRADE_REQUIRED,
                "this is the door of WebSocket sessions: send `Connection: upgrade` and `Upgrade: websocket`",
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
            "this connection cannot become a WebSocket: use HTTP/1.1 without a proxy that ends it",
        ))?;
        Ok(Self { accept, on_upgrade })
    }

    /// The answer that makes a WebSocket of the connection.
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

    /// The connection, once the answer is written; none if it broke before.
    pub async fn socket(self) -> Option<WebSocket<TcpStream>> {
        let upgraded: Upgraded = self.on_upgrade.await.ok()?;
        // The accept loop gives hyper nothing else.
        let parts = upgraded.downcast::<TokioIo<Patient<TcpStream>>>().ok()?;
        // A session has deadlines of its own.
        Some(WebSocket::new(parts.io.into_inner().into_inner(), &parts.read_buf, READ_LIMIT))
    }
}

/// Whether a header that lists words names this one, in any case.
fn names(headers: &HeaderMap, header: header::HeaderName, word: &str) -> bool {
    headers
        .get_all(header)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|name| name.trim().eq_ignore_ascii_case(word))
}
