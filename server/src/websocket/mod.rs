//! WebSocket transport (RFC 6455) over a byte stream: handshake ([`upgrade`]), [`frame`] headers,
//! [`close`] frames, text ([`utf8`]), message assembly ([`inbox`]), and batched IO ([`socket`]).

pub mod close;
pub mod frame;
pub mod inbox;
pub mod socket;
pub mod upgrade;
pub mod utf8;
