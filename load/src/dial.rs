//! How a connection comes about: the one seam between the clients and the network, so that tests
//! can put a pipe in its place.

use std::future::Future;
use std::io;
use std::net::SocketAddr;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpSocket, TcpStream, lookup_host};
use tokio_tungstenite::tungstenite::http::Uri;

/// Port where an address names none.
const HTTP_PORT: u16 = 80;

/// Opens connections to one server.
pub trait Dial: Send + Sync + 'static {
    /// A connection.
    type Stream: AsyncRead + AsyncWrite + Send + Unpin + 'static;

    /// Opens one. `receive_buffer`, bytes, bounds what the system takes in for a reader who does
    /// not read; none leaves it to it.
    fn dial(&self, receive_buffer: Option<u32>) -> impl Future<Output = io::Result<Self::Stream>> + Send;
}

/// TCP to the host and port of an address.
#[derive(Clone, Debug)]
pub struct Tcp {
    host: String,
    port: u16,
}

impl Tcp {
    /// To the host of a checked address.
    #[must_use]
    pub fn to(address: &Uri) -> Self {
        // Brackets are how an address with colons stands in a URL, not how it is looked up.
        let host = address.host().unwrap_or_default().trim_matches(['[', ']']).to_owned();
        Self { host, port: address.port_u16().unwrap_or(HTTP_PORT) }
    }
}

impl Dial for Tcp {
    type Stream = TcpStream;

    async fn dial(&self, receive_buffer: Option<u32>) -> io::Result<TcpStream> {
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

async fn connect(address: SocketAddr, receive_buffer: Option<u32>) -> io::Result<TcpStream> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    if let Some(bytes) = receive_buffer {
        // Before the connection: the window is agreed on with it.
        socket.set_recv_buffer_size(bytes)?;
    }
    let stream = socket.connect(address).await?;
    // Requests are small and timed; Nagle would hold them back.
    stream.set_nodelay(true)?;
    Ok(stream)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn host_and_port_are_those_of_the_address() {
        for (address, host, port) in
            [("ws://[::1]:7/v1/stream", "::1", 7), ("ws://example.org/v1/stream", "example.org", 80)]
        {
            let tcp = Tcp::to(&address.parse().unwrap());
            assert_eq!((tcp.host.as_str(), tcp.port), (host, port));
        }
    }
}
