//! An echo server built from the WebSocket layer, for the test suites of others:
//!
//!     cargo run --example echo -- 127.0.0.1:9001
//!     wstest --mode fuzzingclient --spec SPEC.json
//!
//! with a `SPEC.json` whose server is `ws://127.0.0.1:9001`. `wstest` is Autobahn|Testsuite; the
//! cases of its sections 12 and 13 need compression, which this layer does not have. With the
//! option `--planted-fault` behind the address pongs lack the first byte of their pings, which a
//! suite must find.

// The same echo as that of the conformance suite.
#[path = "../tests/websocket/echo.rs"]
mod echo;
#[path = "../tests/websocket/echo_server.rs"]
mod echo_server;

use std::io;
use tokio::net::TcpListener;

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
    echo_server::run(TcpListener::bind(&address).await?, pong).await
}
