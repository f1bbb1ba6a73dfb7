//! What a cluster promises, tried on a running one: one content per address on all replicas, a cache
//! before them, and clients that go on when a replica is killed.

use super::Cluster;
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, ensure};
use bars::Bar;
use bars::figures::{at, list};
use serde_json::Value;
use std::net::SocketAddr;
use std::thread::sleep;
use std::time::Duration;

/// Levels of the chunks that are compared, from 0 on: those with four chunks around the origin.
const LEVELS: u8 = 16;

/// Clients of the load.
const CLIENTS: usize = 40;

/// The load runs so long; a replica is killed after a third of it.
const LOAD_S: u64 = 24;

/// An answer to a GET.
#[derive(Debug)]
struct Answer {
    etag: String,
    cache: String,
    body: Vec<u8>,
}

/// Every figure beside its bar.
pub fn rows(cluster: &mut Cluster) -> Result<Vec<Bar>> {
    let mut rows = contents(cluster)?;
    rows.extend(failure(cluster)?);
    Ok(rows)
}

/// Chunks of all levels from each replica, and twice through nginx.
fn contents(cluster: &Cluster) -> Result<Vec<Bar>> {
    let proxy = cluster.nginx.address();
    let world: Value = serde_json::from_slice(&get(proxy, "/v1/world")?.body).context("/v1/world")?;
    let digest = world["digest"].as_str().context("/v1/world has no digest")?;
    let (mut differing, mut wrong, mut hits, mut all) = (0, 0, 0, 0);
    for level in 0..LEVELS {
        for [x, z] in [[-1, -1], [0, -1], [-1, 0], [0, 0]] {
            let path = format!("/v1/{digest}/chunk/{level}/{x}/{z}");
            let answers = cluster
                .replicas
                .iter()
                .map(|replica| get(replica.address(), &path))
                .collect::<Result<Vec<_>>>()?;
            all += 1;
            differing += usize::from(answers.iter().any(|answer| answer.etag != answers[0].etag));
            for _ in 0..2 {
                let cached = get(proxy, &path)?;
                hits += usize::from(cached.cache == "HIT");
                wrong += usize::from(answers.iter().all(|answer| answer.body != cached.body));
            }
        }
    }
    Ok(vec![
        Bar::none("addresses with more than one ETag over the replicas", Some(differing as f64)),
        Bar::none("answers through nginx with other bytes than a replica's", Some(wrong as f64)),
        // Each address is asked for twice.
        Bar::at_least(
            "second requests that nginx answers from its cache",
            Some(hits as f64 / f64::from(all)),
            "",
            1.0,
        ),
    ])
}

/// A load through nginx, with one replica killed in the middle of it.
fn failure(cluster: &mut Cluster) -> Result<Vec<Bar>> {
    let json = process::target().join("cluster").join(format!("load-{}.json", std::process::id()));
    let mut load = process::command(process::program("tombolo-load"))
        .args(["--connect", &format!("ws://{}/v1/stream", cluster.nginx.address())])
        .args(["--clients", &CLIENTS.to_string(), "--seconds", &LOAD_S.to_string(), "--quiet", "--json"])
        .arg(&json)
        // It says that sessions were dropped, which is the point here.
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .context("cannot start tombolo-load")?;
    sleep(Duration::from_secs(LOAD_S / 3));
    let before: Vec<_> = cluster.replicas.iter().map(sessions).collect::<Result<_>>()?;
    let mut victim = cluster.replicas.remove(0);
    victim.kill();
    sleep(Duration::from_secs(LOAD_S / 3));
    let after = cluster.replicas.iter().map(sessions).sum::<Result<f64>>()?;
    load.wait().context("tombolo-load")?;
    let report = std::fs::read(&json).with_context(|| format!("no {}", json.display()))?;
    let report: Value = serde_json::from_slice(&report).context("the report of tombolo-load")?;
    let _ = std::fs::remove_file(&json);
    ensure!(before[0] > 0.0, "the replica to be killed had no session: nothing was tried");
    let seconds = list(&report, "timeline").iter().skip(1);
    ensure!(seconds.len() + 2 >= LOAD_S as usize, "tombolo-load ended early");
    let empty = seconds.filter(|second| at(second, "chunks").is_none_or(|chunks| chunks == 0.0)).count();
    Ok(vec![
        Bar::reported("sessions of the replica that is killed", Some(before[0]), ""),
        Bar::none("wrong chunks", at(&report, "mismatches")),
        Bar::at_least("clients with a session 8 s later, over all", Some(after / CLIENTS as f64), "", 1.0),
        Bar::none("seconds without a chunk for anybody", Some(empty as f64)),
        Bar::reported("p99 of a chunk over the whole run", at(&report, "latency_ms/p99"), "ms"),
    ])
}

/// Open sessions of a replica, by its metrics.
fn sessions(replica: &Server) -> Result<f64> {
    let metrics = String::from_utf8(get(replica.address(), "/metrics")?.body).context("/metrics")?;
    let line = metrics.lines().find_map(|line| line.strip_prefix("tombolo_sessions "));
    line.and_then(|value| value.trim().parse().ok()).context("/metrics has no tombolo_sessions")
}

fn get(address: SocketAddr, path: &str) -> Result<Answer> {
    let url = format!("http://{address}{path}");
    let mut response = ureq::get(&url).call().with_context(|| url.clone())?;
    let header = |name: &str| {
        let value = response.headers().get(name).and_then(|value| value.to_str().ok());
        value.unwrap_or_default().to_owned()
    };
    let (etag, cache) = (header("etag"), header("x-cache"));
    let body = response.body_mut().read_to_vec().with_context(|| url.clone())?;
    Ok(Answer { etag, cache, body })
}
