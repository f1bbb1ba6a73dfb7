//! Where the sweep looks: steps across every kind of line where an implementation could break.
//!
//! Lines of constant x or z: the borders of the world and the axes; the lattice lines of every
//! octave next to the origin, next to the borders and next to powers of two between; the borders of
//! island cells, next to the same. Every line is crossed where there is land, as far as any island
//! touches it, at free places and at corners of the same octave's lattice, and at the ends of the
//! world.

use crate::sample::{on_grid, unit, word};
use terrain::constants::{
    FIRST_CELL_BITS, ISLAND_CELL_BITS, OCTAVE_SHIFT, SPACING_BITS, UNITS_PER_METRE, WORLD_HALF,
};
use terrain::island::Archipelago;

/// Two points of the world (units) that differ along one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The lower end.
    pub from: (i32, i32),
    /// The higher end.
    pub to: (i32, i32),
}

/// A line of constant x (or z) that deserves to be crossed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Whether z is constant instead of x.
    pub along_x: bool,
    /// The constant coordinate, units.
    pub at: i32,
    /// log2 of the lattice cell that ends here, and the lattice's shift along the line: crossings
    /// are made at its corners too.
    pub lattice: (u32, i32),
}

/// Vertex spacing of level 0, units.
pub const VERTEX_STEP: i32 = 1 << SPACING_BITS;

/// Crossings of a line over land.
const LAND_CROSSINGS: u32 = 24;

/// Every line to cross.
pub fn lines() -> Vec<Line> {
    let mut lines = Vec::new();
    for along_x in [false, true] {
        for (octave, (x, z)) in OCTAVE_SHIFT.into_iter().enumerate() {
            let (across, along) = if along_x { (z, x) } else { (x, z) };
            let bits = FIRST_CELL_BITS - octave as u32;
            for at in multiples_of_interest(bits).map(|multiple| multiple - i64::from(across)) {
                lines.extend(line(along_x, at, (bits, along)));
            }
        }
        let half_cell = 1i64 << (ISLAND_CELL_BITS - 1);
        for at in
            multiples_of_interest(ISLAND_CELL_BITS).flat_map(|multiple| [multiple, multiple - half_cell])
        {
            lines.extend(line(along_x, at, (ISLAND_CELL_BITS, half_cell as i32)));
        }
        for at in [-i64::from(WORLD_HALF), 0, i64::from(WORLD_HALF)] {
            lines.extend(line(along_x, at, (FIRST_CELL_BITS, 0)));
        }
    }
    lines
}

fn line(along_x: bool, at: i64, lattice: (u32, i32)) -> Option<Line> {
    let at = i32::try_from(at).ok()?;
    (-WORLD_HALF..=WORLD_HALF).contains(&at).then_some(Line { along_x, at, lattice })
}

/// Multiples of `2^bits` next to zero, to powers of two, and to both borders of the world.
fn multiples_of_interest(bits: u32) -> impl Iterator<Item = i64> {
    let cell = 1i64 << bits;
    let near = move |middle: i64| (-2..=2).map(move |n| middle + n * cell);
    let powers = (bits + 3..=30).flat_map(move |power| [1i64 << power, -(1i64 << power)]);
    near(0).chain(powers.flat_map(near))
}

impl Line {
    /// The steps across this line in a world: one unit at a time from two units before to two
    /// behind, and from vertex to vertex.
    pub fn steps(&self, archipelago: &Archipelago, stream: u32) -> Vec<Step> {
        let mut steps = Vec::new();
        for along in self.crossings(archipelago, stream) {
            let low = on_grid(self.at.saturating_sub(1).max(-WORLD_HALF));
            // Vertices see vertices: the line is crossed on the vertex line next to the crossing.
            steps.extend(self.step(low, VERTEX_STEP, on_grid(along)));
            steps.extend((-2..2).filter_map(|before| self.step(self.at + before, 1, along)));
        }
        steps
    }

    fn step(&self, low: i32, length: i32, along: i32) -> Option<Step> {
        let inside = |v: i32| (-WORLD_HALF..=WORLD_HALF).contains(&v);
        let place = |across: i32| if self.along_x { (along, across) } else { (across, along) };
        let high = low + length;
        (inside(low) && inside(high) && inside(along)).then(|| Step { from: place(low), to: place(high) })
    }

