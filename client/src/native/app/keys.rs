//! Keys of the window that are no flight controls.

use crate::scene::places::Place;
use winit::keyboard::KeyCode;

/// Action of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Ends the program.
    Quit,
    /// Ends it if pressed twice.
    AskQuit,
    /// Fills the screen, or no longer.
    Fullscreen,
    /// Writes the picture into a file.
    Screenshot,
    /// Stops the time of waves and day, or lets it go on.
    Pause,
    /// Back to the start.
    ResetView,
    /// Shows or hides the keys.
    Help,
    /// Shows or hides the panel.
    Panel,
    /// Goes to a place.
    Go(Place),
}

/// The keys as the window shows them.
pub const LINES: [(&str, &str); 14] = [
    ("drag", "look around"),
    ("W A S D, arrows", "fly"),
    ("E, Q", "up, down"),
    ("Shift, wheel", "faster; set the speed"),
    ("1 to 8", "go to a place"),
    ("R", "back to the start"),
    ("O", "orbit what is ahead"),
    ("Space", "stop the time"),
    ("H or ?", "these keys"),
    ("F1", "panel"),
    ("F11", "full screen"),
    ("F12", "picture into a file"),
    ("Ctrl + and -", "size of the text"),
    ("Esc twice, Ctrl Q", "quit"),
];

/// What a pressed key does, by its place on the keyboard; `text` is what it writes in the user's
/// layout. While a text field has the focus, keys that write do nothing else.
#[must_use]
pub fn action(code: KeyCode, text: &str, has_control: bool, is_typing: bool) -> Option<Action> {
    if text.eq_ignore_ascii_case("q") && has_control {
        return Some(Action::Quit);
    }
    match code {
        KeyCode::F1 => return Some(Action::Panel),
        KeyCode::F11 => return Some(Action::Fullscreen),
        KeyCode::F12 => return Some(Action::Screenshot),
        _ if is_typing || has_control => return None,
        _ if text == "?" => return Some(Action::Help),
        _ => {}
    }
    let digits = [
        KeyCode::Digit1,
        KeyCode::Digit2,
        KeyCode::Digit3,
        KeyCode::Digit4,
        KeyCode::Digit5,
        KeyCode::Digit6,
        KeyCode::Digit7,
        KeyCode::Digit8,
    ];
    if let Some(index) = digits.iter().position(|digit| *digit == code) {
        return Place::ALL.get(index).copied().map(Action::Go);
    }
    match code {
        KeyCode::Escape => Some(Action::AskQuit),
        KeyCode::Space => Some(Action::Pause),
        KeyCode::KeyR => Some(Action::ResetView),
        KeyCode::KeyH => Some(Action::Help),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escape_leaves_a_text_field_before_it_quits_and_control_q_always_quits() {
        assert_eq!(action(KeyCode::Escape, "", false, true), None);
        assert_eq!(action(KeyCode::Escape, "", false, false), Some(Action::AskQuit));
        assert_eq!(action(KeyCode::KeyQ, "q", true, true), Some(Action::Quit));
        assert_eq!(action(KeyCode::KeyQ, "q", false, false), None, "Q alone flies down");
        // On an AZERTY keyboard A and Q have changed places.
        assert_eq!(action(KeyCode::KeyA, "Q", true, true), Some(Action::Quit));
        assert_eq!(action(KeyCode::KeyQ, "a", true, true), None, "selects all of a text field");
    }

    #[test]
    fn digits_go_to_the_places_in_order_and_write_into_text_fields() {
        assert_eq!(action(KeyCode::Digit1, "", false, false), Some(Action::Go(Place::Beach)));
        assert_eq!(action(KeyCode::Digit8, "", false, false), Some(Action::Go(Place::From20Km)));
        assert_eq!(action(KeyCode::Digit9, "", false, false), None);
        assert_eq!(action(KeyCode::Digit1, "", false, true), None);
        assert_eq!(action(KeyCode::Digit1, "", true, false), None);
    }

    #[test]
    fn a_question_mark_shows_the_keys_wherever_the_layout_has_it() {
        assert_eq!(action(KeyCode::Minus, "?", false, false), Some(Action::Help));
        assert_eq!(action(KeyCode::Slash, "-", false, false), None);
        assert_eq!(action(KeyCode::Minus, "?", false, true), None, "writes into a text field");
    }
}
