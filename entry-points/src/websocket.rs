//! A client's bytes after the handshake, by the assembly of messages.

use server::websocket::frame::{FrameError, unmask};
use server::websocket::inbox::Inbox;

/// Longest message, bytes: short, so that limits are reached.
const LIMIT: usize = 512;

/// Assembles messages, in parts of a size that the first byte selects, and of one byte. Both give
/// the same.
///
/// # Panics
/// They do not, or a violation has a code that may not be sent.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let Some((first, rest)) = bytes.split_first() else { return false };
    let whole = assemble(rest, usize::from(*first) + 1);
    assert_eq!(assemble(rest, 1), whole);
    let (messages, end) = whole;
    if let Err(fault) = end {
        assert!(server::websocket::close::may_be_sent(fault.close_code()));
    }
    !messages.is_empty()
}

/// The messages as text, and how the stream ended.
fn assemble(bytes: &[u8], size: usize) -> (Vec<String>, Result<(), FrameError>) {
    let (mut inbox, mut messages) = (Inbox::new(LIMIT), Vec::new());
    for part in bytes.chunks(size) {
        inbox.extend(part);
        loop {
            match inbox.next_message() {
                Ok(Some(message)) => messages.push(format!("{message:?}")),
                Ok(None) => break,
                Err(fault) => return (messages, Err(fault)),
            }
        }
    }
    (messages, Ok(()))
}

/// Every type of frame.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let frames = [
        frame(0x82, &[7; 200]),
        frame(0x01, "tä".as_bytes()),
        frame(0x89, b"ping"),
        frame(0x80, "xt".as_bytes()),
        frame(0x8a, b""),
        frame(0x88, b"\x03\xe8bye"),
    ];
    let all = frames.concat();
    let mut seeds = vec![[vec![16], all].concat()];
    seeds.extend(frames.map(|frame| [vec![3], frame].concat()));
    seeds
}

fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
    let mask = [9, 8, 7, 6];
    let mut masked = payload.to_vec();
    unmask(&mut masked, mask);
    let length = match u8::try_from(payload.len()) {
        Ok(short @ 0..126) => vec![0x80 | short],
        _ => [&[0x80 | 126][..], &(payload.len() as u16).to_be_bytes()].concat(),
    };
    [vec![first], length, mask.to_vec(), masked].concat()
}
