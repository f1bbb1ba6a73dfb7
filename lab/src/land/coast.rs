//! Coasts: the line of height 0 around the islands of a window.
//!
//! Marching squares with linear interpolation: a cell between four vertices whose heights have
//! both signs holds one segment, or two at a saddle, where its two land corners stay apart.
//! (Lorensen and Cline, SIGGRAPH 1987, in two dimensions.) A vertex at exactly 0 is sea. A coast
//! is the border between land and the sea, which is what touches the window's edge: the coast of a
//! lagoon that is open to the sea counts, the shore of a lake does not.

use super::field::{VERTEX_KM2, Window};
use super::labels::Labels;
use std::f64::consts::PI;

/// Smallest area of an island whose coast is measured, km².
const LEAST_KM2: f64 = 1.0;

/// A piece of coast within one cell.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// The region of its land.
    pub land: u32,
    /// Index of the cell's low corner.
    pub cell: usize,
    /// Its ends: column and row in spacings from the window's corner.
    pub ends: [[f64; 2]; 2],
}

impl Segment {
    /// Its length in spacings.
    pub fn length(&self) -> f64 {
        let [from, to] = self.ends;
        (to[0] - from[0]).hypot(to[1] - from[1])
    }

    /// Its middle: column and row.
    pub fn middle(&self) -> [f64; 2] {
        let [from, to] = self.ends;
        [(from[0] + to[0]) / 2.0, (from[1] + to[1]) / 2.0]
    }
}

/// All coast of a window, row by row of its cells. `labels` are those of the land.
pub fn segments(window: &Window, heights: &[f32], labels: &Labels) -> Vec<Segment> {
    let mut segments = Vec::new();
    for row in 0..window.side - 1 {
        for column in 0..window.side - 1 {
            let cell = row * window.side + column;
            // Round the cell from its low corner.
            let corners = [cell, cell + 1, cell + 1 + window.side, cell + window.side];
            let is_land = corners.map(|corner| heights[corner] > 0.0);
            if is_land == [false; 4] || is_land == [true; 4] {
                continue;
            }
            let region = |corner: usize| labels.of[corners[corner % 4]];
            let crossing = |edge: usize| {
                let [from, to] = [edge % 4, (edge + 1) % 4].map(|corner| f64::from(heights[corners[corner]]));
                let along = from / (from - to);
                let [x, z] = [[along, 0.0], [1.0, along], [1.0 - along, 1.0], [0.0, 1.0 - along]][edge % 4];
                [column as f64 + x, row as f64 + z]
            };
            let mut add = |land: usize, sea: usize, edges: [usize; 2]| {
                if labels.regions[region(sea) as usize].touches_edge {
                    segments.push(Segment { land: region(land), cell, ends: edges.map(crossing) });
                }
            };
            let crossed: Vec<usize> =
                (0..4).filter(|edge| is_land[*edge] != is_land[(edge + 1) % 4]).collect();
            if let [one, other] = crossed[..] {
                let (land, sea) = if is_land[one] { (one, one + 1) } else { (one + 1, one) };
                add(land, sea, [one, other]);
            } else {
                (0..4)
                    .filter(|corner| is_land[*corner])
                    .for_each(|land| add(land, land + 1, [land + 3, land]));
            }
        }
    }
    segments
}

/// The islands of a window whose centroid is measured.
#[derive(Clone, Debug, Default)]
pub struct Islands {
    /// Coast length of each island over that of a circle of its area.
    pub ratios: Vec<f64>,
    /// Islands that touch the window's edge, which are left out.
    pub left_out: u64,
    /// Length of the measured coasts, metres.
    pub coast_m: f64,
    /// Their segments.
    pub segments: Vec<Segment>,
}

