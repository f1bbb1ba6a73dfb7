//! The archipelago: where islands lie, of what kind they are, and the mass and height that they
//! give a point.
//!
//! The world is cut into square cells of 8,192 m. The first is centred on the origin. A cell holds
//! at most one island, whose centre is at most 3,584 m from the middle of the cell along each axis.
//! So a lobe ends less than one cell outside its own cell, and a point is affected by the islands
//! of 3 x 3 cells only.
//!
//! An island has one to four elliptic lobes. The masses of all lobes are joined as `1 - Π (1 - m)`.
//! The result is smooth, below one, and zero outside all lobes. Heights are joined in the same way.

use crate::constants::{GRADIENTS, HOME_LOBE_M, ISLAND_CELL_BITS, UNIT_BITS, WARP_M};
use crate::curves::{ALMOST_ONE_Q30, square};
use crate::hash::{hash2, mix, stream_seed};
use crate::ring::{mul_hi, mul_hi_u};

/// Most lobes of an island.
pub const LOBES: usize = 4;

/// The form of an island.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One mountain with two shoulders.
    Single,
    /// Four lobes side by side.
    Group,
    /// Low rocks.
    Skerries,
    /// Steep sides and a flat top.
    Plateau,
    /// One mountain with a crater.
    Volcano,
    /// A low ring around a lagoon.
    Atoll,
}

/// One elliptic part of an island.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lobe {
    /// Centre, units.
    pub centre: (i32, i32),
    /// Longer semi-axis, metres: an upper bound of the distance between centre and rim.
    pub reach_m: i32,
    /// The point of the ellipse's frame per metre: `along = x (long.0) + z (long.1)`, likewise
    /// across; 1 at the rim. Q38 of 1/m.
    pub long: (i32, i32),
    /// The other axis, Q38 of 1/m.
    pub short: (i32, i32),
    /// Coefficients of the mass, `s (mass.0 + s mass.1) / 8` clamped to `[0, 1]`. `s` is the square
    /// of the falloff `1 - along² - across²`.
    pub mass: (i32, i32),
    /// Height at the middle, 1/256 of the tallest.
    pub height: i32,
    /// log2 of the factor of `s` in the height, whose product is clamped to one: 2 makes a flat
    /// top. `s` is the squared falloff.
    pub plateau: u32,
    /// Whether there is a crater.
    pub crater: bool,
}

/// Contribution of all lobes together to a point. Q30, below 2^30.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mass {
    /// How much land there is: 0 outside all lobes, about 0.2 to 0.5 on coasts.
    pub mass: i32,
    /// How high it may become.
    pub height: i32,
}

/// The islands of one world.
#[derive(Clone, Copy, Debug)]
pub struct Archipelago {
    seed: u32,
}

/// The lobes that may affect a place or a square.
pub type Lobes = Vec<Lobe>;

/// Random numbers of one island.
struct Draws(u32);

impl Draws {
    const fn word(&mut self) -> u32 {
        self.0 = mix(self.0.wrapping_add(0x9e37_79b9));
        self.0
    }

    /// A number from `low` to `high`, both included.
    const fn between(&mut self, low: i32, high: i32) -> i32 {
        low + mul_hi_u(self.word(), (high - low + 1) as u32) as i32
    }

    const fn direction(&mut self) -> (i32, i32) {
        let (x, z) = GRADIENTS[(self.word() >> 27) as usize];
        (x as i32, z as i32)
    }
}

impl Archipelago {
    /// The archipelago of a world seed.
    #[must_use]
    pub const fn new(world_seed: u64) -> Self {
        Self { seed: stream_seed(world_seed, 0x1517) }
    }

    /// Decides which cells hold an island, and which one.
    pub(crate) const fn seed(&self) -> u32 {
        self.seed
    }

    /// The cell that a coordinate lies in.
    #[must_use]
    #[inline]
    pub const fn cell(coordinate: i32) -> i32 {
        (coordinate + (1 << (ISLAND_CELL_BITS - 1))) >> ISLAND_CELL_BITS
    }

    /// The kind of a cell's island, and the hash that decides the rest; the cell of the origin
    /// always has a single mountain.
    #[must_use]
    pub const fn kind(&self, cell_x: i32, cell_z: i32) -> Option<(Kind, u32)> {
        let hash = hash2(self.seed, cell_x, cell_z);
        if cell_x == 0 && cell_z == 0 {
            return Some((Kind::Single, hash));
        }
        let beside_home = cell_x.abs() <= 1 && cell_z.abs() <= 1;
        if hash & 15 >= 7 || (beside_home && hash & 1 == 0) {
            return None;
        }
        let kind = match hash >> 4 & 15 {
            0..=3 => Kind::Single,
            4..=6 => Kind::Group,
            7..=8 => Kind::Skerries,
            9..=11 => Kind::Plateau,
            12..=13 => Kind::Volcano,
            _ => Kind::Atoll,
        };
        Some((kind, hash))
    }

