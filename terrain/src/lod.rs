//! Level of detail by screen error: which chunks a viewer needs.
//!
//! A chunk whose drawn surface is at most `e` away from the truth looks wrong by at most
//! `e * K / D` pixels from distance `D`, with `K = height / (2 tan(fov / 2))` pixels (Ulrich,
//! "Rendering Massive Terrains using Chunked Level of Detail Control", SIGGRAPH 2002). A chunk is
//! refined while that exceeds the tolerance.

pub mod errors;
mod sampled;
mod selector;

pub use errors::{MEASURED_LEVEL, Progress, SAMPLED_LEVEL};
pub use selector::Selector;

use crate::constants::{CHUNK_BITS, TOP_LEVEL, UNITS_PER_METRE, WORLD_HALF};
use crate::key::ChunkKey;
use crate::land::Land;

/// Upper bound of the land's height, units; lets a high eye count its height as distance.
///
/// Proof, in metres, with noise of at most 0.7056 (`lattice::tests`): mountains are at most
/// `704 (5/32 + 13/32 + 11/8 relief)` with a relief of at most `0.7056 + 3/16 + 3/32 + 3/64`,
/// together 1,396.7; the lowland at most 8 and 1/32 of a shore of at most 328 (54 of mass and
/// `0.7056 (64 + 64 + 5/4 (80 + 128))` of octaves), together 18.3; the fine octaves `0.7056 31`,
/// 21.9; a cliff 34. Their sum is 1,470.9; the rest is more than roundings add.
pub const SUMMIT: i32 = 1_472 * UNITS_PER_METRE;

/// Lower bound of the land's height, units: the sea floor and the fine octaves.
pub const LOWEST: i32 = -86 * UNITS_PER_METRE;

/// Range of all heights, units.
pub(crate) const RELIEF: u32 = (SUMMIT - LOWEST).unsigned_abs();

/// Largest view distance that a selection serves, metres.
pub const MAX_VIEW_DISTANCE_M: u32 = 65_536;

/// Usual vertical error of a level against level 0 on rough land, units: what an estimate of a view
/// counts with before any chunk is measured.
///
/// Levels 1 to 6: nine chunks of land in ten have less (`cargo run --release -p tombolo-terrain
/// --example level_error`). Above, the whole range of heights.
const LEVEL_ERROR: [u32; TOP_LEVEL as usize + 1] = {
    let mut errors = [RELIEF; TOP_LEVEL as usize + 1];
    let usual_m = [0, 4, 7, 12, 22, 40, 80];
    let mut level = 0;
    while level < usual_m.len() {
        errors[level] = usual_m[level] * UNITS_PER_METRE as u32;
        level += 1;
    }
    errors
};

/// Usual vertical error of a level against level 0, units; `level` up to 16. No bound: see
/// [`errors`].
#[must_use]
pub const fn level_error(level: u8) -> u32 {
    LEVEL_ERROR[level as usize]
}

/// The viewer of a selection. Integers, so that two machines choose the same chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Viewer {
    /// Eye, units: east, up, south.
    pub eye: (i32, i32, i32),
    /// Chunks farther than this are not needed, metres: the distance to a box up to [`SUMMIT`]. At
    /// most [`MAX_VIEW_DISTANCE_M`].
    pub distance_m: u32,
    /// `K` in pixels: viewport height / (2 tan(vertical field of view / 2)).
    pub pixels_per_radian: u32,
    /// Tolerated screen error in 1/16 pixel; 0 is treated as 1.
    pub tolerance_q4: u32,
}

/// One needed chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needed {
    /// The chunk.
    pub key: ChunkKey,
    /// Distance from the eye, units.
    pub distance: u64,
    /// The largest screen error that remains while the parent of this chunk is drawn, 1/16 pixel,
    /// saturating. With the errors of finer splits that require this chunk ([`balance`]).
    pub gain_q4: u32,
}

/// The chunks a viewer needs, parents before children.
///
/// A chunk that is too coarse for the viewer is split into its four children. So is every chunk
/// that would otherwise be drawn beside one two levels finer ([`balance`]): level borders can then
/// be stitched without cracks. Contains every ancestor of a needed chunk up to
/// [`Viewer::top_level`], so that something coarse can be drawn until the fine chunks arrive.
/// Returns at most `limit` chunks: levels are added from coarse to fine. Of a level that does not
/// fit as a whole, the children of its most urgent splits are added.
#[must_use]
pub fn select(land: &Land, viewer: &Viewer, limit: usize) -> Vec<Needed> {
    Selector::new(land, viewer, limit).finish()
}

