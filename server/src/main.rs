//! `tombolo-server`: reads the configuration, binds, runs until SIGINT or SIGTERM.

use clap::Parser;
use server::config::{Args, ServerConfig};
use std::io::Write;
use std::process::ExitCode;
use tokio::net::TcpListener;
use tracing_subscriber::EnvFilter;

/// Exit code for an option, variable or file that cannot be used; clap uses the same.
const BAD_CONFIGURATION: u8 = 2;

fn main() -> ExitCode {
    let config = match Args::parse().resolve() {
        Ok(config) => config,
        Err(error) => return fail(&error.to_string(), BAD_CONFIGURATION),
    };
    if let Err(message) = set_up_logging(&config) {
        return fail(&message, BAD_CONFIGURATION);
    }
    let served = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| format!("cannot start the runtime: {error}"))
        .and_then(|runtime| runtime.block_on(serve(config)));
    match served {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => fail(&message, 1),
    }
}

async fn serve(config: ServerConfig) -> Result<(), String> {
    let address = config.listen;
    let listener = TcpListener::bind(address).await.map_err(|error| {
        format!("cannot listen on {address}: {error}; stop what uses it or choose another --listen")
    })?;
    let bound = listener.local_addr().map_err(|error| format!("cannot tell the bound address: {error}"))?;
    // On standard output, for scripts that start a server on port 0. Nobody reading it is no reason to stop.
    let _ = writeln!(std::io::stdout(), "listening on http://{bound}");
    server::run(listener, config, interrupted())
        .await
        .map_err(|error| format!("cannot start generation threads: {error}"))
}

/// Completes on SIGINT or SIGTERM.
async fn interrupted() {
    let interrupt = tokio::signal::ctrl_c();
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = interrupt => {}
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    let _ = interrupt.await;
}

fn set_up_logging(config: &ServerConfig) -> Result<(), String> {
    let filter = EnvFilter::try_new(&config.log).map_err(|error| {
        format!("log: `{}` is not a filter ({error}); give for example info or info,server=debug", config.log)
    })?;
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    if config.log_json {
        builder.json().init()
    } else {
        builder.init()
    }
    Ok(())
}

fn fail(message: &str, code: u8) -> ExitCode {
    eprintln!("tombolo-server: {message}");
    ExitCode::from(code)
}
