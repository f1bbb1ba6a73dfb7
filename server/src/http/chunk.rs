//! One chunk by its key: what any cache may keep for ever.

use crate::generation::GenerationError;
use crate::http::address::{self, RawAddress};
use crate::http::conditional::{Representation, etag, for_ever};
use crate::http::problem::{Kind, Problem};
use crate::listener::Shared;
use axum::extract::{Extension, State};
use axum::http::HeaderMap;
use axum::response::Response;
use protocol::server::Wanted;
use protocol::{Delivery, chunk_codec};
use std::net::SocketAddr;
use std::sync::Arc;

/// `GET /v1/{digest}/chunk/{level}/{x}/{z}`.
pub async fn get(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    peer: Option<Extension<SocketAddr>>,
    raw: RawAddress,
) -> Result<Response, Problem> {
    let key = address::key(&shared, &headers, raw, "")?;
    // Always exact: what is cached for ever must be of use to whoever has no generator.
    let wanted = Wanted { key, request: Some(0), priority: u64::MAX };
    let purse = address::purse(&shared, peer).await?;
    let frame =
        shared.generation.flow_paid_by(purse).frame(wanted, Delivery::Exact).await.map_err(refusal)?;
    let representation = Representation {
        // The frame carries its own digest, over all of its bytes.
        etag: etag(&chunk_codec::digest(&frame).unwrap_or_default()),
        content_type: "application/octet-stream",
        caching: for_ever(shared.offer.token.is_some()),
        body: frame,
    };
    Ok(representation.answer(&headers))
}

/// How a chunk that cannot be had is told.
pub fn refusal(error: GenerationError) -> Problem {
    let kind = match error {
        GenerationError::Overloaded => Kind::Overloaded,
        GenerationError::Failed => Kind::Failed,
    };
    Problem::new(kind, error.to_string())
}
