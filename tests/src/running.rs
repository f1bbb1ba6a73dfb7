//! A server in this process, on a free port, stopped when dropped.

use server::ServerConfig;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// A server that listens on a loopback port of its own.
pub struct RunningServer {
    /// The listen address.
    pub address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    task: JoinHandle<()>,
}

/// The defaults with one generation thread and short timeouts, so that timeout suites end soon.
#[must_use]
pub fn quick_config() -> ServerConfig {
    ServerConfig {
        threads: 1,
        handshake_timeout: Duration::from_millis(600),
        write_timeout: Duration::from_millis(1500),
        drain_timeout: Duration::from_secs(5),
        ..ServerConfig::default()
    }
}

impl RunningServer {
    /// Starts a server with [`quick_config`].
    pub async fn start() -> Self {
        Self::start_with(quick_config()).await
    }

    /// Starts a server on a free port.
    pub async fn start_with(config: ServerConfig) -> Self {
        Self::start_at(SocketAddr::from(([127, 0, 0, 1], 0)), config).await
    }

    /// Starts a server at an address, for suites that restart one.
    pub async fn start_at(address: SocketAddr, config: ServerConfig) -> Self {
        let listener = TcpListener::bind(address).await.expect("a loopback port is free");
        let address = listener.local_addr().expect("a bound listener has an address");
        let (stop, stopped) = oneshot::channel::<()>();
        let task = tokio::spawn(async move {
            let shutdown = async {
                // A dropped sender stops the server as well.
                let _ = stopped.await;
            };
            server::run(listener, config, shutdown).await.expect("generation threads start");
        });
        Self { address, stop: Some(stop), task }
    }

    /// The WebSocket URL of the stream endpoint.
    #[must_use]
    pub fn stream_url(&self) -> String {
        format!("ws://{}/v1/stream", self.address)
    }

    /// The HTTP URL of a path.
    #[must_use]
    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    /// Drains the server and waits for its end.
    pub async fn stop(mut self) {
        drop(self.stop.take());
        (&mut self.task).await.expect("the server ends without a panic");
    }
}
