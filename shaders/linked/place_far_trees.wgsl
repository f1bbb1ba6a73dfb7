@group(1) @binding(0)
var<uniform> frame: Frame;

@group(1) @binding(1)
var<uniform> field: Field;

@group(1) @binding(2)
var<uniform> far: FarTrees;

@group(1) @binding(3)
var<storage, read> patches: array<vec2u>;

@group(1) @binding(4)
var<storage, read_write> state: array<u32>;

@group(1) @binding(5)
var<storage, read_write> trees: array<vec4u>;

@group(1) @binding(6)
var<storage, read> sun_clearances: array<u32>;

const SCAN_LANES: u32 = 256u;

const VERTICES_OF_TREE: u32 = 6u;

var<workgroup> mask: array<atomic<u32>, 8>;

var<workgroup> sums: array<u32, 256>;

struct FarTree {
    grows: bool,
    clump: Clump,
    root_m: vec3f,
    pattern_m: vec2f,
    growth: Growth
}

fn height_on(chunk: OccluderChunk, x: i32, z: i32) -> i32 {
    let spot = spot_of(chunk, x, z);
    if is_block_rough(chunk, block_around(spot.low)) {
        return on_rough(chunk, spot);
    }
    return on_cell(chunk, spot);
}

fn density_on(chunk: OccluderChunk, x: i32, z: i32, random_word: u32) -> u32 {
    let east = x + (i32(random_word & 255u) - 128) * 128;
    let south = z + (i32((random_word >> 8u) & 255u) - 128) * 128;
    let shift = (chunk.words.place & 255u) + 2u;
    let column = u32(clamp(((east >> STEP_BITS) - chunk.x) >> shift, 0, 15));
    let row = u32(clamp(((south >> STEP_BITS) - chunk.z) >> shift, 0, 15));
    let word = records[chunk.words.slot * RECORD_WORDS + BLOCK_TEXELS + row * 4u + (column >> 2u)];
    let share = (word >> (8u * (column & 3u))) & 255u;
    return min(2u * (share + (share >> 7u)), 256u);
}

fn normal_on(chunk: OccluderChunk, x: i32, z: i32) -> vec3f {
    let step = 1 << STEP_BITS;
    let corner = vec2i(chunk.x, chunk.z) << vec2u(STEP_BITS);
    let side = i32(CELLS) << (STEP_BITS + (chunk.words.place & 255u));
    let low = max(vec2i(x, z) - step, corner);
    let high = min(vec2i(x, z) + step, corner + side - 1);
    let slope = vec2f(f32(height_on(chunk, low.x, z) - height_on(chunk, high.x, z)), f32(height_on(chunk, x, low.y) - height_on(chunk, x, high.y))) * (2.0 * f32(step) / vec2f(high - low));
    let normal = normalize(vec3f(slope.x, 2.0 * f32(step), slope.y));
    let level = round(normal.xz * 127.0) / 127.0;
    return normalize(vec3f(level.x, sqrt(max(1.0 - dot(level, level), 0.05)), level.y));
}

fn number_of(word: u32) -> f32 {
    return f32(word >> 26u) / 63.0;
}

fn far_tree(chunk: OccluderChunk, cell: vec2i, number: u32) -> FarTree {
    var tree: FarTree;
    let random = clump_attributes(planting.seed, KIND_TREES, planting.cell_x + cell.x, planting.cell_z + cell.y, number);
    let rank = min((number * 256u + ((random.survival >> 8u) & 255u)) / max(planting.per_cell, 1u), 255u);
    let place = vec2i(vec2u(random.place, random.place >> 16u) & vec2u((1u << planting.cell_bits) - 1u)) + (cell << vec2u(planting.cell_bits));
    let level_m = vec2f(place - culling.eye.xz) * METRES_PER_FINE;
    if !field_keeps(field, rank, length(level_m)) || (random.survival & 255u) >= density_on(chunk, place.x, place.y, mix_bits(random.survival)) {
        return tree;
    }
    let y = height_on(chunk, place.x, place.y);
    tree.clump = Clump(vec3i(place.x, y, place.y), normal_on(chunk, place.x, place.y), number_of(random.width), number_of(random.height), number_of(random.hue), number_of(random.phase), rank);
    tree.root_m = root_offset_m(field, tree.clump, frame.eye_fraction_m);
    let away_m = length(tree.root_m);
    if away_m < far.begin_m || !field_keeps(field, rank, away_m) {
        return tree;
    }
    tree.pattern_m = frame.pattern_eye_m + tree.root_m.xz;
    tree.growth = growth_at(f32(y) * METRES_PER_FINE, tree.clump.normal, tree.pattern_m);
    tree.grows = tree_grows(tree.clump, tree.growth);
    return tree;
}

