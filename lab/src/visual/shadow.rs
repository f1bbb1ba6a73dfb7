//! Light in shadow: what the ground keeps of its luminance where the land hides the sun, after tone
//! mapping, and the darkest ground at noon.
//!
//! The shape of the land decides which pixels are in shadow: the measured luminance would choose
//! those that lose much of it. A pixel counts if the land hides the middle of the sun from it, and
//! if its ground is turned to the sun at least as far as level ground. Ground that is turned away
//! has little sunlight to lose, with shadow or without.

use super::views::{DrawOptions, Views};
use client::gpu::GpuError;
use client::lighting::SunLight;
use client::settings::{RenderSettings, Shadows, Show, SunPosition};
use glam::Vec3;
use serde::Serialize;

/// A sun whose shadows fill valleys.
const LOW: SunPosition = SunPosition { azimuth_deg: 250.0, elevation_deg: 15.0 };

/// Noon.
const HIGH: SunPosition = SunPosition { azimuth_deg: 180.0, elevation_deg: 60.0 };

/// Rounding of the cosine of a normal and the sun, by half floats.
const ROUNDING: f32 = 0.002;

/// Pixels in shadow that a pose must have to count.
const LEAST_PIXELS: usize = 200;

/// sRGB value below which ground is black to a person.
const BLACK: u8 = 12;

/// The figures.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Shadow {
    /// Poses with shadow.
    pub poses: usize,
    /// Median over these poses of the mean luminance in shadow over that without shadows.
    pub over_light: f64,
    /// Pixels of the ground at noon.
    pub noon_pixels: usize,
    /// Those of which all channels are below [`BLACK`].
    pub black_at_noon: usize,
}

/// Measures all poses.
pub fn measure(views: &mut Views) -> Result<Shadow, GpuError> {
    let mut shares = Vec::new();
    let (mut noon_pixels, mut black_at_noon) = (0, 0);
    let to_sun = direction(LOW);
    for case in views.cases.clone() {
        let ground = views.light(&case, DrawOptions { show: Show::Normals, ..DrawOptions::IMAGE })?;
        let is_ground = |pixel: usize| ground[pixel][3] < 0.0;
        let options = DrawOptions { sun: LOW, ..DrawOptions::IMAGE };
        // Hard shadows take all sunlight where the middle of the sun is hidden, and none elsewhere.
        let hard =
            views.light(&case, DrawOptions { show: Show::Light, shadows: Shadows::Hard, ..options })?;
        let open = views.light(&case, DrawOptions { show: Show::Light, shadows: Shadows::Off, ..options })?;
        let is_hidden = |pixel: usize| hard[pixel][1] < open[pixel][1];
        let with = views.image(&case, options)?;
        let without = views.image(&case, DrawOptions { shadows: Shadows::Off, ..options })?;
        let pixels = with.rgba.chunks_exact(4).zip(without.rgba.chunks_exact(4)).enumerate();
        let (mut dark, mut lit, mut count) = (0.0, 0.0, 0);
        for (pixel, (with, without)) in pixels {
            if is_ground(pixel) && is_hidden(pixel) && is_turned_to(to_sun, normal_of(ground[pixel])) {
                dark += luminance(with);
                lit += luminance(without);
                count += 1;
            }
        }
        if count >= LEAST_PIXELS {
            shares.push(dark / lit);
        }
        let noon = views.image(&case, DrawOptions { sun: HIGH, ..DrawOptions::IMAGE })?;
        for (_, rgba) in noon.rgba.chunks_exact(4).enumerate().filter(|(pixel, _)| is_ground(*pixel)) {
            noon_pixels += 1;
            black_at_noon += usize::from(rgba[..3].iter().all(|channel| *channel < BLACK));
        }
    }
    shares.sort_unstable_by(f64::total_cmp);
    let over_light = shares.get(shares.len() / 2).copied().unwrap_or(f64::NAN);
    Ok(Shadow { poses: shares.len(), over_light, noon_pixels, black_at_noon })
}

/// Unit vector to a sun.
fn direction(sun: SunPosition) -> Vec3 {
    let settings = RenderSettings { sun: Some(sun), ..RenderSettings::default() };
    SunLight { sun: Vec3::Y, exposure: 1.0 }.with_settings(&settings).sun
}

/// The normal that the debug view shows as a colour.
fn normal_of([red, green, blue, _]: [f32; 4]) -> Vec3 {
    Vec3::new(red, green, blue).powf(1.0 / 2.2) * 2.0 - 1.0
}

/// Whether ground with a normal gets at least as much sunlight as level ground.
fn is_turned_to(sun: Vec3, normal: Vec3) -> bool {
    normal.dot(sun) >= sun.y - ROUNDING
}

/// Linear luminance of an sRGB pixel, 0 to 1 (IEC 61966-2-1, BT.709).
fn luminance(rgba: &[u8]) -> f64 {
    let linear = |channel: u8| {
        let encoded = f64::from(channel) / 255.0;
        if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
    };
    0.2126 * linear(rgba[0]) + 0.7152 * linear(rgba[1]) + 0.0722 * linear(rgba[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_and_sunward_ground_counts_and_ground_turned_away_does_not() {
        let sun = direction(LOW);
        let counts = |normal: Vec3| {
            let [red, green, blue] = (normal * 0.5 + 0.5).powf(2.2).to_array();
            is_turned_to(sun, normal_of([red, green, blue, -1.0]))
        };
        let slope = |toward: f32| Vec3::new(toward * sun.x, 1.0, toward * sun.z).normalize();
        assert!(counts(Vec3::Y) && counts(slope(0.3)) && counts(slope(1.0)));
        assert!(!counts(slope(-0.1)) && !counts(slope(-0.3)), "control");
    }

    #[test]
    fn luminance_is_linear_and_weighted() {
        assert!((luminance(&[255, 255, 255, 255]) - 1.0).abs() < 1e-9);
        assert!((luminance(&[188, 188, 188, 255]) - 0.503).abs() < 0.002);
        assert!(luminance(&[0, 99, 0, 255]) > luminance(&[99, 0, 0, 255]));
    }
}
