//! Options, checked once. No other module reads options, files or the environment.

use crate::mode::Mode;
use crate::path::PathKind;
use clap::Parser;
use cli::UsageError;
use protocol::Delivery;
use protocol::limits::MAX_TEXT;
use std::path::PathBuf;
use terrain::lod::MAX_VIEW_DISTANCE_M;
use tls_client::TlsClient;
use tokio_tungstenite::tungstenite::http::Uri;

/// View distance without `--view-distance`, metres.
const DEFAULT_VIEW_DISTANCE_M: u32 = 2000;

/// Read rate of a slow client without `--slow-rate`, bytes a second.
const DEFAULT_SLOW_RATE: u32 = 2048;

/// Drives a Tombolo server with many headless clients and verifies every chunk that they receive.
///
/// Exits with 0 only if every client had a session, chunks arrived, all were correct and no session
/// was lost. Ctrl-C ends the run early: the report is that of the run so far, and the exit code
/// 130. A second Ctrl-C ends it without a report.
#[derive(Clone, Debug, Parser)]
#[command(name = "tombolo-load", version)]
pub struct Args {
    /// Stream of the server, `ws://HOST:PORT/v1/stream`, or `wss://` with TLS
    #[arg(long, value_name = "URL", default_value = "ws://127.0.0.1:7580/v1/stream")]
    pub connect: String,
    /// Number of clients, 1 to 100000
    #[arg(long, value_name = "N", default_value_t = 16,
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub clients: u32,
    /// Length of the run in seconds, 1 to 86400
    #[arg(long, value_name = "S", default_value_t = 10,
          value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub seconds: u64,
    /// File for the report as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Delivery: exact (all heights), refined (all heights in fewer bytes, with up to 17 MiB of
    /// memory a client), seed (a digest each; every chunk is generated here and verified) or
    /// quantised:METRES (heights within that error)
    #[arg(long, value_name = "exact|refined|seed|quantised:METRES", default_value_t = Delivery::Exact)]
    pub delivery: Delivery,
    /// View distance of every client in metres, 1 to 65536 [default: 2000]
    #[arg(long, value_name = "M",
          value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_VIEW_DISTANCE_M)))]
    pub view_distance: Option<u32>,
    /// How clients move
    #[arg(long, value_name = "PATH", value_enum, default_value_t = PathKind::Fly)]
    pub path: PathKind,
    /// How clients request chunks
    #[arg(long, value_name = "MODE", value_enum, default_value_t = Mode::View)]
    pub mode: Mode,
    /// Requests (in view mode poses) a second over all clients, 0.01 to 1000000, at times that do
    /// not depend on the server (an open loop). Latency counts from these times, so it includes
    /// late sends [default: in view mode views and
    /// probes at fixed intervals; else a closed loop, in which each client waits for answers]
    #[arg(long, value_name = "R", value_parser = rate)]
    pub rate: Option<f64>,
    /// Before the run, fly the first S seconds of the same paths, 0 to 86400. Reported separately:
    /// this phase is `cold`; the run itself, in which clients start again with new sessions and no
    /// chunks, is `warm`
    #[arg(long, value_name = "S", allow_negative_numbers = true, default_value_t = 0,
          value_parser = clap::value_parser!(u64).range(0..=86_400))]
    pub warm_up: u64,
    /// Additional clients that read only --slow-rate bytes a second, 0 to 10000; reported
    /// separately
    #[arg(long, value_name = "N", default_value_t = 0,
          value_parser = clap::value_parser!(u32).range(0..=10_000))]
    pub slow: u32,
    /// Read rate of each slow client, bytes a second, 1 to 1000000 [default: 2048]
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub slow_rate: Option<u32>,
    /// Additional silent clients, 0 to 10000, that send no Hello or, every other one, one view and
    /// then nothing; reported separately
    #[arg(long, value_name = "N", default_value_t = 0,
          value_parser = clap::value_parser!(u32).range(0..=10_000))]
    pub silent: u32,
    /// File for a plot of latency and throughput over time, .png
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Clients that reconnect do not report the chunks that they hold, so that the server sends
    /// them again (for comparison)
    #[arg(long)]
    pub no_resume: bool,
    /// Show no progress
    #[arg(long)]
    pub quiet: bool,
    /// Seed of the paths, 0 to 4294967295; the same seed gives the same paths
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u32,
    /// Compare one in N chunks of each client with local generation, error bound included; 0
    /// compares none, 1 all (one thread compares, so a small N slows the load)
    #[arg(long, value_name = "N", default_value_t = 32)]
    pub verify_every: u32,
    /// Moved to `tombolo-server-bench`. Takes all that follows, so that the error can show the
    /// new command.
    #[arg(long, hide = true, num_args = 0.., allow_hyphen_values = true)]
    pub bench: Option<Vec<String>>,
    /// File whose first line is the access token, if the server requires one
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// Certificate authorities in PEM that a `wss://` server is trusted by [default: the system's]
    #[arg(long, value_name = "FILE")]
    pub ca_file: Option<PathBuf>,
}

