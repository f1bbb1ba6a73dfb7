//! GET requests to the parts of a cluster.

use anyhow::{Context, Result};
use serde_json::Value;
use std::net::SocketAddr;
use std::time::Duration;

/// An answer.
#[derive(Debug)]
pub struct Answer {
    /// The validator.
    pub etag: String,
    /// State of nginx's cache: `HIT`, `MISS` ...; empty from a replica.
    pub cache: String,
    /// Seconds for which a cache may keep it, if it says so.
    pub max_age_s: Option<u64>,
    /// The content.
    pub body: Vec<u8>,
}

/// Time for an answer: a process that accepts and never answers is a failure.
const ANSWER_WITHIN: Duration = Duration::from_secs(30);

/// Connections to the parts of a cluster, by no proxy of the environment.
pub fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().timeout_global(Some(ANSWER_WITHIN)).proxy(None).build().into()
}

/// One request over a new connection.
///
/// # Errors
/// No answer, or a status other than 2xx.
pub fn get(address: SocketAddr, path: &str) -> Result<Answer> {
    get_by(&agent(), address, path)
}

/// One request over a connection of an agent.
///
/// # Errors
/// As [`get`].
pub fn get_by(agent: &ureq::Agent, address: SocketAddr, path: &str) -> Result<Answer> {
    let url = format!("http://{address}{path}");
    let mut response = agent.get(&url).call().with_context(|| url.clone())?;
    let header = |name: &str| {
        let value = response.headers().get(name).and_then(|value| value.to_str().ok());
        value.unwrap_or_default().to_owned()
    };
    let (etag, cache) = (header("etag"), header("x-cache"));
    let control = header("cache-control");
    let max_age_s = control.split(',').find_map(|part| part.trim().strip_prefix("max-age=")?.parse().ok());
    let body = response.body_mut().read_to_vec().with_context(|| url.clone())?;
    Ok(Answer { etag, cache, max_age_s, body })
}

/// The digest of the world that is served.
///
/// # Errors
/// As [`get`], or an answer without it.
pub fn world(address: SocketAddr) -> Result<String> {
    let world: Value = serde_json::from_slice(&get(address, "/v1/world")?.body).context("/v1/world")?;
    Ok(world["digest"].as_str().context("/v1/world has no digest")?.to_owned())
}

/// A metric of a replica by its name with labels, as the text has it.
///
/// # Errors
/// As [`get`], or no such metric.
pub fn metric(address: SocketAddr, name: &str) -> Result<f64> {
    let metrics = String::from_utf8(get(address, "/metrics")?.body).context("/metrics")?;
    let line = metrics.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    line.and_then(|value| value.trim().parse().ok()).with_context(|| format!("/metrics has no {name}"))
}
