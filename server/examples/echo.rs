//! An echo server built from the WebSocket layer, for the test suites of others:
//!
//!     cargo run --example echo -- 127.0.0.1:9001
//!     wstest --mode fuzzingclient --spec SPEC.json
//!
//! with a `SPEC.json` whose server is `ws://127.0.0.1:9001`. `wstest` is Autobahn|Testsuite; the
//! cases of its sections 12 and 13 need compression, which this layer does not have.

// The same echo as that of the conformance suite.
#[path = "../tests/websocket/echo.rs"]
mod echo;

use axum::extract::Request;
use axum::response::{IntoResponse, Response};
use axum::{Router, routing};
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use server::limits::write_timeout::WriteTimeoutStream;
use server::websocket::upgrade::Upgrade;
use std::io;
use std::time::Duration;
use tokio::net::TcpListener;
use tower::ServiceExt;

/// The largest message of Autobahn's section 9.
const LIMIT: usize = 16 << 20;

async fn stream(mut request: Request) -> Response {
    match Upgrade::of(&mut request) {
        Ok(upgrade) => {
            let response = upgrade.response(None);
            tokio::spawn(async move {
                if let Some(socket) = upgrade.socket(LIMIT).await {
                    echo::serve(socket).await;
                }
            });
            response
        }
        Err(rejection) => rejection.into_response(),
    }
}

#[tokio::main]
async fn main() -> io::Result<()> {
    let address = std::env::args().nth(1).unwrap_or_else(|| "127.0.0.1:9001".into());
    let listener = TcpListener::bind(&address).await?;
    let router: Router = Router::new().fallback(routing::any(stream));
    loop {
        let (connection, _) = listener.accept().await?;
        let router = router.clone();
        let service = service_fn(move |request: hyper::Request<hyper::body::Incoming>| {
            router.clone().oneshot(request.map(axum::body::Body::new))
        });
        let io = TokioIo::new(WriteTimeoutStream::new(connection, Duration::from_secs(10)));
        tokio::spawn(
            hyper::server::conn::http1::Builder::new().serve_connection(io, service).with_upgrades(),
        );
    }
}
