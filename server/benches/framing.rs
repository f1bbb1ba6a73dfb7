//! Our WebSocket framing beside tokio-tungstenite's, over loopback, in interleaved rounds: CPU of
//! the serving thread for a message, bytes a second, and memory of a connection.
//!
//! One thread serves, another is the client, which reads bytes and makes no messages of them. The
//! CPU time is that of the serving thread alone, from `/proc/thread-self/schedstat`, so that a busy
//! machine disturbs it little. Linux only.
//!
//!     cargo bench -p tombolo-server --bench framing --profile dist -- --rounds 5 --seconds 2

use bars::Bar;
use bars::figures::{at, median, ratio};
use bytes::Bytes;
use clap::Parser;
use futures_util::{SinkExt, StreamExt};
use serde_json::{Map, Value, json};
use server::websocket::inbox::Message;
use server::websocket::socket::WebSocket;
use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::Builder;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message as TheirMessage;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};

/// As in the server: the allocator is part of what a connection takes.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Bytes of a message: the mean exact frame of a chunk with land, and a seed-only frame.
const SIZES: [(&str, usize); 2] = [("chunk", 3790), ("seed", 36)];

/// Messages between two flushes, as in a session.
const BATCH: usize = 64;

/// Connections at once, and requests outstanding on each where messages are answers.
const CONNECTIONS: usize = 16;
const WINDOW: usize = 16;

/// Bytes of a request: an id and one key.
const REQUEST: usize = 16;

/// Connections whose memory is compared.
const IDLE: usize = 400;

/// Bytes that tungstenite reads at once: as many as our side.
const READ_AT_ONCE: usize = 16 * 1024;

/// Longest message that our side reads.
const READ_LIMIT: usize = 1 << 16;

/// Bytes that the client reads at once.
const READ_BUFFER: usize = 256 * 1024;

/// Bytes of each connection that the client compares with what must come.
const COMPARED: usize = 1 << 20;

/// Compares WebSocket framing.
#[derive(Debug, Parser)]
struct Args {
    /// Rounds; figures are medians
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Length of each timed part in seconds
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=60))]
    seconds: u64,
    /// File for figures and bars as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Given by cargo
    #[arg(long, hide = true)]
    bench: bool,
}

/// Whose framing serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Framing {
    Ours,
    Theirs,
}

/// What is served.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Load {
    /// Messages without pause, flushed in batches.
    Push,
    /// A message for each small request.
    Answers,
}

/// One timed part.
#[derive(Clone, Copy, Debug)]
struct Part {
    cpu_us_per_message: f64,
    mb_per_s: f64,
}

fn main() -> ExitCode {
    let args = Args::parse();
    match run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "framing: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<(), String> {
    let length = Duration::from_secs(args.seconds);
    // Memory first, ours before theirs: what ours has released can only make theirs look smaller.
    let [ours, theirs] = [Framing::Ours, Framing::Theirs].map(memory_kib);
    let mut figures = json!({ "idle_kib": { "ours": ours?, "theirs": theirs? } });
    for (size_name, size) in SIZES {
        for (load_name, load) in [("push", Load::Push), ("answers", Load::Answers)] {
            let rounds = (0..args.rounds).map(|number| round(load, size, length, number));
            let rounds = rounds.collect::<Result<Vec<_>, _>>()?;
            figures[format!("{load_name}_{size_name}")] = summary(&rounds);
        }
    }
    let bars = bars(&figures);
    let report = json!({
        "rounds": args.rounds, "seconds": args.seconds, "figures": figures, "bars": bars,
        "notes": notes(&figures),
    });
    let text = serde_json::to_string_pretty(&report).map_err(|error| error.to_string())?;
    if let Some(path) = &args.json {
        std::fs::write(path, &text).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    }
    let _ = writeln!(std::io::stdout(), "{text}\n\n{}", bars::text(&bars));
    Ok(())
}

