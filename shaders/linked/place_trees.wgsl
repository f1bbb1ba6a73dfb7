@group(1) @binding(0)
var<uniform> frame: Frame;

@group(1) @binding(1)
var<uniform> field: Field;

@group(1) @binding(2)
var<storage, read_write> placed_trees: array<vec4u>;

@group(1) @binding(3)
var<storage, read_write> marks: array<atomic<u32>>;

const LEAST_HEIGHT_M: f32 = 0.01;

fn first_cell() -> vec2i {
    return (culling.eye.xz >> vec2u(planting.cell_bits)) - vec2i(i32(field.tree_grid_cells) / 2);
}

fn cell_of(index: u32) -> vec2i {
    let side = field.tree_grid_cells;
    return vec2i(vec2u(index % side, index / side));
}

@compute @workgroup_size(64)
fn place(@builtin(global_invocation_id) id: vec3u) {
    let cell = cell_of(id.x);
    let first = first_cell();
    if id.x == 0u {
        let corner = first << vec2u(planting.cell_bits);
        let eye_m = vec2f(culling.eye.xz - corner) * METRES_PER_FINE;
        let casts = select(0u, TREES_CAST, field.casts != 0u && frame.shadows != SHADOWS_OFF);
        placed_trees[0] = vec4u(bitcast<vec2u>(eye_m), planting.per_cell, TREES_PLACED | casts);
        let known_m = min(known_in_grid_m(field.tree_grid_cells), field.range_m);
        placed_trees[1] = vec4u(bitcast<vec2u>(vec2f(field.stand_m, known_m)), field.tree_grid_cells, 0u);
    }
    atomicStore(&marks[id.x], 0u);
    var count = 0u;
    for (var number = 0u; number < min(planting.per_cell, TREES_PER_CELL); number++) {
        let at = first + cell;
        let found = clump_at(at.x, at.y, number);
        if !found.exists {
            continue;
        }
        let clump = unpacked_clump(clump_words(found));
        let root_m = root_offset_m(field, clump, frame.eye_fraction_m);
        let height_m = f32(clump.place.y) * METRES_PER_FINE;
        if !tree_grows(clump, growth_at(height_m, clump.normal, frame.pattern_eye_m + root_m.xz)) {
            continue;
        }
        let species = tree_species(clump);
        let sinks = field.collapse_m > 0.0;
        let height = select(1.0, field_height_scale(field, length(root_m)), sinks);
        let size_m = tree_size_m(species, field_size_m(field, clump.width, clump.height)) * vec2f(1.0, height * undissolved(frame, root_m));
        if size_m.y < LEAST_HEIGHT_M {
            continue;
        }
        placed_trees[TREE_HEAD + tree_index(field.tree_grid_cells, cell, count)] = vec4u(bitcast<vec3u>(root_m), packed_shape(size_m.x, size_m.y, species));
        count += 1u;
    }
    for (; count < TREES_PER_CELL; count++) {
        placed_trees[TREE_HEAD + tree_index(field.tree_grid_cells, cell, count)] = vec4u(0u);
    }
}

fn mark_cell(cell: vec2i, columns: u32) {
    if is_in_tree_grid(field.tree_grid_cells, cell) {
        atomicMax(&marks[tree_cell_index(field.tree_grid_cells, cell)], 1u + columns);
    }
}

