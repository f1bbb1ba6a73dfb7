//! The options as they are given: on the command line, in the environment, in the file.

use crate::access::ProtectedRoute;
use crate::bake::BakeArgs;
use crate::mechanism::Mechanism;
use crate::proxy::ProxyHeader;
use clap::{Parser, Subcommand};
use serde::Deserialize;
use std::path::PathBuf;

/// Streams a procedural archipelago to viewers over WebSocket and HTTP.
///
/// Every option can also be set by an environment variable or in the configuration file; a flag
/// wins over the environment, the environment over the file.
#[derive(Clone, Debug, Default, Parser)]
#[command(name = "tombolo-server", version, args_conflicts_with_subcommands = true)]
#[command(allow_negative_numbers = true)]
pub struct Args {
    /// Another job than to serve.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Options that the configuration file can set too.
    #[command(flatten)]
    pub options: Options,
    /// TOML file with any of the options above, named as here without the dashes
    #[arg(long, value_name = "FILE", env = "TOMBOLO_CONFIG")]
    pub config: Option<PathBuf>,
    /// Former name of --rate-limit-ms.
    #[arg(long, value_name = "MS", env = "TOMBOLO_COST_PER_SECOND", hide = true)]
    pub cost_per_second: Option<u64>,
    /// For measurements only: the mechanism against overload that is turned off. Neither in the
    /// environment nor in the file.
    #[arg(long, value_name = "NAME", value_enum, hide = true)]
    pub measure_without: Option<Mechanism>,
}

