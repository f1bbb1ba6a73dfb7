//! Heights of the home island on a coarse grid, and the spots that they show.

use super::units;
use super::woods::wood_share;
use glam::DVec2;
use std::f64::consts::TAU;
use std::ops::Range;
use terrain::constants::UNITS_PER_METRE;
use terrain::island::Kind;
use terrain::land::SEA_FLOOR;
use terrain::{Grid, Land, Octaves, Position};

/// Level of the grid and its spacing, metres.
const LEVEL: u8 = 4;
const SPACING_M: f64 = 32.0;
/// Vertices from the middle to an edge of the grid (5,120 m).
const HALF: usize = 160;
const SIDE: usize = 2 * HALF + 1;
/// Rows of a slice: about a chunk's worth of vertices.
const SLICE_ROWS: usize = 12;
/// Rows of a slice of a search.
const BAND_ROWS: usize = 12;
/// Vertices at the edges that are no spot: those around them are looked at.
const EDGE: usize = 16;
/// Cells of islands that are searched for the next one, to every side.
const CELLS_AROUND: i32 = 3;

/// Where a visitor stands, and the direction of the view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spot {
    /// Metres east and south of the origin.
    pub at: DVec2,
    /// Degrees clockwise from north.
    pub yaw_deg: f64,
}

/// A spot and how well it suits.
pub type Scored = (f64, Spot);

/// Rows in which spots are searched, a slice each.
pub fn bands() -> impl Iterator<Item = Range<usize>> {
    (EDGE..SIDE - EDGE).step_by(BAND_ROWS).map(|row| row..(row + BAND_ROWS).min(SIDE - EDGE))
}

/// The heights.
#[derive(Clone, Debug)]
pub struct Survey {
    /// Metres, row by row.
    heights_m: Vec<f32>,
}

impl Survey {
    pub fn new() -> Self {
        Self { heights_m: Vec::with_capacity(SIDE * SIDE) }
    }

    /// Adds some rows; whether the survey is complete.
    pub fn advance(&mut self, land: &Land) -> bool {
        let row = self.heights_m.len() / SIDE;
        let rows = SLICE_ROWS.min(SIDE - row);
        if rows > 0 {
            let low = -(HALF as f64) * SPACING_M;
            let mut heights = vec![SEA_FLOOR; SIDE * rows];
            if let Ok(grid) = Grid::new(units(low), units(low + row as f64 * SPACING_M), LEVEL, SIDE, rows) {
                land.heights(&grid, &mut heights);
            }
            self.heights_m.extend(heights.iter().map(|units| *units as f32 / UNITS_PER_METRE as f32));
        }
        self.heights_m.len() == SIDE * SIDE
    }

    /// The highest vertex, towards the land that is widest in view.
    pub fn summit(&self, rows: Range<usize>) -> Option<Scored> {
        let (column, row) = self.spots(1, rows).max_by(|a, b| self.at(*a).total_cmp(&self.at(*b)))?;
        let at = place((column, row));
        let seen = |yaw_deg: f64| {
            // Land above the line of sight to all nearer land.
            let (mut highest, mut seen) = (f64::MIN, 0);
            for step in 4..90 {
                let distance_m = SPACING_M * f64::from(step);
                let height_m = self.height_m(at + towards(yaw_deg) * distance_m);
                let rise = (height_m - self.at((column, row))) / distance_m;
                if rise >= highest {
                    (highest, seen) = (rise, seen + if height_m > 0.0 { 3 } else { 1 });
                }
            }
            seen
        };
        let yaw_deg = directions(24).max_by_key(|yaw_deg| seen(*yaw_deg))?;
        Some((self.at((column, row)), Spot { at, yaw_deg }))
    }

    /// A wide gentle shore, along the water towards the highest land.
    pub fn beach(&self, rows: Range<usize>) -> Option<Scored> {
        let candidates = self.spots(1, rows).filter_map(|spot| {
            let height_m = self.at(spot);
            let slope = self.slope(spot);
            let inland = slope.normalize_or_zero();
            let at = place(spot);
            let is_shore = (0.3..2.5).contains(&height_m)
                && slope.length() < 0.08
                && self.height_m(at - inland * 64.0) < -0.5
                && (0.8..14.0).contains(&self.height_m(at + inland * 64.0));
            if !is_shore {
                return None;
            }
            let (column, row) = spot;
            let around = (row - 4..=row + 4)
                .flat_map(|row| (column - 4..=column + 4).map(move |column| (column, row)));
            let gentle = around.filter(|spot| (-0.5..3.5).contains(&self.at(*spot))).count();
            // The water lies to one side, the land that the view rises to on the other.
            let views = [90.0, -90.0].map(|side| {
                let yaw_deg = bearing(inland) + 0.8 * side;
                (self.rise(at, yaw_deg), yaw_deg)
            });
            let (rise, yaw_deg) = if views[0].0 > views[1].0 { views[0] } else { views[1] };
            Some((gentle.min(24) as f64 + 60.0 * rise.min(0.4), Spot { at, yaw_deg }))
        });
        let (score, spot) = best(candidates)?;
        // The sand a little above the water.
        let inland = self.gradient(spot.at).normalize_or_zero();
        let off = |metres: f64| (self.height_m(spot.at + inland * metres) - 0.9).abs();
        let metres =
            (-16..=16).map(|step| 2.0 * f64::from(step)).min_by(|a, b| off(*a).total_cmp(&off(*b)))?;
        Some((score, Spot { at: spot.at + inland * metres, ..spot }))
    }

