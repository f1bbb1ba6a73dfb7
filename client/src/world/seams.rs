//! How drawn chunks join: how far each one has morphed into its parent, inside, along its edges and
//! at its corners.
//!
//! A chunk of level k is drawn between its own surface and that of its parent, by one number inside
//! it (Ulrich, "Rendering Massive Terrains using Chunked Level of Detail Control", SIGGRAPH 2002).
//! What two chunks share must come out the same from both, so an edge or a corner has a number of
//! its own, made from those of all chunks that touch it. Where something coarser touches, it is
//! entirely the parent's surface; where something finer touches, entirely the chunk's own: both are
//! the integers of the same level. `shaders/wgsl/shared/morph.wesl` blends from the border to the
//! inside.
//!
//! A chunk that is there only because a sibling is needed, or a neighbour, is *halved*: drawn with
//! the parent's vertices, a quarter of its own. To what touches it, it is a coarser chunk. Nothing
//! that touches it is split, so drawn levels still differ by one at most; and what touches it can
//! bear the parent's border.

use crate::world::World;
use crate::world::error;
use crate::world::select::Fading;
use rustc_hash::{FxHashMap, FxHashSet};
use shaders::twin::morph::{MORPH_ONE, Seams};
use terrain::ChunkKey;
use terrain::lod::Viewer;

/// Morphing begins when the parent's error on screen has come down to this many tolerances; at one,
/// the parent takes over.
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
    /// How it joins its neighbours.
    pub seams: Seams,
}

/// What a drawn chunk meets on a side or at a corner.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Meets {
    /// Nothing that is drawn: the end of the view or of the world.
    Nothing,
    /// A chunk of the same level, so far morphed.
    Equal(f64),
    /// A coarser chunk.
    Coarser,
    /// Finer chunks.
    Finer,
}

/// Joins the leaves of a balanced tree whose inner nodes are `split`.
pub fn close(
    world: &World,
    viewer: &Viewer,
    leaves: &[ChunkKey],
    split: &FxHashSet<ChunkKey>,
    fading: Fading,
) -> Vec<Drawn> {
    let tolerance = error::tolerance(viewer);
    let inside: FxHashMap<ChunkKey, Inside> = leaves
        .iter()
        .map(|key| {
            let parent = above(world, viewer, *key);
            let morph = parent.map_or(0.0, |parent| morph(world, viewer, *key, parent));
            let is_parent = parent.is_some_and(|parent| parent <= tolerance);
            (*key, Inside { morph: morph.max(unfinished(world, *key, fading)), is_parent })
        })
        .collect();
    // Beside the parent's vertices a neighbour's outermost cells are drawn from both surfaces: both
    // errors count there.
    let bears = |key: ChunkKey, toward: (i32, i32)| {
        let is_parent = inside.get(&key).is_none_or(|inside| inside.is_parent);
        is_parent || error::of_parent(world, viewer, key, toward).is_some_and(|error| error <= tolerance)
    };
    let is_halved = |key: &ChunkKey| {
        inside[key].is_parent
            && EDGES.into_iter().chain(CORNERS).all(|(east, south)| {
                let next = key.neighbour(east, south);
                next.is_none_or(|next| !split.contains(&next) && bears(next, (-east, -south)))
            })
    };
    let halved: FxHashSet<ChunkKey> = leaves.iter().copied().filter(is_halved).collect();
    let meets = |key: ChunkKey, (east, south): (i32, i32)| {
        let Some(next) = key.neighbour(east, south) else { return Meets::Nothing };
        if let Some(inside) = inside.get(&next) {
            if halved.contains(&next) { Meets::Coarser } else { Meets::Equal(inside.morph) }
        } else if split.contains(&next) {
            Meets::Finer
        } else if std::iter::successors(next.parent(), |above| above.parent())
            .any(|above| inside.contains_key(&above))
        {
            Meets::Coarser
        } else {
            Meets::Nothing
        }
    };
    let join = |key: &ChunkKey| {
        if halved.contains(key) {
            return Drawn { key: *key, seams: Seams::HALVED };
        }
        let own = inside[key].morph;
        let around = |way| meets(*key, way);
        let edges = EDGES.map(|way| shared(own, &[around(way)]));
        let corners = CORNERS.map(|(east, south)| {
            shared(own, &[around((east, 0)), around((0, south)), around((east, south))])
        });
        let is_coarser = EDGES.map(|way| around(way) == Meets::Coarser);
        Drawn { key: *key, seams: Seams { inside: steps(own), edges, corners, is_coarser, is_halved: false } }
    };
    leaves.iter().map(join).collect()
}

