//! The lock and the threads of the generation service.
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

/// Nice value of the generation threads: half the weight of a thread of connections, and of other
/// programs, where all want the processor.
#[cfg(all(target_os = "linux", not(shuttle)))]
const NICE: i32 = 3;

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

    /// Runs a function on one of the threads, now or once one is free.
    pub fn spawn(&self, run: impl FnOnce() + Send + 'static) {
        self.pool.spawn(run);
    }

    /// Runs a function on each of the threads: when it waits, or calls [`run_broadcasts`].
    pub fn broadcast(&self, run: fn()) {
        self.pool.spawn_broadcast(move |_| run());
    }
}

/// Runs what [`Threads::broadcast`] has left for this thread. Other functions are not spawned on a
/// thread of the pool, so that no other waits here.
#[cfg(not(shuttle))]
pub fn run_broadcasts() {
    while rayon::yield_local() == Some(rayon::Yield::Executed) {}
}

#[cfg(shuttle)]
impl Threads {
    /// Starts nothing: each function gets a thread of its own.
    pub fn start(_count: usize) -> Result<Self, ThreadPoolBuildError> {
        Ok(Self {})
    }

    /// Runs a function on a thread of its own. The queue bounds their number.
    pub fn spawn(&self, run: impl FnOnce() + Send + 'static) {
        shuttle::thread::spawn(run);
    }

    /// Runs nothing: no thread stays.
    pub fn broadcast(&self, _run: fn()) {}
}

/// Runs nothing.
#[cfg(shuttle)]
pub fn run_broadcasts() {}

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
    fn a_broadcast_reaches_a_thread_whose_function_goes_on() {
        static IS_REACHED: AtomicBool = AtomicBool::new(false);
        let threads = Threads::start(1).unwrap();
        let (sender, ended) = mpsc::channel();
        threads.spawn(move || {
            while !IS_REACHED.load(Ordering::Relaxed) {
                run_broadcasts();
            }
            sender.send(()).unwrap();
        });
        threads.broadcast(|| IS_REACHED.store(true, Ordering::Relaxed));
        ended.recv().unwrap();
    }
}
