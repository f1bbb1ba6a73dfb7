//! One tile of the relief map by the key of the chunk that covers the same square.

use crate::http::address::{self, RawAddress};
use crate::http::chunk::refusal;
use crate::http::conditional::{Representation, etag, for_ever};
use crate::http::problem::{Kind, Problem};
use crate::listener::Shared;
use crate::map::MapError;
use axum::extract::{Extension, State};
use axum::http::HeaderMap;
use axum::response::Response;
use std::net::SocketAddr;
use std::sync::Arc;

/// `GET /v1/{digest}/map/{level}/{x}/{z}.png`.
pub async fn get(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    peer: Option<Extension<SocketAddr>>,
    raw: RawAddress,
) -> Result<Response, Problem> {
    let key = address::key(&shared, &headers, raw, ".png")?;
    let purse = address::purse(&shared, peer).await?;
    let tile = shared.map.tile(key, &shared.generation, &purse, &shared.metrics).await;
    let tile = tile.map_err(|error| match error {
        MapError::Busy => Problem::new(Kind::MapBusy, error.to_string()),
        MapError::Generation(error) => refusal(error),
    })?;
    let representation = Representation {
        etag: etag(&tile.digest),
        content_type: "image/png",
        caching: for_ever(shared.offer.token.is_some()),
        body: tile.png,
    };
    Ok(representation.answer(&headers))
}
