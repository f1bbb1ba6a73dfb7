//! Path parameters and the rate limit of HTTP requests.

use crate::http::client::Client;
use crate::http::problem::{Problem, ProblemKind};
use crate::limits::rate_limit::TokenBucket;
use crate::state::ServerState;
use axum::extract::rejection::PathRejection;
use axum::extract::{FromRequestParts, Path};
use axum::http::request::Parts;
use std::convert::Infallible;
use std::net::IpAddr;
use std::str::FromStr;
use std::sync::Arc;
use terrain::{ChunkKey, WorldDigest};
use tokio::time::Instant;

/// Digest, level, x and z of a path, unparsed.
type RawChunkPath = Result<Path<(String, String, String, String)>, PathRejection>;

/// A request for a resource with the path `/v1/{digest}/.../{level}/{x}/{z}`. Extracting it checks
/// nothing.
#[derive(Debug)]
pub struct ChunkPathRequest {
    /// Who asks.
    pub client: Client,
    raw: RawChunkPath,
}

impl FromRequestParts<Arc<ServerState>> for ChunkPathRequest {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<ServerState>) -> Result<Self, Infallible> {
        let raw = Path::from_request_parts(parts, state).await;
        let client = Client::from_request_parts(parts, state).await?;
        Ok(Self { client, raw })
    }
}

impl ChunkPathRequest {
    /// The chunk key, and the token bucket of the client after waiting until it is not empty; z is
    /// followed by `suffix`.
    ///
    /// # Errors
    /// What is wrong, in this order: token, encoding, world, numbers, key, rate limit.
    pub async fn admit(&self, state: &ServerState, suffix: &str) -> Result<(ChunkKey, TokenBucket), Problem> {
        let key = chunk_key(state, &self.client, &self.raw, suffix)?;
        Ok((key, wait_for_tokens(state, self.client.address).await?))
    }
}

/// The chunk key of an authorised request's path.
fn chunk_key(
    state: &ServerState,
    client: &Client,
    raw: &RawChunkPath,
    suffix: &str,
) -> Result<ChunkKey, Problem> {
    client.authorise(state)?;
    let Ok(Path((digest, level, x, z))) = raw else {
        return Err(Problem::new(ProblemKind::Malformed, "the percent-encoded path is not UTF-8"));
    };
    check_world(state, digest)?;
    let Some(z) = z.strip_suffix(suffix) else {
        return Err(Problem::new(ProblemKind::NoRoute, format!("the path of a tile ends with `{suffix}`")));
    };
    let (Some(level), Some(x), Some(z)) = (number(level), number(x), number(z)) else {
        return Err(Problem::new(
            ProblemKind::Malformed,
            "level, x and z must be whole numbers in their shortest form (level 0 to 255, x and z 32-bit)",
        ));
    };
    ChunkKey::new(level, x, z).map_err(|error| Problem::new(ProblemKind::OutsideWorld, error.to_string()))
}

/// A number in its canonical form only: with `+1`, `01` and `-0` a cache would store one chunk
/// under several URLs.
fn number<N: FromStr + ToString>(text: &str) -> Option<N> {
    text.parse().ok().filter(|number: &N| number.to_string() == text)
}

/// Checks that a path contains the digest of this server's world.
///
/// # Errors
/// It contains another digest, or none.
pub fn check_world(state: &ServerState, digest: &str) -> Result<(), Problem> {
    let ours = state.offer.digest;
    if WorldDigest::from_hex(digest) == Some(ours) {
        return Ok(());
    }
    let shown: String = digest.chars().take(64).collect();
    let detail = format!("world {shown} is not served here; this server has {ours}");
    Err(Problem::new(ProblemKind::WrongWorld, detail))
}

/// The token bucket of the client, after waiting until it is not empty. A wait that would exceed
/// the deadline of requests is an error.
async fn wait_for_tokens(state: &ServerState, client: Option<IpAddr>) -> Result<TokenBucket, Problem> {
    let bucket = state.rate_limiter.bucket(client);
    if bucket.wait(Instant::now() + state.config.deadline, &state.metrics).await {
        Ok(bucket)
    } else {
        Err(over_rate())
    }
}

/// The problem document for a client whose bucket stays empty for too long.
#[must_use]
pub fn over_rate() -> Problem {
    Problem::new(ProblemKind::Overloaded, "the rate limit of this address is exceeded, retry later")
}
