struct Bake {
    layer: u32,
    size: u32,
    normals_given: u32,
    occlusion_given: u32
}

struct BakeTexel {
    albedo: vec3f,
    height: f32,
    normal: vec2f,
    roughness: f32,
    occlusion: f32
}

@group(0) @binding(0)
var<uniform> bake: Bake;

@group(0) @binding(1)
var<storage, read_write> texels: array<BakeTexel>;

@group(0) @binding(2)
var colours: texture_storage_2d_array<rgba16float, write>;

@group(0) @binding(3)
var shapes: texture_storage_2d_array<rgba8unorm, write>;

@group(0) @binding(4)
var heights: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(64)
fn evaluate_recipe(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= bake.size || id.y >= bake.size {
        return;
    }
    let uv = (vec2f(id.xy) + 0.5) / f32(bake.size);
    let made = recipe(bake.layer, TilePoint(uv, 1u));
    texels[id.y * bake.size + id.x] = BakeTexel(made.albedo, made.height, vec2f(0.0), made.roughness, 1.0);
}

fn height_at(x: i32, y: i32, scale: f32) -> f32 {
    let mask = i32(bake.size) - 1;
    return texels[u32((y & mask) * i32(bake.size) + (x & mask))].height * scale;
}

@compute @workgroup_size(64)
fn derive_and_store(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= bake.size || id.y >= bake.size {
        return;
    }
    let texel = texels[id.y * bake.size + id.x];
    let material = material_sets[bake.layer];
    let scale = material.relief_m / material.tile_m * f32(bake.size);
    let x = i32(id.x);
    let y = i32(id.y);
    var normal = texel.normal;
    if bake.normals_given == 0u {
        let slope = 0.5 * vec2f(height_at(x + 1, y, scale) - height_at(x - 1, y, scale), height_at(x, y + 1, scale) - height_at(x, y - 1, scale));
        normal = -slope * inverseSqrt(1.0 + dot(slope, slope));
    }
    var occlusion = texel.occlusion;
    if bake.occlusion_given == 0u {
        occlusion = sky_seen(x, y, texel.height * scale, scale);
    }
    textureStore(colours, id.xy, bake.layer, vec4f(texel.albedo, texel.height));
    textureStore(shapes, id.xy, bake.layer, vec4f((normal * 127.0 + 128.0) / 255.0, texel.roughness, occlusion));
    textureStore(heights, id.xy, bake.layer, vec4f(texel.height));
}

fn sky_seen(x: i32, y: i32, here: f32, scale: f32) -> f32 {
    var rings = array<f32, 3>(2.0, 5.0, 11.0);
    var seen = 0.0;
    for (var index = 0u; index < 8u; index++) {
        let angle = 0.7853982 * (f32(index) + 0.5);
        let ahead = vec2f(cos(angle), sin(angle));
        var steepest = 0.0;
        for (var ring = 0u; ring < 3u; ring++) {
            let distance = rings[ring];
            let there = vec2i(round(ahead * distance));
            steepest = max(steepest, (height_at(x + there.x, y + there.y, scale) - here) / distance);
        }
        seen += 1.0 / (1.0 + steepest * steepest);
    }
    return seen / 8.0;
}

struct Blade {
    height: f32,
    tone: f32,
    along: f32
}

const CLIFF: u32 = 4u;

struct Cellular {
    nearest: f32,
    margin: f32,
    offset: vec2f,
    hash: u32
}

const DRY_GRASS: u32 = 2u;

const MATERIAL_SETS = array<MaterialSet, 7>(MaterialSet(4.0, 0.05, 0.05, vec3f(0.4868, 0.374, 0.2264)), MaterialSet(4.0, 0.06, 1.0, vec3f(0.0526, 0.0806, 0.0235)), MaterialSet(4.0, 0.07, 1.0, vec3f(0.1447, 0.1192, 0.0579)), MaterialSet(8.0, 0.36, 1.0, vec3f(0.0541, 0.0908, 0.0236)), MaterialSet(8.0, 0.34, 0.0, vec3f(0.1788, 0.1562, 0.1271)), MaterialSet(4.0, 0.16, 1.0, vec3f(0.1267, 0.1131, 0.0966)), MaterialSet(4.0, 0.1, 1.0, vec3f(0.1895, 0.1699, 0.1328)));

const MEADOW: u32 = 1u;

struct MaterialSet {
    tile_m: f32,
    relief_m: f32,
    turn: f32,
    mean: vec3f
}

struct Recipe {
    albedo: vec3f,
    height: f32,
    roughness: f32
}

const SAND: u32 = 0u;

