//! Shader parameters of the sun over a page table.

use crate::features::terrain_shadow::page_table::PageTable;
use glam::Vec3;
use shaders::layout::{CLEARANCE_RANGE, SKY_DARK, SKY_LIT, SKY_TRACE, SUN_RADIUS, SunParams};
use std::f64::consts::FRAC_PI_2;

/// Direction components below this, 2^-16 rad (1 mm over 65 m), are set to 0, so that a ray that
/// almost follows a column or row follows it exactly.
const AXIS_SLACK: f64 = 1.0 / 65_536.0;

/// Steepest distinguished horizon: 89.9 degrees.
const STEEPEST: f64 = FRAC_PI_2 - 0.001_75;

/// Shader parameters of a sun direction (unit vector, y up).
#[must_use]
pub fn sun_params(sun: Vec3, table: &PageTable) -> SunParams {
    let [east, up, south] = sun.to_array().map(f64::from);
    // A zero or non-finite direction counts as the zenith.
    let is_direction = sun.is_finite() && sun != Vec3::ZERO;
    let elevation = if is_direction { up.atan2(east.hypot(south)) } else { FRAC_PI_2 };
    // The disc counts: a part of it may be above a level horizon when its centre is not.
    let sky = if elevation + SUN_RADIUS >= FRAC_PI_2 {
        SKY_LIT
    } else if elevation <= -SUN_RADIUS {
        SKY_DARK
    } else {
        SKY_TRACE
    };
    let level = |angle: f64| {
        let part = angle / east.hypot(south);
        if part.abs() < AXIS_SLACK { 0.0 } else { part }
    };
    let toward = if sky == SKY_TRACE { [level(east), level(south)] } else { [1.0, 0.0] };
    let length = toward[0].hypot(toward[1]);
    let range = CLEARANCE_RANGE * SUN_RADIUS;
    SunParams {
        toward: toward.map(|part| (part / length) as f32),
        slope_low: (elevation - range).clamp(0.0, STEEPEST).tan() as f32,
        slope_high: (elevation + range).clamp(0.0, STEEPEST).tan() as f32,
        elevation: elevation as f32,
        root_bits: table.root_bits,
        columns: table.columns,
        rows: table.rows,
        max_height: table.max_height(),
        sky,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sun(azimuth_deg: f64, elevation_deg: f64) -> SunParams {
        let (azimuth, elevation) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        let level = elevation.cos();
        let sun = [azimuth.sin() * level, elevation.sin(), -azimuth.cos() * level].map(|part| part as f32);
        sun_params(Vec3::from(sun), &PageTable::default())
    }

    #[test]
    fn every_sun_gives_finite_numbers() {
        let odd = [
            Vec3::ZERO,
            Vec3::Y,
            -Vec3::Y,
            Vec3::X,
            Vec3::NAN,
            Vec3::splat(f32::MIN_POSITIVE),
            Vec3::INFINITY,
        ];
        for params in odd.map(|sun| sun_params(sun, &PageTable::default())) {
            let [x, z] = params.toward;
            assert!((x.hypot(z) - 1.0).abs() < 1e-6 && params.slope_low >= 0.0, "{params:?}");
            assert!(params.slope_high.is_finite() && params.slope_high >= params.slope_low, "{params:?}");
        }
        assert_eq!(sun_params(Vec3::Y, &PageTable::default()).sky, SKY_LIT);
    }

    #[test]
    fn the_disc_rises_before_its_middle_and_reaches_the_zenith_before_it() {
        assert_eq!(
            [-0.3, -0.25, 0.0, 89.7, 89.8].map(|elevation| sun(33.0, elevation).sky),
            [SKY_DARK, SKY_TRACE, SKY_TRACE, SKY_TRACE, SKY_LIT]
        );
    }

    #[test]
    fn a_sun_in_a_quarter_of_the_sky_is_exactly_there() {
        assert_eq!(
            [0.0, 90.0, 180.0, 270.0].map(|azimuth| sun(azimuth, 20.0).toward),
            [[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]
        );
    }
}