/// Estimate of the chunks that a viewer needs over land without open sea, eye at the ground: the
/// number of chunks of each level within the distance at which its parent is split. Saturating.
///
/// It reads no land and costs nanoseconds, so a server can reject a view before it selects a
/// chunk.
#[must_use]
pub fn estimated_chunks(viewer: &Viewer) -> u64 {
    let reach = viewer.reach();
    let at_level = |level: u8| {
        let scaled = u64::from(level_error(level + 1)) * u64::from(viewer.pixels_per_radian) * 16;
        // Chunks are counted within a square: a split chunk has all four children.
        let side = 2 * (scaled / u64::from(viewer.tolerance())).min(reach)
            / (1 << (CHUNK_BITS + u32::from(level)))
            + 2;
        side.saturating_mul(side)
    };
    (0..viewer.top_level()).map(at_level).fold(viewer.tops().len() as u64, u64::saturating_add)
}

/// Chunks to be drawn by their children, each with the urgency of the most urgent chunk that needs
/// it to be, 1/16 pixel.
#[derive(Clone, Debug, Default)]
pub struct Splits {
    /// By level; sorted and without repetition once balanced.
    levels: [Vec<(ChunkKey, u32)>; TOP_LEVEL as usize + 1],
}

impl Splits {
    /// Adds a chunk.
    pub fn insert(&mut self, key: ChunkKey, urgency: u32) {
        self.levels[usize::from(key.level())].push((key, urgency));
    }

    /// Coarse levels first, keys in order within a level; each once if the set is balanced.
    pub fn coarse_first(&self) -> impl Iterator<Item = (ChunkKey, u32)> + '_ {
        self.levels.iter().rev().flatten().copied()
    }
}

/// Adds the further splits that a balanced quadtree needs: every chunk above a split one, and every
/// chunk that would share an edge or a corner with one that is two levels finer.
///
/// The result is the smallest such set, hence monotone: more initial splits never give fewer final
/// ones.
pub fn balance(splits: &mut Splits, viewer: &Viewer) {
    for level in 0..=viewer.top_level() {
        splits.sort(level);
        let fine = std::mem::take(&mut splits.levels[usize::from(level)]);
        for (key, urgency) in &fine {
            for above in required(*key, viewer) {
                splits.insert(above, *urgency);
            }
        }
        splits.levels[usize::from(level)] = fine;
    }
}

/// The splits that a split of `key` requires: its parent, and the parents of its visible neighbours
/// outside that parent. The chunk's children touch all its neighbours, so each neighbour must be
/// drawn at its own level or finer.
pub fn required(key: ChunkKey, viewer: &Viewer) -> impl Iterator<Item = ChunkKey> + '_ {
    let (east, south) = key.quarter();
    // Towards the outside of the parent: the neighbours on the other sides are its siblings.
    let (east, south) = (2 * east - 1, 2 * south - 1);
    let is_below_the_top = key.level() < viewer.top_level();
    [(0, 0), (east, 0), (0, south), (east, south)]
        .into_iter()
        .filter(move |_| is_below_the_top)
        .filter_map(move |(east, south)| key.neighbour(east, south))
        .filter(move |neighbour| *neighbour == key || viewer.sees(*neighbour))
        .filter_map(ChunkKey::parent)
}

/// Bound of the error of a chunk before it is generated, units ([`errors`]).
#[must_use]
pub fn error_bound(land: &Land, key: ChunkKey) -> u32 {
    land.error_of(key)
}

impl Viewer {
    /// Distance from the eye to the box of a chunk: the square of the chunk, from below the sea up
    /// to [`SUMMIT`]. Units.
    #[must_use]
    pub fn distance_to(&self, key: ChunkKey) -> u64 {
        self.distance_to_box(key, i32::MIN, SUMMIT)
    }

    /// The same for a chunk whose heights lie between two bounds. Not less than
    /// [`Viewer::distance_to`] if the bounds are within its own. Units.
    #[must_use]
    pub fn distance_to_box(&self, key: ChunkKey, lowest: i32, highest: i32) -> u64 {
        self.distance_to_block(key.origin(), key.side(), lowest, highest)
    }

