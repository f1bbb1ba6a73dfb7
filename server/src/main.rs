//! `tombolo-server`: reads the configuration, binds, and runs until SIGINT or SIGTERM; or bakes.

mod allocator;

use cli::UsageError;
use server::bake::{BakeArgs, Baked};
use server::config::{Args, Command, ServerConfig, log_filter};
use server::memory::heaps;
use server::traces::{self, Exporter};
use server::{listener, open_files};
use std::io::{ErrorKind, IsTerminal, Write};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

const NAME: &str = "tombolo-server";

/// Exit code of a bake that a signal has stopped: as a shell reports SIGTERM.
const TERMINATED: u8 = 128 + 15;

/// Log lines that wait to be written, about 2 MiB. While standard error takes none, further ones
/// are lost.
const LOG_LINES: usize = 8192;

/// Longest wait at the end for reads of files and for map tiles, whose results are not needed any
/// more.
const BLOCKING_TIMEOUT: Duration = Duration::from_secs(1);

fn main() -> ExitCode {
    let mut args: Args = match cli::parse() {
        Ok(args) => args,
        Err(code) => return code,
    };
    if let Some(Command::Bake(args)) = args.command.take() {
        return bake(args);
    }
    let config = match args.resolve() {
        Ok(config) => config,
        Err(error) => return cli::fail(NAME, error, cli::USAGE),
    };
    let logging = match set_up_logging(&config) {
        Ok(logging) => logging,
        Err(message) => return cli::fail(NAME, message, cli::USAGE),
    };
    open_files::raise(config.max_sessions);
    heaps::set_allocator(allocator::return_pages);
    let served = tokio::runtime::Builder::new_multi_thread()
        .on_thread_park(|| _ = heaps::return_if_requested())
        .enable_all()
        .build()
        .map_err(|error| format!("cannot start the runtime: {error}"))
        .and_then(|runtime| {
            let served = runtime.block_on(serve(config));
            // A drop would wait without end for a read from a mount that hangs.
            runtime.shutdown_timeout(BLOCKING_TIMEOUT);
            served
        });
    if let Some(exporter) = logging.exporter {
        exporter.close();
    }
    // The lines that wait come before the error.
    drop(logging.lines);
    match served {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => cli::fail(NAME, message, cli::FAILED),
    }
}

/// Bakes a region, with a line on standard error each second.
fn bake(args: BakeArgs) -> ExitCode {
    let bake = match args.resolve() {
        Ok(bake) => bake,
        Err(error) => return cli::fail(NAME, error, cli::USAGE),
    };
    let (started, mut shown) = (Instant::now(), Instant::now());
    let show = |baked: &Baked, total: u64| {
        if shown.elapsed() >= Duration::from_secs(1) || baked.packs == total {
            shown = Instant::now();
            let Baked { packs, kept, bytes, .. } = baked;
            eprintln!("bake: {packs} of {total} packs, {kept} kept, {:.1} MB written", *bytes as f64 / 1e6);
        }
    };
    let baked = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| format!("cannot start the runtime: {error}"))
        .and_then(|runtime| {
            runtime.block_on(async {
                // As the first process of a container it would get no signal without a handler.
                let interrupted = interruption(false).map_err(|error| no_signals(&error))?;
                let stop = CancellationToken::new();
                let stopped = stop.clone();
                tokio::spawn(async move {
                    interrupted.await;
                    stopped.cancel();
                });
                bake.run(&stop, show).await
            })
        });
    match baked {
        Ok(baked) if baked.is_stopped => {
            cli::fail(NAME, format!("{} packs written; run it again to go on", baked.written), TERMINATED)
        }
        Ok(baked) => {
            let region = match baked {
                Baked { is_complete: true, .. } => "is complete",
                Baked { refused: 1.., .. } => {
                    "lacks packs of other parts, or packs that may not be read; the store refused reads: \
                     give the credentials the rights to get and to list objects"
                }
                Baked { .. } => "lacks packs of other parts",
            };
            let seconds = started.elapsed().as_secs_f64();
            let _ = writeln!(
                std::io::stdout(),
                "{} packs written, {} kept in {seconds:.1} s; the region {region}",
                baked.written,
                baked.kept
            );
            ExitCode::SUCCESS
        }
        Err(message) => cli::fail(NAME, message, cli::FAILED),
    }
}

