//! Writes to the store, behind the generation threads. They have a breaker of their own: a full
//! store refuses writes and is read all the same.

use super::breaker::Breaker;
use crate::metrics::Metrics;
use bytes::Bytes;
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::time::{sleep, timeout};

/// Frames that wait for their write: about 8 MiB, at most 30 MiB. One more is dropped and counted,
/// and each replica that needs the chunk makes it again.
const QUEUE: usize = 2048;

/// Writes in flight.
const IN_FLIGHT: u32 = 8;

/// Time between two writes while chunks are made, until half of the queue is full: what a write
/// takes, of the store too where it shares the processors, delays them.
const PAUSE: Duration = Duration::from_millis(20);

/// Timeout of one write.
const WRITE_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest wait for the pending writes on shutdown.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

enum Command {
    Write(Path, Bytes),
    /// Answered when all writes before it have ended.
    Close(oneshot::Sender<()>),
}

/// Sends frames to the store.
#[derive(Debug)]
pub struct Writer {
    commands: mpsc::Sender<Command>,
    shared: Arc<Shared>,
}

/// The state that all writes share.
#[derive(Debug)]
struct Shared {
    objects: Arc<dyn ObjectStore>,
    breaker: Mutex<Breaker>,
    metrics: Arc<Metrics>,
    /// The store has refused a write, and a warning was logged: no other is sent until then.
    refused_until: Mutex<Option<Instant>>,
}

/// Time without writes to a store that refuses them: a permission may be granted meanwhile. After
/// it up to [`IN_FLIGHT`] are sent until one is answered.
const REFUSED: Duration = Duration::from_secs(60);

impl Writer {
    /// A writer whose work runs on a runtime.
    #[must_use]
    pub fn start(runtime: &Handle, objects: Arc<dyn ObjectStore>, metrics: Arc<Metrics>) -> Self {
        let (commands, receiver) = mpsc::channel(QUEUE);
        let (breaker, refused_until) = (Mutex::default(), Mutex::default());
        let shared = Arc::new(Shared { objects, breaker, metrics, refused_until });
        runtime.spawn(run(Arc::clone(&shared), receiver));
        Self { commands, shared }
    }

    /// Queues an object. Its frame is not asked for if it would not be written: the queue is full,
    /// or writes have failed.
    pub fn write(&self, path: Path, frame: impl FnOnce() -> Bytes) {
        let is_held_back = self.shared.holds_back(Instant::now());
        match self.commands.try_reserve() {
            Ok(place) if !is_held_back => place.send(Command::Write(path, frame())),
            _ => _ = self.shared.metrics.store.writes_dropped.inc(),
        }
    }

    /// Waits for the pending writes, 2 s at most.
    pub async fn close(&self) {
        let (done, is_done) = oneshot::channel();
        let closed = async {
            if self.commands.send(Command::Close(done)).await.is_ok() {
                // An error means that the writer has ended.
                let _ = is_done.await;
            }
        };
        if timeout(CLOSE_TIMEOUT, closed).await.is_err() {
            tracing::warn!("the store did not finish its writes in time; the chunks will be made again");
        }
    }
}

async fn run(shared: Arc<Shared>, mut commands: mpsc::Receiver<Command>) {
    let permits = Arc::new(Semaphore::new(IN_FLIGHT as usize));
    while let Some(command) = commands.recv().await {
        match command {
            Command::Write(path, frame) => {
                if shared.metrics.generation.pending_jobs.get() > 0 && commands.len() < QUEUE / 2 {
                    sleep(PAUSE).await;
                }
                // The semaphore is never closed.
                let Ok(permit) = Arc::clone(&permits).acquire_owned().await else { return };
                let shared = Arc::clone(&shared);
                tokio::spawn(async move {
                    shared.put(path, frame).await;
                    drop(permit);
                });
            }
            Command::Close(done) => {
                let all = permits.acquire_many(IN_FLIGHT).await;
                // The server may no longer wait.
                let _ = done.send(());
                drop(all);
            }
        }
    }
}

impl Shared {
    /// Unconditional: an object is named by what its content follows from, so a second write of it
    /// changes nothing.
    async fn put(&self, path: Path, frame: Bytes) {
        if self.is_refused(Instant::now()) || !self.breaker().allows(Instant::now()) {
            self.metrics.store.writes_dropped.inc();
            return;
        }
        let started = Instant::now();
        let put = timeout(WRITE_TIMEOUT, self.objects.put(&path, frame.into())).await;
        self.metrics.store.write_seconds.observe(started.elapsed().as_secs_f64());
        match put {
            Ok(Ok(_)) => {
                self.metrics.store.writes.inc();
                self.breaker().succeeded();
                *self.refused() = None;
            }
            Ok(Err(error @ (Error::PermissionDenied { .. } | Error::Unauthenticated { .. }))) => {
                self.metrics.store.writes_refused.inc();
                if self.refused().replace(Instant::now() + REFUSED).is_none() {
                    tracing::warn!(%error, "the store refuses writes; one a minute is tried");
                }
            }
            Ok(Err(error)) => {
                tracing::debug!(%error, "a write to the store failed");
                self.failed();
            }
            Err(_) => self.failed(),
        }
    }

    /// Whether a write would not be sent.
    fn holds_back(&self, now: Instant) -> bool {
        self.breaker().holds_back(now) || self.is_refused(now)
    }

    fn is_refused(&self, now: Instant) -> bool {
        self.refused().is_some_and(|until| now < until)
    }

    fn refused(&self) -> std::sync::MutexGuard<'_, Option<Instant>> {
        self.refused_until.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn failed(&self) {
        self.metrics.store.writes_failed.inc();
        self.breaker().failed(Instant::now());
    }

    fn breaker(&self) -> std::sync::MutexGuard<'_, Breaker> {
        self.breaker.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use object_store::memory::InMemory;

    /// Frames that are written in 1 s of virtual time while jobs are pending, of so many.
    async fn written_in_a_second(frames: usize, pending_jobs: i64) -> u64 {
        let (metrics, objects) = (Arc::new(Metrics::default()), Arc::new(InMemory::new()));
        metrics.generation.pending_jobs.set(pending_jobs);
        let writer = Writer::start(&Handle::current(), objects, Arc::clone(&metrics));
        for frame in 0..frames {
            writer.write(Path::from(format!("x/{frame}")), || Bytes::from_static(b"frame"));
        }
        sleep(Duration::from_secs(1)).await;
        metrics.store.writes.get()
    }

    #[tokio::test(start_paused = true)]
    async fn writes_wait_for_chunks_that_are_made_unless_many_wait() {
        assert!((40..=60).contains(&written_in_a_second(500, 1).await));
        assert_eq!(written_in_a_second(500, 0).await, 500, "the control: nothing is made");
        let written = written_in_a_second(QUEUE, 1).await;
        assert!((QUEUE as u64 / 2..=QUEUE as u64 / 2 + 60).contains(&written), "{written}");
    }

    #[test]
    fn a_minute_after_a_refusal_writes_are_sent_again() {
        let now = Instant::now();
        let shared = Shared {
            objects: Arc::new(InMemory::new()),
            breaker: Mutex::default(),
            metrics: Arc::default(),
            refused_until: Mutex::new(Some(now + REFUSED)),
        };
        let holds_back = |seconds| shared.holds_back(now + Duration::from_secs(seconds));
        assert_eq!([0, 59, 60].map(holds_back), [true, true, false]);
    }
}
