//! What travels between a Tombolo server and its clients.
//!
//! This crate turns bytes into messages and back ([`control`], [`chunk_codec`]), states every limit
//! ([`limits`]), and runs both ends of a session as state machines without IO ([`client`],
//! [`server`]): frames go in, frames and events come out. A viewer, a load test and a test suite
//! drive the same code over any transport.
//!
//! What it refuses: sockets, clocks, threads, async. Decoders trust nothing: every length is
//! checked before memory is taken, trailing bytes are an error, and no input makes them panic.
//!
//! The public description, complete enough to write a client in another language, is
//! `docs/protocol.md`.

pub mod chunk_codec;
pub mod client;
pub mod close;
pub mod control;
pub mod delivery;
pub mod error;
pub mod limits;
pub mod message;
pub mod parents;
pub mod server;
pub mod view;
pub mod view_selection;

pub use close::CloseCode;
pub use delivery::{Delivery, Tolerance};
pub use error::{ChunkError, ControlError, PeerFault};

/// The WebSocket subprotocol that both sides must name. It says how frames travel, and stays while
/// [`PROTOCOL_VERSION`] says what they mean: a peer of another version gets as far as being told
/// so.
pub const SUBPROTOCOL: &str = "tombolo.v1";

/// Version of the control messages and of the session rules. Carried in every control frame; peers
/// of different versions refuse each other.
pub const PROTOCOL_VERSION: u16 = 4;

/// A data frame as a transport delivers it. Ping, pong and close frames stay in the transport.
#[derive(Clone, Copy, Debug)]
pub enum Incoming<'a> {
    /// A whole binary message.
    Binary(&'a [u8]),
    /// A text message: never valid here, refused with its own close code.
    Text,
}
