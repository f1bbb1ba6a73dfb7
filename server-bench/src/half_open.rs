//! Five thousand sockets that say nothing, or one byte a second: the server must end each, and new
//! clients must be served all the while.

use crate::Plan;
use crate::clients::other_thread;
use crate::connection::{Connection, Received, frames, hello, loopback, open_from, upgrade};
use crate::keys::{WORLD_SEED, land_keys};
use crate::rounds::{Rounds, quantile_ms};
use crate::server_process::ServerProcess;
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::at;
use protocol::message::ClientMessage;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use terrain::{ChunkKey, Land};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::timeout;

/// Sockets, and addresses that they come from.
const SOCKETS: usize = 5000;
const ADDRESSES: usize = 20;

/// Sessions that the server allows, so that most of the sockets have a place at once.
const MAX_SESSIONS: &str = "8192";

/// Time between two bytes of a socket that dribbles.
const BYTE_INTERVAL: Duration = Duration::from_secs(1);

/// A socket that is still open after so long counts with this time.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Stay of the median socket of each kind in seconds: sockets that end before are not half open.
const LEAST_STAY_S: f64 = 3.0;

/// Time between two new good clients, and the longest wait of one.
const GOOD_INTERVAL: Duration = Duration::from_millis(250);
const GOOD_TIMEOUT: Duration = Duration::from_secs(10);

/// The data that a socket sends.
#[derive(Clone, Copy, Debug)]
enum Kind {
    /// Nothing.
    Silent,
    /// The request of the upgrade, one byte a second.
    DribbledRequest,
    /// The upgrade, then nothing.
    NoHello,
    /// The upgrade, then its first message, one byte a second.
    DribbledHello,
    /// A session, then a message of requests, one byte a second.
    DribbledMessage,
}

impl Kind {
    const ALL: [Self; 5] =
        [Self::Silent, Self::DribbledRequest, Self::NoHello, Self::DribbledHello, Self::DribbledMessage];

    const fn name(self) -> &'static str {
        match self {
            Self::Silent => "silent",
            Self::DribbledRequest => "dribbled request",
            Self::NoHello => "no Hello",
            Self::DribbledHello => "dribbled Hello",
            Self::DribbledMessage => "dribbled message",
        }
    }
}

/// Runs the benchmark, each round against a fresh server.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), 0, 512);
    let (mut rounds, mut kinds) = (Rounds::default(), vec![Rounds::default(); Kind::ALL.len()]);
    for _ in 0..plan.rounds {
        round(plan, &keys, &mut rounds, &mut kinds).await?;
    }
    let kinds = Kind::ALL.iter().zip(kinds);
    let kinds: Vec<_> = kinds.map(|(kind, rounds)| rounds.add_to(json!({ "kind": kind.name() }))).collect();
    Ok(rounds.add_to(json!({ "sockets": SOCKETS, "kinds": kinds })))
}

async fn round(plan: &Plan, keys: &[ChunkKey], rounds: &mut Rounds, kinds: &mut [Rounds]) -> Result<()> {
    let server = ServerProcess::start(&plan.launch, &["--max-sessions", MAX_SESSIONS])?;
    let address = server.address;
    let key = keys[0];
    // On a thread of its own, so that the sockets do not delay the good clients.
    let sockets = other_thread()?;
    let opened: Vec<_> = (0..SOCKETS)
        .map(|index| {
            let kind = index % Kind::ALL.len();
            let source = index / Kind::ALL.len() % ADDRESSES;
            (kind, sockets.spawn(stay(Kind::ALL[kind], source, address, key)))
        })
        .collect();
    let end = Instant::now() + Duration::from_secs(plan.seconds).max(TIMEOUT / 2);
    let mut served = Vec::new();
    let mut ticks = tokio::time::interval(GOOD_INTERVAL);
    let mut number = 0;
    while Instant::now() < end {
        ticks.tick().await;
        number += 1;
        let (started, key) = (Instant::now(), keys[number % keys.len()]);
        let answer = timeout(GOOD_TIMEOUT, good_client(address, key)).await;
        served.push(if matches!(answer, Ok(Ok(()))) { started.elapsed() } else { GOOD_TIMEOUT });
    }
    let mut stays = vec![Vec::new(); Kind::ALL.len()];
    let mut unopened = 0;
    for (kind, socket) in opened {
        match socket.await.context("a socket failed")? {
            Some(stay) => stays[kind].push(stay),
            None => unopened += 1,
        }
    }
    for (rounds, stays) in kinds.iter_mut().zip(&stays) {
        rounds.push("sockets", stays.len() as f64);
        rounds.push_extreme("longest_s", quantile_ms(stays.clone(), 1.0).map(|ms| ms / 1000.0));
        rounds.push("median_s", quantile_ms(stays.clone(), 0.5).map(|ms| ms / 1000.0));
    }
    rounds.push_extreme("longest_s", quantile_ms(stays.concat(), 1.0).map(|ms| ms / 1000.0));
    let medians = stays.iter().filter_map(|stays| quantile_ms(stays.clone(), 0.5));
    rounds.push("least_median_s", medians.reduce(f64::min).map(|ms| ms / 1000.0));
    rounds.push_extreme("unopened", f64::from(unopened));
    rounds.push("good_clients", served.len() as f64);
    rounds.push("good_p50_ms", quantile_ms(served.clone(), 0.5));
    rounds.push_extreme("good_worst_ms", quantile_ms(served, 1.0));
    sockets.shutdown_background();
    Ok(())
}