/// Ours, theirs, and ours again as its own control; the order of the first two alternates.
fn round(load: Load, size: usize, length: Duration, number: u32) -> Result<[Part; 3], String> {
    let part = |framing| part(framing, load, size, length);
    let (ours, theirs) = if number.is_multiple_of(2) {
        let ours = part(Framing::Ours)?;
        (ours, part(Framing::Theirs)?)
    } else {
        let theirs = part(Framing::Theirs)?;
        (part(Framing::Ours)?, theirs)
    };
    Ok([ours, theirs, part(Framing::Ours)?])
}

/// Medians, and the ratios round by round.
fn summary(rounds: &[[Part; 3]]) -> Value {
    type Of = fn(&[Part; 3]) -> f64;
    let columns: [(&str, Of); 7] = [
        ("our_cpu_us", |[ours, ..]| ours.cpu_us_per_message),
        ("their_cpu_us", |[_, theirs, _]| theirs.cpu_us_per_message),
        ("our_mb_per_s", |[ours, ..]| ours.mb_per_s),
        ("their_mb_per_s", |[_, theirs, _]| theirs.mb_per_s),
        ("cpu_ratio", |[ours, theirs, _]| theirs.cpu_us_per_message / ours.cpu_us_per_message),
        ("rate_ratio", |[ours, theirs, _]| ours.mb_per_s / theirs.mb_per_s),
        ("own_cpu_ratio", |[ours, _, again]| again.cpu_us_per_message / ours.cpu_us_per_message),
    ];
    let mut object = Map::new();
    for (name, of) in columns {
        let values: Vec<f64> = rounds.iter().map(of).collect();
        object.insert(name.to_owned(), json!(median(values.iter().copied().map(Some))));
        object.insert(format!("{name}_rounds"), json!(values));
    }
    Value::Object(object)
}

fn bars(figures: &Value) -> Vec<Bar> {
    let of = |path| at(figures, path);
    let memory = ratio(of("idle_kib/theirs"), of("idle_kib/ours"));
    vec![
        Bar::at_least("framing: memory of a connection, tungstenite's over ours", memory, "x", 2.0)
            .with_note(
                "resident, both ends and the client's task, after one answered request; 400 connections; \
             tungstenite reads as many bytes at once as ours",
            ),
        Bar::reported("framing: CPU of a pushed chunk, the same", of("push_chunk/cpu_ratio"), "x").with_note(
            "CPU of the serving thread for a message of 3,790 bytes, 64 to a flush, 16 connections",
        ),
        Bar::reported("framing: CPU of an answered request, the same", of("answers_chunk/cpu_ratio"), "x")
            .with_note("as before, each message for a request of 16 bytes, 16 outstanding on a connection"),
        Bar::reported("framing: pushed seed-only frames, the same", of("push_seed/cpu_ratio"), "x"),
        Bar::reported("framing: answered with seed-only frames, the same", of("answers_seed/cpu_ratio"), "x"),
        Bar::reported("framing: ours over itself, pushed (control)", of("push_chunk/own_cpu_ratio"), "x"),
        Bar::reported(
            "framing: ours over itself, answered (control)",
            of("answers_chunk/own_cpu_ratio"),
            "x",
        ),
    ]
}

fn notes(figures: &Value) -> Vec<String> {
    let line = |(path, name): (&str, &str)| {
        let sentence = format!(
            "{name}: ours {{our_cpu_us:.2}} us of CPU a message and {{our_mb_per_s:.0}} MB a second, \
             tungstenite {{their_cpu_us:.2}} us and {{their_mb_per_s:.0}} MB; CPU ratio round by round \
             {{cpu_ratio_rounds:.2}}, ours over itself {{own_cpu_ratio_rounds:.2}}."
        );
        bars::figures::fill(&sentence, figures.get(path).unwrap_or(&Value::Null))
    };
    [
        ("push_chunk", "Framing, pushed chunks"),
        ("answers_chunk", "Framing, answered requests for chunks"),
        ("push_seed", "Framing, pushed seed-only frames"),
        ("answers_seed", "Framing, answered requests for seed-only frames"),
    ]
    .map(line)
    .into()
}

