//! Short lines over the picture: hints, answers to keys, and the question before quitting.

use std::time::{Duration, Instant};

/// How long a line fades before it goes.
const FADE: Duration = Duration::from_millis(800);
/// Within this time a second Esc quits.
const QUIT_WITHIN: Duration = Duration::from_secs(2);
/// Lines at a time; a further one replaces the oldest.
const MOST: usize = 4;

/// Lines with the time at which they go.
#[derive(Debug, Default)]
pub struct Notices {
    lines: Vec<(String, Instant)>,
    quit_until: Option<Instant>,
}

impl Notices {
    /// Shows a line for some time; a line that is shown stays longer.
    pub fn show(&mut self, line: &str, now: Instant, lasts: Duration) {
        self.lines.retain(|(shown, until)| shown != line && *until > now);
        if self.lines.len() == MOST {
            self.lines.remove(0);
        }
        self.lines.push((line.to_owned(), now + lasts));
    }

    /// Esc was pressed; true if it was pressed a short time before.
    pub fn is_second_escape(&mut self, now: Instant) -> bool {
        if self.quit_until.is_some_and(|until| now <= until) {
            return true;
        }
        self.quit_until = Some(now + QUIT_WITHIN);
        self.show("Esc again quits", now, QUIT_WITHIN);
        false
    }

    /// The lines that are shown, with their opacity, 0 to 1.
    pub fn shown(&self, now: Instant) -> impl Iterator<Item = (&str, f32)> {
        self.lines.iter().filter(move |(_, until)| *until > now).map(move |(line, until)| {
            let left = (*until - now).as_secs_f32() / FADE.as_secs_f32();
            (line.as_str(), left.min(1.0))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_escape_quits_only_while_the_question_is_shown() {
        let (mut notices, now) = (Notices::default(), Instant::now());
        assert!(!notices.is_second_escape(now));
        assert_eq!(notices.shown(now).next(), Some(("Esc again quits", 1.0)));
        assert!(notices.is_second_escape(now + Duration::from_millis(1900)));
        let mut late = Notices::default();
        assert!(!late.is_second_escape(now));
        assert!(!late.is_second_escape(now + Duration::from_millis(2100)));
    }

    #[test]
    fn lines_fade_and_go() {
        let (mut notices, now) = (Notices::default(), Instant::now());
        notices.show("a", now, Duration::from_secs(3));
        let opacity = |millis| notices.shown(now + Duration::from_millis(millis)).next().map(|line| line.1);
        assert_eq!((opacity(0), opacity(3001)), (Some(1.0), None));
        assert!(opacity(2600).is_some_and(|opacity| (0.4..0.6).contains(&opacity)));
        for index in 0..9 {
            notices.show(&index.to_string(), now, Duration::from_secs(3));
        }
        assert_eq!(notices.shown(now).count(), MOST);
    }
}
