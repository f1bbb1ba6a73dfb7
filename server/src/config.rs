//! Configuration: command line over environment over file over defaults, validated once.

use crate::bake::BakeArgs;
use crate::cache::disk::DiskConfig;
use crate::mechanism::Mechanism;
use crate::store::{StoreAddress, StoreConfig};
use clap::{Parser, Subcommand};
use cli::UsageError;
use serde::Deserialize;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The default address of clients.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:7580";
const DEFAULT_CACHE_MB: u64 = 128;
const DEFAULT_DISK_MB: u64 = 1024;
const DEFAULT_MAX_SESSIONS: usize = 1024;
/// Milliseconds.
const DEFAULT_DEADLINE_MS: u64 = 500;
const DEFAULT_LOG: &str = "info";

/// Streams a procedural archipelago to viewers over WebSocket and HTTP.
///
/// Every option can also be set by an environment variable or in the configuration file; a flag
/// wins over the environment, the environment over the file.
#[derive(Clone, Debug, Default, Parser)]
#[command(name = "tombolo-server", version, args_conflicts_with_subcommands = true)]
pub struct Args {
    /// Another job than to serve.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Address and port to listen on; port 0 picks a free one and prints it [default:
    /// 127.0.0.1:7580]
    #[arg(long, value_name = "ADDR", env = "TOMBOLO_LISTEN")]
    pub listen: Option<String>,
    /// Seed of the world, 0 to 18446744073709551615 [default: 1]
    #[arg(long, value_name = "N", env = "TOMBOLO_WORLD_SEED")]
    pub world_seed: Option<u64>,
    /// TOML file with any of these options, named as here without the dashes
    #[arg(long, value_name = "FILE", env = "TOMBOLO_CONFIG")]
    pub config: Option<PathBuf>,
    /// Threads that generate chunks, 1 to 1024 [default: one per core]
    #[arg(long, value_name = "N", env = "TOMBOLO_THREADS")]
    pub threads: Option<usize>,
    /// Memory for encoded chunks in MiB, 1 to 65536; map tiles get an eighth of it in addition
    /// [default: 128]
    #[arg(long, value_name = "N", env = "TOMBOLO_CACHE_MB")]
    pub cache_mb: Option<u64>,
    /// Folder of the disk cache for chunks of level 2 and coarser; without it there is no disk
    /// cache
    #[arg(long, value_name = "DIR", env = "TOMBOLO_DISK_CACHE")]
    pub disk_cache: Option<PathBuf>,
    /// Size of the disk cache in MiB, 64 to 262144 [default: 1024]
    #[arg(long, value_name = "N", env = "TOMBOLO_DISK_MB")]
    pub disk_mb: Option<u64>,
    /// Store of chunks that all replicas of a world share: a folder, file:///FOLDER,
    /// s3://BUCKET/PREFIX, gs://BUCKET/PREFIX or az://CONTAINER/PREFIX; settings of its engine in
    /// the environment, such as AWS_ENDPOINT [default: none]
    #[arg(long, value_name = "URL", env = "TOMBOLO_STORE")]
    pub store: Option<String>,
    /// Least time that a chunk waits for the store in milliseconds, 0 to 10000, though making it
    /// would be quicker [default: 0]
    #[arg(long, value_name = "MS", env = "TOMBOLO_STORE_WAIT_MS")]
    pub store_wait_ms: Option<u64>,
    /// File with the access token of clients in its first line; without it no token is required
    #[arg(long, value_name = "FILE", env = "TOMBOLO_TOKEN_FILE")]
    pub token_file: Option<PathBuf>,
    /// Concurrent sessions, 1 to 100000; one more is rejected with 503 [default: 1024]
    #[arg(long, value_name = "N", env = "TOMBOLO_MAX_SESSIONS")]
    pub max_sessions: Option<usize>,
    /// Concurrent sessions per IPv4 address or IPv6 /64 network, 1 to 100000; one more is rejected
    /// with 503 [default: as --max-sessions]
    #[arg(long, value_name = "N", env = "TOMBOLO_MAX_SESSIONS_PER_ADDRESS")]
    pub max_sessions_per_address: Option<usize>,
    /// Rate limit per IPv4 address or IPv6 /64 network: milliseconds of work (chunks generated,
    /// bytes sent) per second, 1 to 1000000; 1000 is one thread [default: no limit]
    #[arg(long, value_name = "MS", env = "TOMBOLO_RATE_LIMIT_MS")]
    pub rate_limit_ms: Option<u64>,
    /// Former name of --rate-limit-ms.
    #[arg(long, value_name = "MS", env = "TOMBOLO_COST_PER_SECOND", hide = true)]
    pub cost_per_second: Option<u64>,
    /// Longest wait of a requested chunk for its generation in milliseconds, 10 to 60000; a request
    /// that would wait longer is rejected as overloaded [default: 500]
    #[arg(long, value_name = "MS", env = "TOMBOLO_DEADLINE_MS")]
    pub deadline_ms: Option<u64>,
    /// For measurements only: the mechanism against overload that is turned off. Neither in the
    /// environment nor in the file.
    #[arg(long, value_name = "NAME", value_enum, hide = true)]
    pub measure_without: Option<Mechanism>,
    /// Log filter: error, warn, info, debug, trace, or per module as in `info,server=debug`
    /// [default: info]
    #[arg(long, value_name = "FILTER", env = "TOMBOLO_LOG")]
    pub log: Option<String>,
    /// Log lines as JSON instead of text
    #[arg(long, env = "TOMBOLO_LOG_JSON")]
    pub log_json: bool,
}

