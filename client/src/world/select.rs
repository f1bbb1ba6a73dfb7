//! Which resident chunks to draw: the finest cover of the view that has no hole and no overlap, and
//! whose neighbours differ by one level at most.
//!
//! The rule is that of `terrain::lod`: split what is too coarse on screen, and what would be drawn
//! beside something two levels finer. The server judges by the level's bound, before anything is
//! generated; this judges by the chunk's own error but never beyond that bound, and both rules are
//! monotone, so whatever this wants, the server sends.

use crate::world::seams::{self, Drawn};
use crate::world::{World, error};
use rustc_hash::FxHashSet;
use std::time::Duration;
use terrain::ChunkKey;
use terrain::lod::{self, Splits, Viewer};

/// What to draw now.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Chunks to draw, none above or below another.
    pub drawn: Vec<Drawn>,
    /// Chunks drawn coarser than wanted because their children have not all arrived, and before
    /// anything can be drawn the coarsest chunks that are missing.
    pub wanting: usize,
}

impl Selection {
    /// Whether all that is here is drawn with the detail that the view asks for. Says nothing about
    /// what has not arrived at all: an eye above the view distance needs no chunk, a new session
    /// has none.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.wanting == 0
    }
}

/// Chooses for one frame, and marks in the world what is in use.
pub fn select(world: &mut World, viewer: &Viewer) -> Selection {
    select_at(world, viewer, Fading::default())
}

/// How fine land takes the place of coarse land that stood in for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fading {
    /// The moment, on a clock that never goes back.
    pub now: Duration,
    /// How long chunks take from their parent's surface to their own once all four are here. Zero:
    /// at once.
    pub lasts: Duration,
}

/// [`select`] with chunks that grow out of their parent instead of appearing.
pub fn select_at(world: &mut World, viewer: &Viewer, fading: Fading) -> Selection {
    let (tops, missing): (Vec<_>, Vec<_>) =
        viewer.tops().into_iter().partition(|key| world.get(*key).is_some());
    let can_be_shown = world.begin_frame(missing.is_empty());
    let wanted = wanted(world, viewer, &tops);
    let split = possible(world, viewer, &wanted);
    world.note_splits(&split, fading.now);

    let is_here = |key: &ChunkKey| world.get(*key).is_some() && viewer.sees(*key);
    let below = split.iter().filter_map(|key| key.children()).flatten();
    let nodes: Vec<ChunkKey> = tops.iter().copied().chain(below).filter(is_here).collect();
    let leaves: Vec<ChunkKey> = nodes.iter().copied().filter(|key| !split.contains(key)).collect();
    let nodes_set: FxHashSet<ChunkKey> = nodes.iter().copied().collect();
    let wanting =
        wanted.coarse_first().filter(|(key, _)| nodes_set.contains(key) && !split.contains(key)).count();
    let drawn = if can_be_shown { seams::close(world, viewer, &leaves, &split, fading) } else { Vec::new() };
    nodes.into_iter().for_each(|key| world.touch(key));
    Selection { drawn, wanting: wanting + if can_be_shown { 0 } else { missing.len() } }
}

/// What is to be split, whether its children are here or not.
fn wanted(world: &World, viewer: &Viewer, tops: &[ChunkKey]) -> Splits {
    let mut wanted = Splits::default();
    let mut open = tops.to_vec();
    while let Some(key) = open.pop() {
        let Some(chunk) = world.get(key) else { continue };
        if error::is_too_coarse(world, viewer, key, chunk) {
            wanted.insert(key, 0);
            open.extend(key.children().into_iter().flatten().filter(|child| viewer.sees(*child)));
        }
    }
    lod::balance(&mut wanted, viewer);
    wanted
}

