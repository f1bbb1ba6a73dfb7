//! Intersection of a ray with a height map in f64, cell by cell, over the bilinear surface between
//! texel centres that the shaders march over. Exact: no steps, no bounds.

use client::features::pom::HeightMap;

/// A ray through the relief, from its top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it enters at height 1, tiles.
    pub entry: [f64; 2],
    /// How far it travels down to height 0, tiles.
    pub travel: [f64; 2],
}

impl Ray {
    /// The ray of a view, as `shared/relief.wesl` makes it: through `uv` (tiles) on a plane at
    /// height `pivot` of a relief `amplitude` high (tiles), towards the eye (unit vector along u,
    /// along v, along the normal).
    pub fn new(uv: [f32; 2], to_eye: [f32; 3], amplitude: f32, pivot: f32) -> Self {
        let [x, y, z] = to_eye.map(f64::from);
        let travel = [-x / z * f64::from(amplitude), -y / z * f64::from(amplitude)];
        let back = 1.0 - f64::from(pivot);
        let entry = [0, 1].map(|axis| f64::from(uv[axis]) - back * travel[axis]);
        Self { entry, travel }
    }

    /// The place after a share of the travel.
    pub fn at(&self, share: f64) -> [f64; 2] {
        [0, 1].map(|axis| self.entry[axis] + share * self.travel[axis])
    }
}

/// Hit of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Where, tiles.
    pub uv: [f64; 2],
    /// At which height.
    pub height: f64,
    /// The least height by which the ray cleared what it passed before, units of the relief: near
    /// 0, it all but touched.
    pub clearance: f64,
}

/// Height of the surface at a place in tiles.
pub fn height(map: &HeightMap, [u, v]: [f64; 2]) -> f64 {
    let side = map.side() as f64;
    let (x, y) = (u * side - 0.5, v * side - 0.5);
    let (column, row) = (x.floor(), y.floor());
    Patch::of(map, column as i64, row as i64).height(x - column, y - row)
}

/// The first contact. Falling from the top to the bottom, every ray has one.
pub fn contact(map: &HeightMap, ray: &Ray) -> Contact {
    let side = map.side() as f64;
    let start = ray.entry.map(|place| place * side - 0.5);
    let along = ray.travel.map(|part| part * side);
    let mut cell = start.map(|place| place.floor() as i64);
    let (mut at, mut clearance) = (0.0f64, f64::INFINITY);
    loop {
        let exits = [0, 1].map(|axis| {
            let border = cell[axis] + i64::from(along[axis] >= 0.0);
            if along[axis] == 0.0 { f64::INFINITY } else { (border as f64 - start[axis]) / along[axis] }
        });
        let exit = exits[0].min(exits[1]).clamp(at, 1.0);
        let patch = Patch::of(map, cell[0], cell[1]);
        let within = |share: f64| [0, 1].map(|axis| start[axis] + share * along[axis] - cell[axis] as f64);
        if let Some(share) = patch.first_contact(within, at, exit) {
            return Contact { uv: ray.at(share), height: 1.0 - share, clearance };
        }
        clearance = clearance.min(patch.least_clearance(within, at, exit));
        if exit >= 1.0 {
            return Contact { uv: ray.at(1.0), height: 0.0, clearance };
        }
        let axis = usize::from(exits[1] < exits[0]);
        cell[axis] += if along[axis] >= 0.0 { 1 } else { -1 };
        at = exit;
    }
}

/// How deep below the surface a ray goes from its contact to where it comes out again, units of the
/// relief; as found in steps of a 32nd texel.
pub fn depth_after(map: &HeightMap, ray: &Ray, contact: &Contact) -> f64 {
    let texels = ray.travel[0].hypot(ray.travel[1]) * map.side() as f64;
    let pitch = 1.0 / (32.0 * texels.max(1.0));
    let from = 1.0 - contact.height;
    let depths = (1u32..)
        .map(|step| from + f64::from(step) * pitch)
        .take_while(|share| *share < 1.0)
        .map(|share| height(map, ray.at(share)) - (1.0 - share));
    // The first steps may still be on the surface.
    depths
        .enumerate()
        .take_while(|(step, depth)| *step < 2 || *depth > 0.0)
        .map(|(_, depth)| depth)
        .fold(0.0, f64::max)
}

