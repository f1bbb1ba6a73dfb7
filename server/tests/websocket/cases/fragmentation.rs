//! Section 5: messages in several frames, and control frames between them.

use super::{Group, valid, violation};
use crate::frame::{BINARY, CLOSE, CONTINUATION, Frame, PING, PONG, TEXT};

pub fn group() -> Group {
    let both = || vec![(TEXT, b"fragment1fragment2".to_vec())];
    let pong = |payload: &str| (PONG, payload.as_bytes().to_vec());
    let first = || Frame::part(TEXT, "fragment1");
    let last = || Frame::new(CONTINUATION, "fragment2");
    let mut cases = vec![
        violation("5.1 a fragmented ping", vec![Frame::part(PING, "fragment1"), last()], vec![], 1002),
        violation("5.2 a fragmented pong", vec![Frame::part(PONG, "fragment1"), last()], vec![], 1002),
        violation("5.2 a fragmented Close frame", vec![Frame::part(CLOSE, [3, 0xe8])], vec![], 1002),
        valid("5.3 two fragments", vec![first(), last()], both()),
        valid(
            "5.6 a ping between two fragments",
            vec![first(), Frame::new(PING, "ping"), last()],
            [vec![pong("ping")], both()].concat(),
        ),
        valid("5.7 a pong between two fragments", vec![first(), Frame::new(PONG, "pong"), last()], both()),
        violation(
            "5.15 a continuation behind a whole fragmented message",
            vec![first(), last(), Frame::part(CONTINUATION, "fragment3"), Frame::new(TEXT, "fragment4")],
            both(),
            1002,
        ),
        violation(
            "5.18 a second message inside the first",
            vec![first(), Frame::new(TEXT, "x")],
            vec![],
            1002,
        ),
        violation("5.18 a second binary message", vec![first(), Frame::new(BINARY, "x")], vec![], 1002),
        violation("5.18 a second start", vec![first(), Frame::part(TEXT, "x")], vec![], 1002),
        valid(
            "5.19 five fragments and two pings",
            vec![
                Frame::part(TEXT, "one"),
                Frame::part(CONTINUATION, "two"),
                Frame::new(PING, "ping 1"),
                Frame::part(CONTINUATION, ""),
                Frame::part(CONTINUATION, "four"),
                Frame::new(PING, "ping 2"),
                Frame::new(CONTINUATION, "five"),
            ],
            vec![pong("ping 1"), pong("ping 2"), (TEXT, b"onetwofourfive".into())],
        ),
        valid(
            "5.20 binary fragments, then a text",
            vec![Frame::part(BINARY, [0xff]), Frame::new(CONTINUATION, [0xfe]), Frame::new(TEXT, "text")],
            vec![(BINARY, vec![0xff, 0xfe]), (TEXT, b"text".into())],
        ),
    ];
    for (is_last, number) in [(true, 9), (false, 12)] {
        for payload in ["", "continuation"] {
            let name = format!("5.{number} a continuation without a message, {} bytes", payload.len());
            let stray = Frame { is_last, ..Frame::new(CONTINUATION, payload) };
            cases.push(violation(name.clone(), vec![stray.clone()], vec![], 1002));
            let sent = vec![Frame::new(BINARY, "before"), stray];
            let received = vec![(BINARY, b"before".to_vec())];
            cases.push(violation(format!("{name}, behind a message"), sent, received, 1002));
        }
    }
    Group {
        name: "5 fragmentation",
        cases,
        fault: "control frames may be fragmented",
        plant: |mut frame| {
            frame.is_last |= frame.opcode >= CLOSE;
            Some(frame)
        },
    }
}
