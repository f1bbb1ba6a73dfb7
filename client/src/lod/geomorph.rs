//! Geomorphing: how far each drawn chunk has morphed into its parent, in its interior, along its
//! edges and at its corners.
//!
//! A chunk of level k is drawn between its own surface and its parent's, by one morph weight for
//! the interior (Ulrich, "Rendering Massive Terrains using Chunked Level of Detail Control",
//! SIGGRAPH 2002). A border is drawn by two chunks and must come out equal from both, so each edge
//! and corner has a weight of its own, computed from all chunks that touch it. Beside a coarser
//! chunk it is exactly the parent's surface, beside a finer chunk exactly the chunk's own: in both
//! cases the integers of one level. `shaders/wgsl/shared/morph.wesl` blends from the border to the
//! interior.
//!
//! A chunk that is drawn only because a sibling or a neighbour is needed is *decimated*: drawn with
//! the parent's vertices, a quarter of its own. Its neighbours treat it as a coarser chunk. It is
//! decimated only if no neighbour is split, so drawn levels still differ by at most one, and only
//! if all neighbours tolerate the parent's border.

use crate::cache::ChunkCache;
use crate::lod::error;
use rustc_hash::{FxHashMap, FxHashSet};
use shaders::twin::morph::{MORPH_ONE, Seams};
use std::time::Duration;
use terrain::ChunkKey;
use terrain::lod::Viewer;

/// Morphing begins when the parent's error on screen is this many tolerances; at one, the parent
/// replaces the chunk.
const MORPH_FROM: f64 = 1.5;

/// Edges in the order of [`Seams::edges`]: north, east, south, west.
const EDGES: [(i32, i32); 4] = [(0, -1), (1, 0), (0, 1), (-1, 0)];

/// Corners in the order of [`Seams::corners`]: (low, low), (high x, low z), (low x, high z), (high,
/// high).
const CORNERS: [(i32, i32); 4] = [(-1, -1), (1, -1), (-1, 1), (1, 1)];

/// A chunk to draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// The chunk.
    pub key: ChunkKey,
    /// Morph weights of interior, edges and corners.
    pub seams: Seams,
}

/// Fade-in of finer chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fading {
    /// Current time, monotonic.
    pub now: Duration,
    /// Time from the parent's surface to the own one after all four children arrived; zero: at
    /// once.
    pub lasts: Duration,
}

/// The neighbour of a drawn chunk at an edge or corner.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Neighbour {
    /// None: the end of the view or of the world.
    Nothing,
    /// A chunk of the same level with this morph.
    Equal(f64),
    /// A coarser chunk.
    Coarser,
    /// Finer chunks.
    Finer,
}

/// Computes the morph weights of the leaves of a balanced tree whose inner nodes are `split`.
pub fn stitch(
    cache: &ChunkCache,
    viewer: &Viewer,
    leaves: &[ChunkKey],
    split: &FxHashSet<ChunkKey>,
    fading: Fading,
) -> Vec<Drawn> {
    let tolerance = error::tolerance(viewer);
    let inside: FxHashMap<ChunkKey, Morph> = leaves
        .iter()
        .map(|key| {
            let parent = parent_error(cache, viewer, *key);
            let morph = parent.map_or(0.0, |parent| morph(cache, viewer, *key, parent));
            let is_parent = parent.is_some_and(|parent| parent <= tolerance);
            (*key, Morph { morph: morph.max(fade_remaining(cache, *key, fading)), is_parent })
        })
        .collect();
    // Beside a decimated chunk, the outermost cells of a neighbour blend both of its surfaces: both
    // errors count there.
    let tolerates = |key: ChunkKey, toward: (i32, i32)| {
        let is_parent = inside.get(&key).is_none_or(|inside| inside.is_parent);
        is_parent
            || error::parent_error_on_screen(cache, viewer, key, toward)
                .is_some_and(|error| error <= tolerance)
    };
    let is_decimated = |key: &ChunkKey| {
        inside[key].is_parent
            && EDGES.into_iter().chain(CORNERS).all(|(east, south)| {
                let next = key.neighbour(east, south);
                next.is_none_or(|next| !split.contains(&next) && tolerates(next, (-east, -south)))
            })
    };
    let decimated: FxHashSet<ChunkKey> = leaves.iter().copied().filter(is_decimated).collect();
    let neighbour_at = |key: ChunkKey, (east, south): (i32, i32)| {
        let Some(next) = key.neighbour(east, south) else { return Neighbour::Nothing };
        if let Some(inside) = inside.get(&next) {
            if decimated.contains(&next) { Neighbour::Coarser } else { Neighbour::Equal(inside.morph) }
        } else if split.contains(&next) {
            Neighbour::Finer
        } else if std::iter::successors(next.parent(), |above| above.parent())
            .any(|above| inside.contains_key(&above))
        {
            Neighbour::Coarser
        } else {
            Neighbour::Nothing
        }
    };
    let stitched = |key: &ChunkKey| {
        if decimated.contains(key) {
            return Drawn { key: *key, seams: Seams::DECIMATED };
        }
        let own = inside[key].morph;
        let around = |direction| neighbour_at(*key, direction);
        let edges = EDGES.map(|direction| border_morph(own, &[around(direction)]));
        let corners = CORNERS.map(|(east, south)| {
            border_morph(own, &[around((east, 0)), around((0, south)), around((east, south))])
        });
        let is_coarser = EDGES.map(|direction| around(direction) == Neighbour::Coarser);
        Drawn {
            key: *key,
            seams: Seams { inside: quantized(own), edges, corners, is_coarser, is_decimated: false },
        }
    };
    leaves.iter().map(stitched).collect()
}

