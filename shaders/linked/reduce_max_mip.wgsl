struct MaxMipReduction {
    side: u32,
    lod: u32,
    level: u32,
    reserved: u32
}

@group(0) @binding(0)
var<uniform> order: MaxMipReduction;

@group(0) @binding(1)
var heights: texture_2d_array<f32>;

@group(0) @binding(2)
var max_mips: texture_2d_array<f32>;

@group(0) @binding(3)
var found: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(8, 8)
fn reduce_max_mip(@builtin(global_invocation_id) id: vec3u) {
    let side = order.side >> (order.lod + order.level);
    if id.x >= side || id.y >= side {
        return;
    }
    let map = PomMap(id.z, order.side, order.lod);
    var top = 0.0;
    let corner = max_mip_corner(map, order.level);
    for (var index = 0u; index < 4u; index++) {
        let quarter = vec2u(index & 1u, index >> 1u);
        if order.level == 0u {
            top = max(top, pom_texel(heights, map, vec2i(id.xy + quarter)));
        }
        else {
            let below = vec2i(2u * id.xy + quarter);
            let finer = max_mip_corner(map, order.level - 1u) + below;
            top = max(top, textureLoad(max_mips, finer, id.z, 0).x);
        }
    }
    textureStore(found, corner + vec2i(id.xy), id.z, vec4f(top));
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

fn pom_texel(heights: texture_2d_array<f32>, map: PomMap, at: vec2i) -> f32 {
    let mask = i32(map.side >> map.lod) - 1;
    return textureLoad(heights, at & vec2i(mask), map.layer, map.lod).x;
}