/// A leaf, as far as it needs no neighbour.
#[derive(Clone, Copy, Debug)]
struct Inside {
    /// How far it has morphed into its parent, 0 to 1.
    morph: f64,
    /// Whether its parent's surface is good enough in its place.
    is_parent: bool,
}

/// Error on screen of a leaf's parent in the leaf's place, if it could be drawn there.
fn above(world: &World, viewer: &Viewer, key: ChunkKey) -> Option<f64> {
    (key.level() < viewer.top_level()).then(|| error::of_parent(world, viewer, key, error::INSIDE)).flatten()
}

/// How far a chunk has morphed into its parent, 0 to 1, by the parent's error on screen in its
/// place.
///
/// With the errors of chunk and parent, `own <= tolerance < parent`, a share m of the parent leaves
/// at most (1 - m) own + m parent: within the tolerance up to (tolerance - own) / (parent - own).
/// That is 0 where the chunk is about to be split and 1 where the parent is about to take over, so
/// neither moment shows. A chunk that is split for others' sake alone is its parent.
fn morph(world: &World, viewer: &Viewer, key: ChunkKey, parent: f64) -> f64 {
    let Some(chunk) = world.get(key) else { return 0.0 };
    let own = error::on_screen(world, viewer, key, chunk);
    let tolerance = error::tolerance(viewer);
    if parent <= tolerance {
        return 1.0;
    }
    let within = (tolerance - own) / (parent - own).max(f64::MIN_POSITIVE);
    let late = (MORPH_FROM - parent / tolerance) / (MORPH_FROM - 1.0);
    within.min(late).clamp(0.0, 1.0)
}

/// How much of its parent a chunk still is because its siblings and it have only now arrived, 1 to
/// 0.
fn unfinished(world: &World, key: ChunkKey, fading: Fading) -> f64 {
    let since = key.parent().and_then(|parent| world.split_since(parent)).filter(|_| !fading.lasts.is_zero());
    since.map_or(0.0, |since| {
        let age = fading.now.saturating_sub(since);
        1.0 - (age.as_secs_f64() / fading.lasts.as_secs_f64()).min(1.0)
    })
}

/// The morph of an edge or corner, from the chunk's own and what it meets there.
fn shared(own: f64, met: &[Meets]) -> u8 {
    if met.contains(&Meets::Coarser) {
        return MORPH_ONE;
    }
    if met.contains(&Meets::Finer) {
        return 0;
    }
    let equals = met.iter().filter_map(|met| if let Meets::Equal(morph) = met { Some(*morph) } else { None });
    let mut morphs: Vec<f64> = std::iter::once(own).chain(equals).collect();
    // All who share it must get the same bits, so the order of the products must not depend on who
    // asks.
    morphs.sort_unstable_by(f64::total_cmp);
    steps(combined(&morphs))
}

/// One number of several: the product of their odds. A chunk that is about to be its parent (1) or
/// about to be split (0) decides alone, because its next state would; equal numbers on the fence
/// stay there. Two that disagree entirely give 1/2.
fn combined(morphs: &[f64]) -> f64 {
    let (yes, no) = morphs.iter().fold((1.0, 1.0), |(yes, no), morph| (yes * morph, no * (1.0 - morph)));
    if yes + no > 0.0 { yes / (yes + no) } else { 0.5 }
}