async fn serve(config: ServerConfig) -> Result<(), String> {
    let address = config.listen;
    let listener = listener::bind(address).map_err(|error| {
        let cure = match error.kind() {
            ErrorKind::AddrInUse => "stop the program that uses it or choose another --listen",
            ErrorKind::PermissionDenied => "choose a port above 1023, or give the program the right to it",
            _ => "give an address of this machine with --listen, such as 127.0.0.1:7580",
        };
        format!("cannot listen on {address}: {error}; {cure}")
    })?;
    let bound = listener.local_addr().map_err(|error| format!("cannot read the bound address: {error}"))?;
    // Before the address is printed: a script that knows the address may send a signal at once. The
    // end of a terminal ends what runs in it; elsewhere SIGHUP asks for a reload, of which there
    // may be nothing.
    let stays = config.has_files() || !std::io::stdin().is_terminal();
    let interrupted = interruption(stays).map_err(|error| no_signals(&error))?;
    let scheme = if config.tls.is_some() { "https" } else { "http" };
    // On standard output, for scripts that start a server on port 0. A closed output is ignored.
    let _ = writeln!(std::io::stdout(), "listening on {scheme}://{bound}");
    server::run(listener, config, interrupted)
        .await
        .map_err(|error| format!("cannot start generation threads: {error}"))
}

fn no_signals(error: &std::io::Error) -> String {
    format!("cannot listen for signals: {error}")
}

/// Listens for SIGINT and SIGTERM from now on; the future completes on the first. `stays` after a
/// SIGHUP, which otherwise ends the process.
fn interruption(stays: bool) -> std::io::Result<impl Future<Output = ()>> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let (mut interrupt, mut terminate) =
            (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        if stays {
            // The handler stays when its receiver is dropped; the server has one of its own.
            drop(signal(SignalKind::hangup())?);
        }
        Ok(async move {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
        })
    }
    #[cfg(not(unix))]
    let _ = stays;
    #[cfg(not(unix))]
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}

/// Log lines and traces, until they are closed.
struct Logging {
    /// Writes the lines that wait when it is dropped, for at most a second.
    lines: WorkerGuard,
    exporter: Option<Exporter>,
}

/// Log lines on standard error, and traces to a collector.
fn set_up_logging(config: &ServerConfig) -> Result<Logging, UsageError> {
    // Spans of traces are for the collector alone.
    let filter = log_filter(&config.log)?.with_target(traces::TARGET, LevelFilter::OFF);
    // Written by a thread of their own: a reader of standard error that stalls must not stop the
    // threads that log.
    let (writer, guard) =
        NonBlockingBuilder::default().buffered_lines_limit(LOG_LINES).finish(std::io::stderr());
    let lines =
        tracing_subscriber::fmt::layer().with_writer(writer).with_ansi(std::io::stderr().is_terminal());
    let lines = if config.log_json { lines.json().boxed() } else { lines.boxed() };
    let registry = tracing_subscriber::registry().with(lines.with_filter(filter));
    // No layer at all rather than an absent one, which has an interest in all spans.
    let Some(config) = &config.traces else {
        registry.init();
        return Ok(Logging { lines: guard, exporter: None });
    };
    let (layer, exporter) = traces::layer(config, instance())
        .map_err(|error| UsageError::new(format!("otlp: cannot export traces: {error}")))?;
    registry.with(layer).init();
    Ok(Logging { lines: guard, exporter: Some(exporter) })
}

/// The name of this process among the replicas.
fn instance() -> String {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    format!("{}:{}", host.trim(), std::process::id())
}
