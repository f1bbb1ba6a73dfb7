//! Path parameters and the rate limit of HTTP requests.

use crate::http::client::Client;
use crate::http::problem::{Problem, ProblemKind};
use crate::limits::rate_limit::TokenBucket;
use crate::map::tiles::STYLE;
use crate::state::ServerState;
use axum::extract::rejection::PathRejection;
use axum::extract::{FromRequestParts, Path};
use axum::http::Uri;
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
    /// The client that sends the request.
    pub client: Client,
    uri: Uri,
    raw: RawChunkPath,
}

impl FromRequestParts<Arc<ServerState>> for ChunkPathRequest {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<ServerState>) -> Result<Self, Infallible> {
        let raw = Path::from_request_parts(parts, state).await;
        let client = Client::from_request_parts(parts, state).await?;
        Ok(Self { client, uri: parts.uri.clone(), raw })
    }
}

impl ChunkPathRequest {
    /// The chunk key, and the token bucket of the client after waiting until it is not empty; z is
    /// followed by `suffix`, and the query is one of `query`.
    ///
    /// # Errors
    /// The first fault, in this order: token, encoding, query, world, numbers, key, rate limit.
    pub async fn admit(
        &self,
        state: &ServerState,
        suffix: &str,
        query: Query,
    ) -> Result<(ChunkKey, TokenBucket), Problem> {
        let key = self.chunk_key(state, suffix, query)?;
        Ok((key, wait_for_tokens(state, self.client.address).await?))
    }

    /// Whether the address names the style of a tile: one without it may have another tile later.
    pub fn has_style(&self) -> bool {
        self.uri.query().is_some()
    }

    /// The chunk key of an authorised request's path.
    fn chunk_key(&self, state: &ServerState, suffix: &str, query: Query) -> Result<ChunkKey, Problem> {
        self.client.authorise(state)?;
        let Ok(Path((digest, level, x, z))) = &self.raw else {
            return Err(Problem::new(ProblemKind::Malformed, "the percent-encoded path is not UTF-8"));
        };
        check_spelling(&self.uri, query)?;
        check_world(state, digest)?;
        key_of(level, x, z, suffix)
    }
}

/// The chunk key of three parts of a path.
fn key_of(level: &str, x: &str, z: &str, suffix: &str) -> Result<ChunkKey, Problem> {
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

/// The query of a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Query {
    /// None.
    None,
    /// None, or `style=N` with this server's style.
    Style,
}

/// Checks that a URI under `/v1/{digest}/` has its one spelling: a cache would store one chunk
/// under `/0` and `/%30`, and under any number of queries.
///
/// # Errors
/// Percent-encoding, which no part of these paths needs, or another query or style.
pub fn check_spelling(uri: &Uri, query: Query) -> Result<(), Problem> {
    if uri.path().contains('%') {
        let detail = "the path must not be percent-encoded: it has letters, digits, `-` and `.` only";
        return Err(Problem::new(ProblemKind::Malformed, detail));
    }
    let detail = match (query, uri.query()) {
        (_, None) => return Ok(()),
        (Query::Style, Some(given)) => match given.strip_prefix("style=").and_then(number::<u32>) {
            Some(STYLE) => return Ok(()),
            // A replica of another version has it: a cache must not store this style under its URL.
            Some(other) => {
                let detail = format!("style {other} is not drawn here; this server has style {STYLE}");
                return Err(Problem::new(ProblemKind::WrongStyle, detail));
            }
            None => "a tile has no query but `style=N`, which /v1/world names",
        },
        (Query::None, Some(_)) => "this path has no query",
    };
    Err(Problem::new(ProblemKind::Malformed, detail))
}

/// A number in its canonical form only: with `+1`, `01` and `-0` a cache would store one chunk
/// under several URLs.
pub fn number<N: FromStr + ToString>(text: &str) -> Option<N> {
    text.parse().ok().filter(|number: &N| number.to_string() == text)
}

/// Checks that a path contains the digest of this server's world.
///
/// # Errors
/// It contains another digest, none, or this one in capitals, which a cache would store again.
pub fn check_world(state: &ServerState, digest: &str) -> Result<(), Problem> {
    let ours = state.offer.digest;
    if WorldDigest::from_hex(digest) == Some(ours) {
        let is_canonical = !digest.contains(|character: char| character.is_ascii_uppercase());
        let problem = || Problem::new(ProblemKind::Malformed, "the digest must be in lower case");
        return is_canonical.then_some(()).ok_or_else(problem);
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
    Problem::new(ProblemKind::OverRate, "the rate limit of this address is exceeded, retry later")
}