/// State of a leaf that does not depend on its neighbours.
#[derive(Clone, Copy, Debug)]
struct Morph {
    /// Morph into its parent, 0 to 1.
    morph: f64,
    /// Whether the parent's error is within the tolerance here.
    is_parent: bool,
}

/// Error on screen of a leaf's parent in place of the leaf; none at the top level.
fn parent_error(cache: &ChunkCache, viewer: &Viewer, key: ChunkKey) -> Option<f64> {
    (key.level() < viewer.top_level())
        .then(|| error::parent_error_on_screen(cache, viewer, key, error::INSIDE))
        .flatten()
}

/// Morph of a chunk into its parent, 0 to 1, from the parent's error on screen in its place.
///
/// With `own <= tolerance < parent`, a morph m leaves an error of at most (1 - m) own + m parent,
/// which is within the tolerance up to m = (tolerance - own) / (parent - own). That is 0 where the
/// chunk is about to be split and 1 where the parent is about to replace it, so neither change is
/// visible. Where the parent alone is good enough, the morph is 1.
fn morph(cache: &ChunkCache, viewer: &Viewer, key: ChunkKey, parent: f64) -> f64 {
    let Some(chunk) = cache.get(key) else { return 0.0 };
    let own = error::on_screen(cache, viewer, key, chunk);
    let tolerance = error::tolerance(viewer);
    if parent <= tolerance {
        return 1.0;
    }
    let within = (tolerance - own) / (parent - own).max(f64::MIN_POSITIVE);
    let late = (MORPH_FROM - parent / tolerance) / (MORPH_FROM - 1.0);
    within.min(late).clamp(0.0, 1.0)
}

/// Part of the fade-in that is left after a chunk and its siblings arrived, 1 to 0.
fn fade_remaining(cache: &ChunkCache, key: ChunkKey, fading: Fading) -> f64 {
    let since = key.parent().and_then(|parent| cache.split_since(parent)).filter(|_| !fading.lasts.is_zero());
    since.map_or(0.0, |since| {
        let age = fading.now.saturating_sub(since);
        1.0 - (age.as_secs_f64() / fading.lasts.as_secs_f64()).min(1.0)
    })
}

/// Morph of an edge or corner from the chunk's own morph and its neighbours.
fn border_morph(own: f64, neighbours: &[Neighbour]) -> u8 {
    if neighbours.contains(&Neighbour::Coarser) {
        return MORPH_ONE;
    }
    if neighbours.contains(&Neighbour::Finer) {
        return 0;
    }
    let equals = neighbours
        .iter()
        .filter_map(|neighbour| if let Neighbour::Equal(morph) = neighbour { Some(*morph) } else { None });
    let mut morphs: Vec<f64> = std::iter::once(own).chain(equals).collect();
    // Sorted, because all chunks that share the border must multiply in the same order to get the
    // same bits.
    morphs.sort_unstable_by(f64::total_cmp);
    quantized(combined(&morphs))
}