const SCREE: u32 = 5u;

const THICKET: u32 = 3u;

struct TilePoint {
    uv: vec2f,
    tiles: u32
}

fn cliff(at: TilePoint) -> Recipe {
    let warp = tile_fbm(at, vec2u(2u, 4u), 4u, 181u);
    let rough = tile_fbm(at, vec2u(16u), 3u, 207u);
    let bent = TilePoint(at.uv + vec2f(0.05, 0.11) * (warp - 0.5) + vec2f(0.035, -0.03) * (rough - 0.5), at.tiles);
    let bed_at = bent.uv.y * 8.0 + 0.35 * tile_noise(at, vec2u(8u, 4u), 186u);
    let bed = i32(floor(bed_at));
    let within = bed_at - floor(bed_at);
    let hash = tile_hash(at, vec2i(0, bed), vec2u(1u, 8u), 187u);
    let hard = unit_of(hash);
    let worn = smoothstep(0.0, 0.14 + 0.3 * (1.0 - hard), within) * smoothstep(0.0, 0.1, 1.0 - within);
    let lumps = tile_fbm(at, vec2u(8u), 3u, 195u);
    let joints = tile_cellular(bent, vec2u(16u, 8u), 0.95, 188u);
    let small_joints = tile_cellular(bent, vec2u(16u, 32u), 1.0, 189u);
    let gape = smoothstep(0.4, 0.62, lumps);
    let crack = mix(1.0, smoothstep(0.0, 0.09, joints.margin), 0.1 + 0.45 * gape) * (0.88 + 0.12 * smoothstep(0.0, 0.1, small_joints.margin));
    let face = unit_of(joints.hash);
    let tilt = dot(joints.offset, vec2f(unit_again(joints.hash, 2u), unit_again(joints.hash, 3u)) - 0.5);
    let grain = tile_fbm(at, vec2u(32u), 4u, 190u);
    let bulk = 0.1 + 0.24 * hard * worn + 0.12 * face + 0.12 * tilt + 0.34 * lumps + 0.34 * (grain - 0.5) + 0.1 * unit_of(small_joints.hash);
    let height = clamp(bulk * (0.45 + 0.55 * crack) * (0.72 + 0.28 * worn) * 1.35, 0.0, 1.0);
    var albedo = mix(vec3f(0.15, 0.13, 0.108), vec3f(0.27, 0.245, 0.21), unit_again(hash, 1u) * 0.6 + 0.4 * lumps);
    albedo *= (0.74 + 0.16 * face + 0.55 * (grain - 0.5) + 0.2 * unit_of(small_joints.hash)) * (0.5 + 0.5 * crack) * (0.78 + 0.22 * worn);
    let stain = smoothstep(0.56, 0.74, tile_fbm(at, vec2u(16u, 4u), 3u, 199u));
    albedo = mix(albedo, albedo * vec3f(1.16, 0.92, 0.7), stain * 0.7);
    let lichen = smoothstep(0.6, 0.7, tile_fbm(at, vec2u(16u), 4u, 203u)) * crack;
    albedo = mix(albedo, vec3f(0.3, 0.3, 0.235), lichen * 0.45);
    return Recipe(albedo, height, 0.84 + 0.1 * grain);
}

fn coats(at: TilePoint, width: f32, salt: u32) -> Blade {
    var top = tile_blades(at, vec2u(64u), width, salt);
    for (var coat = 1u; coat < 5u; coat++) {
        let next = tile_blades(at, vec2u(128u), width * 1.5, salt + coat);
        if next.height * 0.9 > top.height {
            top = Blade(next.height * 0.9, next.tone, next.along);
        }
    }
    return top;
}

fn cobbles(at: TilePoint) -> Recipe {
    let bend = vec2f(tile_noise(at, vec2u(32u), 241u), tile_noise(at, vec2u(32u), 242u)) - 0.5;
    let bent = TilePoint(at.uv + bend * 0.01, at.tiles);
    let stones = tile_cellular(bent, vec2u(16u), 0.62, 243u);
    let grain = tile_fbm(at, vec2u(64u), 3u, 244u);
    let broad = tile_fbm(at, vec2u(4u), 2u, 247u);
    let raised = 0.75 + 0.25 * unit_of(stones.hash);
    let dome = smoothstep(0.06, 0.34, stones.margin);
    let top = raised * (1.0 - 0.34 * stones.nearest * stones.nearest);
    let earth = 0.14 + 0.16 * grain;
    let height = clamp(max(earth, dome * top * (0.94 + 0.12 * grain)), 0.0, 1.0);
    let stone = smoothstep(0.12, 0.3, stones.margin);
    let grey = mix(vec3f(0.19, 0.178, 0.16), vec3f(0.33, 0.3, 0.25), unit_again(stones.hash, 1u));
    let hue = mix(grey, vec3f(0.29, 0.235, 0.175), step(0.78, unit_again(stones.hash, 2u)));
    let moss = smoothstep(0.55, 0.75, broad * 0.6 + grain * 0.5);
    let joint = mix(vec3f(0.095, 0.078, 0.05), vec3f(0.055, 0.08, 0.024), moss) * (0.6 + 0.8 * grain);
    let albedo = mix(joint, hue * (0.74 + 0.5 * grain), stone);
    return Recipe(albedo, height, mix(0.95, 0.66, stone * top));
}

