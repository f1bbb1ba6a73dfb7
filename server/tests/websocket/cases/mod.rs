//! Cases in the groups of Autobahn|Testsuite's sections 1 to 7 and 9. Names begin with the section.

pub mod close;
mod fragmentation;
mod framing;
pub mod limits;
mod opcodes;
mod pings;
mod reserved_bits;
mod utf8;

use crate::frame::Frame;

/// What a client sends to an echo, and what it must receive.
#[derive(Clone, Debug)]
pub struct Case {
    pub name: String,
    pub sent: Vec<Frame>,
    /// Opcodes and payloads in order, without the Close frame at the end.
    pub received: Vec<(u8, Vec<u8>)>,
    /// Code of the Close frame at the end.
    pub code: u16,
}

/// A group of cases, and a fault of a WebSocket layer that at least one of them must find.
pub struct Group {
    pub name: &'static str,
    pub cases: Vec<Case>,
    /// What the faulty layer is like.
    pub fault: &'static str,
    /// Turns a frame into what the faulty layer takes it for.
    pub plant: fn(Frame) -> Option<Frame>,
}

/// All groups.
pub fn groups() -> Vec<Group> {
    vec![
        framing::group(),
        pings::group(),
        reserved_bits::group(),
        opcodes::group(),
        fragmentation::group(),
        utf8::group(),
        close::group(),
        limits::group(),
    ]
}

/// A case without a violation: the client closes with 1000 at the end.
fn valid(name: impl Into<String>, mut sent: Vec<Frame>, received: Vec<(u8, Vec<u8>)>) -> Case {
    sent.push(Frame::close(1000, ""));
    Case { name: name.into(), sent, received, code: 1000 }
}

/// A case that ends with a violation. The client sends more behind it, which nothing may answer.
fn violation(name: impl Into<String>, mut sent: Vec<Frame>, received: Vec<(u8, Vec<u8>)>, code: u16) -> Case {
    if sent.last().is_some_and(|frame| frame.cut.is_none()) {
        sent.push(Frame::new(crate::frame::PING, "behind"));
    }
    Case { name: name.into(), sent, received, code }
}

/// `length` bytes of readable text.
fn text(length: usize) -> Vec<u8> {
    (b'a'..=b'z').cycle().take(length).collect()
}
