//! Compares sampled chunks with local generation whole, measured error included, off the threads
//! that drive the sessions.
//!
//! A coarse chunk takes milliseconds to generate. On the threads that drive the sessions that would
//! hold up their clocks, and the load test would measure itself.

use crate::counters::Counters;
use crate::verify;
use protocol::Delivery;
use std::sync::Arc;
use terrain::{Chunk, Land};
use tokio::sync::mpsc;
use tokio::task::{JoinHandle, spawn_blocking};

/// Chunks waiting for their comparison, about 60 KiB each. While it is full a session that wants to
/// add one waits, so a sample larger than one thread can compare slows the load instead of growing
/// without end.
const QUEUE: usize = 64;

struct Waiting {
    counters: Arc<Counters>,
    land: Land,
    chunk: Box<Chunk>,
    delivery: Delivery,
}

/// The sessions' end of the queue.
#[derive(Clone, Debug)]
pub struct Regeneration {
    queue: mpsc::Sender<Waiting>,
}

impl Regeneration {
    /// Starts the comparing. It ends when the last clone of the first value is gone and everything
    /// queued is compared.
    ///
    /// One chunk at a time is compared on a thread for blocking work. The task that feeds it ends
    /// with the first comparison that panics, which the run's end reports.
    #[must_use]
    pub fn start() -> (Self, JoinHandle<()>) {
        let (queue, mut waiting) = mpsc::channel::<Waiting>(QUEUE);
        let comparing = tokio::spawn(async move {
            while let Some(waiting) = waiting.recv().await {
                if let Err(failed) = spawn_blocking(move || waiting.compare()).await {
                    // Else the program is on its way out.
                    if let Ok(panic) = failed.try_into_panic() {
                        std::panic::resume_unwind(panic);
                    }
                    return;
                }
            }
        });
        (Self { queue }, comparing)
    }

    /// Queues a chunk of a world, with how it came and whose it is; waits while the queue is full.
    pub async fn compare(&self, counters: &Arc<Counters>, land: Land, chunk: Box<Chunk>, delivery: Delivery) {
        let waiting = Waiting { counters: Arc::clone(counters), land, chunk, delivery };
        // The other end is gone only if a comparison panicked, which the run's end reports.
        let _ = self.queue.send(waiting).await;
    }
}

impl Waiting {
    fn compare(&self) {
        if let Err(mismatch) = verify::regeneration(&self.land, &self.chunk, self.delivery) {
            self.counters.mismatch(&mismatch.to_string());
        }
    }
}