fn dry_grass(at: TilePoint) -> Recipe {
    let tufts = tile_cellular(at, vec2u(16u), 1.0, 141u);
    let broad = tile_fbm(at, vec2u(4u), 4u, 142u);
    let blade = coats(at, 0.075, 146u);
    let tuft = smoothstep(0.0, 0.8, 1.0 - tufts.nearest) * (0.5 + 0.5 * unit_of(tufts.hash));
    let crumbs = tile_fbm(at, vec2u(64u), 2u, 152u);
    let height = clamp(0.03 + 0.2 * broad + 0.16 * crumbs + 0.22 * tuft + 0.52 * blade.height * (0.55 + 0.45 * tuft), 0.0, 1.0);
    let soil = mix(vec3f(0.086, 0.066, 0.036), vec3f(0.15, 0.118, 0.066), crumbs);
    let straw = mix(vec3f(0.165, 0.14, 0.052), vec3f(0.345, 0.285, 0.13), blade.tone);
    let hue = mix(straw, vec3f(0.105, 0.128, 0.036), step(0.74, unit_again(u32(blade.tone * 65536.0), 8u)));
    var albedo = mix(soil, hue * (0.7 + 0.45 * blade.along), smoothstep(0.02, 0.2, blade.height) * (0.45 + 0.55 * tuft));
    albedo *= 0.86 + 0.28 * broad;
    return Recipe(albedo, height, 0.9);
}

var<private> material_sets: array<MaterialSet, 7> = MATERIAL_SETS;

fn meadow(at: TilePoint) -> Recipe {
    let tufts = tile_cellular(at, vec2u(16u), 1.0, 121u);
    let broad = tile_fbm(at, vec2u(4u), 3u, 122u);
    let blade = coats(at, 0.085, 125u);
    let tuft = clamp(1.0 - tufts.nearest, 0.0, 1.0);
    let height = clamp(0.05 + 0.34 * tuft + 0.22 * broad + 0.48 * blade.height, 0.0, 1.0);
    let soil = mix(vec3f(0.03, 0.04, 0.016), vec3f(0.044, 0.058, 0.018), broad);
    let fresh = mix(vec3f(0.052, 0.094, 0.02), vec3f(0.104, 0.16, 0.042), blade.tone);
    let hue = mix(fresh, vec3f(0.15, 0.15, 0.056), step(0.9, unit_again(u32(blade.tone * 65536.0), 7u)));
    var albedo = mix(soil, hue * (0.62 + 0.55 * blade.along), smoothstep(0.02, 0.16, blade.height));
    albedo *= 0.8 + 0.3 * tuft + 0.3 * (broad - 0.5);
    let clover = tile_cellular(at, vec2u(64u), 1.0, 131u);
    let leaf = (1.0 - smoothstep(0.3, 0.36, clover.nearest)) * smoothstep(0.56, 0.66, tile_noise(at, vec2u(8u), 132u));
    albedo = mix(albedo, vec3f(0.046, 0.108, 0.034) * (0.6 + 1.1 * clover.nearest), leaf * 0.8);
    return Recipe(albedo, height, 0.86 - 0.1 * blade.along);
}

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = (x * 1664525u + y * 22695477u + 1013904223u) * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn recipe(material: u32, at: TilePoint) -> Recipe {
    switch material {
        case SAND {
            return sand(at);
        }
        case MEADOW {
            return meadow(at);
        }
        case DRY_GRASS {
            return dry_grass(at);
        }
        case THICKET {
            return thicket(at);
        }
        case CLIFF {
            return cliff(at);
        }
        case SCREE {
            return scree(at);
        }
        case default {
            return cobbles(at);
        }
    }
}

