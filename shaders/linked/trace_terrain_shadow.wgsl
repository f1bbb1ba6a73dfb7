struct SunParams {
    toward: vec2f,
    slope_low: f32,
    slope_high: f32,
    elevation: f32,
    root_bits: u32,
    columns: u32,
    rows: u32,
    max_height: i32,
    sky: u32
}

const SKY_TRACE: u32 = 0u;

const SKY_DARK: u32 = 1u;

struct PageNode {
    link: u32,
    max_height: i32
}

const LEAF: u32 = 2147483648u;

const EMPTY_LINK: u32 = 2147483647u;

struct ShadowTarget {
    x: i32,
    z: i32,
    slot: u32,
    level: u32
}

@group(0) @binding(0)
var<uniform> sun_params: SunParams;

@group(0) @binding(1)
var<storage, read> heights: array<i32>;

@group(0) @binding(2)
var<storage, read> maxima: array<i32>;

@group(0) @binding(3)
var<storage, read> nodes: array<PageNode>;

@group(0) @binding(4)
var<storage, read> targets: array<ShadowTarget>;

@group(0) @binding(5)
var<storage, read_write> sun_clearances: array<u32>;

const STEPS_PER_UNIT: f32 = 1.0 / 512.0;

const CHUNK_CELL_BITS: u32 = 6u;

const BLOCK_CELL_BITS: u32 = 3u;

const BLOCK_TEXELS: u32 = 85u;

const MAX_VISITS: u32 = 1024u;

const MAX_CELLS: u32 = 16u;

const MIN_DISTANCE: f32 = 0.5;

const FAR_AWAY: f32 = 1000000000.0;

fn on_triangles(corners: vec4f, at: vec2f) -> f32 {
    if at.x >= at.y {
        return corners.x + at.x * (corners.y - corners.x) + at.y * (corners.w - corners.y);
    }
    return corners.x + at.y * (corners.z - corners.x) + at.x * (corners.w - corners.z);
}

fn cell_corners(slot: u32, column: u32, row: u32) -> vec4f {
    let first = slot * VERTEX_COUNT + row * VERTICES + column;
    let corners = vec4i(heights[first], heights[first + 1u], heights[first + VERTICES], heights[first + VERTICES + 1u]);
    return vec4f(corners) * STEPS_PER_UNIT;
}

fn is_in_page_table(cell: vec2i) -> bool {
    let extent = vec2i(i32(sun_params.columns), i32(sun_params.rows)) << vec2u(sun_params.root_bits);
    return all(cell >= vec2i(0)) && all(cell < extent);
}

fn root_of(cell: vec2i) -> u32 {
    let root = vec2u(cell) >> vec2u(sun_params.root_bits);
    return root.y * sun_params.columns + root.x;
}

fn child_index(cell: vec2i, bits: u32) -> u32 {
    let at = (vec2u(cell) >> vec2u(bits)) & vec2u(1u);
    return at.x + 2u * at.y;
}

fn drawn_height(cell: vec2i, point: vec2i) -> f32 {
    if !is_in_page_table(cell) {
        return 0.0;
    }
    var bits = sun_params.root_bits;
    var node = nodes[root_of(cell)];
    while (node.link < EMPTY_LINK && bits > CHUNK_CELL_BITS) {
        bits -= 1u;
        node = nodes[node.link + child_index(cell, bits)];
    }
    if (node.link & LEAF) == 0u {
        return 0.0;
    }
    let level = bits - CHUNK_CELL_BITS;
    let inside = vec2u(cell) & vec2u((1u << bits) - 1u);
    let at = inside >> vec2u(level);
    let low = vec2i((vec2u(cell) >> vec2u(level)) << vec2u(level));
    let corners = cell_corners(node.link & ~LEAF, at.x, at.y);
    return on_triangles(corners, vec2f(point - low) / f32(1u << level));
}

fn start_height(chunk: ShadowTarget, column: u32, row: u32, place: vec2i) -> f32 {
    var height = f32(heights[chunk.slot * VERTEX_COUNT + row * VERTICES + column]) * STEPS_PER_UNIT;
    if column == 0u || column == CELLS || row == 0u || row == CELLS {
        for (var side = 0u; side < 4u; side++) {
            let toward = vec2i(vec2u(side & 1u, side >> 1u)) - vec2i(1);
            height = max(height, drawn_height(place + toward, place));
        }
    }
    return max(height, 0.0);
}

fn exit_distances(low: vec2f, side: f32) -> vec2f {
    let edge = low + select(vec2f(0.0), vec2f(side), sun_params.toward > vec2f(0.0));
    let toward = select(sun_params.toward, vec2f(1.0), sun_params.toward == vec2f(0.0));
    return select(edge / toward, vec2f(FAR_AWAY), sun_params.toward == vec2f(0.0));
}

fn raise_horizon(horizon: f32, start: f32, corners: vec4f, low: vec2f, side: f32, ahead: f32) -> f32 {
    if ahead < MIN_DISTANCE {
        return horizon;
    }
    let at = clamp((sun_params.toward * ahead - low) / side, vec2f(0.0), vec2f(1.0));
    return max(horizon, (on_triangles(corners, at) - start) / ahead);
}

struct HorizonTrace {
    horizon: f32,
    ahead: f32
}

