//! Free memory that the allocator keeps for each thread.
//!
//! mimalloc has a heap for each thread (Leijen, Zorn and de Moura, "Mimalloc: Free List Sharding in
//! Action", 2019). Blocks that other threads free, and pages without a block, go back to the system
//! when their thread allocates. The heap of a thread without work keeps them. Threads return them
//! when they are asked to.

use std::cell::Cell;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// What returns the free pages of the calling thread's heap. The allocator belongs to the process,
/// and so does this.
static RETURN: OnceLock<fn()> = OnceLock::new();

/// Requests so far.
static REQUESTS: AtomicU64 = AtomicU64::new(0);

thread_local! {
    /// Requests that this thread has followed.
    static FOLLOWED: Cell<u64> = const { Cell::new(0) };
}

/// Sets what returns the free pages of the calling thread's heap to the system; the first call
/// counts. Without it threads return nothing.
pub fn set_allocator(return_pages: fn()) {
    let _ = RETURN.set(return_pages);
}

/// Asks threads to return their free pages. Each does so when it next calls
/// [`return_if_requested`]: those of generation, and the workers of the program's runtime.
pub fn request_return() {
    REQUESTS.fetch_add(1, Ordering::Relaxed);
}

/// Returns the free pages of the calling thread if they were requested since its last call, and
/// whether it was. Takes milliseconds then, and nanoseconds otherwise.
pub fn return_if_requested() -> bool {
    let requests = REQUESTS.load(Ordering::Relaxed);
    let is_requested = FOLLOWED.replace(requests) != requests;
    if is_requested && let Some(return_pages) = RETURN.get() {
        return_pages();
    }
    is_requested
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_thread_returns_its_pages_once_for_a_request() {
        thread_local!(static RETURNS: Cell<u32> = const { Cell::new(0) });
        let returns = || {
            return_if_requested();
            RETURNS.get()
        };
        return_if_requested();
        set_allocator(|| RETURNS.set(RETURNS.get() + 1));
        assert_eq!(returns(), 0, "without a request");
        request_return();
        assert_eq!([returns(), returns()], [1, 1]);
        assert_eq!(std::thread::spawn(returns).join().unwrap(), 1, "another thread");
    }
}
