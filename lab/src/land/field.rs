//! Height fields and windows of them.
//!
//! Every measure reads heights through [`Field`], so that the controls pass through the same code
//! as the land.

use crate::sample::word;
use terrain::constants::{SPACING_BITS, UNITS_PER_METRE};
use terrain::{Grid, Land, Octaves, Position};

/// Metres between the vertices on which coasts, slopes, pits and features are measured.
pub const SPACING_M: f64 = 16.0;

/// Level of that spacing.
pub const LEVEL: u8 = 3;

/// Area of one vertex of that spacing, km².
pub const VERTEX_KM2: f64 = SPACING_M * SPACING_M * 1e-6;

/// A rectangle of vertices of one level.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// Low corner east, units.
    pub x: i32,
    /// Low corner south, units.
    pub z: i32,
    /// Level whose spacing the vertices have.
    pub level: u8,
    /// Vertices along x and along z.
    pub side: usize,
    /// Vertices next to the edge that are seen but not measured.
    pub border: usize,
}

impl Window {
    /// A window of [`SPACING_M`] around a place (units) that measures `inner` vertices a side.
    pub fn around((x, z): (i32, i32), inner: usize, border: usize) -> Self {
        let side = inner + 2 * border;
        let low = |middle: i32| middle - (side as i32 / 2) * (1 << (SPACING_BITS + u32::from(LEVEL)));
        Self { x: low(x), z: low(z), level: LEVEL, side, border }
    }

    /// Metres between vertices.
    pub fn spacing_m(&self) -> f64 {
        f64::from(self.step()) / f64::from(UNITS_PER_METRE)
    }

    /// Units between vertices.
    pub fn step(&self) -> i32 {
        1 << (SPACING_BITS + u32::from(self.level))
    }

    /// Position of a vertex, units.
    pub fn position(&self, column: usize, row: usize) -> (i32, i32) {
        (self.x + column as i32 * self.step(), self.z + row as i32 * self.step())
    }

    /// Whether a place, in spacings from the low corner, is measured.
    pub fn measures(&self, column: f64, row: f64) -> bool {
        let inner = self.border as f64..(self.side - self.border) as f64;
        inner.contains(&column) && inner.contains(&row)
    }

    /// Indices of the vertices that are measured. Each has eight neighbours if there is a border.
    pub fn inner(&self) -> impl Iterator<Item = usize> + use<> {
        let (side, inner) = (self.side, self.border..self.side - self.border);
        inner.clone().flat_map(move |row| inner.clone().map(move |column| row * side + column))
    }

    /// Change of height per metre at an inner vertex, by central differences: east, south.
    pub fn gradient(&self, heights: &[f32], index: usize) -> [f64; 2] {
        let across = |step: usize| f64::from(heights[index + step]) - f64::from(heights[index - step]);
        [1, self.side].map(|step| across(step) / (2.0 * self.spacing_m()))
    }
}

/// A place (units) anywhere in the world, on the vertices of every level up to 8, at least half
/// the world's half side from its border.
pub fn place(stream: u32, index: u32) -> (i32, i32) {
    let axis = |part: u32| (word(stream, 2 * index + part) as i32 >> 2) & !((1 << 17) - 1);
    (axis(0), axis(1))
}

/// A height field.
pub trait Field: Sync {
    /// Height of a position (units) in metres.
    fn at(&self, x: i32, z: i32) -> f32;

    /// Heights of a window in metres, row by row: those of [`Field::at`].
    fn heights(&self, window: &Window) -> Vec<f32> {
        let places =
            (0..window.side * window.side).map(|i| window.position(i % window.side, i / window.side));
        places.map(|(x, z)| self.at(x, z)).collect()
    }
}

impl Field for Land {
    fn at(&self, x: i32, z: i32) -> f32 {
        metres(self.height_at(Position::new(x, z).expect("measured places lie in the world")))
    }

    /// From a level that carries all octaves: the land itself, not what the window's level draws.
    fn heights(&self, window: &Window) -> Vec<f32> {
        let carries_all = |level: &u8| Octaves::at_level(*level) == Octaves::ALL;
        let level = (0..=window.level).rev().find(carries_all).expect("level 0 carries every octave");
        rows(self, window, level)
    }
}

/// Heights of a window with the octaves that its level carries; cheap, for islands seen from far.
pub fn carried(land: &Land, window: &Window) -> Vec<f32> {
    rows(land, window, window.level)
}

/// Heights of a window from the vertices of a level that is not coarser.
fn rows(land: &Land, window: &Window, level: u8) -> Vec<f32> {
    let stride = 1 << (window.level - level);
    let mut row = vec![0; (window.side - 1) * stride + 1];
    let mut heights = Vec::with_capacity(window.side * window.side);
    for index in 0..window.side {
        let (x, z) = window.position(0, index);
        let grid = Grid::new(x, z, level, row.len(), 1).expect("measured places lie in the world");
        land.heights(&grid, &mut row);
        heights.extend(row.iter().step_by(stride).map(|height| metres(*height)));
    }
    heights
}

fn metres(height: i32) -> f32 {
    height as f32 / UNITS_PER_METRE as f32
}

/// A field made from metres east and south.
pub struct Formula<F>(pub F);

impl<F: Fn(f64, f64) -> f64 + Sync> Field for Formula<F> {
    fn at(&self, x: i32, z: i32) -> f32 {
        (self.0)(f64::from(x) / f64::from(UNITS_PER_METRE), f64::from(z) / f64::from(UNITS_PER_METRE)) as f32
    }
}

/// The land with every height changed: position in units and height in metres to metres.
pub struct Changed<F>(pub Land, pub F);

impl<F: Fn(i32, i32, f32) -> f32 + Sync> Field for Changed<F> {
    fn at(&self, x: i32, z: i32) -> f32 {
        (self.1)(x, z, self.0.at(x, z))
    }

    fn heights(&self, window: &Window) -> Vec<f32> {
        let mut heights = Field::heights(&self.0, window);
        for (index, height) in heights.iter_mut().enumerate() {
            let (x, z) = window.position(index % window.side, index / window.side);
            *height = (self.1)(x, z, *height);
        }
        heights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_hold_the_land_itself_although_their_level_carries_fewer_octaves() {
        let land = Land::new(3);
        let window = Window::around((0, 0), 40, 2);
        assert_ne!(Field::heights(&land, &window), carried(&land, &window));
        for (index, height) in Field::heights(&land, &window).into_iter().enumerate().step_by(37) {
            let (x, z) = window.position(index % window.side, index / window.side);
            assert_eq!(height, land.at(x, z));
        }
    }

    #[test]
    fn a_tilted_plane_has_its_gradient_everywhere() {
        let window = Window::around((0, 0), 8, 1);
        let heights = Formula(|x: f64, z: f64| 0.5 * x - 0.25 * z).heights(&window);
        assert_eq!(window.inner().count(), 64);
        for index in window.inner() {
            assert_eq!(window.gradient(&heights, index), [0.5, -0.25]);
        }
        assert!(window.measures(1.0, 8.9) && !window.measures(0.9, 4.0) && !window.measures(4.0, 9.0));
    }
}
