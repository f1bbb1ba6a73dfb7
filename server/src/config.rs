//! Configuration: command line over environment over file over defaults, validated once.

mod options;
#[cfg(test)]
mod tests;

use crate::access::ProtectedRoute;
use crate::access::hosts::{AllowedHosts, AllowedOrigins};
use crate::access::tokens::{TokenFile, TokenSet};
use crate::cache::disk::DiskConfig;
use crate::limits::per_ip::PerIpLimiter;
use crate::mechanism::Mechanism;
use crate::memory::{self, MemoryLimit};
use crate::proxy::TrustedProxies;
use crate::store::{StoreAddress, StoreConfig};
use crate::tls::Tls;
use crate::traces::TraceConfig;
use cli::UsageError;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tracing::Level;
use tracing_subscriber::filter::Targets;
use url::Url;

pub use options::{Args, Command, Options};

/// The default address of clients.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:7580";
const DEFAULT_DISK_MB: u64 = 1024;
const DEFAULT_MAX_SESSIONS: usize = 1024;
/// Connections in addition to sessions: probes, metrics and downloads.
pub const EXTRA_CONNECTIONS: usize = 256;

/// Connections per client network in addition to its sessions: a quarter, so that one network
/// cannot take all.
const EXTRA_CONNECTIONS_PER_IP: usize = EXTRA_CONNECTIONS / 4;
/// Milliseconds.
const DEFAULT_DEADLINE_MS: u64 = 500;
const DEFAULT_LOG: &str = "info";
const DEFAULT_TRACE_EVERY: u64 = 1000;

/// The configuration of a server. Every value is valid.
#[derive(Clone, Debug)]
pub struct ServerConfig {
    /// Address that `main` binds; [`crate::run`] takes a bound listener and ignores it.
    pub listen: SocketAddr,
    /// Seed of the world.
    pub world_seed: u64,
    /// Threads that generate chunks.
    pub threads: usize,
    /// Memory for encoded chunks, bytes.
    pub cache_bytes: u64,
    /// Memory that the process may use; none if that is not known.
    pub memory: Option<MemoryLimit>,
    /// Disk cache; none for no disk cache.
    pub disk: Option<DiskConfig>,
    /// Shared store; none for no store.
    pub store: Option<StoreConfig>,
    /// Certificate and key; none for plain text.
    pub tls: Option<Arc<Tls>>,
    /// Host names that requests may be sent to.
    pub allowed_hosts: AllowedHosts,
    /// Origins of other pages that may open sessions.
    pub allowed_origins: AllowedOrigins,
    /// Proxies that name their clients.
    pub proxies: TrustedProxies,
    /// Access tokens of clients; none if no token is required.
    pub tokens: Option<TokenSet>,
    /// The file that they are read from again; none for tokens that never change.
    pub token_file: Option<TokenFile>,
    /// Routes that require a token too.
    pub protected: Vec<ProtectedRoute>,
    /// Concurrent sessions. One more is rejected before its upgrade with 503 and `Retry-After`.
    pub max_sessions: usize,
    /// Concurrent sessions per client network, one more is rejected likewise; none for no more than
    /// the sessions that remain free.
    pub max_sessions_per_address: Option<usize>,
    /// Milliseconds of work per second and client network; none for no limit.
    pub rate_limit_ms: Option<u64>,
    /// Longest wait of a requested chunk for its generation.
    pub deadline: Duration,
    /// Generation jobs queued or running. One more is rejected as overloaded. None for as many as
    /// sessions, downloads and map tiles can have requested ([`ServerConfig::job_limit`]).
    pub max_jobs: Option<usize>,
    /// Time for the handshake, and for the headers of an HTTP request.
    pub handshake_timeout: Duration,
    /// Time from the first byte of a session's message to its last.
    pub message_timeout: Duration,
    /// Timeout of a write to a client.
    pub write_timeout: Duration,
    /// Idle time after which a client is pinged; after three times as long it is closed.
    pub ping_interval: Duration,
    /// Time for open sessions to end on shutdown.
    pub drain_timeout: Duration,
    /// The mechanism that is turned off, for measurements.
    pub without: Option<Mechanism>,
    /// Where traces go; none for no traces.
    pub traces: Option<TraceConfig>,
    /// Log filter.
    pub log: String,
    /// Whether log lines are JSON.
    pub log_json: bool,
}

