//! From a request to what it names: whose world, which chunk, and whether the client may ask at
//! all.

use crate::http::problem::{Kind, Problem};
use crate::listener::Shared;
use crate::purse::Purse;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path};
use axum::http::{HeaderMap, header};
use std::net::SocketAddr;
use std::str::FromStr;
use terrain::{ChunkKey, WorldDigest};
use tokio::time::{Instant, sleep};

/// Digest, level, x and z as they stand in the path.
pub type RawAddress = Result<Path<(String, String, String, String)>, PathRejection>;

/// The chunk that a path names, once the client is known to be admitted.
///
/// # Errors
/// What is wrong with it, in this order: token, text, world, numbers, key.
pub fn key(shared: &Shared, headers: &HeaderMap, raw: RawAddress, ending: &str) -> Result<ChunkKey, Problem> {
    authorise(shared, headers)?;
    let Ok(Path((digest, level, x, z))) = raw else {
        return Err(Problem::new(Kind::Malformed, "the path is not UTF-8 behind its percent signs"));
    };
    check_world(shared, &digest)?;
    let Some(z) = z.strip_suffix(ending) else {
        return Err(Problem::new(Kind::NoRoute, format!("a picture's address ends with `{ending}`")));
    };
    let (Some(level), Some(x), Some(z)) = (number(&level), number(&x), number(z)) else {
        return Err(Problem::new(
            Kind::Malformed,
            "level, x and z must be whole numbers in their shortest form (level 0 to 255, x and z 32-bit)",
        ));
    };
    ChunkKey::new(level, x, z).map_err(|error| Problem::new(Kind::OutsideWorld, error.to_string()))
}

/// A number as this server would write it: with `+1`, `01` and `-0` a cache would keep one chunk
/// under many addresses.
fn number<N: FromStr + ToString>(text: &str) -> Option<N> {
    text.parse().ok().filter(|number: &N| number.to_string() == text)
}

/// Checks that a path names this server's world.
///
/// # Errors
/// It names another, or none.
pub fn check_world(shared: &Shared, digest: &str) -> Result<(), Problem> {
    let ours = shared.offer.digest;
    if WorldDigest::from_hex(digest) == Some(ours) {
        return Ok(());
    }
    let shown: String = digest.chars().take(64).collect();
    Err(Problem::new(Kind::WrongWorld, format!("world {shown} is not served here; this server has {ours}")))
}

/// The purse of whoever asks, as soon as there is something in it.
///
/// # Errors
/// That would take longer than a requested chunk may wait.
pub async fn purse(shared: &Shared, peer: Option<Extension<SocketAddr>>) -> Result<Purse, Problem> {
    let purse = shared.purses.of(peer.map(|Extension(peer)| peer.ip()));
    let by = Instant::now() + shared.config.deadline;
    loop {
        let now = Instant::now();
        // Of many that wait for the same moment the first spends what came; the others wait on.
        let Some(wait) = purse.wait(now) else { return Ok(purse) };
        if now + wait > by {
            shared.metrics.cost_refusals.inc();
            let sentence = "this address has spent what it may cost, ask again later";
            return Err(Problem::new(Kind::Overloaded, sentence));
        }
        shared.metrics.cost_waits.inc();
        sleep(wait).await;
    }
}

/// Admits a request that carries the token, or any where none is set.
///
/// # Errors
/// The token is missing or wrong.
pub fn authorise(shared: &Shared, headers: &HeaderMap) -> Result<(), Problem> {
    let bearer = headers
        .get(header::AUTHORIZATION)
        .and_then(|value| value.to_str().ok())
        .and_then(|value| value.split_once(' '))
        // The scheme's name is written in any case: RFC 9110, section 11.1.
        .filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer"))
        .map(|(_, token)| token.trim_start_matches(' '));
    if protocol::server::token_matches(shared.offer.token.as_deref(), bearer) {
        return Ok(());
    }
    Err(Problem::new(Kind::Unauthorised, "give the access token as `Authorization: Bearer TOKEN`"))
}