fn sand(at: TilePoint) -> Recipe {
    let broad = tile_fbm(at, vec2u(4u), 3u, 101u);
    let warp = tile_fbm(at, vec2u(2u, 4u), 3u, 104u);
    let phase = 6.2831853 * (22.0 * at.uv.y + 3.0 * at.uv.x + 2.6 * warp);
    let ripple = 0.5 + 0.5 * sin(phase + 0.55 * sin(phase));
    let strength = smoothstep(0.36, 0.62, broad);
    let grain = tile_noise(at, vec2u(256u), 107u) * 0.6 + tile_noise(at, vec2u(512u), 108u) * 0.4;
    let bits = tile_cellular(at, vec2u(32u), 1.0, 109u);
    let shell = select(0.0, 1.0 - smoothstep(0.08, 0.13, bits.nearest), unit_again(bits.hash, 5u) > 0.9);
    let height = clamp(0.06 + 0.5 * ripple * (0.25 + 0.75 * strength) + 0.36 * broad + 0.14 * (grain - 0.5) + 0.16 * shell, 0.0, 1.0);
    var albedo = vec3f(0.56, 0.43, 0.26) * (0.76 + 0.3 * ripple * (0.3 + 0.7 * strength) + 0.2 * (broad - 0.5) + 0.42 * (grain - 0.5));
    let shell_colour = mix(vec3f(0.72, 0.66, 0.56), vec3f(0.16, 0.13, 0.1), step(0.5, unit_again(bits.hash, 6u)));
    albedo = mix(albedo, shell_colour, shell);
    return Recipe(albedo, height, 0.92 - 0.25 * shell);
}

fn scree(at: TilePoint) -> Recipe {
    let bend = vec2f(tile_noise(at, vec2u(32u), 221u), tile_noise(at, vec2u(32u), 222u)) - 0.5;
    let bent = TilePoint(at.uv + bend * 0.016, at.tiles);
    let grain = tile_fbm(at, vec2u(128u), 2u, 223u);
    var height = 0.1 + 0.1 * tile_fbm(at, vec2u(8u), 3u, 225u) + 0.1 * grain;
    var tone = 0.28;
    var warmth = 0.5;
    var cells = 128u;
    for (var size = 0u; size < 4u; size++) {
        let stone = tile_cellular(bent, vec2u(cells), 0.9, 228u + size);
        let hash = stone.hash;
        let radius = (0.3 + 0.26 * unit_again(hash, 1u)) * step(0.3 + 0.12 * f32(size), unit_again(hash, 2u));
        let facet = dot(stone.offset, vec2f(unit_again(hash, 3u), unit_again(hash, 4u)) - 0.5);
        let side = smoothstep(0.0, 0.16, min(radius - stone.nearest, stone.margin * 0.8));
        let top = (0.2 + 0.13 * f32(size)) * (0.72 + 0.5 * unit_of(hash)) + facet * 0.22 + 0.06 * (grain - 0.5);
        let here = select(0.0, top * side, radius > 0.0);
        if here > height {
            height = here;
            tone = (0.6 + 0.6 * unit_again(hash, 5u)) * (0.5 + 0.5 * side);
            warmth = unit_again(hash, 6u);
        }
        cells /= 2u;
    }
    let albedo = mix(vec3f(0.205, 0.195, 0.185), vec3f(0.262, 0.222, 0.172), warmth) * tone * (0.78 + 0.44 * grain);
    return Recipe(albedo, clamp(height * 1.25, 0.0, 1.0), 0.88);
}

fn thicket(at: TilePoint) -> Recipe {
    let bend = vec2f(tile_fbm(at, vec2u(16u), 3u, 171u), tile_fbm(at, vec2u(16u), 3u, 175u)) - 0.5;
    let bent = TilePoint(at.uv + bend * 0.09, at.tiles);
    let crowns = tile_cellular(bent, vec2u(8u), 0.9, 163u);
    let sprigs = tile_cellular(at, vec2u(32u), 1.0, 164u);
    let leaves = tile_cellular(at, vec2u(128u), 1.0, 165u);
    let size = 0.75 + 0.5 * unit_of(crowns.hash);
    let dome = sqrt(max(1.0 - pow(min(crowns.nearest / (0.95 * size), 1.0), 2.0), 0.0));
    let sprig = clamp(1.0 - sprigs.nearest * 1.1, 0.0, 1.0);
    let leaf = clamp(1.0 - leaves.nearest * 1.2, 0.0, 1.0);
    let height = clamp(0.55 * dome + 0.27 * sprig + 0.16 * leaf, 0.0, 1.0);
    let lightness = (0.5 + 0.5 * dome) * (0.6 + 0.55 * sprig) * (0.55 + 0.85 * leaf * (0.5 + unit_of(leaves.hash)));
    let kind = mix(vec3f(0.03, 0.062, 0.016), vec3f(0.062, 0.092, 0.024), unit_again(crowns.hash, 9u));
    let litter = vec3f(0.03, 0.024, 0.013) * (0.6 + 0.8 * leaf);
    let albedo = mix(litter, kind * lightness * 1.5, smoothstep(0.1, 0.34, dome * 0.6 + sprig * 0.5));
    return Recipe(albedo, height, 0.82 - 0.1 * leaf);
}

