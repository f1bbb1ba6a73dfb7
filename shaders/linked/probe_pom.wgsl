struct PomProbe {
    uv: vec2f,
    amplitude: f32,
    lod: u32,
    to_eye: vec3f,
    layer: u32,
    to_sun: vec3f,
    reserved: u32
}

struct PomResult {
    uv: vec2f,
    height: f32,
    residual: f32,
    sun: f32,
    fetches: u32,
    reserved: vec2u
}

@group(0) @binding(0)
var<uniform> pom: PomParams;

@group(0) @binding(1)
var heights: texture_2d_array<f32>;

@group(0) @binding(2)
var smooth_heights: texture_2d_array<f32>;

@group(0) @binding(3)
var max_mips: texture_2d_array<f32>;

@group(0) @binding(4)
var cones: texture_2d_array<f32>;

@group(0) @binding(5)
var tiled: sampler;

@group(0) @binding(6)
var<storage, read> probes: array<PomProbe>;

@group(0) @binding(7)
var<storage, read_write> findings: array<PomResult>;

@compute @workgroup_size(64)
fn probe_pom(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&probes) {
        return;
    }
    let probe = probes[id.x];
    let map = PomMap(probe.layer, textureDimensions(heights).x, probe.lod);
    let ray = pom_ray(probe.uv, probe.to_eye, probe.amplitude);
    let hit = pom_hit(heights, smooth_heights, max_mips, cones, tiled, PomTrace(pom, map, ray));
    let surface = pom_height(heights, smooth_heights, tiled, map, hit.uv, true);
    let sun = pom_sun(heights, smooth_heights, max_mips, tiled, pom, map, hit.uv, hit.height, probe.to_sun, probe.amplitude);
    findings[id.x] = PomResult(hit.uv, hit.height, surface - hit.height, sun, hit.fetches, vec2u(0u));
}

struct Bracket {
    near: f32,
    far: f32,
    near_clearance: f32,
    far_clearance: f32
}

const CONE_BISECTIONS: u32 = 8u;

const CONE_STEPS: u32 = 16u;

const HEIGHTS_EXACT: u32 = 1u;

const LOOP_FLAG: u32 = 1u;

const MAX_NODE_VISITS: u32 = 8192u;

struct MaxMipHit {
    at: f32,
    is_hit: bool,
    fetches: u32
}

struct MaxMipRay {
    start: vec2f,
    along: vec2f,
    height: f32,
    climb: f32,
    end: f32
}

struct NodeExit {
    low: vec2i,
    high: vec2i,
    exits: vec2f,
    exit: f32
}

const POM_AUTO: u32 = 5u;

const POM_CONES: u32 = 3u;

const POM_FLAT: u32 = 0u;

const POM_LINEAR: u32 = 2u;

const POM_MAX_MIP: u32 = 4u;

const POM_MAX_STEPS: u32 = 256u;

const POM_OFFSET: u32 = 1u;

const POM_SHADOW_OFF: u32 = 0u;

const POM_SHADOW_SOFT: u32 = 2u;

struct PomHit {
    uv: vec2f,
    height: f32,
    fetches: u32
}

