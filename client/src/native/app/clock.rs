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

impl Day {
    /// The time of day, in tenths of an hour, whose sun is nearest to a position. It stands.
    #[must_use]
    pub fn nearest_to(sun: SunPosition) -> Self {
        let nearness = |hours: f32| cosine_between(SunPosition::at_hour(hours), sun);
        let hours = (0..240u16).map(|tenths| f32::from(tenths) / 10.0);
        let nearest = hours.max_by(|a, b| nearness(*a).total_cmp(&nearness(*b)));
        Self { hours: nearest.unwrap_or_default(), plays: false }
    }
}

/// Cosine of the angle between two directions.
fn cosine_between(one: SunPosition, other: SunPosition) -> f32 {
    let [one_up, other_up] = [one, other].map(|position| position.elevation_deg.to_radians());
    let turn = (one.azimuth_deg - other.azimuth_deg).to_radians();
    one_up.sin() * other_up.sin() + one_up.cos() * other_up.cos() * turn.cos()
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
    fn the_time_of_day_is_the_nearest_to_a_sun() {
        for hours in [0.0, 5.5, 9.0, 12.0, 18.5, 23.0] {
            assert_eq!(Day::nearest_to(SunPosition::at_hour(hours)), Day { hours, plays: false });
        }
        // South of the path of the day, in the late morning.
        let winter = SunPosition { azimuth_deg: 127.0, elevation_deg: 27.0 };
        assert!((8.0..10.0).contains(&Day::nearest_to(winter).hours));
        let turned = SunPosition { azimuth_deg: 127.0 - 360.0, ..winter };
        assert_eq!(Day::nearest_to(turned), Day::nearest_to(winter));
    }

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
