//! Many requests for few chunks: those that reach the replicas, and the chunks that these generate,
//! without and with a store.

use super::chunks::{self, Truth};
use super::http::{agent, get_by, metric, world};
use super::objects::{self, Objects};
use super::{Cluster, store};
use crate::server::Server;
use anyhow::{Context, Result, ensure};
use bars::Bar;
use std::collections::HashMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::net::SocketAddr;
use std::thread;
use terrain::hash::mix;

/// Requests in all.
const REQUESTS: u32 = 100_000;

/// Threads that send them, each over a connection of its own.
const THREADS: u32 = 8;

/// Chunks per axis, around the origin: 96 x 96.
const SIDE: u32 = 96;

/// The level of the chunks without a store, and with one, which has level 2 and coarser.
const LEVEL: u8 = 0;
const STORED_LEVEL: u8 = 2;

/// Generated chunks of a replica.
const GENERATED: &str = "tombolo_generation_jobs_total{outcome=\"completed\"}";

/// Responses of one address.
#[derive(Clone, Copy, Debug, Default)]
struct Received {
    /// Requests that a replica answered.
    misses: u32,
    /// Of all answers to this address; the first stands for it.
    content: Option<u64>,
    /// Answers with other bytes.
    wrong: u32,
}

/// The rows.
///
/// # Errors
/// A server does not answer.
pub fn rows() -> Result<Vec<Bar>> {
    let (all, made) = requested(&Cluster::start(super::REPLICAS)?, LEVEL)?;
    let (replicas, keys) = (f64::from(super::REPLICAS), all.len() as f64);
    let misses: u32 = all.values().map(|seen| seen.misses).sum();
    let most = all.values().map(|seen| seen.misses).max().context("no request")?;
    let wrong: u32 = all.values().map(|seen| seen.wrong).sum();
    let mut rows = vec![
        Bar::reported("chunks that 10^5 requests with Zipf's frequencies name", Some(keys), ""),
        Bar::none("of the answers, other bytes than the first of the address", Some(wrong.into())),
        Bar::reported(
            "requests that nginx answers from its cache",
            Some(100.0 * (1.0 - f64::from(misses) / f64::from(REQUESTS))),
            "%",
        ),
        Bar::at_most("requests for one chunk that reached a replica, most", Some(most.into()), "", replicas),
        Bar::at_most("chunks generated, over all replicas, per chunk named", Some(made / keys), "", replicas),
    ];
    rows.extend(with_store()?);
    Ok(rows)
}

/// The same with a store; then each replica is asked for every chunk, also those whose home is the
/// other one. The truth is generation by a server without a store.
fn with_store() -> Result<Vec<Bar>> {
    const PER_CHUNK: &str = "with a store: chunks generated, over all replicas, per chunk named";
    if let Some(reason) = objects::lacks() {
        return Ok(vec![Bar::reported(PER_CHUNK, None, "").not_measured_if(true, &reason)]);
    }
    let objects = Objects::start("zipf", None)?;
    let settings = [objects.settings().as_slice(), &[store::patient_wait()]].concat();
    let cluster = Cluster::start_with(super::REPLICAS, &settings)?;
    let (all, made) = requested(&cluster, STORED_LEVEL)?;
    let written =
        |replica: &Server| metric(replica.address(), "tombolo_store_writes_total{outcome=\"written\"}");
    chunks::settled(|| cluster.replicas.iter().map(written).sum())?;
    let paths: Vec<_> = all.keys().map(|place| path(STORED_LEVEL, *place)).collect();
    let mut truth = truth_of(&paths)?;
    let mut bad = differing(&all, STORED_LEVEL, &truth);
    let before = generated(&cluster)?;
    for replica in &cluster.replicas {
        let asked = chunks::ask(replica.address(), &paths, &mut truth, || Ok(()))?;
        bad += asked.wrong + asked.failed;
    }
    let again = generated(&cluster)? - before;
    let control = of_corrupted_truth(&cluster.replicas[0], &paths[0], &mut truth)?;
    let wrong: u32 = all.values().map(|seen| seen.wrong).sum();
    let keys = all.len() as f64;
    Ok(vec![
        Bar::none("with a store: wrong chunks or none", Some(f64::from(wrong) + bad as f64))
            .with_note("chunks of a server without a store, which generated all of them, are right"),
        Bar::some("control: wrong chunks where one bit of the right one differs", Some(control as f64)),
        Bar::at_most(PER_CHUNK, Some((made + again) / keys), "", 1.0),
        Bar::some("control: chunks that were generated before they were stored", Some(made)),
    ])
}

/// Chunks as a server without a store generates them.
///
/// # Errors
/// The server does not start, or did not generate each of them.
fn truth_of(paths: &[String]) -> Result<Truth> {
    let alone = Server::start(super::WORLD_SEED)?;
    let mut truth = Truth::new();
    let asked = chunks::ask(alone.address(), paths, &mut truth, || Ok(()))?;
    let made = metric(alone.address(), GENERATED)?;
    ensure!(
        asked.failed == 0 && made >= paths.len() as f64,
        "a server without a store generated {made} of {} chunks, and did not answer {} requests",
        paths.len(),
        asked.failed
    );
    Ok(truth)
}