    /// Adds the lobes of a cell's island; both coordinates within ±2^10.
    pub fn lobes_of(&self, cell_x: i32, cell_z: i32, lobes: &mut Lobes) {
        let Some((kind, hash)) = self.kind(cell_x, cell_z) else { return };
        let home = cell_x == 0 && cell_z == 0;
        let mut draws = Draws(hash);
        let (size, jitter_x, jitter_z) =
            (draws.between(0, 255), draws.between(-1792, 1792), draws.between(-1792, 1792));
        let drawn_height = draws.between(90, 255);
        // Small islands are more frequent than large ones: the square of a uniform number.
        let radius_m = (HOME_LOBE_M * if home { 256 } else { 108 + ((size * size * 148) >> 16) }) >> 8;
        let middle = |cell: i32, jitter: i32| (cell << ISLAND_CELL_BITS) + if home { 0 } else { jitter << 9 };
        let middle = (middle(cell_x, jitter_x), middle(cell_z, jitter_z));
        let height = if home { 192 } else { drawn_height };
        for index in 0..kind.lobes() {
            lobes.push(kind.lobe(index, home, middle, radius_m, height, &mut draws));
        }
    }

    /// The lobes that may touch the square `[x, x + side] x [z, z + side]` (units), however the
    /// coasts are warped.
    #[must_use]
    pub fn lobes_near(&self, x: i32, z: i32, side: u32) -> Lobes {
        let mut lobes = Lobes::new();
        let last = |v: i32| Self::cell(v.saturating_add_unsigned(side)) + 1;
        for cell_z in Self::cell(z) - 1..=last(z) {
            for cell_x in Self::cell(x) - 1..=last(x) {
                let before = lobes.len();
                self.lobes_of(cell_x, cell_z, &mut lobes);
                let mut kept = before;
                for index in before..lobes.len() {
                    if lobes[index].touches(x, z, side) {
                        lobes[kept] = lobes[index];
                        kept += 1;
                    }
                }
                lobes.truncate(kept);
            }
        }
        lobes
    }

    /// Whether the square touches no island. Conservative: a false answer may still be open sea.
    /// Answers false at once for squares of more than one cell.
    #[must_use]
    pub fn is_open_sea(&self, x: i32, z: i32, side: u32) -> bool {
        side <= 1u32 << ISLAND_CELL_BITS && self.lobes_near(x, z, side).is_empty()
    }
}

impl Kind {
    const fn lobes(self) -> usize {
        match self {
            Self::Single | Self::Skerries => 3,
            Self::Group => 4,
            Self::Plateau | Self::Volcano => 2,
            Self::Atoll => 1,
        }
    }

    /// One lobe. Lengths are drawn in 1/256 of the island's radius.
    fn lobe(
        self,
        index: usize,
        home: bool,
        middle: (i32, i32),
        radius_m: i32,
        height: i32,
        draws: &mut Draws,
    ) -> Lobe {
        let first = index == 0;
        let (away, axis) = (draws.direction(), draws.direction());
        let (distance, long, short) = match (self, first) {
            (Self::Group, _) => (draws.between(115, 179), draws.between(77, 159), draws.between(56, 108)),
            (Self::Volcano, true) => (0, draws.between(179, 189), draws.between(166, 179)),
            (Self::Atoll, _) => (0, draws.between(192, 230), draws.between(159, 192)),
            (_, true) => (13, draws.between(159, 243), draws.between(123, 174)),
            (_, false) => (draws.between(77, 141), draws.between(102, 205), draws.between(72, 128)),
        };
        let share = draws.between(77, 256);
        let length = |part: i32| (part * radius_m) >> 8;
        let (height, plateau) = match (self, first) {
            (Self::Skerries, _) => (10, 0),
            (Self::Atoll, _) => (5, 0),
            (Self::Plateau, _) => (if height < 154 { 108 } else { (height * 179) >> 8 }, 2),
            (Self::Volcano, true) => (if height < 179 { 179 } else { height }, 0),
            (_, true) => (height, 0),
            (_, false) => ((height * share) >> 8, 0),
        };
        let mass = match (self, first) {
            (Self::Skerries, _) => (3, 0),
            (Self::Atoll, _) => (40, -48),
            (Self::Plateau, _) | (Self::Volcano, true) => (16, -8),
            (Self::Single, true) if home => (16, -8),
            _ => (8, 0),
        };
        let offset = |direction: i32| (direction * length(distance)) >> (15 - UNIT_BITS);
        Lobe {
            centre: (middle.0 + offset(away.0), middle.1 + offset(away.1)),
            reach_m: length(long.max(short)),
            long: Lobe::axis(axis, length(long)),
            short: Lobe::axis((-axis.1, axis.0), length(short)),
            mass,
            height,
            plateau,
            crater: matches!(self, Self::Volcano) && first,
        }
    }
}