/// Jobs beside serving.
#[derive(Clone, Debug, Subcommand)]
pub enum Command {
    /// Makes all chunks of a region and puts them into a store, from which servers then read them
    Bake(BakeArgs),
}

/// The configuration file: the same options, all optional.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct File {
    listen: Option<String>,
    world_seed: Option<u64>,
    threads: Option<usize>,
    cache_mb: Option<u64>,
    disk_cache: Option<PathBuf>,
    disk_mb: Option<u64>,
    store: Option<String>,
    store_wait_ms: Option<u64>,
    token_file: Option<PathBuf>,
    max_sessions: Option<usize>,
    max_sessions_per_address: Option<usize>,
    #[serde(alias = "cost-per-second")]
    rate_limit_ms: Option<u64>,
    deadline_ms: Option<u64>,
    log: Option<String>,
    log_json: Option<bool>,
}

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
    /// Disk cache; none for no disk cache.
    pub disk: Option<DiskConfig>,
    /// Shared store; none for no store.
    pub store: Option<StoreConfig>,
    /// Access token of clients; none if no token is required.
    pub token: Option<String>,
    /// Concurrent sessions. One more is rejected before its upgrade with 503 and `Retry-After`.
    pub max_sessions: usize,
    /// Concurrent sessions per client network. One more is rejected likewise.
    pub max_sessions_per_address: usize,
    /// Milliseconds of work per second and client network; none for no limit.
    pub rate_limit_ms: Option<u64>,
    /// Longest wait of a requested chunk for its generation.
    pub deadline: Duration,
    /// Generation jobs queued or running. One more is rejected as overloaded.
    pub max_jobs: usize,
    /// Time for the handshake, and for the headers of an HTTP request.
    pub handshake_timeout: Duration,
    /// Timeout of a write to a client.
    pub write_timeout: Duration,
    /// Idle time after which a client is pinged; after three times as long it is closed.
    pub ping_interval: Duration,
    /// Time for open sessions to end on shutdown.
    pub drain_timeout: Duration,
    /// The mechanism that is turned off, for measurements.
    pub without: Option<Mechanism>,
    /// Log filter.
    pub log: String,
    /// Whether log lines are JSON.
    pub log_json: bool,
}

impl Default for ServerConfig {
    /// The documented defaults: loopback, world 1, no token.
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 7580)),
            world_seed: 1,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            cache_bytes: DEFAULT_CACHE_MB << 20,
            disk: None,
            store: None,
            token: None,
            max_sessions: DEFAULT_MAX_SESSIONS,
            max_sessions_per_address: DEFAULT_MAX_SESSIONS,
            rate_limit_ms: None,
            deadline: Duration::from_millis(DEFAULT_DEADLINE_MS),
            // A thousand sessions of 16 each.
            max_jobs: 16_384,
            handshake_timeout: Duration::from_secs(5),
            write_timeout: Duration::from_secs(10),
            ping_interval: Duration::from_secs(20),
            drain_timeout: Duration::from_secs(10),
            without: None,
            log: DEFAULT_LOG.into(),
            log_json: false,
        }
    }
}

