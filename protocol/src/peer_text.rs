//! Texts of a peer, for display.

use crate::limits::MAX_TEXT;

/// A text of a peer as one line of at most [`MAX_TEXT`] bytes: control characters, which could
/// drive a terminal, separators of lines and marks that reverse the direction of text are replaced.
#[must_use]
pub fn one_line(text: &str) -> String {
    let is_replaced = |mark: char| {
        let marks = ['\u{200e}'..='\u{200f}', '\u{2028}'..='\u{202e}', '\u{2066}'..='\u{2069}'];
        mark.is_control() || mark == '\u{61c}' || marks.iter().any(|marks| marks.contains(&mark))
    };
    text[..text.floor_char_boundary(MAX_TEXT)]
        .chars()
        .map(|mark| if is_replaced(mark) { '?' } else { mark })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_text_of_a_peer_drives_a_terminal_or_is_long() {
        assert_eq!(one_line("tombolo-server 0.1, Mürren"), "tombolo-server 0.1, Mürren");
        assert_eq!(one_line("a\n\x1b[2Jb\u{202e}c\u{2028}d\u{61c}"), "a??[2Jb?c?d?");
        assert!(one_line(&"ü".repeat(1000)).len() <= MAX_TEXT);
    }
}
