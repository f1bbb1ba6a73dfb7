//! The HTTP side: the page and its map, single chunks, what happens, probes and metrics, and the
//! door to a session.
//!
//! One file a route or a few that belong together; [`routes`] is the list of them, and
//! `openapi.json` describes the same list. [`problem`] is the only way to refuse, [`conditional`]
//! the only way to answer with a validator, [`cors`] says what other origins may read.

pub mod address;
pub mod chunk;
pub mod conditional;
pub mod cors;
pub mod health;
pub mod height;
pub mod live;
pub mod map;
pub mod openapi;
pub mod page;
pub mod problem;
pub mod session;
pub mod world;

use crate::listener::Shared;
use crate::metrics::Status;
use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, any, get};
use cors::open;
use problem::{Kind, Problem};
use std::sync::Arc;

/// All routes of a server, in the order of the document.
pub fn routes() -> Vec<(&'static str, MethodRouter<Arc<Shared>>)> {
    vec![
        ("/", closed(get(page::index))),
        ("/page/{name}", closed(get(page::file))),
        ("/openapi.json", open(get(openapi::get))),
        ("/v1/world", open(get(world::get))),
        ("/v1/{digest}/chunk/{level}/{x}/{z}", open(get(chunk::get))),
        ("/v1/{digest}/map/{level}/{x}/{z}", open(get(map::get))),
        ("/v1/{digest}/height/{x}/{z}", open(get(height::get))),
        ("/v1/live", closed(get(live::get))),
        ("/v1/stream", any(session::stream)),
        ("/livez", closed(get(health::livez))),
        ("/readyz", closed(get(health::readyz))),
        ("/metrics", closed(get(health::metrics))),
    ]
}

/// A route for this origin only.
fn closed(methods: MethodRouter<Arc<Shared>>) -> MethodRouter<Arc<Shared>> {
    methods.options(|| async { (StatusCode::NO_CONTENT, [(header::ALLOW, "GET, HEAD, OPTIONS")]) })
}

/// The router of a server.
pub fn router(shared: Arc<Shared>) -> Router {
    let mut router = Router::new();
    for (path, methods) in routes() {
        router = router.route(path, methods);
    }
    router
        .fallback(|| async {
            Problem::new(Kind::NoRoute, "no such route; see GET /v1/world and GET /openapi.json")
        })
        .method_not_allowed_fallback(|method: Method| async move {
            let mut response =
                Problem::new(Kind::WrongMethod, format!("{method} is not for this path")).into_response();
            response.headers_mut().insert(header::ALLOW, HeaderValue::from_static("GET, HEAD, OPTIONS"));
            response
        })
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), count))
        .with_state(shared)
}

/// Counts every response, and every refusal by its kind.
async fn count(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let mut response = next.run(request).await;
    let status = response.status().as_u16();
    shared.metrics.http_responses.get_or_create(&Status { status }).inc();
    if let Some(kind) = response.extensions().get::<Kind>() {
        shared.metrics.http_refused(*kind);
    }
    // Nothing here is meant to be taken for something else than it says.
    response.headers_mut().insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}
