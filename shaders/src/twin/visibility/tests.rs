//! Vertices of drawn plants against the bounds that culling tests.

use super::super::clump::tests::{any_level, unit};
use super::super::clump::{add, grown_push, lean_push, root_offset_m, stem_pose, unpacked_clump, wind_push};
use super::super::field::{field_height_scale, field_keeps, field_size_m, field_widening};
use super::super::tree::{tree_size_m, tree_species};
use super::super::tree_shape::vertex_of_tree;
use super::super::tuft::tuft_vertex;
use super::*;
use crate::layout::{Field, GRASS_VERTICES, KIND_TREES, TREE_VERTICES};
use bytemuck::Zeroable;

const FINE: f32 = 4096.0;
const EYE: [i32; 3] = [1 << 23, 100 << 12, 1 << 23];
/// Half a millimetre for floats, two fine units for what is rounded down.
const ROUNDING_M: f32 = 0.001;

/// The uniforms of a species, for culling and for drawing.
fn kind(kind: u32, thin_from_m: f32, wind: f32, lean: f32) -> (Planting, Field) {
    let is_grass = kind == KIND_GRASS;
    let width_m = if is_grass { [0.16, 0.36] } else { [3.2, 6.4] };
    let height_m = if is_grass { [0.22, 0.62] } else { [6.0, 14.0] };
    let (widest, range_m) = if is_grass { (6.0, 260.0) } else { (1.0, 1500.0) };
    let lod_m: [f32; 2] = if is_grass { [10.0, 32.0] } else { [50.0, 220.0] };
    let fine = |metres: f32| (metres * FINE).round() as i32;
    let squared = |metres: f32| ((metres * 16.0 + 2.0).powi(2)).clamp(0.0, 3e9) as u32;
    let planting = Planting {
        kind,
        width_low: fine(width_m[0]),
        width_span: fine(width_m[1]) - fine(width_m[0]),
        height_low: fine(height_m[0]),
        height_span: fine(height_m[1]) - fine(height_m[0]),
        thin_from: fine(thin_from_m),
        widest: (widest * 256.0) as u32,
        range: (range_m * 16.0) as i32,
        collapse: (range_m * 4.0) as i32,
        detail: lod_m.map(squared),
        wind_reach: wind_reach(wind),
        lean_reach: lean_reach(lean),
        ..Planting::zeroed()
    };
    let field = Field {
        eye_x: EYE[0],
        eye_y: EYE[1],
        eye_z: EYE[2],
        kind,
        width_low_m: width_m[0],
        width_high_m: width_m[1],
        height_low_m: height_m[0],
        height_high_m: height_m[1],
        thin_from_m,
        widest,
        range_m,
        collapse_m: 0.25 * range_m,
        lod_m,
        wind,
        lean,
        ..Field::zeroed()
    };
    (planting, field)
}

/// Vertices of a clump as `draw_grass` and `draw_trees` place them, from its root, with what
/// each of them is of the way from foot to tip; and the level of detail.
fn drawn(
    planting: &Planting,
    field: &Field,
    clump: &Clump,
    slope: [i32; 2],
    seed: u32,
) -> Vec<([f32; 3], f32)> {
    let slope = slope.map(|rise| rise as f32 / 16_384.0);
    let length = (1.0 + slope[0] * slope[0] + slope[1] * slope[1]).sqrt();
    let byte = |part: f32| (((-127.0 * part / length).round() as i32) as u32) << 24;
    let words =
        [clump.x as u32 | byte(slope[0]), clump.z as u32 | byte(slope[1]), clump.y as u32, clump.attributes];
    let packed = unpacked_clump(words);
    let root_m = root_offset_m(field, &packed, [0.0; 3]);
    let far_m = root_m.iter().map(|axis| axis * axis).sum::<f32>().sqrt();
    if !field_keeps(field, packed.rank, far_m) {
        return Vec::new();
    }
    let [width, height] = field_size_m(field, packed.width, packed.height);
    let size_m =
        [width * field_widening(field, packed.rank, far_m), height * field_height_scale(field, far_m)];
    let wind = wind_push(field.wind, [unit(seed, 20), unit(seed, 21)], 100.0 * unit(seed, 22), packed.phase);
    let culling = Culling { eye: EYE, ..Culling::zeroed() };
    let far = distance_squared(&culling, clump.x, clump.y, clump.z);
    let level = u32::from(far > planting.detail[0]) + u32::from(far > planting.detail[1]);
    if planting.kind != KIND_GRASS {
        // Heights of all zones, so that all species are tried.
        let species = tree_species(&packed);
        let size_m = tree_size_m(species, size_m);
        // An impostor stands for the geometry of the level before.
        let level = level.min(1);
        let vertices = 0..TREE_VERTICES[level as usize];
        return vertices
            .map(|index| (vertex_of_tree(species, level, index, size_m, packed.phase, wind), 1.0))
            .collect();
    }
    let own = grown_push(packed.hue, packed.phase);
    let push = add(add(own, wind), lean_push(field.lean, root_m, far_m));
    let pose = stem_pose(packed.normal, push);
    (0..GRASS_VERTICES[level as usize])
        .map(|index| tuft_vertex(level, index, size_m, packed.phase, &pose, far_m))
        .map(|vertex| (vertex.offset_m, vertex.along))
        .collect()
}

