//! Message assembly: bytes in, whole messages out.
//!
//! Holds at most one unfinished message and the frames of one read behind it. An empty inbox holds
//! no memory.

use super::frame::{FrameError, Header, MAX_CLIENT_HEADER, Opcode, read_header, unmask};

/// A whole message, unmasked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message<'a> {
    /// Binary data.
    Binary(&'a [u8]),
    /// A text message, whose payload is not read.
    Text,
    /// A ping with the payload that the pong must repeat.
    Ping(&'a [u8]),
    /// A pong.
    Pong,
    /// A close frame, with its code if it has one.
    Close(Option<u16>),
}

/// See the module.
#[derive(Debug)]
pub struct Inbox {
    /// Longest message, bytes.
    limit: usize,
    bytes: Vec<u8>,
    /// Consumed bytes at the start of `bytes`.
    used: usize,
    /// The fragments so far of a fragmented message, with its type. At most `limit` bytes.
    fragments: Option<(Opcode, Vec<u8>)>,
    /// Whether the last call returned `fragments`, which the next call has to drop.
    is_returned: bool,
}

impl Inbox {
    /// An empty inbox for messages of at most `limit` bytes.
    #[must_use]
    pub const fn new(limit: usize) -> Self {
        Self { limit, bytes: Vec::new(), used: 0, fragments: None, is_returned: false }
    }

    /// Adds bytes read.
    pub fn extend(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.used);
        self.used = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next whole message; none if it is incomplete.
    ///
    /// # Errors
    /// The client violated RFC 6455; the rest of the stream cannot be parsed.
    pub fn next_message(&mut self) -> Result<Option<Message<'_>>, FrameError> {
        if std::mem::take(&mut self.is_returned) {
            self.fragments = None;
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
                    if let Some((_, fragments)) = &mut self.fragments {
                        fragments.extend_from_slice(&self.bytes[start..end]);
                    }
                    if is_last {
                        self.is_returned = true;
                        return Ok(self
                            .fragments
                            .as_ref()
                            .map(|(opcode, fragments)| message(*opcode, fragments)));
                    }
                }
                (opcode, true) => return Ok(Some(message(opcode, &self.bytes[start..end]))),
                (opcode, false) => self.fragments = Some((opcode, self.bytes[start..end].to_vec())),
            }
        }
    }

    /// Checks a frame against the fragments before it.
    fn check(&self, header: &Header) -> Result<(), FrameError> {
        if header.opcode.is_control() {
            return Ok(());
        }
        match (&self.fragments, header.opcode == Opcode::Continuation) {
            (Some((_, fragments)), true) if fragments.len() + header.payload_length > self.limit => {
                Err(FrameError::TooLong(self.limit))
            }
            (Some(_), true) | (None, false) => Ok(()),
            (Some(_), false) | (None, true) => Err(FrameError::BadSequence),
        }
    }

    /// Frees the buffer when it is consumed: most connections are idle most of the time.
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
        // A fragmented message has the opcode of its first frame.
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

    /// All messages as text.
    fn drain(inbox: &mut Inbox) -> Result<Vec<String>, FrameError> {
        let mut out = Vec::new();
        while let Some(message) = inbox.next_message()? {
            out.push(format!("{message:?}"));
        }
        Ok(out)
    }

    #[test]
    fn messages_do_not_depend_on_how_the_bytes_are_split() {
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
            assert_eq!(got, expected, "in chunks of {size}");
        }
    }

    #[test]
    fn a_fragmented_message_is_rejected_at_the_limit() {
        let mut inbox = Inbox::new(100);
        inbox.extend(&frame(0x02, &[0; 60]));
        assert_eq!(inbox.next_message(), Ok(None));
        inbox.extend(&frame(0x00, &[0; 40]));
        assert_eq!(inbox.next_message(), Ok(None));
        inbox.extend(&frame(0x00, &[0; 1]));
        assert_eq!(inbox.next_message(), Err(FrameError::TooLong(100)));
    }

    #[test]
    fn fragments_out_of_order_are_rejected() {
        for frames in [vec![frame(0x80, b"x")], vec![frame(0x02, b"x"), frame(0x82, b"y")]] {
            let mut inbox = Inbox::new(100);
            inbox.extend(&frames.concat());
            assert_eq!(inbox.next_message(), Err(FrameError::BadSequence));
        }
    }

    #[test]
    fn an_empty_inbox_holds_no_memory() {
        let mut inbox = Inbox::new(1000);
        for _ in 0..3 {
            inbox.extend(&vec![frame(0x82, &[1; 100]); 20].concat());
            assert_eq!(drain(&mut inbox).unwrap().len(), 20);
            assert_eq!(inbox.bytes.capacity(), 0);
        }
    }
}
