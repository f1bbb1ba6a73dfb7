//! Section 4: opcodes without a meaning.

use super::{Group, violation};
use crate::frame::{BINARY, Frame, PING, PONG, TEXT};

pub fn group() -> Group {
    let mut cases = Vec::new();
    for (section, opcodes) in [(1, 3..=7), (2, 11..=15)] {
        for opcode in opcodes {
            for payload in ["", "reserved"] {
                let name = format!("4.{section} opcode {opcode}, {} bytes", payload.len());
                let frame = Frame::new(opcode, payload);
                cases.push(violation(name.clone(), vec![frame.clone()], vec![], 1002));
                let sent = vec![Frame::new(TEXT, "before"), Frame::new(PING, ""), frame];
                let received = vec![(TEXT, b"before".to_vec()), (PONG, Vec::new())];
                cases.push(violation(format!("{name}, behind others"), sent, received, 1002));
            }
        }
    }
    Group {
        name: "4 opcodes",
        cases,
        fault: "unknown opcodes are taken for the known ones below them",
        plant: |mut frame| {
            frame.opcode = match frame.opcode {
                3..=7 => BINARY,
                11..=15 => PONG,
                known => known,
            };
            Some(frame)
        },
    }
}
