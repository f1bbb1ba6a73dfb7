//! Slopes, their directions, and heights of land, by central differences on the 16 m grid.

use super::field::{VERTEX_KM2, Window};

/// Histogram bins of a degree; quantiles are exact to one bin.
const BINS: usize = 20;

/// Metres of height in a bin.
const BIN_M: f32 = 10.0;

/// Land flatter than this is flat, and directions count from here on, degrees.
const FLAT: usize = 3;

/// Half the width of the sector about a direction, degrees.
const SECTOR: f64 = 5.0;

/// Statistics of the vertices of land.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Vertices of land.
    pub points: u64,
    /// Vertices by slope, in bins of [`BINS`] a degree.
    slopes: Vec<u64>,
    /// Vertices by height, in bins of [`BIN_M`].
    heights: Vec<u64>,
    /// Sum of squared slopes: all, near the axes, near the diagonals.
    power: [f64; 3],
}

impl Surface {
    /// Of the land of a window.
    pub fn of(window: &Window, heights: &[f32]) -> Self {
        let mut surface = Self { slopes: vec![0; 90 * BINS], ..Self::default() };
        for index in window.inner().filter(|index| heights[*index] > 0.0) {
            surface.add(heights[index], window.gradient(heights, index));
        }
        surface
    }

    fn add(&mut self, height: f32, [east, south]: [f64; 2]) {
        self.points += 1;
        let bin = (height / BIN_M) as usize;
        if bin >= self.heights.len() {
            self.heights.resize(bin + 1, 0);
        }
        self.heights[bin] += 1;
        let squared = east * east + south * south;
        let slope = (squared.sqrt().atan().to_degrees() * BINS as f64) as usize;
        self.slopes[slope.min(90 * BINS - 1)] += 1;
        if slope >= FLAT * BINS {
            // Degrees from the nearest axis, up to 45.
            let turned = east.abs().min(south.abs()).atan2(east.abs().max(south.abs())).to_degrees();
            self.power[0] += squared;
            self.power[1] += if turned <= SECTOR { squared } else { 0.0 };
            self.power[2] += if turned >= 45.0 - SECTOR { squared } else { 0.0 };
        }
    }

    /// Of two lands.
    pub fn and(mut self, other: &Self) -> Self {
        let add = |own: &mut Vec<u64>, other: &[u64]| {
            own.resize(own.len().max(other.len()), 0);
            own.iter_mut().zip(other).for_each(|(own, other)| *own += other);
        };
        add(&mut self.slopes, &other.slopes);
        add(&mut self.heights, &other.heights);
        self.points += other.points;
        self.power = [0, 1, 2].map(|part| self.power[part] + other.power[part]);
        self
    }

    /// Area, km².
    pub fn km2(&self) -> f64 {
        self.points as f64 * VERTEX_KM2
    }

    /// The slope that a share of the land does not exceed, degrees; not a number without land.
    pub fn slope(&self, share: f64) -> f64 {
        let mut left = share * self.points as f64;
        let bin = self.slopes.iter().position(|count| {
            left -= *count as f64;
            left <= 0.0
        });
        match bin {
            Some(bin) if self.points > 0 => (bin as f64 + 0.5) / BINS as f64,
            _ => f64::NAN,
        }
    }

    /// Share of the land flatter than 3 degrees.
    pub fn flat(&self) -> f64 {
        self.slopes.iter().take(FLAT * BINS).sum::<u64>() as f64 / self.points as f64
    }

    /// Squared slope in directions near the four axes, and near the four diagonals, over what
    /// isotropic land has there. Land flatter than 3 degrees does not count.
    pub fn alignment(&self) -> [f64; 2] {
        let isotropic = 4.0 * 2.0 * SECTOR / 360.0;
        [1, 2].map(|sector| self.power[sector] / self.power[0] / isotropic)
    }

    /// Share of the land in each degree of slope, per cent.
    pub fn slope_histogram(&self) -> Vec<(f64, f64)> {
        let shares =
            self.slopes.chunks(BINS).map(|bins| bins.iter().sum::<u64>() as f64 / self.points as f64);
        shares.enumerate().map(|(degree, share)| (degree as f64 + 0.5, 100.0 * share)).collect()
    }

    /// The hypsometric curve: share of the land above each height, per cent, and that height, m.
    pub fn hypsometric_curve(&self) -> Vec<(f64, f64)> {
        let mut above = self.points;
        let bins = self.heights.iter().chain([&0]).enumerate();
        let curve = bins.map(|(bin, count)| {
            let point = (100.0 * above as f64 / self.points as f64, bin as f64 * f64::from(BIN_M));
            above -= count;
            point
        });
        curve.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::field::{Field, Formula};
    use super::*;

    fn of(field: impl Fn(f64, f64) -> f64 + Sync) -> Surface {
        let window = Window::around((0, 0), 200, 1);
        Surface::of(&window, &Formula(field).heights(&window))
    }

    #[test]
    fn a_tilted_plane_has_one_slope_and_the_sea_none() {
        let plane = of(|x, z| 1000.0 + (0.3 * x + 0.4 * z) / 2.0);
        for share in [0.01, 0.5, 0.99] {
            assert!((plane.slope(share) - 0.25f64.atan().to_degrees()).abs() <= 1.0 / BINS as f64);
        }
        assert_eq!((plane.flat(), plane.points), (0.0, 40_000));
        let halves = of(|x, _| if x < 0.0 { -5.0 } else { 10.0 + 0.01 * x });
        assert!((halves.flat() - 0.99).abs() < 1e-9 && halves.points == 20_000, "{}", halves.flat());
        assert!(of(|_, _| 0.0).slope(0.5).is_nan() && of(|_, _| 0.0).flat().is_nan());
    }

    #[test]
    fn a_cone_is_isotropic_and_waves_along_an_axis_or_a_diagonal_are_not() {
        let cone = of(|x, z| 1400.0 - x.hypot(z));
        assert!(cone.alignment().iter().all(|ratio| (ratio - 1.0).abs() < 0.02), "{:?}", cone.alignment());
        let waves = of(|x, _| 1000.0 + 20.0 * (x / 20.0).sin());
        assert_eq!(waves.alignment(), [9.0, 0.0]);
        let waves = of(|x, z| 1000.0 + 20.0 * ((x + z) / 40.0).sin());
        assert!(waves.alignment()[0] < 1e-9 && (waves.alignment()[1] - 9.0).abs() < 1e-9);
    }

    #[test]
    fn parts_add_up_and_curves_hold_all_land() {
        let (low, high) = (of(|_, _| 5.0), of(|x, _| 1000.0 + 0.5 * x));
        let both = low.clone().and(&high);
        assert_eq!((both.points, both.flat()), (low.points + high.points, 0.5));
        assert!((both.slope_histogram().iter().map(|bin| bin.1).sum::<f64>() - 100.0).abs() < 1e-9);
        let curve = both.hypsometric_curve();
        assert!(curve[0] == (100.0, 0.0) && curve[1].0 < 60.0 && curve.last().unwrap().0 == 0.0, "{curve:?}");
    }
}
