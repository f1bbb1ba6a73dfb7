//! Section 2: pings and pongs.

use super::{Group, text, valid, violation};
use crate::frame::{Frame, PING, PONG};

pub fn group() -> Group {
    let mut cases = Vec::new();
    for (name, payload) in [
        ("2.1 empty", Vec::new()),
        ("2.2 text", b"Hello, world!".to_vec()),
        ("2.3 binary", vec![0, 0xff, 0xfe, 0xfd, 0, 0xff]),
        ("2.4 125 bytes", vec![0xfe; 125]),
    ] {
        cases.push(valid(name, vec![Frame::new(PING, &payload)], vec![(PONG, payload)]));
    }
    cases.push(violation("2.5 126 bytes", vec![Frame::new(PING, text(126))], vec![], 1002));
    cases.push(valid("2.7 a pong that nothing asked for", vec![Frame::new(PONG, "")], vec![]));
    cases.push(valid("2.8 the same with a payload", vec![Frame::new(PONG, "unsolicited")], vec![]));
    cases.push(valid(
        "2.9 a pong, then a ping",
        vec![Frame::new(PONG, "unsolicited"), Frame::new(PING, "ping")],
        vec![(PONG, b"ping".into())],
    ));
    let payloads: Vec<Vec<u8>> = (0..10).map(|number| format!("ping {number}").into_bytes()).collect();
    cases.push(valid(
        "2.10 ten pings are answered in order",
        payloads.iter().map(|payload| Frame::new(PING, payload)).collect(),
        payloads.iter().map(|payload| (PONG, payload.clone())).collect(),
    ));
    cases.push(violation("2.11 a pong of 126 bytes", vec![Frame::new(PONG, text(126))], vec![], 1002));
    Group {
        name: "2 pings",
        cases,
        fault: "pings are not answered",
        plant: |frame| (frame.opcode != PING || frame.payload == b"behind").then_some(frame),
    }
}