    /// The floor of the deepest valley, up along it.
    pub fn valley(&self, rows: Range<usize>) -> Option<Scored> {
        best(self.spots(2, rows).filter(|spot| (6.0..260.0).contains(&self.at(*spot))).flat_map(|spot| {
            let (at, height_m) = (place(spot), self.at(spot));
            directions(8).take(4).filter_map(move |yaw_deg| {
                let wall = |side: f64| {
                    let out = |step| self.height_m(at + towards(yaw_deg + side) * (64.0 * f64::from(step)));
                    (1..=5).map(out).fold(f64::MIN, f64::max)
                };
                let depth_m = wall(90.0).min(wall(-90.0)) - height_m;
                let fall = |way: f64| self.height_m(at + towards(yaw_deg) * way) - height_m;
                let is_floor = fall(128.0).abs() < 40.0 && fall(-128.0).abs() < 40.0 && depth_m > 25.0;
                if !is_floor {
                    return None;
                }
                let up = if fall(400.0) > fall(-400.0) { yaw_deg } else { yaw_deg + 180.0 };
                Some((depth_m + 60.0 * self.rise(at, up).min(0.6), Spot { at, yaw_deg: up }))
            })
        }))
    }

    /// A meadow before a wood.
    pub fn wood_edge(&self, rows: Range<usize>) -> Option<Scored> {
        best(self.spots(3, rows).filter_map(|spot| {
            let at = place(spot);
            if !(14.0..220.0).contains(&self.at(spot)) || self.slope(spot).length() > 0.25 {
                return None;
            }
            let here = self.wood(at);
            if here > 0.4 {
                return None;
            }
            let views = directions(8).map(|yaw_deg| {
                let ahead = [40.0, 70.0, 110.0, 160.0, 220.0];
                let level = (self.height_m(at + towards(yaw_deg) * 110.0) - self.at(spot)).abs() / 110.0;
                let wood: f64 = ahead.map(|metres| self.wood(at + towards(yaw_deg) * metres)).iter().sum();
                (wood - 2.0 * level - here, Spot { at, yaw_deg })
            });
            views.max_by(|a, b| a.0.total_cmp(&b.0))
        }))
    }

    /// The sea before the steepest coast, at an angle to it.
    pub fn cliff(&self, rows: Range<usize>) -> Option<Scored> {
        best(self.spots(1, rows).flat_map(|spot| {
            let (at, height_m) = (place(spot), self.at(spot));
            let out = -self.slope(spot).normalize_or_zero();
            let drop = (height_m > 25.0 && self.height_m(at + out * 64.0) < -1.0).then_some(height_m);
            let views = [1.0, -1.0].map(move |side| {
                let along = towards(bearing(out) + 90.0 * side);
                let eye = at + out * 190.0 + along * 150.0;
                let is_sea =
                    self.height_m(eye) < -2.0 && self.height_m(at + out * 100.0 + along * 75.0) < 0.0;
                // Beside it the coast goes on as steep.
                let beside = [-96.0, -48.0, 48.0, 96.0]
                    .map(|metres| self.height_m(at + along * metres).clamp(0.0, 60.0));
                let height_m = drop?.min(70.0) + beside.iter().sum::<f64>() * 0.25;
                is_sea.then_some((height_m, Spot { at: eye, yaw_deg: bearing(at - eye) }))
            });
            views.into_iter().flatten()
        }))
    }

    /// Vertices of some rows away from the edges, every `step`th.
    fn spots(&self, step: usize, rows: Range<usize>) -> impl Iterator<Item = (usize, usize)> {
        let rows = rows.filter(move |row| row.is_multiple_of(step));
        rows.flat_map(move |row| (EDGE..SIDE - EDGE).step_by(step).map(move |column| (column, row)))
    }