impl Args {
    /// Reads the configuration file, if any, and validates all values.
    ///
    /// # Errors
    /// An unreadable or malformed file, an unknown key in it, or a value out of range.
    pub fn resolve(self) -> Result<ServerConfig, UsageError> {
        let file = self.config.as_deref().map_or(Ok(File::default()), read_file)?;
        let defaults = ServerConfig::default();
        let listen = match self.listen.or(file.listen) {
            Some(text) => text.parse().map_err(|_| {
                UsageError::new(format!(
                    "listen: `{text}` is not an address; give ADDR:PORT such as {DEFAULT_LISTEN}"
                ))
            })?,
            None => defaults.listen,
        };
        let threads = self.threads.or(file.threads).unwrap_or(defaults.threads);
        let cache_mb = self.cache_mb.or(file.cache_mb).unwrap_or(DEFAULT_CACHE_MB);
        let disk_mb = self.disk_mb.or(file.disk_mb);
        let disk_folder = self.disk_cache.or(file.disk_cache);
        let max_sessions = self.max_sessions.or(file.max_sessions).unwrap_or(DEFAULT_MAX_SESSIONS);
        in_range("threads", threads as u64, 1, 1024)?;
        in_range("cache-mb", cache_mb, 1, 65_536)?;
        in_range("disk-mb", disk_mb.unwrap_or(DEFAULT_DISK_MB), 64, 262_144)?;
        if let (None, Some(given)) = (&disk_folder, disk_mb) {
            return Err(UsageError::new(format!(
                "disk-mb: {given} MiB without a folder; give disk-cache DIR too, or remove disk-mb"
            )));
        }
        in_range("max-sessions", max_sessions as u64, 1, 100_000)?;
        let max_sessions_per_address =
            self.max_sessions_per_address.or(file.max_sessions_per_address).unwrap_or(max_sessions);
        in_range("max-sessions-per-address", max_sessions_per_address as u64, 1, 100_000)?;
        let rate_limit_ms = self.rate_limit_ms.or(self.cost_per_second).or(file.rate_limit_ms);
        in_range("rate-limit-ms", rate_limit_ms.unwrap_or(1), 1, 1_000_000)?;
        let deadline_ms = self.deadline_ms.or(file.deadline_ms).unwrap_or(DEFAULT_DEADLINE_MS);
        in_range("deadline-ms", deadline_ms, 10, 60_000)?;
        Ok(ServerConfig {
            listen,
            world_seed: self.world_seed.or(file.world_seed).unwrap_or(defaults.world_seed),
            threads,
            cache_bytes: cache_mb << 20,
            disk: disk_folder
                .map(|folder| DiskConfig { folder, bytes: disk_mb.unwrap_or(DEFAULT_DISK_MB) << 20 }),
            store: store(self.store.or(file.store), self.store_wait_ms.or(file.store_wait_ms))?,
            token: self
                .token_file
                .or(file.token_file)
                .as_deref()
                .map(|path| cli::read_token(path, protocol::limits::MAX_TEXT))
                .transpose()?,
            max_sessions,
            max_sessions_per_address,
            rate_limit_ms,
            deadline: Duration::from_millis(deadline_ms),
            without: self.measure_without,
            log: self.log.or(file.log).unwrap_or(defaults.log),
            log_json: self.log_json || file.log_json.unwrap_or(false),
            ..defaults
        })
    }
}

/// The store of an address and a wait.
fn store(address: Option<String>, wait_ms: Option<u64>) -> Result<Option<StoreConfig>, UsageError> {
    in_range("store-wait-ms", wait_ms.unwrap_or(0), 0, 10_000)?;
    let Some(address) = address else {
        return wait_ms.map_or(Ok(None), |_| {
            Err(UsageError::new("store-wait-ms: there is no store; give store URL too, or remove it"))
        });
    };
    let address = StoreAddress::parse(&address).map_err(|why| UsageError::new(format!("store: {why}")))?;
    Ok(Some(StoreConfig { address, wait: Duration::from_millis(wait_ms.unwrap_or(0)) }))
}

fn in_range(option: &str, value: u64, low: u64, high: u64) -> Result<(), UsageError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(UsageError::new(format!("{option}: {value} is out of range; give {low} to {high}")))
}

