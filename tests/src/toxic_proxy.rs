//! A proxy in front of a server that behaves like a bad network.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;
use tokio::time::sleep;

/// Bytes that are read at once.
const SLICE: usize = 4096;

/// The behaviour of the network.
#[derive(Clone, Copy, Debug)]
pub enum Toxic {
    /// Nothing: the control.
    None,
    /// Every slice waits for this time, in both directions.
    Latency(Duration),
    /// This many bytes a second, in both directions.
    BytesPerSecond(usize),
    /// Every byte is written by itself, but for the first slice from the server: clients may take
    /// an answer to their upgrade in many packets for an attack, as tungstenite does.
    SingleBytes,
    /// The first connection ends after this many bytes from the server; later ones are good.
    CutAfter(usize),
    /// As [`Toxic::CutAfter`], with a reset.
    ResetAfter(usize),
    /// After this many bytes from the server nothing arrives any more, in either direction, and no
    /// connection ends.
    BlackHoleAfter(usize),
}

/// A running proxy, stopped when dropped.
pub struct ToxicProxy {
    /// Where it listens.
    pub address: SocketAddr,
    connections: Arc<AtomicUsize>,
    task: JoinHandle<()>,
}

impl ToxicProxy {
    /// Starts a proxy in front of a server.
    pub async fn start(server: SocketAddr, toxic: Toxic) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a loopback port is free");
        let address = listener.local_addr().expect("a bound listener has an address");
        let connections = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&connections);
        let task = tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let is_first = counted.fetch_add(1, Ordering::Relaxed) == 0;
                let toxic = match toxic {
                    Toxic::CutAfter(_) | Toxic::ResetAfter(_) if !is_first => Toxic::None,
                    other => other,
                };
                // A connection that fails is what the suite observes.
                tokio::spawn(async move { forward(client, server, toxic).await });
            }
        });
        Self { address, connections, task }
    }

    /// The WebSocket URL of the stream endpoint behind the proxy.
    #[must_use]
    pub fn stream_url(&self) -> String {
        format!("ws://{}/v1/stream", self.address)
    }

    /// Connections so far.
    #[must_use]
    pub fn connections(&self) -> usize {
        self.connections.load(Ordering::Relaxed)
    }
}

impl Drop for ToxicProxy {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn forward(client: TcpStream, server: SocketAddr, toxic: Toxic) -> std::io::Result<()> {
    let upstream = TcpStream::connect(server).await?;
    for stream in [&client, &upstream] {
        stream.set_nodelay(true)?;
    }
    if matches!(toxic, Toxic::ResetAfter(_)) {
        client.set_zero_linger()?;
        upstream.set_zero_linger()?;
    }
    let (from_client, to_client) = client.into_split();
    let (from_server, to_server) = upstream.into_split();
    let up = match toxic {
        Toxic::CutAfter(_) | Toxic::ResetAfter(_) => Toxic::None,
        other => other,
    };
    tokio::select! {
        ended = copy(from_server, to_client, toxic, SLICE) => ended,
        ended = copy(from_client, to_server, up, 0) => ended,
    }
}

/// Copies until the end of the stream, or until the toxic ends it. Of the first slice at most
/// `whole` bytes are never written one by one.
async fn copy(
    mut from: impl AsyncRead + Unpin,
    mut to: impl AsyncWrite + Unpin,
    toxic: Toxic,
    whole: usize,
) -> std::io::Result<()> {
    let (mut buffer, mut copied) = (vec![0; SLICE], 0);
    loop {
        let length = match from.read(&mut buffer).await? {
            // The end of the stream is lost, too.
            0 if matches!(toxic, Toxic::BlackHoleAfter(_)) => std::future::pending().await,
            0 => return Ok(()),
            length => length,
        };
        let bytes = &buffer[..length];
        match toxic {
            Toxic::None => to.write_all(bytes).await?,
            Toxic::Latency(latency) => {
                sleep(latency).await;
                to.write_all(bytes).await?;
            }
            Toxic::BytesPerSecond(rate) => {
                sleep(Duration::from_secs_f64(length as f64 / rate as f64)).await;
                to.write_all(bytes).await?;
            }
            Toxic::SingleBytes => {
                let (first, rest) = bytes.split_at(if copied == 0 { whole.min(length) } else { 0 });
                to.write_all(first).await?;
                for byte in rest {
                    to.write_all(&[*byte]).await?;
                    to.flush().await?;
                }
            }
            Toxic::CutAfter(limit) | Toxic::ResetAfter(limit) => {
                let rest = limit.saturating_sub(copied).min(length);
                to.write_all(&bytes[..rest]).await?;
                if copied + length > limit {
                    return Ok(());
                }
            }
            Toxic::BlackHoleAfter(limit) => {
                let rest = limit.saturating_sub(copied).min(length);
                to.write_all(&bytes[..rest]).await?;
            }
        }
        copied += length;
    }
}
