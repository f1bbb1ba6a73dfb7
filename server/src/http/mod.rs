//! HTTP routes: the page and its map, chunks, live statistics, probes, metrics, and the upgrade to
//! a session.
//!
//! A request for a host name that is not this server's gets no answer of a route (`known_host`).
//!
//! [`routes`] lists them in the order of `openapi.json`. All error responses are made by
//! [`problem`], all responses with a validator by [`conditional`]; [`cors`] allows other origins.

pub mod chunk;
pub mod client;
pub mod conditional;
pub mod cors;
pub mod health;
pub mod height;
pub mod live;
pub mod map;
pub mod openapi;
pub mod page;
pub mod path;
pub mod problem;
pub mod session;
pub mod world;

use crate::access::hosts::{MalformedHost, Target};
use crate::limits::per_ip::IpPermit;
use crate::proxy::ClientAddress;
use crate::state::ServerState;
use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, any, get};
use problem::{Problem, ProblemKind};
use std::net::IpAddr;
use std::sync::Arc;
use tokio::sync::SemaphorePermit;

/// A route of a server.
#[derive(Clone, Debug)]
pub struct Route {
    /// Pattern of its paths.
    pub path: &'static str,
    /// Whose scripts may read its responses.
    pub origins: Origins,
    methods: MethodRouter<Arc<ServerState>>,
}

/// The origins whose scripts may read the responses of a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origins {
    /// The server's own page.
    Same,
    /// Every page.
    Any,
    /// Those that the operator allows; the route checks `Origin` itself.
    Allowed,
}

impl Route {
    /// A route with the answer to OPTIONS that its origins need.
    fn new(path: &'static str, origins: Origins, methods: MethodRouter<Arc<ServerState>>) -> Self {
        let methods = match origins {
            Origins::Any => cors::with_preflight(methods),
            Origins::Same => methods
                .options(|| async { (StatusCode::NO_CONTENT, [(header::ALLOW, "GET, HEAD, OPTIONS")]) }),
            Origins::Allowed => methods,
        };
        Self { path, origins, methods }
    }
}

/// All routes of a server, in the order of the document.
pub fn routes() -> Vec<Route> {
    use Origins::{Allowed, Any, Same};
    vec![
        Route::new("/", Same, get(page::index)),
        Route::new("/page/{name}", Same, get(page::file)),
        Route::new("/openapi.json", Any, get(openapi::get)),
        Route::new("/v1/world", Any, get(world::get)),
        Route::new("/v1/{digest}/chunk/{level}/{x}/{z}", Any, get(chunk::get)),
        Route::new("/v1/{digest}/map/{level}/{x}/{z}", Any, get(map::get)),
        Route::new("/v1/{digest}/height/{x}/{z}", Any, get(height::get)),
        Route::new("/v1/live", Same, get(live::get)),
        Route::new("/v1/stream", Allowed, any(session::stream)),
        Route::new(PROBES[0], Same, get(health::livez)),
        Route::new(PROBES[1], Same, get(health::readyz)),
        Route::new("/metrics", Same, get(health::metrics)),
    ]
}

/// The router of a server.
pub fn router(state: Arc<ServerState>) -> Router {
    state.metrics.limits.declare_http_rejections(ProblemKind::ALL.map(ProblemKind::name));
    let routes = routes();
    let any_origin = routes.iter().filter(|route| route.origins == Origins::Any);
    let any_origin: Arc<[_]> = any_origin.map(|route| route.path).collect();
    let mut router = Router::new();
    for Route { path, methods, .. } in routes {
        router = router.route(path, methods);
    }
    router
        .fallback(|| async {
            Problem::new(ProblemKind::NoRoute, "no such route; see GET /v1/world and GET /openapi.json")
        })
        .method_not_allowed_fallback(|method: Method| async move {
            let mut response =
                Problem::new(ProblemKind::WrongMethod, format!("this path does not support {method}"))
                    .into_response();
            response.headers_mut().insert(header::ALLOW, HeaderValue::from_static("GET, HEAD, OPTIONS"));
            response
        })
        .layer(middleware::from_fn_with_state(Arc::clone(&state), known_host))
        .layer(middleware::from_fn_with_state(Arc::clone(&state), count))
        // Outside of both, so that a script can read their rejections.
        .layer(middleware::from_fn_with_state(any_origin, cors::allow))
        .with_state(state)
}