/// Addresses whose first answer has other bytes than the truth.
fn differing(all: &HashMap<u32, Received>, level: u8, truth: &Truth) -> usize {
    let is_right = |place: u32, seen: &Received| {
        truth.get(&path(level, place)).is_some_and(|frame| seen.content == Some(content_of(frame)))
    };
    all.iter().filter(|(place, seen)| !is_right(**place, seen)).count()
}

/// The control: wrong answers of a replica for a chunk whose truth has another bit.
fn of_corrupted_truth(replica: &Server, path: &str, truth: &mut Truth) -> Result<usize> {
    let frame = truth.get_mut(path).context("no truth")?;
    *frame.last_mut().context("an empty chunk")? ^= 1;
    Ok(chunks::ask(replica.address(), &[path.to_owned()], truth, || Ok(()))?.wrong)
}

/// Stands for the bytes of an answer.
fn content_of(body: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    body.hash(&mut hasher);
    hasher.finish()
}

/// Generated chunks of all replicas.
fn generated(cluster: &Cluster) -> Result<f64> {
    cluster.replicas.iter().map(|replica| metric(replica.address(), GENERATED)).sum()
}

/// Sends all requests for chunks of a level. The responses by chunk, and the generated chunks.
fn requested(cluster: &Cluster, level: u8) -> Result<(HashMap<u32, Received>, f64)> {
    let proxy = cluster.nginx.address();
    let digest = world(proxy)?;
    let before = generated(cluster)?;
    let sum = zipf();
    let parts: Vec<_> = thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS)
            .map(|number| {
                let (sum, digest) = (&sum, &digest);
                scope.spawn(move || send(proxy, (digest, level), sum, number))
            })
            .collect();
        threads.into_iter().map(|thread| thread.join().expect("no panic")).collect::<Result<_>>()
    })?;
    let mut all: HashMap<u32, Received> = HashMap::new();
    for (key, part) in parts.into_iter().flatten() {
        let seen = all.entry(key).or_default();
        let differs = seen.content.is_some_and(|content| part.content != Some(content));
        seen.misses += part.misses;
        seen.wrong += part.wrong + u32::from(differs);
        seen.content = seen.content.or(part.content);
    }
    Ok((all, generated(cluster)? - before))
}

/// The address of a chunk by its number, below that of its world.
fn path(level: u8, place: u32) -> String {
    let [x, z] = [place % SIDE, place / SIDE].map(|index| index as i32 - SIDE as i32 / 2);
    format!("chunk/{level}/{x}/{z}")
}

/// The share of one thread, by chunk.
fn send(
    proxy: SocketAddr,
    (digest, level): (&str, u8),
    sum: &[f64],
    number: u32,
) -> Result<HashMap<u32, Received>> {
    let agent = agent();
    let mut all: HashMap<u32, Received> = HashMap::new();
    for request in 0..REQUESTS / THREADS {
        let random = f64::from(mix(request * THREADS + number)) / f64::from(u32::MAX);
        let rank =
            sum.partition_point(|until| *until < random * sum[sum.len() - 1]).min(sum.len() - 1) as u32;
        // Neighbours in rank are none on the ground.
        let place = (u64::from(rank) * 4099 % u64::from(SIDE * SIDE)) as u32;
        let answer = get_by(&agent, proxy, &format!("/v1/{digest}/{}", path(level, place)))?;
        let content = content_of(&answer.body);
        let seen = all.entry(place).or_default();
        seen.misses += u32::from(answer.cache != "HIT");
        seen.wrong += u32::from(seen.content.is_some_and(|first| first != content));
        seen.content = seen.content.or(Some(content));
    }
    Ok(all)
}

/// Cumulated frequencies 1, 1/2, 1/3 ... of all chunks (G. K. Zipf, exponent 1).
fn zipf() -> Vec<f64> {
    (1..=SIDE * SIDE)
        .scan(0.0, |sum, rank| {
            *sum += 1.0 / f64::from(rank);
            Some(*sum)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_answers_are_compared_with_the_truth_and_not_with_each_other() {
        let seen = |body: &[u8]| Received { content: Some(content_of(body)), ..Received::default() };
        let truth = Truth::from([(path(2, 7), vec![1, 2]), (path(2, 8), vec![3])]);
        let differing = |all: [(u32, Received); 2]| differing(&HashMap::from(all), 2, &truth);
        assert_eq!(differing([(7, seen(&[1, 2])), (8, seen(&[3]))]), 0);
        assert_eq!(differing([(7, seen(&[1, 2])), (8, seen(&[2]))]), 1, "a corrupted chunk");
        assert_eq!(differing([(7, seen(&[1, 2])), (9, seen(&[3]))]), 1, "a chunk without a truth");
    }
}
