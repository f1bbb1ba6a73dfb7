//! Closed pits: vertices of land from which water could not run off on the 16 m grid.

use super::field::Window;
use std::collections::HashSet;

/// Counts the vertices of land, and plateaus of equal ones, whose neighbours of eight are all
/// higher. A plateau counts once. Land below the sea's level is no land and holds no pit.
pub fn count(window: &Window, heights: &[f32]) -> u64 {
    let side = window.side;
    let around = [side + 1, side, side - 1, 1];
    let neighbours = |index: usize| around.into_iter().flat_map(move |step| [index - step, index + step]);
    let is_outside = |index: usize| {
        let (column, row) = (index % side, index / side);
        column == 0 || row == 0 || column + 1 == side || row + 1 == side
    };
    let mut seen = HashSet::new();
    let mut pits = 0;
    for index in window.inner() {
        let height = heights[index];
        if height <= 0.0 || neighbours(index).any(|other| heights[other] < height) {
            continue;
        }
        if neighbours(index).all(|other| heights[other] > height) {
            pits += 1;
        } else if seen.insert(index) {
            let mut is_closed = true;
            let mut open = vec![index];
            while let Some(at) = open.pop() {
                if is_outside(at) {
                    is_closed = false;
                    continue;
                }
                for other in neighbours(at) {
                    is_closed &= heights[other] >= height;
                    if heights[other] == height && seen.insert(other) {
                        open.push(other);
                    }
                }
            }
            pits += u64::from(is_closed);
        }
    }
    pits
}

#[cfg(test)]
mod tests {
    use super::super::field::{Field, Formula};
    use super::*;

    fn of(field: impl Fn(f64, f64) -> f64 + Sync) -> u64 {
        let window = Window::around((0, 0), 100, 1);
        count(&window, &Formula(field).heights(&window))
    }

    #[test]
    fn planted_pits_are_counted_and_a_plane_a_flat_and_the_sea_have_none() {
        let plane = |x: f64, z: f64| 1000.0 + 0.1 * x + 0.03 * z;
        assert_eq!((of(plane), of(|_, _| 7.0), of(|x, z| x.hypot(z) * 0.01 - 100.0)), (0, 0, 0));
        let at = |x: f64, z: f64| x.rem_euclid(160.0) == 0.0 && z.rem_euclid(160.0) == 0.0;
        assert_eq!(of(move |x, z| plane(x, z) - if at(x, z) { 50.0 } else { 0.0 }), 100);
        // Five vertices wide.
        let bowl = |x: f64, z: f64| plane(x, z).max(1200.0).min(1200.0 + x.hypot(z) - 40.0);
        assert_eq!(of(bowl), 1);
    }

    #[test]
    fn a_plateau_counts_once_and_only_without_an_outlet() {
        let pit = |x: f64, z: f64| if x.abs() < 100.0 && z.abs() < 300.0 { 50.0 } else { 60.0 };
        assert_eq!(of(pit), 1);
        assert_eq!(of(move |x, z| if x > 0.0 && z == 0.0 { 50.0 - 0.01 * x } else { pit(x, z) }), 0);
        // The outlet is higher than the plateau, so it stays closed.
        assert_eq!(of(move |x, z| if x > 100.0 && z == 0.0 { 55.0 } else { pit(x, z) }), 1);
    }
}