/// Configuration of a load test. All values are in range.
#[derive(Clone, Debug)]
pub struct LoadConfig {
    /// The stream, a `ws://` or `wss://` address.
    pub connect: Uri,
    /// TLS to the server; none is plain TCP.
    pub tls: Option<TlsClient>,
    /// Number of clients.
    pub clients: u32,
    /// Length of the run, seconds.
    pub seconds: u64,
    /// Requested delivery.
    pub delivery: Delivery,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// How clients move.
    pub path: PathKind,
    /// How clients request chunks.
    pub mode: Mode,
    /// Requests or poses a second over all clients in an open loop; none is a closed loop.
    pub rate: Option<f64>,
    /// Length of the warm-up, seconds; 0 is none.
    pub warm_up_s: u64,
    /// Additional slow clients.
    pub slow: u32,
    /// Read rate of each of them, bytes a second, at least 1.
    pub slow_bytes_per_s: u32,
    /// Additional silent clients.
    pub silent: u32,
    /// Seed of paths, requests and arrivals.
    pub seed: u32,
    /// One chunk in this number is compared with local generation; 0 is none.
    pub verify_every: u32,
    /// Whether clients that reconnect report the chunks that they hold.
    pub resume: bool,
    /// Access token.
    pub token: Option<String>,
}

impl LoadConfig {
    /// A small load on a server: the defaults of the command line.
    #[must_use]
    pub const fn new(connect: Uri) -> Self {
        Self {
            connect,
            tls: None,
            clients: 16,
            seconds: 10,
            delivery: Delivery::Exact,
            view_distance_m: DEFAULT_VIEW_DISTANCE_M,
            path: PathKind::Fly,
            mode: Mode::View,
            rate: None,
            warm_up_s: 0,
            slow: 0,
            slow_bytes_per_s: DEFAULT_SLOW_RATE,
            silent: 0,
            seed: 1,
            verify_every: 32,
            resume: true,
            token: None,
        }
    }
}

impl Args {
    /// A line for each given option that has no effect beside the others.
    #[must_use]
    pub fn without_effect(&self) -> Vec<String> {
        // Every other silent client sends one view.
        let has_views = self.mode == Mode::View || self.silent > 1;
        let options = [
            ("--slow-rate", self.slow_rate.is_some() && self.slow == 0, "it needs --slow"),
            (
                "--view-distance",
                self.view_distance.is_some() && !has_views,
                "only clients of --mode view have views",
            ),
            ("--no-resume", self.no_resume && self.mode == Mode::Http, "HTTP has no sessions"),
        ];
        let lines = options.into_iter().filter(|(_, has_none, _)| *has_none);
        lines.map(|(option, _, why)| format!("{option} has no effect: {why}")).collect()
    }

    /// Checks what clap cannot check, and reads the token.
    ///
    /// # Errors
    /// An address that is no stream, incompatible options, or an invalid file.
    pub fn resolve(self) -> Result<LoadConfig, UsageError> {
        if let Some(bench) = self.bench {
            let rest = bench.join(" ");
            return Err(UsageError::new(format!(
                "--bench: server benchmarks are in another program; run: tombolo-server-bench {rest}"
            )));
        }
        if self.mode == Mode::Http && self.delivery != Delivery::Exact {
            return Err(UsageError::new(format!(
                "--delivery {}: HTTP delivers exact chunks only; leave it out or use --mode view or explicit",
                self.delivery
            )));
        }
        if let Some(plot) =
            self.plot.filter(|plot| plot.extension().is_none_or(|end| !end.eq_ignore_ascii_case("png")))
        {
            return Err(UsageError::new(format!("--plot: expected a .png file, got `{}`", plot.display())));
        }
        let connect = stream_address(&self.connect)?;
        Ok(LoadConfig {
            tls: TlsClient::of_scheme(connect.scheme_str(), self.ca_file.as_deref())
                .map_err(|error| UsageError::new(format!("--ca-file: {error}")))?,
            connect,
            clients: self.clients,
            seconds: self.seconds,
            delivery: self.delivery,
            view_distance_m: self.view_distance.unwrap_or(DEFAULT_VIEW_DISTANCE_M),
            path: self.path,
            mode: self.mode,
            rate: self.rate,
            warm_up_s: self.warm_up,
            slow: self.slow,
            slow_bytes_per_s: self.slow_rate.unwrap_or(DEFAULT_SLOW_RATE),
            silent: self.silent,
            seed: self.seed,
            verify_every: self.verify_every,
            resume: !self.no_resume,
            token: self.token_file.as_deref().map(|path| cli::read_token(path, MAX_TEXT)).transpose()?,
        })
    }
}

/// Parses a rate.
fn rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (0.01..=1e6).contains(&rate) => Ok(rate),
        _ => Err("give a number from 0.01 to 1000000 a second".into()),
    }
}

