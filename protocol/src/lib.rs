//! The protocol between a Tombolo server and its clients.
//!
//! This crate turns bytes into messages and back ([`control`], [`chunk_codec`]), states every limit
//! ([`limits`]), and runs both ends of a session as state machines without IO ([`client`],
//! [`server`]): frames go in, frames and events come out. A viewer, a load test and a test suite
//! drive the same code over any transport.
//!
//! It has no sockets, clocks, threads or async. Decoders treat all input as hostile: every length
//! is checked before an allocation, trailing bytes are an error, and no input causes a panic.
//!
//! The public description, complete enough to write a client in another language, is
//! `docs/protocol.md`.

pub mod backoff;
pub mod chunk_codec;
pub mod client;
pub mod close;
pub mod control;
pub mod delivery;
pub mod error;
pub mod fault;
pub mod held_chunks;
pub mod limits;
pub mod message;
pub mod peer_text;
pub mod reference_window;
pub mod server;
pub mod view;

pub use close::CloseCode;
pub use delivery::{Delivery, Tolerance};
pub use error::{ChunkError, ControlError};
pub use fault::PeerFault;

/// The WebSocket subprotocol that both sides must name. It covers the transport of frames and stays
/// the same across values of [`PROTOCOL_VERSION`], which covers their content: a peer of another
/// version connects and gets a rejection that names both versions.
pub const SUBPROTOCOL: &str = "tombolo.v1";

/// Version of the control messages and of the session rules, in every control frame. Peers of
/// different versions reject each other.
pub const PROTOCOL_VERSION: u16 = 4;

/// A data frame as a transport delivers it. Ping, pong and close frames stay in the transport.
#[derive(Clone, Copy, Debug)]
pub enum DataFrame<'a> {
    /// A whole binary message.
    Binary(&'a [u8]),
    /// A text message: never valid here, closed with its own code.
    Text,
}