/// Measures the islands of a window.
pub fn islands(window: &Window, heights: &[f32], labels: &Labels) -> Islands {
    let mut all = segments(window, heights, labels);
    let mut lengths = vec![0.0; labels.regions.len()];
    all.iter().for_each(|segment| lengths[segment.land as usize] += segment.length() * window.spacing_m());
    let mut islands = Islands::default();
    let mut is_measured = vec![false; labels.regions.len()];
    for (index, region) in labels.regions.iter().enumerate() {
        let [column, row] = region.centroid();
        let area_km2 = region.points as f64 * VERTEX_KM2;
        if !region.is_set || area_km2 < LEAST_KM2 || !window.measures(column, row) {
            continue;
        }
        if region.touches_edge {
            islands.left_out += 1;
            continue;
        }
        is_measured[index] = true;
        islands.ratios.push(lengths[index] / (2.0 * (PI * area_km2 * 1e6).sqrt()));
        islands.coast_m += lengths[index];
    }
    all.retain(|segment| is_measured[segment.land as usize]);
    Islands { segments: all, ..islands }
}

#[cfg(test)]
mod tests {
    use super::super::field::{Field, Formula};
    use super::super::labels::label;
    use super::*;

    fn of(inner: usize, field: impl Fn(f64, f64) -> f64 + Sync) -> Islands {
        let window = Window::around((0, 0), inner, 2);
        let heights = Formula(field).heights(&window);
        let mask: Vec<bool> = heights.iter().map(|height| *height > 0.0).collect();
        islands(&window, &heights, &label(&mask, window.side, false))
    }

    #[test]
    fn a_cone_has_the_coast_of_a_circle() {
        let cone = |x: f64, z: f64| 1000.0 - (x - 31.0).hypot(z + 45.0);
        let islands = of(160, cone);
        assert!(islands.ratios.len() == 1 && (islands.ratios[0] - 1.0).abs() < 0.005, "{islands:?}");
        assert!((islands.coast_m - 2000.0 * PI).abs() < 5.0, "{}", islands.coast_m);
    }

    #[test]
    fn a_square_has_the_coast_of_a_square_and_a_lake_in_it_counts_only_when_it_is_open() {
        let square = |x: f64, z: f64| 1000.0 - x.abs().max(z.abs());
        let lake = move |x: f64, z: f64| square(x, z).min(x.abs().max(z.abs()) - 400.0);
        let open = move |x: f64, z: f64| if z > 0.0 && x.abs() < 100.0 { -9.0 } else { lake(x, z) };
        let [square, lake, open] = [of(160, square), of(160, lake), of(160, open)];
        assert!((square.coast_m - 8000.0).abs() < 40.0, "{}", square.coast_m);
        assert!((lake.coast_m - square.coast_m).abs() < 1.0, "{}", lake.coast_m);
        // The lake's 3,200 m and both banks of the canal, less its two mouths.
        let added = open.coast_m - square.coast_m;
        assert!((added - (3200.0 + 1200.0 - 400.0)).abs() < 60.0, "{added}");
    }

    #[test]
    fn small_islands_do_not_count_and_cut_ones_are_left_out() {
        let small = of(160, |x, z| 500.0 - x.hypot(z));
        assert_eq!((small.ratios.len(), small.left_out), (0, 0));
        let cut = of(160, |x, z| 1000.0 - (x - 500.0).hypot(z));
        assert_eq!((cut.ratios.len(), cut.left_out, cut.segments.len()), (0, 1, 0));
    }

    #[test]
    fn land_corners_of_a_saddle_stay_apart() {
        let window = Window { x: 0, z: 0, level: 3, side: 4, border: 0 };
        let mut heights = vec![-1.0f32; 16];
        (heights[5], heights[10]) = (1.0, 1.0);
        let mask: Vec<bool> = heights.iter().map(|height| *height > 0.0).collect();
        let segments = segments(&window, &heights, &label(&mask, 4, false));
        // Two diamonds of four segments each.
        assert_eq!(segments.len(), 8);
        assert!(segments.iter().all(|segment| (segment.length() - 0.5f64.sqrt()).abs() < 1e-12));
    }
}
