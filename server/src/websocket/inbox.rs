//! What a client has sent and nobody has looked at: bytes in, whole messages out.
//!
//! Holds at most one unfinished message and one read's worth of frames behind it; empty, it holds
//! no memory.

use super::frame::{Fault, Header, MAX_CLIENT_HEADER, Opcode, read_header, unmask};

/// A whole message, unmasked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message<'a> {
    /// Binary data.
    Binary(&'a [u8]),
    /// A text message; nobody here reads it.
    Text,
    /// A ping with what the pong must repeat.
    Ping(&'a [u8]),
    /// A pong.
    Pong,
    /// The peer says good-bye, with a code if it gave a valid one.
    Close(Option<u16>),
}

/// See the module.
#[derive(Debug)]
pub struct Inbox {
    /// Longest message, bytes.
    limit: usize,
    bytes: Vec<u8>,
    /// Of `bytes`, what has been handed out.
    used: usize,
    /// The parts so far of a message in several frames, with what it is. At most `limit` bytes.
    parts: Option<(Opcode, Vec<u8>)>,
    /// Whether `parts` was handed out by the last call and is to be dropped by the next.
    is_whole: bool,
}

impl Inbox {
    /// An empty one for messages of at most `limit` bytes.
    #[must_use]
    pub const fn new(limit: usize) -> Self {
        Self { limit, bytes: Vec::new(), used: 0, parts: None, is_whole: false }
    }

    /// Adds what was read.
    pub fn extend(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.used);
        self.used = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next whole message; none until more is read.
    ///
    /// # Errors
    /// The client broke RFC 6455; nothing after it can be understood.
    pub fn next_message(&mut self) -> Result<Option<Message<'_>>, Fault> {
        if std::mem::take(&mut self.is_whole) {
            self.parts = None;
        }
        loop {
            let Some(header) = read_header(&self.bytes[self.used..], self.limit)? else {
                self.release();
                return Ok(None);
            };
            self.check(&header)?;
            let start = self.used + header.header_length;
            let end = start + header.payload_length;
            if end > self.bytes.len() {
                return Ok(None);
            }
            self.used = end;
            unmask(&mut self.bytes[start..end], header.mask);
            match (header.opcode, header.is_last) {
                (Opcode::Continuation, is_last) => {
                    if let Some((_, parts)) = &mut self.parts {
                        parts.extend_from_slice(&self.bytes[start..end]);
                    }
                    if is_last {
                        self.is_whole = true;
                        return Ok(self.parts.as_ref().map(|(opcode, parts)| message(*opcode, parts)));
                    }
                }
                (opcode, true) => return Ok(Some(message(opcode, &self.bytes[start..end]))),
                (opcode, false) => self.parts = Some((opcode, self.bytes[start..end].to_vec())),
            }
        }
    }

    /// Judges a frame by what came before it.
    fn check(&self, header: &Header) -> Result<(), Fault> {
        if header.opcode.is_control() {
            return Ok(());
        }
        match (&self.parts, header.opcode == Opcode::Continuation) {
            (Some((_, parts)), true) if parts.len() + header.payload_length > self.limit => {
                Err(Fault::TooLong(self.limit))
            }
            (Some(_), true) | (None, false) => Ok(()),
            (Some(_), false) | (None, true) => Err(Fault::BadSequence),
        }
    }

    /// Gives memory back when everything was handed out: most connections are silent most of the
    /// time.
    fn release(&mut self) {
        if self.used == self.bytes.len() {
            self.used = 0;
            self.bytes.clear();
            if self.bytes.capacity() > 2 * MAX_CLIENT_HEADER {
                self.bytes = Vec::new();
            }
        }
    }
}

fn message(opcode: Opcode, payload: &[u8]) -> Message<'_> {
    match opcode {
        Opcode::Text => Message::Text,
        Opcode::Ping => Message::Ping(payload),
        Opcode::Pong => Message::Pong,
        Opcode::Close => Message::Close(payload.first_chunk().map(|code| u16::from_be_bytes(*code))),
        // A continuation is handed out under the opcode that its message began with.
        Opcode::Binary | Opcode::Continuation => Message::Binary(payload),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
        assert!(payload.len() < 126);
        let mut bytes = vec![first, 0x80 | payload.len() as u8, 9, 8, 7, 6];
        let mut masked = payload.to_vec();
        unmask(&mut masked, [9, 8, 7, 6]);
        bytes.extend(masked);
        bytes
    }

    /// Everything that comes out, as owned words.
    fn drain(inbox: &mut Inbox) -> Result<Vec<String>, Fault> {
        let mut out = Vec::new();
        while let Some(message) = inbox.next_message()? {
            out.push(format!("{message:?}"));
        }
        Ok(out)
    }

    #[test]
    fn messages_come_out_alike_however_the_bytes_are_cut() {
        let all = [
            frame(0x82, b"one"),
            frame(0x02, b"tw"),
            frame(0x89, b"ping between"),
            frame(0x00, b""),
            frame(0x80, b"o"),
            frame(0x81, b"text"),
            frame(0x8a, b""),
            frame(0x88, &1000u16.to_be_bytes()),
            frame(0x88, b""),
        ]
        .concat();
        let mut whole = Inbox::new(100);
        whole.extend(&all);
        let expected = drain(&mut whole).unwrap();
        assert_eq!(expected.len(), 7);
        assert_eq!(expected[0], format!("{:?}", Message::Binary(b"one")));
        assert_eq!(expected[1], format!("{:?}", Message::Ping(b"ping between")));
        assert_eq!(expected[2], format!("{:?}", Message::Binary(b"two")));
        assert_eq!(expected[5..], ["Close(Some(1000))", "Close(None)"]);
        for size in 1..all.len() {
            let mut inbox = Inbox::new(100);
            let mut got = Vec::new();
            for part in all.chunks(size) {
                inbox.extend(part);
                got.extend(drain(&mut inbox).unwrap());
            }
            assert_eq!(got, expected, "in parts of {size}");
        }
    }

    #[test]
    fn an_endless_message_of_small_parts_is_cut_off_at_the_limit() {
        let mut inbox = Inbox::new(100);
        inbox.extend(&frame(0x02, &[0; 60]));
        assert_eq!(inbox.next_message(), Ok(None));
        inbox.extend(&frame(0x00, &[0; 40]));
        assert_eq!(inbox.next_message(), Ok(None));
        inbox.extend(&frame(0x00, &[0; 1]));
        assert_eq!(inbox.next_message(), Err(Fault::TooLong(100)));
    }

    #[test]
    fn parts_out_of_order_are_refused() {
        for frames in [vec![frame(0x80, b"x")], vec![frame(0x02, b"x"), frame(0x82, b"y")]] {
            let mut inbox = Inbox::new(100);
            inbox.extend(&frames.concat());
            assert_eq!(inbox.next_message(), Err(Fault::BadSequence));
        }
    }

    #[test]
    fn an_emptied_inbox_holds_no_memory() {
        let mut inbox = Inbox::new(1000);
        for _ in 0..3 {
            inbox.extend(&vec![frame(0x82, &[1; 100]); 20].concat());
            assert_eq!(drain(&mut inbox).unwrap().len(), 20);
            assert_eq!(inbox.bytes.capacity(), 0);
        }
    }
}
