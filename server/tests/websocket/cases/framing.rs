//! Section 1: every form of the length, text and binary; masks and lengths that may not be sent.

use super::{Case, Group, text, valid, violation};
use crate::frame::{BINARY, Frame, Length, TEXT};

pub fn group() -> Group {
    let mut cases = Vec::new();
    for (section, opcode) in [(1, TEXT), (2, BINARY)] {
        for length in [0, 1, 125, 126, 127, 128, 65_535, 65_536] {
            let payload = if opcode == TEXT { text(length) } else { vec![0xfe; length] };
            let name = format!("1.{section} {length} bytes of opcode {opcode}");
            cases.push(valid(name, vec![Frame::new(opcode, &payload)], vec![(opcode, payload)]));
        }
    }
    let invalid = |name: &str, frame: Frame| -> Case {
        violation(name, vec![Frame::new(BINARY, "before"), frame], vec![(BINARY, b"before".into())], 1002)
    };
    let frame = Frame::new(BINARY, text(100));
    cases.push(invalid("1.3 unmasked", Frame { is_masked: false, ..frame.clone() }));
    cases.push(invalid("1.3 100 bytes in 16 bits", Frame { length: Length::Medium, ..frame.clone() }));
    cases.push(invalid("1.3 100 bytes in 64 bits", Frame { length: Length::Long, ..frame.clone() }));
    let medium = Frame { length: Length::Long, ..Frame::new(BINARY, text(1000)) };
    cases.push(invalid("1.3 1,000 bytes in 64 bits", medium));
    cases.push(invalid("1.3 a length of 2^63", Frame { length: Length::False(1 << 63), ..frame }));
    Group {
        name: "1 framing",
        cases,
        fault: "longer forms of the length are read wrongly",
        plant: |mut frame| {
            let length = frame.payload.len();
            frame.payload.truncate(if length > 125 { length - 1 } else { length });
            Some(frame)
        },
    }
}
