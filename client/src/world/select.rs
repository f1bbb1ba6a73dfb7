//! Which resident chunks to draw: the finest cover of the view that has no hole and no overlap.
//!
//! The rule is that of `terrain::lod`: refine while the error seen on screen exceeds the tolerance. The server refines by the
//! level's bound, before anything is generated; this refines by the chunk's own error but never beyond that bound, so whatever
//! it wants, the server sends.

use crate::world::World;
use terrain::ChunkKey;
use terrain::constants::UNITS_PER_METRE;
use terrain::key::ROOT;
use terrain::lod::{self, Viewer};

/// What to draw now.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// Chunks to draw, none above or below another.
    pub drawn: Vec<ChunkKey>,
    /// Chunks drawn coarser than wanted because their children have not all arrived.
    pub wanting: usize,
    /// Largest error among the drawn chunks, units: how far two neighbours may gape at most is twice this.
    pub worst_error: u32,
}

impl Selection {
    /// Whether all that is here is drawn with the detail that the view asks for. Says nothing about what has not arrived at
    /// all: an eye above the view distance needs no chunk, a new session has none.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.wanting == 0
    }
}

/// Chooses for one frame, and marks in the world what is in use.
pub fn select(world: &mut World, viewer: &Viewer) -> Selection {
    world.begin_frame();
    let mut selection = Selection::default();
    let mut open = vec![ROOT];
    while let Some(key) = open.pop() {
        let distance = viewer.distance_to(key);
        if !is_in_view(viewer, distance) {
            continue;
        }
        let Some(error) = world.get(key).map(|chunk| chunk.error) else {
            // Nothing to draw here; below there may be something.
            if world.has_below(key) {
                open.extend(key.children().into_iter().flatten());
            }
            continue;
        };
        // The level's bound is empirical. A chunk whose own error exceeds it would want children that no server sends, and the
        // view would never be complete.
        let judged = error.min(lod::level_error(key.level()));
        let too_coarse = viewer.screen_error_q4(judged, distance) > viewer.tolerance_q4.max(1);
        let children = key.children().filter(|_| too_coarse);
        let refined = children.filter(|children| {
            children
                .iter()
                .all(|child| world.get(*child).is_some() || !is_in_view(viewer, viewer.distance_to(*child)))
        });
        world.touch(key);
        if let Some(children) = refined {
            open.extend(children);
        } else {
            selection.wanting += usize::from(children.is_some());
            selection.worst_error = selection.worst_error.max(error);
            selection.drawn.push(key);
        }
    }
    selection
}

fn is_in_view(viewer: &Viewer, distance: u64) -> bool {
    distance <= u64::from(viewer.distance_m) * UNITS_PER_METRE as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashSet;
    use std::sync::LazyLock;
    use terrain::{Chunk, Land};

    const VIEWER: Viewer =
        Viewer { eye: (30_000, 20_000, -50_000), distance_m: 2000, pixels_per_radian: 300, tolerance_q4: 64 };

    /// Everything that a server sends for the test's view, generated once.
    static SENT: LazyLock<Vec<Chunk>> = LazyLock::new(|| {
        let land = Land::new(1);
        lod::select(&land, &VIEWER, usize::MAX).into_iter().map(|needed| land.chunk(needed.key)).collect()
    });

    fn world_of<'a>(chunks: impl IntoIterator<Item = &'a Chunk>) -> World {
        let mut world = World::new(10_000);
        for chunk in chunks {
            world.insert(chunk.clone());
        }
        world
    }

    /// How many drawn chunks cover a place.
    fn cover(drawn: &HashSet<ChunkKey>, x: i32, z: i32) -> usize {
        (0..=16).filter(|level| drawn.contains(&ChunkKey::containing(*level, x, z))).count()
    }

    #[test]
    fn what_the_server_sends_is_enough_for_everything_that_is_wanted() {
        let mut world = world_of(SENT.iter());
        let selection = select(&mut world, &VIEWER);
        assert!(selection.is_complete());
        for key in &selection.drawn {
            let chunk = world.get(*key).unwrap();
            let error = VIEWER.screen_error_q4(chunk.error, VIEWER.distance_to(*key));
            assert!(error <= VIEWER.tolerance_q4, "{key} at {error}/16 px");
        }
    }

    #[test]
    fn a_chunk_worse_than_its_levels_bound_wants_nothing_that_is_not_sent() {
        let excessive = |error: fn(&Chunk) -> u32| {
            let chunks = SENT.iter().map(|chunk| Chunk { error: error(chunk), ..chunk.clone() });
            let mut world = world_of(&chunks.collect::<Vec<_>>());
            select(&mut world, &VIEWER)
        };
        let at_the_bound = excessive(|chunk| lod::level_error(chunk.key.level()));
        let beyond = excessive(|_| u32::MAX);
        assert!(beyond.is_complete() && beyond.drawn == at_the_bound.drawn);
        assert_eq!(beyond.worst_error, u32::MAX, "the skirts still bridge what is really there");
    }

    #[test]
    fn an_empty_world_draws_nothing() {
        assert!(select(&mut World::new(4), &VIEWER).drawn.is_empty());
    }

    #[test]
    fn a_missing_child_keeps_its_parent_in_the_picture() {
        let drawn = select(&mut world_of(SENT.iter()), &VIEWER).drawn;
        let gap = drawn.into_iter().find(|key| key.level() == 1).unwrap();
        let parent = gap.parent().unwrap();
        let below_gap = |key: ChunkKey| {
            std::iter::successors(Some(key), |above| above.parent()).any(|above| above == gap)
        };
        let mut world = world_of(SENT.iter().filter(|chunk| !below_gap(chunk.key)));
        let selection = select(&mut world, &VIEWER);
        assert!(selection.drawn.contains(&parent) && selection.wanting >= 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn wherever_a_root_is_resident_every_place_is_covered_exactly_once(
            lost in proptest::collection::vec(any::<proptest::sample::Index>(), 0..200),
            places in proptest::collection::vec((-500_000i32..500_000, -500_000i32..500_000), 50),
        ) {
            let top = SENT[0].key.level();
            let lost: HashSet<ChunkKey> = lost.iter().map(|index| index.get(&SENT).key).filter(|key| key.level() != top).collect();
            let mut world = world_of(SENT.iter().filter(|chunk| !lost.contains(&chunk.key)));
            let drawn: HashSet<ChunkKey> = select(&mut world, &VIEWER).drawn.into_iter().collect();
            for (x, z) in places {
                let (dx, dz) = (i64::from(x) - 30_000, i64::from(z) + 50_000);
                let in_view = (dx * dx + dz * dz).isqrt() < 2000 * 256;
                let covered = cover(&drawn, x, z);
                prop_assert!(covered <= 1 && (!in_view || covered == 1), "({x}, {z}) is covered {covered} times");
            }
        }
    }
}
