//! One content per address: chunks of all levels from every replica, twice through nginx, and after
//! nginx and its replicas were replaced, one of them by another build.

use super::Cluster;
use super::http::{Answer, get, world};
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result};
use bars::Bar;

/// Levels of the chunks that are compared, from 0 on: those with four chunks around the origin.
const LEVELS: u8 = 16;

/// A day, seconds.
const DAY: u64 = 86_400;

/// The rows.
///
/// # Errors
/// A server does not answer.
pub fn rows() -> Result<Vec<Bar>> {
    let mut rows = builds()?;
    rows.extend(replicas()?);
    Ok(rows)
}

/// Addresses of the chunks that are compared.
fn addresses(digest: &str) -> Vec<String> {
    let around = [[-1, -1], [0, -1], [-1, 0], [0, 0]];
    let of_level = |level| around.map(|[x, z]| format!("/v1/{digest}/chunk/{level}/{x}/{z}"));
    (0..LEVELS).flat_map(of_level).collect()
}

/// A cache that was filled before replicas of two builds of one world stand behind it.
fn builds() -> Result<Vec<Bar>> {
    println!("cluster: another build of the server, without optimisation");
    process::run(process::build_tested(&["tombolo-server"])).context("another build")?;
    let other = process::tested_program("tombolo-server");
    let mut cluster = Cluster::start(super::REPLICAS)?;
    let proxy = cluster.nginx.address();
    let paths = addresses(&world(proxy)?);
    let get_all = |address| paths.iter().map(|path| get(address, path)).collect::<Result<Vec<_>>>();
    let filled = get_all(proxy)?;
    cluster.replicas =
        vec![Server::start(super::WORLD_SEED)?, Server::start_program(&other, super::WORLD_SEED, &[])?];
    let replicas: Vec<_> = cluster.replicas.iter().map(Server::address).collect();
    cluster.nginx.restart(&replicas)?;
    let builds = [get_all(replicas[0])?, get_all(replicas[1])?];
    let cached = get_all(proxy)?;
    let with = |is_found: &dyn Fn(&Answer, [&Answer; 2]) -> bool| {
        let answers = cached.iter().zip(builds[0].iter().zip(&builds[1]));
        answers.filter(|(cached, (one, other))| is_found(cached, [one, other])).count() as f64
    };
    let short = filled.iter().filter(|answer| answer.max_age_s < Some(DAY)).count() as f64;
    Ok(vec![
        Bar::none("addresses whose answers a cache may not keep for a day", Some(short)),
        Bar::at_least(
            "an old cache before two builds: answers from it, of 64",
            Some(with(&|cached, _| cached.cache == "HIT")),
            "",
            paths.len() as f64,
        ),
        Bar::none(
            "an old cache before two builds: answers with other bytes than both",
            Some(with(&|cached, builds| builds.iter().all(|build| build.body != cached.body))),
        ),
        Bar::none(
            "an old cache before two builds: addresses with more than one ETag",
            Some(with(&|cached, builds| builds.iter().any(|build| build.etag != cached.etag))),
        ),
    ])
}

fn replicas() -> Result<Vec<Bar>> {
    let cluster = Cluster::start(super::REPLICAS)?;
    let proxy = cluster.nginx.address();
    let digest = world(proxy)?;
    let (mut differing, mut wrong, mut hits, mut all) = (0, 0, 0, 0);
    for path in addresses(&digest) {
        let answers = cluster
            .replicas
            .iter()
            .map(|replica| get(replica.address(), &path))
            .collect::<Result<Vec<_>>>()?;
        all += 1;
        differing += usize::from(answers.iter().any(|answer| answer.etag != answers[0].etag));
        for turn in 0..2 {
            // nginx stores an answer just after it has sent it.
            std::thread::sleep(std::time::Duration::from_millis(20));
            let cached = get(proxy, &path)?;
            hits += usize::from(turn == 1 && cached.cache == "HIT");
            wrong += usize::from(answers.iter().all(|answer| answer.body != cached.body));
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
