//! What a generation thread does: takes turns, finds on disk or makes what is asked for, answers.
//!
//! A panic while making fails its own job only.

use super::frames::Kept;
use super::queue::FlowId;
use super::{Answer, Done, GenerationError, Shared};
use bytes::Bytes;
use protocol::chunk_codec::Effort;
use protocol::{Delivery, chunk_codec};
use rustc_hash::FxHashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::time::Instant;
use terrain::{Chunk, ChunkKey};
use tokio::sync::mpsc::UnboundedSender;

/// Time in which every waiting flow should have had a turn, microseconds of work. A thread that has
/// more than that before it is behind.
const ROUND_US: i64 = 4000;

/// Bounds of the work that a flow gets done in one turn, microseconds. At least four cheap chunks
/// or so, since each turn wakes a session and makes it write, which costs about as much as a chunk;
/// at most some ten, since they are answered together.
const QUANTUM_US: (i64, i64) = (160, 400);

/// Jobs waiting for each flow from which on all are taken to have much waiting: half of what a
/// session may have.
const CROWD: usize = 8;

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
                let quantum_us = self.quantum_us(queue.waiting());
                let turn = queue.take(quantum_us, deadline, Instant::now());
                if turn.keys.is_empty() && turn.view.is_none() {
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
            if let Some((flow, view, budget_us)) = turn.view {
                self.select_view(flow, view, budget_us);
                continue;
            }
            if turn.keys.is_empty() {
                return;
            }
            let made: Vec<Made> = turn.keys.into_iter().map(|key| self.run_job(key)).collect();
            self.answer(&made);
        }
    }

    /// Few flows get long turns, which cost less; many get short ones, so that none waits long for
    /// its own. Where all have much waiting, short turns would make nobody's wait shorter, and a
    /// server that falls behind must not spend its time on writes.
    fn quantum_us(&self, waiting: usize) -> i64 {
        let flows = self.open_flows.load(Ordering::Relaxed).max(1);
        if waiting >= CROWD * flows {
            return QUANTUM_US.1;
        }
        (ROUND_US / flows as i64).clamp(QUANTUM_US.0, QUANTUM_US.1)
    }

    /// Makes what is asked for of a chunk; who asks for another form meanwhile is served by a
    /// further round.
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

    /// Takes a frame from disk, or encodes it; makes the chunk before that if this is the first of
    /// its frames.
    fn make(&self, key: ChunkKey, delivery: Delivery, chunk: &mut Option<Chunk>) -> Answer {
        let (started, is_first) = (Instant::now(), chunk.is_none());
        let effort = self.effort(key);
        let had = catch_unwind(AssertUnwindSafe(|| {
            // Once there is a chunk, to encode it is the shorter way.
            if chunk.is_none()
                && let Some(frame) = self.stored(key, delivery)
            {
                return (frame, true);
            }
            let known_error = || self.frames.known_error(key).or_else(|| self.stored_error(key, delivery));
            let chunk = chunk.get_or_insert_with(|| self.source.chunk(key, known_error()));
            (chunk_codec::encode_with(delivery, effort, chunk, &self.world), false)
        }));
        let Ok((frame, is_stored)) = had else {
            self.metrics.failed.inc();
            tracing::error!(%key, %delivery, "generation panicked");
            return Err(GenerationError::Failed);
        };
        let took = started.elapsed();
        if is_first {
            // A job costs what it takes, wherever its frame comes from.
            self.costs.learn(key, took);
        }
        if is_first && !is_stored {
            self.metrics.generation_seconds.observe(took.as_secs_f64());
            self.metrics.generated.inc();
        }
        // What is hasty in seed-only delivery? Nothing of it is coded.
        let is_hasty = effort == Effort::Fast && delivery != Delivery::SeedOnly && !is_stored;
        self.metrics.hasty.inc_by(u64::from(is_hasty));
        self.frames.insert(key, delivery, Kept { frame: frame.clone(), is_hasty });
        if let Some(disk) = self.disk.as_ref().filter(|_| !is_stored) {
            disk.write(key, delivery, frame.clone());
        }
        Ok(frame)
    }

    /// A server that falls behind has less time than bytes. Of a coarser chunk coding is a small
    /// part of the making, so that is not where to save.
    fn effort(&self, key: ChunkKey) -> Effort {
        let backlog_us = || self.lock().waiting() as i64 * self.costs.mean_us() / self.limits.threads as i64;
        if key.level() == 0 && backlog_us() > ROUND_US { Effort::Fast } else { Effort::Compact }
    }

    /// A frame from disk.
    fn stored(&self, key: ChunkKey, delivery: Delivery) -> Option<Bytes> {
        self.disk.as_ref()?.read(key, delivery, |frame| self.is_genuine(key, delivery, frame))
    }

    /// The error of a chunk that is on disk for another delivery. As in memory, not from a
    /// quantised frame, whose error is larger.
    fn stored_error(&self, key: ChunkKey, not: Delivery) -> Option<u32> {
        let others = [Delivery::Exact, Delivery::SeedOnly].into_iter().filter(|delivery| *delivery != not);
        let disk = self.disk.as_ref()?;
        let frame = others
            .into_iter()
            .find_map(|delivery| disk.peek(key, delivery, |frame| self.is_genuine(key, delivery, frame)))?;
        chunk_codec::error(&frame)
    }

    /// Whether bytes are a frame that answers an asking.
    fn is_genuine(&self, key: ChunkKey, delivery: Delivery, frame: &[u8]) -> bool {
        match delivery {
            // Its digest covers the heights, which are not in it. To make them is cheap when the
            // error is known, and what comes out of it can be compared whole.
            Delivery::SeedOnly => chunk_codec::error(frame).is_some_and(|error| {
                let chunk = self.source.chunk(key, Some(error));
                chunk_codec::encode_for(delivery, &chunk, &self.world) == frame
            }),
            Delivery::Exact | Delivery::Quantised(_) | Delivery::Refined => {
                let found = chunk_codec::verify(frame, &self.world).ok();
                // An exact frame may come in every delivery.
                found == Some((key, delivery)) || found == Some((key, Delivery::Exact))
            }
        }
    }

    /// Answers a whole turn: each asker once, however many chunks it gets, since every answer may
    /// wake a session and cause a write.
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
    use crate::disk::{Disk, DiskConfig};
    use crate::generation::gated::{Gated, MEASURED, ask, ask_for, bench, flat_frame, key, wanted};
    use crate::generation::{Generation, Limits};
    use crate::metrics::Metrics;
    use crate::source::{ChunkSource, Procedural};
    use protocol::delivery::Tolerance;
    use protocol::limits::SEED_ONLY_FRAME;
    use protocol::server::Wanted;
    use std::path::{Path, PathBuf};
    use std::sync::atomic::AtomicUsize;
    use std::sync::{Arc, Mutex, mpsc};
    use std::time::Duration;
    use terrain::{Land, WorldDigest};

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
        bench.service.flow().frame(wanted(key(2), 1), Delivery::SeedOnly).await.unwrap();
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
                let frame = bench.service.flow().frame(wanted(key(x), 1), delivery).await.unwrap();
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
    async fn what_was_coded_in_haste_is_made_again_for_the_first_who_asks_when_nothing_waits() {
        let bench = bench(1 << 20, 1000);
        let mut flow = bench.service.flow();
        // By the first guess, work for some twenty milliseconds.
        for x in 0..200 {
            flow.ask(wanted(key(x), 1), Delivery::Exact);
        }
        (0..200).for_each(|_| bench.permit.send(()).unwrap());
        while flow.open() > 0 {
            flow.answers().await;
        }
        let (hasty, generated) = (bench.metrics.hasty.get(), bench.metrics.generated.get());
        assert!((1..200).contains(&hasty), "{hasty}");
        let idle = async || {
            while bench.service.load() > 0.0 {
                tokio::task::yield_now().await;
            }
        };
        idle().await;

        // The tenth was made when all had been asked for, and in haste; the last was not. While
        // something else runs both are good enough.
        let blocker = ask(&bench.service, key(1000), 1).await;
        for x in [10, 199] {
            assert!(bench.service.cached(key(x), Delivery::Exact).is_some());
        }
        bench.permit.send(()).unwrap();
        blocker.await.unwrap().unwrap();
        idle().await;
        assert!(bench.service.cached(key(199), Delivery::Exact).is_some());
        for _ in 0..2 {
            // A permit for the one job that there should be.
            bench.permit.send(()).unwrap();
            bench.service.flow().frame(wanted(key(10), 1), Delivery::Exact).await.unwrap();
            idle().await;
        }
        assert_eq!((bench.metrics.hasty.get(), bench.metrics.generated.get()), (hasty, generated + 2));
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

    /// The land, with a count of the errors that had to be measured.
    struct Watched(Procedural, Arc<AtomicUsize>);

    impl ChunkSource for Watched {
        fn world(&self) -> WorldDigest {
            self.0.world()
        }

        fn chunk(&self, key: ChunkKey, known_error: Option<u32>) -> Chunk {
            self.1.fetch_add(usize::from(known_error.is_none()), Ordering::Relaxed);
            self.0.chunk(key, known_error)
        }
    }

    /// A service over a folder, as a process that has just started has it.
    fn started(folder: &Path) -> (Generation, Arc<Metrics>, Arc<AtomicUsize>) {
        let (metrics, measured) = (Arc::new(Metrics::default()), Arc::new(AtomicUsize::new(0)));
        let source = Watched(Procedural::new(Land::new(1)), Arc::clone(&measured));
        let config = DiskConfig { folder: folder.into(), bytes: 64 << 20 };
        let disk = Disk::new(config, &source.world(), Arc::clone(&metrics)).unwrap();
        let limits =
            Limits { threads: 1, cache_bytes: 1 << 20, jobs: 10, deadline: Duration::from_secs(3600) };
        let service = Generation::with_disk(source, limits, Some(disk), Arc::clone(&metrics)).unwrap();
        (service, metrics, measured)
    }

    #[tokio::test]
    async fn every_delivery_is_found_on_disk_and_a_measured_error_serves_them_all() {
        let folder = std::env::temp_dir().join(format!("tombolo-runner-disk-{}", std::process::id()));
        let key = ChunkKey::new(3, 1, -1).unwrap();
        let quantised = Delivery::Quantised(Tolerance::COARSEST);
        let mut frames = Vec::new();
        // Each by a process of its own: the first measures, the others find what it measured.
        for (delivery, measurings) in [(Delivery::SeedOnly, 1), (Delivery::Exact, 0), (quantised, 0)] {
            let (service, metrics, measured) = started(&folder);
            let frame = service.flow().frame(wanted(key, 1), delivery).await.unwrap();
            assert_eq!(metrics.generated.get(), 1, "{delivery}");
            assert_eq!(measured.load(Ordering::Relaxed), measurings, "{delivery}");
            service.close().await;
            frames.push((delivery, frame));
        }
        let (service, metrics, measured) = started(&folder);
        for (delivery, frame) in &frames {
            assert_eq!(&service.flow().frame(wanted(key, 1), *delivery).await.unwrap(), frame, "{delivery}");
        }
        assert_eq!((metrics.generated.get(), metrics.disk_hits.get()), (0, 3));
        assert_eq!(measured.load(Ordering::Relaxed), 0);
        service.close().await;

        // The control: with its error changed, which no digest over the file alone would notice,
        // the seed's frame is refused.
        let seed = files(&folder).into_iter().find(|path| path.to_string_lossy().contains(".seed.")).unwrap();
        let mut bytes = std::fs::read(&seed).unwrap();
        bytes[16] ^= 1;
        std::fs::write(&seed, bytes).unwrap();
        let (service, metrics, _) = started(&folder);
        let again = service.flow().frame(wanted(key, 1), Delivery::SeedOnly).await.unwrap();
        assert_eq!(again, frames[0].1);
        assert_eq!((metrics.disk_damaged.get(), metrics.generated.get()), (1, 1));
        service.close().await;
        std::fs::remove_dir_all(&folder).unwrap();
    }

    fn files(folder: &Path) -> Vec<PathBuf> {
        let shards = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let shards = shards.filter(|path| path.is_dir());
        shards
            .flat_map(|shard| std::fs::read_dir(shard).unwrap().map(|entry| entry.unwrap().path()))
            .collect()
    }
}
