//! Bugs that a simulation must find.

/// A bug beside a session: the loop itself is that of the product.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plant {
    Nothing,
    /// Some chunks are generated with one other height.
    OtherHeight,
    /// Some chunks are never finished.
    EndlessJob,
    /// Some messages of clients are lost.
    LostMessage,
    /// Some frames of the server arrive twice.
    FrameTwice,
    /// Some bytes of the server are lost.
    LostByte,
    /// The tasks of some sessions do not end.
    LeakedSession,
    /// A client that reconnects reports chunks that it does not have.
    FalseHolding,
}

/// All bugs.
pub const PLANTS: [Plant; 7] = [
    Plant::OtherHeight,
    Plant::EndlessJob,
    Plant::LostMessage,
    Plant::FrameTwice,
    Plant::LostByte,
    Plant::LeakedSession,
    Plant::FalseHolding,
];
