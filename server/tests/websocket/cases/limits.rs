//! Section 9: long messages, whole and in fragments, and many short ones. Autobahn goes to 16 MiB,
//! these to 1 MiB, which the runner's limit is.

use super::{Group, text, valid, violation};
use crate::frame::{BINARY, CONTINUATION, Frame, TEXT};

/// Longest message of the echo, bytes.
pub const LIMIT: usize = 1 << 20;

pub fn group() -> Group {
    let mut cases = Vec::new();
    for (section, opcode) in [(1, TEXT), (2, BINARY)] {
        for length in [64 << 10, 256 << 10, LIMIT] {
            let payload = text(length);
            let received = vec![(opcode, payload.clone())];
            let name = format!("9.{section} {length} bytes of opcode {opcode}");
            cases.push(valid(name, vec![Frame::new(opcode, &payload)], received));
        }
    }
    for (section, opcode) in [(3, TEXT), (4, BINARY)] {
        for size in [64, 4 << 10, 64 << 10] {
            let payload = text(256 << 10);
            let mut sent: Vec<_> = payload.chunks(size).map(|part| Frame::part(CONTINUATION, part)).collect();
            sent[0].opcode = opcode;
            sent.push(Frame::new(CONTINUATION, ""));
            let name = format!("9.{section} 256 KiB in fragments of {size} bytes");
            cases.push(valid(name, sent, vec![(opcode, payload)]));
        }
    }
    for (section, opcode) in [(7, TEXT), (8, BINARY)] {
        for length in [0, 16, 1024] {
            let message = (opcode, text(length));
            let sent = vec![Frame::new(opcode, text(length)); 200];
            let name = format!("9.{section} 200 messages of {length} bytes");
            cases.push(valid(name, sent, vec![message; 200]));
        }
    }
    let long = Frame::new(BINARY, text(LIMIT + 1));
    cases.push(violation("9.9 one byte over the limit", vec![long], vec![], 1009));
    let parts = vec![Frame::part(BINARY, text(LIMIT)), Frame::new(CONTINUATION, "x")];
    cases.push(violation("9.9 one byte over the limit in the second fragment", parts, vec![], 1009));
    Group {
        name: "9 limits",
        cases,
        fault: "messages over the limit are cut",
        plant: |mut frame| {
            frame.payload.truncate(LIMIT);
            Some(frame)
        },
    }
}
