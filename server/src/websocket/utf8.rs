//! UTF-8 in parts: a text is rejected at the first byte that cannot be continued, however it is
//! split into frames and reads.

use super::frame::FrameError;

/// Longest character, bytes.
const MAX_CHARACTER: usize = 4;

/// The state between two parts of a text.
#[derive(Clone, Copy, Debug, Default)]
pub struct Utf8Check {
    /// The start of a character whose end has not arrived.
    start: [u8; MAX_CHARACTER],
    length: usize,
}

impl Utf8Check {
    /// Checks the next part of the text.
    ///
    /// # Errors
    /// [`FrameError::NotUtf8`] if no further part could make the text valid.
    pub fn push(&mut self, mut part: &[u8]) -> Result<(), FrameError> {
        while self.length > 0 {
            let Some((first, rest)) = part.split_first() else { return Ok(()) };
            part = rest;
            // An incomplete character has at most three bytes.
            self.start[self.length] = *first;
            self.length += 1;
            match std::str::from_utf8(&self.start[..self.length]) {
                Ok(_) => self.length = 0,
                Err(error) if error.error_len().is_some() => return Err(FrameError::NotUtf8),
                Err(_) => {}
            }
        }
        match std::str::from_utf8(part) {
            Ok(_) => Ok(()),
            Err(error) if error.error_len().is_some() => Err(FrameError::NotUtf8),
            Err(error) => {
                let start = &part[error.valid_up_to()..];
                self.start[..start.len()].copy_from_slice(start);
                self.length = start.len();
                Ok(())
            }
        }
    }

    /// Checks that the text does not end inside a character.
    ///
    /// # Errors
    /// [`FrameError::NotUtf8`] if it does.
    pub const fn finish(&self) -> Result<(), FrameError> {
        if self.length == 0 { Ok(()) } else { Err(FrameError::NotUtf8) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The result for a text in parts of `size` bytes, and the bytes after which it is known.
    fn check(text: &[u8], size: usize) -> (Result<(), FrameError>, usize) {
        let (mut check, mut read) = (Utf8Check::default(), 0);
        for part in text.chunks(size) {
            read += part.len();
            if let Err(error) = check.push(part) {
                return (Err(error), read);
            }
        }
        (check.finish(), read)
    }

    #[test]
    fn every_split_gives_the_result_of_the_whole() {
        let texts: [&[u8]; 12] = [
            b"",
            b"plain",
            "κόσμε ß € 😀 \u{10ffff}".as_bytes(),
            b"\xce",
            b"\xe2\x82",
            b"\xf0\x9f\x98",
            b"\xc0\x80",
            b"\xed\xa0\x80",
            b"\xf4\x90\x80\x80",
            b"\xf8\x88\x80\x80\x80",
            b"a\x80b",
            b"\xce\xba\xff",
        ];
        for text in texts {
            let expected = std::str::from_utf8(text).is_ok();
            for size in 1..=text.len().max(1) {
                assert_eq!(check(text, size).0.is_ok(), expected, "{text:02x?} in parts of {size}");
            }
        }
    }

    #[test]
    fn a_text_is_rejected_at_the_first_impossible_byte() {
        for (text, read) in [
            (&b"ab\xf4\x90\x80\x80"[..], 4),
            (b"\xed\xa0\x80", 2),
            (b"\xc0\x80", 1),
            (b"\xe0\x80\x80", 2),
            (b"a\x80", 2),
            (b"\xce\xbaa\xe1\xa0a", 6),
        ] {
            assert_eq!(check(text, 1), (Err(FrameError::NotUtf8), read), "{text:02x?}");
        }
    }
}
