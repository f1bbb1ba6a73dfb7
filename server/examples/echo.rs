//! An echo server built from the WebSocket layer, for the test suites of others:
//!
//!     cargo run --example echo -- 127.0.0.1:9001
//!     wstest --mode fuzzingclient --spec SPEC.json
//!
//! with a `SPEC.json` whose server is `ws://127.0.0.1:9001`. `wstest` is Autobahn|Testsuite; the
//! cases of its sections 12 and 13 need compression, which this layer does not have. With the option
//! `--planted-fault` behind the address pongs lack the first byte of their pings, which a suite must
//! find.

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

async fn stream(mut request: Request, pong: fn(&[u8]) -> &[u8]) -> Response {
    match Upgrade::of(&mut request) {
        Ok(upgrade) => {
            let response = upgrade.response(None);
            tokio::spawn(async move {
                if let Some(socket) = upgrade.socket(LIMIT).await {
                    echo::serve(socket, pong).await;
                }
            });
            response
        }
        Err(rejection) => rejection.into_response(),
    }
}

#[tokio::main]
async fn main() -> io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments.next().unwrap_or_else(|| "127.0.0.1:9001".into());
    let pong: fn(&[u8]) -> &[u8] = match arguments.next().as_deref() {
        None => |ping| ping,
        Some("--planted-fault") => |ping| ping.get(1..).unwrap_or_default(),
        Some(other) => {
            let fault = format!("unknown option `{other}`; the only one is --planted-fault");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, fault));
        }
    };
    let listener = TcpListener::bind(&address).await?;
    let router: Router = Router::new().fallback(routing::any(move |request| stream(request, pong)));
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
