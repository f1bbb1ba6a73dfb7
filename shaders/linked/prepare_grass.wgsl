const NOTHING = vec4u(0u);

fn prepared_grass(words: vec4u) -> vec4u {
    let placed = clump_instance(words);
    let clump = placed.clump;
    let growth = placed.growth;
    if !is_on_land(clump.place) || clump_random(clump) >= smoothstep(0.2, 0.7, growth.meadow) {
        return NOTHING;
    }
    let spot = spot_under(clump.place);
    let push = grown_push(clump.hue, clump.phase) + wind_on(placed) + lean_push(field.lean, placed.root_m, placed.distance_m);
    let dryness = growth.tint.dryness * smoothstep(0.4, 1.0, growth.meadow);
    let place = palette_place(dryness, clump.hue, spot.palette);
    let gust = gust_at(placed.pattern_m / PATTERN_PERIOD_M, frame.time_s);
    let trees = tree_shade(frame, placed.root_m, growth.wood, 0.1);
    let sun = sun_at(spot, placed.pattern_m) * trees.sun;
    return vec4u(packed_size(field, drawn_size_m(placed)), packed_push(push), pack2x16unorm(vec2f(place / 3.0, growth.tint.shade / GREATEST_SHADE)), (pack4x8unorm(vec4f(sun, trees.sky, gust, 0.0)) & 16777215u) | GROWS);
}

