//! The server process, and moving clients.

use futures_util::{SinkExt, StreamExt};
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::view::View;
use protocol::{DataFrame, Delivery, SUBPROTOCOL};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// Chunks that a moving client remembers.
const HELD: usize = 1200;

/// A running `tombolo-server`; killed when dropped.
pub struct Program {
    child: Child,
    /// `ADDR:PORT`.
    pub address: String,
}

impl Program {
    pub fn start(address: &str, arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tombolo-server"));
        // The developer's environment must not affect a test.
        for (variable, _) in
            std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("TOMBOLO_"))
        {
            command.env_remove(variable);
        }
        // The page is tested, not load shedding: an unoptimised server on a busy machine is slow.
        command.args(["--listen", address, "--log", "warn", "--deadline-ms", "60000"]).args(arguments);
        let mut child =
            command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().expect("the server starts");
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").expect("an address").to_owned();
        Self { child, address }
    }

    pub fn page(&self) -> String {
        format!("http://{}/", self.address)
    }

    pub fn stream(&self) -> String {
        format!("ws://{}/v1/stream", self.address)
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A session whose view moves whenever it is settled; ends when dropped.
pub struct MovingClient {
    /// Number of the session.
    pub session: u64,
    task: JoinHandle<()>,
}

impl MovingClient {
    /// Connects at a position in metres with a heading, and moves `pace_m` metres per step along a
    /// wide circle.
    pub async fn start(server: &Program, [x_m, z_m]: [i32; 2], yaw_mdeg: i32, pace_m: i32) -> Self {
        let mut request = server.stream().into_client_request().unwrap();
        request.headers_mut().insert("Sec-WebSocket-Protocol", SUBPROTOCOL.parse().unwrap());
        let (mut socket, _) = connect_async(request).await.unwrap();
        let config = ClientConfig {
            digest: None,
            delivery: Delivery::Exact,
            token: None,
            software: "moving client".into(),
            window: 64,
        };
        let mut session = ClientSession::new(config);
        let mut view = View {
            eye: [x_m * 256, 150 * 256, z_m * 256],
            yaw_mdeg,
            pitch_mdeg: -5000,
            viewport: [1280, 720],
            tolerance_q4: 32,
            ..test_support::view(1, 2500)
        };
        let Some(Event::Welcome(welcome)) = step(&mut socket, &mut session).await else {
            panic!("no welcome")
        };
        session.set_view(view);
        let task = tokio::spawn(async move {
            let mut held = VecDeque::new();
            while let Some(event) = step(&mut socket, &mut session).await {
                if let Event::Chunk { chunk, .. } = &event {
                    held.push_back(chunk.key);
                }
                if !matches!(event, Event::Settled(_)) {
                    continue;
                }
                // A rate of steps far below a load test.
                tokio::time::sleep(Duration::from_millis(150)).await;
                let heading = (f64::from(view.yaw_mdeg) / 1000.0).to_radians();
                let pace = f64::from(pace_m * 256);
                view.id += 1;
                view.eye[0] += (heading.sin() * pace) as i32;
                view.eye[2] -= (heading.cos() * pace) as i32;
                view.yaw_mdeg += if pace_m == 0 { 0 } else { 2000 };
                // A small cache, so that a moving client always needs chunks.
                if held.len() > HELD {
                    session.release(&held.drain(..held.len() - HELD).collect::<Vec<_>>());
                }
                session.set_view(view);
            }
        });
        Self { session: welcome.session, task }
    }
}

impl Drop for MovingClient {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Sends pending messages and receives the next event; none after the end of the connection.
async fn step(
    socket: &mut WebSocketStream<MaybeTlsStream<TcpStream>>,
    session: &mut ClientSession,
) -> Option<Event> {
    while let Some(frame) = session.poll_transmit() {
        socket.send(Message::Binary(frame)).await.ok()?;
    }
    loop {
        match socket.next().await?.ok()? {
            Message::Binary(frame) => return session.receive(DataFrame::Binary(&frame)).ok(),
            Message::Close(_) => return None,
            // The library answers pings on the next write.
            _ => {}
        }
    }
}
