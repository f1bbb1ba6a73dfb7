//! Many chunks by HTTP from one replica, each once: their latency and whether their bytes are
//! right.

use super::http::{agent, get_by, world};
use anyhow::Result;
use bars::stats::quantile;
use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use terrain::hash::mix;

/// Threads that ask, each over a connection of its own.
const THREADS: usize = 4;

/// Right bytes by path, from the first replica that was asked.
pub type Truth = HashMap<String, Vec<u8>>;

/// Results of the requests.
#[derive(Debug, Default)]
pub struct Asked {
    /// Milliseconds of every request after the fault, in no order.
    pub latencies_ms: Vec<f64>,
    /// Answers with other bytes than the truth.
    pub wrong: usize,
    /// Requests without an answer.
    pub failed: usize,
}

impl Asked {
    /// 99th percentile, milliseconds.
    pub fn p99_ms(&self) -> Option<f64> {
        let mut sorted = self.latencies_ms.clone();
        sorted.sort_by(f64::total_cmp);
        quantile(&sorted, 0.99)
    }
}

/// Paths of all chunks of a level in a square of so many around the origin.
pub fn square(level: u8, side: i32) -> Vec<String> {
    let half = side / 2;
    let keys = (-half..side - half).flat_map(|z| (-half..side - half).map(move |x| (x, z)));
    keys.map(|(x, z)| format!("chunk/{level}/{x}/{z}")).collect()
}

/// The same paths in another order, always the same.
pub fn shuffled(paths: Vec<String>) -> Vec<String> {
    let mut numbered: Vec<_> = (0..).map(mix).zip(paths).collect();
    numbered.sort();
    numbered.into_iter().map(|(_, path)| path).collect()
}

/// Asks for each path once, in order. After a quarter of them `fault` is called; only the requests
/// after it count. Answers are compared with the truth, or become it where there is none.
///
/// # Errors
/// The replica has no world, or the fault failed.
pub fn ask(
    replica: SocketAddr,
    paths: &[String],
    truth: &mut Truth,
    fault: impl FnOnce() -> Result<()>,
) -> Result<Asked> {
    let digest = world(replica)?;
    let (before, after) = paths.split_at(paths.len() / 4);
    let first = part(replica, &digest, before, truth);
    fault()?;
    let second = part(replica, &digest, after, truth);
    let asked = Asked {
        wrong: first.wrong + second.wrong,
        failed: first.failed + second.failed,
        latencies_ms: second.latencies_ms,
    };
    for (path, body) in first.bodies.into_iter().chain(second.bodies) {
        truth.entry(path).or_insert(body);
    }
    Ok(asked)
}

#[derive(Default)]
struct Part {
    latencies_ms: Vec<f64>,
    bodies: Vec<(String, Vec<u8>)>,
    wrong: usize,
    failed: usize,
}

fn part(replica: SocketAddr, digest: &str, paths: &[String], truth: &Truth) -> Part {
    let next = AtomicUsize::new(0);
    let ask = || {
        let agent = agent();
        let mut part = Part::default();
        while let Some(path) = paths.get(next.fetch_add(1, Ordering::Relaxed)) {
            let started = Instant::now();
            let answer = get_by(&agent, replica, &format!("/v1/{digest}/{path}"));
            part.latencies_ms.push(started.elapsed().as_secs_f64() * 1e3);
            match (answer, truth.get(path)) {
                (Err(_), _) => part.failed += 1,
                (Ok(answer), Some(right)) => part.wrong += usize::from(answer.body != *right),
                (Ok(answer), None) => part.bodies.push((path.clone(), answer.body)),
            }
        }
        part
    };
    thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(ask)).collect();
        threads.into_iter().fold(Part::default(), |mut all, thread| {
            let part = thread.join().expect("no panic");
            all.latencies_ms.extend(part.latencies_ms);
            all.bodies.extend(part.bodies);
            all.wrong += part.wrong;
            all.failed += part.failed;
            all
        })
    })
}

/// Waits until a figure stays for half a second, ten seconds at most.
pub fn settled(mut figure: impl FnMut() -> Result<f64>) -> Result<f64> {
    let (mut last, mut since) = (figure()?, Instant::now());
    let deadline = Instant::now() + Duration::from_secs(10);
    while since.elapsed() < Duration::from_millis(500) && Instant::now() < deadline {
        thread::sleep(Duration::from_millis(50));
        let now = figure()?;
        if now != last {
            (last, since) = (now, Instant::now());
        }
    }
    Ok(last)
}