/// Combines morphs by the product of their odds. A chunk at 0 (about to be split) or 1 (about to be
/// its parent) decides alone; equal values stay; 0 against 1 gives 1/2.
fn combined(morphs: &[f64]) -> f64 {
    let (morphed, unmorphed) = morphs
        .iter()
        .fold((1.0, 1.0), |(morphed, unmorphed), morph| (morphed * morph, unmorphed * (1.0 - morph)));
    if morphed + unmorphed > 0.0 { morphed / (morphed + unmorphed) } else { 0.5 }
}

/// Rounded down: more morph could exceed the tolerance.
fn quantized(morph: f64) -> u8 {
    (morph * f64::from(MORPH_ONE)).floor() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lod::select;
    use proptest::prelude::*;
    use shaders::twin::grid::GridVertex;
    use shaders::twin::morph::{morph_at, morphed, parent_height, snapped};
    use std::collections::{BTreeMap, BTreeSet, HashSet};
    use std::sync::LazyLock;
    use terrain::constants::VERTICES;
    use terrain::{Chunk, Land, lod};

    /// Over a coast, so that levels differ by much within a short way; tight, so that all levels
    /// occur.
    const VIEWER: Viewer = Viewer {
        eye: (1_150_000, 30_000, 40_000),
        distance_m: 4000,
        pixels_per_radian: 300,
        tolerance_q4: 6,
    };

    static SENT: LazyLock<Vec<Chunk>> = LazyLock::new(|| {
        let land = Land::new(1);
        lod::select(&land, &VIEWER, usize::MAX).into_iter().map(|needed| land.chunk(needed.key)).collect()
    });

    fn cache_without(lost: &HashSet<ChunkKey>) -> ChunkCache {
        let mut cache = ChunkCache::new(10_000);
        for chunk in SENT.iter().filter(|chunk| !lost.contains(&chunk.key)) {
            cache.insert(chunk.clone());
        }
        cache
    }

    /// Where the vertices of one side of a chunk are drawn: east, south, up.
    fn side(cache: &ChunkCache, drawn: &Drawn, way: usize) -> BTreeSet<(i32, i32, i32)> {
        let (chunk, quarter) = (cache.get(drawn.key).unwrap(), drawn.key.quarter());
        let (x0, z0) = drawn.key.origin();
        let last = VERTICES as u32 - 1;
        let place = |step: u32| match way {
            0 => GridVertex { column: step, row: 0 },
            1 => GridVertex { column: last, row: step },
            2 => GridVertex { column: step, row: last },
            _ => GridVertex { column: 0, row: step },
        };
        let point = |step| {
            let vertex = snapped(&drawn.seams, place(step));
            let own = chunk.heights[vertex.row as usize * VERTICES + vertex.column as usize];
            let morph = morph_at(&drawn.seams, vertex);
            let height = if morph == 0 {
                own
            } else {
                let parent = cache.get(drawn.key.parent().unwrap()).unwrap();
                let quarter = (quarter.0 as u32, quarter.1 as u32);
                morphed(own, parent_height(&parent.heights, quarter, vertex), morph)
            };
            let spacing = drawn.key.spacing();
            (x0 + vertex.column as i32 * spacing, z0 + vertex.row as i32 * spacing, height)
        };
        (0..=last).map(point).collect()
    }

    /// The vertices within the view distance. Beyond it land has dissolved, and levels are balanced
    /// only as far as the view reaches.
    fn seen(side: &BTreeSet<(i32, i32, i32)>) -> BTreeSet<(i32, i32, i32)> {
        let reach = i64::from(VIEWER.distance_m) * i64::from(terrain::constants::UNITS_PER_METRE);
        let is_near = |(x, z, _): &&(i32, i32, i32)| {
            let (east, south) = (i64::from(*x - VIEWER.eye.0), i64::from(*z - VIEWER.eye.2));
            east * east + south * south <= reach * reach
        };
        side.iter().filter(is_near).copied().collect()
    }

    /// Sides whose vertices are not exactly those of what lies across, of how many.
    fn open_sides(cache: &ChunkCache, drawn: &[Drawn]) -> (usize, usize) {
        let by_key: BTreeMap<ChunkKey, &Drawn> = drawn.iter().map(|drawn| (drawn.key, drawn)).collect();
        let (mut open, mut all) = (0, 0);
        for drawn in drawn {
            for (direction, (east, south)) in EDGES.into_iter().enumerate() {
                let Some(next) = drawn.key.neighbour(east, south).filter(|next| VIEWER.sees(*next)) else {
                    continue;
                };
                let own = side(cache, drawn, direction);
                let across =
                    std::iter::successors(Some(next), |key| key.parent()).find_map(|key| by_key.get(&key));
                // A side towards finer chunks is compared from their side.
                let Some(across) = across else { continue };
                let theirs = side(cache, across, (direction + 2) % 4);
                let shared: BTreeSet<_> = if across.key.level() == drawn.key.level() {
                    theirs
                } else {
                    let span = |point: &&(i32, i32, i32)| {
                        let (low, high) = (own.first().unwrap(), own.last().unwrap());
                        (low.0..=high.0).contains(&point.0) && (low.1..=high.1).contains(&point.1)
                    };
                    theirs.iter().filter(span).copied().collect()
                };
                all += 1;
                open += usize::from(seen(&own) != seen(&shared));
            }
        }
        (open, all)
    }

    #[test]
    fn shared_borders_have_equal_vertices_and_a_control_fails() {
        let mut cache = cache_without(&HashSet::new());
        let mut drawn = select(&mut cache, &VIEWER).drawn;
        let levels: BTreeSet<u8> = drawn.iter().map(|drawn| drawn.key.level()).collect();
        let (open, all) = open_sides(&cache, &drawn);
        assert!(
            open == 0 && all > 250 && levels.len() >= 4,
            "{open} of {all} sides are open; levels {levels:?}"
        );
        let decimated = drawn.iter().filter(|drawn| drawn.seams.is_decimated).count();
        assert!(decimated > 10, "chunks with their parents' vertices are part of the test: {decimated}");
        let between = |drawn: &Drawn| (1..MORPH_ONE).contains(&drawn.seams.inside);
        assert!(
            drawn.iter().filter(|drawn| between(drawn)).count() > 10,
            "morphs between the ends are part of the test"
        );
        for chunk in &mut drawn {
            chunk.seams = Seams::default();
        }
        assert!(open_sides(&cache, &drawn).0 > 20, "without seams, level borders gape");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn borders_stay_closed_whatever_is_missing(
            lost in proptest::collection::vec(any::<proptest::sample::Index>(), 0..300),
        ) {
            let top = VIEWER.top_level();
            let lost = lost.iter().map(|index| index.get(&SENT).key);
            let lost = lost.filter(|key| key.level() != top).collect();
            let mut cache = cache_without(&lost);
            let drawn = select(&mut cache, &VIEWER).drawn;
            let (open, all) = open_sides(&cache, &drawn);
            prop_assert!(open == 0, "{open} of {all} sides are open");
        }

        #[test]
        fn chunks_at_a_corner_compute_the_same_morph(
            mut morphs in proptest::collection::vec(0.0f64..=1.0, 1..5),
            turn in 0usize..4,
        ) {
            let equal = |others: &[f64]| {
                others.iter().map(|morph| Neighbour::Equal(*morph)).collect::<Vec<_>>()
            };
            let first = border_morph(morphs[0], &equal(&morphs[1..]));
            let turn = turn % morphs.len();
            morphs.rotate_left(turn);
            prop_assert_eq!(border_morph(morphs[0], &equal(&morphs[1..])), first);
        }
    }

    #[test]
    fn a_morph_of_0_or_1_decides_the_border() {
        assert_eq!(combined(&[0.3, 1.0]), 1.0);
        assert_eq!(combined(&[0.0, 0.9, 0.9]), 0.0);
        assert_eq!(combined(&[0.5, 0.5]), 0.5);
        assert_eq!(combined(&[0.0, 1.0]), 0.5);
        assert_eq!(border_morph(0.4, &[Neighbour::Nothing, Neighbour::Finer, Neighbour::Coarser]), MORPH_ONE);
    }
}
