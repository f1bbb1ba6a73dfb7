//! Section 7: Close frames, what follows them, their codes and reasons.

use super::{Case, Group, text, violation};
use crate::frame::{BINARY, CLOSE, CONTINUATION, Frame, PING, TEXT};

/// Codes that are sent back as they came.
pub const VALID_CODES: [u16; 17] =
    [1000, 1001, 1002, 1003, 1007, 1008, 1009, 1010, 1011, 1012, 1013, 1014, 3000, 3999, 4000, 4998, 4999];

/// Codes that no endpoint may send.
pub const INVALID_CODES: [u16; 15] =
    [0, 1, 999, 1004, 1005, 1006, 1015, 1016, 1100, 1999, 2000, 2999, 5000, 65_534, 65_535];

/// A Close frame is answered with its code, and nothing behind it is answered.
fn closed(name: impl Into<String>, sent: Vec<Frame>, received: Vec<(u8, Vec<u8>)>, code: u16) -> Case {
    violation(name, sent, received, code)
}

pub fn group() -> Group {
    let close = || Frame::close(1000, "");
    let mut cases = vec![
        closed(
            "7.1.1 a message, then Close",
            vec![Frame::new(TEXT, "before"), close()],
            vec![(TEXT, b"before".into())],
            1000,
        ),
        closed("7.1.2 two Close frames", vec![close(), Frame::close(1001, "")], vec![], 1000),
        closed("7.1.3 a ping behind Close", vec![close(), Frame::new(PING, "ping")], vec![], 1000),
        closed("7.1.4 a text behind Close", vec![close(), Frame::new(TEXT, "text")], vec![], 1000),
        closed(
            "7.1.5 Close inside a fragmented message",
            vec![Frame::part(TEXT, "one"), close(), Frame::new(CONTINUATION, "two")],
            vec![],
            1000,
        ),
        closed(
            "7.1.6 256 KiB, Close, then a ping",
            vec![Frame::new(BINARY, text(256 << 10)), close(), Frame::new(PING, "")],
            vec![(BINARY, text(256 << 10))],
            1000,
        ),
        closed("7.1.6 a violation behind Close", vec![close(), Frame::new(3, "")], vec![], 1000),
        closed("7.3.1 an empty payload", vec![Frame::new(CLOSE, "")], vec![], 1000),
        closed("7.3.2 one byte", vec![Frame::new(CLOSE, [3])], vec![], 1002),
        closed("7.3.4 a reason", vec![Frame::close(1000, "Hello, world!")], vec![], 1000),
        closed("7.3.5 a reason of 123 bytes", vec![Frame::close(1000, text(123))], vec![], 1000),
        closed("7.3.6 a reason of 124 bytes", vec![Frame::close(1000, text(124))], vec![], 1002),
        closed("7.5.1 a reason that is not UTF-8", vec![Frame::close(1000, b"\xed\xa0\x80")], vec![], 1007),
        closed("7.5.1 a reason that is cut", vec![Frame::close(4000, b"abc\xe2\x82")], vec![], 1007),
    ];
    for code in VALID_CODES {
        cases.push(closed(format!("7.7 code {code}"), vec![Frame::close(code, "")], vec![], code));
        let name = format!("7.7 code {code} with a reason");
        cases.push(closed(name, vec![Frame::close(code, "reason")], vec![], code));
    }
    for code in INVALID_CODES {
        cases.push(closed(format!("7.9 code {code}"), vec![Frame::close(code, "")], vec![], 1002));
        let name = format!("7.9 code {code} with a reason");
        cases.push(closed(name, vec![Frame::close(code, "reason")], vec![], 1002));
    }
    Group {
        name: "7 close handling",
        cases,
        fault: "every code may be sent",
        plant: |mut frame| {
            if frame.opcode == CLOSE
                && let [high, low, ..] = &mut frame.payload[..]
                && INVALID_CODES.contains(&u16::from_be_bytes([*high, *low]))
            {
                [*high, *low] = 1000u16.to_be_bytes();
            }
            Some(frame)
        },
    }
}
