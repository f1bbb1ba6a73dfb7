//! Light in shadow: what the ground keeps of its luminance where the land hides the sun, after tone
//! mapping, and the darkest ground at noon.

use super::views::{Shot, Views};
use client::gpu::GpuError;
use client::settings::{Shadows, Show, SunPosition};
use serde::Serialize;

/// A sun whose shadows fill valleys.
const LOW: SunPosition = SunPosition { azimuth_deg: 250.0, elevation_deg: 15.0 };

/// Noon.
const HIGH: SunPosition = SunPosition { azimuth_deg: 180.0, elevation_deg: 60.0 };

/// Share of its light that a pixel in shadow must lose at least, or it is a rim of a shadow.
const LOST: f64 = 0.3;

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
    for case in views.cases.clone() {
        let ground = views.light(&case, Shot { show: Show::Chunks, ..Shot::IMAGE })?;
        let is_ground = |pixel: usize| ground[pixel][3] < 0.0;
        let shot = Shot { sun: LOW, ..Shot::IMAGE };
        let with = views.image(&case, shot)?;
        let without = views.image(&case, Shot { shadows: Shadows::Off, ..shot })?;
        let pixels = with.rgba.chunks_exact(4).zip(without.rgba.chunks_exact(4)).enumerate();
        let (mut dark, mut lit, mut count) = (0.0, 0.0, 0);
        for (pixel, (with, without)) in pixels {
            let (with, without) = (luminance(with), luminance(without));
            if is_ground(pixel) && with < (1.0 - LOST) * without {
                dark += with;
                lit += without;
                count += 1;
            }
        }
        if count >= LEAST_PIXELS {
            shares.push(dark / lit);
        }
        let noon = views.image(&case, Shot { sun: HIGH, ..Shot::IMAGE })?;
        for (_, rgba) in noon.rgba.chunks_exact(4).enumerate().filter(|(pixel, _)| is_ground(*pixel)) {
            noon_pixels += 1;
            black_at_noon += usize::from(rgba[..3].iter().all(|channel| *channel < BLACK));
        }
    }
    shares.sort_unstable_by(f64::total_cmp);
    let over_light = shares.get(shares.len() / 2).copied().unwrap_or(f64::NAN);
    Ok(Shadow { poses: shares.len(), over_light, noon_pixels, black_at_noon })
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
    fn luminance_is_linear_and_weighted() {
        assert!((luminance(&[255, 255, 255, 255]) - 1.0).abs() < 1e-9);
        assert!((luminance(&[188, 188, 188, 255]) - 0.503).abs() < 0.002);
        assert!(luminance(&[0, 99, 0, 255]) > luminance(&[99, 0, 0, 255]));
    }
}