/// What of it can be split: all seen children are here, and so is all that balance asks for.
/// Decided from the coarsest level down, because a chunk depends on coarser ones only.
fn possible(world: &World, viewer: &Viewer, wanted: &Splits) -> FxHashSet<ChunkKey> {
    let mut split = FxHashSet::default();
    for (key, _) in wanted.coarse_first() {
        let has_children = key.children().is_some_and(|children| {
            children.iter().all(|child| world.get(*child).is_some() || !viewer.sees(*child))
        });
        if world.get(key).is_some()
            && has_children
            && lod::required(key, viewer).all(|above| split.contains(&above))
        {
            split.insert(key);
        }
    }
    split
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

    fn keys(selection: &Selection) -> Vec<ChunkKey> {
        selection.drawn.iter().map(|drawn| drawn.key).collect()
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
        for key in keys(&selection) {
            let chunk = world.get(key).unwrap();
            let error = error::on_screen(&world, &VIEWER, key, chunk);
            assert!(error <= f64::from(VIEWER.tolerance_q4), "{key} at {error}/16 px");
        }
    }

    #[test]
    fn a_chunk_worse_than_its_levels_bound_wants_nothing_that_is_not_sent() {
        let excessive = |error: fn(&Chunk) -> u32| {
            let chunks = SENT.iter().map(|chunk| Chunk { error: error(chunk), ..chunk.clone() });
            let mut world = world_of(&chunks.collect::<Vec<_>>());
            let selection = select(&mut world, &VIEWER);
            (world, selection)
        };
        // The open sea has no error, and no server splits it for one.
        let (_, at_the_bound) =
            excessive(|chunk| lod::level_error(chunk.key.level()).min(chunk.error * 1000));
        let (world, beyond) = excessive(|chunk| if chunk.error > 0 { u32::MAX } else { 0 });
        assert!(beyond.is_complete() && beyond.drawn.len() >= at_the_bound.drawn.len());
        // Judged by what they say of themselves, drawn chunks would want children, and those were
        // not sent.
        let wants = |key: &ChunkKey| {
            let error = world.get(*key).unwrap().error;
            key.level() > 0 && VIEWER.screen_error_q4(error, VIEWER.distance_to(*key)) > VIEWER.tolerance()
        };
        let unsent = |key: &ChunkKey| key.children().unwrap().iter().any(|child| world.get(*child).is_none());
        assert!(keys(&beyond).iter().any(|key| wants(key) && unsent(key)));
    }

    #[test]
    fn nothing_is_drawn_before_a_view_is_covered_and_something_ever_after() {
        let mut world = World::new(10_000);
        let top = VIEWER.top_level();
        let (tops, finer): (Vec<_>, Vec<_>) = SENT.iter().partition(|chunk| chunk.key.level() == top);
        let (last, first) = tops.split_last().unwrap();
        for chunk in first.iter().chain(&finer) {
            let selection = select(&mut world, &VIEWER);
            assert!(selection.drawn.is_empty() && !selection.is_complete());
            world.insert((*chunk).clone());
        }
        world.insert((*last).clone());
        assert!(!select(&mut world, &VIEWER).drawn.is_empty());
        let moved = Viewer { eye: (200_000, 20_000, -50_000), ..VIEWER };
        assert!(
            !select(&mut world, &moved).drawn.is_empty(),
            "new land at the far end is missing, the rest stays"
        );
    }

    #[test]
    fn children_grow_out_of_their_parent_and_end_where_they_would_have_begun() {
        let lasts = Duration::from_millis(200);
        let at = |world: &mut World, millis| {
            select_at(world, &VIEWER, Fading { now: Duration::from_millis(millis), lasts })
        };
        let mut world = world_of(SENT.iter().filter(|chunk| chunk.key.level() == VIEWER.top_level()));
        let coarse = at(&mut world, 0);
        for chunk in SENT.iter() {
            world.insert(chunk.clone());
        }
        let begun = at(&mut world, 1000);
        let insides = |selection: &Selection| {
            selection.drawn.iter().map(|drawn| drawn.seams.inside).collect::<Vec<_>>()
        };
        let top = VIEWER.top_level();
        assert!(coarse.drawn.len() < begun.drawn.len());
        assert!(begun.drawn.iter().all(|drawn| drawn.key.level() == top || drawn.seams.inside == 64));
        let half: u32 = insides(&at(&mut world, 1100)).into_iter().map(u32::from).sum();
        let whole: u32 = insides(&begun).into_iter().map(u32::from).sum();
        let ended = at(&mut world, 1200);
        assert_eq!(ended, select(&mut world_of(SENT.iter()), &VIEWER));
        let end: u32 = insides(&ended).into_iter().map(u32::from).sum();
        assert!(end < half && half < whole, "{end} {half} {whole}");
        assert_eq!(at(&mut world, 5000), ended, "what is split stays grown");
    }

    #[test]
    fn a_missing_child_keeps_its_parent_in_the_picture() {
        let drawn = keys(&select(&mut world_of(SENT.iter()), &VIEWER));
        let gap = drawn.into_iter().find(|key| key.level() == 1).unwrap();
        let parent = gap.parent().unwrap();
        let below_gap = |key: ChunkKey| {
            std::iter::successors(Some(key), |above| above.parent()).any(|above| above == gap)
        };
        let mut world = world_of(SENT.iter().filter(|chunk| !below_gap(chunk.key)));
        let selection = select(&mut world, &VIEWER);
        assert!(keys(&selection).contains(&parent) && selection.wanting >= 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn whatever_is_missing_every_place_is_covered_once_and_neighbours_differ_by_one_level(
            lost in proptest::collection::vec(any::<proptest::sample::Index>(), 0..200),
            places in proptest::collection::vec((-500_000i32..500_000, -500_000i32..500_000), 50),
        ) {
            let top = VIEWER.top_level();
            let lost: HashSet<ChunkKey> = lost.iter().map(|index| index.get(&SENT).key).filter(|key| key.level() != top).collect();
            let mut world = world_of(SENT.iter().filter(|chunk| !lost.contains(&chunk.key)));
            let drawn: HashSet<ChunkKey> = keys(&select(&mut world, &VIEWER)).into_iter().collect();
            for (x, z) in places {
                let (dx, dz) = (i64::from(x) - 30_000, i64::from(z) + 50_000);
                let in_view = (dx * dx + dz * dz).isqrt() < 2000 * 256;
                let covered = cover(&drawn, x, z);
                prop_assert!(covered <= 1 && (!in_view || covered == 1), "({x}, {z}) is covered {covered} times");
            }
            for key in &drawn {
                let around = (-1..=1).flat_map(|east| (-1..=1).filter_map(move |south| key.neighbour(east, south)));
                for next in around.filter(|next| VIEWER.sees(*next)) {
                    let over = std::iter::successors(Some(next), |key| key.parent()).find(|key| drawn.contains(key));
                    prop_assert!(over.is_none_or(|over| over.level() <= key.level() + 1), "{key} beside {over:?}");
                }
            }
        }
    }
}