fn cell_of(listed: vec2u, lane: u32) -> vec2i {
    let first = vec2u(listed.y & 65535u, listed.y >> 16u) * FAR_PATCH_CELLS;
    return vec2i(first + vec2u(lane % FAR_PATCH_CELLS, lane / FAR_PATCH_CELLS));
}

fn per_cell() -> u32 {
    return min(planting.per_cell, TREES_PER_CELL);
}

@compute @workgroup_size(64)
fn count_far_trees(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let listed = patches[group.x];
    let chunk = chunks[listed.x];
    var own = 0u;
    for (var number = 0u; number < per_cell(); number++) {
        let tree = far_tree(chunk, cell_of(listed, lane), number);
        own |= select(0u, 1u << number, tree.grows);
    }
    atomicOr(&mask[lane / 8u], own << (4u * (lane % 8u)));
    workgroupBarrier();
    if lane < FAR_MASK_WORDS {
        let word = atomicLoad(&mask[lane]);
        state[FAR_MASKS + group.x * FAR_MASK_WORDS + lane] = word;
        sums[lane] = countOneBits(word);
    }
    workgroupBarrier();
    if lane == 0u {
        var all = 0u;
        for (var word = 0u; word < FAR_MASK_WORDS; word++) {
            all += sums[word];
        }
        state[FAR_COUNTS + group.x] = all;
    }
}

fn inclusive_scan(lane: u32, own: u32) -> u32 {
    workgroupBarrier();
    sums[lane] = own;
    for (var reach = 1u; reach < SCAN_LANES; reach *= 2u) {
        workgroupBarrier();
        let below = select(0u, sums[max(lane, reach) - reach], lane >= reach);
        workgroupBarrier();
        sums[lane] += below;
    }
    workgroupBarrier();
    return sums[lane];
}

@compute @workgroup_size(256)
fn scan_far_trees(@builtin(local_invocation_index) lane: u32) {
    var total = 0u;
    let rounds = (far.patches + SCAN_LANES - 1u) / SCAN_LANES;
    for (var n = 0u; n < rounds; n++) {
        let index = n * SCAN_LANES + lane;
        let has = state[FAR_COUNTS + min(index, max(far.patches, 1u) - 1u)];
        let own = select(0u, has, index < far.patches);
        let upto = inclusive_scan(lane, own);
        if index < far.patches {
            state[FAR_COUNTS + index] = total + upto - own;
        }
        total += sums[SCAN_LANES - 1u];
    }
    if lane == 0u {
        let drawn = min(total, far.room);
        state[0] = VERTICES_OF_TREE;
        state[1] = drawn;
        state[2] = 0u;
        state[3] = 0u;
        state[FAR_LOST] = total - drawn;
    }
}

fn land_sun(chunk: OccluderChunk, spot: Spot, pattern_m: vec2f) -> f32 {
    let slot = chunk.words.slot;
    let part = vec2f(f32(spot.east), f32(spot.south)) / f32(1 << spot.bits);
    let at = vec2u(spot.low.column, spot.low.row);
    let next = at + vec2u(spot.stride);
    let clearance = mix(mix(clearance_of(slot, at.x, at.y), clearance_of(slot, next.x, at.y), part.x), mix(clearance_of(slot, at.x, next.y), clearance_of(slot, next.x, next.y), part.x), part.y);
    return sun_share(frame, clearance) * cloud_shade(frame, pattern_m);
}

