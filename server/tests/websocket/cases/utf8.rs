//! Section 6: text is UTF-8, in whole and in fragments. An invalid text is rejected at its first
//! impossible byte. Sequences are those of Kuhn's "UTF-8 decoder capability and stress test".

use super::{Case, Group, valid, violation};
use crate::frame::{CONTINUATION, Frame, TEXT};

/// Valid texts: characters at both ends of each length, and beside the surrogates.
const VALID: [&str; 14] = [
    "",
    "Hello-µ@ßöäüàá-UTF-8!!",
    "κόσμε",
    "\0",
    "\u{7f}",
    "\u{80}",
    "\u{7ff}",
    "\u{800}",
    "\u{d7ff}\u{e000}\u{fffd}",
    "\u{ffff}",
    "\u{10000}",
    "\u{10ffff}",
    "\u{fdd0}\u{1fffe}\u{2ffff}",
    "日本語 😀 €",
];

/// Invalid texts, each with the number of bytes after which no continuation could be valid; none if
/// only its end is missing.
const INVALID: [(&str, &[u8], Option<usize>); 27] = [
    ("a continuation byte", b"\x80", Some(1)),
    ("the last continuation byte", b"\xbf", Some(1)),
    ("continuation bytes", b"a\x80\xbf\x80", Some(2)),
    ("a start of two bytes, then a space", b"\xc3 ", Some(2)),
    ("a start of three bytes, then a space", b"\xe1\xa0 ", Some(3)),
    ("a start of four bytes, then a space", b"\xf1\xa0\xa0 ", Some(4)),
    ("a start of five bytes", b"\xf8\x88\x80\x80\x80", Some(1)),
    ("a start of six bytes", b"\xfc\x84\x80\x80\x80\x80", Some(1)),
    ("two bytes, cut", b"\xdf", None),
    ("three bytes, cut", b"\xef\xbf", None),
    ("four bytes, cut", b"\xf4\x8f\xbf", None),
    ("valid, then cut", b"\xce\xba\xe1\xbd", None),
    ("byte fe", b"\xfe", Some(1)),
    ("byte ff", b"\xff", Some(1)),
    ("fe fe ff ff", b"\xfe\xfe\xff\xff", Some(1)),
    ("overlong, two bytes", b"\xc0\xaf", Some(1)),
    ("overlong, the largest of two bytes", b"\xc1\xbf", Some(1)),
    ("overlong, three bytes", b"\xe0\x80\xaf", Some(2)),
    ("overlong, four bytes", b"\xf0\x80\x80\xaf", Some(2)),
    ("overlong zero", b"\xe0\x80\x80", Some(2)),
    ("the first surrogate", b"\xed\xa0\x80", Some(2)),
    ("the last surrogate", b"\xed\xbf\xbf", Some(2)),
    ("a pair of surrogates", b"\xed\xa0\x80\xed\xb0\x80", Some(2)),
    ("beyond U+10FFFF", b"\xf4\x90\x80\x80", Some(2)),
    ("far beyond", b"\xf5\x80\x80\x80", Some(1)),
    ("inside a text", b"\xce\xba\xcf\x8c\xed\xa0\x80edited", Some(6)),
    ("at the end", b"Hello-\xc2\xb5\xf4\x90\x80\x80", Some(10)),
];

/// A text as one frame, in two fragments at every place, and in fragments of one byte.
fn splits(text: &[u8]) -> Vec<(String, Vec<Frame>)> {
    let mut splits = vec![("whole".into(), vec![Frame::new(TEXT, text)])];
    for at in 0..text.len() {
        let fragments = vec![Frame::part(TEXT, &text[..at]), Frame::new(CONTINUATION, &text[at..])];
        splits.push((format!("split at {at}"), fragments));
    }
    let mut single: Vec<_> = text.iter().map(|byte| Frame::part(CONTINUATION, [*byte])).collect();
    if let [first, ..] = &mut single[..] {
        first.opcode = TEXT;
        single.push(Frame::new(CONTINUATION, ""));
        splits.push(("byte by byte".into(), single));
    }
    splits
}

/// The client sends an invalid text up to its first impossible byte, and waits.
fn at_once(name: &str, text: &[u8], impossible: usize) -> Case {
    let long = [text, &b"x".repeat(100)].concat();
    let mut frame = Frame::new(TEXT, long);
    // Behind a header of two bytes and a mask of four.
    frame.cut = Some(frame.bytes().len() - frame.payload.len() + impossible);
    violation(format!("6.4 {name}, before the rest of its frame"), vec![frame], vec![], 1007)
}

pub fn group() -> Group {
    let mut cases = Vec::new();
    for text in VALID {
        for (split, sent) in splits(text.as_bytes()) {
            let name = format!("6.2 {text:?}, {split}");
            cases.push(valid(name, sent, vec![(TEXT, text.as_bytes().to_vec())]));
        }
    }
    for (name, text, impossible) in INVALID {
        for (split, sent) in splits(text) {
            cases.push(violation(format!("6.3 {name}, {split}"), sent, vec![], 1007));
        }
        cases.extend(impossible.map(|impossible| at_once(name, text, impossible)));
    }
    Group {
        name: "6 UTF-8",
        cases,
        fault: "invalid text is repaired",
        plant: |mut frame| {
            if frame.opcode == TEXT && frame.cut.is_none() {
                frame.payload = String::from_utf8_lossy(&frame.payload).into_owned().into();
            }
            Some(frame)
        },
    }
}
