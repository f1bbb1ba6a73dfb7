//! The echo behind a handshake, over TCP. The example `echo` is this server.

use crate::echo;
use axum::body::Body;
use axum::extract::Request;
use axum::response::{IntoResponse, Response};
use axum::{Router, routing};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use server::limits::write_timeout::WriteTimeoutStream;
use server::tls::PeerStream;
use server::websocket::upgrade::Upgrade;
use std::io;
use std::time::Duration;
use tokio::net::TcpListener;
use tower::ServiceExt;

/// The largest message of Autobahn's section 9.
const LIMIT: usize = 16 << 20;

/// Serves every connection until an accept fails; `pong` as of [`echo::serve`].
pub async fn run(listener: TcpListener, pong: fn(&[u8]) -> &[u8]) -> io::Result<()> {
    let router: Router = Router::new().fallback(routing::any(move |request| stream(request, pong)));
    loop {
        let (connection, _) = listener.accept().await?;
        let router = router.clone();
        let service = service_fn(move |request: hyper::Request<Incoming>| {
            router.clone().oneshot(request.map(Body::new))
        });
        // The type of stream that an upgrade gives to its socket.
        let connection = WriteTimeoutStream::new(PeerStream::Left(connection), Duration::from_secs(10));
        tokio::spawn(
            http1::Builder::new().serve_connection(TokioIo::new(connection), service).with_upgrades(),
        );
    }
}

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
