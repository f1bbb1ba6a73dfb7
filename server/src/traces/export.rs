//! The export of spans: OTLP over HTTP with protocol buffers.

use super::config::{TARGET, TraceConfig};
use opentelemetry::KeyValue;
use opentelemetry::trace::TracerProvider;
use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{Sampler, SdkTracer, SdkTracerProvider};
use std::time::Duration;
use tracing::{Level, Subscriber};
use tracing_opentelemetry::OpenTelemetryLayer;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::registry::LookupSpan;

/// Longest time of one export, and of the last one at the end.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Sends spans on a thread of its own, some seconds after their end. Its queue holds 2,048 spans; a
/// full one drops further ones.
#[derive(Debug)]
pub struct Exporter(SdkTracerProvider);

impl Exporter {
    /// Sends what is left, for at most 5 s.
    pub fn close(self) {
        if let Err(error) = self.0.shutdown_with_timeout(TIMEOUT) {
            tracing::warn!(%error, "the last spans were not exported");
        }
    }
}

/// A layer that exports the spans of traces, and its exporter.
///
/// # Errors
/// The exporter cannot start.
pub fn layer<S>(
    config: &TraceConfig,
    instance: String,
) -> Result<(impl Layer<S> + use<S>, Exporter), opentelemetry_otlp::ExporterBuildError>
where
    S: Subscriber + for<'span> LookupSpan<'span> + Send + Sync,
{
    // The exporter's client needs one even for plain HTTP. An error means that there is one.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let exporter = SpanExporter::builder()
        .with_http()
        .with_endpoint(config.endpoint.as_str())
        .with_protocol(Protocol::HttpBinary)
        .with_timeout(TIMEOUT)
        .build()?;
    let resource = Resource::builder()
        .with_service_name("tombolo-server")
        .with_attributes([
            KeyValue::new("service.instance.id", instance),
            KeyValue::new("service.version", env!("CARGO_PKG_VERSION")),
        ])
        .build();
    let provider = SdkTracerProvider::builder()
        .with_batch_exporter(exporter)
        .with_resource(resource)
        // Whether a chunk is traced was decided before its span.
        .with_sampler(Sampler::AlwaysOn)
        .build();
    let layer: OpenTelemetryLayer<S, SdkTracer> = tracing_opentelemetry::layer()
        .with_tracer(provider.tracer(TARGET))
        .with_location(false)
        .with_threads(false)
        .with_target(false)
        .with_level(false)
        .with_tracked_inactivity(false);
    Ok((layer.with_filter(Targets::new().with_target(TARGET, Level::INFO)), Exporter(provider)))
}