/// Serves on a thread of its own while `client` runs here. Returns the client's result and the CPU
/// time of the serving thread.
fn with_server<T>(
    framing: Framing,
    load: Load,
    size: usize,
    client: impl AsyncFnOnce(SocketAddr) -> Result<T, String>,
) -> Result<(T, Duration), String> {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").map_err(|error| error.to_string())?;
    listener.set_nonblocking(true).map_err(|error| error.to_string())?;
    let address = listener.local_addr().map_err(|error| error.to_string())?;
    let (stop, stopped) = oneshot::channel();
    let server = std::thread::spawn(move || {
        let before = thread_cpu()?;
        runtime()?.block_on(accept(listener, framing, load, size, stopped))?;
        Ok::<_, String>(thread_cpu()?.saturating_sub(before))
    });
    let result = runtime()?.block_on(client(address));
    let _ = stop.send(());
    let cpu = server.join().map_err(|_| "the server panicked")??;
    Ok((result?, cpu))
}

fn runtime() -> Result<tokio::runtime::Runtime, String> {
    Builder::new_current_thread().enable_all().build().map_err(|error| error.to_string())
}

/// CPU time of this thread.
fn thread_cpu() -> Result<Duration, String> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").map_err(|error| error.to_string())?;
    let ns = text.split_whitespace().next().and_then(|ns| ns.parse().ok());
    ns.map(Duration::from_nanos).ok_or_else(|| "no CPU time in /proc/thread-self/schedstat".to_owned())
}

async fn accept(
    listener: std::net::TcpListener,
    framing: Framing,
    load: Load,
    size: usize,
    mut stopped: oneshot::Receiver<()>,
) -> Result<(), String> {
    let listener = TcpListener::from_std(listener).map_err(|error| error.to_string())?;
    let payload = payload(size);
    let mut tasks = JoinSet::new();
    loop {
        tokio::select! {
            _ = &mut stopped => return Ok(()),
            accepted = listener.accept() => {
                let (stream, _) = accepted.map_err(|error| error.to_string())?;
                stream.set_nodelay(true).map_err(|error| error.to_string())?;
                let payload = payload.clone();
                tasks.spawn(async move {
                    // Ends with an error when the client closes.
                    let _ = match framing {
                        Framing::Ours => serve_ours(stream, load, payload).await,
                        Framing::Theirs => serve_theirs(stream, load, payload).await,
                    };
                });
            }
        }
    }
}

async fn serve_ours(stream: TcpStream, load: Load, payload: Bytes) -> Result<(), String> {
    let mut socket = WebSocket::new(stream, &[], READ_LIMIT);
    loop {
        match load {
            Load::Push => (0..BATCH).for_each(|_| socket.queue(payload.clone())),
            Load::Answers => {
                socket.read().await.map_err(|error| error.to_string())?;
                let mut count = 0;
                while let Some(message) = socket.next_message().map_err(|error| error.to_string())? {
                    count += usize::from(matches!(message, Message::Binary(bytes) if bytes.len() == REQUEST));
                }
                (0..count).for_each(|_| socket.queue(payload.clone()));
            }
        }
        socket.flush().await.map_err(|error| error.to_string())?;
    }
}

async fn serve_theirs(stream: TcpStream, load: Load, payload: Bytes) -> Result<(), String> {
    // As many bytes a read as ours; the default is eight times as much for each connection.
    let config = WebSocketConfig::default().read_buffer_size(READ_AT_ONCE);
    let mut socket = WebSocketStream::from_raw_socket(stream, Role::Server, Some(config)).await;
    loop {
        let count = match load {
            Load::Push => BATCH,
            Load::Answers => {
                let mut count = 0;
                let mut next = Some(socket.next().await.ok_or("closed")?);
                // All that have arrived, without waiting for more. Costs a read that finds nothing.
                while let Some(message) = next {
                    let message = message.map_err(|error| error.to_string())?;
                    count +=
                        usize::from(matches!(message, TheirMessage::Binary(bytes) if bytes.len() == REQUEST));
                    next = futures_util::FutureExt::now_or_never(socket.next()).flatten();
                }
                count
            }
        };
        for _ in 0..count {
            socket.feed(TheirMessage::Binary(payload.clone())).await.map_err(|error| error.to_string())?;
        }
        socket.flush().await.map_err(|error| error.to_string())?;
    }
}

