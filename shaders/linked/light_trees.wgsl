@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(10)
var<storage, read_write> lights: array<u32>;

@compute @workgroup_size(64)
fn light_trees(@builtin(global_invocation_id) id: vec3u) {
    let casts = (tree_cells[0].w & TREES_CAST) != 0u;
    for (var number = 0u; number < TREES_PER_CELL; number++) {
        let index = id.x * TREES_PER_CELL + number;
        let words = tree_cells[TREE_HEAD + index];
        if words.w == 0u {
            break;
        }
        var light = vec3f(1.0);
        if casts {
            let tree = unpacked_tree(words);
            let heights_m = LIGHT_AT * tree.height_m;
            let level = length(frame.sun.xz) / max(frame.sun.y, LOWEST_SUN);
            for (var part = 0u; part < 3u; part++) {
                let at_m = tree.root_m + vec3f(0.0, heights_m[part], 0.0);
                let columns = min(u32((15.0 - heights_m[part]) * level / 8.0) + 1u, MOST_COLUMNS);
                light[part] = sun_past_trees(at_m, frame.sun, columns, 1.0, tree.root_m.xz);
            }
        }
        let bytes = vec3u(light * 255.0 + 0.5);
        lights[index] = bytes.x | (bytes.y << 8u) | (bytes.z << 16u);
    }
}

struct Atmosphere {
    sun: vec3f,
    sun_aloft: vec3f,
    toward: vec3f,
    away: vec3f,
    upward: vec3f,
    multiple_scattering: vec3f,
    sky_mean: vec3f,
    sky_east: vec3f,
    sky_up: vec3f,
    sky_south: vec3f
}

const CROWN_MARGIN_M: f32 = 3.4;

struct Caster {
    root_m: vec3f,
    width_m: f32,
    height_m: f32,
    species: u32
}

struct Crown {
    wide_m: f32,
    rise_m: f32,
    radius_m: f32,
    is_cone: bool,
    density: f32
}

struct Frame {
    clip_from_camera: mat4x4f,
    ray_right: vec3f,
    time_s: f32,
    ray_up: vec3f,
    eye_height_m: f32,
    ray_forward: vec3f,
    view_distance_m: f32,
    sun: vec3f,
    exposure: f32,
    eye_fraction_m: vec3f,
    pixel: f32,
    pattern_eye_m: vec2f,
    viewport: vec2f,
    diffuse: u32,
    visibility: u32,
    tiling: u32,
    water_tier: u32,
    shadows: u32,
    show: u32,
    pixels_per_radian: f32,
    tolerance_px: f32,
    parallax_factor: f32,
    parallax_bias_m: f32,
    wave_steepness: f32,
    grass: u32,
    pom: PomParams,
    atmosphere: Atmosphere
}

const LIGHT_AT = vec3f(0.15, 0.5, 0.85);

const LOWEST_SUN: f32 = 0.02;

const MOST_COLUMNS: u32 = 12u;

const PINE: u32 = 1u;

struct PomParams {
    tier: u32,
    steps_min: u32,
    steps_max: u32,
    refine: u32,
    refinements: u32,
    loop_form: u32,
    heights: u32,
    shadow: u32,
    silhouette: u32,
    depth: u32,
    pivot: f32,
    amplitude: f32,
    horizon: vec4f,
    travel_flat: f32,
    travel_offset: f32,
    travel_linear: f32,
    fade_px: f32
}

const SHAPE_STEPS: f32 = 64.0;

const SPRUCE: u32 = 0u;

const SUN_RADIUS: f32 = 0.004651;

const TREES_CAST: u32 = 2u;

const TREES_PER_CELL: u32 = 4u;

const TREE_CELL_M: f32 = 8.0;

const TREE_HEAD: u32 = 2u;

fn crown_chord(crown: Crown, at_m: vec3f, toward: vec3f) -> f32 {
    if !crown.is_cone {
        let axes = vec3f(crown.radius_m, crown.rise_m, crown.radius_m);
        let begin = (at_m - vec3f(0.0, crown.wide_m, 0.0)) / axes;
        let step = toward / axes;
        let a = dot(step, step);
        let b = dot(begin, step);
        let inside = b * b - a * (dot(begin, begin) - 1.0);
        if inside <= 0.0 {
            return 0.0;
        }
        let root = sqrt(inside);
        return max(0.0, (root - b) - max(-root - b, 0.0)) / a;
    }
    let k = crown.radius_m / crown.rise_m;
    let y = at_m.y - (crown.wide_m + crown.rise_m);
    let up = max(toward.y, 0.0001);
    var near = max(0.0, (-crown.rise_m - y) / up);
    var far = -y / up;
    var a = dot(toward.xz, toward.xz) - k * k * up * up;
    a = select(a, 1e-5, abs(a) < 1e-5);
    let b = dot(at_m.xz, toward.xz) - k * k * y * up;
    let c = dot(at_m.xz, at_m.xz) - k * k * y * y;
    let inside = b * b - a * c;
    if inside <= 0.0 {
        return 0.0;
    }
    let root = sqrt(inside);
    if a > 0.0 {
        near = max(near, (-b - root) / a);
        far = min(far, (root - b) / a);
    }
    else {
        far = min(far, (root - b) / a);
    }
    return max(0.0, far - near);
}

