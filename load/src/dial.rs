//! Opens connections: the only interface between clients and network, which tests replace with
//! pipes in memory.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use tls_client::{TlsClient, Transport, endpoint};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpSocket, TcpStream, lookup_host};
use tokio_tungstenite::tungstenite::http::Uri;
use tokio_util::either::Either;

/// Opens connections to one server.
pub trait Dial: Send + Sync + 'static {
    /// A connection.
    type Stream: AsyncRead + AsyncWrite + Send + Unpin + 'static;

    /// Opens a connection. `receive_buffer` is the size of the system's receive buffer, bytes; none
    /// is the system's default.
    fn dial(&self, receive_buffer: Option<u32>) -> impl Future<Output = io::Result<Self::Stream>> + Send;
}

/// TCP, or TLS over it, to the host and port of an address.
#[derive(Clone, Debug)]
pub struct Network {
    host: String,
    port: u16,
    tls: Option<TlsClient>,
}

impl Network {
    /// To the host of a checked address, over TLS if a client for it is given.
    #[must_use]
    pub fn to(address: &Uri, tls: Option<TlsClient>) -> Self {
        let (host, port) = endpoint(address.host(), address.port_u16(), tls.is_some());
        Self { host: host.to_owned(), port, tls }
    }

    async fn tcp(&self, receive_buffer: Option<u32>) -> io::Result<TcpStream> {
        let mut last = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
        for address in lookup_host((self.host.as_str(), self.port)).await? {
            match connect(address, receive_buffer).await {
                Ok(stream) => return Ok(stream),
                Err(error) => last = error,
            }
        }
        Err(last)
    }
}

impl Dial for Network {
    type Stream = Transport;

    async fn dial(&self, receive_buffer: Option<u32>) -> io::Result<Transport> {
        let stream = self.tcp(receive_buffer).await?;
        match &self.tls {
            Some(tls) => tls.connect(&self.host, stream).await,
            None => Ok(Either::Left(stream)),
        }
    }
}

async fn connect(address: SocketAddr, receive_buffer: Option<u32>) -> io::Result<TcpStream> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    if let Some(bytes) = receive_buffer {
        // Before connecting, which negotiates the window.
        socket.set_recv_buffer_size(bytes)?;
    }
    let stream = socket.connect(address).await?;
    // Requests are small and timed; Nagle's algorithm would delay them.
    stream.set_nodelay(true)?;
    Ok(stream)
}