fn payload(size: usize) -> Bytes {
    (0..size).map(|index| (index * 7 + 3) as u8).collect()
}

/// A message as it must be on the wire.
fn wire(size: usize) -> Vec<u8> {
    let mut bytes = vec![0x82];
    match u8::try_from(size) {
        Ok(short @ ..126) => bytes.push(short),
        _ => {
            bytes.push(126);
            bytes.extend((size as u16).to_be_bytes());
        }
    }
    bytes.extend(payload(size));
    bytes
}

/// A masked request.
fn request() -> Vec<u8> {
    let mut bytes = vec![0x82, 0x80 | REQUEST as u8, 1, 2, 3, 4];
    bytes.extend([9; REQUEST]);
    bytes
}

fn part(framing: Framing, load: Load, size: usize, length: Duration) -> Result<Part, String> {
    let (read, cpu) = with_server(framing, load, size, async |address| {
        let mut clients = JoinSet::new();
        let end = Instant::now() + length;
        for _ in 0..CONNECTIONS {
            clients.spawn(client(address, load, size, end));
        }
        let mut read = 0;
        while let Some(client) = clients.join_next().await {
            read += client.map_err(|error| error.to_string())??;
        }
        Ok(read)
    })?;
    let messages = read as f64 / wire(size).len() as f64;
    Ok(Part {
        cpu_us_per_message: cpu.as_secs_f64() * 1e6 / messages,
        mb_per_s: read as f64 / 1e6 / length.as_secs_f64(),
    })
}

/// Reads until `end` and returns the number of bytes. The first of them must be the messages.
async fn client(address: SocketAddr, load: Load, size: usize, end: Instant) -> Result<u64, String> {
    let mut stream = TcpStream::connect(address).await.map_err(|error| error.to_string())?;
    stream.set_nodelay(true).map_err(|error| error.to_string())?;
    let (message, requests) = (wire(size), request().repeat(WINDOW));
    let (mut buffer, mut total, mut due) = (vec![0; READ_BUFFER], 0, 0);
    while Instant::now() < end {
        if load == Load::Answers && total == due {
            stream.write_all(&requests).await.map_err(|error| error.to_string())?;
            due += WINDOW * message.len();
        }
        let count = stream.read(&mut buffer).await.map_err(|error| error.to_string())?;
        if count == 0 {
            return Err("the server closed".into());
        }
        if total < COMPARED {
            let expected = message.iter().cycle().skip(total % message.len());
            if buffer[..count].iter().zip(expected).any(|(byte, expected)| byte != expected) {
                return Err("the server sent other bytes than the messages".into());
            }
        }
        total += count;
    }
    Ok(total as u64)
}

/// Resident memory of a connection after one answered request, KiB.
fn memory_kib(framing: Framing) -> Result<f64, String> {
    let (kib, _) = with_server(framing, Load::Answers, SIZES[0].1, async |address| {
        let mut open = Vec::new();
        let mut connect = async |count| {
            for _ in 0..count {
                let mut stream = TcpStream::connect(address).await.map_err(|error| error.to_string())?;
                stream.write_all(&request()).await.map_err(|error| error.to_string())?;
                let mut answer = vec![0; wire(SIZES[0].1).len()];
                stream.read_exact(&mut answer).await.map_err(|error| error.to_string())?;
                open.push(stream);
            }
            rss_kib()
        };
        // The first ones cause allocations that all later ones share.
        let before = connect(IDLE / 10).await?;
        Ok((connect(IDLE).await? - before) / IDLE as f64)
    })?;
    Ok(kib)
}

/// Resident memory of this process, KiB.
fn rss_kib() -> Result<f64, String> {
    let status = std::fs::read_to_string("/proc/self/status").map_err(|error| error.to_string())?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok());
    kib.ok_or_else(|| "no VmRSS in /proc/self/status".to_owned())
}
