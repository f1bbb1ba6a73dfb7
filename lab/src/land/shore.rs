//! Cliffs and beaches: what rises inland of a point of the coast.
//!
//! From a point of the coast a transect runs uphill, along the gradient of the 16 m grid there
//! (mean of the central differences at the four corners of its cell), with one height every 2 m.
//! It starts where the transect itself leaves the sea, at most 24 m from the point; a point
//! without such a place is neither cliff nor beach.
//!
//! - A *cliff* rises above 10 m within 24 m, and contains a stretch of steps steeper than 40
//!   degrees that rises by at least 6 m.
//! - A *beach* has a mean slope of at most 10 degrees over 16 m and stays below 3 m there.

use super::coast::Segment;
use super::field::{Field, Window};
use serde::Serialize;
use terrain::constants::UNITS_PER_METRE;

/// Metres between the heights of a transect.
const STEP_M: f64 = 2.0;
/// Steps to both sides within which the transect must leave the sea.
const SEARCH: i32 = 12;
/// Steps inland within which a cliff rises, and its height and steep part, metres.
const CLIFF: (usize, f32, f32) = (12, 10.0, 6.0);
/// Steps inland of a beach, and the height that it stays below, metres.
const BEACH: (usize, f32) = (8, 3.0);
/// Slope that a cliff's steep part exceeds, and mean slope that a beach does not, degrees.
const STEEP: f64 = 40.0;
const GENTLE: f64 = 10.0;

/// Statistics of coasts.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Shores {
    /// Points of the coast.
    pub points: u64,
    /// Those with a cliff.
    pub cliffs: u64,
    /// Those with a beach.
    pub beaches: u64,
    /// Those whose transect does not leave the sea near them.
    pub lost: u64,
}

impl Shores {
    /// Of two parts of the coast.
    pub fn and(self, other: Self) -> Self {
        Self {
            points: self.points + other.points,
            cliffs: self.cliffs + other.cliffs,
            beaches: self.beaches + other.beaches,
            lost: self.lost + other.lost,
        }
    }
}

/// Looks inland every `every_m` metres along segments. The windows' heights reach a vertex beyond
/// every segment.
pub fn along(
    field: &dyn Field,
    window: &Window,
    heights: &[f32],
    segments: &[Segment],
    every_m: f64,
) -> Shores {
    let mut shores = Shores::default();
    let mut until_next_m = every_m / 2.0;
    for segment in segments {
        until_next_m -= segment.length() * window.spacing_m();
        while until_next_m <= 0.0 {
            until_next_m += every_m;
            shores = shores.and(at(field, window, heights, segment));
        }
    }
    shores
}

/// Looks inland from the middle of a segment.
fn at(field: &dyn Field, window: &Window, heights: &[f32], segment: &Segment) -> Shores {
    let corners = [0, 1, window.side, window.side + 1];
    let gradients = corners.map(|corner| window.gradient(heights, segment.cell + corner));
    let uphill = [0, 1].map(|axis| gradients.iter().map(|gradient| gradient[axis]).sum::<f64>());
    let length = uphill[0].hypot(uphill[1]);
    let found =
        (length > 0.0).then(|| inland(field, window, segment.middle(), uphill.map(|part| part / length)));
    let Some(profile) = found.flatten() else { return Shores { points: 1, lost: 1, ..Shores::default() } };
    Shores {
        points: 1,
        cliffs: u64::from(is_cliff(&profile)),
        beaches: u64::from(is_beach(&profile)),
        lost: 0,
    }
}

/// Heights from the last one in the sea on.
fn inland(field: &dyn Field, window: &Window, [column, row]: [f64; 2], uphill: [f64; 2]) -> Option<Vec<f32>> {
    let height = |step: i32| {
        let along = f64::from(step) * STEP_M * f64::from(UNITS_PER_METRE);
        let unit = |low: i32, steps: f64, part: f64| {
            low + (steps * f64::from(window.step()) + part * along).round() as i32
        };
        field.at(unit(window.x, column, uphill[0]), unit(window.z, row, uphill[1]))
    };
    let near: Vec<f32> = (-SEARCH..=SEARCH).map(height).collect();
    let leaves_sea = |start: &i32| {
        let index = (start + SEARCH) as usize;
        near[index] <= 0.0 && near[index + 1] > 0.0
    };
    let start = (-SEARCH..SEARCH).filter(leaves_sea).min_by_key(|start| (2 * start + 1).abs())?;
    Some((start..=start + CLIFF.0 as i32).map(height).collect())
}