impl Default for ServerConfig {
    /// The documented defaults: loopback, world 1, no token.
    fn default() -> Self {
        let memory = MemoryLimit::of_process();
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 7580)),
            world_seed: 1,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            cache_bytes: memory::default_cache_mb(memory.as_ref()) << 20,
            memory,
            disk: None,
            store: None,
            tls: None,
            allowed_hosts: AllowedHosts::default(),
            allowed_origins: AllowedOrigins::default(),
            proxies: TrustedProxies::default(),
            tokens: None,
            token_file: None,
            protected: Vec::new(),
            max_sessions: DEFAULT_MAX_SESSIONS,
            max_sessions_per_address: None,
            rate_limit_ms: None,
            deadline: Duration::from_millis(DEFAULT_DEADLINE_MS),
            max_jobs: None,
            handshake_timeout: Duration::from_secs(5),
            message_timeout: Duration::from_secs(5),
            write_timeout: Duration::from_secs(10),
            ping_interval: Duration::from_secs(20),
            drain_timeout: Duration::from_secs(5),
            without: None,
            traces: None,
            log: DEFAULT_LOG.into(),
            log_json: false,
        }
    }
}

impl ServerConfig {
    /// Generation jobs that may be queued or running. No number of peers fills the default: each
    /// session has 16 at most, each connection one, and the map's tiles 8 each. At most 96 tiles
    /// are made at a time, however many threads there are.
    #[must_use]
    pub fn job_limit(&self) -> usize {
        self.max_jobs.unwrap_or_else(|| self.max_sessions.saturating_mul(16 + 1).saturating_add(1024))
    }

    /// Connections that may be open, those of sessions aside.
    #[must_use]
    pub const fn max_connections(&self) -> usize {
        self.max_sessions.saturating_add(EXTRA_CONNECTIONS)
    }

    /// Counts what a client network has of them: connections, or requests behind a proxy. With a
    /// limit of its sessions, `EXTRA_CONNECTIONS_PER_IP` more than those.
    #[must_use]
    pub fn connections_per_ip(&self) -> PerIpLimiter {
        match self.max_sessions_per_address {
            Some(sessions) => PerIpLimiter::new(sessions.saturating_add(EXTRA_CONNECTIONS_PER_IP)),
            None => PerIpLimiter::fair_share(self.max_connections()),
        }
    }

    /// Whether there are files that a running server reads again.
    #[must_use]
    pub const fn has_files(&self) -> bool {
        self.token_file.is_some() || self.tls.is_some()
    }
}

impl Args {
    /// Reads the configuration file, if any, and validates all values.
    ///
    /// # Errors
    /// An unreadable or malformed file, an unknown key in it, or a value out of range.
    pub fn resolve(self) -> Result<ServerConfig, UsageError> {
        let file = self.config.as_deref().map_or_else(|| Ok(Options::default()), read_file)?;
        self.resolve_over(file)
    }

    /// As [`Args::resolve`], over the options of a configuration file that was read.
    ///
    /// # Errors
    /// A value out of range, or a file named by an option that cannot be read.
    pub fn resolve_over(self, file: Options) -> Result<ServerConfig, UsageError> {
        self.resolve_with(file, ServerConfig::default())
    }