fn tile_blades(at: TilePoint, cells: vec2u, width: f32, salt: u32) -> Blade {
    let p = at.uv * vec2f(cells);
    let low = floor(p);
    let f = p - low;
    let cell = vec2i(low);
    var top = Blade(0.0, 0.0, 0.0);
    for (var index = 0; index < 9; index++) {
        let hop = vec2i(index % 3 - 1, index / 3 - 1);
        let hash = tile_hash(at, cell + hop, cells, salt);
        let root = vec2f(hop) + vec2f(unit_of(hash), unit_again(hash, 1u));
        let angle = 6.2831853 * unit_again(hash, 2u);
        let ahead = vec2f(cos(angle), sin(angle));
        let offset = f - root;
        let along = dot(offset, ahead);
        let bend = (unit_again(hash, 3u) - 0.5) * 0.7 * along * along;
        let aside = abs(dot(offset, vec2f(-ahead.y, ahead.x)) - bend);
        let half_width = width * (1.0 - along * along);
        if along > 0.0 && along < 1.0 && aside < half_width {
            let tone = unit_again(hash, 4u);
            let arch = along * (1.6 - 0.8 * along);
            let height = (0.35 + 0.65 * tone) * arch * (1.0 - 0.4 * aside / half_width);
            if height > top.height {
                top = Blade(height, tone, along);
            }
        }
    }
    return top;
}

fn tile_cellular(at: TilePoint, cells: vec2u, jitter: f32, salt: u32) -> Cellular {
    let p = at.uv * vec2f(cells);
    let low = floor(p);
    let f = p - low;
    let cell = vec2i(low);
    var found = Cellular(8.0, 8.0, vec2f(0.0), 0u);
    var second = 8.0;
    for (var index = 0; index < 9; index++) {
        let hop = vec2i(index % 3 - 1, index / 3 - 1);
        let hash = tile_hash(at, cell + hop, cells, salt);
        let point = vec2f(hop) + 0.5 + jitter * (vec2f(unit_of(hash), unit_again(hash, 1u)) - 0.5);
        let offset = f - point;
        let distance = length(offset);
        if distance < found.nearest {
            second = found.nearest;
            found = Cellular(distance, 0.0, offset, hash);
        }
        else {
            second = min(second, distance);
        }
    }
    found.margin = second - found.nearest;
    return found;
}

fn tile_fbm(at: TilePoint, cells: vec2u, octaves: u32, salt: u32) -> f32 {
    var sum = 0.0;
    var total = 0.0;
    var weight = 1.0;
    var finer = cells;
    for (var octave = 0u; octave < octaves; octave++) {
        sum += weight * tile_noise(at, finer, salt + octave);
        total += weight;
        weight *= 0.5;
        finer *= 2u;
    }
    return sum / total;
}

fn tile_hash(at: TilePoint, cell: vec2i, cells: vec2u, salt: u32) -> u32 {
    let wrapped = vec2u(cell & (vec2i(cells * at.tiles) - vec2i(1)));
    return pattern_hash(wrapped.x + salt * 2654435769u, wrapped.y);
}

fn tile_noise(at: TilePoint, cells: vec2u, salt: u32) -> f32 {
    let p = at.uv * vec2f(cells);
    let low = floor(p);
    let f = p - low;
    let cell = vec2i(low);
    let a = unit_of(tile_hash(at, cell, cells, salt));
    let b = unit_of(tile_hash(at, cell + vec2i(1, 0), cells, salt));
    let c = unit_of(tile_hash(at, cell + vec2i(0, 1), cells, salt));
    let d = unit_of(tile_hash(at, cell + vec2i(1, 1), cells, salt));
    let u = f * f * (3.0 - 2.0 * f);
    return mix(mix(a, b, u.x), mix(c, d, u.x), u.y);
}

fn unit_again(hash: u32, turn: u32) -> f32 {
    return unit_of((hash ^ (hash >> 15u)) * (2891336453u + 2u * turn));
}

fn unit_of(hash: u32) -> f32 {
    return f32(hash >> 8u) * (1.0 / 16777216.0);
}
