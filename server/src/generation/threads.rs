//! The lock and the threads of the generation service; a test can run the turns elsewhere.
//!
//! With `--cfg shuttle` both are those of [shuttle](https://docs.rs/shuttle), which runs one test
//! in thousands of schedules of its threads; `schedules` holds the tests.

#[cfg(shuttle)]
pub use shuttle::sync::{Mutex, MutexGuard};
#[cfg(not(shuttle))]
pub use std::sync::{Mutex, MutexGuard};

use rayon::ThreadPoolBuildError;
#[cfg(not(shuttle))]
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::cell::Cell;
use std::time::Duration;

/// Nice value of the generation threads: half the weight of a thread of connections, and of other
/// programs, where all want the processor.
#[cfg(all(target_os = "linux", not(shuttle)))]
const NICE: i32 = 3;

/// Time that a generation thread works on views between two yields. A thread of connections that
/// wakes meanwhile waits for little more than this; without a yield it may wait for the next tick
/// of the system's scheduler, 4 ms where there are 250 a second. Not less: each yield leaves the
/// processor to a busy program for a time slice of some milliseconds, and the first view of a
/// place, which takes tenths of a second, has many.
const YIELD_INTERVAL: Duration = Duration::from_micros(500);

thread_local! {
    /// The time of this thread on views since its last yield.
    static VIEW_TIME: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

/// Counts time of this thread on views, and yields after [`YIELD_INTERVAL`] of it. Threads that
/// generate chunks only do not yield: connections then handle several turns at once.
pub fn yield_after_views(spent: Duration) {
    if is_yield_due(spent) {
        std::thread::yield_now();
    }
}

/// Counts time of this thread on views. Whether a yield is due; the count begins again then.
fn is_yield_due(spent: Duration) -> bool {
    let time = VIEW_TIME.get() + spent;
    let is_due = time >= YIELD_INTERVAL;
    VIEW_TIME.set(if is_due { Duration::ZERO } else { time });
    is_due
}

/// The turns of a runner: each call runs one, until one returns false.
pub type Turns = Box<dyn FnMut() -> bool + Send>;

/// What runs the turns of the service.
pub trait Executor: Send + Sync + 'static {
    /// Runs turns on one of the threads, now or once one is free.
    fn spawn(&self, turns: Turns);

    /// Runs a function on each of the threads: when it waits, or between two turns.
    fn broadcast(&self, run: fn());
}

/// The generation threads.
pub struct Threads {
    #[cfg(not(shuttle))]
    pool: ThreadPool,
}

#[cfg(not(shuttle))]
impl Threads {
    /// Starts `count` threads.
    ///
    /// # Errors
    /// The system cannot start threads.
    pub fn start(count: usize) -> Result<Self, ThreadPoolBuildError> {
        let pool = ThreadPoolBuilder::new()
            .num_threads(count)
            .thread_name(|n| format!("generate-{n}"))
            .start_handler(|_| lower_priority())
            .build()?;
        Ok(Self { pool })
    }
}

#[cfg(not(shuttle))]
impl Executor for Threads {
    fn spawn(&self, mut turns: Turns) {
        self.pool.spawn(move || {
            loop {
                // A runner may go on for hours.
                run_broadcasts();
                if !turns() {
                    break;
                }
            }
        });
    }

    fn broadcast(&self, run: fn()) {
        self.pool.spawn_broadcast(move |_| run());
    }
}

/// Runs what [`Executor::broadcast`] has left for this thread. Other functions are not spawned on a
/// thread of the pool, so that no other waits here.
#[cfg(not(shuttle))]
fn run_broadcasts() {
    while rayon::yield_local() == Some(rayon::Yield::Executed) {}
}

#[cfg(shuttle)]
impl Threads {
    /// Starts nothing: each runner gets a thread of its own.
    pub fn start(_count: usize) -> Result<Self, ThreadPoolBuildError> {
        Ok(Self {})
    }
}

#[cfg(shuttle)]
impl Executor for Threads {
    /// Runs turns on a thread of their own. The queue bounds the number of runners.
    fn spawn(&self, mut turns: Turns) {
        shuttle::thread::spawn(move || while turns() {});
    }

    /// Runs nothing: no thread stays.
    fn broadcast(&self, _run: fn()) {}
}

/// Lowers the priority of this thread a little: connections that wait for a moment of processor
/// time go before jobs that take milliseconds. Linux alone has a priority for each thread.
#[cfg(not(shuttle))]
fn lower_priority() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(NICE);
}

#[cfg(all(test, not(shuttle)))]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc;

    #[test]
    fn a_yield_is_due_after_each_interval_of_views() {
        let part = YIELD_INTERVAL.div_f64(2.5);
        let due = [part; 7].map(is_yield_due);
        assert_eq!(due, [false, false, true, false, false, true, false]);
        assert!(is_yield_due(YIELD_INTERVAL) && !is_yield_due(Duration::ZERO));
    }

    #[test]
    fn a_broadcast_reaches_a_thread_whose_turns_go_on() {
        static IS_REACHED: AtomicBool = AtomicBool::new(false);
        let threads = Threads::start(1).unwrap();
        let (sender, ended) = mpsc::channel();
        threads.spawn(Box::new(move || {
            let goes_on = !IS_REACHED.load(Ordering::Relaxed);
            if !goes_on {
                sender.send(()).unwrap();
            }
            goes_on
        }));
        threads.broadcast(|| IS_REACHED.store(true, Ordering::Relaxed));
        ended.recv().unwrap();
    }
}
