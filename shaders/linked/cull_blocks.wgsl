@group(0) @binding(7)
var<uniform> patches: array<vec4u, 256>;

@group(1) @binding(0)
var<storage, read_write> visible_blocks: array<u32>;

@group(1) @binding(1)
var<storage, read_write> last_seen: array<u32>;

const BLOCKS: u32 = 256u;

const BLOCK_LIST: u32 = 1280u;

const LAST_SEEN_BITS: u32 = 9u;

var<workgroup> visible_before: array<u32, 256>;

var<workgroup> occluded_corners: atomic<u32>;

fn corner_is_occluded(column: i32, row: i32, corner: u32) -> bool {
    let bits = planting.cell_bits + BLOCK_CELL_BITS + 4u;
    let side = 1 << bits;
    let middle = vec2i((column << bits) + (side >> 1u), (row << bits) + (side >> 1u));
    let toward = vec2i(i32(corner & 1u), i32(corner >> 1u)) * 2 - vec2i(1);
    let at = select(middle + toward * (side >> 1u), middle, corner == 4u);
    let last = (1 << 24u) - 1;
    let place = clamp(at, vec2i(0), vec2i(last));
    let top = node_at(bits, column, row).top << FINE_UNIT_BITS;
    let occludee = point_occludee(place.x, top, place.y);
    return raymarch_occlusion(occludee, false, select(0, (side >> 1u), corner == 4u));
}

fn is_in_sight(column: i32, row: i32) -> bool {
    if block_distance_squared(column, row) > draw_distance_squared(0u) {
        return false;
    }
    let bits = planting.cell_bits + BLOCK_CELL_BITS;
    let block = block_extent(bits, column, row);
    if !block.is_drawn || !is_in_view(block.extent) {
        return false;
    }
    return METHOD != CULL_HIERARCHICAL || !OCCLUDES || block_is_seen(column, row, block);
}

fn block_is_seen(column: i32, row: i32, block: BlockExtent) -> bool {
    let bits = planting.cell_bits + BLOCK_CELL_BITS - 1u;
    for (var part = 0; part < 5; part++) {
        var occludee = block.extent.occludee;
        if part > 0 {
            let x = 2 * column + ((part - 1) & 1);
            let z = 2 * row + ((part - 1) >> 1u);
            let quarter = block_extent(bits, x, z);
            if !quarter.is_drawn || !may_be_in_view(quarter.extent) || !has_clump(x, z) {
                continue;
            }
            occludee = sloped_occludee(bits, x, z, quarter);
        }
        let is_hidden = is_occluded(occludee, NO_CLEAR_INTERVAL);
        if part == 0 && is_hidden {
            return false;
        }
        if !is_hidden && (part > 0 || KIND != KIND_GRASS) {
            return true;
        }
    }
    return false;
}

fn is_visible(column: i32, row: i32) -> bool {
    let is_seen = is_in_sight(column, row);
    if culling.stay == 0u {
        return is_seen;
    }
    let cells = vec2i(planting.cell_x, planting.cell_z) >> vec2u(BLOCK_CELL_BITS);
    let mask = (1 << LAST_SEEN_BITS) - 1;
    let place = (cells + vec2i(column, row)) & vec2i(mask);
    let index = u32((place.y << LAST_SEEN_BITS) + place.x) + (KIND << (2u * LAST_SEEN_BITS));
    if is_seen {
        last_seen[index] = culling.frame;
        return true;
    }
    return last_seen[index] != 0u && culling.frame - last_seen[index] <= culling.stay;
}

@compute @workgroup_size(256)
fn cull_blocks(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3u) {
    let packed = patches[group.x >> 2u][group.x & 3u];
    let patch_column = i32(packed & 65535u);
    let patch_row = i32(packed >> 16u);
    if METHOD == CULL_MARCH && OCCLUDES {
        if lane < 5u && corner_is_occluded(patch_column, patch_row, lane) {
            atomicAdd(&occluded_corners, 1u);
        }
    }
    workgroupBarrier();
    let side = i32(PATCH_BLOCKS);
    let column = patch_column * side + i32(lane % PATCH_BLOCKS);
    let row = patch_row * side + i32(lane / PATCH_BLOCKS);
    let visible = select(0u, 1u, atomicLoad(&occluded_corners) < 5u && is_visible(column, row));
    visible_before[lane] = visible;
    for (var reach = 1u; reach < BLOCKS; reach *= 2u) {
        workgroupBarrier();
        let below = select(0u, visible_before[max(lane, reach) - reach], lane >= reach);
        workgroupBarrier();
        visible_before[lane] += below;
    }
    if visible != 0u {
        visible_blocks[BLOCK_LIST + group.x * BLOCKS + visible_before[lane] - 1u] = u32(column) | (u32(row) << 16u);
    }
    if lane == BLOCKS - 1u {
        visible_blocks[1u + group.x] = visible_before[lane];
    }
}

const ALMOST_ONE_Q30: i32 = (1 << 30u) - 1;

const BASE_CELL_BITS: u32 = 21u;

const BASE_OCTAVES: u32 = 4u;

const BASE_OF_SEA: BaseNode = BaseNode(-(SEA_FLOOR_M << FINE_BITS), 0, 0);

const BASE_STREAM: u32 = 16u;

const BEACH_BITS: u32 = u32(countTrailingZeros(BEACH_M));

const BEACH_EDGE: i32 = BEACH_M << FINE_BITS;

const BEACH_M: i32 = 8;

const BLOCK_CELL_BITS: u32 = 2u;

const BLOCK_TEXELS: u32 = 85u;

struct BaseNode {
    height: i32,
    roughness: i32,
    exposure: i32
}

struct BlockBounds {
    is_drawn: bool,
    top: i32,
    bottom: i32
}

struct BlockExtent {
    is_drawn: bool,
    extent: Extent,
    half: i32,
    height: i32,
    is_far: bool
}

const CELLS: u32 = 64u;

const CLIFF_FOOT_M: i32 = 2;

const CLIFF_M: i32 = 34;

const CLUMP_CELL_SEED: u32 = 27223u;

const COARSE_BITS: u32 = 8u;

const COMPLEMENT_OF_SEA: Complement = Complement(ALMOST_ONE_Q30, ALMOST_ONE_Q30);

const CRATER_Q26: i32 = 15 << 22u;

const CROSSINGS: u32 = 4u;

const CULL_DISTANCE: u32 = 0u;

const CULL_HIERARCHICAL: u32 = 5u;

const CULL_MARCH: u32 = 3u;

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

struct ClearInterval {
    until: i32,
    major_is_x: bool,
    is_mirrored: bool
}

struct ClumpCell {
    height: u32,
    hue: u32
}

struct Complement {
    mass: i32,
    height: i32
}

struct Corner {
    value: i32,
    gradient: vec2i
}

