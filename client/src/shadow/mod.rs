//! The land's shadow on itself, as far as no GPU is needed: where the sun stands ([`caster`]), what
//! may cast a shadow ([`table`]) and whose shadow is to be found next ([`schedule`]).
//! `shaders/wgsl/cast_shadows.wesl` does the finding.
//!
//! What comes out depends on the drawn chunks and the sun only: not on arrival, slots or what else
//! is resident.

pub mod schedule;
pub mod table;

pub use schedule::{Candidate, Casting, Quota, Schedule};
pub use table::{Page, PageTable};

use glam::Vec3;
use shaders::layout::{CLEARANCE_RANGE, Caster, SKY_DARK, SKY_LIT, SKY_WALK, SUN_RADIUS};
use std::f64::consts::FRAC_PI_2;

/// Directions are rounded so finely, 2^-16 rad (1 mm over 65 m): a track that all but follows a
/// column or row follows it.
const AXIS_SLACK: f64 = 1.0 / 65_536.0;

/// Horizons steeper than this are no different: 89.9 degrees.
const STEEPEST: f64 = FRAC_PI_2 - 0.001_75;

/// What the shader needs to know of a sun (unit vector, y up) over a page table.
#[must_use]
pub fn caster(sun: Vec3, table: &PageTable) -> Caster {
    let [east, up, south] = sun.to_array().map(f64::from);
    // A direction that is none counts as the zenith.
    let is_direction = sun.is_finite() && sun != Vec3::ZERO;
    let elevation = if is_direction { up.atan2(east.hypot(south)) } else { FRAC_PI_2 };
    // The disc counts: half of it may stand above a level horizon when its middle does not.
    let sky = if elevation + SUN_RADIUS >= FRAC_PI_2 {
        SKY_LIT
    } else if elevation <= -SUN_RADIUS {
        SKY_DARK
    } else {
        SKY_WALK
    };
    let level = |angle: f64| {
        let part = angle / east.hypot(south);
        if part.abs() < AXIS_SLACK { 0.0 } else { part }
    };
    let toward = if sky == SKY_WALK { [level(east), level(south)] } else { [1.0, 0.0] };
    let length = toward[0].hypot(toward[1]);
    let range = CLEARANCE_RANGE * SUN_RADIUS;
    Caster {
        toward: toward.map(|part| (part / length) as f32),
        slope_low: (elevation - range).clamp(0.0, STEEPEST).tan() as f32,
        slope_high: (elevation + range).clamp(0.0, STEEPEST).tan() as f32,
        elevation: elevation as f32,
        root_bits: table.root_bits,
        columns: table.columns,
        rows: table.rows,
        top: table.top(),
        sky,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sun(azimuth_deg: f64, elevation_deg: f64) -> Caster {
        let (azimuth, elevation) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        let level = elevation.cos();
        let sun = [azimuth.sin() * level, elevation.sin(), -azimuth.cos() * level].map(|part| part as f32);
        caster(Vec3::from(sun), &PageTable::default())
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
        for caster in odd.map(|sun| caster(sun, &PageTable::default())) {
            let [x, z] = caster.toward;
            assert!((x.hypot(z) - 1.0).abs() < 1e-6 && caster.slope_low >= 0.0, "{caster:?}");
            assert!(caster.slope_high.is_finite() && caster.slope_high >= caster.slope_low, "{caster:?}");
        }
        assert_eq!(caster(Vec3::Y, &PageTable::default()).sky, SKY_LIT);
    }

    #[test]
    fn the_disc_rises_before_its_middle_and_reaches_the_zenith_before_it() {
        assert_eq!(
            [-0.3, -0.25, 0.0, 89.7, 89.8].map(|elevation| sun(33.0, elevation).sky),
            [SKY_DARK, SKY_WALK, SKY_WALK, SKY_WALK, SKY_LIT]
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
