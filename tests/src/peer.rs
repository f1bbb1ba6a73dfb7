//! WebSocket clients for suites: raw frames, or the session machine.

use futures_util::{SinkExt, StreamExt};
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::view::View;
use protocol::{DataFrame, Delivery, SUBPROTOCOL};
use std::time::Duration;
pub use test_support::view;
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::CloseFrame;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// Longest wait for a frame; a suite that reaches it fails.
const RECEIVE_TIMEOUT: Duration = Duration::from_secs(20);

/// A raw connection to a server.
pub struct Peer {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
}

impl Peer {
    /// Connects with the right subprotocol.
    pub async fn connect(url: &str) -> Self {
        Self::try_connect(url, Some(SUBPROTOCOL)).await.expect("the server accepts")
    }

    /// Connects with a given subprotocol, or none.
    ///
    /// # Errors
    /// The handshake failed; the error holds the HTTP response, if any.
    pub async fn try_connect(url: &str, subprotocol: Option<&str>) -> Result<Self, Box<Error>> {
        let mut request = url.into_client_request()?;
        if let Some(name) = subprotocol {
            let name = name.parse().expect("a header value");
            request.headers_mut().insert("Sec-WebSocket-Protocol", name);
        }
        let (socket, _) = connect_async(request).await?;
        Ok(Self { socket })
    }

    /// Sends a message. The next receive reports a closed connection.
    pub async fn send(&mut self, message: Message) {
        let _ = self.socket.send(message).await;
    }

    /// Sends a binary frame.
    pub async fn send_bytes(&mut self, bytes: impl AsRef<[u8]>) {
        self.send(Message::Binary(bytes.as_ref().to_vec().into())).await;
    }

    /// The next binary frame, or the close frame that ended the connection (none if it broke
    /// without one).
    ///
    /// # Errors
    /// The connection ended.
    pub async fn receive(&mut self) -> Result<Vec<u8>, Option<CloseFrame>> {
        let next = async {
            loop {
                match self.socket.next().await {
                    Some(Ok(Message::Binary(bytes))) => return Ok(bytes.to_vec()),
                    Some(Ok(Message::Close(frame))) => return Err(frame),
                    Some(Ok(_)) => {}
                    Some(Err(_)) | None => return Err(None),
                }
            }
        };
        tokio::time::timeout(RECEIVE_TIMEOUT, next).await.expect("the server sends a frame in time")
    }

    /// Reads until the connection ends; returns the close code.
    pub async fn closed(&mut self) -> Option<u16> {
        loop {
            if let Err(frame) = self.receive().await {
                return frame.map(|frame| frame.code.into());
            }
        }
    }
}

/// A well-behaved client: the session machine over a [`Peer`].
pub struct TestClient {
    peer: Peer,
    /// The session, for direct use between two calls.
    pub session: ClientSession,
}

/// A client configuration: any world, exact delivery.
#[must_use]
pub fn client_config() -> ClientConfig {
    ClientConfig {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: "suite".into(),
        window: 64,
    }
}

impl TestClient {
    /// Connects and completes the handshake.
    pub async fn connect(url: &str) -> Self {
        Self::connect_as(url, client_config()).await
    }

    /// As [`TestClient::connect`], with a configuration.
    pub async fn connect_as(url: &str, config: ClientConfig) -> Self {
        let mut client = Self { peer: Peer::connect(url).await, session: ClientSession::new(config) };
        let welcome = client.event().await.expect("a welcome");
        assert!(matches!(welcome, Event::Welcome(_)), "{welcome:?}");
        client
    }

    /// Sends all waiting frames and returns the next event.
    ///
    /// # Errors
    /// The connection ended, with its close frame if there was one.
    pub async fn event(&mut self) -> Result<Event, Option<CloseFrame>> {
        self.flush().await;
        let frame = self.peer.receive().await?;
        Ok(self.session.receive(DataFrame::Binary(&frame)).expect("a correct server"))
    }

    /// Sends all waiting frames.
    pub async fn flush(&mut self) {
        while let Some(frame) = self.session.poll_transmit() {
            self.peer.send_bytes(&frame).await;
        }
    }

    /// Sets a view and collects all events until it is settled.
    pub async fn settle(&mut self, view: View) -> Vec<Event> {
        self.session.set_view(view);
        let mut events = Vec::new();
        loop {
            let event = self.event().await.expect("the session stays open");
            let done = matches!(event, Event::Settled(settled) if settled.view == view.id);
            events.push(event);
            if done {
                return events;
            }
        }
    }
}
