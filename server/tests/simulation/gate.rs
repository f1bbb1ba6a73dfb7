//! The generation thread of a server in virtual time: it stops before each chunk until the virtual
//! time of that chunk has passed, and the clock stands still while the thread works.

use crate::plant::Plant;
use crate::truth;
use server::chunk_id::ChunkId;
use server::generation::Generation;
use server::source::ChunkSource;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::panic::resume_unwind;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;
use terrain::{Chunk, WorldDigest};
use tokio::sync::Notify;

/// Bytes of a thread's line in /proc up to its state: number, name, state.
const STATE_BYTES: usize = 64;

/// Where the generation thread of one server stops.
#[derive(Debug, Default)]
pub struct Gate {
    state: Mutex<State>,
    passes: Condvar,
    entered: Notify,
    /// The state of the thread, known from its first chunk on.
    thread: OnceLock<File>,
}

#[derive(Clone, Copy, Debug, Default)]
struct State {
    is_waiting: bool,
    /// Nothing stops here any more.
    is_open: bool,
    outcome: Outcome,
}

/// How the generation of a chunk ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outcome {
    #[default]
    Right,
    OtherHeight,
    Panic,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Gate {
    /// Stops the thread until its chunk is finished.
    fn pass(&self) -> Outcome {
        self.thread.get_or_init(|| File::open("/proc/thread-self/stat").expect("/proc of Linux"));
        let mut state = lock(&self.state);
        state.is_waiting = !state.is_open;
        self.entered.notify_one();
        let state = self.passes.wait_while(state, |state| state.is_waiting);
        state.unwrap_or_else(PoisonError::into_inner).outcome
    }

    /// Finishes each chunk after the virtual time that `pace` returns, as it says; never where it
    /// returns none.
    pub async fn run(&self, mut pace: impl FnMut() -> Option<(Duration, Outcome)>) {
        loop {
            self.entered.notified().await;
            let Some((takes, outcome)) = pace() else { return };
            tokio::time::sleep(takes).await;
            let mut state = lock(&self.state);
            (state.is_waiting, state.outcome) = (false, outcome);
            drop(state);
            self.passes.notify_all();
        }
    }

    /// Lets the thread go on for ever.
    pub fn open(&self) {
        let mut state = lock(&self.state);
        (state.is_waiting, state.is_open) = (false, true);
        drop(state);
        self.passes.notify_all();
    }

    /// Whether the thread has nothing to do until virtual time passes.
    fn is_quiet(&self, generation: &Generation) -> bool {
        let has_jobs = generation.load() > 0.0;
        let Some(thread) = self.thread.get() else { return !has_jobs };
        sleeps(thread) && (!has_jobs || lock(&self.state).is_waiting)
    }
}

/// Whether a thread sleeps. A thread that was woken does not, even before it has a processor.
fn sleeps(stat: &File) -> bool {
    let mut bytes = [0; STATE_BYTES];
    let count = stat.read_at(&mut bytes, 0).expect("the thread lives as long as its server");
    let text = String::from_utf8_lossy(&bytes[..count]);
    text.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with('S'))
}

/// The servers of a simulation, for its clock.
#[derive(Clone, Default)]
pub struct Threads(Arc<Mutex<Servers>>);

type Servers = Vec<(Arc<Gate>, Generation)>;

impl Threads {
    pub fn add(&self, gate: &Arc<Gate>, generation: &Generation) {
        lock(&self.0).push((Arc::clone(gate), generation.clone()));
    }

    pub fn remove(&self, gate: &Arc<Gate>) {
        lock(&self.0).retain(|(other, _)| !Arc::ptr_eq(other, gate));
    }

    /// Waits until no generation thread works. Before virtual time passes.
    pub fn wait(&self) {
        while !lock(&self.0).iter().all(|(gate, generation)| gate.is_quiet(generation)) {
            std::thread::yield_now();
        }
    }
}

/// The source of the chunks of one server.
pub struct GatedSource(pub Arc<Gate>);

impl ChunkSource for GatedSource {
    fn world(&self) -> WorldDigest {
        truth::digest()
    }

    fn chunk(&self, id: ChunkId, _known_error: Option<u32>) -> Chunk {
        let outcome = self.0.pass();
        let mut chunk = (*truth::chunk(id.key)).clone();
        match outcome {
            Outcome::Right => {}
            Outcome::OtherHeight => chunk.heights[77] += 1 << 8,
            // Without the message of a panic.
            Outcome::Panic => resume_unwind(Box::new("a fault")),
        }
        chunk
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