impl Lobe {
    /// An axis of a length (metres, 300 to 8,191) as [`Lobe::long`]. The division is the only one
    /// of the formula, unsigned.
    const fn axis(direction: (i32, i32), length_m: i32) -> (i32, i32) {
        let inverse_q39 = ((1u32 << 31) / length_m as u32) << 8;
        (mul_hi(direction.0 << 16, inverse_q39 as i32), mul_hi(direction.1 << 16, inverse_q39 as i32))
    }

    /// Whether the lobe may touch a square.
    fn touches(&self, x: i32, z: i32, side: u32) -> bool {
        let reach = i64::from(self.reach_m + WARP_M) << UNIT_BITS;
        let gap = |centre: i32, low: i32| {
            let (centre, low) = (i64::from(centre), i64::from(low));
            (low - centre).max(centre - low - i64::from(side)).max(0)
        };
        gap(self.centre.0, x).max(gap(self.centre.1, z)) <= reach
    }

    /// The falloff of a point from the centre, given in Q18 metres: `1 - along² - across²`, Q26,
    /// from 0 at and beyond the rim to less than 2^26.
    #[must_use]
    #[inline]
    pub(crate) fn falloff(&self, (x, z): (i32, i32)) -> i32 {
        let squared = |axis: (i32, i32)| {
            let along_q24 = mul_hi(x, axis.0) + mul_hi(z, axis.1);
            let clamped_q29 = along_q24.clamp(-TWO_Q24, TWO_Q24) << 5;
            mul_hi(clamped_q29, clamped_q29)
        };
        ((1 << 26) - 1 - squared(self.long) - squared(self.short)).max(0)
    }
}

pub(crate) const TWO_Q24: i32 = 2 << 24;
/// [`Lobe::falloff`] at which the crater begins, Q26 (not squared).
pub(crate) const CRATER_Q26: i32 = 15 << 22;

impl Mass {
    /// Outside all lobes.
    pub const NONE: Self = Self { mass: 0, height: 0 };

    /// Contribution of lobes to the point `(x, z)` (units), displaced by the warp (Q16 metres).
    #[must_use]
    pub fn at(lobes: &[Lobe], (x, z): (i32, i32), warp: (i32, i32)) -> Self {
        let (mut mass_left, mut height_left) = (ALMOST_ONE_Q30, ALMOST_ONE_Q30);
        for lobe in lobes {
            let u = lobe.falloff((offset(x, lobe.centre.0, warp.0), offset(z, lobe.centre.1, warp.1)));
            if u == 0 {
                continue;
            }
            let s = square(u << 4);
            let inner_q27 = (lobe.mass.0 << 24) + lobe.mass.1 * (s >> 6);
            let mass_q26 = mul_hi(s << 1, inner_q27).clamp(0, (1 << 26) - 1);
            mass_left -= mul_hi(mass_left, mass_q26 << 5) << 1;
            let mut top = s.min(ALMOST_ONE_Q30 >> lobe.plateau) << lobe.plateau;
            if lobe.crater {
                let w = (u - CRATER_Q26).max(0) << 8;
                top -= (square(w) >> 4) * 7;
            }
            let height_q30 = (top >> 8) * lobe.height;
            height_left -= mul_hi(height_left, height_q30 << 1) << 1;
        }
        Self { mass: ALMOST_ONE_Q30 - mass_left, height: ALMOST_ONE_Q30 - height_left }
    }
}

/// Largest distance from a lobe's centre along an axis, Q16 metres.
pub(crate) const OFFSET_LIMIT: i32 = 1 << 29;

