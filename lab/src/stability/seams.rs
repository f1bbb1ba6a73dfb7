//! Seams: what two chunks share is equal bit for bit, and a height does not depend on the grid that
//! computed it.

use super::check::Check;
use crate::sample;
use terrain::constants::{CELLS, SPACING_BITS, TOP_LEVEL, VERTICES, WORLD_HALF};
use terrain::{ChunkKey, Grid, Land, Octaves, Position};

/// Positions whose chunks are checked, units: corners and middles of the borders, both
/// signs of the origin.
const PLACES: [(i32, i32); 13] = [
    (-WORLD_HALF, -WORLD_HALF),
    (-WORLD_HALF, WORLD_HALF),
    (WORLD_HALF, -WORLD_HALF),
    (WORLD_HALF, WORLD_HALF),
    (-WORLD_HALF, 0),
    (WORLD_HALF, -1),
    (-1, -WORLD_HALF),
    (0, WORLD_HALF),
    (-1, -1),
    (-1, 0),
    (0, -1),
    (0, 0),
    (700_000, -900_000),
];

/// Further places inside islands.
const LAND_PLACES: u32 = 12;

/// What is checked.
const NAMES: [&str; 5] = [
    "seams to the east equal at every level",
    "seams to the south equal at every level",
    "chunks equal single heights with the same octaves",
    "chunks equal grids of other shapes over the same vertices",
    "finer grids that keep the same octaves equal on shared vertices",
];

/// Checks all seams of a world.
pub fn check(land: &Land) -> Vec<Check> {
    let mut seams = Seams { land, checks: NAMES.map(Check::new) };
    let places = PLACES.into_iter().chain(sample::land_vertices(land.world_seed(), LAND_PLACES, 5));
    for (x, z) in places {
        for level in 0..=TOP_LEVEL {
            seams.check_chunk(ChunkKey::containing(level, x, z));
        }
    }
    seams.checks.into()
}

/// The seam between two different worlds: must be caught.
pub fn control() -> Check {
    let keys = [0, 1].map(|x| ChunkKey::new(0, x, 0).expect("a chunk at the origin"));
    let (here, east) = (Land::new(1).chunk_heights(keys[0]), Land::new(2).chunk_heights(keys[1]));
    let mut seam = Check::new("the seam between two worlds");
    for row in 0..VERTICES {
        seam.expect_equal(here[row * VERTICES + CELLS].into(), east[row * VERTICES].into(), keys[0]);
    }
    seam
}

struct Seams<'a> {
    land: &'a Land,
    /// By [`NAMES`].
    checks: [Check; NAMES.len()],
}

impl Seams<'_> {
    fn check_chunk(&mut self, key: ChunkKey) {
        let heights = self.land.chunk_heights(key);
        let at = |column: usize, row: usize| i64::from(heights[row * VERTICES + column]);
        for (axis, (east, south)) in [(1, 0), (0, 1)].into_iter().enumerate() {
            let Ok(beside) = ChunkKey::new(key.level(), key.x() + east, key.z() + south) else { continue };
            let other = self.land.chunk_heights(beside);
            for along in 0..VERTICES {
                let (its, own) =
                    [(other[along * VERTICES], at(CELLS, along)), (other[along], at(along, CELLS))][axis];
                self.checks[axis].expect_equal(i64::from(its), own, key);
            }
        }
        self.compare_with_points(key, &at);
        self.compare_with_grids(key, &at);
    }

    fn compare_with_points(&mut self, key: ChunkKey, at: &impl Fn(usize, usize) -> i64) {
        let octaves = Octaves::at_level(key.level());
        // No divisor of 65: every column and row is met, at every position in a vector.
        for index in (0..VERTICES * VERTICES).step_by(11) {
            let (column, row) = (index % VERTICES, index / VERTICES);
            let (x, z) = vertex(key, column, row);
            let position = Position::new(x, z).expect("a chunk lies in the world");
            let height = self.land.height_keeping(position, octaves);
            self.checks[2].expect_equal(at(column, row), height.into(), key);
        }
    }

    /// Odd shapes that begin inside the chunk; and the grid one level finer where that carries at
    /// least the same octaves.
    fn compare_with_grids(&mut self, key: ChunkKey, at: &impl Fn(usize, usize) -> i64) {
        for (column, row, columns, rows) in
            [(1, 2, 7, 3), (60, 0, 5, 1), (3, 3, 17, 2), (64, 64, 1, 1), (0, 1, 64, 2)]
        {
            let (x, z) = vertex(key, column, row);
            let grid = Grid::new(x, z, key.level(), columns, rows).expect("inside the chunk");
            let heights = self.heights(grid);
            for (index, height) in heights.into_iter().enumerate() {
                let (c, r) = (index % columns, index / columns);
                self.checks[3].expect_equal(height.into(), at(column + c, row + r), key);
            }
        }
        if let Some(finer) = key.level().checked_sub(1) {
            // 64 finer columns: the west half of the chunk, from its second row on.
            let (x, z) = vertex(key, 0, 1);
            let grid = Grid::new(x, z, finer, CELLS, 5).expect("inside the chunk");
            let grid = grid.keeping(Octaves::at_level(key.level()));
            for (index, height) in self.heights(grid).into_iter().enumerate() {
                let (column, row) = (index % grid.columns(), index / grid.columns());
                if column % 2 == 0 && row % 2 == 0 {
                    self.checks[4].expect_equal(height.into(), at(column / 2, 1 + row / 2), key);
                }
            }
        }
    }

    fn heights(&self, grid: Grid) -> Vec<i32> {
        let mut heights = vec![0; grid.vertex_count()];
        self.land.heights(&grid, &mut heights);
        heights
    }
}

/// Position of a vertex of a chunk, units.
fn vertex(key: ChunkKey, column: usize, row: usize) -> (i32, i32) {
    let (x, z) = key.origin();
    let step = |low: i32, index: usize| {
        (i64::from(low) + ((index as i64) << (SPACING_BITS + u32::from(key.level())))) as i32
    };
    (step(x, column), step(z, row))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_seam_of_a_world_is_closed() {
        for check in check(&Land::new(77)) {
            assert!(check.holds() && check.cases > 1_000, "{check:?}");
        }
    }

    #[test]
    fn heights_of_another_world_violate_the_seam() {
        let seam = control();
        assert!(!seam.holds() && seam.violations > 60);
    }
}
