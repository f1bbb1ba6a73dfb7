@group(0) @binding(0)
var<uniform> planting: Planting;

@group(0) @binding(1)
var<uniform> size: vec4u;

@group(0) @binding(2)
var<storage, read_write> visible_blocks: array<u32>;

@group(0) @binding(3)
var<storage, read_write> indirect_args: array<u32>;

const LANES: u32 = 256u;

const MASK_BEGIN: u32 = 263424u;

const MASK_WORDS: u32 = 32u;

const VISIBILITY_WORDS: u32 = 35u;

const GROUPS_ACROSS: u32 = 32768u;

const DRAWS: u32 = 4u;

const STATS: u32 = 16u;

const PREPARE: u32 = 20u;

const REGIONS: u32 = 24u;

const PREPARE_LANES: u32 = 64u;

var<workgroup> sums: array<vec3u, 256>;

var<workgroup> block_count: u32;

fn inclusive_scan(lane: u32, own: vec3u) -> vec3u {
    workgroupBarrier();
    sums[lane] = own;
    for (var reach = 1u; reach < LANES; reach *= 2u) {
        workgroupBarrier();
        let below = select(vec3u(0u), sums[max(lane, reach) - reach], lane >= reach);
        workgroupBarrier();
        sums[lane] += below;
    }
    workgroupBarrier();
    return sums[lane];
}

@compute @workgroup_size(256)
fn scan_blocks(@builtin(local_invocation_index) lane: u32) {
    var total = 0u;
    let rounds = (size.x + LANES - 1u) / LANES;
    for (var n = 0u; n < rounds; n++) {
        let patch_index = n * LANES + lane;
        let own = select(0u, visible_blocks[1u + min(patch_index, max(size.x, 1u) - 1u)], patch_index < size.x);
        let upto = inclusive_scan(lane, vec3u(own, 0u, 0u));
        if patch_index < size.x {
            visible_blocks[1u + patch_index] = total + upto.x - own;
        }
        total += sums[LANES - 1u].x;
    }
    if lane == 0u {
        visible_blocks[0] = size.x;
        visible_blocks[1u + size.x] = total;
        let groups = min(total, planting.room.w);
        indirect_args[0] = min(groups, GROUPS_ACROSS);
        indirect_args[1] = (groups + GROUPS_ACROSS - 1u) / GROUPS_ACROSS;
        indirect_args[2] = 1u;
        indirect_args[STATS] = groups;
        indirect_args[STATS + 1u] = total - groups;
    }
}

@compute @workgroup_size(256)
fn scan_clumps(@builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        block_count = min(visible_blocks[1u + visible_blocks[0]], planting.room.w);
    }
    let count = workgroupUniformLoad(&block_count);
    var total = vec3u(0u);
    let rounds = (count + LANES - 1u) / LANES;
    for (var n = 0u; n < rounds; n++) {
        let block = n * LANES + lane;
        let first = MASK_BEGIN + min(block, max(count, 1u) - 1u) * VISIBILITY_WORDS + MASK_WORDS;
        let has = vec3u(visible_blocks[first], visible_blocks[first + 1u], visible_blocks[first + 2u]);
        let own = select(vec3u(0u), has, block < count);
        let upto = inclusive_scan(lane, own);
        if block < count {
            let begin = total + upto - own;
            visible_blocks[first] = begin.x;
            visible_blocks[first + 1u] = begin.y;
            visible_blocks[first + 2u] = begin.z;
        }
        total += sums[LANES - 1u];
    }
    if lane == 0u {
        let drawn = min(total, planting.room.xyz);
        for (var level = 0u; level < 3u; level++) {
            indirect_args[DRAWS + 4u * level] = planting.vertices[level];
            indirect_args[DRAWS + 4u * level + 1u] = drawn[level];
            indirect_args[DRAWS + 4u * level + 2u] = 0u;
            indirect_args[DRAWS + 4u * level + 3u] = 0u;
        }
        let groups = (drawn.x + drawn.y + drawn.z + PREPARE_LANES - 1u) / PREPARE_LANES;
        indirect_args[PREPARE] = min(groups, GROUPS_ACROSS);
        indirect_args[PREPARE + 1u] = (groups + GROUPS_ACROSS - 1u) / GROUPS_ACROSS;
        indirect_args[PREPARE + 2u] = 1u;
        indirect_args[REGIONS] = 0u;
        indirect_args[REGIONS + 1u] = planting.room.x;
        indirect_args[REGIONS + 2u] = planting.room.x + planting.room.y;
        indirect_args[STATS + 2u] = drawn.x + drawn.y + drawn.z;
        indirect_args[STATS + 3u] = total.x + total.y + total.z - (drawn.x + drawn.y + drawn.z);
    }
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
