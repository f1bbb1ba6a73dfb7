//! Chunk selection: the finest cover of the view by resident chunks without hole or overlap, whose
//! neighbours differ by one level at most.
//!
//! The rule is that of `terrain::lod`: split what is too coarse on screen, and what would be drawn
//! beside something two levels finer. The server uses a bound of the chunk's error, before anything
//! is generated; the viewer uses the error in the header, never above that bound. The rule is
//! monotone, so the server sends every chunk that is selected here. The server knows the unscaled
//! land: what it may send is decided by [`vertical_scale::served`].

use crate::cache::{ChunkCache, vertical_scale};
use crate::lod::error;
use crate::lod::geomorph;
use crate::lod::geomorph::{Drawn, Fading};
use rustc_hash::FxHashSet;
use terrain::ChunkKey;
use terrain::lod::{self, Splits, Viewer};

/// Selected chunks of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Chunks to draw, none an ancestor of another.
    pub drawn: Vec<Drawn>,
    /// Chunks drawn coarser than wanted because children are missing, and the missing chunks of the
    /// coarsest level.
    pub missing: usize,
}

impl Selection {
    /// Whether the view is covered with the detail that it asks for. True also for an eye above the
    /// view distance, which needs no chunk.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.missing == 0
    }
}

/// Selects the chunks of one frame and marks them as used.
pub fn select(cache: &mut ChunkCache, viewer: &Viewer) -> Selection {
    select_at(cache, viewer, Fading::default())
}

/// [`select`] with a fade-in of finer chunks.
pub fn select_at(cache: &mut ChunkCache, viewer: &Viewer, fading: Fading) -> Selection {
    let served = vertical_scale::served(viewer, cache.vertical_scale());
    let missing_tops = served.tops().into_iter().filter(|key| cache.get(*key).is_none()).count();
    let shown_m = cache.begin_frame(viewer, missing_tops == 0);
    let distance_m = shown_m.unwrap_or(viewer.distance_m);
    let (viewer, served) = (Viewer { distance_m, ..*viewer }, Viewer { distance_m, ..served });
    let is_visible = |key: &ChunkKey| cache.get(*key).is_some() && served.sees(*key);

    let tops: Vec<ChunkKey> = served.tops().into_iter().filter(is_visible).collect();
    let wanted = wanted_splits(cache, &viewer, &served, &tops);
    let split = possible_splits(cache, &served, &wanted);
    let below = split.iter().filter_map(|key| key.children()).flatten();
    let nodes: Vec<ChunkKey> = tops.into_iter().chain(below.filter(is_visible)).collect();
    cache.note_splits(&split, fading.now);

    let leaves: Vec<ChunkKey> = nodes.iter().copied().filter(|key| !split.contains(key)).collect();
    let nodes_set: FxHashSet<ChunkKey> = nodes.iter().copied().collect();
    let missing =
        wanted.coarse_first().filter(|(key, _)| nodes_set.contains(key) && !split.contains(key)).count();
    let drawn = if shown_m.is_some() {
        geomorph::stitch(cache, &viewer, &leaves, &split, fading)
    } else {
        Vec::new()
    };
    nodes.into_iter().for_each(|key| cache.touch(key));
    Selection { drawn, missing: missing + missing_tops }
}

/// Chunks to split, whether their children are resident or not.
fn wanted_splits(cache: &ChunkCache, viewer: &Viewer, served: &Viewer, tops: &[ChunkKey]) -> Splits {
    let mut wanted = Splits::default();
    let mut open = tops.to_vec();
    while let Some(key) = open.pop() {
        let Some(chunk) = cache.get(key) else { continue };
        if error::is_too_coarse(cache, viewer, served, key, chunk) {
            wanted.insert(key, 0);
            open.extend(key.children().into_iter().flatten().filter(|child| served.sees(*child)));
        }
    }
    lod::balance(&mut wanted, served);
    wanted
}

