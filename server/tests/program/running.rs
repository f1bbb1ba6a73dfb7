//! A running program.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Timeout of every wait.
pub const TEST_TIMEOUT: Duration = Duration::from_secs(30);

/// The lines of a log about peers that break rules, with the events that each stands for.
pub fn peer_lines(log: &str) -> Vec<(&str, u64)> {
    let lines = log.lines().filter(|line| line.contains("peer breaks the rules"));
    let events = |line: &str| line.rsplit_once("events=").unwrap().1.trim().parse::<u64>().unwrap();
    lines.map(|line| (line, events(line))).collect()
}

pub fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tombolo-server"));
    // The environment of a developer must not change a test.
    for (variable, _) in std::env::vars_os() {
        if variable.to_string_lossy().starts_with("TOMBOLO_") {
            command.env_remove(variable);
        }
    }
    command
}

/// A running server, killed when dropped.
pub struct Server {
    pub child: Child,
    /// What it printed before its address.
    pub scheme: String,
    pub address: String,
}

impl Server {
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_with(arguments, &[])
    }

    /// With variables in its environment.
    pub fn start_with(arguments: &[&str], variables: &[(&str, &str)]) -> Self {
        let mut child = program()
            .args(["--threads", "1", "--log", "warn"])
            .args(arguments)
            .envs(variables.iter().copied())
            // As a service: a terminal's end would end it.
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let (scheme, address) = line.trim().strip_prefix("listening on ").unwrap().split_once("://").unwrap();
        Self { scheme: scheme.into(), address: address.into(), child }
    }

    /// Ends it; what it logged to its end. As a service manager does, where there are signals: a
    /// process that is killed loses lines that wait to be written.
    pub fn log(mut self) -> String {
        #[cfg(unix)]
        {
            let id = self.child.id().to_string();
            assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
        }
        #[cfg(not(unix))]
        self.child.kill().unwrap();
        let mut log = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut log).unwrap();
        log
    }

    /// The status of `/v1/live` with a token.
    pub fn live(&self, token: &str) -> u16 {
        self.get("/v1/live", token).split(' ').nth(1).unwrap().parse().unwrap()
    }

    /// The status of a request for a session with a token.
    pub fn upgrade(&self, token: &str) -> u16 {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
        write!(
            stream,
            "GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\n\
             Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\
             Sec-WebSocket-Protocol: tombolo.v1\r\nAuthorization: Bearer {token}\r\n\r\n"
        )
        .unwrap();
        let mut status = String::new();
        BufReader::new(stream).read_line(&mut status).unwrap();
        status.split(' ').nth(1).unwrap().parse().unwrap()
    }

    /// The response to a GET with a token.
    pub fn get(&self, path: &str, token: &str) -> String {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\
             Authorization: Bearer {token}\r\n\r\n"
        )
        .unwrap();
        let mut reply = Vec::new();
        stream.read_to_end(&mut reply).unwrap();
        // Frames are no text.
        String::from_utf8_lossy(&reply).into_owned()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
