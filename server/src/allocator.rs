//! The allocator of the process.

#![expect(unsafe_code, reason = "a function of C; no pointer crosses")]

use mimalloc::MiMalloc;

/// Generation allocates blocks of some 20 KiB for microseconds. The system's allocator returns such
/// memory to the kernel and faults it in again, page by page.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

unsafe extern "C" {
    /// Of mimalloc: frees what other threads have freed of this thread's heap, and with `force`
    /// returns pages without a block to the system.
    safe fn mi_collect(force: bool);
}

/// Returns the free pages of this thread's heap to the system.
pub fn return_pages() {
    mi_collect(true);
}