    /// Distance to the box over any square: low corner and side in units, between two heights.
    /// Units.
    #[must_use]
    pub fn distance_to_block(&self, (x, z): (i32, i32), side: u32, lowest: i32, highest: i32) -> u64 {
        let gap = |eye: i32, low: i32| {
            let (eye, low) = (i64::from(eye), i64::from(low));
            (low - eye).max(eye - low - i64::from(side)).max(0).unsigned_abs()
        };
        let up = i64::from(self.eye.1);
        let dy = (up - i64::from(highest)).max(i64::from(lowest) - up).max(0).unsigned_abs();
        let (dx, dz) = (gap(self.eye.0, x), gap(self.eye.2, z));
        root(dx * dx + dz * dz + dy * dy)
    }

    /// Screen error of a vertical error at a distance (both units), 1/16 pixel, saturating. Rounded
    /// up: what is within a tolerance in these steps is within it.
    #[must_use]
    pub fn screen_error_q4(&self, error: u32, distance: u64) -> u32 {
        let scaled = u64::from(error) * u64::from(self.pixels_per_radian) * 16;
        u32::try_from(scaled.div_ceil(distance.max(1))).unwrap_or(u32::MAX)
    }

    /// Tolerated screen error, 1/16 pixel, at least 1.
    #[must_use]
    pub fn tolerance(&self) -> u32 {
        self.tolerance_q4.max(1)
    }

    /// Whether any of a chunk is within the view distance.
    #[must_use]
    pub fn sees(&self, key: ChunkKey) -> bool {
        self.distance_to(key) <= self.reach()
    }

    /// The coarsest drawn level: the largest one whose chunk side is at most the view distance. 0
    /// if even a chunk of level 0 is wider.
    #[must_use]
    pub fn top_level(&self) -> u8 {
        let chunks = self.reach() >> CHUNK_BITS;
        (chunks.max(1).ilog2() as u8).min(TOP_LEVEL)
    }

    /// The visible chunks of the coarsest level, at most 25.
    #[must_use]
    pub fn tops(&self) -> Vec<ChunkKey> {
        let level = self.top_level();
        let reach = self.reach() as i64;
        let clamped = |value: i64| value.clamp(-i64::from(WORLD_HALF), i64::from(WORLD_HALF)) as i32;
        let at = |way: i64| {
            let (x, z) = (i64::from(self.eye.0) + way, i64::from(self.eye.2) + way);
            ChunkKey::containing(level, clamped(x), clamped(z))
        };
        let (low, high) = (at(-reach), at(reach));
        let rows = low.z()..=high.z();
        rows.flat_map(|z| (low.x()..=high.x()).map(move |x| (x, z)))
            .filter_map(|(x, z)| ChunkKey::new(level, x, z).ok())
            .filter(|key| self.sees(*key))
            .collect()
    }

    /// View distance, units.
    fn reach(&self) -> u64 {
        u64::from(self.distance_m) * UNITS_PER_METRE as u64
    }
}