fn slope(degrees: f64) -> f32 {
    degrees.to_radians().tan() as f32
}

fn is_cliff(profile: &[f32]) -> bool {
    let (steps, above, stretch) = CLIFF;
    let least_rise = slope(STEEP) * STEP_M as f32;
    let (mut risen, mut most) = (0.0f32, 0.0f32);
    for pair in profile[..=steps].windows(2) {
        let rise = pair[1] - pair[0];
        risen = if rise > least_rise { risen + rise } else { 0.0 };
        most = most.max(risen);
    }
    most >= stretch && profile[..=steps].iter().any(|height| *height > above)
}

fn is_beach(profile: &[f32]) -> bool {
    let (steps, below) = BEACH;
    let length_m = STEP_M as f32 * steps as f32;
    profile[steps] <= slope(GENTLE) * length_m && profile[..=steps].iter().all(|height| *height < below)
}

#[cfg(test)]
mod tests {
    use super::super::coast;
    use super::super::field::Formula;
    use super::super::labels::label;
    use super::*;

    /// An island of 1 km radius by its height over the distance inland.
    fn island(inland: impl Fn(f64) -> f64 + Sync) -> Shores {
        let field = Formula(move |x: f64, z: f64| inland(1000.0 - x.hypot(z)));
        let window = Window::around((0, 0), 160, 2);
        let heights = field.heights(&window);
        let mask: Vec<bool> = heights.iter().map(|height| *height > 0.0).collect();
        let islands = coast::islands(&window, &heights, &label(&mask, window.side, false));
        along(&field, &window, &heights, &islands.segments, 20.0)
    }

    fn shares(shores: Shores) -> [f64; 2] {
        assert!((300..330).contains(&shores.points) && shores.lost == 0, "{shores:?}");
        [shores.cliffs, shores.beaches].map(|count| count as f64 / shores.points as f64)
    }

    #[test]
    fn a_step_is_a_cliff_and_a_gentle_slope_a_beach() {
        let step = |inland: f64| if inland < 6.0 { 0.05 * inland } else { 20.0 };
        for (inland, expected) in [
            (&step as &(dyn Fn(f64) -> f64 + Sync), [1.0, 0.0]),
            (&|inland| 1.2 * inland, [1.0, 0.0]),
            (&|inland| 0.1 * inland, [0.0, 1.0]),
            // Neither: 30 degrees to 13.9 m.
            (&|inland| 0.577 * inland, [0.0, 0.0]),
            // Steep, but not high enough; high enough, but steep over 3.4 m of height only.
            (&|inland| (1.2 * inland).min(8.0), [0.0, 0.0]),
            (&|inland| (1.2 * inland).min(2.0 + 0.5 * inland), [0.0, 0.0]),
            // A beach below a cliff is both.
            (&|inland| if inland < 18.0 { 0.05 * inland } else { 30.0 }, [1.0, 1.0]),
        ] {
            let found = shares(island(inland));
            assert!(
                (found[0] - expected[0]).abs() < 0.02 && (found[1] - expected[1]).abs() < 0.02,
                "{found:?}"
            );
        }
    }

    #[test]
    fn a_coast_that_the_transect_does_not_find_is_lost() {
        // Between the vertices there is no land.
        let field =
            Formula(
                |x: f64, z: f64| {
                    if x.rem_euclid(16.0) + z.rem_euclid(16.0) > 0.0 { -1.0 } else { 1000.0 - x.hypot(z) }
                },
            );
        let window = Window::around((0, 0), 160, 2);
        let heights = field.heights(&window);
        let mask: Vec<bool> = heights.iter().map(|height| *height > 0.0).collect();
        let islands = coast::islands(&window, &heights, &label(&mask, window.side, false));
        let shores = along(&field, &window, &heights, &islands.segments, 20.0);
        assert!(shores.lost > 9 * shores.points / 10 && shores.cliffs == 0, "{shores:?}");
    }
}
