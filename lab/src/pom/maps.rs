//! Height maps that are hard to march over, each in its own way.

use crate::sample::{unit, word};
use client::features::pom::HeightMap;

/// Texels a side of all of them.
pub const SIDE: usize = 512;

/// A map of the measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Smooth hills: four octaves of value noise with quintic steps, from eight cells a tile.
    Fbm,
    /// A running bond of 6 x 12 bricks with mortar between.
    Brick,
    /// 16 x 16 square posts, a fifth to a quarter of their cell wide, on flat ground.
    Posts,
    /// Ridges of one texel, at three angles.
    Ridges,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Fbm, Self::Brick, Self::Posts, Self::Ridges];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fbm => "fbm",
            Self::Brick => "brick",
            Self::Posts => "posts",
            Self::Ridges => "ridges",
        }
    }

    /// The map.
    ///
    /// # Panics
    /// Never: the side is one that maps may have.
    pub fn map(self) -> HeightMap {
        let height = match self {
            Self::Fbm => fbm,
            Self::Brick => brick,
            Self::Posts => posts,
            Self::Ridges => ridges,
        };
        HeightMap::of(SIDE, height).expect("the side is a power of two and heights are numbers")
    }
}

fn fbm(u: f64, v: f64) -> f64 {
    let octave = |octave: u32| {
        let cells = 8 << octave;
        let (x, z) = (u * f64::from(cells), v * f64::from(cells));
        let corner = |east: u32, south: u32| {
            let (column, row) = ((x as u32 + east) % cells, (z as u32 + south) % cells);
            unit(word(0xf8a0 + octave, row * cells + column))
        };
        let step = |part: f64| part * part * part * (part * (part * 6.0 - 15.0) + 10.0);
        let (east, south) = (step(x.fract()), step(z.fract()));
        let north_edge = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * east;
        let south_edge = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * east;
        north_edge + (south_edge - north_edge) * south
    };
    (0..4).map(|index| octave(index) * 0.5f64.powi(index as i32 + 1)).sum::<f64>() / 0.9375
}

fn brick(u: f64, v: f64) -> f64 {
    let row = (v * 12.0).floor();
    let along = (u * 6.0 + 0.5 * (row % 2.0)).fract();
    let across = (v * 12.0).fract();
    let slope = |part: f64, width: f64| {
        let part = (part / width).clamp(0.0, 1.0);
        part * part * (3.0 - 2.0 * part)
    };
    let inset = |part: f64, width: f64| slope(part, width) * slope(1.0 - part, width);
    inset(along, 0.06) * inset(across, 0.10)
}

fn posts(u: f64, v: f64) -> f64 {
    let cell = |value: f64| ((value * 16.0) as u32, (value * 16.0).fract() - 0.5);
    let ((column, x), (row, z)) = (cell(u), cell(v));
    let half_width = 0.10 + 0.04 * unit(word(0x9057, row * 16 + column));
    f64::from(u8::from(x.abs() < half_width && z.abs() < half_width))
}

fn ridges(u: f64, v: f64) -> f64 {
    let (column, row) = ((u * SIDE as f64) as u32, (v * SIDE as f64) as u32);
    let is_ridge = match row / 171 {
        0 => column % 32 == 7,
        1 => (column + row) % 32 == 7,
        _ => row % 32 == 7,
    };
    f64::from(u8::from(is_ridge))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_map_has_high_and_low_ground_and_the_smooth_one_tiles() {
        for kind in Kind::ALL {
            let map = kind.map();
            let share =
                map.heights().iter().filter(|height| **height > 0.5).count() as f64 / (SIDE * SIDE) as f64;
            assert!((0.02..0.9).contains(&share), "{}: {share}", kind.name());
        }
        let map = Kind::Fbm.map();
        let steepest = (0..SIDE as i64 * SIDE as i64).map(|index| {
            let (column, row) = (index % SIDE as i64, index / SIDE as i64);
            (map.texel(column + 1, row) - map.texel(column, row)).abs()
        });
        assert!(steepest.fold(0.0, f32::max) < 0.08);
    }
}