    /// Coordinates along the line at which it is crossed.
    fn crossings(&self, archipelago: &Archipelago, stream: u32) -> Vec<i32> {
        let mut crossings = vec![-WORLD_HALF, -WORLD_HALF + 1, -1, 0, 1, WORLD_HALF - 1, WORLD_HALF];
        let units = f64::from(UNITS_PER_METRE);
        let own_cell = Archipelago::cell(self.at);
        for n in 0..LAND_CROSSINGS {
            // The first three tries go to the ends of the line and its middle, where the world's
            // corners and the home island are.
            let other_cell = match n {
                0 => Archipelago::cell(-WORLD_HALF),
                1 => Archipelago::cell(WORLD_HALF),
                2 => 0,
                _ => word(stream ^ self.at as u32, 2 * n) as i32 >> (32 - (31 - ISLAND_CELL_BITS)),
            };
            let (cell_x, cell_z) = if self.along_x { (other_cell, own_cell) } else { (own_cell, other_cell) };
            let Some(island) = archipelago.island(cell_x, cell_z) else { continue };
            let (across, along) = if self.along_x {
                (island.centre.1, island.centre.0)
            } else {
                (island.centre.0, island.centre.1)
            };
            let (radius, offset) =
                (f64::from(island.radius_m) * units, f64::from(self.at) - f64::from(across));
            let half_chord = (radius * radius - offset * offset).max(0.0).sqrt();
            if half_chord == 0.0 {
                continue;
            }
            let place =
                f64::from(along) + half_chord * (2.0 * unit(word(stream ^ self.at as u32, 2 * n + 1)) - 1.0);
            // The border cells are half outside.
            let place = place.clamp(-f64::from(WORLD_HALF), f64::from(WORLD_HALF)) as i32;
            let (bits, shift) = self.lattice;
            let corner = ((i64::from(place) + i64::from(shift)) >> bits << bits) - i64::from(shift);
            crossings.push(place);
            crossings.extend(i32::try_from(corner));
        }
        crossings
    }
}

/// Walks of `length` unit steps from each corner of the world inwards, along both borders and along
/// the diagonal's stairs.
pub fn corner_walks(length: i32) -> impl Iterator<Item = Step> {
    let corners = [(-1, -1), (-1, 1), (1, -1), (1, 1)];
    corners.into_iter().flat_map(move |(sign_x, sign_z)| {
        (0..length).flat_map(move |n| {
            let at = |inward_x: i32, inward_z: i32| {
                (sign_x * (WORLD_HALF - inward_x), sign_z * (WORLD_HALF - inward_z))
            };
            [
                (at(n, 0), at(n + 1, 0)),
                (at(0, n), at(0, n + 1)),
                (at(n, n), at(n + 1, n)),
                (at(n + 1, n), at(n + 1, n + 1)),
            ]
            .map(|(a, b)| if a < b { Step { from: a, to: b } } else { Step { from: b, to: a } })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_octave_has_lines_on_both_sides_and_near_the_borders() {
        let lines = lines();
        for along_x in [false, true] {
            for bits in (FIRST_CELL_BITS - 7)..=FIRST_CELL_BITS {
                let own: Vec<i32> = lines
                    .iter()
                    .filter(|line| line.along_x == along_x && line.lattice.0 == bits)
                    .map(|line| line.at)
                    .collect();
                let near = |place: i32| own.iter().any(|at| (at - place).unsigned_abs() <= 2 << bits);
                for place in [0, 1 << 25, -(1 << 25), WORLD_HALF, -WORLD_HALF] {
                    assert!(near(place), "octave cell 2^{bits} near {place}");
                }
                assert!(own.iter().any(|at| *at < 0) && own.iter().any(|at| *at > 0));
            }
        }
    }

    #[test]
    fn steps_stay_in_the_world_and_cross_their_line() {
        let archipelago = Archipelago::new(1);
        for line in lines().into_iter().step_by(7) {
            let steps = line.steps(&archipelago, 1);
            assert!(steps.len() > 20, "{line:?}");
            for Step { from, to } in steps {
                let (dx, dz) = (to.0 - from.0, to.1 - from.1);
                assert!(dx == 0 || dz == 0);
                assert!([1, VERTEX_STEP].contains(&(dx + dz)));
                for v in [from.0, from.1, to.0, to.1] {
                    assert!((-WORLD_HALF..=WORLD_HALF).contains(&v));
                }
            }
        }
        assert!(corner_walks(10).all(|step| step.to.0 - step.from.0 + step.to.1 - step.from.1 == 1));
    }
}