/// The integer part of the square root, as [`u64::isqrt`] and several times as fast: the machine's
/// root is correctly rounded (IEEE 754) and so at most one off.
fn root(square: u64) -> u64 {
    let near = (square as f64).sqrt() as u64;
    let fits = |root: u64| u128::from(root) * u128::from(root) <= u128::from(square);
    if !fits(near) {
        near - 1
    } else if fits(near + 1) {
        near + 1
    } else {
        near
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::WORLD_HALF;
    use std::cmp::Reverse;
    use std::collections::{BTreeMap, HashSet};

    #[test]
    fn the_root_is_that_of_integers() {
        let squares = (0..64).flat_map(|bits| {
            let root = (1u64 << (bits / 2)) + crate::hash::mix(bits as u32) as u64 % (1 << (bits / 2));
            [root * root - 1, root * root, root * root + 1, 1 << bits, (1 << bits) - 1, u64::MAX >> bits]
        });
        for square in squares {
            assert_eq!(root(square), square.isqrt(), "{square}");
        }
    }

    fn viewer() -> Viewer {
        Viewer { eye: (0, 100 * 256, 0), distance_m: 8000, pixels_per_radian: 312, tolerance_q4: 24 }
    }

    #[test]
    fn a_selection_is_closed_under_parents_and_covers_the_view() {
        let land = Land::new(1);
        let selected = select(&land, &viewer(), usize::MAX);
        let keys: HashSet<_> = selected.iter().map(|needed| needed.key).collect();
        assert_eq!(keys.len(), selected.len(), "no chunk twice");
        let top = selected[0].key.level();
        for key in &keys {
            assert!(key.level() == top || keys.contains(&key.parent().unwrap()), "{key} without its parent");
        }
        for (x, z) in [(0, 0), (7_900, 0), (-5_000, 5_000), (3, -7_990)] {
            let covers = |level| keys.contains(&ChunkKey::containing(level, x * 256, z * 256));
            assert!(covers(top), "({x}, {z}) is not covered");
        }
        assert!(keys.contains(&ChunkKey::new(0, 0, 0).unwrap()), "full detail under the eye");
        assert!((60..2000).contains(&keys.len()), "{} chunks", keys.len());
    }

    #[test]
    fn every_chunk_that_stays_a_leaf_is_within_the_tolerance() {
        let land = Land::new(1);
        let selected = select(&land, &viewer(), usize::MAX);
        let keys: HashSet<_> = selected.iter().map(|needed| needed.key).collect();
        for needed in &selected {
            let refined =
                needed.key.children().is_some_and(|children| children.iter().any(|c| keys.contains(c)));
            let error = viewer().screen_error_q4(error_bound(&land, needed.key), needed.distance);
            assert!(refined || error <= 24 || needed.key.level() == 0, "{} at {error}/16 px", needed.key);
        }
    }

    #[test]
    fn adjacent_chunks_differ_by_at_most_one_level() {
        let land = Land::new(1);
        let mut broken = 0;
        for (eye, tolerance_q4) in
            [((0, 25_600, 0), 24), ((1_300_000, 2_000, -77), 4), ((-900_000, 1, 90_000), 64)]
        {
            let viewer = Viewer { eye, tolerance_q4, ..viewer() };
            let keys: HashSet<_> =
                select(&land, &viewer, usize::MAX).iter().map(|needed| needed.key).collect();
            assert_eq!(unbalanced(&keys, &viewer), None);
            // Without the chunks that only balance adds, some border spans two levels.
            let by_error: HashSet<_> = keys
                .iter()
                .copied()
                .filter(|key| {
                    key.parent().is_none_or(|parent| {
                        parent.level() > viewer.top_level()
                            || viewer.screen_error_q4(error_bound(&land, parent), viewer.distance_to(parent))
                                > tolerance_q4
                    })
                })
                .collect();
            broken += usize::from(by_error.len() < keys.len() && unbalanced(&by_error, &viewer).is_some());
        }
        assert!(broken > 0, "balance added no chunk");
    }

    /// A leaf that touches a leaf of more than one level above it.
    fn unbalanced(keys: &HashSet<ChunkKey>, viewer: &Viewer) -> Option<(ChunkKey, ChunkKey)> {
        let is_split = |key: &ChunkKey| {
            key.children().is_some_and(|children| children.iter().any(|child| keys.contains(child)))
        };
        let leaves: HashSet<_> = keys.iter().copied().filter(|key| !is_split(key)).collect();
        let around = (-1..=1).flat_map(|east| (-1..=1).map(move |south| (east, south)));
        leaves.iter().flat_map(|leaf| around.clone().map(move |way| (*leaf, way))).find_map(
            |(leaf, (east, south))| {
                let next = leaf.neighbour(east, south).filter(|next| viewer.sees(*next))?;
                let over =
                    std::iter::successors(Some(next), |key| key.parent()).find(|key| leaves.contains(key))?;
                (over.level() > leaf.level() + 1).then_some((leaf, over))
            },
        )
    }

    #[test]
    fn the_distance_to_a_block_is_that_to_its_nearest_point() {
        for (eye, low, expected) in [
            ((0, 0, 0), (300, 400), 500),
            ((0, 0, 0), (-310, -410), 500),
            ((0, 1207, 0), (300, 400), 1300),
            ((0, -1205, 0), (-310, -410), 1300),
            ((305, 2, 405), (300, 400), 0),
            ((305, 19, 405), (300, 400), 12),
            ((305, -17, 405), (300, 400), 12),
        ] {
            let viewer = Viewer { eye, ..viewer() };
            assert_eq!(viewer.distance_to_block(low, 10, -5, 7), expected, "from {eye:?}");
        }
    }

    #[test]
    fn a_split_requires_its_parent_and_those_of_its_visible_neighbours_below_the_top() {
        let viewer = Viewer { distance_m: 300, ..viewer() };
        assert_eq!(viewer.top_level(), 1);
        let required = |level, x, z| {
            let keys = required(ChunkKey::new(level, x, z).unwrap(), &viewer);
            keys.map(|key| (key.level(), key.x(), key.z())).collect::<Vec<_>>()
        };
        assert_eq!(required(0, 1, 0), [(1, 0, 0), (1, 1, 0), (1, 0, -1), (1, 1, -1)]);
        assert_eq!(required(0, 3, 0), [(1, 1, 0)], "neighbours beyond the view distance");
        assert!(required(1, 0, 0).is_empty());
    }

    /// The closure by the rule alone, with all eight visible neighbours: those in the parent add
    /// nothing.
    #[test]
    fn balance_adds_the_smallest_closed_set_with_the_largest_urgencies() {
        let viewer = Viewer { distance_m: MAX_VIEW_DISTANCE_M, ..viewer() };
        let (mut splits, mut closed) = (Splits::default(), BTreeMap::new());
        for (level, x, z, urgency) in [(0, 3, -2, 50), (0, -9, 4, 70), (2, 2, 2, 90), (0, 3, -2, 60)] {
            let key = ChunkKey::new(level, x, z).unwrap();
            splits.insert(key, urgency);
            closed.insert(key, urgency);
        }
        balance(&mut splits, &viewer);
        loop {
            let before = closed.clone();
            for (key, urgency) in &before {
                let around = (-1..=1).flat_map(|east| (-1..=1).map(move |south| (east, south)));
                let around = around.filter_map(|(east, south)| key.neighbour(east, south));
                let visible = around.filter(|next| next == key || viewer.sees(*next));
                for above in visible.filter_map(ChunkKey::parent) {
                    if above.level() <= viewer.top_level() {
                        let most = closed.entry(above).or_insert(*urgency);
                        *most = (*most).max(*urgency);
                    }
                }
            }
            if closed == before {
                break;
            }
        }
        let mut expected: Vec<_> = closed.into_iter().collect();
        expected.sort_by_key(|(key, _)| (Reverse(key.level()), *key));
        assert!(expected.len() > 20, "{} splits", expected.len());
        assert_eq!(splits.coarse_first().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn the_tops_cover_the_view_and_are_few() {
        for distance_m in [0, 1, 127, 128, 255, 1_000, 8_000, MAX_VIEW_DISTANCE_M] {
            for eye in
                [(0, 0, 0), (WORLD_HALF, 0, -WORLD_HALF), (i32::MIN, 0, i32::MAX), (12_345, 9, -54_321)]
            {
                let viewer = Viewer { eye, distance_m, ..viewer() };
                let tops = viewer.tops();
                let level = viewer.top_level();
                assert!(tops.len() <= 25, "{} at {distance_m} m", tops.len());
                assert!(level == 0 || u64::from(tops.first().map_or(0, |key| key.side())) <= viewer.reach());
                let inside = |value: i32| value.clamp(-WORLD_HALF, WORLD_HALF);
                let below = ChunkKey::containing(level, inside(eye.0), inside(eye.2));
                assert_eq!(tops.contains(&below), viewer.sees(below), "{eye:?} at {distance_m} m");
            }
        }
    }

    #[test]
    fn a_tighter_tolerance_selects_more_within_the_limit() {
        let land = Land::new(1);
        let count = |tolerance_q4| select(&land, &Viewer { tolerance_q4, ..viewer() }, usize::MAX).len();
        assert!(count(16) > count(32) && count(32) > count(160));
        assert_eq!(select(&land, &viewer(), 10).len(), 10);
        assert!(select(&land, &viewer(), 0).is_empty());
    }

    #[test]
    fn extreme_viewers_stay_within_the_limit() {
        let land = Land::new(1);
        for eye in [
            (WORLD_HALF, 0, WORLD_HALF),
            (-WORLD_HALF, i32::MAX, -WORLD_HALF),
            (i32::MIN, i32::MIN, i32::MAX),
        ] {
            for distance_m in [0, 1, MAX_VIEW_DISTANCE_M] {
                let viewer = Viewer { eye, distance_m, pixels_per_radian: u32::MAX, tolerance_q4: 0 };
                assert!(select(&land, &viewer, 500).len() <= 500);
            }
        }
    }
}
