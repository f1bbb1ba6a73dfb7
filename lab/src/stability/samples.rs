//! Where the sweep looks: short walks across every kind of line where an implementation could
//! break.
//!
//! Lines of constant x or z ([`lines`]): the borders of the world and the axes; the lattice lines
//! of every fine octave and of the base lattice next to the origin, next to the borders and next to
//! powers of two between; the borders of the archipelago's cells, next to the same. Every line is
//! crossed where there is land, as far as any island touches it, at free places and at corners of
//! the same lattice, and at the ends of the world. The edges and corners of turned lattices
//! ([`super::edges`]) and the places where curves of the base field begin and end
//! ([`super::thresholds`]) are not such lines.

use crate::sample::{lobe, on_grid, unit, word};
use terrain::constants::{
    FIRST_CELL_BITS, ISLAND_CELL_BITS, OCTAVE_SHIFT, SPACING_BITS, UNITS_PER_METRE, WORLD_HALF,
};
use terrain::island::Archipelago;
use terrain::spline::CELL_BITS;

/// Steps of one length along one axis, all in the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Walk {
    /// Where it begins, at the lower end, units.
    pub from: (i32, i32),
    /// 0 east, 1 south.
    pub axis: usize,
    /// Length of a step, units.
    pub step: i32,
    /// Number of steps.
    pub count: i32,
}

/// A line of constant x (or z) that deserves to be crossed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Axis of which the coordinate is constant: 0 for x, 1 for z.
    pub axis: usize,
    /// The constant coordinate, units.
    pub at: i32,
    /// log2 of the lattice cell that ends here, and the lattice's shift along the line: crossings
    /// are made at its corners too.
    pub lattice: (u32, i32),
}

/// Vertex spacing of level 0, units.
pub const VERTEX_STEP: i32 = 1 << SPACING_BITS;

/// Unit steps before and behind a line.
const AROUND: i32 = 2;

/// Crossings of a line over land, and the cells that are tried for them.
const LAND_CROSSINGS: usize = 4;
const TRIES: u32 = 24;

impl Walk {
    /// Unit steps around a place, those in the world.
    pub fn around(place: (i32, i32), axis: usize) -> Option<Self> {
        let [x, z] = [place.0, place.1];
        let (across, along) = if axis == 0 { (x, z) } else { (z, x) };
        if !is_inside(across) || !is_inside(along) {
            return None;
        }
        let low = (across - AROUND).max(-WORLD_HALF);
        let high = (across + AROUND).min(WORLD_HALF);
        Some(Self { from: place_of(axis, low, along), axis, step: 1, count: high - low })
    }

    /// Its points, one more than steps.
    pub fn points(&self) -> impl Iterator<Item = (i32, i32)> + use<> {
        let Self { from, axis, step, count } = *self;
        (0..=count)
            .map(move |n| if axis == 0 { (from.0 + n * step, from.1) } else { (from.0, from.1 + n * step) })
    }
}

/// A place from its coordinate on an axis and the one along the other.
fn place_of(axis: usize, across: i32, along: i32) -> (i32, i32) {
    if axis == 0 { (across, along) } else { (along, across) }
}

fn is_inside(coordinate: i32) -> bool {
    (-WORLD_HALF..=WORLD_HALF).contains(&coordinate)
}

/// Every line to cross.
pub fn lines() -> Vec<Line> {
    let mut lines = Vec::new();
    for axis in [0, 1] {
        for (octave, (x, z)) in OCTAVE_SHIFT.into_iter().enumerate() {
            let (across, along) = if axis == 0 { (x, z) } else { (z, x) };
            let bits = FIRST_CELL_BITS - octave as u32;
            for at in multiples_of_interest(bits).map(|multiple| multiple - i64::from(across)) {
                lines.extend(line(axis, at, (bits, along)));
            }
        }
        for at in multiples_of_interest(CELL_BITS) {
            lines.extend(line(axis, at, (CELL_BITS, 0)));
        }
        let half_cell = 1i64 << (ISLAND_CELL_BITS - 1);
        for at in multiples_of_interest(ISLAND_CELL_BITS).map(|multiple| multiple - half_cell) {
            lines.extend(line(axis, at, (ISLAND_CELL_BITS, half_cell as i32)));
        }
        for at in [-i64::from(WORLD_HALF), 0, i64::from(WORLD_HALF)] {
            lines.extend(line(axis, at, (FIRST_CELL_BITS, 0)));
        }
    }
    lines
}

fn line(axis: usize, at: i64, lattice: (u32, i32)) -> Option<Line> {
    let at = i32::try_from(at).ok().filter(|at| is_inside(*at))?;
    Some(Line { axis, at, lattice })
}

/// Multiples of `2^bits` next to zero, to powers of two, and to both borders of the world.
fn multiples_of_interest(bits: u32) -> impl Iterator<Item = i64> {
    let cell = 1i64 << bits;
    let near = move |middle: i64| (-2..=2).map(move |n| middle + n * cell);
    let powers = (bits + 3..=30).flat_map(move |power| [1i64 << power, -(1i64 << power)]);
    near(0).chain(powers.flat_map(near))
}

impl Line {
    /// The walks across this line in a world: one unit at a time from two units before to two
    /// behind, and from vertex to vertex.
    pub fn walks(&self, archipelago: &Archipelago, stream: u32) -> Vec<Walk> {
        let mut walks = Vec::new();
        let low = on_grid(self.at.saturating_sub(1).max(-WORLD_HALF)).min(WORLD_HALF - VERTEX_STEP);
        for along in self.crossings(archipelago, stream) {
            // Vertices see vertices: the line is crossed on the vertex line next to the crossing.
            let from = place_of(self.axis, low, on_grid(along));
            walks.push(Walk { from, axis: self.axis, step: VERTEX_STEP, count: 1 });
            walks.extend(Walk::around(place_of(self.axis, self.at, along), self.axis));
        }
        walks
    }

