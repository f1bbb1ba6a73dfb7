//! Reads tokens and certificates again: on SIGHUP, and when their files have changed.

use crate::access::gate::Reloaded;
use crate::state::ServerState;
use cli::UsageError;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::sleep;

/// Interval between two looks at the files. They are read whole: a changed mount, as of a
/// Kubernetes secret, has no reliable time of modification.
const INTERVAL: Duration = Duration::from_secs(5);

/// Reloads until it is dropped. Ends at once if there is nothing to reload.
pub async fn run(state: Arc<ServerState>) {
    if !state.config.has_files() {
        return;
    }
    let mut hangup = Hangup::new();
    // The last failure of tokens and of TLS, so that each is logged once.
    let mut failures = [None, None];
    loop {
        let is_asked = tokio::select! {
            () = hangup.received() => true,
            () = sleep(INTERVAL) => false,
        };
        let (gate, tls) = (Arc::clone(&state.gate), state.config.tls.clone());
        // Files may be on a slow disk.
        let read = tokio::task::spawn_blocking(move || {
            [Some(gate.reload()), tls.map(|tls| tls.reload())]
                .map(|read| read.unwrap_or(Ok(Reloaded::Unchanged)))
        });
        let Ok(results) = read.await else { continue };
        let metrics = [
            ("tokens", &state.metrics.tokens_reload_failed),
            ("certificate", &state.metrics.certificate_reload_failed),
        ];
        for (((name, gauge), result), failure) in metrics.into_iter().zip(results).zip(&mut failures) {
            gauge.set(i64::from(result.is_err()));
            log(name, result, is_asked, failure);
        }
    }
}

fn log(name: &str, result: Result<Reloaded, UsageError>, is_asked: bool, failure: &mut Option<UsageError>) {
    match result {
        Ok(Reloaded::Unchanged) => *failure = None,
        Ok(Reloaded::Changed) => {
            tracing::info!(name, "read again");
            *failure = None;
        }
        Err(error) => {
            if is_asked || failure.as_ref() != Some(&error) {
                tracing::warn!(name, %error, "cannot read again; the earlier ones stay in use");
            }
            *failure = Some(error);
        }
    }
}

/// SIGHUP, where there are signals.
struct Hangup {
    #[cfg(unix)]
    signal: Option<tokio::signal::unix::Signal>,
}

impl Hangup {
    fn new() -> Self {
        Self {
            #[cfg(unix)]
            signal: tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup())
                .inspect_err(|error| tracing::warn!(%error, "cannot listen for SIGHUP"))
                .ok(),
        }
    }

    async fn received(&mut self) {
        #[cfg(unix)]
        if let Some(signal) = &mut self.signal
            && signal.recv().await.is_some()
        {
            return;
        }
        std::future::pending::<()>().await;
    }
}
