//! The generation thread of a server in virtual time. It and the runtime work by turns: while one
//! works, the other waits. It stops before each chunk until the virtual time of that chunk has
//! passed.

use crate::plant::Plant;
use crate::truth;
use server::chunk_id::ChunkId;
use server::generation::{Executor, Turns, WorkClock};
use server::source::ChunkSource;
use std::future::pending;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use terrain::{Chunk, WorldDigest};
use tokio::runtime::Handle;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::yield_now;

/// Time of work between two readings of the clock, microseconds: three steps of a view are a turn.
const READING_US: u64 = 50;

/// How the generation of a chunk ends.
#[derive(Clone, Copy, Debug)]
pub enum Outcome {
    Right,
    OtherHeight,
    Panic,
}

/// Virtual time of a chunk, and how its generation ends; none if it does not.
pub type Pace = Option<(Duration, Outcome)>;

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Passes turns to the thread. One runner at a time: the service has one thread.
pub struct ToWorker(UnboundedSender<Turns>);

impl Executor for ToWorker {
    fn spawn(&self, turns: Turns) {
        // The server may have been dropped.
        let _ = self.0.send(turns);
    }

    /// Runs nothing: it would return memory to the system.
    fn broadcast(&self, _run: fn()) {}
}

/// Time of the thread's work: it passes with each chunk and with each reading.
#[derive(Clone, Default)]
pub struct VirtualWork(Arc<AtomicU64>);

impl VirtualWork {
    fn pass(&self, us: u64) -> Duration {
        Duration::from_micros(self.0.fetch_add(us, Ordering::Relaxed))
    }
}

impl WorkClock for VirtualWork {
    fn clock(&self) -> Duration {
        self.pass(READING_US)
    }

    /// The thread is never interrupted.
    fn processor(&self) -> Duration {
        self.pass(0)
    }
}

/// What the thread does when the runtime goes on.
enum Stop {
    /// It is about to generate a chunk.
    AtChunk,
    /// A turn has ended, perhaps not the last one of its runner.
    AfterTurn { turns: Turns, goes_on: bool },
}

/// The source of the chunks of one server: generates on its thread.
pub struct StoppingSource {
    stops: Mutex<Sender<Stop>>,
    outcomes: Mutex<Receiver<Outcome>>,
}

impl ChunkSource for StoppingSource {
    fn world(&self) -> WorldDigest {
        truth::digest()
    }

    fn chunk(&self, id: ChunkId, _known_error: Option<u32>) -> Chunk {
        // Without a receiver the server has been dropped.
        let is_sent = lock(&self.stops).send(Stop::AtChunk).is_ok();
        let outcome = is_sent.then(|| lock(&self.outcomes).recv().ok()).flatten();
        let mut chunk = (*truth::chunk(id.key)).clone();
        match outcome {
            Some(Outcome::Right) => {}
            Some(Outcome::OtherHeight) => chunk.heights[77] += 1 << 8,
            // Without the message of a panic.
            Some(Outcome::Panic) | None => resume_unwind(Box::new("a fault")),
        }
        chunk
    }
}

/// The thread, from the runtime. Dropping it ends the thread.
pub struct Worker {
    waiting: UnboundedReceiver<Turns>,
    turns: Sender<Turns>,
    outcomes: Sender<Outcome>,
    stops: Receiver<Stop>,
    work: VirtualWork,
    /// Joined when the channels have been dropped, which ends it.
    _thread: JoinOnDrop,
}

struct JoinOnDrop(Option<JoinHandle<()>>);

impl Drop for JoinOnDrop {
    fn drop(&mut self) {
        // The service catches panics of its turns.
        let _ = self.0.take().map(JoinHandle::join);
    }
}

impl Worker {
    /// Starts a thread in the present runtime.
    pub fn start(work: VirtualWork) -> (Self, ToWorker, StoppingSource) {
        let (to_worker, waiting) = unbounded_channel();
        let (stops_of_thread, stops) = channel();
        let (outcomes, outcomes_of_thread) = channel();
        let (turns, turns_of_thread) = channel::<Turns>();
        let stopped = stops_of_thread.clone();
        let runtime = Handle::current();
        let thread = std::thread::spawn(move || {
            // So that moments are virtual on this thread, too.
            let _entered = runtime.enter();
            while let Ok(mut turns) = turns_of_thread.recv() {
                let goes_on = turns();
                if stopped.send(Stop::AfterTurn { turns, goes_on }).is_err() {
                    break;
                }
            }
        });
        let source =
            StoppingSource { stops: Mutex::new(stops_of_thread), outcomes: Mutex::new(outcomes_of_thread) };
        let _thread = JoinOnDrop(Some(thread));
        (Self { waiting, turns, outcomes, stops, work, _thread }, ToWorker(to_worker), source)
    }

    /// Runs what waits, each chunk in the virtual time and with the outcome that `pace` returns;
    /// never further where it returns none.
    pub async fn run(mut self, mut pace: impl FnMut() -> Pace) {
        while let Some(mut next) = self.waiting.recv().await {
            loop {
                self.turns.send(next).expect("the thread waits");
                let mut stop = self.next_stop();
                let goes_on = loop {
                    match stop {
                        Stop::AfterTurn { turns, goes_on } => {
                            next = turns;
                            break goes_on;
                        }
                        Stop::AtChunk => {
                            let Some((takes, outcome)) = pace() else { return pending().await };
                            tokio::time::sleep(takes).await;
                            self.work.pass(takes.as_micros() as u64);
                            self.outcomes.send(outcome).expect("the thread waits");
                            stop = self.next_stop();
                        }
                    }
                };
                if !goes_on {
                    break;
                }
                yield_now().await;
            }
        }
    }

    fn next_stop(&self) -> Stop {
        self.stops.recv().expect("the thread stops")
    }
}

/// The outcome of a chunk without a fault.
pub const fn planted(plant: Plant, is_chosen: bool) -> Option<Outcome> {
    match plant {
        Plant::EndlessJob if is_chosen => None,
        Plant::OtherHeight if is_chosen => Some(Outcome::OtherHeight),
        _ => Some(Outcome::Right),
    }
}
