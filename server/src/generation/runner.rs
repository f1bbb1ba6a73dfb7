//! What a generation thread does: takes turns, makes what is asked for, answers.
//!
//! A panic while making fails its own job only.

use super::queue::FlowId;
use super::{Answer, Done, GenerationError, Shared};
use protocol::chunk_codec::Effort;
use protocol::{Delivery, chunk_codec};
use rustc_hash::FxHashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::time::Instant;
use terrain::{Chunk, ChunkKey};
use tokio::sync::mpsc::UnboundedSender;

/// Time in which every waiting flow should have had a turn, microseconds of work.
const ROUND_US: i64 = 4000;

/// Bounds of the work that a flow gets done in one turn, microseconds. At least two cheap chunks or so, since each turn wakes a session
/// and makes it write; at most some ten, since they are answered together.
const QUANTUM_US: (i64, i64) = (80, 400);

/// What a runner holds of a job between making and answering.
struct Made {
    key: ChunkKey,
    answers: Vec<(Delivery, Answer)>,
}

impl Made {
    fn has(&self, delivery: Delivery) -> bool {
        self.answers.iter().any(|(made, _)| *made == delivery)
    }
}

impl Shared {
    /// Takes turns until nothing waits.
    pub(super) fn run(&self) {
        let deadline = self.limits.deadline;
        loop {
            let turn = {
                let mut queue = self.lock();
                let turn = queue.take(self.quantum_us(), deadline, Instant::now());
                if turn.keys.is_empty() {
                    queue.runners -= 1;
                }
                self.metrics.queue.set(queue.jobs() as i64);
                turn
            };
            self.metrics.cancelled.inc_by(turn.dropped);
            self.metrics.expired.inc_by(turn.expired.len() as u64);
            for waiter in turn.expired {
                // An asker that left in the meantime is no error; the same below.
                let _ = waiter.answers.send(vec![(waiter.wanted, Err(GenerationError::Overloaded))]);
            }
            if turn.keys.is_empty() {
                return;
            }
            let made: Vec<Made> = turn.keys.into_iter().map(|key| self.run_job(key)).collect();
            self.answer(&made);
        }
    }

    /// Few flows get long turns, which cost less; many get short ones, so that none waits long for its own.
    fn quantum_us(&self) -> i64 {
        let flows = self.open_flows.load(Ordering::Relaxed).max(1) as i64;
        (ROUND_US / flows).clamp(QUANTUM_US.0, QUANTUM_US.1)
    }

    /// Makes what is asked for of a chunk; who asks for another form meanwhile is served by a further round.
    fn run_job(&self, key: ChunkKey) -> Made {
        // Dropped at the end of this job, so that the next one finds its memory warm.
        let mut chunk = None;
        let mut made = Made { key, answers: Vec::with_capacity(1) };
        while let Some(delivery) = { self.lock().missing(key, |delivery| made.has(delivery)) } {
            let answer = self.make(key, delivery, &mut chunk);
            made.answers.push((delivery, answer));
        }
        made
    }

    /// Encodes a frame and caches it; makes the chunk before that if this is the first of its frames.
    fn make(&self, key: ChunkKey, delivery: Delivery, chunk: &mut Option<Chunk>) -> Answer {
        let (started, is_first) = (Instant::now(), chunk.is_none());
        // A queue that is half full is a server that falls behind: its time is worth more than the bytes.
        let effort = if self.lock().jobs() * 2 > self.limits.jobs { Effort::Fast } else { Effort::Compact };
        let encoded = catch_unwind(AssertUnwindSafe(|| {
            let chunk = chunk.get_or_insert_with(|| self.source.chunk(key, self.frames.known_error(key)));
            chunk_codec::encode_with(delivery, effort, chunk, &self.world)
        }));
        let Ok(frame) = encoded else {
            self.metrics.failed.inc();
            tracing::error!(%key, %delivery, "generation panicked");
            return Err(GenerationError::Failed);
        };
        if is_first {
            let took = started.elapsed();
            self.costs.learn(key, took);
            self.metrics.generation_seconds.observe(took.as_secs_f64());
            self.metrics.generated.inc();
        }
        self.frames.insert(key, delivery, frame.clone());
        Ok(frame)
    }