fn read_file(path: &Path) -> Result<File, UsageError> {
    let shown = path.display();
    let text = std::fs::read_to_string(path)
        .map_err(|error| UsageError::new(format!("config: cannot read `{shown}`: {error}")))?;
    toml::from_str(&text).map_err(|error| {
        let line = error.span().map_or(1, |span| text[..span.start].lines().count().max(1));
        // Errors of programs are one line.
        let message = error.message().lines().collect::<Vec<_>>().join(" ");
        UsageError::new(format!("config: {shown} line {line}: {message}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn with_file(content: &str, args: Args) -> Result<ServerConfig, UsageError> {
        let name = format!("tombolo-config-{}-{:?}.toml", std::process::id(), std::thread::current().id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, content).unwrap();
        let result = Args { config: Some(path.clone()), ..args }.resolve();
        std::fs::remove_file(path).unwrap();
        result
    }

    #[test]
    fn the_defaults_are_the_documented_ones() {
        let config = Args::default().resolve().unwrap();
        assert_eq!(config.listen.to_string(), DEFAULT_LISTEN);
        assert_eq!((config.world_seed, config.cache_bytes, config.max_sessions), (1, 128 << 20, 1024));
        assert_eq!(config.disk, None);
    }

    #[test]
    fn a_flag_overrides_the_file_and_the_file_the_default() {
        let file = "world-seed = 7\ncache-mb = 64\nlog-json = true\n";
        let config = with_file(file, Args { world_seed: Some(9), ..Args::default() }).unwrap();
        assert_eq!((config.world_seed, config.cache_bytes, config.log_json), (9, 64 << 20, true));
    }

    #[test]
    fn a_disk_cache_has_a_default_size() {
        let config = with_file("disk-cache = \"/var/cache/x\"\n", Args::default()).unwrap();
        assert_eq!(config.disk, Some(DiskConfig { folder: "/var/cache/x".into(), bytes: 1 << 30 }));
    }

    #[test]
    fn the_former_name_of_the_rate_limit_is_accepted() {
        let parsed = Args::try_parse_from(["tombolo-server", "--cost-per-second", "50"]).unwrap();
        assert_eq!(parsed.resolve().unwrap().rate_limit_ms, Some(50));
        let parsed = Args::try_parse_from(["tombolo-server", "--rate-limit-ms", "60"]).unwrap();
        assert_eq!(parsed.resolve().unwrap().rate_limit_ms, Some(60));
        assert_eq!(with_file("cost-per-second = 70", Args::default()).unwrap().rate_limit_ms, Some(70));
    }

    /// What a user cannot turn off by accident.
    #[test]
    fn a_mechanism_is_turned_off_by_a_hidden_option_alone() {
        let parsed = Args::try_parse_from(["tombolo-server", "--measure-without", "turns"]).unwrap();
        assert_eq!(parsed.resolve().unwrap().without, Some(Mechanism::Turns));
        assert_eq!(Args::default().resolve().unwrap().without, None);
        assert!(Args::try_parse_from(["tombolo-server", "--measure-without", "everything"]).is_err());
        assert!(with_file("measure-without = \"turns\"", Args::default()).is_err());
        let mut command = Args::command();
        let option = command.get_arguments().find(|option| option.get_id() == "measure_without").unwrap();
        assert!(option.get_env().is_none());
        assert!(!command.render_long_help().to_string().contains("measure-without"));
    }

    #[test]
    fn errors_are_one_line_with_option_value_and_range() {
        for (file, words) in [
            ("cahce-mb = 1", &["line 1", "cahce-mb", "cache-mb"][..]),
            ("\nthreads = \"two\"", &["line 2", "usize"][..]),
            ("threads = 0", &["threads", "0", "1 to 1024"][..]),
            ("cache-mb = 70000", &["cache-mb", "70000", "65536"][..]),
            ("disk-cache = \"/tmp/x\"\ndisk-mb = 63", &["disk-mb", "63", "64 to 262144"][..]),
            ("disk-mb = 64", &["disk-mb", "64", "disk-cache"][..]),
            ("rate-limit-ms = 0", &["rate-limit-ms", "0", "1 to 1000000"][..]),
            ("cost-per-second = 0", &["rate-limit-ms", "0", "1 to 1000000"][..]),
            ("deadline-ms = 9", &["deadline-ms", "9", "10 to 60000"][..]),
            ("max-sessions-per-address = 0", &["max-sessions-per-address", "0", "1 to 100000"][..]),
            ("listen = \"nowhere\"", &["listen", "nowhere", "ADDR:PORT"][..]),
            ("token-file = \"/does/not/exist\"", &["token-file", "/does/not/exist"][..]),
            ("= broken", &["line 1"][..]),
        ] {
            let message = with_file(file, Args::default()).unwrap_err().to_string();
            assert!(!message.contains('\n'), "{message}");
            for word in words {
                assert!(message.contains(word), "`{message}` lacks `{word}`");
            }
        }
        let missing = Args { config: Some("/does/not/exist.toml".into()), ..Args::default() };
        assert!(missing.resolve().unwrap_err().to_string().contains("/does/not/exist.toml"));
    }
}
