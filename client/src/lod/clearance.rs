//! Clearance: keeps an eye away from the drawn land, so that no near plane cuts a hole into it.

use crate::cache::{ChunkCache, Resident};
use crate::camera::{CLEARANCE_M, Pose};
use crate::lod::Drawn;
use glam::{DVec2, DVec3};
use shaders::twin::grid::GridVertex;
use shaders::twin::morph::{morph_at, morphed, parent_height, snapped};
use std::ops::Range;
use terrain::constants::{CELLS, UNITS_PER_METRE, VERTICES};

/// A drawn triangle: its corners in metres, from the eye along x and z, above the sea along y.
pub type Triangle = [DVec3; 3];

/// The pose raised until no drawn triangle is nearer to the eye than [`CLEARANCE_M`], in any
/// direction. The near plane lies within that distance
/// ([`Projection::near_m`](crate::camera::Projection::near_m)).
#[must_use]
pub fn raised(pose: Pose, cache: &ChunkCache, drawn: &[Drawn]) -> Pose {
    let lowest = triangles_near(&pose, cache, drawn, CLEARANCE_M)
        .iter()
        .filter_map(|triangle| resting_height(triangle, CLEARANCE_M))
        .fold(pose.position_m.y, f64::max);
    Pose { position_m: pose.position_m.with_y(lowest), ..pose }
}

/// The drawn triangles within so many metres of an eye along x and along z, and some around them.
#[must_use]
pub fn triangles_near(pose: &Pose, cache: &ChunkCache, drawn: &[Drawn], reach_m: f64) -> Vec<Triangle> {
    let eye = DVec2::new(pose.position_m.x, pose.position_m.z);
    let mut triangles = Vec::new();
    for drawn in drawn {
        let (x0, z0) = drawn.key.origin();
        let spacing_m = metres(drawn.key.spacing());
        let (columns, rows) =
            (cells(eye.x - metres(x0), spacing_m, reach_m), cells(eye.y - metres(z0), spacing_m, reach_m));
        let Some(chunk) = cache.get(drawn.key).filter(|_| !columns.is_empty() && !rows.is_empty()) else {
            continue;
        };
        let parent = drawn.key.parent().and_then(|parent| cache.get(parent));
        let corner = |column: u32, row: u32| {
            let vertex = snapped(&drawn.seams, GridVertex { column, row });
            let along = |low: i32, steps: u32, eye: f64| metres(low) + f64::from(steps) * spacing_m - eye;
            DVec3::new(
                along(x0, vertex.column, eye.x),
                metres(drawn_height(drawn, chunk, parent, vertex)),
                along(z0, vertex.row, eye.y),
            )
        };
        for row in rows {
            for column in columns.clone() {
                let (low, high) = (corner(column, row), corner(column + 1, row + 1));
                triangles.push([low, high, corner(column + 1, row)]);
                triangles.push([low, corner(column, row + 1), high]);
            }
        }
    }
    triangles
}

/// Drawn height of a vertex that no other one replaces, units.
fn drawn_height(drawn: &Drawn, chunk: &Resident, parent: Option<&Resident>, vertex: GridVertex) -> i32 {
    let own = chunk.heights[vertex.row as usize * VERTICES + vertex.column as usize];
    let (east, south) = drawn.key.quarter();
    match (morph_at(&drawn.seams, vertex), parent) {
        (0, _) | (_, None) => own,
        (morph, Some(parent)) => {
            morphed(own, parent_height(&parent.heights, (east as u32, south as u32), vertex), morph)
        }
    }
}

fn metres(units: i32) -> f64 {
    f64::from(units) / f64::from(UNITS_PER_METRE)
}

/// Cells along one side of a chunk within `reach_m` of a place that lies `at_m` from its low
/// corner, with one more to either side: snapped vertices widen triangles by a cell.
fn cells(at_m: f64, spacing_m: f64, reach_m: f64) -> Range<u32> {
    let last = CELLS as f64;
    let (low, high) = ((at_m - reach_m) / spacing_m, (at_m + reach_m) / spacing_m);
    if high < 0.0 || low > last {
        return 0..0;
    }
    let (low, high) = ((low.floor() - 1.0).max(0.0), (high.floor() + 2.0).min(last));
    low as u32..high as u32
}

