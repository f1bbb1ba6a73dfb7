//! Shaded relief: hypsometric tints, light from the north-west, a shore line, and contours where
//! they are readable.
//!
//! Colours are sRGB bytes and are mixed in that space. A pixel depends on its own sample only, so
//! tiles meet without a seam.

use crate::map::elevation::{ElevationGrid, Sample, TILE_PIXELS};

type Colour = [f32; 3];

/// Depth in metres, negative, and colour; ascending.
const SEA: [(f32, Colour); 7] = [
    (-64.0, [38.0, 78.0, 122.0]),
    (-48.0, [46.0, 92.0, 137.0]),
    (-30.0, [62.0, 116.0, 157.0]),
    (-16.0, [84.0, 143.0, 174.0]),
    (-7.0, [114.0, 172.0, 189.0]),
    (-2.0, [150.0, 199.0, 202.0]),
    (0.0, [181.0, 217.0, 211.0]),
];

/// Height in metres and colour; ascending.
const LAND: [(f32, Colour); 9] = [
    (0.0, [232.0, 222.0, 184.0]),
    (2.5, [224.0, 214.0, 170.0]),
    (7.0, [187.0, 199.0, 140.0]),
    (30.0, [151.0, 180.0, 117.0]),
    (110.0, [126.0, 161.0, 102.0]),
    (250.0, [160.0, 163.0, 108.0]),
    (430.0, [178.0, 150.0, 107.0]),
    (620.0, [190.0, 170.0, 145.0]),
    (900.0, [243.0, 240.0, 234.0]),
];

const SHORE: Colour = [52.0, 78.0, 96.0];
const CONTOUR: Colour = [92.0, 66.0, 40.0];
const SHADOW: Colour = [46.0, 48.0, 74.0];
const LIGHT: Colour = [255.0, 250.0, 228.0];

/// Towards the light: north-west, 45 degrees high, the cartographic convention. East, up, south.
const TOWARDS_LIGHT: [f32; 3] = [-0.5, std::f32::consts::FRAC_1_SQRT_2, -0.5];

/// Metres between contours by level; none at coarser levels, where they would merge.
const CONTOUR_M: [f32; 4] = [5.0, 10.0, 20.0, 50.0];

/// Vertical exaggeration before shading. It grows with the level, since coarse pixels average over
/// steep slopes.
fn exaggeration(level: u8) -> f32 {
    1.6 + 0.16 * f32::from(level)
}

/// The RGB bytes of a tile, row by row from the north-west.
#[must_use]
pub fn render(grid: &ElevationGrid, level: u8) -> Vec<u8> {
    let mut pixels = Vec::with_capacity(TILE_PIXELS * TILE_PIXELS * 3);
    for row in 0..TILE_PIXELS {
        for column in 0..TILE_PIXELS {
            let colour = colour(grid.sample(column, row), grid.pixel_m(), level);
            pixels.extend(colour.map(|part| part.clamp(0.0, 255.0).round() as u8));
        }
    }
    pixels
}

/// The colour of one sample.
fn colour(sample: Sample, pixel_m: f32, level: u8) -> Colour {
    let is_land = sample.height_m >= 0.0;
    let tint = ramp(if is_land { &LAND } else { &SEA }, sample.height_m);
    // Water reduces the contrast of the sea floor.
    let strength = if is_land { 1.0 } else { 0.35 };
    let mut colour = shaded(tint, sample, exaggeration(level), strength);
    // Change of height per pixel: the distance of a height in pixels.
    let rise_m = sample.east.hypot(sample.south) * pixel_m;
    if is_land {
        colour = mix(colour, CONTOUR, contour(sample.height_m, rise_m, level));
    }
    mix(colour, SHORE, 0.55 * line(sample.height_m.abs(), rise_m, 1.1))
}

/// Lightens slopes towards the light and darkens the others; level ground keeps its tint.
fn shaded(tint: Colour, sample: Sample, exaggeration: f32, strength: f32) -> Colour {
    let (east, south) = (sample.east * exaggeration, sample.south * exaggeration);
    let [light_east, light_up, light_south] = TOWARDS_LIGHT;
    let facing =
        (light_up - east * light_east - south * light_south) / (1.0 + east * east + south * south).sqrt();
    // 1 for level ground.
    let brightness = facing / light_up;
    if brightness < 1.0 {
        mix(tint, SHADOW, strength * 0.72 * (1.0 - brightness).min(1.0))
    } else {
        mix(tint, LIGHT, strength * 1.3 * (brightness - 1.0).min(0.5))
    }
}

/// Coverage of a contour, 0 to a quarter.
fn contour(height_m: f32, rise_m: f32, level: u8) -> f32 {
    let Some(interval_m) = CONTOUR_M.get(usize::from(level)) else { return 0.0 };
    let nearest_m = (height_m / interval_m).round() * interval_m;
    // The shore has its own line.
    if nearest_m <= 0.0 || rise_m <= 0.0 {
        return 0.0;
    }
    // Contours closer than a few pixels would merge.
    let apart = ((interval_m / rise_m - 4.0) / 8.0).clamp(0.0, 1.0);
    0.25 * apart * line((height_m - nearest_m).abs(), rise_m, 0.9)
}

/// Coverage of a line at a vertical distance, 0 to 1: full within `half_width` - 0.5 pixels, none
/// one pixel further.
fn line(away_m: f32, rise_m: f32, half_width: f32) -> f32 {
    if rise_m <= 0.0 { 0.0 } else { (half_width + 0.5 - away_m / rise_m).clamp(0.0, 1.0) }
}

