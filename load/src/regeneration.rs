//! Compares sampled chunks with local generation, error bound included, on a thread of its own.
//!
//! A coarse chunk takes milliseconds to generate. On the threads of the sessions that would delay
//! their clocks, and the load test would measure itself.

use crate::counters::Counters;
use crate::verify;
use protocol::Delivery;
use std::sync::Arc;
use terrain::{Chunk, Land};
use tokio::sync::mpsc;
use tokio::task::{JoinHandle, spawn_blocking};

/// Chunks waiting for comparison, about 60 KiB each. Sessions wait while the queue is full, so a
/// sample that one thread cannot compare in time slows the load instead of growing without bound.
const QUEUE: usize = 64;

struct Waiting {
    counters: Arc<Counters>,
    land: Land,
    chunk: Box<Chunk>,
    delivery: Delivery,
}

/// The sender of the queue.
#[derive(Clone, Debug)]
pub struct Regeneration {
    queue: mpsc::Sender<Waiting>,
}

impl Regeneration {
    /// Starts the comparison task. It ends when the last sender is dropped and the queue is empty.
    ///
    /// One chunk at a time is compared on a blocking thread. A panic there ends the task and is
    /// reported at the end of the run.
    #[must_use]
    pub fn start() -> (Self, JoinHandle<()>) {
        let (queue, mut waiting) = mpsc::channel::<Waiting>(QUEUE);
        let comparing = tokio::spawn(async move {
            while let Some(waiting) = waiting.recv().await {
                if let Err(failed) = spawn_blocking(move || waiting.compare()).await {
                    // Otherwise the runtime is shutting down.
                    if let Ok(panic) = failed.try_into_panic() {
                        std::panic::resume_unwind(panic);
                    }
                    return;
                }
            }
        });
        (Self { queue }, comparing)
    }

    /// Queues a chunk; waits while the queue is full.
    pub async fn compare(&self, counters: &Arc<Counters>, land: Land, chunk: Box<Chunk>, delivery: Delivery) {
        let waiting = Waiting { counters: Arc::clone(counters), land, chunk, delivery };
        // The receiver is gone only after a panic, which the end of the run reports.
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
