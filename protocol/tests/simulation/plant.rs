//! Bugs that a simulation must find.

/// A bug of the simulated server or client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plant {
    Nothing,
    /// Some frames are sent twice.
    FrameTwice,
    /// Some results reach the session of another chunk.
    CrossTalk,
    /// One of several sessions that wait for a chunk is forgotten.
    LostWaiter,
    /// A second request of a chunk starts a second job.
    TwoJobs,
    /// A failed chunk is neither refused nor is its credit returned.
    LostFailure,
    /// A session is read however much waits to be written.
    NoBackpressure,
    /// A client that reconnects reports chunks that it does not have.
    FalseHolding,
}

/// All bugs.
pub const PLANTS: [Plant; 7] = [
    Plant::FrameTwice,
    Plant::CrossTalk,
    Plant::LostWaiter,
    Plant::TwoJobs,
    Plant::LostFailure,
    Plant::NoBackpressure,
    Plant::FalseHolding,
];
