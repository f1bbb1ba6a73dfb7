//! Traces of chunks, sent by the program to a collector: one client's over two replicas with one
//! store.

#![cfg(unix)]

use axum::Router;
use axum::body::Bytes;
use axum::routing::post;
use futures_util::{SinkExt, StreamExt};
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message as _;
use protocol::message::{ClientMessage, Hello, WireKey};
use protocol::{Delivery, SUBPROTOCOL, control};
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;
use terrain::Land;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

/// Timeout of every wait.
const TEST_TIMEOUT: Duration = Duration::from_secs(60);

/// The client's trace, its span in it, and both as a header.
const TRACE: &str = "0af7651916cd43dd8448eb211c80319c";
const CLIENT_SPAN: &str = "b7ad6b7169203331";
const TRACEPARENT: &str = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";

/// A span and the process that sent it.
struct ReceivedSpan {
    instance: String,
    span: Span,
}

impl ReceivedSpan {
    fn text(&self, name: &str) -> Option<String> {
        let value = self.span.attributes.iter().find(|attribute| attribute.key == name)?;
        Some(format!("{:?}", value.value.as_ref()?.value.as_ref()?))
    }

    fn has(&self, name: &str, text: &str) -> bool {
        self.text(name).is_some_and(|value| value.contains(&format!("{text:?}")))
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A collector: its address, and the bodies that it receives.
async fn collector() -> (SocketAddr, Receiver<Bytes>) {
    let (sender, receiver) = channel();
    let route = post(move |body: Bytes| {
        let sender = sender.clone();
        async move { sender.send(body).unwrap() }
    });
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(async move { axum::serve(listener, Router::new().route("/v1/traces", route)).await });
    (address, receiver)
}

/// All spans that were received.
fn spans(bodies: &Receiver<Bytes>) -> Vec<ReceivedSpan> {
    let mut seen = Vec::new();
    for body in bodies.try_iter() {
        for resource in ExportTraceServiceRequest::decode(body).unwrap().resource_spans {
            let attributes = resource.resource.unwrap().attributes;
            let instance = attributes.iter().find(|attribute| attribute.key == "service.instance.id");
            let instance = format!("{:?}", instance.unwrap().value);
            for span in resource.scope_spans.into_iter().flat_map(|scope| scope.spans) {
                seen.push(ReceivedSpan { instance: instance.clone(), span });
            }
        }
    }
    seen
}

/// A running program.
struct Server {
    child: Child,
    address: String,
}

impl Server {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tombolo-server"));
        for (variable, _) in std::env::vars_os() {
            // The environment of a developer must not change a test.
            let name = variable.to_string_lossy().to_ascii_uppercase();
            if ["TOMBOLO_", "OTEL_"].iter().any(|start| name.starts_with(start)) || name.ends_with("_PROXY") {
                command.env_remove(variable);
            }
        }
        command.args(["--listen", "127.0.0.1:0", "--threads", "1"]).args(arguments);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").unwrap().to_owned();
        Self { child, address }
    }

    /// Requests a path for a host name, with a further header; the status.
    fn get(&self, path: &str, host: &str, header: &str) -> u16 {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\n{header}Connection: close\r\n\r\n").unwrap();
        let mut reply = Vec::new();
        stream.read_to_end(&mut reply).unwrap();
        let line = String::from_utf8_lossy(&reply[..reply.len().min(16)]).into_owned();
        line.split(' ').nth(1).unwrap().parse().unwrap()
    }

    /// Requests a chunk by HTTP.
    fn chunk(&self, (level, x, z): (u8, i32, i32), header: &str) {
        let path = format!("/v1/{}/chunk/{level}/{x}/{z}", Land::new(1).digest());
        assert_eq!(self.get(&path, "localhost", header), 200);
    }

    /// Requests chunks by a session with a trace, and waits for them.
    async fn session(&self, keys: Vec<WireKey>) {
        tokio::time::timeout(TEST_TIMEOUT, self.run_session(keys)).await.unwrap();
    }

    async fn run_session(&self, keys: Vec<WireKey>) {
        let mut request = format!("ws://{}/v1/stream", self.address).into_client_request().unwrap();
        request.headers_mut().insert("sec-websocket-protocol", SUBPROTOCOL.parse().unwrap());
        request.headers_mut().insert("traceparent", TRACEPARENT.parse().unwrap());
        let (mut socket, _) = tokio_tungstenite::connect_async(request).await.unwrap();
        let hello = Hello { digest: None, delivery: Delivery::Exact, token: None, software: "test".into() };
        let count = keys.len() as u32;
        for message in [
            ClientMessage::Hello(hello),
            ClientMessage::Credit { chunks: count },
            ClientMessage::Request { id: 1, keys },
        ] {
            let bytes = control::encode(&message).unwrap();
            socket.send(Message::Binary(bytes)).await.unwrap();
        }
        // Control messages are shorter.
        let is_chunk = |message: &Message| message.is_binary() && message.len() > 500;
        for _ in 0..count {
            while !is_chunk(&socket.next().await.unwrap().unwrap()) {}
        }
        socket.close(None).await.unwrap();
    }

    /// Ends it as an operator does, when it sends what is left; its log.
    fn stop(mut self) -> String {
        let killed = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        let mut log = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut log).unwrap();
        assert!(self.child.wait().unwrap().success(), "{log}");
        log
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trace_follows_a_chunk_over_two_replicas() {
    let (collector, bodies) = collector().await;
    let folder = std::env::temp_dir().join(format!("tombolo-traces-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let endpoint = format!("http://{collector}/v1/traces");
    let options = [
        &["--otlp", &endpoint, "--trace-every", "0"][..],
        &["--store", folder.to_str().unwrap(), "--store-wait-ms", "10000"],
    ]
    .concat();
    let key = (5, 0, 0);
    let traced = format!("traceparent: {TRACEPARENT}\r\n");
    for _ in 0..2 {
        let server = Server::start(&options);
        // The control: a request without a trace.
        server.chunk((4, 1, 1), "");
        server.chunk(key, &traced);
        server.session(vec![WireKey { level: 6, x: 0, z: 0 }]).await;
        server.stop();
    }
    std::fs::remove_dir_all(&folder).unwrap();

    let seen = spans(&bodies);
    assert!(seen.iter().all(|seen| hex(&seen.span.trace_id) == TRACE), "one trace");
    let chunks: Vec<_> = seen.iter().filter(|seen| seen.span.name == "chunk").collect();
    let names: Vec<_> = chunks.iter().map(|chunk| (&chunk.instance, chunk.text("chunk"))).collect();
    assert_eq!(chunks.len(), 4, "each replica has one of each kind of request: {names:?}");
    assert!(chunks.iter().all(|chunk| hex(&chunk.span.parent_span_id) == CLIENT_SPAN));
    let instances: BTreeSet<_> = chunks.iter().map(|chunk| &chunk.instance).collect();
    assert_eq!(instances.len(), 2);
    let parts = |chunk: &ReceivedSpan| -> BTreeSet<&str> {
        let of_chunk = |seen: &&ReceivedSpan| seen.span.parent_span_id == chunk.span.span_id;
        seen.iter().filter(of_chunk).map(|seen| seen.span.name.as_str()).collect()
    };
    for chunk in chunks {
        let parts = parts(chunk);
        let (is_made, is_stored) = (chunk.has("origin", "made"), chunk.has("origin", "store"));
        assert!(is_made != is_stored, "{:?}", chunk.text("origin"));
        assert_eq!(parts.contains("generate"), is_made, "{parts:?}");
        assert_eq!(parts.contains("encode"), is_made, "{parts:?}");
        assert!(parts.contains("store") && parts.contains("queue"), "{parts:?}");
        assert!(chunk.has("outcome", "sent"), "{:?}", chunk.text("outcome"));
        let is_session = chunk.text("chunk").unwrap().contains("6/");
        assert_eq!(parts.contains("write"), is_session, "{parts:?}");
        let (start, end) = (chunk.span.start_time_unix_nano, chunk.span.end_time_unix_nano);
        for part in seen.iter().filter(|seen| seen.span.parent_span_id == chunk.span.span_id) {
            assert!(part.span.start_time_unix_nano >= start && part.span.end_time_unix_nano <= end);
        }
    }
    let made = seen.iter().filter(|seen| seen.has("origin", "made")).count();
    assert_eq!(made, 2, "what the first replica made the second reads");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_chunk_of_many_is_traced_without_a_header() {
    let (collector, bodies) = collector().await;
    // Without a path it is that of OTLP.
    let server = Server::start(&["--otlp", &format!("http://{collector}"), "--trace-every", "4"]);
    for x in 0..8 {
        server.chunk((0, x, 0), "");
    }
    server.stop();
    let chunks = spans(&bodies).into_iter().filter(|seen| seen.span.name == "chunk").count();
    assert_eq!(chunks, 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_serves_and_ends_beside_a_collector_that_does_not_answer() {
    // Connections are accepted by the system, and nothing reads them.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("http://{}/v1/traces", silent.local_addr().unwrap());
    let server = Server::start(&["--otlp", &endpoint, "--trace-every", "1"]);
    for x in 0..8 {
        server.chunk((0, x, 0), "");
    }
    let log = server.stop();
    // By whichever limit comes first: that of the last export, or that of the end.
    assert!(log.contains("not exported") || log.contains("telemetry data will be lost"), "{log}");
}

/// Spans of traces must not keep log lines from the log: with a collector and without.
#[tokio::test(flavor = "multi_thread")]
async fn the_default_log_has_all_its_lines_after_traced_chunks() {
    let (collector, _bodies) = collector().await;
    let endpoint = format!("http://{collector}/v1/traces");
    for options in [&[][..], &["--otlp", &endpoint, "--trace-every", "1"]] {
        let server = Server::start(options);
        for x in 0..8 {
            server.chunk((0, x, 0), "");
        }
        assert_eq!(server.get("/v1/world", "rebound.example", ""), 421);
        let log = server.stop();
        assert!(log.contains("unknown host name"), "{options:?}: {log}");
        assert!(!log.contains("tombolo_trace") && !log.contains("generate"), "{options:?}: {log}");
    }
}