/// Whether the sun is seen from a place on the surface, looking from `lift` of the way up: no cell
/// on the way to the top is higher than the ray. `travel`: from the bottom to the top, tiles.
pub fn is_lit(map: &HeightMap, from: [f64; 2], from_height: f64, travel: [f64; 2], lift: f64) -> bool {
    let steps = (travel[0].hypot(travel[1]) * map.side() as f64 * 16.0).ceil().max(1.0);
    let clear = |step: f64| {
        let share = lift + step / steps;
        let place = [0, 1].map(|axis| from[axis] + share * travel[axis]);
        from_height + share >= 1.0 || from_height + share > height(map, place)
    };
    (0..=steps as u64).all(|step| clear(step as f64))
}

/// The bilinear surface over one cell: `a + b x + c y + d x y`.
#[derive(Clone, Copy, Debug)]
struct Patch {
    a: f64,
    b: f64,
    c: f64,
    d: f64,
}

impl Patch {
    fn of(map: &HeightMap, column: i64, row: i64) -> Self {
        let corner = |east, south| f64::from(map.texel(column + east, row + south));
        let a = corner(0, 0);
        let (b, c) = (corner(1, 0) - a, corner(0, 1) - a);
        Self { a, b, c, d: corner(1, 1) - a - b - c }
    }

    fn height(&self, x: f64, y: f64) -> f64 {
        self.a + self.b * x + self.c * y + self.d * x * y
    }

    /// Coefficients, constant first, of the ray's height over the surface as a function of the
    /// share of the way from `near` to `far`.
    fn above(&self, within: impl Fn(f64) -> [f64; 2], near: f64, far: f64) -> [f64; 3] {
        let ([x, y], [to_x, to_y]) = (within(near), within(far));
        let (dx, dy) = (to_x - x, to_y - y);
        let slope = self.b * dx + self.c * dy + self.d * (x * dy + y * dx);
        [1.0 - near - self.height(x, y), near - far - slope, -self.d * dx * dy]
    }

    fn first_contact(&self, within: impl Fn(f64) -> [f64; 2], near: f64, far: f64) -> Option<f64> {
        let [zero, one, two] = self.above(within, near, far);
        if zero <= 0.0 {
            return Some(near);
        }
        let roots = if two.abs() < 1e-15 {
            [-zero / one, f64::NAN]
        } else {
            let discriminant = one * one - 4.0 * two * zero;
            let half = -0.5 * (one + discriminant.sqrt().copysign(one));
            [half / two, zero / half]
        };
        let inside = roots.into_iter().filter(|root| (0.0..=1.0).contains(root));
        inside.min_by(f64::total_cmp).map(|root| near + root * (far - near))
    }

    fn least_clearance(&self, within: impl Fn(f64) -> [f64; 2], near: f64, far: f64) -> f64 {
        let [zero, one, two] = self.above(within, near, far);
        let lowest = if two > 0.0 { (-one / (2.0 * two)).clamp(0.0, 1.0) } else { 0.0 };
        [0.0, lowest, 1.0]
            .map(|share| zero + share * (one + share * two))
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pom::maps::Kind;
    use crate::sample::{unit, word};

    fn rays(count: u32, tan: f64) -> impl Iterator<Item = Ray> {
        (0..count).map(move |index| {
            let share = |part: u32| unit(word(0x7ab5, 3 * index + part));
            let angle = share(2) * std::f64::consts::TAU;
            Ray { entry: [share(0), share(1)], travel: [0.05 * tan * angle.cos(), 0.05 * tan * angle.sin()] }
        })
    }

    #[test]
    fn a_contact_lies_on_the_surface_and_nothing_before_it_does() {
        for kind in Kind::ALL {
            let map = kind.map();
            for ray in rays(300, 3.7) {
                let found = contact(&map, &ray);
                assert!((height(&map, found.uv) - found.height).abs() < 1e-9, "{} {found:?}", kind.name());
                let steps = 4_000;
                let first = (0..=steps)
                    .map(|step| f64::from(step) / f64::from(steps))
                    .find(|share| 1.0 - share <= height(&map, ray.at(*share)));
                // A dense march may step over a contact, never find an earlier one.
                assert!(first.unwrap_or(1.0) >= 1.0 - found.height - 1e-9);
            }
        }
    }

    #[test]
    fn a_dense_march_agrees_and_a_coarse_one_does_not() {
        let map = Kind::Posts.map();
        let wrong = |steps: u32| {
            rays(400, 3.7)
                .filter(|ray| {
                    let first = (0..=steps).map(|step| f64::from(step) / f64::from(steps));
                    let first = first.into_iter().find(|share| 1.0 - share <= height(&map, ray.at(*share)));
                    (first.unwrap_or(1.0) - (1.0 - contact(&map, ray).height)).abs() > 0.05
                })
                .count()
        };
        let (dense, coarse) = (wrong(8_000), wrong(8));
        assert!(dense <= 1 && coarse > 40, "{dense} {coarse}");
    }
}
