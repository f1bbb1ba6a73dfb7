//! An allocator that counts bytes of the heap, thread by thread and of all threads. A suite that
//! measures memory is a test binary of its own and names it as its global allocator.
#![expect(unsafe_code, reason = "an allocator is unsafe by nature; this one counts and delegates")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicIsize, Ordering};

/// The system's allocator, counted.
#[derive(Debug)]
pub struct CountingAllocator;

thread_local! {
    static LIVE: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

/// Bytes of all threads.
static ALL: AtomicIsize = AtomicIsize::new(0);

/// Bytes that the program has allocated and not freed, whichever thread did.
#[must_use]
pub fn live_of_all_threads() -> isize {
    ALL.load(Ordering::Relaxed)
}

/// Bytes that this thread has allocated, less those that it has freed: negative on a thread that
/// frees what others allocated.
#[must_use]
pub fn live() -> isize {
    LIVE.get()
}

/// A result, and the most bytes that were live at once on this thread during some work, beyond
/// those before it.
pub fn peak_of<T>(work: impl FnOnce() -> T) -> (usize, T) {
    let before = LIVE.get();
    PEAK.set(before);
    let result = work();
    ((PEAK.get() - before).unsigned_abs(), result)
}

// SAFETY: every call is delegated to the system allocator unchanged.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LIVE.set(LIVE.get() + layout.size() as isize);
        PEAK.set(PEAK.get().max(LIVE.get()));
        ALL.fetch_add(layout.size() as isize, Ordering::Relaxed);
        // SAFETY: the caller keeps the contract; so below.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.set(LIVE.get() - layout.size() as isize);
        ALL.fetch_sub(layout.size() as isize, Ordering::Relaxed);
        // SAFETY: see above.
        unsafe { System.dealloc(pointer, layout) }
    }
}
