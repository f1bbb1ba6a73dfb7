//! The trace that a peer names: W3C Trace Context, header `traceparent`.

use axum::http::HeaderMap;
use opentelemetry::Context;
use opentelemetry::propagation::{Extractor, TextMapPropagator};
use opentelemetry::trace::TraceContextExt;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use tracing::Span;
use tracing_opentelemetry::OpenTelemetrySpanExt;

/// A span of a peer, under which the chunks of its requests belong.
#[derive(Clone, Debug)]
pub struct Parent(Context);

impl Parent {
    /// The span that valid headers name, if the peer records it.
    #[must_use]
    pub fn of(headers: &HeaderMap) -> Option<Self> {
        let context = TraceContextPropagator::new().extract_with_context(&Context::new(), &Headers(headers));
        let is_recorded = {
            let span = context.span();
            span.span_context().is_valid() && span.span_context().is_sampled()
        };
        is_recorded.then_some(Self(context))
    }

    /// Makes a span its child.
    pub fn adopt(&self, span: &Span) {
        // An error means that spans are not exported.
        let _ = span.set_parent(self.0.clone());
    }

    /// Headers that name a span.
    #[cfg(test)]
    pub fn headers(headers: &[(&'static str, &str)]) -> HeaderMap {
        let headers = headers.iter().map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap()));
        headers.collect()
    }
}

/// Headers as the propagator reads them. `tracestate` is not read: it may have kilobytes, and each
/// span would hold them.
struct Headers<'a>(&'a HeaderMap);

impl Extractor for Headers<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        (key == "traceparent").then(|| self.0.get(key)?.to_str().ok())?
    }

    fn keys(&self) -> Vec<&str> {
        vec!["traceparent"]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_valid_and_recorded_trace_counts() {
        let is_some = |text| Parent::of(&Parent::headers(&[("traceparent", text)])).is_some();
        assert!(is_some("00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"));
        for other in [
            // Not recorded.
            "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-00",
            // No trace, no span.
            "00-00000000000000000000000000000000-b7ad6b7169203331-01",
            "00-0af7651916cd43dd8448eb211c80319c-0000000000000000-01",
            // Malformed.
            "00-0AF7651916CD43DD8448EB211C80319C-b7ad6b7169203331-01",
            "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331",
            "ff-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01",
            "",
        ] {
            assert!(!is_some(other), "{other}");
        }
        assert!(Parent::of(&HeaderMap::new()).is_none());
    }

    #[test]
    fn the_state_of_a_trace_is_not_kept() {
        let named = ("traceparent", "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01");
        let parent = Parent::of(&Parent::headers(&[named, ("tracestate", "vendor=kilobytes")])).unwrap();
        assert_eq!(parent.0.span().span_context().trace_state().header(), "");
    }
}
