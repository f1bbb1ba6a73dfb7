//! One content per address: chunks of all levels from every replica, and twice through nginx.

use super::Cluster;
use super::http::{get, world};
use anyhow::Result;
use bars::Bar;

/// Levels of the chunks that are compared, from 0 on: those with four chunks around the origin.
const LEVELS: u8 = 16;

/// The rows.
///
/// # Errors
/// A server does not answer.
pub fn rows() -> Result<Vec<Bar>> {
    let cluster = Cluster::start(super::REPLICAS)?;
    let proxy = cluster.nginx.address();
    let digest = world(proxy)?;
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
                // nginx stores an answer just after it has sent it.
                std::thread::sleep(std::time::Duration::from_millis(20));
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