fn trace_block(slot: u32, level: u32, cell: vec2i, place: vec2i, start: f32, trace: HorizonTrace) -> HorizonTrace {
    let chunk_mask = (1u << (level + CHUNK_CELL_BITS)) - 1u;
    let chunk_low = vec2i(vec2u(cell) & ~vec2u(chunk_mask));
    var at = vec2i((vec2u(cell) & vec2u(chunk_mask)) >> vec2u(level));
    let block = at >> vec2u(BLOCK_CELL_BITS);
    let side = f32(1u << level);
    let diagonal_rate = sun_params.toward.x - sun_params.toward.y;
    var horizon = trace.horizon;
    var t_enter = trace.ahead;
    for (var crossed = 0u; crossed < MAX_CELLS; crossed++) {
        let corners = cell_corners(slot, u32(at.x), u32(at.y));
        let low = vec2f(chunk_low + (at << vec2u(level)) - place);
        let exits = exit_distances(low, side);
        let t_exit = max(min(exits.x, exits.y), t_enter);
        if crossed == 0u {
            horizon = raise_horizon(horizon, start, corners, low, side, t_enter);
        }
        horizon = raise_horizon(horizon, start, corners, low, side, t_exit);
        if diagonal_rate != 0.0 {
            let diagonal = (low.x - low.y) / diagonal_rate;
            if diagonal > t_enter && diagonal < t_exit {
                horizon = raise_horizon(horizon, start, corners, low, side, diagonal);
            }
        }
        t_enter = t_exit;
        at += select(vec2i(0, 1), vec2i(1, 0), exits.x <= exits.y) * vec2i(sign(sun_params.toward));
        if any((at >> vec2u(BLOCK_CELL_BITS)) != block) {
            break;
        }
    }
    return HorizonTrace(horizon, t_enter);
}

fn horizon_slope(place: vec2i, start: f32) -> f32 {
    var trace = HorizonTrace(sun_params.slope_low, 0.0);
    for (var visit = 0u; visit < MAX_VISITS; visit++) {
        let ray_height = start + trace.horizon * trace.ahead;
        if f32(sun_params.max_height) * STEPS_PER_UNIT <= ray_height || trace.horizon >= sun_params.slope_high {
            break;
        }
        let entered = trace.ahead + max(trace.ahead * exp2(-20.0), exp2(-8.0));
        let cell = place + vec2i(floor(sun_params.toward * entered));
        if !is_in_page_table(cell) {
            break;
        }
        var bits = sun_params.root_bits;
        var node = nodes[root_of(cell)];
        while (node.link < EMPTY_LINK && bits > CHUNK_CELL_BITS && f32(node.max_height) * STEPS_PER_UNIT > ray_height) {
            bits -= 1u;
            node = nodes[node.link + child_index(cell, bits)];
        }
        let is_above = f32(node.max_height) * STEPS_PER_UNIT > ray_height;
        if is_above && (node.link & LEAF) != 0u {
            let slot = node.link & ~LEAF;
            let level = bits - CHUNK_CELL_BITS;
            let inside = vec2u(cell) & vec2u((1u << bits) - 1u);
            var is_higher = true;
            var blocks = 1u;
            while (is_higher && blocks < 8u) {
                blocks *= 2u;
                bits -= 1u;
                let at = inside >> vec2u(bits);
                let texel = BLOCK_TEXELS - (4u * blocks * blocks - 1u) / 3u + at.y * blocks + at.x;
                is_higher = f32(maxima[slot * BLOCK_TEXELS + texel]) * STEPS_PER_UNIT > ray_height;
            }
            if is_higher {
                trace = trace_block(slot, level, cell, place, start, trace);
                trace.ahead = max(trace.ahead, entered);
                continue;
            }
        }
        let low = vec2i((vec2u(cell) >> vec2u(bits)) << vec2u(bits)) - place;
        let exits = exit_distances(vec2f(low), f32(1u << bits));
        trace.ahead = max(min(exits.x, exits.y), entered);
    }
    return trace.horizon;
}

fn sun_clearance_of(chunk: ShadowTarget, column: u32, row: u32) -> u32 {
    let place = vec2i(chunk.x, chunk.z) + vec2i(vec2u(column, row) << vec2u(chunk.level));
    let horizon = horizon_slope(place, start_height(chunk, column, row, place));
    return clearance_byte((sun_params.elevation - atan(horizon)) / SUN_RADIUS);
}

@compute @workgroup_size(64)
fn trace_terrain_shadow(@builtin(global_invocation_id) invocation: vec3u) {
    let word = invocation.x;
    if word >= CLEARANCE_WORDS {
        return;
    }
    let chunk = targets[invocation.y];
    let row = word / CLEARANCE_ROW_WORDS;
    let first = 4u * (word % CLEARANCE_ROW_WORDS);
    var packed = 0u;
    for (var n = 0u; n < 4u; n++) {
        let column = first + n;
        var byte = 255u;
        if sun_params.sky == SKY_DARK {
            byte = 1u;
        }
        else if sun_params.sky == SKY_TRACE && column < VERTICES {
            byte = sun_clearance_of(chunk, column, row);
        }
        packed |= byte << (8u * n);
    }
    sun_clearances[chunk.slot * CLEARANCE_WORDS + word] = packed;
}

const CELLS: u32 = 64u;

const CLEARANCE_RANGE: f32 = 8.0;

const CLEARANCE_ROW_WORDS: u32 = (VERTICES + 3u) / 4u;

const CLEARANCE_WORDS: u32 = CLEARANCE_ROW_WORDS * VERTICES;

const SUN_RADIUS: f32 = 0.004651;

const VERTEX_COUNT: u32 = 4225u;

const VERTICES: u32 = 65u;

fn clearance_byte(clearance: f32) -> u32 {
    let part = clamp(clearance / CLEARANCE_RANGE, -1.0, 1.0);
    return u32(128.5 + 127.0 * sign(part) * sqrt(abs(part)));
}