/// Height of the centre of a sphere above the origin of x and z that rests on a triangle; none if
/// the triangle is out of its reach. The sphere's centre over a point of the triangle at the
/// horizontal distance r is `sqrt(radius² - r²)` above it; the highest of these is either where the
/// triangle's plane touches, or on an edge.
fn resting_height(triangle: &Triangle, radius: f64) -> Option<f64> {
    let [a, b, c] = *triangle;
    let edges = [(a, b), (b, c), (c, a)];
    let on_edge = edges.into_iter().filter_map(|(from, to)| resting_on_edge(from, to, radius));
    let normal = (b - a).cross(c - a);
    if normal.y == 0.0 {
        // Seen from above it has no area.
        return on_edge.reduce(f64::max);
    }
    let slope = DVec2::new(-normal.x, -normal.z) / normal.y;
    let steepness = (1.0 + slope.length_squared()).sqrt();
    let touch = slope * (radius / steepness);
    let side = |(from, to): (DVec3, DVec3)| flat(to - from).perp_dot(touch - flat(from)) * normal.y;
    let is_inside = edges.into_iter().all(|edge| side(edge) <= 0.0);
    let on_plane = is_inside.then(|| a.y - slope.dot(flat(a)) + radius * steepness);
    on_edge.chain(on_plane).reduce(f64::max)
}

fn flat(point: DVec3) -> DVec2 {
    DVec2::new(point.x, point.z)
}