/// Opens a session, requests a chunk and waits for it.
async fn good_client(address: SocketAddr, key: ChunkKey) -> Result<()> {
    let mut connection = Connection::connect(address).await?;
    connection.request([key], false).await?;
    let mut has_chunk = false;
    while !has_chunk {
        connection.receive(|received| has_chunk |= matches!(received, Received::Chunk(_))).await?;
    }
    Ok(())
}

/// How long a socket stays open, at most [`TIMEOUT`]; none if it cannot be opened.
async fn stay(kind: Kind, source: usize, address: SocketAddr, key: ChunkKey) -> Option<Duration> {
    let mut stream = open_from(loopback(source), address, None).await.ok()?;
    let started = Instant::now();
    let request = upgrade(address).into_bytes();
    let requests = ClientMessage::Request { id: 1, keys: vec![key.into(); 64] };
    let [hello, requests] = [hello(), requests].map(|message| frames(&[message]).unwrap_or_default());
    // Sent at once, and byte by byte.
    let (at_once, dribbled) = match kind {
        Kind::Silent => (Vec::new(), Vec::new()),
        Kind::DribbledRequest => (Vec::new(), request),
        Kind::NoHello => (request, Vec::new()),
        Kind::DribbledHello => (request, hello),
        Kind::DribbledMessage => ([request, hello].concat(), requests),
    };
    let (mut reader, mut writer) = stream.split();
    let write = async {
        writer.write_all(&at_once).await?;
        for byte in &dribbled {
            tokio::time::sleep(BYTE_INTERVAL).await;
            writer.write_all(&[*byte]).await?;
        }
        std::future::pending::<std::io::Result<()>>().await
    };
    let read = async {
        let mut buffer = [0; 1024];
        while !matches!(reader.read(&mut buffer).await, Ok(0) | Err(_)) {}
    };
    let ended = async {
        tokio::select! {
            _ = write => {}
            () = read => {}
        }
    };
    let _ = timeout(TIMEOUT, ended).await;
    Some(started.elapsed())
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    // Figures count only if the sockets were there.
    let were_opened = at(figures, "unopened").is_some_and(|unopened| unopened <= 0.01 * SOCKETS as f64);
    let have_stayed = at(figures, "least_median_s") >= Some(LEAST_STAY_S);
    let of = |path| at(figures, path).filter(|_| were_opened && have_stayed);
    vec![
        Bar::at_most("5,000 half-open or dribbling sockets: longest stay of one", of("longest_s"), "s", 10.0)
            .with_note(
                "from its connect to the end of its stream, at most 30 s; silent, the request of the upgrade \
                 byte by byte, no Hello, the Hello byte by byte, a message byte by byte",
            ),
        Bar::at_most("the same: slowest new client, connect to chunk", of("good_worst_ms"), "ms", 200.0),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let kinds = bars::figures::list(figures, "kinds").iter().map(|kind| {
        let line = "Sockets, longest and median stay: {longest_s:.1} and {median_s:.1} s";
        let name = bars::figures::text(kind, "kind").unwrap_or("?");
        format!("{} ({name}).", bars::figures::fill(line, kind))
    });
    let line = "New clients beside them: {good_clients:.0} a round, p50 {good_p50_ms:.1} ms, \
                slowest by round {good_worst_ms_rounds:.1} ms; {unopened:.0} sockets could not be opened.";
    kinds.chain([bars::figures::fill(line, figures)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_without_peers};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({ "longest_s": 9.5, "good_worst_ms": 80.0, "unopened": 0, "least_median_s": 5.0 });
        check(bars, &good, &[("/longest_s", json!(10.1)), ("/good_worst_ms", json!(201))]);
        check_without_peers(bars, &good, "/unopened", json!(4000));
        check_without_peers(bars, &good, "/least_median_s", json!(2.9));
    }
}