/// Rounded down: a morph must not go farther into the parent than the tolerance allows.
fn steps(morph: f64) -> u8 {
    (morph * f64::from(MORPH_ONE)).floor() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::select;
    use proptest::prelude::*;
    use shaders::twin::grid::GridVertex;
    use shaders::twin::morph::{morph_at, morphed, parent_height, welded};
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

    fn world_without(lost: &HashSet<ChunkKey>) -> World {
        let mut world = World::new(10_000);
        for chunk in SENT.iter().filter(|chunk| !lost.contains(&chunk.key)) {
            world.insert(chunk.clone());
        }
        world
    }

    /// Where the vertices of one side of a chunk are drawn: east, south, up.
    fn side(world: &World, drawn: &Drawn, way: usize) -> BTreeSet<(i32, i32, i32)> {
        let (chunk, quarter) = (world.get(drawn.key).unwrap(), drawn.key.quarter());
        let (x0, z0) = drawn.key.origin();
        let last = VERTICES as u32 - 1;
        let place = |step: u32| match way {
            0 => GridVertex { column: step, row: 0 },
            1 => GridVertex { column: last, row: step },
            2 => GridVertex { column: step, row: last },
            _ => GridVertex { column: 0, row: step },
        };
        let point = |step| {
            let vertex = welded(&drawn.seams, place(step));
            let own = chunk.heights[vertex.row as usize * VERTICES + vertex.column as usize];
            let morph = morph_at(&drawn.seams, vertex);
            let height = if morph == 0 {
                own
            } else {
                let parent = world.get(drawn.key.parent().unwrap()).unwrap();
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
    fn open_sides(world: &World, drawn: &[Drawn]) -> (usize, usize) {
        let by_key: BTreeMap<ChunkKey, &Drawn> = drawn.iter().map(|drawn| (drawn.key, drawn)).collect();
        let (mut open, mut all) = (0, 0);
        for drawn in drawn {
            for (way, (east, south)) in EDGES.into_iter().enumerate() {
                let Some(next) = drawn.key.neighbour(east, south).filter(|next| VIEWER.sees(*next)) else {
                    continue;
                };
                let own = side(world, drawn, way);
                let across =
                    std::iter::successors(Some(next), |key| key.parent()).find_map(|key| by_key.get(&key));
                // A side towards finer chunks is compared from their side.
                let Some(across) = across else { continue };
                let theirs = side(world, across, (way + 2) % 4);
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
    fn every_chunk_draws_a_shared_border_with_the_same_vertices_and_the_check_can_fail() {
        let mut world = world_without(&HashSet::new());
        let mut drawn = select(&mut world, &VIEWER).drawn;
        let levels: BTreeSet<u8> = drawn.iter().map(|drawn| drawn.key.level()).collect();
        let (open, all) = open_sides(&world, &drawn);
        assert!(
            open == 0 && all > 250 && levels.len() >= 4,
            "{open} of {all} sides are open; levels {levels:?}"
        );
        let halved = drawn.iter().filter(|drawn| drawn.seams.is_halved).count();
        assert!(halved > 10, "chunks with their parents' vertices are part of the test: {halved}");
        let between = |drawn: &Drawn| (1..MORPH_ONE).contains(&drawn.seams.inside);
        assert!(
            drawn.iter().filter(|drawn| between(drawn)).count() > 10,
            "morphs between the ends are part of the test"
        );
        for chunk in &mut drawn {
            chunk.seams = Seams::default();
        }
        assert!(open_sides(&world, &drawn).0 > 20, "without seams, level borders gape");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn borders_stay_closed_whatever_is_missing(
            lost in proptest::collection::vec(any::<proptest::sample::Index>(), 0..300),
        ) {
            let top = VIEWER.top_level();
            let lost = lost.iter().map(|index| index.get(&SENT).key).filter(|key| key.level() != top).collect();
            let mut world = world_without(&lost);
            let drawn = select(&mut world, &VIEWER).drawn;
            let (open, all) = open_sides(&world, &drawn);
            prop_assert!(open == 0, "{open} of {all} sides are open");
        }

        #[test]
        fn all_who_share_a_corner_compute_the_same_morph(mut morphs in proptest::collection::vec(0.0f64..=1.0, 1..5), turn in 0usize..4) {
            let meets = |others: &[f64]| others.iter().map(|morph| Meets::Equal(*morph)).collect::<Vec<_>>();
            let first = shared(morphs[0], &meets(&morphs[1..]));
            let turn = turn % morphs.len();
            morphs.rotate_left(turn);
            prop_assert_eq!(shared(morphs[0], &meets(&morphs[1..])), first);
        }
    }

    #[test]
    fn one_that_is_about_to_change_decides_and_the_undecided_follow() {
        assert_eq!(combined(&[0.3, 1.0]), 1.0);
        assert_eq!(combined(&[0.0, 0.9, 0.9]), 0.0);
        assert_eq!(combined(&[0.5, 0.5]), 0.5);
        assert_eq!(combined(&[0.0, 1.0]), 0.5);
        assert_eq!(shared(0.4, &[Meets::Nothing, Meets::Finer, Meets::Coarser]), MORPH_ONE);
    }
}
