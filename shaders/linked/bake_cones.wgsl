struct ConeOrder {
    side: u32,
    lod: u32,
    layer: u32,
    block: u32,
    first: u32,
    count: u32,
    reserved: vec2u,
    directions: array<vec4i, 16>
}

const CONE_STEP_BITS: u32 = 12u;

const WIDEST_CONE: f32 = 1.0;

@group(0) @binding(0)
var<uniform> order: ConeOrder;

@group(0) @binding(1)
var heights: texture_2d_array<f32>;

@group(0) @binding(2)
var max_mips: texture_2d_array<f32>;

@group(0) @binding(3)
var baked: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(64)
fn bake_cones(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= order.count {
        return;
    }
    let map = PomMap(order.layer, order.side, order.lod);
    let cones = (order.side >> order.lod) / order.block;
    let cone = vec2u((order.first + id.x) % cones, (order.first + id.x) / cones);
    var tip = 1.0;
    for (var index = 0u; index < order.block * order.block; index++) {
        let within = vec2u(index % order.block, index / order.block);
        tip = min(tip, pom_texel(heights, map, vec2i(cone * order.block + within)));
    }
    let top = max_mip_height(max_mips, map, vec2i(0), firstLeadingBit(order.side) - order.lod);
    let middle = vec2i((2u * cone + 1u) * order.block) << vec2u(CONE_STEP_BITS);
    var ratio = WIDEST_CONE;
    for (var pair = 0u; pair < 16u; pair++) {
        let two = order.directions[pair];
        ratio = narrowed_cone(map, middle, two.xy, tip, top, ratio);
        ratio = narrowed_cone(map, middle, two.zw, tip, top, ratio);
    }
    textureStore(baked, cone, order.layer, vec4f(ratio));
}

fn height_along(map: PomMap, middle: vec2i, along: vec2i, steps: i32) -> f32 {
    return pom_texel(heights, map, (middle + steps * along) >> vec2u(CONE_STEP_BITS + 1u));
}

fn narrowed_cone(map: PomMap, middle: vec2i, along: vec2i, tip: f32, top: f32, widest: f32) -> f32 {
    let side = i32(map.side >> map.lod);
    let per_half_texel = 0.5 / f32(side);
    var ratio = widest;
    var steps = select(1, 2, order.block == 1u);
    var here = height_along(map, middle, along, steps);
    while (steps <= 2 * side) {
        let way = f32(steps) * per_half_texel;
        if ratio * (top - tip) <= way {
            break;
        }
        let next = height_along(map, middle, along, steps + 2);
        if here > tip && next < here {
            ratio = min(ratio, (way + per_half_texel) / (here - tip));
        }
        here = next;
        steps += 2;
    }
    return ratio;
}

struct PomMap {
    layer: u32,
    side: u32,
    lod: u32
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

fn pom_texel(heights: texture_2d_array<f32>, map: PomMap, at: vec2i) -> f32 {
    let mask = i32(map.side >> map.lod) - 1;
    return textureLoad(heights, at & vec2i(mask), map.layer, map.lod).x;
}
