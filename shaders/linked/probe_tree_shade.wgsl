@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(11)
var<storage, read> places: array<vec4f>;

@group(0) @binding(12)
var<storage, read_write> shades: array<vec4f>;

@compute @workgroup_size(64)
fn probe_tree_shade(@builtin(global_invocation_id) id: vec3u) {
    if id.x < arrayLength(&shades) {
        let at_m = places[2u * id.x].xyz;
        let shade = tree_shade(frame, at_m, 0.0, 0.0);
        let growth = growth_at(frame.eye_height_m + at_m.y, places[2u * id.x + 1u].xyz, frame.pattern_eye_m + at_m.xz);
        let mean = mean_tree_sun(tree_cells[0], growth.wood, frame.sun);
        shades[id.x] = vec4f(shade.sun, shade.sky, mean, growth.wood);
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

struct Growth {
    meadow: f32,
    wood: f32,
    tint: MeadowTint,
    groves: f32
}

const LOWEST_SUN: f32 = 0.02;

struct MeadowTint {
    dryness: f32,
    shade: f32
}

const PATTERN_PERIOD_M: f32 = 8192.0;

const PINE: u32 = 1u;

struct Patterns {
    turned_m: vec2f,
    footprint_m: f32,
    broad: f32,
    medium: f32,
    fine: f32,
    clumps: f32,
    tufts: f32
}

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

const TREES_FADE: f32 = 0.2;

const TREES_PER_CELL: u32 = 4u;

const TREE_CELL_M: f32 = 8.0;

const TREE_HEAD: u32 = 2u;

struct TreeShade {
    sun: f32,
    sky: f32
}

fn beach_at(at: Patterns, height_m: f32, slope: f32) -> f32 {
    let shore_m = height_m + (at.medium - 0.5) * 2.2 + at.fine * 1.7 + at.clumps * 1.2;
    return (1.0 - smoothstep(1.9, 3.0, shore_m)) * (1.0 - smoothstep(0.16, 0.26, slope));
}

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

fn growth_at(height_m: f32, normal: vec3f, pattern_m: vec2f) -> Growth {
    let at = patterns_at(pattern_m, 0.0);
    let slope = slope_of(at, normal);
    let rock = rock_at(at, slope, summit_at(at, height_m), height_m);
    let soil = (1.0 - beach_at(at, height_m, slope)) * (1.0 - rock.x) * (1.0 - track_at(at, height_m, 1.0 - normal.y, 0.0)) * (1.0 - rock.y);
    let woods = woods_at(at, pattern_m, height_m, normal, slope);
    let groves = 3.5 * smoothstep(0.52, 0.68, at.medium);
    return Growth(soil * (1.0 - woods.y), soil * woods.x, meadow_tint_at(at, height_m), groves);
}

fn is_in_tree_grid(side: u32, cell: vec2i) -> bool {
    return all(cell >= vec2i(0)) && all(cell < vec2i(i32(side)));
}

fn lattice_value(cell: vec2i, mask: i32, salt: u32) -> f32 {
    let wrapped = vec2u(cell & vec2i(mask));
    return f32(pattern_hash(wrapped.x + salt * 2654435769u, wrapped.y) >> 8u) * (1.0 / 16777216.0);
}

fn meadow_tint_at(at: Patterns, height_m: f32) -> MeadowTint {
    return MeadowTint(smoothstep(0.42, 0.68, at.broad + height_m * 0.0002 + (at.medium - 0.5) * 0.3 + at.clumps * 0.45), (0.82 + 0.36 * at.medium) * max(1.0 + 0.35 * at.fine + 0.9 * at.clumps + 0.9 * at.tufts, 0.2));
}

fn mean_tree_sun(head: vec4u, wood: f32, sun: vec3f) -> f32 {
    if (head.w & TREES_CAST) == 0u {
        return 1.0;
    }
    let lean = length(sun.xz) / max(sun.y, 0.05);
    let area = 3.14159265 * 2.0 * sqrt(4.0 + 12.25 * lean * lean) / (TREE_CELL_M * TREE_CELL_M);
    return exp(-0.8 * area * f32(head.z) * wood);
}

fn pattern(position_m: vec2f, cell_m: f32, salt: u32) -> f32 {
    return pattern_gradient(position_m, cell_m, salt).x;
}

fn pattern_fbm(position_m: vec2f, cell_m: f32, salt: u32) -> f32 {
    var p = position_m;
    var sum = 0.0;
    var weight = 0.5333;
    for (var octave = 0u; octave < 4u; octave++) {
        sum += weight * pattern(p, cell_m, salt + octave);
        p = vec2f(2.0 * p.x + p.y, 2.0 * p.y - p.x);
        weight *= 0.5;
    }
    return sum;
}

fn pattern_fbm_seen(position_m: vec2f, cell_m: f32, salt: u32, footprint_m: f32) -> f32 {
    var p = position_m;
    var size_m = cell_m;
    var sum = 0.5;
    var weight = 0.5333;
    for (var octave = 0u; octave < 4u; octave++) {
        let seen = clamp(1.5 - 1.5 * footprint_m / size_m, 0.0, 1.0);
        if seen <= 0.0 {
            break;
        }
        sum += weight * seen * (pattern(p, cell_m, salt + octave) - 0.5);
        p = vec2f(2.0 * p.x + p.y, 2.0 * p.y - p.x);
        size_m *= 0.4472136;
        weight *= 0.5;
    }
    return sum;
}

fn pattern_gradient(position_m: vec2f, cell_m: f32, salt: u32) -> vec3f {
    let p = position_m / cell_m;
    let low = floor(p);
    let f = p - low;
    let cell = vec2i(low);
    let mask = i32(PATTERN_PERIOD_M / cell_m) - 1;
    let a = lattice_value(cell, mask, salt);
    let b = lattice_value(cell + vec2i(1, 0), mask, salt);
    let c = lattice_value(cell + vec2i(0, 1), mask, salt);
    let d = lattice_value(cell + vec2i(1, 1), mask, salt);
    let u = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let du = 30.0 * f * f * (f * (f - 2.0) + 1.0);
    let value = mix(mix(a, b, u.x), mix(c, d, u.x), u.y);
    let gradient = du * vec2f(mix(b - a, d - c, u.y), mix(c - a, d - b, u.x)) / cell_m;
    return vec3f(value, gradient);
}

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = (x * 1664525u + y * 22695477u + 1013904223u) * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn patterns_at(pattern_m: vec2f, footprint_m: f32) -> Patterns {
    let turned_m = vec2f(2.0 * pattern_m.x + pattern_m.y, 2.0 * pattern_m.y - pattern_m.x);
    let broad = pattern_fbm_seen(pattern_m, 512.0, 1u, footprint_m);
    let medium = pattern_fbm_seen(pattern_m, 64.0, 2u, footprint_m);
    let near = clamp(1.5 - footprint_m * 0.75, 0.0, 1.0);
    let fine = (pattern(turned_m, 4.0, 3u) - 0.5) * near;
    var clumps = 0.0;
    if footprint_m < 6.0 {
        clumps = (pattern_fbm(turned_m, 32.0, 15u) - 0.5) * clamp(1.5 - footprint_m * 0.25, 0.0, 1.0);
    }
    var tufts = 0.0;
    if footprint_m < 1.0 {
        tufts = (pattern(turned_m, 2.0, 33u) - 0.5) * clamp(2.0 - 2.0 * footprint_m, 0.0, 1.0);
    }
    if footprint_m < 0.5 {
        tufts += (pattern(turned_m, 1.0, 34u) - 0.5) * clamp(1.0 - 2.0 * footprint_m, 0.0, 0.5);
    }
    return Patterns(turned_m, footprint_m, broad, medium, fine, clumps, tufts);
}

fn rock_at(at: Patterns, slope: f32, summit: f32, height_m: f32) -> vec2f {
    let high = 0.07 * smoothstep(90.0, 300.0, height_m);
    return vec2f(smoothstep(0.165, 0.255, slope), max(smoothstep(0.125, 0.185, slope + high + (at.broad - 0.5) * 0.06 + at.fine * 0.04 + at.clumps * 0.05), summit * 0.8));
}

fn shelter_at(at: Patterns, height_m: f32, normal: vec3f) -> f32 {
    let plain = (1.0 - smoothstep(0.0015, 0.01, 1.0 - normal.y)) * (1.0 - smoothstep(20.0, 45.0, height_m));
    return (at.broad - 0.5) * 0.25 - normal.z * 0.25 - plain * 0.09 - smoothstep(120.0, 340.0, height_m) * 0.16;
}

fn single_shadows(sun: vec3f) -> f32 {
    return smoothstep(LOWEST_SUN, 3.0 * LOWEST_SUN, sun.y);
}

fn sky_past(caster: Caster, point_m: vec3f) -> f32 {
    let at_m = point_m.xz - caster.root_m.xz;
    let square = dot(at_m, at_m);
    let radius_m = max(crown_of(caster).radius_m, 0.1);
    let trunk_m = 3.0 * max(trunk_radius_m(caster), 0.01);
    return (1.0 - 0.42 * exp(-square / (1.7 * radius_m * radius_m))) * (1.0 - 0.35 * exp(-square / (trunk_m * trunk_m)));
}

fn sky_past_trees(point_m: vec3f, cell: vec2i) -> f32 {
    let grid = tree_cells[1].z;
    var left = 1.0;
    for (var part = 0; part < 9; part++) {
        let beside = cell + vec2i(part % 3 - 1, part / 3 - 1);
        if !is_in_tree_grid(grid, beside) {
            continue;
        }
        let base = TREE_HEAD + tree_index(grid, beside, 0u);
        for (var number = 0u; number < TREES_PER_CELL; number++) {
            let words = tree_cells[base + number];
            if words.w == 0u {
                break;
            }
            left *= sky_past(unpacked_tree(words), point_m);
        }
    }
    return left;
}

fn slope_of(at: Patterns, normal: vec3f) -> f32 {
    return 1.0 - normal.y + (at.medium - 0.5) * 0.07 + at.fine * 0.02;
}

fn summit_at(at: Patterns, height_m: f32) -> f32 {
    return smoothstep(520.0, 700.0, height_m + (at.medium - 0.5) * 70.0);
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

fn track_at(at: Patterns, height_m: f32, steep: f32, long_m: f32) -> f32 {
    let wander = pattern_gradient(at.turned_m, 1024.0, 13u) + vec3f(0.06, vec2f(0.06)) * (pattern_gradient(at.turned_m, 128.0, 14u) - vec3f(0.5, 0.0, 0.0));
    let off_track_m = abs(wander.x - 0.5) / max(length(wander.yz) * 2.236, 0.0001);
    let ragged_m = 1.25 + at.fine * 1.1 + (at.medium - 0.5) * 0.8;
    let blur_m = max(0.35, long_m * 0.6);
    return (1.0 - smoothstep(ragged_m - blur_m, ragged_m + blur_m, off_track_m)) * min(2.6 / max(long_m, 0.1), 1.0) * (1.0 - smoothstep(0.035, 0.06, steep)) * smoothstep(3.0, 4.5, height_m) * (1.0 - smoothstep(140.0, 180.0, height_m)) * smoothstep(0.0002, 0.0005, length(wander.yz));
}

fn tree_cell_index(side: u32, cell: vec2i) -> u32 {
    return u32(cell.y) * side + u32(cell.x);
}

@group(0) @binding(8)
var<storage, read> tree_cells: array<vec4u>;

fn tree_index(side: u32, cell: vec2i, number: u32) -> u32 {
    return tree_cell_index(side, cell) * TREES_PER_CELL + number;
}

@group(0) @binding(9)
var<storage, read> tree_marks: array<u32>;

fn tree_place(offset_m: vec2f) -> vec2f {
    return (bitcast<vec2f>(tree_cells[0].xy) + offset_m) / TREE_CELL_M;
}

fn tree_shade(frame: Frame, point_m: vec3f, wood: f32, blur_m: f32) -> TreeShade {
    let head = tree_cells[0];
    if (head.w & TREES_CAST) == 0u {
        return TreeShade(1.0, 1.0);
    }
    let away_m = length(point_m.xz);
    let known_m = bitcast<f32>(tree_cells[1].y);
    let known = 1.0 - smoothstep((1.0 - TREES_FADE) * known_m, known_m, away_m);
    let single = known * single_shadows(frame.sun);
    var shade = TreeShade(1.0, 1.0);
    if single < 1.0 {
        let range_m = bitcast<f32>(tree_cells[1].x);
        let stand = wood * (1.0 - smoothstep(0.75 * range_m, range_m, away_m));
        let sun = mean_tree_sun(head, stand, frame.sun);
        shade = TreeShade(sun, 1.0 - 0.3 * min(f32(head.z) * stand, 1.5));
    }
    if known <= 0.0 {
        return shade;
    }
    var here = TreeShade(1.0, 1.0);
    let cell = vec2i(floor(tree_place(point_m.xz)));
    let grid = tree_cells[1].z;
    if is_in_tree_grid(grid, cell) {
        let mark = tree_marks[tree_cell_index(grid, cell)];
        if mark > 0u {
            here.sun = sun_past_trees(point_m, frame.sun, mark - 1u, blur_m, vec2f(1000000000.0));
            here.sky = sky_past_trees(point_m, cell);
        }
    }
    return TreeShade(mix(shade.sun, here.sun, single), mix(shade.sky, here.sky, known));
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

fn woods_at(at: Patterns, pattern_m: vec2f, height_m: f32, normal: vec3f, slope: f32) -> vec2f {
    let wood_noise = pattern_fbm_seen(pattern_m, 256.0, 4u, at.footprint_m) + (at.medium - 0.5) * 0.25 + at.fine * 0.03 + at.clumps * 0.12 + shelter_at(at, height_m, normal);
    let wood_belt = smoothstep(5.0, 12.0, height_m) * (1.0 - smoothstep(340.0, 430.0, height_m + (at.broad - 0.5) * 90.0));
    let wood = smoothstep(0.47, 0.54, wood_noise) * wood_belt * (1.0 - smoothstep(0.16, 0.26, slope));
    let rim = smoothstep(0.4, 0.47, wood_noise) * wood_belt * (1.0 - smoothstep(0.2, 0.3, slope));
    return vec2f(wood, max(wood, rim * 0.8));
}