@compute @workgroup_size(64)
fn mark(@builtin(global_invocation_id) id: vec3u) {
    let cell = cell_of(id.x);
    let head = placed_trees[0];
    let level = length(frame.sun.xz);
    let along = frame.sun.xz / max(level, 0.0001);
    let is_east = abs(along.x) >= abs(along.y);
    for (var number = 0u; number < TREES_PER_CELL; number++) {
        let words = placed_trees[TREE_HEAD + tree_index(field.tree_grid_cells, cell, number)];
        if words.w == 0u {
            break;
        }
        for (var part = 0; part < 9; part++) {
            mark_cell(cell + vec2i(part % 3 - 1, part / 3 - 1), 0u);
        }
        if (head.w & TREES_CAST) == 0u || frame.sun.y < LOWEST_SUN || level < 0.001 {
            continue;
        }
        let tree = unpacked_tree(words);
        let fall = max(frame.sun.y / level - 0.5, 0.1);
        let reach_m = min(tree.height_m / fall + CROWN_MARGIN_M, f32(MOST_COLUMNS) * TREE_CELL_M);
        let root_m = bitcast<vec2f>(head.xy) + tree.root_m.xz;
        let across_m = vec2f(-along.y, along.x) * (CROWN_MARGIN_M + 1.5);
        for (var way_m = 0.0; way_m < reach_m + 3.0; way_m += 3.0) {
            for (var side = -1; side <= 1; side++) {
                let at_m = root_m - along * way_m + across_m * f32(side);
                let shaded = vec2i(floor(at_m / TREE_CELL_M));
                let apart = abs(shaded - cell);
                mark_cell(shaded, u32(select(apart.y, apart.x, is_east)));
            }
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

const CLUMP_CELL_SEED: u32 = 27223u;

const COARSE_BITS: u32 = 8u;

const CROWN_MARGIN_M: f32 = 3.4;

struct Caster {
    root_m: vec3f,
    width_m: f32,
    height_m: f32,
    species: u32
}

struct Cell {
    is_drawn: bool,
    chunk: OccluderChunk,
    spot: Spot
}

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

struct ClumpCell {
    height: u32,
    hue: u32
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

const FARTHEST: i32 = 32768;

const FINE_UNIT_BITS: u32 = 4u;

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

const GRID_BITS: u32 = 24u;

const GRID_TILES: i32 = 32;

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

const HEIGHT_SHARE: u32 = 9u;

const HUE_SHARE: u32 = 12u;

override KIND: u32 = KIND_GRASS;

const KIND_GRASS: u32 = 0u;

const LOWEST_SUN: f32 = 0.02;

const METRES_PER_FINE: f32 = 1.0 / 4096.0;

const MORPH_BAND: u32 = 1u;

const MORPH_BAND_BITS: u32 = 0u;

const MOST_COLUMNS: u32 = 12u;

struct MeadowTint {
    dryness: f32,
    shade: f32
}

const NOWHERE: i32 = -33554432;

const NO_CHUNK: u32 = 4294967295u;

struct OccluderChunk {
    words: ChunkWords,
    x: i32,
    z: i32
}

struct OcclusionNode {
    top: i32,
    bottom: i32,
    chunk: u32,
    reserved: u32
}

const PART_BITS: u32 = 4u;

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

struct RootedClump {
    exists: bool,
    x: i32,
    z: i32,
    y: i32,
    attributes: u32
}

const SHADOWS_OFF: u32 = 0u;

const SHAPE_STEPS: f32 = 64.0;

const SOLITARY: f32 = 0.04;

const SPREAD_JITTER: u32 = 511u;

const SPREAD_SEED: u32 = 27224u;

const SPRUCE: u32 = 0u;

const SQUARE_BITS: u32 = 12u;

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

const TILE_BITS: u32 = 19u;

const TREES_CAST: u32 = 2u;

const TREES_PER_CELL: u32 = 4u;

const TREES_PLACED: u32 = 1u;

const TREE_CELL_M: f32 = 8.0;

const TREE_HEAD: u32 = 2u;

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

fn cell_at(x: i32, z: i32) -> Cell {
    let index = chunk_at(x, z);
    if index == NO_CHUNK {
        return Cell();
    }
    let chunk = chunks[index];
    return Cell(true, chunk, spot_of(chunk, x, z));
}

fn cell_corner(chunk: OccluderChunk, spot: Spot, east: u32, south: u32) -> i32 {
    let vertex = GridVertex(spot.low.column + east * spot.stride, spot.low.row + south * spot.stride);
    return drawn_vertex(chunk, vertex) << FINE_UNIT_BITS;
}

fn chunk_at(x: i32, z: i32) -> u32 {
    return nodes[(z >> TILE_BITS) * GRID_TILES + (x >> TILE_BITS)].chunk;
}

@group(0) @binding(6)
var<storage, read> chunks: array<OccluderChunk>;

fn clump_at(column: i32, row: i32, index: u32) -> RootedClump {
    let random = clump_attributes(planting.seed, KIND, planting.cell_x + column, planting.cell_z + row, index);
    let mask = (1u << planting.cell_bits) - 1u;
    var place = vec2u(random.place, random.place >> 16u);
    if KIND == KIND_GRASS {
        let first = hash2(SPREAD_SEED, planting.cell_x + column, planting.cell_z + row);
        place = spread_place(first, index, place);
    }
    let x = (column << planting.cell_bits) + i32(place.x & mask);
    let z = (row << planting.cell_bits) + i32(place.y & mask);
    let rank = (index * 256u + ((random.survival >> 8u) & 255u)) / max(planting.per_cell, 1u);
    if distance_squared(x, culling.eye.y, z) > draw_distance_squared(min(rank, 255u)) {
        return RootedClump(false, x, z, 0, 0u);
    }
    if (random.survival & 255u) >= density_near(x, z, mix_bits(random.survival)) {
        return RootedClump(false, x, z, 0, 0u);
    }
    let y = height_at(x, z);
    if y <= (NOWHERE << FINE_UNIT_BITS) {
        return RootedClump(false, x, z, 0, 0u);
    }
    var height = random.height >> 26u;
    var hue = random.hue >> 26u;
    if KIND == KIND_GRASS {
        let squares = planting.cell_bits - SQUARE_BITS;
        let cell = clump_cell(vec2i(planting.cell_x, planting.cell_z) << vec2u(squares), vec2i(x, z));
        height = shared_number(height, cell.height, HEIGHT_SHARE);
        hue = shared_number(hue, cell.hue, HUE_SHARE);
    }
    let attributes = (random.width >> 26u) | (height << 6u) | (hue << 12u) | ((random.phase >> 26u) << 18u) | (min(rank, 255u) << 24u);
    return RootedClump(true, x, z, y, attributes);
}

fn clump_attributes(seed: u32, kind: u32, x: i32, z: i32, index: u32) -> RandomAttributes {
    let random = pcg4d(vec4u(bitcast<u32>(x), bitcast<u32>(z), index ^ (kind << 16u), seed));
    return RandomAttributes(random.x, random.y, random.z, random.w, mix_bits(mix_bits(random.x ^ 1757159915u) ^ random.w), mix_bits(mix_bits(random.y ^ 48610963u) ^ random.z));
}

fn clump_cell(origin: vec2i, place: vec2i) -> ClumpCell {
    let corner = (place + vec2i(1 << (SQUARE_BITS - 1u))) >> vec2u(SQUARE_BITS);
    let part = (place - (corner << vec2u(SQUARE_BITS))) >> vec2u(PART_BITS);
    var nearest = 2147483647;
    var found = 0u;
    for (var square = 0u; square < 4u; square++) {
        let low = vec2i(i32(square & 1u), i32(square >> 1u)) - vec2i(1);
        let at = origin + corner + low;
        let hash = hash2(CLUMP_CELL_SEED, at.x, at.y);
        let point = (low << vec2u(8u)) + 64 + vec2i(i32(hash & 127u), i32((hash >> 7u) & 127u));
        let apart = part - point;
        let far = apart.x * apart.x + apart.y * apart.y;
        if far < nearest {
            nearest = far;
            found = hash;
        }
    }
    return ClumpCell((found >> 14u) & 63u, (found >> 20u) & 63u);
}

fn clump_number(word: u32, shift: u32) -> f32 {
    return f32((word >> shift) & 63u) / 63.0;
}

fn clump_random(clump: Clump) -> f32 {
    return fract(37.3 * clump.phase + 21.7 * clump.hue + 0.61803399 * f32(clump.rank));
}

fn clump_words(clump: RootedClump) -> vec4u {
    let normal = normal_bytes(clump);
    return vec4u(u32(clump.x) | (normal.x << 24u), u32(clump.z) | (normal.y << 24u), bitcast<u32>(clump.y), clump.attributes);
}

@group(0) @binding(0)
var<uniform> culling: Culling;

fn density_at(x: i32, z: i32) -> u32 {
    let index = chunk_at(x, z);
    if index == NO_CHUNK {
        return 0u;
    }
    let chunk = chunks[index];
    let shift = (chunk.words.place & 255u) + 2u;
    let column = u32(clamp(((x >> STEP_BITS) - chunk.x) >> shift, 0, 15));
    let row = u32(clamp(((z >> STEP_BITS) - chunk.z) >> shift, 0, 15));
    let word = records[chunk.words.slot * RECORD_WORDS + BLOCK_TEXELS + row * 4u + (column >> 2u)];
    return (word >> (8u * (column & 3u))) & 255u;
}

fn density_near(x: i32, z: i32, random_word: u32) -> u32 {
    let last = (1 << GRID_BITS) - 1;
    let east = clamp(x + (i32(random_word & 255u) - 128) * 128, 0, last);
    let south = clamp(z + (i32((random_word >> 8u) & 255u) - 128) * 128, 0, last);
    let share = density_at(east, south);
    let full = share + (share >> 7u);
    if KIND == KIND_GRASS {
        return full;
    }
    return min(2u * full, 256u);
}

fn dissolve(frame: Frame, offset_m: vec3f) -> f32 {
    return smoothstep(0.72, 0.98, length(offset_m.xz) / frame.view_distance_m);
}

fn distance_squared(x: i32, y: i32, z: i32) -> u32 {
    let far = abs(from_eye(x, y, z));
    if max(far.x, max(far.y, far.z)) >= FARTHEST {
        return 4294967295u;
    }
    return u32(far.x * far.x) + u32(far.y * far.y) + u32(far.z * far.z);
}

fn draw_distance_squared(rank: u32) -> u32 {
    return planting.draw_distance_squared[rank >> 2u][rank & 3u];
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

fn field_height_scale(field: Field, distance_m: f32) -> f32 {
    let band_m = max(field.collapse_m, 0.001);
    return 1.0 - smoothstep(field.range_m - band_m, field.range_m, distance_m);
}

fn field_size_m(field: Field, width: f32, height: f32) -> vec2f {
    return vec2f(mix(field.width_low_m, field.width_high_m, width), mix(field.height_low_m, field.height_high_m, height));
}

fn from_eye(x: i32, y: i32, z: i32) -> vec3i {
    return (vec3i(x, y, z) - culling.eye) >> vec3u(COARSE_BITS);
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

fn hash2(seed: u32, x: i32, z: i32) -> u32 {
    return mix_bits(mix_bits(seed ^ (bitcast<u32>(x) * 2654435769u)) + bitcast<u32>(z) * 2246822507u);
}

fn height_at(x: i32, z: i32) -> i32 {
    let cell = cell_at(x, z);
    if !cell.is_drawn {
        return NOWHERE << FINE_UNIT_BITS;
    }
    if is_block_rough(cell.chunk, block_around(cell.spot.low)) {
        return on_rough(cell.chunk, cell.spot);
    }
    return on_cell(cell.chunk, cell.spot);
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

fn is_in_tree_grid(side: u32, cell: vec2i) -> bool {
    return all(cell >= vec2i(0)) && all(cell < vec2i(i32(side)));
}

fn known_in_grid_m(side: u32) -> f32 {
    return (0.5 * f32(side) - 1.5) * TREE_CELL_M;
}

fn lattice_value(cell: vec2i, mask: i32, salt: u32) -> f32 {
    let wrapped = vec2u(cell & vec2i(mask));
    return f32(pattern_hash(wrapped.x + salt * 2654435769u, wrapped.y) >> 8u) * (1.0 / 16777216.0);
}

fn meadow_tint_at(at: Patterns, height_m: f32) -> MeadowTint {
    return MeadowTint(smoothstep(0.42, 0.68, at.broad + height_m * 0.0002 + (at.medium - 0.5) * 0.3 + at.clumps * 0.45), (0.82 + 0.36 * at.medium) * max(1.0 + 0.35 * at.fine + 0.9 * at.clumps + 0.9 * at.tufts, 0.2));
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

@group(0) @binding(5)
var<storage, read> nodes: array<OcclusionNode>;

fn normal_bytes(clump: RootedClump) -> vec2u {
    let step = 1 << STEP_BITS;
    let west = height_at(max(clump.x - step, 0), clump.z);
    let east = height_at(min(clump.x + step, (1 << 24u) - 1), clump.z);
    let north = height_at(clump.x, max(clump.z - step, 0));
    let south = height_at(clump.x, min(clump.z + step, (1 << 24u) - 1));
    if min(min(west, east), min(north, south)) <= (NOWHERE << FINE_UNIT_BITS) {
        return vec2u(0u);
    }
    let normal = normalize(vec3f(f32(west - east), f32(4 * step) * 0.5, f32(north - south)));
    return bitcast<vec2u>(vec2i(round(normal.xz * 127.0))) & vec2u(255u);
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

fn shared_number(own: u32, cell: u32, share: u32) -> u32 {
    return ((16u - share) * own + share * cell) >> 4u;
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

fn spread_place(first: u32, index: u32, random: vec2u) -> vec2u {
    let even = vec2u(first, first << 16u) + index * vec2u(3242174889u, 2447445413u);
    return (even >> vec2u(32u - planting.cell_bits)) + (random & vec2u(SPREAD_JITTER));
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

fn tree_grows(clump: Clump, growth: Growth) -> bool {
    return clump_random(clump) < growth.wood + SOLITARY * growth.groves * growth.meadow;
}

fn tree_index(side: u32, cell: vec2i, number: u32) -> u32 {
    return tree_cell_index(side, cell) * TREES_PER_CELL + number;
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

fn unpacked_clump(words: vec4u) -> Clump {
    let level = clamp(vec2f(vec2i(words.xy) >> vec2u(24u)) / 127.0, vec2f(-1.0), vec2f(1.0));
    let upright = sqrt(max(1.0 - dot(level, level), 0.05));
    return Clump(vec3i(i32(words.x & 16777215u), bitcast<i32>(words.z), i32(words.y & 16777215u)), normalize(vec3f(level.x, upright, level.y)), clump_number(words.w, 0u), clump_number(words.w, 6u), clump_number(words.w, 12u), clump_number(words.w, 18u), words.w >> 24u);
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