fn any_clump(seed: u32, far_m: f32) -> (Clump, [i32; 2]) {
    let way = any_level(seed, 0, 1.0);
    let length = way[0].hypot(way[1]).max(1e-3);
    let at = |axis: usize| EYE[2 * axis] + (way[axis] / length * far_m * FINE) as i32;
    let up = (unit(seed, 2) - 0.7) * far_m * 0.8;
    let slope = any_level(seed, 3, 1.3).map(|rise| (rise * 16_384.0) as i32);
    let attributes = (unit(seed, 5) * 16_777_215.0) as u32;
    let rank = (256.0 * unit(seed, 6).powi(2)) as u32;
    (Clump { x: at(0), z: at(1), y: EYE[1] + (up * FINE) as i32, attributes: attributes | rank << 24 }, slope)
}

/// How far a vertex is outside what a target is said to take up, as it is seen along a
/// horizontal direction, metres: beside it, and above it.
fn outside(occludee: &Occludee, root_y: i32, (offset, along): ([f32; 3], f32), angle: f32) -> [f32; 2] {
    let metres = |fine: i32| fine as f32 / FINE;
    let (radius, taper, slope_radius) =
        (metres(occludee.radius), metres(occludee.taper), metres(occludee.slope_radius));
    let down = if occludee.taper > 0 { 1.0 - along } else { 0.0 };
    let beside = offset[0].hypot(offset[2]) - (radius + down * taper);
    // Behind and beside the root, as it is seen.
    let turned = |x: f32, z: f32| [x * angle.cos() + z * angle.sin(), z * angle.cos() - x * angle.sin()];
    let [behind, across] = turned(offset[0], offset[2]);
    let [ahead, tilt] = turned(occludee.slope_east as f32 / 16_384.0, occludee.slope_south as f32 / 16_384.0);
    let spread = slope_radius + down * (radius + taper - slope_radius);
    let lean = radius - slope_radius;
    let (least, most) = ((behind - lean).max(-spread), (behind + lean).min(spread));
    let planar = if ahead > 0.0 { most } else { least };
    let limit =
        metres(occludee.top - root_y) + tilt * across + ahead * planar - down * metres(occludee.taper_drop);
    [beside, offset[1] - limit]
}

#[test]
fn every_drawn_vertex_lies_inside_its_occludee() {
    let culling = Culling { eye: EYE, ..Culling::zeroed() };
    let (mut tested, mut tapers, mut closest) = (0, 0, [f32::MIN; 2]);
    for seed in 0..30_000 {
        let [wind, lean] = [unit(seed, 10).round(), unit(seed, 11)];
        let thin_from_m = [14.0, 42.0, 80.0][(3.0 * unit(seed, 12)) as usize % 3];
        let (planting, field) = kind(KIND_GRASS, thin_from_m, wind, lean);
        let (clump, gradient) = any_clump(seed, 1.0 + 250.0 * unit(seed, 13).powi(2));
        let slope = Some(gradient).filter(|[east, south]| steepness(*east, *south) <= 1 << 14);
        let occludee = extent_of(&culling, &planting, &clump, slope).occludee;
        tapers += u32::from(occludee.taper > 0);
        for vertex in drawn(&planting, &field, &clump, gradient, seed) {
            for turn in 0..6 {
                let out = outside(&occludee, clump.y, vertex, turn as f32);
                assert!(
                    out[0].max(out[1]) <= ROUNDING_M,
                    "{out:?} m: {seed} {clump:?} {gradient:?} {occludee:?}"
                );
                closest = [closest[0].max(out[0]), closest[1].max(out[1])];
            }
            tested += 1;
        }
    }
    assert!(tested > 100_000 && tapers > 1000, "{tested} {tapers}");
    // A bound that nothing comes near to would be a wasteful one; one a little smaller, the
    // control, is left.
    assert!(closest.iter().all(|out| *out > -0.02), "{closest:?}");
}

#[test]
fn every_vertex_of_a_tree_lies_inside_its_cone() {
    let culling = Culling { eye: EYE, ..Culling::zeroed() };
    let mut left = 0;
    for seed in 0..4000 {
        let (planting, field) = kind(KIND_TREES, 1500.0, 1.0, 0.0);
        let (clump, _) = any_clump(seed, 5.0 + 1000.0 * unit(seed, 13));
        let occludee = extent_of(&culling, &planting, &clump, Some([0, 0])).occludee;
        let top = (occludee.top - clump.y) as f32 / FINE;
        let reach = |y: f32, thinner: f32| {
            let share = ((top - y) / (occludee.taper_drop as f32 / FINE)).max(0.0);
            (occludee.radius as f32 + share * occludee.taper as f32) / FINE * thinner
        };
        for ([x, y, z], _) in drawn(&planting, &field, &clump, [0, 0], seed) {
            let out = x.hypot(z);
            assert!(y <= top && out <= reach(y, 1.0) + ROUNDING_M, "{out} at {y} of {top}: {seed}");
            // The lobes of impostors touch the cone more closely (`tree_impostor`).
            left += u32::from(out > reach(y, 0.75));
        }
    }
    assert!(left > 100, "the control: {left}");
}

#[test]
fn no_blade_is_longer_than_the_table_says() {
    for phase in 0..64u32 {
        let pose = stem_pose([0.0, 1.0, 0.0], [0.0; 2]);
        let tips = (0..GRASS_VERTICES[2])
            .map(|index| tuft_vertex(2, index, [0.0, 1.0], phase as f32 / 63.0, &pose, 50.0))
            .filter(|vertex| vertex.along == 1.0);
        // A blade leans out of its own: its length is that of the stem.
        let longest = tips.map(|tip| {
            let [x, y, z] = tip.offset_m;
            x.hypot(y).hypot(z)
        });
        let longest = longest.fold(0.0, f32::max);
        let longest_by_table = LONGEST[(phase % 9) as usize] as f32 / 256.0;
        assert!(
            (longest..longest + 0.02).contains(&longest_by_table),
            "{phase}: {longest} of {longest_by_table}"
        );
    }
}
