//! Pictures of the land: shaded relief at four scales, and charts of slopes and heights.

use super::field::{Field, Window, carried};
use super::surface::Surface;
use crate::curve;
use anyhow::{Context, Result};
use chart::{Chart, Panel, linear};
use std::path::Path;
use terrain::Land;

/// Pixels along a side of a map, and between maps.
const PIXELS: usize = 320;
const GAP: usize = 4;

/// Levels whose vertices are pixels: 2, 16, 64 and 256 m.
const LEVELS: [u8; 4] = [0, 3, 5, 7];

/// Towards the light: north-west, 45 degrees high. East, up, south.
const LIGHT: [f64; 3] = [-0.5, std::f64::consts::FRAC_1_SQRT_2, -0.5];

/// Height or depth in metres and colour, from the deep sea to the summits.
const TINTS: [(f32, [f64; 3]); 10] = [
    (-64.0, [30.0, 66.0, 110.0]),
    (-20.0, [66.0, 122.0, 164.0]),
    (-0.01, [150.0, 200.0, 205.0]),
    (0.0, [226.0, 214.0, 172.0]),
    (4.0, [186.0, 196.0, 136.0]),
    (60.0, [128.0, 166.0, 104.0]),
    (160.0, [156.0, 160.0, 106.0]),
    (300.0, [170.0, 142.0, 104.0]),
    (500.0, [184.0, 168.0, 150.0]),
    (800.0, [246.0, 244.0, 240.0]),
];

/// Writes `relief.png`: a row of maps for each world, finest first, centred on a place (units).
///
/// # Errors
/// The file cannot be written.
pub fn relief(folder: &Path, worlds: &[(Land, (i32, i32))]) -> Result<()> {
    let pitch = PIXELS + GAP;
    let size = |maps: usize| (maps * pitch - GAP.min(maps * pitch)) as u32;
    let mut sheet = image::RgbImage::from_pixel(size(LEVELS.len()), size(worlds.len()), image::Rgb([255; 3]));
    for (row, (land, middle)) in worlds.iter().enumerate() {
        for (column, level) in LEVELS.into_iter().enumerate() {
            for (index, pixel) in map(land, *middle, level).into_iter().enumerate() {
                let (x, y) = (column * pitch + index % PIXELS, row * pitch + index / PIXELS);
                sheet.put_pixel(x as u32, y as u32, image::Rgb(pixel));
            }
        }
    }
    let path = folder.join("relief.png");
    sheet.save(&path).with_context(|| format!("--out: cannot write `{}`", path.display()))
}

/// Shaded relief with a vertex of a level for each pixel.
fn map(land: &Land, (x, z): (i32, i32), level: u8) -> Vec<[u8; 3]> {
    let mut window = Window { x, z, level, side: PIXELS + 2, border: 1 };
    let low = |middle: i32| middle - (window.side as i32 / 2) * window.step();
    (window.x, window.z) = (low(x), low(z));
    // Coarse pixels as coarse levels draw them: without octaves that they would alias.
    let heights = if level > 3 { carried(land, &window) } else { Field::heights(land, &window) };
    window.inner().map(|at| colour(heights[at], window.gradient(&heights, at))).collect()
}

/// Tint of the height, lit by the slope; the sea hides most of its floor's relief.
fn colour(height: f32, [east, south]: [f64; 2]) -> [u8; 3] {
    let facing = (LIGHT[1] - east * LIGHT[0] - south * LIGHT[2]) / (1.0 + east * east + south * south).sqrt();
    let relief = if height > 0.0 { 0.9 } else { 0.25 };
    let light = 1.0 + relief * (facing / LIGHT[1] - 1.0);
    let above = TINTS.partition_point(|(stop, _)| *stop <= height).clamp(1, TINTS.len() - 1);
    let ((low, from), (high, to)) = (TINTS[above - 1], TINTS[above]);
    let share = f64::from(((height - low) / (high - low)).clamp(0.0, 1.0));
    [0, 1, 2].map(|part| ((from[part] + (to[part] - from[part]) * share) * light).clamp(0.0, 255.0) as u8)
}

/// Writes `land.png`: the histogram of slopes and the hypsometric curve.
///
/// # Errors
/// The file cannot be written, or there is no land.
pub fn charts(folder: &Path, surface: &Surface) -> Result<()> {
    let slopes = Panel::new("Slopes", linear("slope, degrees"), linear("land in a degree, %"))
        .line("land on the 16 m grid", surface.slope_histogram().into_iter().take(70));
    let heights = Panel::new("Hypsometric curve", linear("land above, %"), linear("height, m"))
        .line("land on the 16 m grid", surface.hypsometric_curve());
    curve::draw(&folder.join("land.png"), &Chart::grid("Slopes and heights of land", vec![slopes, heights]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_towards_the_light_are_lighter_and_the_sea_is_blue() {
        let [towards, level, away] =
            [[0.3, 0.3], [0.0; 2], [-0.3, -0.3]].map(|slope| colour(100.0, slope)[1]);
        assert!(towards > level && level > away, "{towards} {level} {away}");
        let [red, _, blue] = colour(-30.0, [0.0; 2]);
        assert!(blue > red && colour(5000.0, [0.0; 2]) == [246, 244, 240]);
    }
}
