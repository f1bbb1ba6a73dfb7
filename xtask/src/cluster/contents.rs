//! One content per address: chunks of all levels from every replica, twice through nginx, and from
//! a cache that is a day old, after the replicas were replaced, one of them by another build.

use super::Cluster;
use super::chunks::settled;
use super::http::{Answer, get, world};
use super::objects::files;
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, ensure};
use bars::Bar;
use std::path::Path;

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

/// Layout of a cached answer in nginx 1.11.10 and later, 64 bits: its version, and the offsets of
/// two times, s since 1970, by which nginx decides whether an answer is valid: the end of its
/// validity, and the `Date` of the answer.
const VERSION: u64 = 5;
const TIMES: [usize; 2] = [8, 40];

/// Makes the answers in a cache older. nginx must not run.
///
/// # Errors
/// A file cannot be read or written, or has another layout.
fn age(cache: &Path, by_s: u64) -> Result<()> {
    for file in files(cache)? {
        let mut bytes = std::fs::read(&file)?;
        let version = bytes.first_chunk().map(|bytes| u64::from_ne_bytes(*bytes));
        ensure!(version == Some(VERSION), "{} has another layout than expected", file.display());
        for at in TIMES {
            let time = bytes[at..].first_chunk_mut().context("a cached answer is too short")?;
            *time = i64::from_ne_bytes(*time).saturating_sub_unsigned(by_s).to_ne_bytes();
        }
        std::fs::write(&file, bytes).with_context(|| file.display().to_string())?;
    }
    Ok(())
}

/// A cache that was filled a day before replicas of two builds of one world stand behind it.
fn builds() -> Result<Vec<Bar>> {
    println!("cluster: another build of the server, without optimisation");
    process::run(process::build_tested(&["tombolo-server"])).context("another build")?;
    let other = process::tested_program("tombolo-server");
    let mut cluster = Cluster::start(super::REPLICAS)?;
    let proxy = cluster.nginx.address();
    let paths = addresses(&world(proxy)?);
    let get_all = |address| paths.iter().map(|path| get(address, path)).collect::<Result<Vec<_>>>();
    let filled = get_all(proxy)?;
    // nginx stores an answer just after it has sent it.
    let cache = cluster.nginx.cache();
    settled(|| Ok(files(&cache)?.len() as f64))?;
    cluster.nginx.stop();
    age(&cache, DAY)?;
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
    // The control: beyond their validity answers are no longer taken from the cache as they are.
    let longest_s = filled.iter().filter_map(|answer| answer.max_age_s).max().unwrap_or(0);
    cluster.nginx.stop();
    age(&cache, longest_s)?;
    cluster.nginx.restart(&replicas)?;
    let expired = get_all(proxy)?;
    let hits_beyond = expired.iter().filter(|answer| answer.cache == "HIT").count() as f64;
    let short = filled.iter().filter(|answer| answer.max_age_s < Some(DAY)).count() as f64;
    Ok(vec![
        Bar::none("addresses whose answers a cache may not keep for a day", Some(short)),
        Bar::at_least(
            "a cache a day old before two builds: answers from it, of 64",
            Some(with(&|cached, _| cached.cache == "HIT")),
            "",
            paths.len() as f64,
        ),
        Bar::none(
            "a cache a day old before two builds: answers with other bytes than a build's",
            Some(with(&|cached, builds| builds.iter().any(|build| build.body != cached.body))),
        ),
        Bar::none(
            "a cache a day old before two builds: addresses with more than one ETag",
            Some(with(&|cached, builds| builds.iter().any(|build| build.etag != cached.etag))),
        ),
        Bar::none("control: answers from it a year later", Some(hits_beyond)),
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
            wrong += usize::from(answers.iter().any(|answer| answer.body != cached.body));
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