struct PomMap {
    layer: u32,
    side: u32,
    lod: u32
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

struct PomRay {
    uv: vec2f,
    travel: vec2f,
    cosine: f32,
    amplitude: f32
}

struct PomTrace {
    pom: PomParams,
    map: PomMap,
    ray: PomRay
}

const REFINE_BISECTION: u32 = 3u;

const REFINE_NONE: u32 = 0u;

const REFINE_SECANT: u32 = 2u;

const REFINE_SEGMENT: u32 = 1u;

const SHADOW_START: f32 = 0.5;

struct TraversalState {
    cell: vec2i,
    level: u32,
    at: f32
}

fn clearance(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f, share: f32) -> f32 {
    let exact = trace.pom.heights == HEIGHTS_EXACT;
    let uv = entry + share * trace.ray.travel;
    return (1.0 - share) - pom_height(heights, smooth_heights, tiled, trace.map, uv, exact);
}

fn cone_search(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, cones: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f) -> PomHit {
    let map = trace.map;
    let ray = trace.ray;
    let level = min(map.lod, textureNumLevels(cones) - 1u);
    let side = i32(textureDimensions(cones, level).x);
    let speed = max(length(ray.travel), 1e-9);
    var bracket = Bracket(0.0, 0.0, 0.0, clearance(heights, smooth_heights, tiled, trace, entry, 0.0));
    var fetches = 1u;
    for (var step = 0u; step < CONE_STEPS; step++) {
        if bracket.far_clearance <= 0.0 || bracket.far >= 1.0 {
            break;
        }
        let uv = entry + bracket.far * ray.travel;
        let texel = vec2i((uv - floor(uv)) * f32(side)) & vec2i(side - 1);
        let ratio = textureLoad(cones, texel, map.layer, level).x;
        let step_share = max(ratio * bracket.far_clearance / (speed + ratio), 0.0001);
        let share = min(bracket.far + step_share, 1.0);
        let sampled = clearance(heights, smooth_heights, tiled, trace, entry, share);
        bracket = Bracket(bracket.far, share, bracket.far_clearance, sampled);
        fetches += 2u;
    }
    var bisection = trace;
    bisection.pom.refine = REFINE_BISECTION;
    bisection.pom.refinements = CONE_BISECTIONS;
    if bracket.far_clearance > 0.0 {
        return PomHit(entry + bracket.far * ray.travel, 1.0 - bracket.far, fetches);
    }
    return refine_crossing(heights, smooth_heights, tiled, bisection, entry, bracket, fetches);
}

fn interpolated_crossing(bracket: Bracket) -> f32 {
    let fall = bracket.near_clearance - bracket.far_clearance;
    return mix(bracket.near, bracket.far, bracket.near_clearance / fall);
}

fn linear_search(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f, steps: u32) -> PomHit {
    var bracket = Bracket(0.0, 0.0, 0.0, clearance(heights, smooth_heights, tiled, trace, entry, 0.0));
    var fetches = 1u;
    if trace.pom.loop_form == LOOP_FLAG {
        var done = bracket.far_clearance <= 0.0;
        for (var step = 1u; step <= steps; step++) {
            let share = f32(step) / f32(steps);
            let sampled = clearance(heights, smooth_heights, tiled, trace, entry, share);
            bracket = Bracket(select(bracket.far, bracket.near, done), select(share, bracket.far, done), select(bracket.far_clearance, bracket.near_clearance, done), select(sampled, bracket.far_clearance, done));
            done = done || sampled <= 0.0;
        }
        fetches += steps;
    }
    else {
        for (var step = 1u; step <= steps && bracket.far_clearance > 0.0; step++) {
            let share = f32(step) / f32(steps);
            let sampled = clearance(heights, smooth_heights, tiled, trace, entry, share);
            bracket = Bracket(bracket.far, share, bracket.far_clearance, sampled);
            fetches += 1u;
        }
    }
    return refine_crossing(heights, smooth_heights, tiled, trace, entry, bracket, fetches);
}

fn max_mip_corner(map: PomMap, level: u32) -> vec2i {
    let side = map.side >> map.lod;
    let south = 2u * (map.side - side);
    if level == 0u {
        return vec2i(0, i32(south));
    }
    return vec2i(i32(side), i32(south + side - 2u * (side >> level)));
}

fn max_mip_height(max_mips: texture_2d_array<f32>, map: PomMap, node: vec2i, level: u32) -> f32 {
    let mask = i32(map.side >> (map.lod + level)) - 1;
    return textureLoad(max_mips, max_mip_corner(map, level) + (node & vec2i(mask)), map.layer, 0).x;
}

fn max_mip_traversal(heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, map: PomMap, walk: MaxMipRay) -> MaxMipHit {
    let highest = firstLeadingBit(map.side) - map.lod;
    let per_cell = 1.0 / select(vec2f(1.0), walk.along, abs(walk.along) > vec2f(1e-9));
    let travel = max(abs(walk.along.x), abs(walk.along.y)) * walk.end;
    var traversal = TraversalState(vec2i(floor(walk.start)), min(u32(log2(max(travel, 1.0))), highest), 0.0);
    var fetches = 0u;
    var visits = 0u;
    loop {
        var left: NodeExit;
        var may_touch = false;
        while (visits < MAX_NODE_VISITS) {
            visits += 1u;
            left = node_exit(walk, traversal, per_cell);
            let height = walk.height + walk.climb * traversal.at;
            let lowest = min(height, walk.height + walk.climb * left.exit);
            let top = max_mip_height(max_mips, map, traversal.cell >> vec2u(traversal.level), traversal.level);
            fetches += 1u;
            if lowest <= top {
                may_touch = traversal.level == 0u;
                if may_touch {
                    break;
                }
                if walk.climb < 0.0 && height > top {
                    traversal.at = clamp((top - walk.height) / walk.climb, traversal.at, left.exit);
                }
                traversal.level -= 1u;
                traversal.cell = clamp(vec2i(floor(walk.start + traversal.at * walk.along)), left.low, left.high - 1);
                continue;
            }
            if left.exit >= walk.end {
                traversal.at = walk.end;
                break;
            }
            traversal = next_node(walk, traversal, left, highest);
        }
        if !may_touch {
            break;
        }
        let share = patch_intersection(heights, map, traversal.cell, walk, traversal.at, left.exit);
        fetches += 4u;
        if share >= 0.0 {
            return MaxMipHit(mix(traversal.at, left.exit, share), true, fetches);
        }
        if left.exit >= walk.end {
            traversal.at = walk.end;
            break;
        }
        traversal = next_node(walk, traversal, left, highest);
    }
    return MaxMipHit(traversal.at, false, fetches);
}

fn next_node(walk: MaxMipRay, traversal: TraversalState, left: NodeExit, highest: u32) -> TraversalState {
    var next = clamp(vec2i(floor(walk.start + left.exit * walk.along)), left.low, left.high - 1);
    if left.exits.x <= left.exits.y {
        next.x = select(left.low.x - 1, left.high.x, walk.along.x >= 0.0);
    }
    else {
        next.y = select(left.low.y - 1, left.high.y, walk.along.y >= 0.0);
    }
    let above = vec2u(traversal.level + 1u);
    let rises = traversal.level < highest && any((next >> above) != (left.low >> above));
    return TraversalState(next, select(traversal.level, traversal.level + 1u, rises), left.exit);
}

fn node_exit(walk: MaxMipRay, traversal: TraversalState, per_cell: vec2f) -> NodeExit {
    let low = (traversal.cell >> vec2u(traversal.level)) << vec2u(traversal.level);
    let high = low + vec2i(i32(1u << traversal.level));
    let far = vec2f(select(low, high, walk.along >= vec2f(0.0)));
    let exits = select(vec2f(3e38), (far - walk.start) * per_cell, abs(walk.along) > vec2f(1e-9));
    return NodeExit(low, high, exits, clamp(min(exits.x, exits.y), traversal.at, walk.end));
}

fn patch_intersection(heights: texture_2d_array<f32>, map: PomMap, cell: vec2i, walk: MaxMipRay, from_at: f32, to_at: f32) -> f32 {
    let a = pom_texel(heights, map, cell);
    let b = pom_texel(heights, map, cell + vec2i(1, 0)) - a;
    let c = pom_texel(heights, map, cell + vec2i(0, 1)) - a;
    let d = pom_texel(heights, map, cell + vec2i(1, 1)) - a - b - c;
    let near = clamp(walk.start + from_at * walk.along - vec2f(cell), vec2f(0.0), vec2f(1.0));
    let span = (to_at - from_at) * walk.along;
    let zero = walk.height + walk.climb * from_at - (a + b * near.x + c * near.y + d * near.x * near.y);
    if zero <= 0.0 {
        return 0.0;
    }
    let one = walk.climb * (to_at - from_at) - (b * span.x + c * span.y + d * (near.x * span.y + near.y * span.x));
    let two = -d * span.x * span.y;
    let discriminant = one * one - 4.0 * two * zero;
    if discriminant < 0.0 {
        return -1.0;
    }
    let half = -0.5 * (one + select(-1.0, 1.0, one >= 0.0) * sqrt(discriminant));
    var share = -1.0;
    if one < 0.0 {
        share = zero / max(half, 1e-30);
    }
    else if two < 0.0 {
        share = half / two;
    }
    return select(-1.0, share, share >= 0.0 && share <= 1.0);
}

fn pom_entry(ray: PomRay, pivot: f32) -> vec2f {
    return (ray.uv - floor(ray.uv)) - (1.0 - pivot) * ray.travel;
}

fn pom_height(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, map: PomMap, uv: vec2f, exact: bool) -> f32 {
    let within = uv - floor(uv);
    if !exact {
        return textureSampleLevel(smooth_heights, tiled, within, map.layer, f32(map.lod)).a;
    }
    let place = within * f32(map.side >> map.lod) - 0.5;
    let low = floor(place);
    let part = place - low;
    let cell = vec2i(low);
    let north = mix(pom_texel(heights, map, cell), pom_texel(heights, map, cell + vec2i(1, 0)), part.x);
    let south = mix(pom_texel(heights, map, cell + vec2i(0, 1)), pom_texel(heights, map, cell + vec2i(1, 1)), part.x);
    return mix(north, south, part.y);
}

fn pom_hit(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, cones: texture_2d_array<f32>, tiled: sampler, trace: PomTrace) -> PomHit {
    let ray = trace.ray;
    let travels = ray.amplitude > 0.0 && texel_travel(trace.map, ray) > 0.0;
    if trace.pom.tier == POM_CONES && travels {
        let entry = pom_entry(ray, trace.pom.pivot);
        return pom_return(ray, cone_search(heights, smooth_heights, cones, tiled, trace, entry));
    }
    return pom_hit_no_cones(heights, smooth_heights, max_mips, tiled, trace);
}

fn pom_hit_no_cones(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, tiled: sampler, trace: PomTrace) -> PomHit {
    let pom = trace.pom;
    let map = trace.map;
    let ray = trace.ray;
    let travel = texel_travel(map, ray);
    let tier = pom_tier(pom, travel);
    let exact = pom.heights == HEIGHTS_EXACT;
    if tier == POM_FLAT || ray.amplitude <= 0.0 {
        return PomHit(ray.uv, pom.pivot, 0u);
    }
    if tier == POM_OFFSET || tier == POM_CONES || travel == 0.0 {
        let height = pom_height(heights, smooth_heights, tiled, map, ray.uv, exact);
        let moves = pom.tier != POM_AUTO || travel >= pom.travel_flat;
        return PomHit(select(ray.uv, ray.uv + (pom.pivot - height) * ray.travel, moves), height, 1u);
    }
    let entry = pom_entry(ray, pom.pivot);
    if tier == POM_MAX_MIP {
        let side = f32(map.side >> map.lod);
        let base = floor(entry);
        let start = (entry - base) * side - 0.5;
        let found = max_mip_traversal(heights, max_mips, map, MaxMipRay(start, ray.travel * side, 1.0, -1.0, 1.0));
        return pom_return(ray, PomHit(entry + found.at * ray.travel, 1.0 - found.at, found.fetches));
    }
    var steps = pom_steps(pom, ray);
    var search = trace;
    if pom.tier == POM_AUTO {
        steps = clamp(u32(ceil(travel)) + 1u, 1u, POM_MAX_STEPS);
        search.pom.refine = REFINE_SECANT;
        search.pom.refinements = 3u;
    }
    return pom_return(ray, linear_search(heights, smooth_heights, tiled, search, entry, steps));
}

fn pom_ray(uv: vec2f, to_eye: vec3f, amplitude: f32) -> PomRay {
    let is_from_above = to_eye.z > 1e-5;
    let travel = -to_eye.xy * (amplitude / select(1.0, to_eye.z, is_from_above));
    return PomRay(uv, select(vec2f(0.0), travel, is_from_above), max(to_eye.z, 0.0), amplitude);
}

fn pom_return(ray: PomRay, hit: PomHit) -> PomHit {
    return PomHit(floor(ray.uv) + hit.uv, hit.height, hit.fetches);
}

fn pom_steps(pom: PomParams, ray: PomRay) -> u32 {
    let flatness = acos(clamp(ray.cosine, 0.0, 1.0)) * 0.63661977;
    let steps = mix(f32(pom.steps_min), f32(pom.steps_max), flatness);
    return clamp(u32(ceil(steps - 0.001)), 1u, POM_MAX_STEPS);
}

fn pom_sun(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, tiled: sampler, pom: PomParams, map: PomMap, uv: vec2f, height: f32, to_sun: vec3f, amplitude: f32) -> f32 {
    if pom.shadow == POM_SHADOW_OFF || amplitude <= 0.0 {
        return 1.0;
    }
    if to_sun.z <= 0.0 {
        return 0.0;
    }
    let travel = to_sun.xy * (amplitude / max(to_sun.z, 0.0001));
    if pom.shadow == POM_SHADOW_SOFT {
        return soft_sun(heights, smooth_heights, tiled, pom, map, uv, height, travel);
    }
    let side = f32(map.side >> map.lod);
    let speed = length(travel) * side;
    if speed < SHADOW_START {
        return 1.0;
    }
    let within = uv - floor(uv);
    let lift = SHADOW_START / speed;
    let walk = MaxMipRay(within * side - 0.5 + travel * side * lift, travel * side, height + lift, 1.0, max(1.0 - height - lift, 0.0));
    return select(1.0, 0.0, max_mip_traversal(heights, max_mips, map, walk).is_hit);
}

fn pom_texel(heights: texture_2d_array<f32>, map: PomMap, at: vec2i) -> f32 {
    let mask = i32(map.side >> map.lod) - 1;
    return textureLoad(heights, at & vec2i(mask), map.layer, map.lod).x;
}

fn pom_tier(pom: PomParams, travel: f32) -> u32 {
    if pom.tier != POM_AUTO {
        return pom.tier;
    }
    if travel < pom.travel_offset {
        return POM_OFFSET;
    }
    return select(POM_MAX_MIP, POM_LINEAR, travel < pom.travel_linear);
}

fn refine_crossing(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f, found: Bracket, spent: u32) -> PomHit {
    let pom = trace.pom;
    var bracket = found;
    var fetches = spent;
    var share = bracket.far;
    if pom.refine != REFINE_NONE && bracket.near_clearance > 0.0 {
        let rounds = select(pom.refinements, 0u, pom.refine == REFINE_SEGMENT);
        for (var round = 0u; round < rounds; round++) {
            share = select(interpolated_crossing(bracket), 0.5 * (bracket.near + bracket.far), pom.refine == REFINE_BISECTION);
            let sampled = clearance(heights, smooth_heights, tiled, trace, entry, share);
            fetches += 1u;
            if sampled > 0.0 {
                bracket = Bracket(share, bracket.far, sampled, bracket.far_clearance);
            }
            else {
                bracket = Bracket(bracket.near, share, bracket.near_clearance, sampled);
            }
        }
        share = interpolated_crossing(bracket);
    }
    return PomHit(entry + share * trace.ray.travel, 1.0 - share, fetches);
}

fn soft_sun(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, pom: PomParams, map: PomMap, uv: vec2f, height: f32, travel: vec2f) -> f32 {
    var darkest = 0.0;
    for (var tap = 0u; tap < 7u; tap++) {
        let fraction = 0.88 - 0.11 * f32(tap);
        let weight = select(2.0 * f32(tap), 1.0, tap == 0u);
        let there = pom_height(heights, smooth_heights, tiled, map, uv + fraction * travel, pom.heights == HEIGHTS_EXACT);
        darkest = max(darkest, (there - height - fraction) * weight * 0.58);
    }
    return 1.0 - clamp(darkest, 0.0, 1.0);
}

fn texel_travel(map: PomMap, ray: PomRay) -> f32 {
    return length(ray.travel) * f32(map.side >> map.lod);
}