/// The wanted splits that are possible: all visible children are resident, and so are all chunks
/// that the balance requires. Decided from the coarsest level down, because a split depends on
/// coarser ones only.
fn possible_splits(cache: &ChunkCache, served: &Viewer, wanted: &Splits) -> FxHashSet<ChunkKey> {
    let mut split = FxHashSet::default();
    for (key, _) in wanted.coarse_first() {
        let has_children = key.children().is_some_and(|children| {
            children.iter().all(|child| cache.get(*child).is_some() || !served.sees(*child))
        });
        if cache.get(key).is_some()
            && has_children
            && lod::required(key, served).all(|above| split.contains(&above))
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
    use protocol::Delivery;
    use protocol::chunk_codec::quantised;
    use std::collections::HashSet;
    use std::sync::LazyLock;
    use std::time::Duration;
    use terrain::{Chunk, Land};

    const VIEWER: Viewer =
        Viewer { eye: (30_000, 20_000, -50_000), distance_m: 2000, pixels_per_radian: 300, tolerance_q4: 64 };

    /// Everything that a server sends for the test's view, generated once.
    static SENT: LazyLock<Vec<Chunk>> = LazyLock::new(|| {
        let land = Land::new(1);
        lod::select(&land, &VIEWER, usize::MAX).into_iter().map(|needed| land.chunk(needed.key)).collect()
    });

    fn world_of<'a>(chunks: impl IntoIterator<Item = &'a Chunk>) -> ChunkCache {
        let mut cache = ChunkCache::new(10_000);
        for chunk in chunks {
            cache.insert(chunk.clone());
        }
        cache
    }

    fn keys(selection: &Selection) -> Vec<ChunkKey> {
        selection.drawn.iter().map(|drawn| drawn.key).collect()
    }

    /// How many drawn chunks cover a place.
    fn cover(drawn: &HashSet<ChunkKey>, x: i32, z: i32) -> usize {
        (0..=16).filter(|level| drawn.contains(&ChunkKey::containing(*level, x, z))).count()
    }

    /// The chunks of [`SENT`] rounded to half a metre, for an eye near the ground.
    #[test]
    fn a_view_of_quantised_chunks_is_complete() {
        let viewer = Viewer { eye: (30_000, 3_000, -50_000), tolerance_q4: 24, ..VIEWER };
        let land = Land::new(1);
        let delivery: Delivery = "quantised:0.5".parse().unwrap();
        let Delivery::Quantised(tolerance) = delivery else { panic!() };
        let needed = lod::select(&land, &viewer, usize::MAX);
        let sent: Vec<_> = needed
            .into_iter()
            .map(|needed| quantised::quantise(&land.chunk(needed.key), tolerance).unwrap())
            .collect();
        let select_by = |error: &dyn Fn(u32) -> u32| {
            let chunks: Vec<_> =
                sent.iter().map(|chunk| Chunk { error: error(chunk.error), ..chunk.clone() }).collect();
            select(&mut world_of(&chunks), &viewer)
        };
        assert!(select_by(&|stated| error::without_rounding(stated, delivery)).is_complete());
        // The control: by what the frames state, chunks are missing that no server sends.
        assert!(!select_by(&|stated| stated).is_complete());
    }

    #[test]
    fn the_server_sends_every_wanted_chunk() {
        let mut cache = world_of(SENT.iter());
        let selection = select(&mut cache, &VIEWER);
        assert!(selection.is_complete());
        for key in keys(&selection) {
            let chunk = cache.get(key).unwrap();
            let error = error::on_screen(&cache, &VIEWER, key, chunk);
            assert!(error <= f64::from(VIEWER.tolerance_q4), "{key} at {error}/16 px");
        }
    }

    #[test]
    fn a_chunk_that_overstates_its_error_is_drawn_while_its_children_are_not_sent() {
        let honest = select(&mut world_of(SENT.iter()), &VIEWER);
        // The open sea has no error, and no server splits it for one.
        let overstated = SENT
            .iter()
            .map(|chunk| Chunk { error: if chunk.error > 0 { u32::MAX } else { 0 }, ..chunk.clone() });
        let mut cache = world_of(&overstated.collect::<Vec<_>>());
        let selection = select(&mut cache, &VIEWER);
        assert!(selection.drawn.len() >= honest.drawn.len());
        let drawn: HashSet<_> = keys(&selection).into_iter().collect();
        for key in keys(&honest) {
            let (x, z) = key.origin();
            assert_eq!(cover(&drawn, x, z), 1, "{key}");
        }
        let unsent = |key: &ChunkKey| {
            key.children().is_some_and(|all| all.iter().any(|child| cache.get(*child).is_none()))
        };
        assert!(drawn.iter().any(|key| cache.get(*key).is_some_and(|chunk| chunk.error > 0) && unsent(key)));
    }

    #[test]
    fn land_is_drawn_from_the_first_covered_view_on() {
        let mut cache = ChunkCache::new(10_000);
        let top = VIEWER.top_level();
        let (tops, finer): (Vec<_>, Vec<_>) = SENT.iter().partition(|chunk| chunk.key.level() == top);
        let (last, first) = tops.split_last().unwrap();
        for chunk in first.iter().chain(&finer) {
            let selection = select(&mut cache, &VIEWER);
            assert!(selection.drawn.is_empty() && !selection.is_complete());
            cache.insert((*chunk).clone());
        }
        cache.insert((*last).clone());
        assert!(!select(&mut cache, &VIEWER).drawn.is_empty());
        let moved = Viewer { eye: (200_000, 20_000, -50_000), ..VIEWER };
        assert!(
            !select(&mut cache, &moved).drawn.is_empty(),
            "new land at the far end is missing, the rest stays"
        );
    }

    #[test]
    fn land_stays_while_a_view_with_another_coarsest_level_has_not_come() {
        let farther = Viewer { distance_m: 9000, ..VIEWER };
        assert!(farther.top_level() > VIEWER.top_level());
        let mut cache = world_of(SENT.iter());
        let before = select(&mut cache, &VIEWER);
        let waiting = select(&mut cache, &farther);
        assert_eq!((&waiting.drawn, waiting.missing), (&before.drawn, farther.tops().len()));
        for key in farther.tops() {
            cache.insert(Land::new(1).chunk(key));
        }
        let covered = keys(&select(&mut cache, &farther));
        assert!(covered.iter().any(|key| key.level() == farther.top_level()), "{covered:?}");
        // The control: a new session has nothing to draw.
        assert!(select(&mut world_of(SENT.iter()), &farther).drawn.is_empty());
    }

    #[test]
    fn a_view_of_stretched_land_is_complete_with_what_the_server_sends_for_it() {
        let land = Land::new(1);
        let missing = |viewer: &Viewer, sent_for: &Viewer, scale: i32| {
            let mut cache = ChunkCache::new(10_000);
            cache.set_vertical_scale(scale);
            for needed in lod::select(&land, sent_for, usize::MAX) {
                cache.insert(land.chunk(needed.key));
            }
            select(&mut cache, viewer).missing
        };
        let low = Viewer { eye: (30_000, 3_000, -50_000), tolerance_q4: 24, ..VIEWER };
        for (viewer, scale) in
            [VIEWER, low].into_iter().flat_map(|viewer| [64, 461, 1024].map(|s| (viewer, s)))
        {
            assert_eq!(missing(&viewer, &vertical_scale::served(&viewer, scale), scale), 0, "{scale}");
        }
        // The control: chunks for the same view of the land as it is.
        assert!(missing(&low, &low, 1024) > 0);
    }

    #[test]
    fn children_fade_in_from_their_parent() {
        let lasts = Duration::from_millis(200);
        let at = |cache: &mut ChunkCache, millis| {
            select_at(cache, &VIEWER, Fading { now: Duration::from_millis(millis), lasts })
        };
        let mut cache = world_of(SENT.iter().filter(|chunk| chunk.key.level() == VIEWER.top_level()));
        let coarse = at(&mut cache, 0);
        for chunk in SENT.iter() {
            cache.insert(chunk.clone());
        }
        let begun = at(&mut cache, 1000);
        let insides = |selection: &Selection| {
            selection.drawn.iter().map(|drawn| drawn.seams.inside).collect::<Vec<_>>()
        };
        let top = VIEWER.top_level();
        assert!(coarse.drawn.len() < begun.drawn.len());
        assert!(begun.drawn.iter().all(|drawn| drawn.key.level() == top || drawn.seams.inside == 64));
        let half: u32 = insides(&at(&mut cache, 1100)).into_iter().map(u32::from).sum();
        let whole: u32 = insides(&begun).into_iter().map(u32::from).sum();
        let ended = at(&mut cache, 1200);
        assert_eq!(ended, select(&mut world_of(SENT.iter()), &VIEWER));
        let end: u32 = insides(&ended).into_iter().map(u32::from).sum();
        assert!(end < half && half < whole, "{end} {half} {whole}");
        assert_eq!(at(&mut cache, 5000), ended, "what is split stays grown");
    }

    #[test]
    fn a_missing_child_keeps_its_parent_drawn() {
        let drawn = keys(&select(&mut world_of(SENT.iter()), &VIEWER));
        let gap = drawn.into_iter().find(|key| key.level() == 1).unwrap();
        let parent = gap.parent().unwrap();
        let below_gap = |key: ChunkKey| {
            std::iter::successors(Some(key), |above| above.parent()).any(|above| above == gap)
        };
        let mut cache = world_of(SENT.iter().filter(|chunk| !below_gap(chunk.key)));
        let selection = select(&mut cache, &VIEWER);
        assert!(keys(&selection).contains(&parent) && selection.missing >= 1);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn whatever_is_missing_every_place_is_covered_once_and_neighbours_differ_by_one_level(
            lost in proptest::collection::vec(any::<proptest::sample::Index>(), 0..200),
            places in proptest::collection::vec((-500_000i32..500_000, -500_000i32..500_000), 50),
        ) {
            let top = VIEWER.top_level();
            let lost = lost.iter().map(|index| index.get(&SENT).key);
            let lost: HashSet<ChunkKey> = lost.filter(|key| key.level() != top).collect();
            let mut cache = world_of(SENT.iter().filter(|chunk| !lost.contains(&chunk.key)));
            let drawn: HashSet<ChunkKey> = keys(&select(&mut cache, &VIEWER)).into_iter().collect();
            for (x, z) in places {
                let (dx, dz) = (i64::from(x) - 30_000, i64::from(z) + 50_000);
                let in_view = (dx * dx + dz * dz).isqrt() < 2000 * 256;
                let covered = cover(&drawn, x, z);
                prop_assert!(covered <= 1 && (!in_view || covered == 1), "({x}, {z}) is covered \
                    {covered} times");
            }
            for key in &drawn {
                let around = (-1..=1)
                    .flat_map(|east| (-1..=1).filter_map(move |south| key.neighbour(east, south)));
                for next in around.filter(|next| VIEWER.sees(*next)) {
                    let mut above = std::iter::successors(Some(next), |key| key.parent());
                    let over = above.find(|key| drawn.contains(key));
                    prop_assert!(over.is_none_or(|over| over.level() <= key.level() + 1), "{key} \
                        beside {over:?}");
                }
            }
        }
    }
}