/// The colour of a height on a ramp.
fn ramp(stops: &[(f32, Colour)], height_m: f32) -> Colour {
    let above = stops.partition_point(|(stop, _)| *stop <= height_m);
    match (above.checked_sub(1).map(|below| stops[below]), stops.get(above)) {
        (None, _) => stops[0].1,
        (Some((_, last)), None) => last,
        (Some((low, from)), Some((high, to))) => mix(from, *to, (height_m - low) / (high - low)),
    }
}

fn mix(from: Colour, to: Colour, share: f32) -> Colour {
    std::array::from_fn(|part| from[part] + (to[part] - from[part]) * share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::elevation::sources;
    use terrain::{Chunk, ChunkKey, Land};

    fn tile(level: u8, x: i32, z: i32) -> Vec<u8> {
        let (land, key) = (Land::new(1), ChunkKey::new(level, x, z).unwrap());
        let chunks: Vec<Chunk> = sources(key).into_iter().map(|key| land.chunk(key)).collect();
        render(&ElevationGrid::new(key, &chunks), level)
    }

    fn brightness(colour: Colour) -> f32 {
        0.2126 * colour[0] + 0.7152 * colour[1] + 0.0722 * colour[2]
    }

    fn at(height_m: f32, east: f32, south: f32) -> Colour {
        // Level 9 has no contours.
        colour(Sample { height_m, east, south }, 1.0, 9)
    }

    #[test]
    fn the_open_sea_is_blue_and_even_and_land_is_not() {
        let sea = tile(0, 60, 60);
        assert_eq!(sea.len(), TILE_PIXELS * TILE_PIXELS * 3);
        assert!(sea.chunks_exact(3).all(|pixel| pixel == [38, 78, 122]));
        let land = tile(0, 0, 0);
        assert!(land.chunks_exact(3).any(|pixel| pixel[2] < pixel[1]), "the control: land is not blue");
    }

    #[test]
    fn deeper_is_darker_and_every_depth_is_blue() {
        for depth in 1..64 {
            let (shallow, deep) = (at(-depth as f32 + 0.9, 0.0, 0.0), at(-depth as f32, 0.0, 0.0));
            assert!(brightness(deep) < brightness(shallow) && deep[2] > deep[0], "{depth} m");
        }
    }

    #[test]
    fn what_faces_north_west_is_lighter_than_what_faces_south_east() {
        // Land that rises towards south-east faces north-west.
        for height in [20.0, 100.0, 200.0] {
            let (lit, level, dark) = (at(height, 0.4, 0.4), at(height, 0.0, 0.0), at(height, -0.4, -0.4));
            assert!(brightness(lit) > brightness(level) + 5.0 && brightness(level) > brightness(dark) + 5.0);
            // The control: across the light there is no such difference.
            let (left, right) = (at(height, 0.4, -0.4), at(height, -0.4, 0.4));
            assert!((brightness(left) - brightness(right)).abs() < 0.01);
        }
    }

    #[test]
    fn a_peak_of_the_real_land_is_lighter_on_its_north_western_side() {
        let (land, key) = (Land::new(1), ChunkKey::new(5, 0, 0).unwrap());
        let chunks: Vec<Chunk> = sources(key).into_iter().map(|key| land.chunk(key)).collect();
        let grid = ElevationGrid::new(key, &chunks);
        let pixels = render(&grid, 5);
        // Means over all pixels that face one way steeply, of one band of heights, so that the tint
        // is about the same.
        let mean = |faces: fn(Sample) -> bool| {
            let (mut sum, mut count) = (0.0, 0.0);
            for (index, pixel) in pixels.chunks_exact(3).enumerate() {
                let sample = grid.sample(index % TILE_PIXELS, index / TILE_PIXELS);
                if (40.0..80.0).contains(&sample.height_m) && faces(sample) {
                    sum += brightness([pixel[0], pixel[1], pixel[2]].map(f32::from));
                    count += 1.0;
                }
            }
            assert!(count > 50.0, "{count} such pixels");
            sum / count
        };
        let north_west = mean(|sample| sample.east > 0.1 && sample.south > 0.1);
        let south_east = mean(|sample| sample.east < -0.1 && sample.south < -0.1);
        let (north_east, south_west) = (
            mean(|sample| sample.east < -0.1 && sample.south > 0.1),
            mean(|sample| sample.east > 0.1 && sample.south < -0.1),
        );
        assert!(north_west > south_east + 15.0, "{north_west} against {south_east}");
        assert!((north_east - south_west).abs() < (north_west - south_east) / 3.0, "the control");
    }

    #[test]
    fn a_shore_has_a_line_and_a_contour_lies_at_its_height_only() {
        let (shore, inland) = (at(0.01, 0.2, 0.0), at(3.0, 0.2, 0.0));
        assert!(brightness(shore) < brightness(inland) - 20.0);
        assert!(contour(20.0, 0.5, 2) > 0.2 && contour(29.9, 0.5, 2) == 0.0);
        assert_eq!(contour(20.0, 0.5, 12), 0.0, "far away there are none");
        assert_eq!(contour(20.0, 8.0, 2), 0.0, "nor where they would merge");
        assert_eq!(contour(0.0, 0.5, 2), 0.0);
    }

    #[test]
    fn ramps_go_on_at_both_ends_and_through_every_stop() {
        assert_eq!(ramp(&LAND, -5.0), LAND[0].1);
        assert_eq!(ramp(&LAND, 9999.0), LAND[LAND.len() - 1].1);
        for stops in [&SEA[..], &LAND[..]] {
            assert!(stops.windows(2).all(|pair| pair[0].0 < pair[1].0));
            assert!(stops.iter().all(|(height, colour)| ramp(stops, *height) == *colour));
        }
    }
}