    /// As [`Args::resolve_over`], with known defaults: some of [`ServerConfig::default`] take reads
    /// of the system.
    ///
    /// # Errors
    /// As [`Args::resolve_over`].
    pub fn resolve_with(self, file: Options, defaults: ServerConfig) -> Result<ServerConfig, UsageError> {
        let (given, file) = (self.options.without_empty(), file.without_empty());
        let listen: SocketAddr = match given.listen.or(file.listen) {
            Some(text) => text.parse().map_err(|_| {
                UsageError::new(format!(
                    "listen: `{text}` is not an address; give ADDR:PORT such as {DEFAULT_LISTEN}"
                ))
            })?,
            None => defaults.listen,
        };
        let threads = given.threads.or(file.threads).unwrap_or(defaults.threads);
        let cache_mb = given.cache_mb.or(file.cache_mb).unwrap_or(defaults.cache_bytes >> 20);
        let disk_mb = given.disk_mb.or(file.disk_mb);
        let disk_folder = given.disk_cache.or(file.disk_cache);
        let max_sessions = given.max_sessions.or(file.max_sessions).unwrap_or(DEFAULT_MAX_SESSIONS);
        in_range("threads", threads as u64, 1, 1024)?;
        in_range("cache-mb", cache_mb, 1, 65_536)?;
        in_range("disk-mb", disk_mb.unwrap_or(DEFAULT_DISK_MB), 64, 262_144)?;
        if let (None, Some(given)) = (&disk_folder, disk_mb) {
            return Err(UsageError::new(format!(
                "disk-mb: {given} MiB without a folder; give disk-cache DIR too, or remove disk-mb"
            )));
        }
        in_range("max-sessions", max_sessions as u64, 1, 100_000)?;
        let max_sessions_per_address = given.max_sessions_per_address.or(file.max_sessions_per_address);
        in_range("max-sessions-per-address", max_sessions_per_address.unwrap_or(1) as u64, 1, 100_000)?;
        let rate_limit_ms = given.rate_limit_ms.or(self.cost_per_second).or(file.rate_limit_ms);
        in_range("rate-limit-ms", rate_limit_ms.unwrap_or(1), 1, 1_000_000)?;
        let deadline_ms = given.deadline_ms.or(file.deadline_ms).unwrap_or(DEFAULT_DEADLINE_MS);
        in_range("deadline-ms", deadline_ms, 10, 60_000)?;
        let otlp = given.otlp.or(file.otlp);
        let log = given.log.or(file.log).unwrap_or(defaults.log);
        log_filter(&log)?;
        let tls = Tls::of_options(given.tls_cert.or(file.tls_cert), given.tls_key.or(file.tls_key))?;
        let proxies = TrustedProxies::parse(
            &either_text(given.trusted_proxy, file.trusted_proxy),
            given.proxy_header.or(file.proxy_header),
        )?;
        let is_insecure = given.insecure.or(file.insecure).unwrap_or(false);
        refuse_plain_text(listen, is_insecure || tls.is_some() || proxies.any())?;
        let token_file = given.token_file.or(file.token_file).map(TokenFile::new);
        let protected = either(given.protect, file.protect);
        if let (None, Some(route)) = (&token_file, protected.first()) {
            return Err(UsageError::new(format!(
                "protect: {route} without a token; give token-file FILE too, or remove protect"
            )));
        }
        Ok(ServerConfig {
            listen,
            world_seed: given.world_seed.or(file.world_seed).unwrap_or(defaults.world_seed),
            threads,
            cache_bytes: cache_mb << 20,
            disk: disk_folder
                .map(|folder| DiskConfig { folder, bytes: disk_mb.unwrap_or(DEFAULT_DISK_MB) << 20 }),
            store: store(given.store.or(file.store), given.store_wait_ms.or(file.store_wait_ms))?,
            tls,
            allowed_hosts: AllowedHosts::parse(&either_text(given.allowed_host, file.allowed_host))?,
            allowed_origins: AllowedOrigins::parse(&either_text(given.allowed_origin, file.allowed_origin))?,
            proxies,
            tokens: token_file.as_ref().map(TokenFile::read).transpose()?,
            token_file,
            protected,
            max_sessions,
            max_sessions_per_address,
            rate_limit_ms,
            deadline: Duration::from_millis(deadline_ms),
            without: self.measure_without,
            traces: traces(otlp, given.trace_every.or(file.trace_every))?,
            log,
            log_json: given.log_json.or(file.log_json).unwrap_or(defaults.log_json),
            ..defaults
        })
    }
}

/// The traces of an address and a share.
fn traces(address: Option<String>, every: Option<u64>) -> Result<Option<TraceConfig>, UsageError> {
    in_range("trace-every", every.unwrap_or(0), 0, 1_000_000_000)?;
    let Some(address) = address else {
        return every.map_or(Ok(None), |_| {
            Err(UsageError::new("trace-every: there is no collector; give otlp URL too, or remove it"))
        });
    };
    // The invalid part may be a password, which no error should show.
    let wrong = || {
        UsageError::new("otlp: not an address of OTLP over HTTP; give http://HOST:4318/v1/traces or https")
    };
    let mut endpoint = Url::parse(&address).map_err(|_| wrong())?;
    if !matches!(endpoint.scheme(), "http" | "https") {
        return Err(wrong());
    }
    if !endpoint.username().is_empty() || endpoint.password().is_some() {
        return Err(UsageError::new(
            "otlp: credentials belong into OTEL_EXPORTER_OTLP_HEADERS, not into the address",
        ));
    }
    if endpoint.path() == "/" {
        endpoint.set_path("v1/traces");
    }
    Ok(Some(TraceConfig { endpoint, every: every.unwrap_or(DEFAULT_TRACE_EVERY) }))
}

