//! Sunlight and exposure of a frame.

use crate::settings::{RenderSettings, Show};
use glam::Vec3;

/// Direction of the sun and exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunLight {
    /// Unit vector to the sun.
    pub sun: Vec3,
    /// Multiplies linear radiance before the tone curve.
    pub exposure: f32,
}

impl SunLight {
    /// The light after the user's settings, clamped to their ranges. A sun position or exposure
    /// that is not finite is ignored.
    #[must_use]
    pub fn with_settings(self, settings: &RenderSettings) -> Self {
        let position = settings
            .sun
            .filter(|position| position.azimuth_deg.is_finite() && position.elevation_deg.is_finite());
        let sun = position.map_or(self.sun, |position| {
            let azimuth = position.azimuth_deg.to_radians();
            let elevation = position.elevation_deg.clamp(-90.0, 90.0).to_radians();
            Vec3::new(azimuth.sin() * elevation.cos(), elevation.sin(), -azimuth.cos() * elevation.cos())
        });
        // Debug views show flat colours, not light.
        let adapted_ev = if settings.show == Show::Image { adaptation_ev(sun.y) } else { 0.0 };
        Self { sun, exposure: self.exposure * (exposure_ev(settings) + adapted_ev).exp2() }
    }
}

/// The user's exposure, stops, -8 to 8; 0 if it is not finite.
#[must_use]
pub fn exposure_ev(settings: &RenderSettings) -> f32 {
    if settings.exposure_ev.is_finite() { settings.exposure_ev.clamp(-8.0, 8.0) } else { 0.0 }
}

/// Eye adaptation in stops, by the sine of the sun's elevation: 0 from 12 degrees above the horizon
/// on, 3.5 at 12 degrees below, where the light is more than ten stops lower. Nights stay dark.
fn adaptation_ev(rise: f32) -> f32 {
    let dusk = ((0.2 - rise) / 0.4).clamp(0.0, 1.0);
    3.5 * dusk * dusk * (3.0 - 2.0 * dusk)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::SunPosition;

    #[test]
    fn exposure_rises_at_dusk_and_invalid_settings_are_ignored() {
        let light = SunLight { sun: Vec3::new(0.66, 0.43, 0.50).normalize(), exposure: 1.0 };
        let under = |elevation_deg, exposure_ev| {
            let sun = Some(SunPosition { azimuth_deg: 10.0, elevation_deg });
            light.with_settings(&RenderSettings { sun, exposure_ev, ..RenderSettings::default() })
        };
        let exposures = [90.0, 45.0, 12.0, 5.0, 0.0, -6.0, -12.0, -90.0].map(|deg| under(deg, 0.0).exposure);
        assert!(exposures.is_sorted() && exposures[1] == light.exposure, "{exposures:?}");
        assert!((exposures[7] / exposures[0]).log2() < 4.0, "nights stay dark: {exposures:?}");
        let levels = RenderSettings { show: Show::Levels, sun: under_horizon(), ..RenderSettings::default() };
        assert_eq!(light.with_settings(&levels).exposure, light.exposure);

        assert_eq!(under(200.0, 0.0).sun, under(90.0, 0.0).sun);
        assert_eq!(under(45.0, 100.0).exposure, under(45.0, 8.0).exposure);
        for odd in [f32::NAN, f32::INFINITY] {
            assert_eq!(under(odd, odd), light);
        }
        assert_ne!(under(45.0, 1.0), light);
    }

    fn under_horizon() -> Option<SunPosition> {
        Some(SunPosition { azimuth_deg: 0.0, elevation_deg: -20.0 })
    }
}