fn crown_of(caster: Caster) -> Crown {
    let high = caster.height_m;
    let half = 0.5 * caster.width_m;
    if caster.species == SPRUCE {
        return Crown(0.1 * high, 0.9 * high, 0.86 * half, true, 1.5);
    }
    if caster.species == PINE {
        return Crown(0.66 * high, 0.33 * high, 0.9 * half, false, 1.0);
    }
    return Crown(0.56 * high, 0.43 * high, 0.92 * half, false, 1.0);
}

fn is_in_tree_grid(side: u32, cell: vec2i) -> bool {
    return all(cell >= vec2i(0)) && all(cell < vec2i(i32(side)));
}

fn sun_past(caster: Caster, point_m: vec3f, sun: vec3f, blur_m: f32) -> f32 {
    let at_m = point_m - caster.root_m;
    let crown = crown_of(caster);
    let passed = exp(-crown.density * crown_chord(crown, at_m, sun));
    return passed * (1.0 - trunk_shade(caster, at_m, sun, blur_m));
}

fn sun_past_trees(point_m: vec3f, sun: vec3f, columns: u32, blur_m: f32, own_m: vec2f) -> f32 {
    let level = length(sun.xz);
    if sun.y < LOWEST_SUN || level < 0.001 {
        return 1.0;
    }
    let along = sun.xz / level;
    let grid = tree_cells[1].z;
    let place = tree_place(point_m.xz);
    let is_east = abs(along.x) >= abs(along.y);
    let run = select(along.yx, along, is_east);
    let at = select(place.yx, place, is_east);
    let way = select(-1.0, 1.0, run.x > 0.0);
    let drift = run.y / abs(run.x);
    let margin = CROWN_MARGIN_M / TREE_CELL_M;
    let side = margin / abs(run.x);
    let first = floor(at.x - way * margin);
    var left = 1.0;
    for (var step = 0u; step <= columns + 1u; step++) {
        let column = first + way * f32(step);
        let begin = select(at.x - column - 1.0, column - at.x, way > 0.0);
        let near = max(begin, -margin);
        let far = max(begin + 1.0, near);
        let low = floor(at.y + min(drift * near, drift * far) - side);
        let high = floor(at.y + max(drift * near, drift * far) + side);
        for (var row = i32(low); row <= i32(high); row++) {
            let cell = select(vec2i(row, i32(column)), vec2i(i32(column), row), is_east);
            if !is_in_tree_grid(grid, cell) {
                continue;
            }
            let base = TREE_HEAD + tree_index(grid, cell, 0u);
            for (var number = 0u; number < TREES_PER_CELL; number++) {
                let words = tree_cells[base + number];
                if words.w == 0u {
                    break;
                }
                let tree = unpacked_tree(words);
                let to_m = tree.root_m.xz - point_m.xz;
                let beside_m = abs(to_m.x * along.y - to_m.y * along.x);
                let apart_m = tree.root_m.xz - own_m;
                if beside_m > 0.5 * tree.width_m + 0.2 || dot(apart_m, apart_m) < 0.001 {
                    continue;
                }
                left *= sun_past(tree, point_m, sun, blur_m);
            }
        }
        if left < 0.01 {
            break;
        }
    }
    return left;
}

fn tree_cell_index(side: u32, cell: vec2i) -> u32 {
    return u32(cell.y) * side + u32(cell.x);
}

@group(0) @binding(8)
var<storage, read> tree_cells: array<vec4u>;

fn tree_index(side: u32, cell: vec2i, number: u32) -> u32 {
    return tree_cell_index(side, cell) * TREES_PER_CELL + number;
}

fn tree_place(offset_m: vec2f) -> vec2f {
    return (bitcast<vec2f>(tree_cells[0].xy) + offset_m) / TREE_CELL_M;
}

fn trunk_radius_m(caster: Caster) -> f32 {
    return min(0.018 * caster.height_m, 0.1 * caster.width_m);
}

fn trunk_shade(caster: Caster, at_m: vec3f, toward: vec3f, blur_m: f32) -> f32 {
    let level = max(length(toward.xz), 0.0001);
    let along = toward.xz / level;
    let way_m = -dot(at_m.xz, along);
    let beside_m = abs(at_m.x * along.y - at_m.z * along.x);
    let half_m = trunk_radius_m(caster);
    let up_m = at_m.y + way_m * toward.y / level;
    if way_m < 0.0 || up_m < -0.2 || up_m > 0.8 * caster.height_m {
        return 0.0;
    }
    let soft_m = SUN_RADIUS * way_m / level + blur_m + 0.001;
    return clamp(0.5 + (half_m - beside_m) / (2.0 * soft_m), 0.0, min(1.0, half_m / soft_m));
}

fn unpacked_tree(words: vec4u) -> Caster {
    return Caster(bitcast<vec3f>(words.xyz), f32(words.w & 4095u) / SHAPE_STEPS, f32((words.w >> 12u) & 4095u) / SHAPE_STEPS, (words.w >> 24u) & 3u);
}