/// Options of the command line, the environment and the configuration file. All may be absent.
#[derive(Clone, Debug, Default, clap::Args, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields, default)]
pub struct Options {
    /// Address and port to listen on; port 0 picks a free one and prints it. Beyond the loopback it
    /// needs --tls-cert, --trusted-proxy or --insecure [default: 127.0.0.1:7580]
    #[arg(long, value_name = "ADDR", env = "TOMBOLO_LISTEN")]
    pub listen: Option<String>,
    /// Seed of the world, 0 to 18446744073709551615 [default: 1]
    #[arg(long, value_name = "N", env = "TOMBOLO_WORLD_SEED", value_parser = whole::<u64>(0, u64::MAX))]
    pub world_seed: Option<u64>,
    /// Threads that generate chunks, 1 to 1024 [default: one per core]
    #[arg(long, value_name = "N", env = "TOMBOLO_THREADS", value_parser = whole::<usize>(1, 1024))]
    pub threads: Option<usize>,
    /// Memory for encoded chunks in MiB, 1 to 65536; map tiles get an eighth of it in addition
    /// [default: 128, or an eighth of the memory that the process may use if that is less]
    #[arg(long, value_name = "N", env = "TOMBOLO_CACHE_MB", value_parser = whole::<u64>(1, 65_536))]
    pub cache_mb: Option<u64>,
    /// Folder of the disk cache for chunks of level 2 and coarser; without it there is no disk
    /// cache
    #[arg(long, value_name = "DIR", env = "TOMBOLO_DISK_CACHE")]
    pub disk_cache: Option<PathBuf>,
    /// Size of the disk cache in MiB, 64 to 262144 [default: 1024]
    #[arg(long, value_name = "N", env = "TOMBOLO_DISK_MB", value_parser = whole::<u64>(64, 262_144))]
    pub disk_mb: Option<u64>,
    /// Store of chunks that all replicas of a world share: a folder, file:///FOLDER,
    /// s3://BUCKET/PREFIX, gs://BUCKET/PREFIX or az://CONTAINER/PREFIX; settings of its engine in
    /// the environment, such as AWS_ENDPOINT [default: none]
    #[arg(long, value_name = "URL", env = "TOMBOLO_STORE")]
    pub store: Option<String>,
    /// Least time that a chunk waits for the store in milliseconds, 0 to 10000, though making it
    /// would be quicker [default: 0]
    #[arg(long, value_name = "MS", env = "TOMBOLO_STORE_WAIT_MS", value_parser = whole::<u64>(0, 10_000))]
    pub store_wait_ms: Option<u64>,
    /// Listen beyond the loopback without TLS: machines on the way can read tokens and positions
    #[arg(long, value_name = "BOOL", env = "TOMBOLO_INSECURE", num_args = 0..=1, require_equals = true,
          default_missing_value = "true")]
    pub insecure: Option<bool>,
    /// Certificate chain in PEM, read again on SIGHUP and after a change; with --tls-key the server
    /// speaks TLS only
    #[arg(long, value_name = "FILE", env = "TOMBOLO_TLS_CERT")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate in PEM
    #[arg(long, value_name = "FILE", env = "TOMBOLO_TLS_KEY")]
    pub tls_key: Option<PathBuf>,
    /// Host name under which clients reach the server, or `*` for any; may be repeated. IP
    /// addresses and names of the loopback are always allowed
    #[arg(long, value_name = "NAME", env = "TOMBOLO_ALLOWED_HOST", value_delimiter = ',')]
    pub allowed_host: Vec<String>,
    /// Origin of other web pages that may open sessions, such as `https://map.example`, or `*` for
    /// any; may be repeated. The server's own page is always allowed
    #[arg(long, value_name = "ORIGIN", env = "TOMBOLO_ALLOWED_ORIGIN", value_delimiter = ',')]
    pub allowed_origin: Vec<String>,
    /// Address or network (CIDR) of a proxy whose --proxy-header names the client; may be repeated
    #[arg(long, value_name = "CIDR", env = "TOMBOLO_TRUSTED_PROXY", value_delimiter = ',')]
    pub trusted_proxy: Vec<String>,
    /// Where trusted proxies name the client [default: x-forwarded-for]
    #[arg(long, value_name = "NAME", env = "TOMBOLO_PROXY_HEADER", value_enum)]
    pub proxy_header: Option<ProxyHeader>,
    /// File with the access tokens of clients, read again on SIGHUP and after a change: one token
    /// in its first line, or a list in TOML; without the option no token is required
    #[arg(long, value_name = "FILE", env = "TOMBOLO_TOKEN_FILE")]
    pub token_file: Option<PathBuf>,
    /// Route that requires a token too, otherwise open; may be repeated
    #[arg(long, value_name = "ROUTE", env = "TOMBOLO_PROTECT", value_enum, value_delimiter = ',')]
    pub protect: Vec<ProtectedRoute>,
    /// Concurrent sessions, 1 to 100000; one more is rejected with 503 [default: 1024]
    #[arg(long, value_name = "N", env = "TOMBOLO_MAX_SESSIONS", value_parser = whole::<usize>(1, 100_000))]
    pub max_sessions: Option<usize>,
    /// Concurrent sessions per IPv4 address or IPv6 /64 network, 1 to 100000; one more is rejected
    /// with 503 [default: as many as remain free, so half of --max-sessions for a single address]
    #[arg(long, value_name = "N", env = "TOMBOLO_MAX_SESSIONS_PER_ADDRESS",
          value_parser = whole::<usize>(1, 100_000))]
    pub max_sessions_per_address: Option<usize>,
    /// Rate limit per IPv4 address or IPv6 /64 network: milliseconds of work (chunks generated,
    /// bytes sent) per second, 1 to 1000000; 1000 is one thread [default: no limit]
    #[arg(long, value_name = "MS", env = "TOMBOLO_RATE_LIMIT_MS", value_parser = whole::<u64>(1, 1_000_000))]
    #[serde(alias = "cost-per-second")]
    pub rate_limit_ms: Option<u64>,
    /// Longest wait of a requested chunk for its generation in milliseconds, 10 to 60000; a request
    /// that would wait longer is rejected as overloaded [default: 500]
    #[arg(long, value_name = "MS", env = "TOMBOLO_DEADLINE_MS", value_parser = whole::<u64>(10, 60_000))]
    pub deadline_ms: Option<u64>,
    /// Address of a collector of OpenTelemetry, OTLP over HTTP, to which traces of chunks go, such
    /// as http://127.0.0.1:4318/v1/traces [default: none]
    #[arg(long, value_name = "URL", env = "TOMBOLO_OTLP")]
    pub otlp: Option<String>,
    /// Trace one requested chunk of so many, 0 to 1000000000; 0 is only those whose client names a
    /// recorded trace in traceparent [default: 1000]
    #[arg(long, value_name = "N", env = "TOMBOLO_TRACE_EVERY",
          value_parser = whole::<u64>(0, 1_000_000_000))]
    pub trace_every: Option<u64>,
    /// Log filter: off, error, warn, info, debug, trace, or per module as in `info,server=debug`
    /// [default: info]
    #[arg(long, value_name = "FILTER", env = "TOMBOLO_LOG")]
    pub log: Option<String>,
    /// Log lines as JSON instead of text
    #[arg(long, value_name = "BOOL", env = "TOMBOLO_LOG_JSON", num_args = 0..=1, require_equals = true,
          default_missing_value = "true")]
    pub log_json: Option<bool>,
}

impl Options {
    /// The options without those of empty text: deployments pass on variables that may be empty.
    /// Options that protect the server stay, so that a forgotten file of tokens is an error.
    #[must_use]
    pub fn without_empty(mut self) -> Self {
        for text in [&mut self.store, &mut self.otlp, &mut self.log] {
            text.take_if(|text| text.is_empty());
        }
        self.disk_cache.take_if(|folder| folder.as_os_str().is_empty());
        self
    }
}

/// Jobs beside serving.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Makes all chunks of a region and puts them into a store, from which servers then read them
    Bake(BakeArgs),
}

/// A whole number within a range. The error names the range; clap adds option and value.
fn whole<T: TryFrom<u64>>(low: u64, high: u64) -> impl Fn(&str) -> Result<T, String> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| (low..=high).contains(number));
        let number = number.and_then(|number| T::try_from(number).ok());
        number.ok_or_else(|| format!("give a whole number, {low} to {high}"))
    }
}
