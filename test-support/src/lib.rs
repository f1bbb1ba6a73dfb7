//! The code that test suites of several crates share.

pub mod chunk_fault;
pub mod counting_allocator;
#[cfg(unix)]
pub mod memory_group;
pub mod random;

pub use chunk_fault::ChunkFault;
#[cfg(unix)]
pub use memory_group::MemoryGroup;
pub use random::Random;

use protocol::view::View;

/// A northward view over the home island: 60 degrees, 4 pixels of tolerance.
#[must_use]
pub const fn view(id: u32, distance_m: u32) -> View {
    View {
        id,
        eye: [0, 60 * 256, 0],
        velocity: [0; 3],
        yaw_mdeg: 0,
        pitch_mdeg: 0,
        fov_mdeg: 60_000,
        viewport: [640, 360],
        tolerance_q4: 64,
        distance_m,
    }
}
