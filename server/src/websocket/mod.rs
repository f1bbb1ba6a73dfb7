//! WebSocket transport (RFC 6455) over a byte stream: handshake ([`upgrade`]), [`frame`] headers,
//! message assembly ([`inbox`]), and batched IO ([`socket`]).

pub mod frame;
pub mod inbox;
pub mod socket;
pub mod upgrade;