/// Rejects requests for other host names: a page whose name was pointed at this server (DNS
/// rebinding) must not read what its visitor may read.
async fn known_host(
    State(state): State<Arc<ServerState>>,
    mut request: Request,
    next: Next,
) -> Result<Response, Problem> {
    let target = Target::of(request.uri(), request.headers(), request.version());
    let target = target.map_err(|MalformedHost| {
        Problem::new(ProblemKind::Malformed, "`Host` must be one host name or address, with or without port")
    })?;
    if let Some(target) = target {
        if !state.config.allowed_hosts.allows(&target) {
            let client = request.extensions().get::<ClientAddress>().map(|client| client.0);
            state.peer_log.report(client, "unknown host name");
            let detail = format!("{} is no name of this server; see its option allowed-host", target.shown());
            return Err(Problem::new(ProblemKind::UnknownHost, detail));
        }
        request.extensions_mut().insert(target);
    }
    Ok(next.run(request).await)
}

/// The place of a request that is being answered. Behind a proxy a client is not limited by its
/// connections; here it is by its requests, likewise.
struct RequestPlace<'a> {
    _permit: SemaphorePermit<'a>,
    _of_client: IpPermit,
}

impl<'a> RequestPlace<'a> {
    fn take(state: &'a ServerState, client: Option<IpAddr>) -> Result<Self, Problem> {
        let Ok(permit) = state.request_permits.try_acquire() else {
            return Err(Problem::new(ProblemKind::TooManyRequests, "too many requests at once, retry later"));
        };
        let free = state.request_permits.available_permits();
        let Some(of_client) = state.requests_per_ip.try_acquire(client, free) else {
            let sentence = "too many requests of this address at once, retry later";
            return Err(Problem::new(ProblemKind::AddressFull, sentence));
        };
        Ok(Self { _permit: permit, _of_client: of_client })
    }
}

/// Routes without a place: they never wait, and clients of their address must not make a probe
/// fail.
const PROBES: [&str; 2] = ["/livez", "/readyz"];

/// Counts all responses, and rejected requests by kind.
async fn count(State(state): State<Arc<ServerState>>, request: Request, next: Next) -> Response {
    // A connection answers up to 16 requests that arrived together before it lets others run.
    tokio::task::yield_now().await;
    let client = request.extensions().get::<ClientAddress>().map(|client| client.0);
    let needs_place = !PROBES.contains(&request.uri().path());
    let mut response = match needs_place.then(|| RequestPlace::take(&state, client)).transpose() {
        Ok(_place) => next.run(request).await,
        Err(problem) => problem.into_response(),
    };
    state.metrics.http.responded(response.status().as_u16());
    if let Some(kind) = response.extensions().get::<ProblemKind>() {
        state.metrics.limits.http_request_rejected(kind.name());
    }
    // Browsers must not guess another content type.
    response.headers_mut().insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ServerConfig;
    use axum::body::Body;
    use std::net::Ipv4Addr;
    use tower::ServiceExt;

    #[tokio::test]
    async fn a_probe_is_answered_where_its_address_has_no_place_for_a_request() {
        let config =
            ServerConfig { threads: 1, max_sessions_per_address: Some(1), ..ServerConfig::default() };
        let state = Arc::new(ServerState::new(config).unwrap());
        let client = IpAddr::from(Ipv4Addr::new(192, 0, 2, 1));
        let places: Vec<_> =
            std::iter::from_fn(|| state.requests_per_ip.try_acquire(Some(client), 0)).collect();
        assert!(!places.is_empty());
        for (path, status) in [("/v1/world", 503), ("/livez", 200), ("/readyz", 200)] {
            let request =
                Request::get(path).header(header::HOST, "localhost").extension(ClientAddress(client));
            let request = request.body(Body::empty()).unwrap();
            let response = router(Arc::clone(&state)).oneshot(request).await.unwrap();
            assert_eq!(response.status(), status, "{path}");
        }
    }
}
