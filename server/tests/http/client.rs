//! A server in this process, and requests written byte by byte, so that no client library corrects
//! them.

use server::ServerConfig;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;
use terrain::Land;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// Timeout of every wait.
pub const TEST_TIMEOUT: Duration = Duration::from_secs(30);

pub struct Server {
    pub address: SocketAddr,
    /// Stops the server when dropped.
    stop: oneshot::Sender<()>,
    running: JoinHandle<()>,
}

/// A response.
#[derive(Debug)]
pub struct Reply {
    pub status: u16,
    headers: BTreeMap<String, String>,
    pub body: Vec<u8>,
}

impl Server {
    pub async fn start() -> Self {
        Self::start_with(ServerConfig { threads: 2, ..ServerConfig::default() }).await
    }

    pub async fn start_with(config: ServerConfig) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel::<()>();
        let running = tokio::spawn(async move {
            let stopped = async {
                let _ = stopped.await;
            };
            server::run(listener, config, stopped).await.unwrap();
        });
        Self { address, stop, running }
    }

    /// Stops the server and waits for its end.
    pub async fn stop(self) {
        drop(self.stop);
        tokio::time::timeout(TEST_TIMEOUT, self.running).await.expect("the server ends in time").unwrap();
    }

    /// The value of a counter or gauge in `/metrics`; its labels are part of the name.
    pub async fn metric(&self, name: &str) -> f64 {
        let text = String::from_utf8(self.get("/metrics").await.body).unwrap();
        let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        line.unwrap_or_else(|| panic!("{name} is not in {text}")).parse().unwrap()
    }

    /// The path of a resource of this server's world, such as `chunk/0/0/0`.
    pub fn path(&self, rest: &str) -> String {
        format!("/v1/{}/{rest}", Land::new(1).digest())
    }

    pub async fn get(&self, path: &str) -> Reply {
        self.request("GET", path, &[]).await
    }

    pub async fn request(&self, method: &str, path: &str, headers: &[(&str, &str)]) -> Reply {
        let stream = TcpStream::connect(self.address).await.unwrap();
        request_over(stream, method, path, headers).await
    }
}

/// One request over a new connection, read to the end of the connection or, for an upgrade, of the
/// head.
async fn request_over(mut stream: TcpStream, method: &str, path: &str, headers: &[(&str, &str)]) -> Reply {
    let mut request = format!("{method} {path} HTTP/1.1\r\nHost: test\r\n");
    if !headers.iter().any(|(name, _)| name.eq_ignore_ascii_case("connection")) {
        request += "Connection: close\r\n";
    }
    for (name, value) in headers {
        request += &format!("{name}: {value}\r\n");
    }
    request += "\r\n";
    stream.write_all(request.as_bytes()).await.unwrap();
    let read = async {
        let mut bytes = Vec::new();
        while stream.read_buf(&mut bytes).await.unwrap() > 0 {
            if bytes.starts_with(b"HTTP/1.1 101") && bytes.ends_with(b"\r\n\r\n") {
                break;
            }
        }
        bytes
    };
    let bytes = tokio::time::timeout(TEST_TIMEOUT, read).await.expect("the server answers in time");
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("a whole head");
    let head = std::str::from_utf8(&bytes[..end]).unwrap();
    let mut lines = head.lines();
    let status = lines.next().unwrap().split(' ').nth(1).unwrap().parse().unwrap();
    let headers = lines
        .map(|line| line.split_once(": ").unwrap())
        .map(|(name, value)| (name.to_ascii_lowercase(), value.to_owned()))
        .collect();
    Reply { status, headers, body: bytes[end + 4..].to_vec() }
}

impl Reply {
    /// A header; empty if it is missing.
    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", String::as_str)
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap()
    }

    /// The kind of a valid problem document.
    pub fn problem(&self) -> String {
        assert_eq!(self.header("content-type"), "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["status"], self.status);
        assert!(["title", "detail"].iter().all(|part| !problem[part].as_str().unwrap().is_empty()));
        let kind = problem["type"].as_str().unwrap();
        kind.strip_prefix("/openapi.json#/components/examples/").unwrap().to_owned()
    }
}
