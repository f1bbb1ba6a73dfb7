//! Reads tokens and certificates again: on SIGHUP, and when their files have changed.

use crate::access::gate::Reloaded;
use crate::state::ServerState;
use cli::UsageError;
use prometheus_client::metrics::gauge::Gauge;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::{JoinHandle, spawn_blocking};
use tokio::time::{sleep, timeout};

/// Interval between two checks of the files. They are read whole: a changed mount, as of a
/// Kubernetes secret, has no reliable time of modification.
const INTERVAL: Duration = Duration::from_secs(5);

/// Longest wait for a file, as of a mount that hangs. Its read goes on, on a thread of its own;
/// until it ends the file counts as unreadable and is not read again. Its result is not used.
const READ_TIMEOUT: Duration = Duration::from_secs(2);

/// Reloads until it is dropped. Ends at once if there is nothing to reload.
pub async fn run(state: Arc<ServerState>) {
    if !state.config.has_files() {
        return;
    }
    let mut hangup = Hangup::new();
    let (gate, metrics) = (Arc::clone(&state.gate), &state.metrics);
    let read = Arc::clone(&gate);
    let mut tokens = File::new(
        "tokens",
        &metrics.limits.tokens_reload_failed,
        move || read.read(),
        move |read| gate.replace(read),
    );
    let mut certificate = state.config.tls.clone().map(|tls| {
        let read = Arc::clone(&tls);
        File::new(
            "certificate",
            &metrics.limits.certificate_reload_failed,
            move || read.read(),
            move |read| tls.replace(read),
        )
    });
    loop {
        let is_asked = tokio::select! {
            () = hangup.received() => true,
            () = sleep(INTERVAL) => false,
        };
        // Together: one may hang.
        tokio::join!(tokens.reload(is_asked), async {
            if let Some(certificate) = &mut certificate {
                certificate.reload(is_asked).await;
            }
        });
    }
}

/// The content of a file, or why it cannot be used.
type Content<T> = Result<T, UsageError>;

/// A file, or the two of a certificate.
struct File<'a, T> {
    name: &'static str,
    failed: &'a Gauge,
    read: Arc<dyn Fn() -> Content<T> + Send + Sync>,
    /// Puts content into use.
    replace: Box<dyn Fn(T) -> Reloaded + Send + Sync>,
    /// The read that has not ended.
    reading: Option<JoinHandle<Content<T>>>,
    /// The last failure, so that it is logged once.
    failure: Option<UsageError>,
}

impl<'a, T: Send + 'static> File<'a, T> {
    fn new(
        name: &'static str,
        failed: &'a Gauge,
        read: impl Fn() -> Content<T> + Send + Sync + 'static,
        replace: impl Fn(T) -> Reloaded + Send + Sync + 'static,
    ) -> Self {
        let (read, replace) = (Arc::new(read), Box::new(replace));
        Self { name, failed, read, replace, reading: None, failure: None }
    }

    /// Reads it again, after the end of an earlier read that took too long.
    async fn reload(&mut self, is_asked: bool) {
        let (reading, read) = (&mut self.reading, Arc::clone(&self.read));
        // The result of a late read may be out of date.
        let waited = match reading.as_mut() {
            Some(late) => timeout(READ_TIMEOUT, late).await.map(drop),
            None => Ok(()),
        };
        // Files may be on a slow disk.
        let read = match waited {
            Ok(()) => timeout(READ_TIMEOUT, reading.insert(spawn_blocking(move || read()))).await,
            Err(late) => Err(late),
        };
        let outcome = match read {
            Ok(content) => {
                self.reading = None;
                // A panic is reported by its hook.
                let Ok(content) = content else { return };
                content.map(&self.replace)
            }
            Err(_) => {
                let seconds = READ_TIMEOUT.as_secs();
                Err(UsageError::new(format!("the read takes more than {seconds} s; check its disk or mount")))
            }
        };
        self.failed.set(i64::from(outcome.is_err()));
        self.log(outcome, is_asked);
    }

    fn log(&mut self, outcome: Result<Reloaded, UsageError>, is_asked: bool) {
        let name = self.name;
        match outcome {
            Ok(Reloaded::Unchanged) => self.failure = None,
            Ok(Reloaded::Changed) => {
                tracing::info!(name, "read again");
                self.failure = None;
            }
            Err(error) => {
                if is_asked || self.failure.as_ref() != Some(&error) {
                    tracing::warn!(name, %error, "cannot read again; the earlier ones stay in use");
                }
                self.failure = Some(error);
            }
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};
    use std::sync::{Mutex, mpsc};
    use tokio::task::yield_now;
    use tokio::time::advance;

    #[tokio::test(start_paused = true)]
    async fn a_late_read_is_a_failure_starts_no_second_one_and_its_content_is_not_used() {
        let (end, ended) = mpsc::channel::<()>();
        let ended = Mutex::new(ended);
        let reads = Arc::new(AtomicU32::new(0));
        let used = Arc::new(Mutex::new(Vec::new()));
        let failed = Gauge::default();
        let mut file = {
            let (reads, used) = (Arc::clone(&reads), Arc::clone(&used));
            let read = move || {
                let read = reads.fetch_add(1, Ordering::Relaxed);
                if read % 2 == 0 {
                    ended.lock().unwrap().recv().unwrap();
                }
                Ok(read)
            };
            File::new("tokens", &failed, read, move |read| {
                used.lock().unwrap().push(read);
                Reloaded::Changed
            })
        };
        for late in [0, 2] {
            for _ in 0..2 {
                tokio::join!(file.reload(true), advance(READ_TIMEOUT + Duration::from_millis(1)));
                // No time passes for the thread that reads.
                while reads.load(Ordering::Relaxed) == late {
                    yield_now().await;
                }
                assert_eq!((failed.get(), reads.load(Ordering::Relaxed)), (1, late + 1));
            }
            if late == 0 {
                end.send(()).unwrap();
                while !file.reading.as_ref().unwrap().is_finished() {
                    yield_now().await;
                }
                file.reload(true).await;
            } else {
                // It ends while the next one waits.
                tokio::join!(file.reload(true), async {
                    end.send(()).unwrap();
                });
            }
            assert_eq!((failed.get(), used.lock().unwrap().last()), (0, Some(&(late + 1))));
        }
        assert_eq!(*used.lock().unwrap(), [1, 3]);
    }
}
