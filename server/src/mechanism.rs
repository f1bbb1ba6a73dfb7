//! Mechanisms against overload that a measurement can turn off, one at a time, to show what each of
//! them is worth. A deployed server has all of them.

use clap::ValueEnum;

/// A mechanism that can be turned off. The others have options of their own: limits of sessions,
/// the rate limit and the deadline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Mechanism {
    /// Turns by cost. Without them, chunks are generated in the order of their requests.
    Turns,
    /// Refusal back-off. Without it, a session is read however many of its requests were rejected.
    RefusalBackoff,
    /// View selection in turns on the generation threads. Without it, the thread of the connection
    /// selects a whole view at once.
    ViewTurns,
    /// Yields of a generation thread that selects views. Without them, a thread of connections on
    /// the same core waits for the system's scheduler.
    ViewYields,
    /// The fast effort at level 0 under backlog. Without it, all chunks are encoded compactly.
    FastEffort,
    /// The memory mark. Without it, the memory in use ends no session and rejects none.
    MemoryMark,
}
