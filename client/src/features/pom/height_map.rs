//! A height map: a square of heights that repeats in both directions.

use thiserror::Error;

/// Largest side whose textures, max mips included, every WebGPU device supports.
pub const LARGEST_SIDE: usize = 4096;

/// Why numbers are not a height map.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum MapError {
    /// The side is not a power of two, or is too large.
    #[error("a height map of {0} texels a side: the side must be a power of two, {LARGEST_SIDE} at most")]
    Side(usize),
    /// The number of heights is not the square of the side.
    #[error("{0} heights for a map of {1} texels a side: expected the square of the side")]
    Count(usize, usize),
    /// A height is NaN.
    #[error("height {0} of the map is not a number: every height must be from 0 to 1")]
    NotANumber(usize),
}

/// Heights from 0 to 1, row by row; texel centres lie at half-integers and the surface between them
/// is bilinear.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightMap {
    side: usize,
    heights: Vec<f32>,
}

impl HeightMap {
    /// A map. Heights are clamped to 0 to 1.
    ///
    /// # Errors
    /// The side is no power of two up to [`LARGEST_SIDE`], the heights are not as many as its
    /// square, or one is not a number.
    pub fn new(side: usize, mut heights: Vec<f32>) -> Result<Self, MapError> {
        if !side.is_power_of_two() || side > LARGEST_SIDE {
            return Err(MapError::Side(side));
        }
        if heights.len() != side * side {
            return Err(MapError::Count(heights.len(), side));
        }
        if let Some(index) = heights.iter().position(|height| height.is_nan()) {
            return Err(MapError::NotANumber(index));
        }
        for height in &mut heights {
            *height = height.clamp(0.0, 1.0);
        }
        Ok(Self { side, heights })
    }

    /// A map of a function of the texel centres (0 to 1 in both directions).
    ///
    /// # Errors
    /// As [`HeightMap::new`].
    pub fn of(side: usize, height: impl Fn(f64, f64) -> f64) -> Result<Self, MapError> {
        let centre = |texel: usize| (texel as f64 + 0.5) / side as f64;
        let count = if side > LARGEST_SIDE { 0 } else { side * side };
        let heights = (0..count).map(|index| height(centre(index % side), centre(index / side)) as f32);
        Self::new(side, heights.collect())
    }

    /// Texels a side, a power of two.
    #[must_use]
    pub fn side(&self) -> usize {
        self.side
    }

    /// The heights, row by row.
    #[must_use]
    pub fn heights(&self) -> &[f32] {
        &self.heights
    }

    /// Height of a texel; coordinates wrap.
    #[must_use]
    pub fn texel(&self, column: i64, row: i64) -> f32 {
        let mask = self.side as i64 - 1;
        self.heights[((row & mask) * self.side as i64 + (column & mask)) as usize]
    }

    /// The next mip level: means of four texels. Of a single texel, itself.
    #[must_use]
    pub fn next_mip(&self) -> Self {
        if self.side == 1 {
            return self.clone();
        }
        let side = self.side / 2;
        let mean = |index: usize| {
            let (column, row) = (2 * (index % side), 2 * (index / side));
            let four =
                [0, 1, self.side, self.side + 1].map(|step| self.heights[row * self.side + column + step]);
            four.iter().sum::<f32>() / 4.0
        };
        Self { side, heights: (0..side * side).map(mean).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_map_is_refused_with_its_reason() {
        assert_eq!(HeightMap::new(3, vec![0.0; 9]), Err(MapError::Side(3)));
        assert_eq!(HeightMap::of(8192, |_, _| 0.0), Err(MapError::Side(8192)));
        assert_eq!(HeightMap::new(0, vec![]), Err(MapError::Side(0)));
        assert_eq!(HeightMap::new(2, vec![0.0; 3]), Err(MapError::Count(3, 2)));
        assert_eq!(HeightMap::new(2, vec![0.0, 0.5, f32::NAN, 1.0]), Err(MapError::NotANumber(2)));
        let cut = HeightMap::new(2, vec![-1.0, 0.5, f32::INFINITY, 1.0]).unwrap();
        assert_eq!(cut.heights(), [0.0, 0.5, 1.0, 1.0]);
    }

    #[test]
    fn a_map_repeats_and_halves_to_its_mean() {
        let map = HeightMap::of(4, |u, v| u * v).unwrap();
        assert_eq!(map.texel(-1, 9), map.texel(3, 1));
        let mean = map.heights().iter().sum::<f32>() / 16.0;
        let smallest = map.next_mip().next_mip();
        assert_eq!((smallest.side(), smallest.heights()), (1, [mean].as_slice()));
        assert_eq!(smallest.next_mip(), smallest);
    }
}