    /// Answers a whole turn: each asker once, however many chunks it gets, since every answer may wake a session and cause a write.
    fn answer(&self, turn: &[Made]) {
        let mut askers: FxHashMap<FlowId, (UnboundedSender<Vec<Done>>, Vec<Done>)> = FxHashMap::default();
        {
            let mut queue = self.lock();
            for made in turn {
                for waiter in queue.finish(made.key, |delivery| made.has(delivery)) {
                    let answer = made.answers.iter().find(|(delivery, _)| *delivery == waiter.delivery);
                    let answer = answer.map_or(Err(GenerationError::Failed), |(_, answer)| answer.clone());
                    let (_, answers) = askers.entry(waiter.flow).or_insert((waiter.answers, Vec::new()));
                    answers.push((waiter.wanted, answer));
                }
            }
            self.metrics.queue.set(queue.jobs() as i64);
        }
        for (asker, answers) in askers.into_values() {
            let _ = asker.send(answers);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generation::gated::{Gated, MEASURED, ask, ask_for, bench, flat_frame, key, wanted};
    use crate::generation::{Generation, Limits};
    use crate::metrics::Metrics;
    use protocol::limits::SEED_ONLY_FRAME;
    use protocol::server::Wanted;
    use std::sync::{Arc, Mutex, mpsc};
    use std::time::Duration;

    #[tokio::test]
    async fn both_deliveries_of_a_key_share_one_job_and_only_what_is_asked_for_is_encoded() {
        let bench = bench(1 << 20, 10);
        let exact = ask(&bench.service, key(1), 1).await;
        let seed = ask_for(&bench.service, key(1), Delivery::SeedOnly, 1).await;
        bench.permit.send(()).unwrap();
        assert_eq!(exact.await.unwrap().unwrap().len(), flat_frame());
        assert_eq!(seed.await.unwrap().unwrap().len(), SEED_ONLY_FRAME);
        assert_eq!(bench.metrics.generated.get(), 1);
        assert_eq!(bench.metrics.coalesced.get(), 1);

        bench.permit.send(()).unwrap();
        bench.service.frame(wanted(key(2), 1), Delivery::SeedOnly).await.unwrap();
        assert!(bench.service.cached(key(2), Delivery::SeedOnly).is_some());
        assert!(bench.service.cached(key(2), Delivery::Exact).is_none());
    }

    #[tokio::test]
    async fn another_delivery_of_a_cached_chunk_takes_the_error_from_the_cached_frame() {
        let bench = bench(1 << 20, 10);
        for (x, first, second) in
            [(1, Delivery::Exact, Delivery::SeedOnly), (2, Delivery::SeedOnly, Delivery::Exact)]
        {
            for (delivery, error) in [(first, MEASURED), (second, MEASURED + 1)] {
                bench.permit.send(()).unwrap();
                let frame = bench.service.frame(wanted(key(x), 1), delivery).await.unwrap();
                assert_eq!(chunk_codec::error(&frame), Some(error), "{delivery} of {x}");
                // Until the job is gone a further asker would share its chunk instead.
                while bench.service.load() > 0.0 {
                    tokio::task::yield_now().await;
                }
            }
        }
    }

    #[tokio::test]
    async fn a_request_that_waited_beyond_the_deadline_is_refused_and_not_made() {
        let (permit, permits) = mpsc::channel();
        let (made_sender, made) = mpsc::channel();
        let source = Gated { permits: Mutex::new(permits), made: Mutex::new(made_sender) };
        let limits = Limits { threads: 1, cache_bytes: 1 << 20, jobs: 10, deadline: Duration::ZERO };
        let metrics = Arc::new(Metrics::default());
        let service = Generation::new(source, limits, Arc::clone(&metrics)).unwrap();
        let mut flow = service.flow();
        // What a view needs has no deadline, and holds the thread.
        flow.ask(wanted(key(0), 9), Delivery::Exact);
        while !service.shared.lock().is_running(key(0)) {
            tokio::task::yield_now().await;
        }
        flow.ask(Wanted { request: Some(7), ..wanted(key(1), 9) }, Delivery::Exact);
        permit.send(()).unwrap();
        assert_eq!(flow.answers().await[0].0.key, key(0));
        assert_eq!(flow.answers().await[0].1, Err(GenerationError::Overloaded));
        assert_eq!((made.try_iter().count(), metrics.expired.get()), (1, 1));
    }

    #[tokio::test]
    async fn a_panic_fails_its_own_job_only() {
        let bench = bench(1 << 20, 10);
        let bad = ask(&bench.service, key(666), 2).await;
        let good = ask(&bench.service, key(1), 1).await;
        bench.permit.send(()).unwrap();
        bench.permit.send(()).unwrap();
        assert_eq!(bad.await.unwrap(), Err(GenerationError::Failed));
        assert!(good.await.unwrap().is_ok());
        assert_eq!(bench.metrics.failed.get(), 1);
    }
}
