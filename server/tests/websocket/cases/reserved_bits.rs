//! Section 3: reserved bits, which only extensions may set.

use super::{Group, violation};
use crate::frame::{BINARY, CLOSE, Frame, PING, PONG, TEXT};

pub fn group() -> Group {
    let mut cases = Vec::new();
    for reserved in 1..8 {
        for opcode in [TEXT, BINARY, CLOSE, PING, PONG] {
            let payload: &[u8] = if opcode == CLOSE { &[3, 0xe8] } else { b"reserved" };
            let frame = Frame { reserved, ..Frame::new(opcode, payload) };
            let name = format!("3.{reserved} opcode {opcode} with reserved bits {reserved:03b}");
            cases.push(violation(name.clone(), vec![frame.clone()], vec![], 1002));
            let name = format!("{name}, behind a message");
            let sent = vec![Frame::new(TEXT, "before"), frame];
            cases.push(violation(name, sent, vec![(TEXT, b"before".into())], 1002));
        }
    }
    Group {
        name: "3 reserved bits",
        cases,
        fault: "reserved bits are ignored",
        plant: |frame| Some(Frame { reserved: 0, ..frame }),
    }
}