/// The displaced distance of a coordinate from a centre, Q18 metres, at most 8,192 m either way:
/// every lobe is smaller.
#[inline]
pub(crate) fn offset(coordinate: i32, centre: i32, warp_q16: i32) -> i32 {
    let units = (coordinate - centre).clamp(-OFFSET_LIMIT >> 8, OFFSET_LIMIT >> 8);
    ((units << 8) + warp_q16).clamp(-OFFSET_LIMIT, OFFSET_LIMIT - 1) << 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::{UNITS_PER_METRE, WORLD_HALF};
    use crate::land::{Land, SEA_FLOOR};
    use crate::position::Position;

    fn cells() -> impl Iterator<Item = (i32, i32)> {
        (-100..100).flat_map(|x| (-100..100).map(move |z| (x, z)))
    }

    #[test]
    fn lobes_reach_less_than_one_cell_beyond_their_own() {
        let archipelago = Archipelago::new(7);
        let mut farthest = 0;
        for (x, z) in cells() {
            let mut lobes = Lobes::new();
            archipelago.lobes_of(x, z, &mut lobes);
            for lobe in lobes {
                assert!((300..8192).contains(&lobe.reach_m), "{lobe:?}");
                for (centre, cell) in [(lobe.centre.0, x), (lobe.centre.1, z)] {
                    let reach = (lobe.reach_m + WARP_M) * UNITS_PER_METRE;
                    farthest = farthest.max((centre - (cell << ISLAND_CELL_BITS)).abs() + reach);
                }
            }
        }
        let limit = 3 << (ISLAND_CELL_BITS - 1);
        assert!(farthest <= limit && farthest > limit * 9 / 10, "{farthest} of {limit}");
    }

    #[test]
    fn every_world_has_a_home_and_all_kinds_of_islands() {
        for seed in [0, 1, 42, u64::MAX] {
            let archipelago = Archipelago::new(seed);
            assert_eq!(archipelago.kind(0, 0).map(|(kind, _)| kind), Some(Kind::Single));
            let kinds: Vec<_> =
                cells().filter_map(|(x, z)| archipelago.kind(x, z)).map(|(kind, _)| kind).collect();
            assert!((16_500..18_500).contains(&kinds.len()), "{} islands in 40,000 cells", kinds.len());
            for kind in [Kind::Single, Kind::Group, Kind::Skerries, Kind::Plateau, Kind::Volcano, Kind::Atoll]
            {
                assert!(kinds.iter().filter(|found| **found == kind).count() > 1500, "{kind:?}");
            }
        }
    }

    /// The falloff and the products in f64, from the lobes as they are.
    fn mass_f64(lobes: &[Lobe], (x, z): (i32, i32), warp: (i32, i32)) -> (f64, f64) {
        let (mut mass_left, mut height_left) = (1.0, 1.0);
        for lobe in lobes {
            let metres = |p: i32, c: i32, w: i32| f64::from(p - c) / 256.0 + f64::from(w) / 65_536.0;
            let (x, z) = (metres(x, lobe.centre.0, warp.0), metres(z, lobe.centre.1, warp.1));
            let along = |axis: (i32, i32)| (x * f64::from(axis.0) + z * f64::from(axis.1)) / 2f64.powi(38);
            let u = (1.0 - along(lobe.long).powi(2) - along(lobe.short).powi(2)).max(0.0);
            let s = u * u;
            let mass = s * (f64::from(lobe.mass.0) + f64::from(lobe.mass.1) * s) / 8.0;
            mass_left *= 1.0 - mass.clamp(0.0, 1.0);
            let mut top = (s * f64::from(1 << lobe.plateau)).min(1.0);
            if lobe.crater {
                top -= ((u - 15.0 / 16.0).max(0.0) * 16.0).powi(2) * 7.0 / 16.0;
            }
            height_left *= 1.0 - top * f64::from(lobe.height) / 256.0;
        }
        (1.0 - mass_left, 1.0 - height_left)
    }

    #[test]
    fn mass_and_height_are_the_stated_products() {
        let archipelago = Archipelago::new(3);
        let mut inside = 0;
        for n in 0..40_000u32 {
            let place = (mix(n) as i32 >> 8, mix(!n) as i32 >> 8);
            let warp = (mix(n ^ 77) as i32 >> 6, mix(n ^ 99) as i32 >> 6);
            let lobes = archipelago.lobes_near(place.0, place.1, 1);
            let got = Mass::at(&lobes, place, warp);
            let exact = mass_f64(&lobes, place, warp);
            for (got, exact) in [(got.mass, exact.0), (got.height, exact.1)] {
                assert!((f64::from(got) / 2f64.powi(30) - exact).abs() < 2f64.powi(-20), "{got} {exact}");
                assert!((0..1 << 30).contains(&got));
            }
            inside += i32::from(got.mass > 0);
        }
        assert!(inside > 4_000, "{inside}");
    }

    #[test]
    fn open_sea_is_the_flat_sea_floor() {
        let land = Land::new(11);
        let side = 1u32 << 18;
        let mut seas = 0;
        for (x, z) in (-40..40).flat_map(|i| (-40..40).map(move |j| (i << 18, j << 18))) {
            if !land.archipelago().is_open_sea(x, z, side) {
                continue;
            }
            seas += 1;
            let far = side as i32;
            for (px, pz) in [(x, z), (x + far, z), (x, z + far), (x + far / 2, z + far / 2)] {
                assert_eq!(land.height_at(Position::new(px, pz).unwrap()), SEA_FLOOR, "({px}, {pz})");
            }
        }
        assert!(seas > 500, "{seas}");
        assert!(!land.archipelago().is_open_sea(-1000, -1000, 2000), "the home island is land");
        let whole = land.archipelago().is_open_sea(-WORLD_HALF, -WORLD_HALF, 1 << 31);
        assert!(!whole, "the whole world is not open sea");
    }

    #[test]
    fn lobes_have_the_heights_and_masses_of_the_table() {
        let lobe = |kind: Kind, index, home, tall| kind.lobe(index, home, (0, 0), 3000, tall, &mut Draws(1));
        for (kind, tall, height) in [
            (Kind::Single, 90, 90),
            (Kind::Group, 255, 255),
            (Kind::Skerries, 255, 10),
            (Kind::Atoll, 255, 5),
            (Kind::Plateau, 153, 108),
            (Kind::Plateau, 154, 107),
            (Kind::Plateau, 255, 178),
            (Kind::Volcano, 178, 179),
            (Kind::Volcano, 180, 180),
        ] {
            assert_eq!(lobe(kind, 0, false, tall).height, height, "{kind:?} of {tall}");
        }
        for (kind, index, home, mass) in [
            (Kind::Single, 0, true, (16, -8)),
            (Kind::Single, 0, false, (8, 0)),
            (Kind::Single, 1, true, (8, 0)),
            (Kind::Group, 0, false, (8, 0)),
            (Kind::Skerries, 1, false, (3, 0)),
            (Kind::Atoll, 0, false, (40, -48)),
            (Kind::Plateau, 1, false, (16, -8)),
            (Kind::Volcano, 0, false, (16, -8)),
            (Kind::Volcano, 1, false, (8, 0)),
        ] {
            assert_eq!(lobe(kind, index, home, 200).mass, mass, "{kind:?} {index}, home: {home}");
        }
    }

    #[test]
    fn a_lobe_touches_squares_within_its_reach_and_the_warp() {
        let centre = (5_000, -9_000);
        let none = (0, 0);
        let lobe = Lobe {
            centre,
            reach_m: 300,
            long: none,
            short: none,
            mass: none,
            height: 0,
            plateau: 0,
            crater: false,
        };
        let (reach, side) = ((300 + WARP_M) * UNITS_PER_METRE, 100);
        for (offset, touches) in
            [(reach, true), (reach + 1, false), (-reach - side, true), (-reach - side - 1, false)]
        {
            assert_eq!(lobe.touches(centre.0 + offset, centre.1, side as u32), touches, "east {offset}");
            assert_eq!(lobe.touches(centre.0, centre.1 + offset, side as u32), touches, "south {offset}");
        }
    }

    #[test]
    fn a_cell_holds_an_island_by_the_rule_of_its_hash() {
        use Kind::{Atoll, Group, Plateau, Single, Skerries, Volcano};
        let kinds = [
            [Single, Single, Single, Single, Group, Group, Group, Skerries],
            [Skerries, Plateau, Plateau, Plateau, Volcano, Volcano, Atoll, Atoll],
        ];
        for (seed, x, z) in (0..20).flat_map(|seed| (0..49).map(move |n| (seed, n % 7 - 3, n / 7 - 3))) {
            let hash = hash2(stream_seed(seed, 0x1517), x, z);
            let (is_home, is_beside_home) = (x == 0 && z == 0, x.abs() < 2 && z.abs() < 2);
            let holds = is_home || hash % 16 < 7 && (!is_beside_home || hash % 2 == 1);
            let kind = if is_home { Single } else { kinds.as_flattened()[(hash >> 4) as usize % 16] };
            assert_eq!(Archipelago::new(seed).kind(x, z), holds.then_some((kind, hash)), "({x}, {z})");
        }
    }
}
