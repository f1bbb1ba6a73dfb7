//! Requests to a program that ends: `SIGTERM` to the real program while a session is open.

use crate::client::{Received, Session, TEST_TIMEOUT, get_over, in_time, read_all, upgrade_request};
use protocol::CloseCode;
use protocol::message::ServerMessage;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

/// A running program, killed when dropped.
struct Program {
    child: Child,
    address: String,
}

impl Program {
    fn start() -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tombolo-server"));
        // The environment of a developer must not change a test.
        for (variable, _) in std::env::vars_os() {
            if variable.to_string_lossy().starts_with("TOMBOLO_") {
                command.env_remove(variable);
            }
        }
        let mut child = command
            .args(["--threads", "1", "--log", "error", "--listen", "127.0.0.1:0"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").unwrap().to_owned();
        Self { child, address }
    }

    async fn connect(&self) -> TcpStream {
        TcpStream::connect(&self.address).await.unwrap()
    }

    /// A connection whose head lacks its last line, and the rest.
    async fn begin(&self, head: &str) -> (TcpStream, String) {
        let (begun, rest) = head.split_at(head.len() - 2);
        let mut stream = self.connect().await;
        stream.write_all(begun.as_bytes()).await.unwrap();
        (stream, rest.to_owned())
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[tokio::test]
async fn a_program_that_ends_refuses_sessions_and_is_not_ready_while_one_is_open() {
    let mut program = Program::start();
    let mut session = Session::over(program.connect().await).await;
    let ready = "GET /readyz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let begun = [program.begin(ready).await, program.begin(&upgrade_request()).await];
    // The answer to a later connection shows that the server has the first ones.
    let reply = get_over(program.connect().await, "/readyz").await;
    assert!(reply.starts_with("HTTP/1.1 200 "), "the control: {reply}");

    let killed = Command::new("kill").args(["-TERM", &program.child.id().to_string()]).status();
    assert!(killed.unwrap().success());
    let draining = session.receive().await;
    assert!(matches!(draining, Received::Message(ServerMessage::Draining { .. })), "{draining:?}");
    assert_eq!(session.receive().await, Received::Close(CloseCode::GoingAway.code()));
    // The Close frame is not answered: the session is open.
    in_time(async { while TcpStream::connect(&program.address).await.is_ok() {} }).await;
    let mut replies = Vec::new();
    for (mut stream, rest) in begun {
        stream.write_all(rest.as_bytes()).await.unwrap();
        replies.push(String::from_utf8_lossy(&read_all(&mut stream).await).into_owned());
    }
    let [not_ready, refused] = &replies[..] else { unreachable!("two requests") };
    assert!(not_ready.starts_with("HTTP/1.1 503 ") && not_ready.ends_with("draining\n"), "{not_ready}");
    assert!(refused.starts_with("HTTP/1.1 503 ") && refused.contains("/no-session"), "{refused}");
    assert!(refused.to_ascii_lowercase().contains("\r\nretry-after: "), "{refused}");

    drop(session);
    let started = Instant::now();
    let status = loop {
        if let Some(status) = program.child.try_wait().unwrap() {
            break status;
        }
        assert!(started.elapsed() < TEST_TIMEOUT, "it does not end");
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    assert!(status.success(), "{status}");
}