    /// Coordinates along the line, in the world, at which it is crossed.
    fn crossings(&self, archipelago: &Archipelago, stream: u32) -> Vec<i32> {
        let mut crossings = vec![-WORLD_HALF, -WORLD_HALF + 1, -1, 0, 1, WORLD_HALF - 1, WORLD_HALF];
        let fixed = crossings.len();
        let own_cell = Archipelago::cell(self.at);
        for n in 0..TRIES {
            if crossings.len() >= fixed + 2 * LAND_CROSSINGS {
                break;
            }
            let words: [u32; 3] =
                std::array::from_fn(|part| word(stream ^ self.at as u32, 3 * n + part as u32));
            // The first three tries go to the ends of the line and its middle, where the world's
            // corners and the home island are.
            let other_cell = match n {
                0 => Archipelago::cell(-WORLD_HALF),
                1 => Archipelago::cell(WORLD_HALF),
                2 => 0,
                _ => words[0] as i32 >> (32 - (31 - ISLAND_CELL_BITS)),
            };
            let cell = place_of(self.axis, own_cell, other_cell);
            if archipelago.kind(cell.0, cell.1).is_none() {
                continue;
            }
            let lobe = lobe(archipelago, cell, words[1]);
            let (across, along) = if self.axis == 0 { lobe.centre } else { (lobe.centre.1, lobe.centre.0) };
            let radius = f64::from(lobe.reach_m) * f64::from(UNITS_PER_METRE);
            let offset = f64::from(self.at) - f64::from(across);
            let half_chord = (radius * radius - offset * offset).max(0.0).sqrt();
            if half_chord == 0.0 {
                continue;
            }
            // The border cells are half outside.
            let place = (f64::from(along) + half_chord * (2.0 * unit(words[2]) - 1.0))
                .clamp(-f64::from(WORLD_HALF), f64::from(WORLD_HALF)) as i32;
            let (bits, shift) = self.lattice;
            let corner = ((i64::from(place) + i64::from(shift)) >> bits << bits) - i64::from(shift);
            crossings.push(place);
            crossings.extend(i32::try_from(corner).ok().filter(|corner| is_inside(*corner)));
        }
        crossings
    }
}

/// Walks of `length` unit steps from each corner of the world inwards, along both borders and along
/// the diagonal's stairs.
pub fn corner_walks(length: i32) -> impl Iterator<Item = Walk> {
    let corners = [(-1, -1), (-1, 1), (1, -1), (1, 1)];
    corners.into_iter().flat_map(move |(sign_x, sign_z)| {
        // The lower end of `count` steps that begin `inward` units from the border.
        let low = |sign: i32, inward: i32, count: i32| {
            if sign < 0 { inward - WORLD_HALF } else { WORLD_HALF - inward - count }
        };
        let walk = move |axis: usize, inward: (i32, i32), count: i32| {
            let counts = if axis == 0 { (count, 0) } else { (0, count) };
            let from = (low(sign_x, inward.0, counts.0), low(sign_z, inward.1, counts.1));
            Walk { from, axis, step: 1, count }
        };
        let stairs = (0..length).flat_map(move |n| [walk(0, (n, n), 1), walk(1, (n + 1, n), 1)]);
        [walk(0, (0, 0), length), walk(1, (0, 0), length)].into_iter().chain(stairs)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_lattice_has_lines_on_both_sides_and_near_the_borders() {
        let lines = lines();
        for axis in [0, 1] {
            for bits in ((FIRST_CELL_BITS - 4)..=FIRST_CELL_BITS).chain([ISLAND_CELL_BITS]) {
                let own: Vec<i32> = lines
                    .iter()
                    .filter(|line| line.axis == axis && line.lattice.0 == bits)
                    .map(|line| line.at)
                    .collect();
                let near = |place: i32| own.iter().any(|at| (at - place).unsigned_abs() <= 2 << bits);
                for place in [0, 1 << 25, -(1 << 25), WORLD_HALF, -WORLD_HALF] {
                    assert!(near(place), "cell 2^{bits} near {place}");
                }
                assert!(own.iter().any(|at| *at < 0) && own.iter().any(|at| *at > 0));
            }
            let base: Vec<_> = lines.iter().filter(|line| line.lattice == (CELL_BITS, 0)).collect();
            assert!(base.len() > 100 && base.iter().all(|line| line.at % (1 << CELL_BITS) == 0));
        }
    }

    #[test]
    fn walks_stay_in_the_world_and_cross_their_line() {
        let archipelago = Archipelago::new(1);
        for line in lines().into_iter().step_by(7) {
            let walks = line.walks(&archipelago, 1);
            assert!(walks.len() >= 14, "{line:?}");
            for walk in walks {
                let points: Vec<_> = walk.points().collect();
                assert!(points.iter().all(|(x, z)| is_inside(*x) && is_inside(*z)), "{walk:?}");
                let across = |(x, z): (i32, i32)| if line.axis == 0 { x } else { z };
                let (low, high) = (across(points[0]), across(points[points.len() - 1]));
                assert!(low <= line.at && line.at <= high && low < high, "{walk:?} {line:?}");
            }
        }
        for walk in corner_walks(10) {
            assert!(walk.points().all(|(x, z)| is_inside(x) && is_inside(z)), "{walk:?}");
            assert!(walk.points().any(|(x, z)| x.abs().min(z.abs()) >= WORLD_HALF - 10));
        }
    }
}
