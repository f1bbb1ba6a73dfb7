//! Message assembly: bytes in, whole messages out.
//!
//! Holds at most one unfinished message and the frames of one read behind it. An empty inbox holds
//! no memory. After a Close frame or a protocol violation no further bytes are parsed.

use super::close::Close;
use super::frame::{FrameError, Header, MAX_CLIENT_HEADER, Opcode, read_header, unmask};
use super::utf8::Utf8Check;

/// A whole message, unmasked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message<'a> {
    /// Binary data.
    Binary(&'a [u8]),
    /// Text.
    Text(&'a str),
    /// A ping with the payload that the pong must repeat.
    Ping(&'a [u8]),
    /// A pong.
    Pong,
    /// A Close frame; no message follows.
    Close(Close<'a>),
}

/// Assembles the frames of a client into messages.
#[derive(Debug)]
pub struct Inbox {
    /// Longest message, bytes.
    limit: usize,
    bytes: Vec<u8>,
    /// Consumed bytes at the start of `bytes`.
    used: usize,
    /// Payload bytes of the frame behind `used` that are unmasked, and checked if they are text.
    unmasked: usize,
    /// The fragments so far of a fragmented message, with its type. At most `limit` bytes.
    fragments: Option<(Opcode, Vec<u8>)>,
    /// The text so far of a text message.
    text: Utf8Check,
    /// Whether the last call returned `fragments`, which the next call has to drop.
    is_returned: bool,
    /// The end of the stream: a Close frame or a violation.
    end: Option<Result<(), FrameError>>,
}

impl Inbox {
    /// An empty inbox for messages of at most `limit` bytes.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self {
            limit,
            bytes: Vec::new(),
            used: 0,
            unmasked: 0,
            fragments: None,
            text: Utf8Check::default(),
            is_returned: false,
            end: None,
        }
    }

    /// Adds bytes read. Behind the end of the stream they are discarded.
    pub fn extend(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.used);
        self.used = 0;
        if self.end.is_none() {
            self.bytes.extend_from_slice(bytes);
        }
    }

    /// Whether a Close frame or a violation ended the stream.
    #[must_use]
    pub const fn has_ended(&self) -> bool {
        self.end.is_some()
    }

    /// Whether the bytes so far end within a message, once [`Inbox::next_message`] has returned
    /// none.
    #[must_use]
    pub const fn is_in_message(&self) -> bool {
        self.end.is_none() && (self.fragments.is_some() || self.used < self.bytes.len())
    }

    /// Whether some fragments of a message have come, and not its last one.
    #[must_use]
    pub const fn is_fragmented(&self) -> bool {
        self.fragments.is_some()
    }

    /// The next whole message; none if it is incomplete, and behind a Close frame.
    ///
    /// # Errors
    /// The client violated RFC 6455; the rest of the stream cannot be parsed.
    pub fn next_message(&mut self) -> Result<Option<Message<'_>>, FrameError> {
        if std::mem::take(&mut self.is_returned) {
            self.fragments = None;
        }
        if let Some(end) = self.end {
            self.used = self.bytes.len();
            self.release();
            return end.map(|()| None);
        }
        let payload = match self.next_payload() {
            Ok(Some(payload)) => payload,
            Ok(None) => return Ok(None),
            Err(fault) => {
                self.end = Some(Err(fault));
                return Err(fault);
            }
        };
        let (opcode, bytes) = match &self.fragments {
            Some((opcode, fragments)) if self.is_returned => (*opcode, &fragments[..]),
            _ => (payload.opcode, &self.bytes[payload.start..payload.end]),
        };
        let message = message(opcode, bytes);
        match message {
            Ok(Message::Close(_)) => self.end = Some(Ok(())),
            Err(fault) => self.end = Some(Err(fault)),
            Ok(_) => {}
        }
        message.map(Some)
    }

    /// Consumes frames up to the last one of a message. Sets `is_returned` if the message is in
    /// `fragments`.
    fn next_payload(&mut self) -> Result<Option<Payload>, FrameError> {
        loop {
            let Some(header) = read_header(&self.bytes[self.used..], self.limit)? else {
                self.release();
                return Ok(None);
            };
            self.check(&header)?;
            let start = self.used + header.header_length;
            let end = start + header.payload_length;
            self.unmask(&header, start, end.min(self.bytes.len()))?;
            if end > self.bytes.len() {
                return Ok(None);
            }
            self.used = end;
            self.unmasked = 0;
            if header.is_last && self.is_text(&header) {
                std::mem::take(&mut self.text).finish()?;
            }
            match (header.opcode, header.is_last) {
                (Opcode::Continuation, is_last) => {
                    if let Some((_, fragments)) = &mut self.fragments {
                        fragments.extend_from_slice(&self.bytes[start..end]);
                    }
                    if is_last {
                        self.is_returned = true;
                        return Ok(Some(Payload { opcode: header.opcode, start, end }));
                    }
                }
                (opcode, true) => return Ok(Some(Payload { opcode, start, end })),
                (opcode, false) => self.fragments = Some((opcode, self.bytes[start..end].to_vec())),
            }
        }
    }

    /// Unmasks what has arrived of a frame's payload, from `start` to `end`. Text is checked at
    /// once: a peer must not be able to send a long invalid text to its end.
    fn unmask(&mut self, header: &Header, start: usize, end: usize) -> Result<(), FrameError> {
        let from = start + self.unmasked;
        if from >= end {
            return Ok(());
        }
        let mut mask = header.mask;
        mask.rotate_left(self.unmasked % 4);
        unmask(&mut self.bytes[from..end], mask);
        self.unmasked = end - start;
        if self.is_text(header) {
            self.text.push(&self.bytes[from..end])?;
        }
        Ok(())
    }

    /// Whether a frame is part of a text message.
    fn is_text(&self, header: &Header) -> bool {
        match header.opcode {
            Opcode::Text => true,
            Opcode::Continuation => matches!(self.fragments, Some((Opcode::Text, _))),
            _ => false,
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

/// The last frame of a message: its type and where its payload is.
struct Payload {
    opcode: Opcode,
    start: usize,
    end: usize,
}

fn message(opcode: Opcode, payload: &[u8]) -> Result<Message<'_>, FrameError> {
    Ok(match opcode {
        Opcode::Text => Message::Text(std::str::from_utf8(payload).map_err(|_| FrameError::NotUtf8)?),
        Opcode::Ping => Message::Ping(payload),
        Opcode::Pong => Message::Pong,
        Opcode::Close => Message::Close(Close::parse(payload)?),
        // A fragmented message has the opcode of its first frame.
        Opcode::Binary | Opcode::Continuation => Message::Binary(payload),
    })
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
            frame(0x81, "täxt".as_bytes()),
            frame(0x01, b"fragmented \xe2"),
            frame(0x8a, b""),
            frame(0x80, b"\x82\xac"),
            frame(0x88, &1001u16.to_be_bytes()),
            frame(0x82, b"behind the end"),
        ]
        .concat();
        let mut whole = Inbox::new(100);
        whole.extend(&all);
        let expected = drain(&mut whole).unwrap();
        assert_eq!(expected.len(), 7);
        assert!(whole.has_ended());
        assert_eq!(expected[0], format!("{:?}", Message::Binary(b"one")));
        assert_eq!(expected[1], format!("{:?}", Message::Ping(b"ping between")));
        assert_eq!(expected[2], format!("{:?}", Message::Binary(b"two")));
        assert_eq!(expected[5], format!("{:?}", Message::Text("fragmented €")));
        assert_eq!(expected[6], format!("{:?}", Message::Close(Close { code: Some(1001), reason: "" })));
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
    fn invalid_text_is_rejected_before_its_frame_is_complete() {
        let text = frame(0x81, b"abc\xed\xa0\x80 and more");
        for (received, expected) in [(6 + 4, Ok(None)), (6 + 5, Err(FrameError::NotUtf8))] {
            let mut inbox = Inbox::new(100);
            inbox.extend(&text[..received]);
            assert_eq!(inbox.next_message(), expected, "{received} bytes");
        }
        // A text that ends inside a character, and a binary message of the same bytes.
        for (first, is_valid) in [(0x81, false), (0x82, true)] {
            let mut inbox = Inbox::new(100);
            inbox.extend(&frame(first, b"abc\xe2\x82"));
            assert_eq!(inbox.next_message().is_ok(), is_valid);
        }
    }

    #[test]
    fn nothing_is_read_behind_a_violation() {
        let mut inbox = Inbox::new(100);
        inbox.extend(&frame(0x88, &1005u16.to_be_bytes()));
        for _ in 0..3 {
            assert_eq!(inbox.next_message(), Err(FrameError::BadCloseCode(1005)));
            inbox.extend(&frame(0x82, b"more"));
        }
        assert!(inbox.has_ended() && inbox.bytes.is_empty());
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
