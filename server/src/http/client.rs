//! The sender of a request: address, headers and access token.

use crate::access::gate::{Presenter, Refusal};
use crate::access::hosts::Target;
use crate::http::problem::{Problem, ProblemKind};
use crate::proxy::ClientAddress;
use crate::state::ServerState;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use std::convert::Infallible;
use std::net::IpAddr;

/// The client of a request. Extracting it checks nothing.
#[derive(Debug)]
pub struct Client {
    /// Its address; none without a connection.
    pub address: Option<IpAddr>,
    /// Headers of the request.
    pub headers: HeaderMap,
    /// Where it was sent; none without `Host`.
    target: Option<Target>,
}

impl<S: Sync> FromRequestParts<S> for Client {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        let address = parts.extensions.get::<ClientAddress>().map(|client| client.0);
        let target = parts.extensions.get::<Target>().cloned();
        Ok(Self { address, headers: parts.headers.clone(), target })
    }
}

impl Client {
    /// Accepts a request with an access token, or any request if none is required.
    ///
    /// # Errors
    /// The token is missing, wrong or expired, or the address has guessed too often.
    pub fn authorise(&self, state: &ServerState) -> Result<(), Problem> {
        let is_allowed = state.config.allowed_origins.allows(&self.headers, self.target.as_ref());
        let presenter = if is_allowed { Presenter::Client } else { Presenter::OtherPage };
        state.gate.check(self.address, presenter, bearer(&self.headers)).map_err(problem)
    }
}

/// The token of `Authorization`.
#[must_use]
pub fn bearer(headers: &HeaderMap) -> Option<&str> {
    let value = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, token) = value.split_once(' ')?;
    // The scheme is case-insensitive: RFC 9110, section 11.1.
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim_start_matches(' '))
}

/// The problem document for a client that is not admitted.
#[must_use]
pub fn problem(refusal: Refusal) -> Problem {
    let (kind, detail) = match refusal {
        Refusal::Missing => {
            (ProblemKind::Unauthorised, "send an access token as `Authorization: Bearer TOKEN`")
        }
        Refusal::Wrong => (ProblemKind::Unauthorised, "this access token is not known here"),
        Refusal::Expired => (ProblemKind::Unauthorised, "this access token has expired"),
        Refusal::Throttled => {
            (ProblemKind::TooManyGuesses, "too many wrong tokens from this address, retry in a minute")
        }
    };
    Problem::new(kind, detail)
}