fn clearance_of(slot: u32, column: u32, row: u32) -> f32 {
    return clearance_at(sun_clearances[clearance_word(slot, column, row)], column);
}

fn tree_light(wood: f32) -> vec3f {
    let casts = select(0u, TREES_CAST, field.casts != 0u && frame.shadows != SHADOWS_OFF);
    let mean = mean_tree_sun(vec4u(0u, 0u, planting.per_cell, casts), wood, frame.sun);
    return mix(vec3f(1.0), vec3f(mean, 0.5 + 0.5 * mean, 1.0), 0.7);
}

fn write_tree(index: u32, chunk: OccluderChunk, tree: FarTree) {
    let species = tree_species(tree.clump);
    let away_m = length(tree.root_m);
    let size_m = tree_size_m(species, field_size_m(field, tree.clump.width, tree.clump.height)) * vec2f(field_widening(field, tree.clump.rank, away_m), field_height_scale(field, away_m) * undissolved(frame, tree.root_m));
    let place = tree.clump.place;
    let sun = land_sun(chunk, spot_of(chunk, place.x, place.z), tree.pattern_m);
    let light = vec4f(tree_light(tree.growth.wood), sun);
    trees[2u * index] = vec4u(bitcast<vec3u>(tree.root_m), packed_shape(size_m.x, size_m.y, species));
    trees[2u * index + 1u] = vec4u(pack4x8unorm(light), bitcast<u32>(tree.clump.phase), 0u, 0u);
}