    fn at(&self, (column, row): (usize, usize)) -> f64 {
        f64::from(self.heights_m[row * SIDE + column])
    }

    /// Bilinear height, metres; that of the edge beyond the grid.
    fn height_m(&self, at: DVec2) -> f64 {
        let last = (SIDE - 1) as f64 - 1e-6;
        let [x, z] = (at / SPACING_M + HALF as f64).to_array().map(|value| value.clamp(0.0, last));
        let (column, row) = (x as usize, z as usize);
        let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let along = |row| mix(self.at((column, row)), self.at((column + 1, row)), x.fract());
        mix(along(row), along(row + 1), z.fract())
    }

    /// Gradient at a vertex, upward.
    fn slope(&self, (column, row): (usize, usize)) -> DVec2 {
        let east = self.at((column + 1, row)) - self.at((column - 1, row));
        let south = self.at((column, row + 1)) - self.at((column, row - 1));
        DVec2::new(east, south) / (2.0 * SPACING_M)
    }

    fn gradient(&self, at: DVec2) -> DVec2 {
        let along = |way: DVec2| (self.height_m(at + way) - self.height_m(at - way)) / (2.0 * SPACING_M);
        DVec2::new(along(DVec2::X * SPACING_M), along(DVec2::Y * SPACING_M))
    }

    /// How high the land rises above a place within 3 km, as a tangent.
    fn rise(&self, at: DVec2, yaw_deg: f64) -> f64 {
        let height_m = self.height_m(at);
        let rise =
            |distance_m: f64| (self.height_m(at + towards(yaw_deg) * distance_m) - height_m) / distance_m;
        (2..16).map(|step| rise(192.0 * f64::from(step))).fold(0.0, f64::max)
    }

    fn wood(&self, at: DVec2) -> f64 {
        let slope = self.gradient(at);
        let length = (1.0 + slope.length_squared()).sqrt();
        wood_share(at, self.height_m(at), [-slope.x / length, 1.0 / length, -slope.y / length])
    }
}

/// The spot with the highest score.
pub fn best(candidates: impl Iterator<Item = Scored>) -> Option<Scored> {
    candidates.max_by(|a, b| a.0.total_cmp(&b.0))
}

fn place((column, row): (usize, usize)) -> DVec2 {
    DVec2::new(column as f64 - HALF as f64, row as f64 - HALF as f64) * SPACING_M
}

/// Unit vector (east, south) of a heading.
pub fn towards(yaw_deg: f64) -> DVec2 {
    let yaw = yaw_deg.to_radians();
    DVec2::new(yaw.sin(), -yaw.cos())
}

/// Heading of a direction (east, south), degrees.
pub fn bearing(way: DVec2) -> f64 {
    way.x.atan2(-way.y).to_degrees()
}

fn directions(count: u32) -> impl Iterator<Item = f64> {
    (0..count).map(move |n| (TAU * f64::from(n) / f64::from(count)).to_degrees())
}

/// Height at a place, metres, with so many octaves.
pub fn height_m(land: &Land, at: DVec2, octaves: Octaves) -> f64 {
    let height = Position::new(units(at.x), units(at.y));
    let height = height.map_or(SEA_FLOOR, |position| land.height_keeping(position, octaves));
    f64::from(height) / f64::from(UNITS_PER_METRE)
}

/// [`height_m`] of a coarse level, at a ninth of the cost.
pub fn outline_m(land: &Land, at: DVec2) -> f64 {
    height_m(land, at, Octaves::at_level(6))
}

/// Middle of the nearest island with mountains; of the nearest one where none has, metres.
pub fn next_island(land: &Land) -> DVec2 {
    let around = || -CELLS_AROUND..=CELLS_AROUND;
    let islands = around().flat_map(|z| around().map(move |x| (x, z))).filter(|cell| *cell != (0, 0));
    let islands = islands.filter_map(|(x, z)| {
        let (kind, _) = land.archipelago().kind(x, z)?;
        let mut lobes = Vec::new();
        land.archipelago().lobes_of(x, z, &mut lobes);
        let centre = lobes.first()?.centre;
        let middle = DVec2::new(f64::from(centre.0), f64::from(centre.1)) / f64::from(UNITS_PER_METRE);
        let is_low = matches!(kind, Kind::Skerries | Kind::Atoll);
        Some((is_low, middle))
    });
    let nearest = islands.min_by(|a, b| {
        (a.0, a.1.length()).partial_cmp(&(b.0, b.1.length())).unwrap_or(std::cmp::Ordering::Equal)
    });
    nearest.map_or(DVec2::new(8192.0, 0.0), |(_, middle)| middle)
}