/// [`resting_height`] on a line.
fn resting_on_edge(from: DVec3, to: DVec3, radius: f64) -> Option<f64> {
    let length = flat(to - from).length();
    if length == 0.0 {
        return None;
    }
    let (way, rise) = (flat(to - from) / length, (to.y - from.y) / length);
    // Along the edge from its point nearest to the origin.
    let start = flat(from).dot(way);
    let beside = way.perp_dot(flat(from));
    let reach = (radius * radius - beside * beside).max(0.0).sqrt();
    let (low, high) = (start.max(-reach), (start + length).min(reach));
    if beside.abs() > radius || low > high {
        return None;
    }
    let at = (rise * reach / (1.0 + rise * rise).sqrt()).clamp(low, high);
    Some(from.y + rise * (at - start) + (reach * reach - at * at).max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::vertical_scale;
    use crate::camera::{NEAR_M, Projection};
    use crate::lod::{Selection, select};
    use crate::settings::RenderSettings;
    use crate::view::ViewParams;
    use std::collections::BTreeMap;
    use terrain::{Chunk, ChunkKey, Land, lod};

    /// Vertical field of view, degrees, and size of the picture.
    const LENSES: [(f64, (u32, u32)); 5] =
        [(30.0, (64, 36)), (60.0, (64, 36)), (90.0, (36, 64)), (120.0, (84, 36)), (170.0, (64, 36))];
    const SCALES: [f64; 3] = [1.0, 1.8, 4.0];

    /// Eyes of a place on world 1, and how many places.
    const EYES: usize = 20;
    const PLACES: usize = 10;

    /// Part of a triangle in front of a near plane and inside the frustum: what the near plane
    /// cuts away. Clipped plane by plane (Sutherland and Hodgman, CACM 1974); shares nothing with
    /// [`resting_height`].
    fn is_cut(triangle: &Triangle, pose: &Pose, projection: &Projection, near_m: f64) -> bool {
        let (forward, right, up) = (pose.forward(), pose.right(), pose.up());
        let (height, width) = (projection.half_height(), projection.half_height() * projection.aspect());
        let sides =
            [right + forward * width, forward * width - right, up + forward * height, forward * height - up];
        let mut part: Vec<DVec3> =
            triangle.iter().map(|corner| corner - DVec3::Y * pose.position_m.y).collect();
        let before = |point: DVec3| near_m - forward.dot(point);
        part = clipped(&part, before);
        for side in sides {
            part = clipped(&part, |point| side.dot(point));
        }
        !part.is_empty()
    }

    fn clipped(part: &[DVec3], inside: impl Fn(DVec3) -> f64) -> Vec<DVec3> {
        let mut kept = Vec::new();
        for (index, from) in part.iter().enumerate() {
            let to = part[(index + 1) % part.len()];
            let (here, there) = (inside(*from), inside(to));
            if here >= 0.0 {
                kept.push(*from);
            }
            if (here < 0.0) != (there < 0.0) {
                kept.push(*from + (to - *from) * (here / (here - there)));
            }
        }
        kept
    }

    /// The steepest level-0 chunks near the middle of world 1, one of each 512 m.
    fn steep_chunks(land: &Land) -> Vec<ChunkKey> {
        let mut steep: Vec<(u32, ChunkKey)> = (-10..10)
            .flat_map(|z| (-10..10).map(move |x| (4 * x, 4 * z)))
            .filter_map(|(x, z)| {
                let key = ChunkKey::new(0, x, z).ok()?;
                let chunk = land.chunk(key);
                (chunk.min() > 0).then_some((chunk.slope, key))
            })
            .collect();
        steep.sort_unstable_by_key(|(slope, key)| (u32::MAX - slope, *key));
        steep.into_iter().take(PLACES).map(|(_, key)| key).collect()
    }

    /// Eyes in the ground at the foot of the steepest cells of a chunk, where a lifted eye is
    /// beside higher land.
    fn eyes(chunk: &Chunk) -> Vec<Pose> {
        let at = |column: usize, row: usize| chunk.heights[row * VERTICES + column];
        let mut cells: Vec<(i32, usize, usize)> = (1..CELLS)
            .flat_map(|row| (1..CELLS).map(move |column| (column, row)))
            .map(|(column, row)| {
                let around = [(1, 0), (0, 1), (1, 1)];
                let rise =
                    around.map(|(east, south)| at(column + east, row + south).abs_diff(at(column, row)));
                (rise.into_iter().max().unwrap_or(0) as i32, column, row)
            })
            .collect();
        cells.sort_unstable_by_key(|(rise, column, row)| (-rise, *column, *row));
        let (x0, z0) = chunk.key.origin();
        cells
            .into_iter()
            .take(EYES)
            .enumerate()
            .map(|(index, (_, column, row))| Pose {
                // On the vertex, beside it, and inside a cell.
                position_m: DVec3::new(
                    metres(x0) + 2.0 * column as f64 + 0.63 * (index % 3) as f64,
                    -64.0,
                    metres(z0) + 2.0 * row as f64 + 0.41 * (index % 4) as f64,
                ),
                yaw_deg: 37.0 * index as f64,
                pitch_deg: [-60.0, -20.0, 0.0, 15.0][index % 4],
            })
            .collect()
    }

    fn view(pose: Pose) -> ViewParams {
        ViewParams {
            pose,
            projection: Projection { fov_deg: 60.0, width: 64, height: 36 },
            view_distance_m: 150,
            tolerance_px: 2.0,
            time_s: 0.0,
            settings: RenderSettings::default(),
        }
    }

    /// The chunks of a view at a vertical scale.
    fn selected(
        land: &Land,
        made: &mut BTreeMap<ChunkKey, Chunk>,
        pose: Pose,
        scale: f64,
    ) -> (ChunkCache, Selection) {
        let viewer = view(pose).viewer();
        let mut cache = ChunkCache::new(4096);
        cache.set_vertical_scale((scale * 256.0) as i32);
        let served = vertical_scale::served(&viewer, cache.vertical_scale());
        for needed in lod::select(land, &served, usize::MAX) {
            let chunk = made.entry(needed.key).or_insert_with(|| land.chunk(needed.key));
            cache.insert(chunk.clone());
        }
        let selection = select(&mut cache, &viewer);
        (cache, selection)
    }

    #[test]
    fn no_near_plane_cuts_the_land_under_a_lifted_eye_and_the_vertical_rule_does() {
        let land = Land::new(1);
        let (mut checked, mut cut, mut cut_before) = (0, 0, 0);
        for key in steep_chunks(&land) {
            let mut made = BTreeMap::new();
            for (pose, scale) in
                eyes(&land.chunk(key)).into_iter().flat_map(|pose| SCALES.map(|scale| (pose, scale)))
            {
                let (cache, selection) = selected(&land, &mut made, pose, scale);
                let eye = pose.eye();
                // The rule before: above the highest corner of the cell, one near plane for all.
                let before = pose.above(cache.ground(eye.units[0], eye.units[2]));
                let after = raised(before, &cache, &selection.drawn);
                let triangles = triangles_near(&after, &cache, &selection.drawn, 24.0);
                assert!(triangles.len() > 100, "{pose}: {} triangles", triangles.len());
                for (fov_deg, (width, height)) in LENSES {
                    let projection = Projection { fov_deg, width, height };
                    let is_cut_at = |pose: &Pose, near_m: f32| {
                        let near_m = f64::from(near_m);
                        triangles.iter().any(|triangle| is_cut(triangle, pose, &projection, near_m))
                    };
                    checked += 1;
                    cut += usize::from(is_cut_at(&after, projection.near_m()));
                    cut_before += usize::from(is_cut_at(&before, NEAR_M));
                }
            }
        }
        eprintln!("{cut_before} of {checked} near planes cut the land by the vertical rule, {cut} now");
        assert_eq!((checked, cut), (PLACES * EYES * LENSES.len() * SCALES.len(), 0));
        assert!(cut_before > 300, "the control: {cut_before} of {checked} cut by the vertical rule");
    }

    #[test]
    fn a_sphere_rests_on_planes_edges_and_corners() {
        let far = 50.0;
        let plane = |rise: f64| {
            [
                DVec3::new(-far, -far * rise, -far),
                DVec3::new(far, far * rise, -far),
                DVec3::new(0.0, 0.0, far),
            ]
        };
        let near = |got: Option<f64>, expected: f64| {
            assert!(got.is_some_and(|got| (got - expected).abs() < 1e-9), "{got:?} {expected}");
        };
        near(resting_height(&plane(0.0), 0.5), 0.5);
        near(resting_height(&plane(1.0), 0.5), 0.5 * 2f64.sqrt());
        let beside = |x: f64| [DVec3::new(x, 3.0, -far), DVec3::new(x, 3.0, far), DVec3::new(far, 3.0, 0.0)];
        near(resting_height(&beside(0.3), 0.5), 3.4);
        assert_eq!(resting_height(&beside(0.51), 0.5), None);
        let corner = [DVec3::new(0.0, 2.0, 0.4), DVec3::new(-9.0, -9.0, 9.0), DVec3::new(9.0, -9.0, 9.0)];
        near(resting_height(&corner, 0.5), 2.3);
    }

    #[test]
    fn the_distance_to_the_land_is_never_below_the_clearance() {
        let land = Land::new(1);
        let key = steep_chunks(&land)[0];
        let mut made = BTreeMap::new();
        for pose in eyes(&land.chunk(key)) {
            let (cache, selection) = selected(&land, &mut made, pose, 4.0);
            let after = raised(pose, &cache, &selection.drawn);
            assert_eq!(raised(after, &cache, &selection.drawn), after, "raised once is enough");
            let eye = DVec3::Y * after.position_m.y;
            let triangles = triangles_near(&after, &cache, &selection.drawn, 4.0);
            let samples = triangles.iter().flat_map(|[a, b, c]| {
                (0..=20).flat_map(move |i| {
                    (0..=20 - i).map(move |j| {
                        let (s, t) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                        a + (b - a) * s + (c - a) * t
                    })
                })
            });
            let nearest = samples.map(|point| point.distance(eye)).fold(f64::MAX, f64::min);
            assert!((CLEARANCE_M - 1e-9..0.7).contains(&nearest), "{nearest} m from {after}");
        }
    }
}