@compute @workgroup_size(64)
fn write_far_trees(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let listed = patches[group.x];
    let chunk = chunks[listed.x];
    let masks = FAR_MASKS + group.x * FAR_MASK_WORDS;
    var index = state[FAR_COUNTS + group.x];
    for (var word = 0u; word < lane / 8u; word++) {
        index += countOneBits(state[masks + word]);
    }
    let word = state[masks + lane / 8u];
    let shift = 4u * (lane % 8u);
    index += countOneBits(word & ((1u << shift) - 1u));
    for (var number = 0u; number < per_cell(); number++) {
        if ((word >> (shift + number)) & 1u) != 0u {
            if index < far.room {
                write_tree(index, chunk, far_tree(chunk, cell_of(listed, lane), number));
            }
            index += 1u;
        }
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

const BLOCK_TEXELS: u32 = 85u;

const BROADLEAF: u32 = 2u;

const CELLS: u32 = 64u;

const CLEARANCE_RANGE: f32 = 8.0;

const CLEARANCE_ROW_WORDS: u32 = (VERTICES + 3u) / 4u;

const CLEARANCE_WORDS: u32 = CLEARANCE_ROW_WORDS * VERTICES;

const CLOUD_DRIFT_M = vec2f(9.0, 4.0);

const CLOUD_HEIGHT_M: f32 = 1600.0;

struct ChunkWords {
    slot: u32,
    parent_slot: u32,
    edges: u32,
    corners: u32,
    inside: u32,
    place: u32
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

struct Culling {
    eye: vec3i,
    path: u32,
    planes: array<vec4i, 4>,
    start: i32,
    occlusion_enabled: u32,
    step: i32,
    stay: u32,
    corner: vec2i,
    frame: u32,
    archipelago_seed: u32,
    land_seeds: array<vec4u, 4>,
    stretch: i32
}

const DECIMATED: u32 = 4096u;

const FAR_COUNTS: u32 = 8u;

const FAR_LOST: u32 = 4u;

const FAR_MASKS: u32 = 32776u;

const FAR_MASK_WORDS: u32 = 8u;

const FAR_PATCH_CELLS: u32 = 8u;

const FINE_UNIT_BITS: u32 = 4u;

struct FarTrees {
    patches: u32,
    room: u32,
    begin_m: f32,
    reserved: u32
}

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

struct GridVertex {
    column: u32,
    row: u32
}

struct Growth {
    meadow: f32,
    wood: f32,
    tint: MeadowTint,
    groves: f32
}

const KIND_TREES: u32 = 1u;

const LOWEST_CAST: f32 = 0.1;

const METRES_PER_FINE: f32 = 1.0 / 4096.0;

const MORPH_BAND: u32 = 1u;

const MORPH_BAND_BITS: u32 = 0u;

struct MeadowTint {
    dryness: f32,
    shade: f32
}

const NOWHERE: i32 = -33554432;

struct OccluderChunk {
    words: ChunkWords,
    x: i32,
    z: i32
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

struct Planting {
    kind: u32,
    seed: u32,
    cell_bits: u32,
    per_cell: u32,
    cell_x: i32,
    cell_z: i32,
    width_low: i32,
    width_span: i32,
    height_low: i32,
    height_span: i32,
    thin_from: i32,
    widest: u32,
    reach: i32,
    over: i32,
    range: i32,
    collapse: i32,
    detail: vec2u,
    wind_reach: i32,
    lean_reach: i32,
    draw_distance_squared: array<vec4u, 64>,
    vertices: vec4u,
    room: vec4u
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

const RECORD_WORDS: u32 = 149u;

struct RandomAttributes {
    place: u32,
    width: u32,
    height: u32,
    hue: u32,
    phase: u32,
    survival: u32
}

const SHADOWS_HARD: u32 = 1u;

const SHADOWS_OFF: u32 = 0u;

const SHADOW_EDGE_M: f32 = 250.0;

const SHAPE_STEPS: f32 = 64.0;

const SOLITARY: f32 = 0.04;

const SPRUCE: u32 = 0u;

const STEP_BITS: u32 = 13u;

struct Seams {
    edges: u32,
    corners: u32,
    inside: u32
}

struct Spot {
    low: GridVertex,
    stride: u32,
    bits: u32,
    east: i32,
    south: i32
}

const TREES_CAST: u32 = 2u;

const TREES_PER_CELL: u32 = 4u;

const TREE_CELL_M: f32 = 8.0;

const VERTEX_COUNT: u32 = 4225u;

const VERTICES: u32 = 65u;

fn beach_at(at: Patterns, height_m: f32, slope: f32) -> f32 {
    let shore_m = height_m + (at.medium - 0.5) * 2.2 + at.fine * 1.7 + at.clumps * 1.2;
    return (1.0 - smoothstep(1.9, 3.0, shore_m)) * (1.0 - smoothstep(0.16, 0.26, slope));
}

fn block_around(cell: GridVertex) -> GridVertex {
    return GridVertex(cell.column & ~1u, cell.row & ~1u);
}

fn block_vertex(chunk: OccluderChunk, block: GridVertex, east: u32, south: u32) -> vec3i {
    let vertex = GridVertex(block.column + east, block.row + south);
    let at = snapped(seams_of(chunk.words), vertex);
    let height = drawn_vertex(chunk, vertex) << FINE_UNIT_BITS;
    return vec3i(i32(at.column) - i32(block.column), i32(at.row) - i32(block.row), height);
}

fn cell_corner(chunk: OccluderChunk, spot: Spot, east: u32, south: u32) -> i32 {
    let vertex = GridVertex(spot.low.column + east * spot.stride, spot.low.row + south * spot.stride);
    return drawn_vertex(chunk, vertex) << FINE_UNIT_BITS;
}

@group(0) @binding(6)
var<storage, read> chunks: array<OccluderChunk>;

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

fn clump_attributes(seed: u32, kind: u32, x: i32, z: i32, index: u32) -> RandomAttributes {
    let random = pcg4d(vec4u(bitcast<u32>(x), bitcast<u32>(z), index ^ (kind << 16u), seed));
    return RandomAttributes(random.x, random.y, random.z, random.w, mix_bits(mix_bits(random.x ^ 1757159915u) ^ random.w), mix_bits(mix_bits(random.y ^ 48610963u) ^ random.z));
}

fn clump_random(clump: Clump) -> f32 {
    return fract(37.3 * clump.phase + 21.7 * clump.hue + 0.61803399 * f32(clump.rank));
}

fn covered(broad: f32, puffs: f32) -> f32 {
    return smoothstep(0.5, 0.78, broad * 0.62 + puffs * 0.38);
}

@group(0) @binding(0)
var<uniform> culling: Culling;

fn disc_share(clearance: f32) -> f32 {
    let x = clamp(clearance, -1.0, 1.0);
    return clamp(0.5 + (x * sqrt(max(1.0 - x * x, 0.0)) + asin(x)) / 3.14159265, 0.0, 1.0);
}

fn dissolve(frame: Frame, offset_m: vec3f) -> f32 {
    return smoothstep(0.72, 0.98, length(offset_m.xz) / frame.view_distance_m);
}

fn drawn_vertex(chunk: OccluderChunk, vertex: GridVertex) -> i32 {
    if (chunk.words.edges | chunk.words.corners | chunk.words.inside) == 0u {
        return slot_height(chunk.words.slot, vertex.column, vertex.row);
    }
    let seams = seams_of(chunk.words);
    let at = snapped(seams, vertex);
    let own = slot_height(chunk.words.slot, at.column, at.row);
    let morph = morph_at(seams, at);
    if morph == 0 {
        return own;
    }
    let half = CELLS / 2u;
    let column = ((chunk.words.place >> 8u) & 1u) * half + (at.column >> 1u);
    let row = ((chunk.words.place >> 9u) & 1u) * half + (at.row >> 1u);
    let first = slot_height(chunk.words.parent_slot, column, row);
    let second = slot_height(chunk.words.parent_slot, column + (at.column & 1u), row + (at.row & 1u));
    return morphed(own, (first + second) >> 1u, morph);
}

fn drifted(frame: Frame, place_m: vec2f) -> vec2f {
    return place_m - CLOUD_DRIFT_M * frame.time_s;
}

fn field_band(share: f32) -> f32 {
    return min(max(0.25 * share, 1.0 / 256.0), 2.0 * (1.0 - share));
}

fn field_height_scale(field: Field, distance_m: f32) -> f32 {
    let band_m = max(field.collapse_m, 0.001);
    return 1.0 - smoothstep(field.range_m - band_m, field.range_m, distance_m);
}

fn field_keeps(field: Field, rank: u32, distance_m: f32) -> bool {
    return distance_m < field.range_m && field_presence(field_share(field, distance_m), rank) > 0.0;
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

fn growth_at(height_m: f32, normal: vec3f, pattern_m: vec2f) -> Growth {
    let at = patterns_at(pattern_m, 0.0);
    let slope = slope_of(at, normal);
    let rock = rock_at(at, slope, summit_at(at, height_m), height_m);
    let soil = (1.0 - beach_at(at, height_m, slope)) * (1.0 - rock.x) * (1.0 - track_at(at, height_m, 1.0 - normal.y, 0.0)) * (1.0 - rock.y);
    let woods = woods_at(at, pattern_m, height_m, normal, slope);
    let groves = 3.5 * smoothstep(0.52, 0.68, at.medium);
    return Growth(soil * (1.0 - woods.y), soil * woods.x, meadow_tint_at(at, height_m), groves);
}

@group(0) @binding(2)
var<storage, read> heights: array<i32>;

fn is_block_rough(chunk: OccluderChunk, block: GridVertex) -> bool {
    let coarser = chunk.words.inside >> 8u;
    let last = CELLS - 2u;
    if (chunk.words.inside & DECIMATED) != 0u {
        return false;
    }
    return ((coarser & 1u) != 0u && block.row == 0u) || ((coarser & 2u) != 0u && block.column == last) || ((coarser & 4u) != 0u && block.row == last) || ((coarser & 8u) != 0u && block.column == 0u);
}

fn is_decimated(seams: Seams) -> bool {
    return (seams.inside & 4096u) != 0u;
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

fn mix_bits(seed: u32) -> u32 {
    var h = seed;
    h ^= h >> 16u;
    h *= 569420461u;
    h ^= h >> 15u;
    h *= 3545902487u;
    return h ^ (h >> 15u);
}

fn morph_at(seams: Seams, vertex: GridVertex) -> i32 {
    let east = vertex.column > CELLS / 2u;
    let south = vertex.row > CELLS / 2u;
    let from_x = select(vertex.column, CELLS - vertex.column, east);
    let from_z = select(vertex.row, CELLS - vertex.row, south);
    let near_x = i32(MORPH_BAND - min(from_x, MORPH_BAND));
    let near_z = i32(MORPH_BAND - min(from_z, MORPH_BAND));
    let far_x = i32(MORPH_BAND) - near_x;
    let far_z = i32(MORPH_BAND) - near_z;
    let corner = morph_byte(seams.corners, u32(east) + 2u * u32(south));
    let edge_x = morph_byte(seams.edges, select(3u, 1u, east));
    let edge_z = morph_byte(seams.edges, select(0u, 2u, south));
    let inside = morph_byte(seams.inside, 0u);
    let sum = near_z * (near_x * corner + far_x * edge_z) + far_z * (near_x * edge_x + far_x * inside);
    return sum >> (2u * MORPH_BAND_BITS);
}

fn morph_byte(word: u32, index: u32) -> i32 {
    return i32((word >> (8u * index)) & 255u);
}

fn morphed(own: i32, parent: i32, morph: i32) -> i32 {
    return own + (((parent - own) * morph) >> 6u);
}

fn mul_hi(a: i32, b: i32) -> i32 {
    let product = bitcast<i32>(mul_hi_u(bitcast<u32>(a), bitcast<u32>(b)));
    return product - ((a >> 31u) & b) - ((b >> 31u) & a);
}

fn mul_hi_u(a: u32, b: u32) -> u32 {
    let a_low = a & 65535u;
    let a_high = a >> 16u;
    let b_low = b & 65535u;
    let b_high = b >> 16u;
    let first = a_high * b_low + ((a_low * b_low) >> 16u);
    let second = a_low * b_high + (first & 65535u);
    return a_high * b_high + (first >> 16u) + (second >> 16u);
}

fn on_cell(chunk: OccluderChunk, spot: Spot) -> i32 {
    let low = cell_corner(chunk, spot, 0u, 0u);
    let high = cell_corner(chunk, spot, 1u, 1u);
    if spot.east >= spot.south {
        let side = cell_corner(chunk, spot, 1u, 0u);
        return low + part_of(side - low, spot.east, spot.bits) + part_of(high - side, spot.south, spot.bits);
    }
    let side = cell_corner(chunk, spot, 0u, 1u);
    return low + part_of(side - low, spot.south, spot.bits) + part_of(high - side, spot.east, spot.bits);
}

fn on_rough(chunk: OccluderChunk, spot: Spot) -> i32 {
    let block = block_around(spot.low);
    let east = spot.east + (i32(spot.low.column & 1u) << spot.bits);
    let south = spot.south + (i32(spot.low.row & 1u) << spot.bits);
    for (var triangle = 0u; triangle < 8u; triangle++) {
        let column = (triangle >> 1u) & 1u;
        let row = triangle >> 2u;
        let upper = triangle & 1u;
        let a = block_vertex(chunk, block, column, row);
        let b = block_vertex(chunk, block, column + 1u - upper, row + upper);
        let c = block_vertex(chunk, block, column + 1u, row + 1u);
        let area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
        if area == 0 {
            continue;
        }
        let way = sign(area);
        let from_x = east - (a.x << spot.bits);
        let from_z = south - (a.y << spot.bits);
        let of_b = way * (from_x * (c.y - a.y) - (c.x - a.x) * from_z);
        let of_c = way * ((b.x - a.x) * from_z - from_x * (b.y - a.y));
        let whole = abs(area) << spot.bits;
        if of_b < 0 || of_c < 0 || of_b + of_c > whole {
            continue;
        }
        let bits = spot.bits + u32(abs(area) - 1);
        return a.z + part_of(b.z - a.z, of_b, bits) + part_of(c.z - a.z, of_c, bits);
    }
    return NOWHERE << FINE_UNIT_BITS;
}

fn packed_shape(width_m: f32, height_m: f32, species: u32) -> u32 {
    let width = u32(clamp(width_m * SHAPE_STEPS + 0.5, 0.0, 4095.0));
    let height = u32(clamp(height_m * SHAPE_STEPS + 0.5, 0.0, 4095.0));
    return width | (height << 12u) | (species << 24u) | 2147483648u;
}

fn part_of(difference: i32, part: i32, bits: u32) -> i32 {
    return mul_hi(difference << 2u, part << (30u - bits));
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

fn pcg4d(words: vec4u) -> vec4u {
    var v = words * 1664525u + 1013904223u;
    v = stir(v);
    v ^= v >> vec4u(16u);
    return stir(v);
}

@group(0) @binding(1)
var<uniform> planting: Planting;

@group(0) @binding(4)
var<storage, read> records: array<u32>;

fn rock_at(at: Patterns, slope: f32, summit: f32, height_m: f32) -> vec2f {
    let high = 0.07 * smoothstep(90.0, 300.0, height_m);
    return vec2f(smoothstep(0.165, 0.255, slope), max(smoothstep(0.125, 0.185, slope + high + (at.broad - 0.5) * 0.06 + at.fine * 0.04 + at.clumps * 0.05), summit * 0.8));
}

fn root_offset_m(field: Field, clump: Clump, eye_fraction_m: vec3f) -> vec3f {
    let whole = clump.place - vec3i(field.eye_x, field.eye_y, field.eye_z);
    let fraction = eye_fraction_m / METRES_PER_FINE;
    return (vec3f(whole) - (fraction - floor(fraction + 0.5))) * METRES_PER_FINE;
}

fn seams_of(words: ChunkWords) -> Seams {
    return Seams(words.edges, words.corners, words.inside);
}

fn shelter_at(at: Patterns, height_m: f32, normal: vec3f) -> f32 {
    let plain = (1.0 - smoothstep(0.0015, 0.01, 1.0 - normal.y)) * (1.0 - smoothstep(20.0, 45.0, height_m));
    return (at.broad - 0.5) * 0.25 - normal.z * 0.25 - plain * 0.09 - smoothstep(120.0, 340.0, height_m) * 0.16;
}

fn slope_of(at: Patterns, normal: vec3f) -> f32 {
    return 1.0 - normal.y + (at.medium - 0.5) * 0.07 + at.fine * 0.02;
}

fn slot_height(slot: u32, column: u32, row: u32) -> i32 {
    return heights[slot * VERTEX_COUNT + row * VERTICES + column];
}

fn snapped(seams: Seams, vertex: GridVertex) -> GridVertex {
    let coarser = seams.inside >> 8u;
    let along_x = is_decimated(seams) || ((coarser & 1u) != 0u && vertex.row == 0u) || ((coarser & 4u) != 0u && vertex.row == CELLS);
    let along_z = is_decimated(seams) || ((coarser & 8u) != 0u && vertex.column == 0u) || ((coarser & 2u) != 0u && vertex.column == CELLS);
    return GridVertex(vertex.column - select(0u, vertex.column & 1u, along_x), vertex.row - select(0u, vertex.row & 1u, along_z));
}

fn spot_of(chunk: OccluderChunk, x: i32, z: i32) -> Spot {
    let level = chunk.words.place & 255u;
    let decimated = select(0u, 1u, (chunk.words.inside & DECIMATED) != 0u);
    let last = i32(CELLS) - 1;
    let steps_x = (x >> STEP_BITS) - chunk.x;
    let steps_z = (z >> STEP_BITS) - chunk.z;
    let column = clamp(steps_x >> level, 0, last) & ~i32(decimated);
    let row = clamp(steps_z >> level, 0, last) & ~i32(decimated);
    let bits = STEP_BITS + level + decimated;
    let mask = (1 << STEP_BITS) - 1;
    return Spot(GridVertex(u32(column), u32(row)), 1u + decimated, bits, ((steps_x - (column << level)) << STEP_BITS) + (x & mask), ((steps_z - (row << level)) << STEP_BITS) + (z & mask));
}

fn stir(words: vec4u) -> vec4u {
    var v = words;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

fn summit_at(at: Patterns, height_m: f32) -> f32 {
    return smoothstep(520.0, 700.0, height_m + (at.medium - 0.5) * 70.0);
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

fn track_at(at: Patterns, height_m: f32, steep: f32, long_m: f32) -> f32 {
    let wander = pattern_gradient(at.turned_m, 1024.0, 13u) + vec3f(0.06, vec2f(0.06)) * (pattern_gradient(at.turned_m, 128.0, 14u) - vec3f(0.5, 0.0, 0.0));
    let off_track_m = abs(wander.x - 0.5) / max(length(wander.yz) * 2.236, 0.0001);
    let ragged_m = 1.25 + at.fine * 1.1 + (at.medium - 0.5) * 0.8;
    let blur_m = max(0.35, long_m * 0.6);
    return (1.0 - smoothstep(ragged_m - blur_m, ragged_m + blur_m, off_track_m)) * min(2.6 / max(long_m, 0.1), 1.0) * (1.0 - smoothstep(0.035, 0.06, steep)) * smoothstep(3.0, 4.5, height_m) * (1.0 - smoothstep(140.0, 180.0, height_m)) * smoothstep(0.0002, 0.0005, length(wander.yz));
}

fn tree_grows(clump: Clump, growth: Growth) -> bool {
    return clump_random(clump) < growth.wood + SOLITARY * growth.groves * growth.meadow;
}

fn tree_size_m(species: u32, size_m: vec2f) -> vec2f {
    if species == SPRUCE {
        return size_m * vec2f(0.88, 1.0);
    }
    if species == PINE {
        return vec2f(0.9 * size_m.x, min(0.95 * size_m.y, 2.3 * size_m.x));
    }
    return vec2f(size_m.x, min(0.9 * size_m.y, 1.6 * size_m.x));
}

fn tree_species(clump: Clump) -> u32 {
    let height_m = f32(clump.place.y) * METRES_PER_FINE;
    let steep = 1.0 - clump.normal.y;
    let low = 1.0 - clamp((height_m - 15.0) / 30.0, 0.0, 1.0);
    let broad = clamp(0.68 - height_m / 330.0 - 2.0 * steep, 0.04, 0.68);
    let pine = clamp(0.1 + 2.5 * steep + 0.16 * low, 0.1, 0.45);
    let number = clump.hue + 0.004;
    if number < broad {
        return BROADLEAF;
    }
    return select(SPRUCE, PINE, number > 1.0 - pine);
}

fn undissolved(frame: Frame, offset_m: vec3f) -> f32 {
    return 1.0 - dissolve(frame, offset_m);
}

fn woods_at(at: Patterns, pattern_m: vec2f, height_m: f32, normal: vec3f, slope: f32) -> vec2f {
    let wood_noise = pattern_fbm_seen(pattern_m, 256.0, 4u, at.footprint_m) + (at.medium - 0.5) * 0.25 + at.fine * 0.03 + at.clumps * 0.12 + shelter_at(at, height_m, normal);
    let wood_belt = smoothstep(5.0, 12.0, height_m) * (1.0 - smoothstep(340.0, 430.0, height_m + (at.broad - 0.5) * 90.0));
    let wood = smoothstep(0.47, 0.54, wood_noise) * wood_belt * (1.0 - smoothstep(0.16, 0.26, slope));
    let rim = smoothstep(0.4, 0.47, wood_noise) * wood_belt * (1.0 - smoothstep(0.2, 0.3, slope));
    return vec2f(wood, max(wood, rim * 0.8));
}