@compute @workgroup_size(64)
fn prepare_grass(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let index = clump_of_invocation(lane, group);
    if index != NO_CLUMP {
        prepared[PREPARED_HEAD + index] = prepared_grass(clumps[index]);
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

const BEND_S: f32 = 23.0;

const BEND_WAVES = vec2f(-36.0, 48.0);

const CELLS: u32 = 64u;

const CLEARANCE_RANGE: f32 = 8.0;

const CLEARANCE_ROW_WORDS: u32 = (VERTICES + 3u) / 4u;

const CLEARANCE_WORDS: u32 = CLEARANCE_ROW_WORDS * VERTICES;

const CLOUD_DRIFT_M = vec2f(9.0, 4.0);

const CLOUD_HEIGHT_M: f32 = 1600.0;

const CLUMP_GRID_TILES: u32 = 32u;

const CLUMP_GRID_TILE_BITS: u32 = 19u;

const CROWN_MARGIN_M: f32 = 3.4;

struct Caster {
    root_m: vec3f,
    width_m: f32,
    height_m: f32,
    species: u32
}

struct Clump {
    place: vec3i,
    normal: vec3f,
    width: f32,
    height: f32,
    hue: f32,
    phase: f32,
    rank: u32
}

struct ClumpInstance {
    clump: Clump,
    root_m: vec3f,
    distance_m: f32,
    pattern_m: vec2f,
    growth: Growth
}

struct Crown {
    wide_m: f32,
    rise_m: f32,
    radius_m: f32,
    is_cone: bool,
    density: f32
}

const DRAWS: u32 = 1u;

const FINE_PER_STEP: f32 = 8192.0;

const FLUTTER_S: f32 = 1.15;

const FLUTTER_WAVES = vec2f(1480.0, 480.0);

const FRONT_S: f32 = 4.6;

const FRONT_WAVES = vec2f(160.0, 120.0);

struct Field {
    eye_x: i32,
    eye_y: i32,
    eye_z: i32,
    kind: u32,
    width_low_m: f32,
    width_high_m: f32,
    height_low_m: f32,
    height_high_m: f32,
    thin_from_m: f32,
    widest: f32,
    range_m: f32,
    collapse_m: f32,
    lod_m: vec2f,
    wind: f32,
    lean: f32,
    casts: u32,
    detail: f32,
    stand_m: f32,
    tree_grid_cells: u32
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

const GREATEST_SHADE: f32 = 4.0;

const GROUPS_ACROSS: u32 = 32768u;

const GROWS: u32 = 16777216u;

struct Growth {
    meadow: f32,
    wood: f32,
    tint: MeadowTint,
    groves: f32
}

const LANES: u32 = 64u;

const LOWEST_CAST: f32 = 0.1;

const LOWEST_SUN: f32 = 0.02;

const METRES_PER_FINE: f32 = 1.0 / 4096.0;

struct MeadowTint {
    dryness: f32,
    shade: f32
}

const NO_CHUNK: u32 = 4294967295u;

const NO_CLUMP: u32 = 4294967295u;

const PATTERN_PERIOD_M: f32 = 8192.0;

const PINE: u32 = 1u;

const PREPARED_HEAD: u32 = 7u;

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

const REGIONS: u32 = 6u;

const SHADOWS_HARD: u32 = 1u;

const SHADOWS_OFF: u32 = 0u;

const SHADOW_EDGE_M: f32 = 250.0;

const SHAPE_STEPS: f32 = 64.0;

const SPRUCE: u32 = 0u;

const STRENGTH_S: f32 = 11.0;

const STRENGTH_WAVES = vec2f(32.0, 8.0);

const SUN_RADIUS: f32 = 0.004651;

struct Spot {
    slot: u32,
    palette: u32,
    column: u32,
    row: u32,
    part: vec2f
}

const TREES_CAST: u32 = 2u;

const TREES_FADE: f32 = 0.2;

const TREES_PER_CELL: u32 = 4u;

const TREE_CELL_M: f32 = 8.0;

const TREE_HEAD: u32 = 2u;

const TURN: f32 = 6.2831853;

struct TreeShade {
    sun: f32,
    sky: f32
}

const VERTICES: u32 = 65u;

const WIND = vec2f(0.8, 0.6);

fn beach_at(at: Patterns, height_m: f32, slope: f32) -> f32 {
    let shore_m = height_m + (at.medium - 0.5) * 2.2 + at.fine * 1.7 + at.clumps * 1.2;
    return (1.0 - smoothstep(1.9, 3.0, shore_m)) * (1.0 - smoothstep(0.16, 0.26, slope));
}

@group(0) @binding(3)
var<storage, read> chunks: array<vec4u>;

fn clearance_at(word: u32, column: u32) -> f32 {
    let byte = (word >> (8u * (column & 3u))) & 255u;
    let part = (f32(byte) - 128.0) / 127.0;
    return CLEARANCE_RANGE * part * abs(part);
}

fn clearance_word(slot: u32, column: u32, row: u32) -> u32 {
    return slot * CLEARANCE_WORDS + row * CLEARANCE_ROW_WORDS + (column >> 2u);
}

fn cloud_shade(frame: Frame, pattern_m: vec2f) -> f32 {
    let cast_m = frame.sun.xz * (CLOUD_HEIGHT_M / max(frame.sun.y, LOWEST_CAST));
    let place_m = drifted(frame, pattern_m + cast_m);
    let cover = covered(pattern_fbm_seen(place_m, 2048.0, 21u, SHADOW_EDGE_M), pattern_fbm_seen(place_m, 512.0, 22u, SHADOW_EDGE_M));
    let seen = 1.0 - smoothstep(0.8 * CLOUD_HEIGHT_M, CLOUD_HEIGHT_M, frame.eye_height_m);
    return 1.0 - 0.5 * cover * seen;
}

fn clump_instance(words: vec4u) -> ClumpInstance {
    let clump = unpacked_clump(words);
    let root_m = root_offset_m(field, clump, frame.eye_fraction_m);
    let pattern_m = frame.pattern_eye_m + root_m.xz;
    let growth = growth_at(f32(clump.place.y) * METRES_PER_FINE, clump.normal, pattern_m);
    return ClumpInstance(clump, root_m, length(root_m), pattern_m, growth);
}

fn clump_number(word: u32, shift: u32) -> f32 {
    return f32((word >> shift) & 63u) / 63.0;
}

fn clump_of_invocation(lane: u32, group: vec3u) -> u32 {
    var number = (group.y * GROUPS_ACROSS + group.x) * LANES + lane;
    for (var level = 0u; level < 3u; level++) {
        let count = prepared[DRAWS + level].y;
        if number < count {
            return prepared[REGIONS][level] + number;
        }
        number -= count;
    }
    return NO_CLUMP;
}

fn clump_random(clump: Clump) -> f32 {
    return fract(37.3 * clump.phase + 21.7 * clump.hue + 0.61803399 * f32(clump.rank));
}

@group(0) @binding(11)
var<storage, read> clumps: array<vec4u>;

fn covered(broad: f32, puffs: f32) -> f32 {
    return smoothstep(0.5, 0.78, broad * 0.62 + puffs * 0.38);
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

fn disc_share(clearance: f32) -> f32 {
    let x = clamp(clearance, -1.0, 1.0);
    return clamp(0.5 + (x * sqrt(max(1.0 - x * x, 0.0)) + asin(x)) / 3.14159265, 0.0, 1.0);
}

fn dissolve(frame: Frame, offset_m: vec3f) -> f32 {
    return smoothstep(0.72, 0.98, length(offset_m.xz) / frame.view_distance_m);
}

fn drawn_size_m(placed: ClumpInstance) -> vec2f {
    let size_m = field_size_m(field, placed.clump.width, placed.clump.height);
    return size_m * vec2f(field_widening(field, placed.clump.rank, placed.distance_m), field_height_scale(field, placed.distance_m) * undissolved(frame, placed.root_m));
}

fn drifted(frame: Frame, place_m: vec2f) -> vec2f {
    return place_m - CLOUD_DRIFT_M * frame.time_s;
}

@group(0) @binding(1)
var<uniform> field: Field;

fn field_band(share: f32) -> f32 {
    return min(max(0.25 * share, 1.0 / 256.0), 2.0 * (1.0 - share));
}

fn field_height_scale(field: Field, distance_m: f32) -> f32 {
    let band_m = max(field.collapse_m, 0.001);
    return 1.0 - smoothstep(field.range_m - band_m, field.range_m, distance_m);
}

fn field_presence(share: f32, rank: u32) -> f32 {
    let band = field_band(share);
    let inside = share + 0.5 * band - (f32(rank) + 0.5) / 256.0;
    return clamp(inside / max(band, 1e-6), 0.0, 1.0);
}

fn field_share(field: Field, distance_m: f32) -> f32 {
    return min(1.0, field.thin_from_m / max(distance_m, 0.001));
}

fn field_size_m(field: Field, width: f32, height: f32) -> vec2f {
    return vec2f(mix(field.width_low_m, field.width_high_m, width), mix(field.height_low_m, field.height_high_m, height));
}

fn field_widening(field: Field, rank: u32, distance_m: f32) -> f32 {
    let share = field_share(field, distance_m);
    return min(1.0 / max(share, 1e-6), field.widest) * field_presence(share, rank);
}

@group(0) @binding(0)
var<uniform> frame: Frame;

fn greatest_size_m(field: Field) -> vec2f {
    return vec2f(field.width_high_m * field.widest, field.height_high_m);
}

fn grown_push(hue: f32, phase: f32) -> vec2f {
    let angle = 9.0 * hue + 2.0 * phase;
    return vec2f(cos(angle), sin(angle)) * (0.08 + 0.16 * hue);
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

fn gust_at(turns: vec2f, time_s: f32) -> f32 {
    let bend = sin(TURN * fract(dot(BEND_WAVES, turns) - time_s / BEND_S));
    let since = fract(time_s / FRONT_S - dot(FRONT_WAVES, turns) + 0.15 * bend);
    let front = smoothstep(0.0, 0.12, since) * (1.0 - smoothstep(0.12, 0.95, since));
    let strength = 0.7 + 0.3 * sin(TURN * fract(dot(STRENGTH_WAVES, turns) - time_s / STRENGTH_S));
    return front * strength;
}

fn is_in_tree_grid(side: u32, cell: vec2i) -> bool {
    return all(cell >= vec2i(0)) && all(cell < vec2i(i32(side)));
}

fn is_on_land(place: vec3i) -> bool {
    return nodes[tile_of(place)].z != NO_CHUNK;
}

fn lattice_value(cell: vec2i, mask: i32, salt: u32) -> f32 {
    let wrapped = vec2u(cell & vec2i(mask));
    return f32(pattern_hash(wrapped.x + salt * 2654435769u, wrapped.y) >> 8u) * (1.0 / 16777216.0);
}

fn lean_push(lean: f32, root_offset_m: vec3f, distance_m: f32) -> vec2f {
    let from_eye = root_offset_m / max(distance_m, 0.001);
    let above = clamp(-from_eye.y, 0.0, 1.0);
    return from_eye.xz * (0.9 * lean * above * smoothstep(2.0, 8.0, distance_m));
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

@group(0) @binding(2)
var<storage, read> nodes: array<vec4u>;

fn packed_push(push: vec2f) -> u32 {
    return pack2x16snorm(0.5 * push);
}

fn packed_size(field: Field, size_m: vec2f) -> u32 {
    let share = clamp(size_m / max(greatest_size_m(field), vec2f(1e-6)), vec2f(0.0), vec2f(1.0));
    let words = vec2u(share * 65535.0);
    return words.x | (words.y << 16u);
}

fn palette_place(dryness: f32, hue: f32, region: u32) -> f32 {
    return clamp(2.1 * dryness + 1.1 * hue + 0.08 * f32(region) - 0.17, 0.0, 3.0);
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

@group(0) @binding(12)
var<storage, read_write> prepared: array<vec4u>;

fn rock_at(at: Patterns, slope: f32, summit: f32, height_m: f32) -> vec2f {
    let high = 0.07 * smoothstep(90.0, 300.0, height_m);
    return vec2f(smoothstep(0.165, 0.255, slope), max(smoothstep(0.125, 0.185, slope + high + (at.broad - 0.5) * 0.06 + at.fine * 0.04 + at.clumps * 0.05), summit * 0.8));
}

fn root_offset_m(field: Field, clump: Clump, eye_fraction_m: vec3f) -> vec3f {
    let whole = clump.place - vec3i(field.eye_x, field.eye_y, field.eye_z);
    let fraction = eye_fraction_m / METRES_PER_FINE;
    return (vec3f(whole) - (fraction - floor(fraction + 0.5))) * METRES_PER_FINE;
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

fn spot_of(place: vec3i, slots: vec4u, place_and_corner: vec4u) -> Spot {
    let corner = bitcast<vec2i>(place_and_corner.zw);
    let cells = (vec2f(place.xz) / FINE_PER_STEP - vec2f(corner)) * exp2(-f32(place_and_corner.y & 255u));
    let cell = clamp(floor(cells), vec2f(0.0), vec2f(f32(CELLS - 1u)));
    return Spot(slots.x, (place_and_corner.y >> 16u) & 3u, u32(cell.x), u32(cell.y), clamp(cells - cell, vec2f(0.0), vec2f(1.0)));
}

fn spot_under(place: vec3i) -> Spot {
    let chunk = nodes[tile_of(place)].z;
    return spot_of(place, chunks[2u * chunk], chunks[2u * chunk + 1u]);
}

fn summit_at(at: Patterns, height_m: f32) -> f32 {
    return smoothstep(520.0, 700.0, height_m + (at.medium - 0.5) * 70.0);
}

fn sun_at(spot: Spot, pattern_m: vec2f) -> f32 {
    let above = clearance_word(spot.slot, spot.column, spot.row);
    let beside = clearance_word(spot.slot, spot.column + 1u, spot.row);
    let north = mix(clearance_at(sun_clearances[above], spot.column), clearance_at(sun_clearances[beside], spot.column + 1u), spot.part.x);
    let south = mix(clearance_at(sun_clearances[above + CLEARANCE_ROW_WORDS], spot.column), clearance_at(sun_clearances[beside + CLEARANCE_ROW_WORDS], spot.column + 1u), spot.part.x);
    return sun_share(frame, mix(north, south, spot.part.y)) * cloud_shade(frame, pattern_m);
}

@group(0) @binding(4)
var<storage, read> sun_clearances: array<u32>;

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

fn sun_share(frame: Frame, clearance: f32) -> f32 {
    if frame.shadows == SHADOWS_OFF {
        return 1.0;
    }
    if frame.shadows == SHADOWS_HARD {
        return select(0.0, 1.0, clearance > 0.0);
    }
    return disc_share(clearance);
}

fn tile_of(place: vec3i) -> u32 {
    let tile = vec2u(place.xz) >> vec2u(CLUMP_GRID_TILE_BITS);
    return tile.y * CLUMP_GRID_TILES + tile.x;
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

fn undissolved(frame: Frame, offset_m: vec3f) -> f32 {
    return 1.0 - dissolve(frame, offset_m);
}

fn unpacked_clump(words: vec4u) -> Clump {
    let level = clamp(vec2f(vec2i(words.xy) >> vec2u(24u)) / 127.0, vec2f(-1.0), vec2f(1.0));
    let upright = sqrt(max(1.0 - dot(level, level), 0.05));
    return Clump(vec3i(i32(words.x & 16777215u), bitcast<i32>(words.z), i32(words.y & 16777215u)), normalize(vec3f(level.x, upright, level.y)), clump_number(words.w, 0u), clump_number(words.w, 6u), clump_number(words.w, 12u), clump_number(words.w, 18u), words.w >> 24u);
}

fn unpacked_tree(words: vec4u) -> Caster {
    return Caster(bitcast<vec3f>(words.xyz), f32(words.w & 4095u) / SHAPE_STEPS, f32((words.w >> 12u) & 4095u) / SHAPE_STEPS, (words.w >> 24u) & 3u);
}

fn wind_at(pattern_m: vec2f, phase: f32) -> vec2f {
    return wind_push(field.wind, pattern_m / PATTERN_PERIOD_M, frame.time_s, phase);
}

fn wind_on(placed: ClumpInstance) -> vec2f {
    return wind_at(placed.pattern_m, placed.clump.phase);
}

fn wind_push(wind: f32, turns: vec2f, time_s: f32, phase: f32) -> vec2f {
    let gust = gust_at(turns, time_s);
    let flutter = TURN * fract(dot(FLUTTER_WAVES, turns) - time_s / FLUTTER_S + 0.35 * phase);
    let along = 0.1 + 0.36 * gust + (0.02 + 0.06 * gust) * sin(flutter);
    let across = (0.04 + 0.06 * gust) * cos(flutter);
    return wind * (WIND * along + vec2f(-WIND.y, WIND.x) * across);
}

fn woods_at(at: Patterns, pattern_m: vec2f, height_m: f32, normal: vec3f, slope: f32) -> vec2f {
    let wood_noise = pattern_fbm_seen(pattern_m, 256.0, 4u, at.footprint_m) + (at.medium - 0.5) * 0.25 + at.fine * 0.03 + at.clumps * 0.12 + shelter_at(at, height_m, normal);
    let wood_belt = smoothstep(5.0, 12.0, height_m) * (1.0 - smoothstep(340.0, 430.0, height_m + (at.broad - 0.5) * 90.0));
    let wood = smoothstep(0.47, 0.54, wood_noise) * wood_belt * (1.0 - smoothstep(0.16, 0.26, slope));
    let rim = smoothstep(0.4, 0.47, wood_noise) * wood_belt * (1.0 - smoothstep(0.2, 0.3, slope));
    return vec2f(wood, max(wood, rim * 0.8));
}