struct Crossing {
    exists: bool,
    progress: i32
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

const DONE: u32 = 3u;

const EXPOSURE_CELL_BITS: u32 = 21u;

const EXPOSURE_STREAM: u32 = 24u;

struct Edge {
    slope: i32,
    value: i32
}

struct Extent {
    occludee: Occludee,
    bottom: i32
}

const FARTHEST: i32 = 32768;

const FINE_BITS: u32 = 16u;

const FINE_OCTAVES: u32 = 5u;

const FINE_UNIT_BITS: u32 = 4u;

const FIRST_AMPLITUDE_BITS: u32 = 4u;

const FIRST_CELL_BITS: u32 = 15u;

const FRACTION_BITS: u32 = 15u;

const GRADIENTS = array<vec2i, 32>(vec2i(32610, 3212), vec2i(31357, 9512), vec2i(28899, 15447), vec2i(25330, 20788), vec2i(20788, 25330), vec2i(15447, 28899), vec2i(9512, 31357), vec2i(3212, 32610), vec2i(-3212, 32610), vec2i(-9512, 31357), vec2i(-15447, 28899), vec2i(-20788, 25330), vec2i(-25330, 20788), vec2i(-28899, 15447), vec2i(-31357, 9512), vec2i(-32610, 3212), vec2i(-32610, -3212), vec2i(-31357, -9512), vec2i(-28899, -15447), vec2i(-25330, -20788), vec2i(-20788, -25330), vec2i(-15447, -28899), vec2i(-9512, -31357), vec2i(-3212, -32610), vec2i(3212, -32610), vec2i(9512, -31357), vec2i(15447, -28899), vec2i(20788, -25330), vec2i(25330, -20788), vec2i(28899, -15447), vec2i(31357, -9512), vec2i(32610, -3212));

const GRID_BITS: u32 = 24u;

const GRID_NODES: i32 = 1365;

const GRID_TILES: i32 = 32;

struct GridVertex {
    column: u32,
    row: u32
}

const HALF_Q15: i32 = 1 << 14u;

const HEIGHT_SHARE: u32 = 9u;

const HOME_LOBE_M: i32 = 5000;

const HUE_SHARE: u32 = 12u;

const INLAND_REACH: i32 = (1 << 23u) - 1;

const ISLAND_CELL_BITS: u32 = 21u;

const ISLAND_REACH: i32 = 346;

struct Island {
    kind: u32,
    home: bool,
    middle: vec2i,
    radius_m: i32,
    height: i32,
    draws: u32
}

override KIND: u32 = KIND_GRASS;

const KIND_ATOLL: u32 = 6u;

const KIND_GRASS: u32 = 0u;

const KIND_GROUP: u32 = 2u;

const KIND_NONE: u32 = 0u;

const KIND_PLATEAU: u32 = 4u;

const KIND_SINGLE: u32 = 1u;

const KIND_SKERRIES: u32 = 3u;

const KIND_VOLCANO: u32 = 5u;

const LATTICES: u32 = 9u;

const LIMIT: i32 = 16777215;

const LONGEST = array<i32, 9>(251, 253, 245, 254, 256, 255, 247, 250, 241);

struct Lattice {
    seed: u32,
    stream: u32,
    bits: u32
}

struct LatticePlace {
    cell: i32,
    fraction: i32
}

struct Lobe {
    centre: vec2i,
    long: vec2i,
    short: vec2i,
    mass: vec2i,
    height: i32,
    plateau: u32,
    crater: bool
}

struct LobeRange {
    distance: vec2i,
    long: vec2i,
    short: vec2i
}

const MAX_CELLS: u32 = 9u;

const MAX_ROUGHNESS: i32 = (1 << 29u) - (1 << 14u);

const MAX_STEEPNESS: i32 = 13421772;

const MAX_STEPS: i32 = 2048;

const MAX_STRETCH: i32 = 160;

const MAX_TRIES: u32 = 256u;

const MAX_VISITS: u32 = 512u;

override METHOD: u32 = CULL_HIERARCHICAL;

const MORPH_BAND: u32 = 1u;

const MORPH_BAND_BITS: u32 = 0u;

const MOUNTAIN_M: i32 = 704;

const NOWHERE: i32 = -33554432;

const NO_CHUNK: u32 = 4294967295u;

const NO_CLEAR_INTERVAL: ClearInterval = ClearInterval(0, false, false);

struct Node {
    top: i32,
    bottom: i32,
    finest: u32
}

override OCCLUDES: bool = true;

const OCTAVES_OF_NOISE: u32 = 6u;

const OCTAVE_SHIFT = array<vec2i, 5>(vec2i(9472, 23808), vec2i(12032, 7424), vec2i(2816, 4864), vec2i(1792, 1280), vec2i(768, 256));

const OFFSET_LIMIT: i32 = 1 << 29u;

struct Occludee {
    x: i32,
    top: i32,
    z: i32,
    radius: i32,
    slope_radius: i32,
    taper: i32,
    taper_drop: i32,
    slope_east: i32,
    slope_south: i32
}

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

const PATCH_BLOCKS: u32 = 16u;

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

const RECORD_WORDS: u32 = 149u;

const RIM_M: i32 = 80;

struct RandomAttributes {
    place: u32,
    width: u32,
    height: u32,
    hue: u32,
    phase: u32,
    survival: u32
}

struct Ray {
    is_tested: bool,
    major_is_x: bool,
    is_mirrored: bool,
    eye_major: i32,
    eye_minor: i32,
    eye_height: i32,
    length: i32,
    minor_slope: i32,
    height_slope: i32,
    outer_slope: i32,
    core_slope: i32,
    drop_slope: i32,
    margin: i32,
    cross_slope: i32
}

struct RootedClump {
    exists: bool,
    x: i32,
    z: i32,
    y: i32,
    attributes: u32
}

const SEA_FLOOR_M: i32 = 64;

const SHORE_M: vec4i = vec4i(64, 64, 80, 128);

const SHORE_REACH: i32 = (1 << 23u) - 1;

const SKIP_COLUMNS: u32 = 0u;

const SPLINE_CELL_BITS: u32 = 13u;

const SPREAD: i32 = 902;

const SPREAD_JITTER: u32 = 511u;

const SPREAD_SEED: u32 = 27224u;

const SQUARE_BITS: u32 = 12u;

const STEEPEST_BITS: u32 = 4u;

const STEP_BITS: u32 = 13u;

struct Sample {
    value: i32,
    gradient: vec2i
}

struct Seams {
    edges: u32,
    corners: u32,
    inside: u32
}

struct Shape {
    radius: i32,
    slope_radius: i32,
    taper: i32,
    taper_drop: i32,
    over: i32
}

struct Slope {
    is_known: bool,
    east: i32,
    south: i32
}

struct Spot {
    low: GridVertex,
    stride: u32,
    bits: u32,
    east: i32,
    south: i32
}

const TEST_CROSSINGS: u32 = 2u;

const TEST_LOWER_END: u32 = 1u;

const TILE_BITS: u32 = 19u;

const TWO_Q24: i32 = 2 << 24u;

struct Taper {
    core: i32,
    width: i32,
    drop: i32
}

const UNIT_BITS: u32 = 8u;

const UPLIFT_M: i32 = 384;

const VERTEX_COUNT: u32 = 4225u;

const VERTICES: u32 = 65u;

const WARP_AMPLITUDE_M: vec2i = vec2i(1800, 600);

const WARP_CELL_BITS: vec2u = vec2u(22u, 20u);

const WARP_M: i32 = 1698;

const WARP_STREAM: u32 = 20u;

struct Weights {
    line: vec2i,
    step: vec2i
}

struct World {
    fine_seeds: array<u32, FINE_OCTAVES>,
    lattice_seeds: array<u32, LATTICES>,
    archipelago_seed: u32
}

fn axis_squared(axis: vec2i, place: vec2i) -> i32 {
    let along_q24 = mul_hi(place.x, axis.x) + mul_hi(place.y, axis.y);
    let clamped_q29 = clamp(along_q24, -TWO_Q24, TWO_Q24) << 5u;
    return mul_hi(clamped_q29, clamped_q29);
}

fn base_at(lattice_seeds: array<u32, LATTICES>, archipelago_seed: u32, x: i32, z: i32, octaves: u32) -> BaseNode {
    if !is_near_land(archipelago_seed, x, z) {
        return BASE_OF_SEA;
    }
    let complement = complement_at(archipelago_seed, x, z, warp_at(lattice_seeds, x, z));
    let mass = ALMOST_ONE_Q30 - complement.mass;
    let height = ALMOST_ONE_Q30 - complement.height;
    if mass == 0 {
        return BASE_OF_SEA;
    }
    var seeds = lattice_seeds;
    let exposed = Lattice(seeds[EXPOSURE_STREAM - BASE_STREAM], EXPOSURE_STREAM, EXPOSURE_CELL_BITS);
    let exposure = clamp(3 * sample_at(exposed, x, z).value - (1 << 24u), 0, 1 << 29u);
    let ruggedness = (3 << 28u) + exposure;
    var shore = shore_of(mass);
    var wide_shore = shore;
    var relief = 0;
    var slope = vec2i(0);
    var flatness = ALMOST_ONE_Q30;
    for (var index = 0u; index < octaves; index++) {
        let octave = Lattice(seeds[index], BASE_STREAM + index, BASE_CELL_BITS - index);
        let sample = sample_at(octave, x, z);
        let back = turned_back(octave, sample.gradient) >> vec2u(2u);
        let value = sample.value;
        let is_folded = index > 0u;
        slope += back + select(vec2i(0), back >> vec2u(1u), is_folded);
        flatness = flatness_of(slope);
        let size = abs(value);
        let folded = select(value, (3 << 26u) - (size + (size >> 1u)), is_folded);
        relief += mul_hi(folded, damping(flatness)) >> index;
        if index <= 1u {
            shore += mul_hi(value, select(SHORE_M[1], SHORE_M[0], index == 0u) << 19u);
        }
        else if index == 2u {
            shore += mul_hi(value, mul_hi(SHORE_M[2] << 21u, ruggedness));
        }
        else {
            let amplitude = mul_hi(SHORE_M[3] << 21u, ruggedness);
            let near = window(clamp(shore, -SHORE_REACH, SHORE_REACH) << 7u);
            shore += mul_hi(mul_hi(value, near) << 2u, amplitude);
        }
        if index <= 2u {
            wide_shore = shore;
        }
    }
    let inland = smooth_step(clamp(wide_shore - (8 << FINE_BITS), 0, INLAND_REACH) << 7u);
    let share = mul_hi(height << 1u, inland << 1u);
    let raised_relief = max((13 << 20u) + ((relief * 11) >> 3u), 0) + (5 << 20u);
    let mountain = mul_hi(mul_hi(share << 1u, raised_relief) << 5u, MOUNTAIN_M << 19u);
    let sum = max(lowland(shore) + mountain + (SEA_FLOOR_M << FINE_BITS), 0);
    let rim = min(mass, (1 << 27u) - 1) << 3u;
    var raised = sum;
    if mass < (1 << 27u) {
        raised = mul_hi(sum << 2u, smooth_step(rim));
    }
    return BaseNode(raised - (SEA_FLOOR_M << FINE_BITS), roughness_of(shore, exposure, rim, height, inland, flatness), min(exposure >> 14u, (1 << 15u) - 1));
}

fn base_octaves(octaves: u32) -> u32 {
    return min(octaves, BASE_OCTAVES);
}

fn beach(fine: i32) -> i32 {
    if abs(fine) >= BEACH_EDGE {
        return fine;
    }
    let r = fine << (31u - FINE_BITS - BEACH_BITS);
    let r2 = mul_hi(r, r) << 1u;
    let r4 = mul_hi(r2, r2) << 1u;
    let slope_q29 = 107374182 + mul_hi(r2, 1717986918) - mul_hi(r4, 858993459);
    return mul_hi(fine << 3u, slope_q29);
}

fn bilinear_at(x: i32, z: i32) -> i32 {
    let cell = cell_at(x, z);
    if !cell.is_drawn {
        return NOWHERE << FINE_UNIT_BITS;
    }
    let chunk = cell.chunk;
    let spot = cell.spot;
    let near_west = cell_corner(chunk, spot, 0u, 0u);
    let near_east = cell_corner(chunk, spot, 1u, 0u);
    let far_west = cell_corner(chunk, spot, 0u, 1u);
    let far_east = cell_corner(chunk, spot, 1u, 1u);
    let near = near_west + part_of(near_east - near_west, spot.east, spot.bits);
    let far = far_west + part_of(far_east - far_west, spot.east, spot.bits);
    return near + part_of(far - near, spot.south, spot.bits);
}

fn block_around(cell: GridVertex) -> GridVertex {
    return GridVertex(cell.column & ~1u, cell.row & ~1u);
}

fn block_distance_squared(column: i32, row: i32) -> u32 {
    let bits = planting.cell_bits + BLOCK_CELL_BITS;
    let side = 1 << bits;
    let west = column << bits;
    let north = row << bits;
    let x = clamp(culling.eye.x, west, west + side);
    let z = clamp(culling.eye.z, north, north + side);
    return distance_squared(x, culling.eye.y, z);
}

fn block_extent(bits: u32, column: i32, row: i32) -> BlockExtent {
    let bounds = bounds_of(bits, column, row);
    let middle = 1 << (bits - 1u);
    let x = (column << bits) + middle;
    let z = (row << bits) + middle;
    let diagonal = half_diagonal(bits);
    let far = max(distance_bound(x, bounds.top, z), distance_bound(x, bounds.bottom, z));
    let apart = ((diagonal + bounds.top - bounds.bottom) >> COARSE_BITS) + 2;
    let wide = (planting.width_low + planting.width_span) * widening_at(far + apart);
    let near = u32(clamp(far - apart - 5, 0, 65535));
    let is_far = near * near > planting.detail.y;
    let half = (wide >> 9u) + 2 + spread_of(KIND, is_far);
    let tall = planting.height_low + planting.height_span;
    let height = ((tall * height_scale_at(far - apart - 5)) >> 8u) + 1;
    let shape = shape_of(half, height, is_far, Slope(false, 0, 0), push_of(63, 128));
    let occludee = Occludee(x, bounds.top + shape.over, z, diagonal + shape.radius, diagonal + shape.radius, shape.taper, shape.taper_drop, 0, 0);
    let extent = Extent(occludee, bounds.bottom - half);
    return BlockExtent(bounds.is_drawn, extent, half, height, is_far);
}

fn block_of(chunk: OccluderChunk, bits: u32, x: i32, z: i32) -> Node {
    let level = chunk.words.place & 255u;
    let finest = STEP_BITS + level + 3u;
    let coarser = min(max(bits, finest) - finest, 3u);
    let shift = level + 3u + coarser;
    let side = 8 >> coarser;
    let column = clamp(((x >> STEP_BITS) - chunk.x) >> shift, 0, side - 1);
    let row = clamp(((z >> STEP_BITS) - chunk.z) >> shift, 0, side - 1);
    let texel = block_texel(side, column, row);
    var top = maxima[chunk.words.slot * BLOCK_TEXELS + texel];
    var bottom = slot_bottom(chunk.words.slot, texel);
    if (chunk.words.edges | chunk.words.corners | (chunk.words.inside & 255u)) != 0u {
        let above = min(8 >> (max(coarser, 1u) - 1u), 8);
        let down = select(0u, 1u, coarser == 0u);
        let half = above >> 1u;
        let up_column = i32((chunk.words.place >> 8u) & 1u) * half + (column >> down);
        let up_row = i32((chunk.words.place >> 9u) & 1u) * half + (row >> down);
        let up_texel = block_texel(above, up_column, up_row);
        top = max(top, maxima[chunk.words.parent_slot * BLOCK_TEXELS + up_texel]);
        bottom = min(bottom, slot_bottom(chunk.words.parent_slot, up_texel));
    }
    return Node(top, bottom, finest);
}

fn block_texel(side: i32, column: i32, row: i32) -> u32 {
    return u32(i32(BLOCK_TEXELS) - i32(u32(4 * side * side - 1) / 3u) + row * side + column);
}

fn block_vertex(chunk: OccluderChunk, block: GridVertex, east: u32, south: u32) -> vec3i {
    let vertex = GridVertex(block.column + east, block.row + south);
    let at = snapped(seams_of(chunk.words), vertex);
    let height = drawn_vertex(chunk, vertex) << FINE_UNIT_BITS;
    return vec3i(i32(at.column) - i32(block.column), i32(at.row) - i32(block.row), height);
}

fn bounds_of(bits: u32, column: i32, row: i32) -> BlockBounds {
    let node = node_at(bits, column, row);
    if node.top <= NOWHERE {
        return BlockBounds(false, 0, 0);
    }
    if bits >= node.finest || is_rough_near(column << bits, row << bits) {
        return BlockBounds(true, node.top << FINE_UNIT_BITS, node.bottom << FINE_UNIT_BITS);
    }
    let steps = 1 << (bits - STEP_BITS);
    let last = (GRID_TILES << TILE_BITS) - 1;
    var top = NOWHERE << FINE_UNIT_BITS;
    var bottom = 2147483647;
    for (var z = 0; z <= steps; z++) {
        for (var x = 0; x <= steps; x++) {
            let east = min((column << bits) + (x << STEP_BITS), last);
            let south = min((row << bits) + (z << STEP_BITS), last);
            let height = height_at(east, south);
            if height <= (NOWHERE << FINE_UNIT_BITS) {
                return BlockBounds(true, node.top << FINE_UNIT_BITS, node.bottom << FINE_UNIT_BITS);
            }
            top = max(top, height);
            bottom = min(bottom, height);
        }
    }
    return BlockBounds(true, top + 2, bottom);
}

fn cell_at(x: i32, z: i32) -> Cell {
    let index = chunk_at(x, z);
    if index == NO_CHUNK {
        return Cell();
    }
    let chunk = chunks[index];
    return Cell(true, chunk, spot_of(chunk, x, z));
}

fn cell_bits_at(x: i32, z: i32) -> u32 {
    let index = chunk_at(x, z);
    if index == NO_CHUNK {
        return GRID_BITS;
    }
    return STEP_BITS + (chunks[index].words.place & 255u);
}

fn cell_bits_on_ray_axes(ray: Ray, major: i32, minor: i32) -> u32 {
    return cell_bits_at(select(minor, major, ray.major_is_x), select(major, minor, ray.major_is_x));
}

fn cell_corner(chunk: OccluderChunk, spot: Spot, east: u32, south: u32) -> i32 {
    let vertex = GridVertex(spot.low.column + east * spot.stride, spot.low.row + south * spot.stride);
    return drawn_vertex(chunk, vertex) << FINE_UNIT_BITS;
}

fn centre_is_above(ray: Ray, progress: i32) -> bool {
    let lowest = lowest_on_ray_axes(ray, ray_major(ray, progress), ray_minor(ray, progress));
    return lowest >= ray_height(ray, progress) + ray.margin;
}

fn chunk_at(x: i32, z: i32) -> u32 {
    return nodes[(z >> TILE_BITS) * GRID_TILES + (x >> TILE_BITS)].chunk;
}

@group(0) @binding(6)
var<storage, read> chunks: array<OccluderChunk>;

fn cliff(fine: i32) -> i32 {
    let x = clamp(fine + (CLIFF_FOOT_M << FINE_BITS), 0, BEACH_EDGE - 1);
    return mul_hi(smooth_step(x << (30u - FINE_BITS - BEACH_BITS)), CLIFF_M << (FINE_BITS + 2u));
}

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

fn coast(raw: i32, exposure: i32) -> i32 {
    let low = beach(raw);
    let difference = raw + cliff(raw) - low;
    return round_to_units(low + mul_hi(difference << 8u, exposure << 9u));
}

fn column_bounds(ray: Ray, bits: u32, progress: i32, end: i32) -> Node {
    let column = column_of(ray, progress, bits);
    let near = ray_minor(ray, progress) >> bits;
    let far = ray_minor(ray, end) >> bits;
    let first = node_on_ray_axes(ray, bits, column, near);
    if far == near {
        return first;
    }
    let second = node_on_ray_axes(ray, bits, column, far);
    return Node(max(first.top, second.top), min(first.bottom, second.bottom), min(first.finest, second.finest));
}

fn column_end(ray: Ray, progress: i32, bits: u32) -> i32 {
    let edge = (((ray.eye_major + progress) >> bits) + 1) << bits;
    return min(edge - ray.eye_major, ray.length);
}

fn column_of(ray: Ray, progress: i32, bits: u32) -> i32 {
    let column = (ray.eye_major + progress) >> bits;
    let last = (1 << (GRID_BITS - bits)) - 1;
    return clamp(select(column, last - column, ray.is_mirrored), 0, last);
}

fn complement_after(before: Complement, lobe: Lobe, x: i32, z: i32, warp: vec2i) -> Complement {
    let u = falloff(lobe, vec2i(lobe_offset(x, lobe.centre.x, warp.x), lobe_offset(z, lobe.centre.y, warp.y)));
    if u == 0 {
        return before;
    }
    let s = square(u << 4u);
    let inner_q27 = (lobe.mass.x << 24u) + lobe.mass.y * (s >> 6u);
    let mass_q26 = clamp(mul_hi(s << 1u, inner_q27), 0, (1 << 26u) - 1);
    var top = min(s, ALMOST_ONE_Q30 >> lobe.plateau) << lobe.plateau;
    if lobe.crater {
        let w = max(u - CRATER_Q26, 0) << 8u;
        top -= (square(w) >> 4u) * 7;
    }
    let height_q30 = (top >> 8u) * lobe.height;
    return Complement(before.mass - (mul_hi(before.mass, mass_q26 << 5u) << 1u), before.height - (mul_hi(before.height, height_q30 << 1u) << 1u));
}

fn complement_at(archipelago_seed: u32, x: i32, z: i32, warp: vec2i) -> Complement {
    let middle = vec2i(island_cell(x), island_cell(z));
    var complement = COMPLEMENT_OF_SEA;
    for (var index = 0; index < 9; index++) {
        let island = island_of(archipelago_seed, middle + near_cell(index));
        if may_reach(island, x, z) {
            var draws = island.draws;
            for (var lobe = 0u; lobe < lobe_count(island.kind); lobe++) {
                let next = next_lobe(island, lobe == 0u, &draws);
                complement = complement_after(complement, next, x, z, warp);
            }
        }
    }
    return complement;
}

fn corner(seed: u32, cell: vec2u, x: i32, z: i32) -> Corner {
    let gradient = direction(hash2(seed, bitcast<i32>(cell.x), bitcast<i32>(cell.y))) << vec2u(14u);
    return Corner(mul_hi(gradient.x << 1u, x) + mul_hi(gradient.y << 1u, z), gradient);
}

fn crossing_of(ray: Ray, progress: i32, next: i32, bits: u32, which: u32) -> Crossing {
    if which == 3u {
        return Crossing(true, next);
    }
    let near = ray_minor(ray, progress);
    let far = ray_minor(ray, next);
    let span = next - progress;
    if which == 0u {
        let line = max(near >> bits, far >> bits) << bits;
        let share = share_along(abs(line - near), abs(far - near), span, bits);
        return Crossing((near >> bits) != (far >> bits), progress + share);
    }
    let way = select(-1, 1, ray.major_is_x);
    let first = way * (ray_major(ray, progress) - near);
    let last = way * (ray_major(ray, next) - far);
    let low = min(first, last) >> bits;
    let high = max(first, last) >> bits;
    let index = low + i32(which);
    let line = index << bits;
    let share = share_along(abs(line - first), abs(last - first), span, bits);
    return Crossing(index <= high, progress + share);
}

@group(0) @binding(0)
var<uniform> culling: Culling;

fn damping(flatness: i32) -> i32 {
    let squared = mul_hi(flatness, flatness);
    return squared - (squared >> 3u) + (1 << 25u);
}

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

fn direction(word: u32) -> vec2i {
    return gradients[word >> 27u];
}

fn distance_bound(x: i32, y: i32, z: i32) -> i32 {
    return root_of(distance_squared(x, y, z)) + 2;
}

fn distance_squared(x: i32, y: i32, z: i32) -> u32 {
    let far = abs(from_eye(x, y, z));
    if max(far.x, max(far.y, far.z)) >= FARTHEST {
        return 4294967295u;
    }
    return u32(far.x * far.x) + u32(far.y * far.y) + u32(far.z * far.z);
}

fn draw_between(draws: ptr<function, u32>, low: i32, high: i32) -> i32 {
    return low + bitcast<i32>(mul_hi_u(draw_word(draws), bitcast<u32>(high - low + 1)));
}

fn draw_distance_squared(rank: u32) -> u32 {
    return planting.draw_distance_squared[rank >> 2u][rank & 3u];
}

fn draw_word(draws: ptr<function, u32>) -> u32 {
    let word = mix_bits(*draws + 2654435769u);
    *draws = word;
    return word;
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

fn edge(above: vec2i, below: vec2i, down: Weights) -> Edge {
    let slope = above.x * down.step.x + below.x * down.step.y;
    let value = above.y * down.line.x + below.y * down.line.y;
    return Edge((slope + HALF_Q15) >> 15u, (value + HALF_Q15) >> 15u);
}

fn end_heights(centre: i32, slope: i32, slope_radius: i32) -> vec2i {
    let raise = mul_hi(slope_radius << 12u, abs(slope) << 6u) + 2;
    return select(vec2i(centre - raise + 2, centre + raise), vec2i(centre + raise, centre - raise + 2), slope < 0);
}

fn extent_of(clump: RootedClump, slope: Slope) -> Extent {
    let whole_height = planting.height_low + ((planting.height_span * (i32((clump.attributes >> 6u) & 63u) + 1)) >> 6u);
    let width = planting.width_low + ((planting.width_span * (i32(clump.attributes & 63u) + 1)) >> 6u);
    let bound = distance_bound(clump.x, clump.y, clump.z);
    let near = bound - 5;
    let presence = presence_at(near, clump.attributes >> 24u);
    let widening = (widening_at(bound) * presence) >> 8u;
    let is_far = distance_squared(clump.x, clump.y, clump.z) > planting.detail.y;
    let half = ((width * widening) >> 9u) + 2 + spread_of(KIND, is_far);
    let height = ((whole_height * height_scale_at(near)) >> 8u) + 1;
    let is_low = is_far && KIND == KIND_GRASS;
    let longest = select(256, longest_by_phase[((clump.attributes >> 18u) & 63u) % 9u], is_low);
    let sink = select(0, sink_of(half, height, near, presence), is_low);
    let push = push_of(i32((clump.attributes >> 12u) & 63u), tilt_of(clump.y, near));
    let shape = shape_of(half, ((height * longest) >> 8u) + 1, is_far, slope, push);
    let follows = slope.is_known && KIND == KIND_GRASS;
    return Extent(Occludee(clump.x, clump.y + shape.over - sink, clump.z, shape.radius, shape.slope_radius, shape.taper, shape.taper_drop, select(0, slope.east, follows), select(0, slope.south, follows)), clump.y - half);
}

fn fade(t: i32) -> i32 {
    let t2 = mul_hi(t, t) << 1u;
    let t3 = mul_hi(t2, t) << 1u;
    let inner_q27 = (10 << 27u) - 15 * (t >> 4u) + 6 * (t2 >> 4u);
    return mul_hi(t3, inner_q27) << 5u;
}

fn fade_slope(t: i32) -> i32 {
    let product_q31 = mul_hi(t, 2147483647 - t) << 1u;
    let four_q31 = product_q31 << 2u;
    return 15 * (mul_hi(four_q31, four_q31) >> 4u);
}

fn falloff(lobe: Lobe, place: vec2i) -> i32 {
    return max((1 << 26u) - 1 - axis_squared(lobe.long, place) - axis_squared(lobe.short, place), 0);
}

fn fbm_at(fine_seeds: array<u32, FINE_OCTAVES>, x: i32, z: i32, octaves: u32) -> i32 {
    var seeds = fine_seeds;
    var sum = 0;
    for (var octave = 0u; octave < octaves; octave++) {
        let shift = octave_shifts[octave];
        let at_x = lattice_place(octave, x + shift.x);
        let at_z = lattice_place(octave, z + shift.y);
        let seed = seeds[octave];
        let down = weights(at_z.fraction);
        let low = edge(gradient(seed, at_x.cell, at_z.cell), gradient(seed, at_x.cell, at_z.cell + 1), down);
        let high = edge(gradient(seed, at_x.cell + 1, at_z.cell), gradient(seed, at_x.cell + 1, at_z.cell + 1), down);
        sum += value(low, high, weights(at_x.fraction)) >> fine_shift(octave);
    }
    return sum;
}

fn fine_octaves(octaves: u32) -> u32 {
    return octaves - base_octaves(octaves);
}

fn fine_shift(octave: u32) -> u32 {
    return 31u - FINE_BITS - FIRST_AMPLITUDE_BITS + octave;
}

fn flatness_of(slope: vec2i) -> i32 {
    let steepness = mul_hi(slope.x, slope.x) + mul_hi(slope.y, slope.y);
    return max(MAX_STEEPNESS - steepness, 0) * 80;
}

fn from_eye(x: i32, y: i32, z: i32) -> vec3i {
    return (vec3i(x, y, z) - culling.eye) >> vec3u(COARSE_BITS);
}

fn gradient(seed: u32, cell_x: i32, cell_z: i32) -> vec2i {
    return direction(hash2(seed, cell_x, cell_z));
}

var<private> gradients: array<vec2i, 32> = GRADIENTS;

fn half_diagonal(bits: u32) -> i32 {
    return (1 << (bits - 6u)) * 46;
}

fn half_width_slope(radius: i32, drift: i32, length: i32) -> i32 {
    let half = radius + (mul_hi(radius << 8u, drift << 1u) >> 2u) + 2;
    return i32((u32(half) << 13u) / u32(length)) + 1;
}

fn has_clump(column: i32, row: i32) -> bool {
    let bits = planting.cell_bits + BLOCK_CELL_BITS - 1u;
    let last = (1 << GRID_BITS) - 1;
    var density = 0u;
    for (var z = -1; z < 2; z++) {
        for (var x = -1; x < 2; x++) {
            let at = vec2i(column + x, row + z) << vec2u(bits);
            density = max(density, density_at(clamp(at.x, 0, last), clamp(at.y, 0, last)));
        }
    }
    if density == 0u {
        return false;
    }
    let far = block_distance_squared(column >> 1u, row >> 1u);
    var tries = 0u;
    for (var index = 0u; index < planting.per_cell; index++) {
        if draw_distance_squared(index * 256u / planting.per_cell) < far {
            break;
        }
        for (var cell = 0; cell < 4; cell++) {
            let clump = clump_at(2 * column + (cell & 1), 2 * row + (cell >> 1u), index);
            if clump.exists && distance_squared(clump.x, clump.y, clump.z) <= draw_distance_squared(clump.attributes >> 24u) && may_be_in_view(extent_of(clump, slope_at(clump.x, clump.z))) {
                return true;
            }
        }
        tries += 4u;
        if tries >= MAX_TRIES {
            return true;
        }
    }
    return false;
}

fn hash2(seed: u32, x: i32, z: i32) -> u32 {
    return mix_bits(mix_bits(seed ^ (bitcast<u32>(x) * 2654435769u)) + bitcast<u32>(z) * 2246822507u);
}

fn height_above_ray(ray: Ray, major: i32, centre: i32, taper: Taper, minor: i32) -> i32 {
    let beyond = u32(clamp(abs(minor - centre) - taper.core, 0, max(taper.width, 0)));
    let fallen = i32(u32(taper.drop) * beyond / u32(max(taper.width, 1)));
    let lowest = lowest_on_ray_axes(ray, major, minor);
    return lowest + fallen - mul_hi((minor - centre) << 12u, ray.cross_slope << 6u) - 1;
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

fn height_from(west: i32, north: i32, x: i32, z: i32) -> i32 {
    let last = (GRID_TILES << TILE_BITS) - 1;
    return height_at(clamp(west + x, 0, last), clamp(north + z, 0, last));
}

fn height_keeping(world: World, x: i32, z: i32, octaves: u32) -> i32 {
    return height_over(world, node_keeping(world, x, z, octaves), x, z, octaves);
}

fn height_over(world: World, node: BaseNode, x: i32, z: i32, octaves: u32) -> i32 {
    var fine = 0;
    if node.roughness != 0 {
        fine = fbm_at(world.fine_seeds, x, z, fine_octaves(octaves));
    }
    return coast(node.height + mul_hi(fine << 9u, node.roughness << 8u), node.exposure);
}

fn height_scale_at(near: i32) -> i32 {
    let into = near - (planting.range - planting.collapse);
    if into <= 0 {
        return 256;
    }
    let part = min(i32((u32(into) << 8u) / u32(planting.collapse)), 256);
    return 256 - ((part * part * (768 - 2 * part)) >> 16u) + 1;
}

fn height_slope_to(height: i32, distance: i32, lean: i32) -> i32 {
    if height < 0 {
        return -i32(quotient_q24(u32(-height), u32(distance + lean + 1)));
    }
    return i32(quotient_q24(u32(height), u32(distance - lean - 1))) + 1;
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

fn is_in_view(extent: Extent) -> bool {
    return METHOD == CULL_DISTANCE || may_be_in_view(extent);
}

fn is_low(lattice: Lattice) -> bool {
    return (lattice.stream & 1u) == 0u;
}

fn is_near_land(archipelago_seed: u32, x: i32, z: i32) -> bool {
    let middle = vec2i(island_cell(x), island_cell(z));
    for (var index = 0; index < 9; index++) {
        if may_reach(island_of(archipelago_seed, middle + near_cell(index)), x, z) {
            return true;
        }
    }
    return false;
}

fn is_occluded(occludee: Occludee, clear: ClearInterval) -> bool {
    let ray = ray_to(culling.eye, occludee, culling.start);
    if !ray.is_tested {
        return false;
    }
    let is_known = clear.major_is_x == ray.major_is_x && clear.is_mirrored == ray.is_mirrored;
    var progress = select(culling.start, max(culling.start, clear.until), is_known);
    var bits = TILE_BITS - 3u;
    var visits = 0u;
    var state = SKIP_COLUMNS;
    var end = progress;
    var lower_end = progress;
    var can_descend = false;
    var cell_bits = 0u;
    var at = progress;
    var cell = 0u;
    var which = 0u;
    loop {
        while (state == SKIP_COLUMNS) {
            if progress >= ray.length || visits >= MAX_VISITS {
                state = DONE;
                break;
            }
            visits += 1u;
            end = column_end(ray, progress, bits);
            let node = column_bounds(ray, bits, progress, end);
            let at_begin = ray_height(ray, progress);
            let at_end = ray_height(ray, end);
            let lower = min(at_begin, at_end);
            if lower >= (node.top << FINE_UNIT_BITS) {
                bits = next_column_bits(ray, progress, bits);
                progress = end;
                continue;
            }
            can_descend = bits > min(node.finest, TILE_BITS);
            if node.bottom > NOWHERE && lower + ray.margin <= (node.bottom << FINE_UNIT_BITS) {
                lower_end = select(end, progress, at_begin < at_end);
                state = TEST_LOWER_END;
            }
            else if can_descend {
                bits -= 1u;
            }
            else {
                state = TEST_CROSSINGS;
            }
            cell_bits = node.finest - 3u;
            cell = 0u;
            which = 0u;
            at = progress;
        }
        if state == DONE {
            break;
        }
        var candidate = lower_end;
        var is_found = false;
        var is_last = state == TEST_LOWER_END;
        loop {
            if state == TEST_CROSSINGS {
                if at >= end || cell >= MAX_CELLS {
                    is_last = true;
                    break;
                }
                let next = min(column_end(ray, at, cell_bits), end);
                let crossing = crossing_of(ray, at, next, cell_bits, which);
                candidate = crossing.progress;
                which += 1u;
                if which == CROSSINGS {
                    which = 0u;
                    cell += 1u;
                    at = next;
                }
                if !crossing.exists {
                    continue;
                }
            }
            is_found = centre_is_above(ray, candidate);
            if is_found || state == TEST_LOWER_END {
                break;
            }
        }
        if is_found && occludes_at(ray, candidate) {
            return true;
        }
        if !is_last {
            continue;
        }
        if state == TEST_LOWER_END && !can_descend {
            state = TEST_CROSSINGS;
            continue;
        }
        if state == TEST_LOWER_END {
            bits -= 1u;
        }
        else {
            bits = next_column_bits(ray, progress, bits);
            progress = end;
        }
        state = SKIP_COLUMNS;
    }
    return false;
}

fn is_rough_at(x: i32, z: i32) -> bool {
    let cell = cell_at(x, z);
    if !cell.is_drawn {
        return true;
    }
    return is_block_rough(cell.chunk, block_around(cell.spot.low));
}

fn is_rough_from(west: i32, north: i32, x: i32, z: i32) -> bool {
    let last = (GRID_TILES << TILE_BITS) - 1;
    return is_rough_at(clamp(west + x, 0, last), clamp(north + z, 0, last));
}

fn is_rough_near(x: i32, z: i32) -> bool {
    let index = chunk_at(x, z);
    if index == NO_CHUNK {
        return true;
    }
    let chunk = chunks[index];
    return (chunk.words.place & 255u) >= 2u && (chunk.words.inside & 3840u) != 0u;
}

fn island_cell(coordinate: i32) -> i32 {
    return (coordinate + (1 << (ISLAND_CELL_BITS - 1u))) >> ISLAND_CELL_BITS;
}

fn island_kind(hash: u32, cell: vec2i) -> u32 {
    if all(cell == vec2i(0)) {
        return KIND_SINGLE;
    }
    let beside_home = all(abs(cell) <= vec2i(1));
    if (hash & 15u) >= 7u || (beside_home && (hash & 1u) == 0u) {
        return KIND_NONE;
    }
    let drawn = (hash >> 4u) & 15u;
    if drawn <= 3u {
        return KIND_SINGLE;
    }
    if drawn <= 6u {
        return KIND_GROUP;
    }
    if drawn <= 8u {
        return KIND_SKERRIES;
    }
    if drawn <= 11u {
        return KIND_PLATEAU;
    }
    return select(KIND_ATOLL, KIND_VOLCANO, drawn <= 13u);
}

fn island_of(seed: u32, cell: vec2i) -> Island {
    let hash = hash2(seed, cell.x, cell.y);
    let home = all(cell == vec2i(0));
    var draws = hash;
    let size = draw_between(&draws, 0, 255);
    let jitter_x = draw_between(&draws, -1792, 1792);
    let jitter_z = draw_between(&draws, -1792, 1792);
    let drawn_height = draw_between(&draws, 90, 255);
    let part = select(108 + ((size * size * 148) >> 16u), 256, home);
    let jitter = select(vec2i(jitter_x, jitter_z) << vec2u(9u), vec2i(0), home);
    let middle = (cell << vec2u(ISLAND_CELL_BITS)) + jitter;
    let height = select(drawn_height, 192, home);
    return Island(island_kind(hash, cell), home, middle, (HOME_LOBE_M * part) >> 8u, height, draws);
}

fn land_seed(index: u32) -> u32 {
    return culling.land_seeds[index >> 2u][index & 3u];
}

fn lattice_place(octave: u32, shifted: i32) -> LatticePlace {
    let cell_bits = FIRST_CELL_BITS - octave;
    let inside = shifted & ((1 << cell_bits) - 1);
    return LatticePlace(shifted >> cell_bits, inside << (FRACTION_BITS - cell_bits));
}

fn lean_of(height: i32, steep: i32, push: i32) -> i32 {
    let tip = min(push + ((116 * steep) >> 14u) + 1, 192);
    return ((height * tip) >> 9u) + ((((15 * height) >> 6u) * steep) >> 14u) + (height >> 6u) + 2;
}

fn lerp(a: i32, b: i32, t_q31: i32) -> i32 {
    return a + (mul_hi(b - a, t_q31) << 1u);
}

fn lobe_axis(axis: vec2i, length_m: i32) -> vec2i {
    let inverse_q39 = bitcast<i32>((2147483648u / bitcast<u32>(length_m)) << 8u);
    return vec2i(mul_hi(axis.x << 16u, inverse_q39), mul_hi(axis.y << 16u, inverse_q39));
}

fn lobe_count(kind: u32) -> u32 {
    switch kind {
        case KIND_SINGLE, KIND_SKERRIES {
            return 3u;
        }
        case KIND_GROUP {
            return 4u;
        }
        case KIND_PLATEAU, KIND_VOLCANO {
            return 2u;
        }
        case KIND_ATOLL {
            return 1u;
        }
        case default {
            return 0u;
        }
    }
}

fn lobe_offset(coordinate: i32, centre: i32, warp_q16: i32) -> i32 {
    let units = clamp(coordinate - centre, -(OFFSET_LIMIT >> 8u), OFFSET_LIMIT >> 8u);
    return clamp((units << 8u) + warp_q16, -OFFSET_LIMIT, OFFSET_LIMIT - 1) << 2u;
}

fn lobe_range(kind: u32, first: bool) -> LobeRange {
    if kind == KIND_GROUP {
        return LobeRange(vec2i(115, 179), vec2i(77, 159), vec2i(56, 108));
    }
    if kind == KIND_VOLCANO && first {
        return LobeRange(vec2i(0), vec2i(179, 189), vec2i(166, 179));
    }
    if kind == KIND_ATOLL {
        return LobeRange(vec2i(0), vec2i(192, 230), vec2i(159, 192));
    }
    if first {
        return LobeRange(vec2i(13), vec2i(159, 243), vec2i(123, 174));
    }
    return LobeRange(vec2i(77, 141), vec2i(102, 205), vec2i(72, 128));
}

var<private> longest_by_phase: array<i32, 9> = LONGEST;

fn lowest_at(x: i32, z: i32) -> i32 {
    let cell = cell_at(x, z);
    if !cell.is_drawn {
        return NOWHERE << FINE_UNIT_BITS;
    }
    let block = block_around(cell.spot.low);
    if !is_block_rough(cell.chunk, block) {
        return on_cell(cell.chunk, cell.spot);
    }
    var lowest = 2147483647;
    for (var vertex = 0u; vertex < 9u; vertex++) {
        lowest = min(lowest, block_vertex(cell.chunk, block, vertex % 3u, vertex / 3u).z);
    }
    return lowest;
}

fn lowest_on_ray_axes(ray: Ray, major: i32, minor: i32) -> i32 {
    return lowest_at(select(minor, major, ray.major_is_x), select(major, minor, ray.major_is_x));
}

fn lowland(shore: i32) -> i32 {
    if shore < 0 {
        return (shore >> 5u) + (shore >> 1u);
    }
    let near = min(shore, (1 << 21u) - 1);
    return (shore >> 5u) + (near >> 1u) - (square(near << 9u) >> 11u);
}

@group(0) @binding(3)
var<storage, read> maxima: array<i32>;

fn may_be_in_view(extent: Extent) -> bool {
    let middle = extent.bottom + ((extent.occludee.top - extent.bottom) >> 1u);
    let far = from_eye(extent.occludee.x, middle, extent.occludee.z);
    let apart = abs(far);
    if max(apart.x, max(apart.y, apart.z)) >= FARTHEST {
        return true;
    }
    let half = (extent.occludee.top - extent.bottom) >> (COARSE_BITS + 1u);
    let radius = ((extent.occludee.radius + extent.occludee.taper) >> COARSE_BITS) + half + 2;
    let slack = apart.x + apart.y + apart.z + (3 << 14u);
    let reach = (min(radius, FARTHEST) << 14u) + slack;
    for (var side = 0u; side < 4u; side++) {
        let plane = culling.planes[side];
        if plane.x * far.x + plane.y * far.y + plane.z * far.z < -reach {
            return false;
        }
    }
    return true;
}

fn may_reach(island: Island, x: i32, z: i32) -> bool {
    let reach = (((ISLAND_REACH * island.radius_m) >> 8u) + WARP_M) << UNIT_BITS;
    let away = abs(vec2i(x, z) - island.middle);
    return island.kind != KIND_NONE && max(away.x, away.y) <= reach;
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

fn narrow(wide: vec2i) -> vec2i {
    return (wide + (1 << 7u)) >> vec2u(8u);
}

fn near_cell(index: i32) -> vec2i {
    let row = select(select(1, 0, index < 6), -1, index < 3);
    return vec2i(index - 3 * row - 4, row);
}

fn next_column_bits(ray: Ray, progress: i32, bits: u32) -> u32 {
    let odd = u32((ray.eye_major + progress) >> bits) & 1u;
    return min(bits + odd, GRID_BITS - 1u);
}

fn next_lobe(island: Island, first: bool, draws: ptr<function, u32>) -> Lobe {
    let kind = island.kind;
    let away = direction(draw_word(draws));
    let axis = direction(draw_word(draws));
    let range = lobe_range(kind, first);
    var distance = range.distance.x;
    if range.distance.x < range.distance.y {
        distance = draw_between(draws, range.distance.x, range.distance.y);
    }
    let long = draw_between(draws, range.long.x, range.long.y);
    let short = draw_between(draws, range.short.x, range.short.y);
    let share = draw_between(draws, 77, 256);
    let lengths = (vec3i(distance, long, short) * island.radius_m) >> vec3u(8u);
    var height = island.height;
    var plateau = 0u;
    var mass = vec2i(8, 0);
    if kind == KIND_SKERRIES {
        height = 10;
        mass = vec2i(3, 0);
    }
    else if kind == KIND_ATOLL {
        height = 5;
        mass = vec2i(40, -48);
    }
    else if kind == KIND_PLATEAU {
        height = select((height * 179) >> 8u, 108, height < 154);
        plateau = 2u;
        mass = vec2i(16, -8);
    }
    else if kind == KIND_VOLCANO && first {
        height = max(height, 179);
        mass = vec2i(16, -8);
    }
    else if !first {
        height = (height * share) >> 8u;
    }
    else if kind == KIND_SINGLE && island.home {
        mass = vec2i(16, -8);
    }
    let offset = (away * lengths.x) >> vec2u(15u - UNIT_BITS);
    return Lobe(island.middle + offset, lobe_axis(axis, lengths.y), lobe_axis(vec2i(-axis.y, axis.x), lengths.z), mass, height, plateau, kind == KIND_VOLCANO && first);
}

fn node_at(bits: u32, column: i32, row: i32) -> Node {
    let above = max(bits, TILE_BITS) - TILE_BITS;
    let down = TILE_BITS - min(bits, TILE_BITS);
    let side = GRID_TILES >> above;
    let first = GRID_NODES - i32(u32(4 * side * side - 1) / 3u);
    let tile = nodes[first + (row >> down) * side + (column >> down)];
    if above > 0u {
        return Node(tile.top, tile.bottom, 0u);
    }
    if tile.chunk == NO_CHUNK {
        return Node(NOWHERE, NOWHERE, GRID_BITS);
    }
    return block_of(chunks[tile.chunk], bits, column << bits, row << bits);
}

fn node_keeping(world: World, x: i32, z: i32, octaves: u32) -> BaseNode {
    let between_nodes = splined(octaves);
    let cell = vec2i(spline_cell(x), spline_cell(z));
    let count = select(1, 3, between_nodes);
    var columns: array<BaseNode, 3>;
    var rows: array<BaseNode, 3>;
    for (var east = 0; east < count; east++) {
        for (var south = 0; south < count; south++) {
            let corner = cell + vec2i(east - 1, south - 1);
            let node = vec2i(spline_node(corner.x), spline_node(corner.y));
            let place = select(vec2i(x, z), node, between_nodes);
            rows[south] = base_at(world.lattice_seeds, world.archipelago_seed, place.x, place.y, base_octaves(octaves));
        }
        if !between_nodes {
            return rows[0];
        }
        columns[east] = splined_node(rows[0], rows[1], rows[2], spline_fraction(z));
    }
    return splined_node(columns[0], columns[1], columns[2], spline_fraction(x));
}

fn node_on_ray_axes(ray: Ray, bits: u32, major: i32, minor: i32) -> Node {
    return node_at(bits, select(minor, major, ray.major_is_x), select(major, minor, ray.major_is_x));
}

@group(0) @binding(5)
var<storage, read> nodes: array<OcclusionNode>;

fn noise_at(x: i32, z: i32) -> i32 {
    var fine_seeds: array<u32, FINE_OCTAVES>;
    for (var octave = 0u; octave < FINE_OCTAVES; octave++) {
        fine_seeds[octave] = land_seed(octave);
    }
    var lattice_seeds: array<u32, LATTICES>;
    for (var index = 0u; index < LATTICES; index++) {
        lattice_seeds[index] = land_seed(FINE_OCTAVES + index);
    }
    let world = World(fine_seeds, lattice_seeds, culling.archipelago_seed);
    let east = culling.corner.x + (x >> FINE_UNIT_BITS);
    let south = culling.corner.y + (z >> FINE_UNIT_BITS);
    let height = height_keeping(world, east, south, OCTAVES_OF_NOISE);
    let stretched = clamp(mul_hi(height << 6u, culling.stretch << 18u), -LIMIT, LIMIT);
    return stretched << FINE_UNIT_BITS;
}

fn occludes_at(ray: Ray, progress: i32) -> bool {
    let height = ray_height(ray, progress) + ray.margin;
    let half = ((ray.outer_slope * progress) >> 13u) + 4;
    let core = ((ray.core_slope * progress) >> 13u) + 4;
    let drop = select(0, mul_hi(ray.drop_slope << 2u, progress << 6u), half > core);
    let taper = Taper(core, half - core, drop);
    return stretch_is_above(ray, ray_major(ray, progress), ray_minor(ray, progress), half, height, taper);
}

var<private> octave_shifts: array<vec2i, FINE_OCTAVES> = OCTAVE_SHIFT;

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

fn part_of(difference: i32, part: i32, bits: u32) -> i32 {
    return mul_hi(difference << 2u, part << (30u - bits));
}

fn pcg4d(words: vec4u) -> vec4u {
    var v = words * 1664525u + 1013904223u;
    v = stir(v);
    v ^= v >> vec4u(16u);
    return stir(v);
}

@group(0) @binding(1)
var<uniform> planting: Planting;

fn point_occludee(x: i32, top: i32, z: i32) -> Occludee {
    return Occludee(x, top, z, 0, 0, 0, 0, 0, 0);
}

fn presence_at(near: i32, rank: u32) -> i32 {
    let begin = u32(planting.thin_from >> COARSE_BITS) << 16u;
    let share = min(i32(begin / u32(max(near, 1))), 65536);
    let band = min(max(share >> 2u, 256), 2 * (65536 - share));
    let inside = share + (band >> 1u) - (i32(rank) * 256 + 128) + 16;
    if inside >= band {
        return 256;
    }
    return min(i32((u32(max(inside, 0)) << 8u) / u32(max(band, 1))) + 1, 256);
}

fn push_of(hue: i32, tilt: i32) -> i32 {
    return 21 + ((41 * (hue + 1)) >> 6u) + planting.wind_reach + ((planting.lean_reach * min(tilt, 128)) >> 8u) + 2;
}

fn quotient_q24(part: u32, whole: u32) -> u32 {
    var bits = part / whole;
    var rest = part % whole;
    for (var n = 0u; n < 3u; n++) {
        bits = (bits << 8u) | ((rest << 8u) / whole);
        rest = (rest << 8u) % whole;
    }
    return bits;
}

fn ray_height(ray: Ray, progress: i32) -> i32 {
    return ray.eye_height + mul_hi(ray.height_slope << 2u, progress << 6u) + 1;
}

fn ray_major(ray: Ray, progress: i32) -> i32 {
    let at = ray.eye_major + progress;
    return clamp(select(at, (1 << GRID_BITS) - at, ray.is_mirrored), 0, (1 << GRID_BITS) - 1);
}

fn ray_minor(ray: Ray, progress: i32) -> i32 {
    let at = ray.eye_minor + mul_hi(ray.minor_slope << 2u, progress << 6u);
    return clamp(at, 0, (1 << GRID_BITS) - 1);
}

fn ray_to(eye: vec3i, occludee: Occludee, start: i32) -> Ray {
    var ray: Ray;
    let east = occludee.x - eye.x;
    let south = occludee.z - eye.z;
    let major_is_x = abs(east) >= abs(south);
    let forward = select(south, east, major_is_x);
    let sideways = select(east, south, major_is_x);
    let distance = abs(forward);
    let outer_radius = occludee.radius + occludee.taper;
    let length = distance - outer_radius - 1;
    if length <= start {
        return ray;
    }
    let eye_major = select(eye.z, eye.x, major_is_x);
    let is_mirrored = forward < 0;
    let drift = i32(quotient_q24(u32(abs(sideways)), u32(distance)));
    let minor_slope = select(drift, -drift, sideways < 0);
    let slope_major = select(occludee.slope_south, occludee.slope_east, major_is_x);
    let cross_slope = select(occludee.slope_east, occludee.slope_south, major_is_x);
    let slope = select(slope_major, -slope_major, is_mirrored) + mul_hi(cross_slope << 8u, minor_slope);
    let lean = occludee.radius - occludee.slope_radius;
    let centre = occludee.top - eye.y;
    let bounds = end_heights(centre, slope, outer_radius);
    let steepest = max(abs(bounds.x), abs(bounds.y));
    if (steepest >> STEEPEST_BITS) >= length || length <= lean + start {
        return ray;
    }
    let farthest = distance + outer_radius + 1;
    let most = i32(quotient_q24(u32(steepest), u32(length))) + 1;
    let by_slope = mul_hi((occludee.taper + lean) << 12u, abs(slope) << 6u);
    let lost = by_slope + mul_hi(occludee.taper << 9u, most) + 3;
    let has_rim = occludee.taper > 0 && (farthest >> 1u) <= length;
    let drop = select(0, occludee.taper_drop - lost, has_rim);
    let slope_radius = select(outer_radius, occludee.slope_radius, occludee.taper == 0 || drop > 0);
    let heights_at_ends = end_heights(centre, slope, slope_radius);
    let height_slope = max(height_slope_to(heights_at_ends.x, distance - slope_radius, lean), height_slope_to(heights_at_ends.y, distance + slope_radius, lean));
    ray.is_tested = true;
    ray.major_is_x = major_is_x;
    ray.is_mirrored = is_mirrored;
    ray.eye_major = select(eye_major, (1 << GRID_BITS) - eye_major, is_mirrored);
    ray.eye_minor = select(eye.x, eye.z, major_is_x);
    ray.eye_height = eye.y;
    ray.length = length;
    ray.minor_slope = minor_slope;
    ray.height_slope = height_slope;
    ray.outer_slope = half_width_slope(outer_radius, drift, length);
    ray.core_slope = half_width_slope(occludee.radius, drift, length);
    ray.drop_slope = i32(quotient_q24(u32(max(drop, 0)), u32(farthest)));
    ray.margin = (abs(height_slope) >> 24u) + 4;
    ray.cross_slope = cross_slope;
    return ray;
}

fn raymarch_occlusion(occludee: Occludee, over_noise: bool, skipped_end: i32) -> bool {
    let east = occludee.x - culling.eye.x;
    let up = occludee.top - culling.eye.y;
    let south = occludee.z - culling.eye.z;
    let length = max(abs(east), abs(south));
    if length == 0 || (abs(up) >> 4u) >= length {
        return false;
    }
    let whole = u32(length);
    let by_x = i32(quotient_q24(u32(abs(east)), whole));
    let by_z = i32(quotient_q24(u32(abs(south)), whole));
    let by_y = i32(quotient_q24(u32(abs(up)), whole));
    let last = (1 << GRID_BITS) - 1;
    for (var n = 1; n <= MAX_STEPS; n++) {
        let progress = n * culling.step;
        if progress >= length - skipped_end {
            break;
        }
        let x = culling.eye.x + select(1, -1, east < 0) * mul_hi(by_x << 2u, progress << 6u);
        let z = culling.eye.z + select(1, -1, south < 0) * mul_hi(by_z << 2u, progress << 6u);
        let y = culling.eye.y + select(1, -1, up < 0) * mul_hi(by_y << 2u, progress << 6u);
        let at = clamp(vec2i(x, z), vec2i(0), vec2i(last));
        var land = 0;
        if over_noise {
            land = noise_at(at.x, at.y);
        }
        else {
            land = bilinear_at(at.x, at.y);
        }
        if land > y {
            return true;
        }
    }
    return false;
}

@group(0) @binding(4)
var<storage, read> records: array<u32>;

fn root_of(square: u32) -> i32 {
    var root = 0u;
    for (var bit = 0u; bit < 16u; bit++) {
        let more = root | (1u << (15u - bit));
        if more * more <= square {
            root = more;
        }
    }
    return i32(root) + select(0, 1, root * root < square);
}

fn roughness_of(shore: i32, exposure: i32, rim: i32, height: i32, inland: i32, flatness: i32) -> i32 {
    let near = window(clamp(shore, 1 - (1 << 21u), (1 << 21u) - 1) << 9u);
    let coast = mul_hi(near << 1u, (9 << 27u) + (exposure >> 2u) * 3);
    let foot = mul_hi(inland << 1u, (ALMOST_ONE_Q30 - inland) << 1u);
    let rocky = mul_hi(inland << 1u, flatness << 1u) + foot * 2 + (foot >> 1u);
    let sum = (coast >> 1u) + mul_hi(height << 1u, rocky) + (1 << 23u);
    return (mul_hi(min(sum, MAX_ROUGHNESS) << 2u, rim << 1u) + (1 << 14u)) >> 15u;
}

fn round_to_units(fine: i32) -> i32 {
    return (fine + (1 << (FINE_BITS - UNIT_BITS - 1u))) >> (FINE_BITS - UNIT_BITS);
}

fn sample_at(lattice: Lattice, x: i32, z: i32) -> Sample {
    let place = turned(lattice, x, z);
    let bits = vec2u(lattice.bits);
    let cell = place >> bits;
    let next = (cell + 1u) & (vec2u(4294967295u) >> bits);
    let inside = place & vec2u((1u << lattice.bits) - 1u);
    let low = bitcast<vec2i>(inside << (31u - bits));
    let high = low ^ vec2i(-2147483647 - 1);
    let fade_x = fade(low.x);
    let fade_z = fade(low.y);
    let c00 = corner(lattice.seed, cell, low.x, low.y);
    let c10 = corner(lattice.seed, vec2u(next.x, cell.y), high.x, low.y);
    let c01 = corner(lattice.seed, vec2u(cell.x, next.y), low.x, high.y);
    let c11 = corner(lattice.seed, next, high.x, high.y);
    let west = lerp(c00.value, c01.value, fade_z);
    let east = lerp(c10.value, c11.value, fade_z);
    let north = lerp(c00.value, c10.value, fade_x);
    let south = lerp(c01.value, c11.value, fade_x);
    let mean_x = lerp(lerp(c00.gradient.x, c10.gradient.x, fade_x), lerp(c01.gradient.x, c11.gradient.x, fade_x), fade_z);
    let mean_z = lerp(lerp(c00.gradient.y, c10.gradient.y, fade_x), lerp(c01.gradient.y, c11.gradient.y, fade_x), fade_z);
    let gradient = vec2i((mean_x >> 3u) + mul_hi(east - west, fade_slope(low.x)), (mean_z >> 3u) + mul_hi(south - north, fade_slope(low.y)));
    return Sample(lerp(west, east, fade_x), gradient);
}

fn seams_of(words: ChunkWords) -> Seams {
    return Seams(words.edges, words.corners, words.inside);
}

fn shape_of(half: i32, height: i32, is_far: bool, slope: Slope, push: i32) -> Shape {
    if KIND != KIND_GRASS {
        let core = ((half * 84) >> 8u) + 1;
        let drop = (height * 84) >> 8u;
        return Shape(core, core, ((half * 277) >> 8u) + 1 - core, drop, height + 1);
    }
    let steep = select(16384, steepness(slope.east, slope.south), slope.is_known);
    let lean = lean_of(height, steep, push);
    let foot = select(half, (((height * steep) >> 14u) * steep) >> 15u, slope.is_known);
    let over = height + foot + (half >> 6u) + 2;
    let spread = select(half, ((half * 154) >> 8u) + 1, is_far);
    if is_far && slope.is_known && spread + lean < half {
        let radius = spread + lean;
        return Shape(radius, spread, half - radius, height + foot, over);
    }
    let radius = select(half + lean, max(half, spread + lean), is_far);
    return Shape(radius, half, 0, 0, over);
}

fn share_along(part: i32, whole: i32, span: i32, bits: u32) -> i32 {
    let cut = max(bits, 14u) - 14u;
    let divisor = max(u32(whole >> cut), 1u);
    return i32(u32(part >> cut) * u32(span >> cut) / divisor) << cut;
}

fn shared_number(own: u32, cell: u32, share: u32) -> u32 {
    return ((16u - share) * own + share * cell) >> 4u;
}

fn shore_of(mass: i32) -> i32 {
    let rim = ALMOST_ONE_Q30 - (min(mass, (1 << 27u) - 1) << 3u);
    let middle = max(mass - (5 << 27u), 0);
    return mul_hi(square(middle), UPLIFT_M << 18u) - mul_hi(square(rim), RIM_M << 18u);
}

fn sink_of(half: i32, height: i32, near: i32, presence: i32) -> i32 {
    if near <= 512 || presence < 256 {
        return 0;
    }
    return min((height * 10) >> 8u, (half * 56) >> 8u);
}

fn slope_at(x: i32, z: i32) -> Slope {
    let step = 1 << STEP_BITS;
    let last = (1 << GRID_BITS) - 1;
    let west = height_at(max(x - step, 0), z);
    let east = height_at(min(x + step, last), z);
    let north = height_at(x, max(z - step, 0));
    let south = height_at(x, min(z + step, last));
    if min(min(west, east), min(north, south)) <= (NOWHERE << FINE_UNIT_BITS) {
        return Slope(false, 0, 0);
    }
    let along = east - west;
    let across = south - north;
    if steepness(along, across) > 16384 {
        return Slope(false, 0, 0);
    }
    return Slope(true, along, across);
}

fn sloped_occludee(bits: u32, column: i32, row: i32, block: BlockExtent) -> Occludee {
    let flat = block.extent.occludee;
    let west = column << bits;
    let north = row << bits;
    let side = 1 << bits;
    if bits >= node_at(bits, column, row).finest || is_rough_near(west, north) {
        return flat;
    }
    let step = 1 << STEP_BITS;
    for (var n = 0u; n < 9u; n++) {
        let along = select(select(side + step, step, n % 3u == 1u), -step, n % 3u == 0u);
        let across = select(select(side + step, step, n / 3u == 1u), -step, n / 3u == 0u);
        if is_rough_from(west, north, along, across) {
            return flat;
        }
    }
    let north_west = height_from(west, north, 0, 0);
    let north_east = height_from(west, north, side, 0);
    let south_west = height_from(west, north, 0, side);
    let south_east = height_from(west, north, side, side);
    let east = ((north_east + south_east) - (north_west + south_west)) >> (bits - 13u);
    let south = ((south_west + south_east) - (north_west + north_east)) >> (bits - 13u);
    let plane_steep = steepness(east, south);
    if plane_steep > 32768 {
        return flat;
    }
    let steps = 1 << (bits - STEP_BITS);
    var plane = NOWHERE << FINE_UNIT_BITS;
    var lowest = north_west;
    var steep = 0;
    var apart = 0;
    for (var z = 0; z <= steps; z++) {
        for (var x = 0; x <= steps; x++) {
            let along = x << STEP_BITS;
            let across = z << STEP_BITS;
            let on_west = height_from(west, north, along - step, across);
            let on_east = height_from(west, north, along + step, across);
            let on_north = height_from(west, north, along, across - step);
            let on_south = height_from(west, north, along, across + step);
            let rise = (east * (along - (side >> 1u)) + south * (across - (side >> 1u))) >> 14u;
            plane = max(plane, height_from(west, north, along, across) - rise);
            lowest = min(lowest, min(min(on_west, on_east), min(on_north, on_south)));
            let slope_east = on_east - on_west;
            let slope_south = on_south - on_north;
            steep = max(steep, steepness(slope_east, slope_south) + 4);
            apart = max(apart, steepness(slope_east - east, slope_south - south) + 4);
        }
    }
    if lowest <= (NOWHERE << FINE_UNIT_BITS) {
        return flat;
    }
    let push = push_of(63, 128);
    let shape = shape_of(block.half, block.height, block.is_far, Slope(false, 0, 0), push);
    var over = shape.over + ((plane_steep * shape.radius) >> 14u);
    var reach = shape.radius;
    if steep <= 16384 {
        let lean = lean_of(block.height, steep, push);
        reach = block.half + lean;
        let foot = (((block.height * steep) >> 14u) * steep) >> 15u;
        let raised = ((apart * reach) >> 14u) + ((steep * lean) >> 14u);
        over = block.height + foot + (block.half >> 6u) + 2 + raised;
    }
    let radius = half_diagonal(bits) + reach;
    return Occludee(flat.x, plane + 2 + over + 2, flat.z, radius, radius, flat.taper, flat.taper_drop, east, south);
}

fn slot_bottom(slot: u32, texel: u32) -> i32 {
    return bitcast<i32>(records[slot * RECORD_WORDS + texel]);
}

fn slot_height(slot: u32, column: u32, row: u32) -> i32 {
    return heights[slot * VERTEX_COUNT + row * VERTICES + column];
}

fn smooth_step(x_q30: i32) -> i32 {
    return mul_hi(square(x_q30) << 1u, (3 << 29u) - x_q30) << 2u;
}

fn snapped(seams: Seams, vertex: GridVertex) -> GridVertex {
    let coarser = seams.inside >> 8u;
    let along_x = is_decimated(seams) || ((coarser & 1u) != 0u && vertex.row == 0u) || ((coarser & 4u) != 0u && vertex.row == CELLS);
    let along_z = is_decimated(seams) || ((coarser & 8u) != 0u && vertex.column == 0u) || ((coarser & 2u) != 0u && vertex.column == CELLS);
    return GridVertex(vertex.column - select(0u, vertex.column & 1u, along_x), vertex.row - select(0u, vertex.row & 1u, along_z));
}

fn spline_cell(coordinate: i32) -> i32 {
    return coordinate >> SPLINE_CELL_BITS;
}

fn spline_fraction(coordinate: i32) -> i32 {
    return coordinate & ((1 << SPLINE_CELL_BITS) - 1);
}

fn spline_height(nodes: vec3i, t_q13: i32) -> i32 {
    let rise = nodes.y - nodes.x;
    let bend = (nodes.z - nodes.y) - rise;
    return ((nodes.x + nodes.y) >> 1u) + mul_hi(rise << 1u, t_q13 << (31u - SPLINE_CELL_BITS)) + mul_hi(bend, (t_q13 * t_q13) << (31u - 2u * SPLINE_CELL_BITS));
}

fn spline_node(cell: i32) -> i32 {
    return (cell << SPLINE_CELL_BITS) + (1 << (SPLINE_CELL_BITS - 1u));
}

fn spline_share(nodes: vec3i, weights: vec3i) -> i32 {
    let sum = nodes.x * weights.x + nodes.y * weights.y + nodes.z * weights.z;
    return (sum + (1 << 14u)) >> 15u;
}

fn spline_weights(t_q13: i32) -> vec3i {
    let rest = (1 << SPLINE_CELL_BITS) - t_q13;
    let before = (rest * rest) >> (2u * SPLINE_CELL_BITS - 14u);
    let after = (t_q13 * t_q13) >> (2u * SPLINE_CELL_BITS - 14u);
    return vec3i(before, (1 << 15u) - before - after, after);
}

fn splined(octaves: u32) -> bool {
    return fine_octaves(octaves) + SPLINE_CELL_BITS > FIRST_CELL_BITS;
}

fn splined_node(a: BaseNode, b: BaseNode, c: BaseNode, t: i32) -> BaseNode {
    let weights = spline_weights(t);
    return BaseNode(spline_height(vec3i(a.height, b.height, c.height), t), spline_share(vec3i(a.roughness, b.roughness, c.roughness), weights), spline_share(vec3i(a.exposure, b.exposure, c.exposure), weights));
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

fn spread_of(kind: u32, is_far: bool) -> i32 {
    return select(0, SPREAD, kind == KIND_GRASS && !is_far);
}

fn spread_place(first: u32, index: u32, random: vec2u) -> vec2u {
    let even = vec2u(first, first << 16u) + index * vec2u(3242174889u, 2447445413u);
    return (even >> vec2u(32u - planting.cell_bits)) + (random & vec2u(SPREAD_JITTER));
}

fn square(x_q30: i32) -> i32 {
    return mul_hi(x_q30 << 1u, x_q30 << 1u);
}

fn steepness(along: i32, across: i32) -> i32 {
    return max(abs(along), abs(across)) + (min(abs(along), abs(across)) >> 1u);
}

fn stir(words: vec4u) -> vec4u {
    var v = words;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

fn stretch_is_above(ray: Ray, major: i32, centre: i32, half: i32, height: i32, taper: Taper) -> bool {
    let last = (1 << GRID_BITS) - 1;
    let low = clamp(centre - half, 0, last);
    let high = clamp(centre + half, 0, last);
    if height_above_ray(ray, major, centre, taper, low) < height || height_above_ray(ray, major, centre, taper, high) < height {
        return false;
    }
    if taper.drop > 0 {
        let left = centre - taper.core;
        let right = centre + taper.core;
        if left > low && left < high && height_above_ray(ray, major, centre, taper, left) < height {
            return false;
        }
        if right > low && right < high && height_above_ray(ray, major, centre, taper, right) < height {
            return false;
        }
    }
    let bits = min(cell_bits_on_ray_axes(ray, major, low), cell_bits_on_ray_axes(ray, major, high));
    let inside = major & ((1 << bits) - 1);
    let first = low >> bits;
    let lines = (high >> bits) - first;
    if 2 * lines > MAX_STRETCH {
        return false;
    }
    for (var line = 0; line <= lines; line++) {
        let corner = (first + line) << bits;
        if corner > low && height_above_ray(ray, major, centre, taper, corner) < height {
            return false;
        }
        if ((first + line) & 1) == 0 && corner - 1 > low && height_above_ray(ray, major, centre, taper, corner - 1) < height {
            return false;
        }
        let diagonal = corner + inside;
        if diagonal > low && diagonal < high && height_above_ray(ray, major, centre, taper, diagonal) < height {
            return false;
        }
    }
    return true;
}

fn tilt_of(y: i32, near: i32) -> i32 {
    let up = ((culling.eye.y - y) >> COARSE_BITS) + 1;
    return i32(min(u32(clamp(up, 0, FARTHEST) << 8u) / u32(max(near, 1)), 256u)) + 1;
}

fn turned(lattice: Lattice, x: i32, z: i32) -> vec2u {
    let low = is_low(lattice);
    let along = select(vec2i(3 * x - 4 * z, 4 * x + 3 * z), vec2i(4 * x - 3 * z, 3 * x + 4 * z), low);
    return bitcast<vec2u>(along) + vec2u(lattice.stream * 2654435761u);
}

fn turned_back(lattice: Lattice, gradient: vec2i) -> vec2i {
    let x = gradient.x;
    let z = gradient.y;
    return select(vec2i(3 * x + 4 * z, 3 * z - 4 * x), vec2i(4 * x + 3 * z, 4 * z - 3 * x), is_low(lattice));
}

fn value(low: Edge, high: Edge, east: Weights) -> i32 {
    return low.slope * east.line.x + low.value * east.step.x + high.slope * east.line.y + high.value * east.step.y;
}

fn warp_at(lattice_seeds: array<u32, LATTICES>, x: i32, z: i32) -> vec2i {
    var seeds = lattice_seeds;
    var warp = vec2i(0);
    for (var index = 0u; index < 4u; index++) {
        let wide = index < 2u;
        let stream = WARP_STREAM + index;
        let bits = select(WARP_CELL_BITS.y, WARP_CELL_BITS.x, wide);
        let amplitude = select(WARP_AMPLITUDE_M[1], WARP_AMPLITUDE_M[0], wide) << 19u;
        let lattice = Lattice(seeds[stream - BASE_STREAM], stream, bits);
        let part = mul_hi(sample_at(lattice, x, z).value, amplitude);
        warp += select(vec2i(0, part), vec2i(part, 0), (index & 1u) == 0u);
    }
    return warp;
}

fn weights(fraction: i32) -> Weights {
    let high = fade(fraction << (31u - FRACTION_BITS));
    let low = 2147483648u - bitcast<u32>(high);
    let from_low = bitcast<u32>(fraction) << (32u - FRACTION_BITS);
    let from_high = 0u - from_low;
    let line = vec2i(bitcast<i32>(mul_hi_u(from_low, low) >> 7u), -bitcast<i32>(mul_hi_u(from_high, bitcast<u32>(high)) >> 7u));
    let step = vec2i((high >> 8u) - (1 << 23u), -(high >> 8u));
    return Weights(narrow(line), narrow(step));
}

fn widening_at(bound: i32) -> i32 {
    let begin = max(planting.thin_from >> COARSE_BITS, 1);
    return i32(clamp(u32(min(bound, FARTHEST) << 8u) / u32(begin), 256u, planting.widest));
}

fn window(x_q30: i32) -> i32 {
    return square(ALMOST_ONE_Q30 - square(x_q30));
}
