//! A point and a grid are two ways to the same heights: a grid evaluates the lobes of its whole
//! area, a point those about it alone.

use terrain::hash::mix;
use terrain::{Grid, Land, Octaves, Position};

/// Points along the rims of islands, where a lobe that is left out makes a difference.
#[test]
fn heights_of_points_are_those_of_grids() {
    const SIDE: usize = 33;
    let (mut compared, mut dry) = (0, 0);
    for square in 0..48 {
        let land = Land::new(u64::from(square % 3));
        let at = |stream: u32| ((mix(square * 2 + stream) % 4_000_000) as i32 - 2_000_000) & !0xffff;
        let (x, z) = (at(0), at(1));
        // 256 m between vertices: an island and the sea about it.
        let grid = Grid::new(x, z, 7, SIDE, SIDE).unwrap();
        let mut heights = vec![0; SIDE * SIDE];
        land.heights(&grid, &mut heights);
        for (index, height) in heights.into_iter().enumerate() {
            let step = |low: i32, n: usize| low + ((n as i32) << (9 + 7));
            let place = Position::new(step(x, index % SIDE), step(z, index / SIDE)).unwrap();
            assert_eq!(land.height_keeping(place, grid.octaves()), height, "{square}: {place:?}");
            compared += 1;
            dry += u32::from(height > 0);
        }
    }
    assert!(compared > 50_000 && dry > 2000, "{compared} {dry}");
}

/// Single points, whose lobes are looked for each by itself.
#[test]
fn heights_of_points_are_those_of_grids_of_one_vertex() {
    let land = Land::new(1);
    let mut height = [0];
    for number in 0..200_000 {
        let at = |stream: u32| (mix(number * 2 + stream) % 4_000_000) as i32 - 2_000_000;
        let place = Position::new(at(0), at(1)).unwrap();
        land.heights(&Grid::new(place.x(), place.z(), 0, 1, 1).unwrap(), &mut height);
        assert_eq!(land.height_at(place), height[0], "{place:?}");
    }
}

/// Grids are evaluated in bands of some hundred rows.
#[test]
fn heights_of_points_are_those_of_a_tall_grid() {
    let land = Land::new(1);
    let grid = Grid::new(-280_000, -280_000, 0, 3, 1100).unwrap();
    let mut heights = vec![0; grid.vertex_count()];
    land.heights(&grid, &mut heights);
    for (index, height) in heights.into_iter().enumerate() {
        let step = |n: usize| -280_000 + ((n as i32) << 9);
        let place = Position::new(step(index % 3), step(index / 3)).unwrap();
        assert_eq!(land.height_at(place), height, "{place:?}");
    }
}

/// All octaves, closely about the shores of the home island.
#[test]
fn heights_of_points_are_those_of_the_finest_grid() {
    const SIDE: usize = 65;
    let land = Land::new(1);
    let start = land.start();
    let mut heights = vec![0; SIDE * SIDE];
    for square in 0..24 {
        let far = |stream: u32| ((mix(square * 2 + stream) % 1_600_000) as i32 - 800_000) & !0x1ff;
        let (x, z) = ((start.x + far(0)) & !0x1ff, (start.z + far(1)) & !0x1ff);
        let grid = Grid::new(x, z, 0, SIDE, SIDE).unwrap();
        land.heights(&grid, &mut heights);
        for (index, height) in heights.iter().enumerate() {
            let step = |low: i32, n: usize| low + ((n as i32) << 9);
            let place = Position::new(step(x, index % SIDE), step(z, index / SIDE)).unwrap();
            assert_eq!(land.height_keeping(place, Octaves::ALL), *height, "{square}: {place:?}");
        }
    }
}
