//! Time of what moves: waves and clouds, and the sun while the day plays.

use crate::settings::SunPosition;
use std::time::Duration;

/// Hours of the day that pass in a second while it plays.
const HOURS_PER_S: f32 = 0.25;

/// Time of waves and day.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    time_s: f64,
    /// Whether the time stands still.
    pub is_paused: bool,
}

/// Time of day.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Day {
    /// Hours since midnight, 0 to 24.
    pub hours: f32,
    /// Whether the sun moves.
    pub plays: bool,
}

impl Clock {
    /// A clock that begins at a time, seconds.
    #[must_use]
    pub fn at(time_s: f64) -> Self {
        Self { time_s, is_paused: false }
    }

    /// Lets time pass, and the sun move if the day plays.
    pub fn step(&mut self, step: Duration, day: &mut Day, sun: &mut Option<SunPosition>) {
        if self.is_paused {
            return;
        }
        self.time_s += step.as_secs_f64();
        if day.plays {
            day.hours = (day.hours + step.as_secs_f32() * HOURS_PER_S) % 24.0;
            *sun = Some(SunPosition::at_hour(day.hours));
        }
    }

    /// Seconds since the beginning.
    #[must_use]
    pub fn time_s(&self) -> f32 {
        self.time_s as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_paused_clock_stands_and_a_day_that_plays_moves_the_sun() {
        let (mut clock, mut sun) = (Clock::at(1.0), None);
        let mut day = Day { hours: 23.0, plays: false };
        clock.step(Duration::from_secs(2), &mut day, &mut sun);
        assert_eq!((clock.time_s(), day.hours, sun), (3.0, 23.0, None));
        day.plays = true;
        clock.step(Duration::from_secs(8), &mut day, &mut sun);
        assert_eq!((day.hours, sun), (1.0, Some(SunPosition::at_hour(1.0))));
        clock.is_paused = true;
        clock.step(Duration::from_secs(8), &mut day, &mut sun);
        assert_eq!((clock.time_s(), day.hours), (11.0, 1.0));
    }
}
