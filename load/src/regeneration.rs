//! Compares sampled chunks with local generation whole, measured error included, on a thread of its own.
//!
//! A coarse chunk takes milliseconds to generate. On the threads that drive the sessions that would hold up their clocks, and
//! the load test would measure itself.

use crate::tally::Tally;
use crate::verify;
use protocol::Delivery;
use std::sync::Arc;
use terrain::{Chunk, Land};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// Chunks waiting for their comparison, about 60 KiB each. While it is full a session that wants to add one waits, so a
/// sample larger than one thread can compare slows the load instead of growing without end.
const QUEUE: usize = 64;

/// The sessions' end of the queue.
#[derive(Clone, Debug)]
pub struct Regeneration {
    queue: mpsc::Sender<(Land, Box<Chunk>, Delivery)>,
}

impl Regeneration {
    /// Starts the thread. It ends when the last clone of the first value is gone and everything queued is compared.
    #[must_use]
    pub fn start(tally: Arc<Tally>) -> (Self, JoinHandle<()>) {
        let (queue, mut waiting) = mpsc::channel::<(Land, Box<Chunk>, Delivery)>(QUEUE);
        let thread = tokio::task::spawn_blocking(move || {
            while let Some((land, chunk, delivery)) = waiting.blocking_recv() {
                if let Err(mismatch) = verify::regeneration(&land, &chunk, delivery) {
                    tally.mismatch(&mismatch.to_string());
                }
            }
        });
        (Self { queue }, thread)
    }

    /// Queues a chunk of a world, with how it came; waits while the queue is full.
    pub async fn compare(&self, land: Land, chunk: Box<Chunk>, delivery: Delivery) {
        // The other end is gone only if the thread panicked, which the run's end reports.
        let _ = self.queue.send((land, chunk, delivery)).await;
    }
}