/// The store of an address and a wait.
fn store(address: Option<String>, wait_ms: Option<u64>) -> Result<Option<StoreConfig>, UsageError> {
    in_range("store-wait-ms", wait_ms.unwrap_or(0), 0, 10_000)?;
    let Some(address) = address else {
        return wait_ms.map_or(Ok(None), |_| {
            Err(UsageError::new("store-wait-ms: there is no store; give store URL too, or remove it"))
        });
    };
    let invalid = |why| UsageError::new(format!("store: {why}"));
    let address = StoreAddress::parse(&address).map_err(invalid)?;
    // Nothing is sent yet; settings that no store can have are an error of the start, as is a
    // folder that does not exist.
    address.open().map_err(invalid)?;
    Ok(Some(StoreConfig { address, wait: Duration::from_millis(wait_ms.unwrap_or(0)) }))
}

/// The list of the command line or environment, or else that of the file.
fn either<T>(given: Vec<T>, file: Vec<T>) -> Vec<T> {
    if given.is_empty() { file } else { given }
}

/// As [`either`], without blanks around the texts and without empty ones: lists in variables may
/// have blanks and commas at their ends.
fn either_text(given: Vec<String>, file: Vec<String>) -> Vec<String> {
    let texts = either(given, file).into_iter().map(|text| text.trim().to_owned());
    texts.filter(|text| !text.is_empty()).collect()
}

/// Beyond the loopback, plain text has to be asked for.
fn refuse_plain_text(listen: SocketAddr, is_allowed: bool) -> Result<(), UsageError> {
    if is_allowed || listen.ip().to_canonical().is_loopback() {
        return Ok(());
    }
    Err(UsageError::new(format!(
        "listen: {listen} is reachable from other machines, which could read tokens and positions on \
         the way; give tls-cert and tls-key, or trusted-proxy CIDR of the proxy in front, or insecure"
    )))
}

/// The filter of log lines. A single word is a level: as the name of a module it would turn all
/// lines off.
///
/// # Errors
/// It is no filter.
pub fn log_filter(text: &str) -> Result<Targets, UsageError> {
    let allowed = "give off, error, warn, info, debug, trace, or per module as in info,server=debug";
    for part in text.split(',').map(str::trim) {
        let is_level = part.eq_ignore_ascii_case("off") || part.parse::<Level>().is_ok();
        if !part.contains('=') && !is_level {
            return Err(UsageError::new(format!("log: `{text}`: `{part}` is no level; {allowed}")));
        }
    }
    text.parse().map_err(|error| UsageError::new(format!("log: `{text}` is no filter ({error}); {allowed}")))
}

fn in_range(option: &str, value: u64, low: u64, high: u64) -> Result<(), UsageError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(UsageError::new(format!("{option}: {value} is out of range; give {low} to {high}")))
}

fn read_file(path: &Path) -> Result<Options, UsageError> {
    let shown = path.display();
    let text = std::fs::read_to_string(path)
        .map_err(|error| UsageError::new(format!("config: cannot read `{shown}`: {error}")))?;
    parse_file(&text, &shown.to_string())
}

/// The options of a configuration file, from its text; `name` is for messages.
///
/// # Errors
/// A malformed text or an unknown key: one line with the line's number.
pub fn parse_file(text: &str, name: &str) -> Result<Options, UsageError> {
    toml::from_str(text).map_err(|error| {
        let line = error.span().map_or(1, |span| text[..span.start].lines().count().max(1));
        // Errors of programs are one line.
        let message = error.message().lines().collect::<Vec<_>>().join(" ");
        UsageError::new(format!("config: {name} line {line}: {message}"))
    })
}