/// Parses the address of a stream.
///
/// # Errors
/// Anything but `ws://HOST[:PORT]/PATH` or `wss://...`, with the value and what is allowed.
pub fn stream_address(text: &str) -> Result<Uri, UsageError> {
    let refuse =
        |why: &str| UsageError::new(format!("--connect: `{text}` {why}; give ws://HOST:PORT/v1/stream"));
    let address: Uri = text.parse().map_err(|_| refuse("is not an address"))?;
    match (address.scheme_str(), address.host()) {
        (Some("ws" | "wss"), Some(host)) if !host.is_empty() => Ok(address),
        _ => Err(refuse("is not a ws:// or wss:// address")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(args: &[&str]) -> Result<Args, String> {
        let all = ["tombolo-load"].iter().chain(args);
        Args::try_parse_from(all).map_err(|error| error.to_string())
    }

    #[test]
    fn the_defaults_are_a_small_load_on_the_default_server() {
        let config = parse(&[]).unwrap().resolve().unwrap();
        assert_eq!(config.connect.to_string(), "ws://127.0.0.1:7580/v1/stream");
        assert_eq!((config.clients, config.seconds, config.view_distance_m), (16, 10, 2000));
        assert_eq!(config.delivery, Delivery::Exact);
        assert_eq!((config.path, config.verify_every, &config.token), (PathKind::Fly, 32, &None));
        assert_eq!((config.mode, config.rate, config.warm_up_s), (Mode::View, None, 0));
        assert_eq!((config.slow, config.silent), (0, 0));
        // Tests start from the same defaults as the command line.
        let plain = LoadConfig::new(config.connect.clone());
        assert_eq!(format!("{config:?}"), format!("{plain:?}"));
    }

    #[test]
    fn invalid_options_are_errors_that_name_them() {
        for (args, word) in [
            (&["--clients", "0"][..], "--clients"),
            (&["--seconds", "0"], "--seconds"),
            (&["--view-distance", "65537"], "--view-distance"),
            (&["--path", "swim"], "swim"),
            (&["--delivery", "lossy"], "exact, refined"),
            (&["--mode", "ftp"], "ftp"),
            (&["--rate", "0"], "0.01 to 1000000"),
            (&["--rate", "NaN"], "0.01 to 1000000"),
            (&["--slow-rate", "0"], "--slow-rate"),
            (&["--warm-up", "-1"], "--warm-up"),
            (&["--rounds", "5"], "--rounds"),
            (&["--server-cpus", "0"], "--server-cpus"),
            (&["--colour", "red"], "--colour"),
        ] {
            let error = parse(args).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn invalid_addresses_are_one_line_errors() {
        for bad in ["", "localhost:1", "http://127.0.0.1/v1/stream", "wss://", "ws://", "nonsense here"] {
            let error = stream_address(bad).unwrap_err().to_string();
            assert!(error.starts_with("--connect: ") && error.lines().count() == 1, "{bad}: {error}");
        }
        assert!(stream_address("ws://[::1]:7/v1/stream").is_ok());
        assert!(stream_address("wss://a/v1/stream").is_ok());
    }

    #[test]
    fn options_without_effect_are_named() {
        let lines = |args: &[&str]| parse(args).unwrap().without_effect().join("\n");
        for (args, option) in [
            (&["--slow-rate", "9"][..], "--slow-rate"),
            (&["--mode", "explicit", "--view-distance", "9", "--silent", "1"], "--view-distance"),
            (&["--mode", "http", "--no-resume"], "--no-resume"),
        ] {
            assert!(lines(args).starts_with(&format!("{option} has no effect: ")), "{args:?}");
        }
        for args in [
            &["--slow-rate", "9", "--slow", "1"][..],
            &["--view-distance", "9"],
            &["--mode", "explicit", "--view-distance", "9", "--silent", "2"],
            &["--mode", "explicit", "--no-resume"],
            // An error follows.
            &["--ca-file", "ca.pem"],
        ] {
            assert_eq!(lines(args), "", "{args:?}");
        }
    }

    #[test]
    fn seed_only_over_http_is_an_error_with_a_hint() {
        let args = parse(&["--mode", "http", "--delivery", "seed"]).unwrap();
        assert!(args.resolve().unwrap_err().to_string().contains("--mode view"));
    }

    #[test]
    fn benchmarks_are_an_error_that_names_their_program() {
        let args = parse(&["--seconds", "2", "--bench", "idle", "--rounds", "5"]).unwrap();
        let error = args.resolve().unwrap_err().to_string();
        assert!(error.ends_with("tombolo-server-bench idle --rounds 5"), "{error}");
        assert!(!error.contains('\n'));
    }

    #[test]
    fn a_missing_token_file_is_an_error_that_names_it() {
        let error = parse(&["--token-file", "/no/such/file"]).unwrap().resolve().unwrap_err().to_string();
        assert!(error.contains("token-file") && error.contains("/no/such/file"), "{error}");
    }
}
