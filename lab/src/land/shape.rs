//! The shape of the land in a window: coasts, slopes, pits, shores; sums over windows, and figures.

use super::coast;
use super::field::{Field, Window};
use super::labels::label;
use super::pits;
use super::shore::{self, Shores};
use super::surface::Surface;
use crate::stats::quantiles;
use serde::Serialize;

/// Metres of coast between the points that are looked at for cliffs and beaches.
pub const EVERY_M: f64 = 200.0;

/// Sums over windows.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// Coast length of each island over that of a circle of its area.
    ratios: Vec<f64>,
    left_out: u64,
    coast_m: f64,
    pits: u64,
    shores: Shores,
    /// Slopes and heights.
    pub surface: Surface,
}

/// Figures of the shape. Field names are a contract with scripts.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Figures {
    /// Islands of at least 1 km² with their centroid in a window.
    pub islands: usize,
    /// Such islands that touch the window's edge and so have no coast length.
    pub left_out: u64,
    pub coast_km: f64,
    pub land_km2: f64,
    /// Coast length over that of a circle of the same area: lower quartile, median, upper quartile.
    pub coast_ratio: [f64; 3],
    /// Quantiles of the slope, degrees: 50, 90 and 99 %.
    pub slopes: [f64; 3],
    /// Land flatter than 3 degrees, per cent.
    pub flat: f64,
    pub pits_per_km2: f64,
    /// Coast with a cliff and with a beach, per cent.
    pub cliffs: f64,
    pub beaches: f64,
    /// Points of the coast.
    pub shores: Shores,
    /// Power of gradients near the axes, and near the diagonals, over isotropic.
    pub axes: f64,
    pub diagonals: f64,
}

impl Shape {
    /// Measures a window.
    pub fn of(field: &dyn Field, window: &Window) -> Self {
        let heights = field.heights(window);
        let mask: Vec<bool> = heights.iter().map(|height| *height > 0.0).collect();
        let islands = coast::islands(window, &heights, &label(&mask, window.side, false));
        Self {
            shores: shore::along(field, window, &heights, &islands.segments, EVERY_M),
            ratios: islands.ratios,
            left_out: islands.left_out,
            coast_m: islands.coast_m,
            pits: pits::count(window, &heights),
            surface: Surface::of(window, &heights),
        }
    }

    /// Of two sets of windows.
    pub fn and(mut self, other: Self) -> Self {
        self.ratios.extend(other.ratios);
        Self {
            ratios: self.ratios,
            left_out: self.left_out + other.left_out,
            coast_m: self.coast_m + other.coast_m,
            pits: self.pits + other.pits,
            shores: self.shores.and(other.shores),
            surface: self.surface.and(&other.surface),
        }
    }

    /// The figures; not numbers where there is no land.
    pub fn figures(&self) -> Figures {
        let percent = |count: u64| 100.0 * count as f64 / self.shores.points as f64;
        let [axes, diagonals] = self.surface.alignment();
        Figures {
            islands: self.ratios.len(),
            left_out: self.left_out,
            coast_km: self.coast_m * 1e-3,
            land_km2: self.surface.km2(),
            coast_ratio: quantiles(self.ratios.iter().copied(), [0.25, 0.5, 0.75]),
            slopes: [0.5, 0.9, 0.99].map(|share| self.surface.slope(share)),
            flat: 100.0 * self.surface.flat(),
            pits_per_km2: self.pits as f64 / self.surface.km2(),
            cliffs: percent(self.shores.cliffs),
            beaches: percent(self.shores.beaches),
            shores: self.shores,
            axes,
            diagonals,
        }
    }
}
