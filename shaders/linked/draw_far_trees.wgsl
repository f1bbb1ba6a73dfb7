@group(0) @binding(0)
var<uniform> frame: Frame;

struct Instance {
    @location(0)
    tree: vec4u,
    @location(1)
    light: vec4u
}

struct Varying {
    @builtin(position)
    position: vec4f,
    @location(0)
    toward_m: vec3f,
    @location(1) @interpolate(flat)
    tree: vec4u,
    @location(2) @interpolate(flat)
    light: vec2u
}

@vertex
fn vertex(@builtin(vertex_index) index: u32, instance: Instance) -> Varying {
    let tree = unpacked_tree(instance.tree);
    let toward_m = impostor_corner(tree, index);
    let position = select(vec4f(0.0, 0.0, 0.0, -1.0), frame.clip_from_camera * vec4f(toward_m, 1.0), tree.height_m > 0.0);
    return Varying(position, toward_m, instance.tree, instance.light.xy);
}

fn far_hit(in: Varying, toward_m: vec3f) -> ImpostorHit {
    let tree = unpacked_tree(in.tree);
    let crown = impostor_crown(tree);
    let toward = normalize(toward_m);
    let begin_m = toward * ray_begin_m(tree, toward) - tree.root_m;
    let leaves = crown_way(crown, begin_m, toward);
    let trunk = trunk_way(tree, begin_m, toward);
    let way = min(leaves, trunk);
    let at_m = begin_m + toward * way;
    var outward = vec3f(at_m.x, 0.0, at_m.z);
    if leaves <= trunk && crown.is_cone {
        outward.y = length(at_m.xz) * crown.radius_m / crown.rise_m;
    }
    else if leaves <= trunk {
        let axes = vec3f(crown.radius_m, crown.rise_m, crown.radius_m);
        outward = (at_m - vec3f(0.0, crown.wide_m, 0.0)) / (axes * axes);
    }
    outward = normalize(outward + vec3f(0.0, 0.0001, 0.0));
    let point = ImpostorPoint(at_m, outward, trunk < leaves);
    let pixel_m = length(tree.root_m) / frame.pixels_per_radian;
    let number = leaf_number(at_m, bitcast<f32>(in.light.y), pixel_m);
    return ImpostorHit(way < NO_WAY && leaves_cover(point, toward, number), point, number);
}

fn hit_light(in: Varying, hit: ImpostorHit) -> vec4f {
    let tree = unpacked_tree(in.tree);
    let light = impostor_light(frame, tree, impostor_crown(tree), bitcast<f32>(in.light.y), unpack4x8unorm(in.light.x), hit.point, hit.number);
    return vec4f(light, 1.0);
}

@fragment
fn fragment(in: Varying) -> @location(0) vec4f {
    let hit = far_hit(in, in.toward_m);
    if !hit.is_hit {
        discard;
    }
    return hit_light(in, hit);
}

struct Sampled {
    @location(0)
    light: vec4f,
    @builtin(sample_mask)
    mask: u32
}

@fragment
fn sampled_fragment(in: Varying) -> Sampled {
    let right = dpdx(in.toward_m);
    let down = dpdy(in.toward_m);
    var mask = 0u;
    var last: ImpostorHit;
    for (var sample = 0u; sample < 4u; sample++) {
        let from_middle = sample_places[sample];
        let hit = far_hit(in, in.toward_m + right * from_middle.x + down * from_middle.y);
        if hit.is_hit {
            mask |= 1u << sample;
            last = hit;
        }
    }
    if mask == 0u {
        discard;
    }
    return Sampled(hit_light(in, last), mask);
}

struct AerialPerspective {
    transmittance: vec3f,
    inscattering: vec3f
}

struct Amount {
    near: f32,
    whole: f32
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

const BARK = vec3f(0.078, 0.064, 0.05);

const BOUGHS_FILL: f32 = 0.84;

const BROAD_LEAF = vec3f(0.044, 0.082, 0.02);

const BROAD_YOUNG = vec3f(0.08, 0.108, 0.026);

const BURLEY_ENERGY: f32 = 1.0 / 1.51;

const CLUMP_DEPTH: f32 = 3.0;

struct Caster {
    root_m: vec3f,
    width_m: f32,
    height_m: f32,
    species: u32
}

struct Crown {
    wide_m: f32,
    rise_m: f32,
    radius_m: f32,
    is_cone: bool,
    density: f32
}

const DEEPEST: f32 = 20.0;

const DIELECTRIC_F0: f32 = 0.04;

const DIFFUSE_BURLEY: u32 = 1u;

const EARTH_RADIUS_M: f32 = 6371000.0;

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

const HAZE_ALBEDO: f32 = 0.94;

const HAZE_EXTINCTION = vec3f(8.8e-6, 9e-6, 9.2e-6);

const HAZE_SCALE_M: f32 = 1200.0;

struct ImpostorHit {
    is_hit: bool,
    point: ImpostorPoint,
    number: f32
}

struct ImpostorPoint {
    at_m: vec3f,
    outward: vec3f,
    is_trunk: bool
}

const LEAF_CELL_M: f32 = 0.55;

const LEAF_GLOW = vec3f(1.15, 1.0, 0.4);

const LEAF_SHARE: f32 = 0.25;

const LIGHT_AT = vec3f(0.15, 0.5, 0.85);

struct LeafPoint {
    albedo: vec3f,
    normal: vec3f,
    open: f32,
    thin: f32,
    leaves: f32
}

const MAX_GLOSS: f32 = 64.0;

const MIN_NV: f32 = 0.0001;

const MIN_ROUGHNESS: f32 = 0.045;

const NO_WAY: f32 = 1e30;

const PINE: u32 = 1u;

const PINE_BARK = vec3f(0.13, 0.078, 0.048);

const PINE_LEAF = vec3f(0.04, 0.066, 0.028);

const PINE_YOUNG = vec3f(0.056, 0.078, 0.03);

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

const RAYLEIGH_SCALE_M: f32 = 8000.0;

const RAYLEIGH_SCATTERING = vec3f(5.8e-6, 1.35e-5, 3.31e-5);

const SHAPE_STEPS: f32 = 64.0;

const SHARP_ROUGHNESS: f32 = 0.35;

const SPACE_M: f32 = 10000000.0;

const SPRAYS_OUT: f32 = 0.5;

const SPRAY_MEAN: f32 = 0.9;

const SPRUCE: u32 = 0u;

const SPRUCE_LEAF = vec3f(0.024, 0.05, 0.02);

const SPRUCE_YOUNG = vec3f(0.04, 0.07, 0.024);

struct ShadingAngles {
    nl: f32,
    nv: f32,
    lh: f32,
    middle: vec3f
}

struct Surface {
    albedo: vec3f,
    normal: vec3f,
    roughness: f32,
    occlusion: f32,
    leaves: f32
}

const VISIBILITY_FAST: u32 = 1u;

const WHORLS: f32 = 9.0;

fn aerial_perspective(frame: Frame, direction: vec3f, distance_m: f32) -> AerialPerspective {
    let height_m = max(frame.eye_height_m, 0.0);
    let air = amount(height_m, direction.y, distance_m, RAYLEIGH_SCALE_M);
    let haze = amount(height_m, direction.y, distance_m, HAZE_SCALE_M);
    let air_depth = RAYLEIGH_SCATTERING * air.near;
    let haze_depth = HAZE_EXTINCTION * haze.near;
    let air_whole = RAYLEIGH_SCATTERING * (air.whole + 1.0);
    let haze_whole = HAZE_EXTINCTION * (haze.whole + 0.001);
    let by_air = air_whole / (air_whole + haze_whole);
    let by_haze = 1.0 - by_air;
    let whole = air_whole + haze_whole;
    let thin = (1.0 - exp(-whole)) / whole * smoothstep(-0.3, 0.1, direction.y);
    let level = direction.xz * frame.sun.xz;
    let lengths = dot(direction.xz, direction.xz) * dot(frame.sun.xz, frame.sun.xz);
    let sunward = 0.5 + 0.5 * (level.x + level.y) * inverseSqrt(lengths + 0.0001);
    let low = mix(frame.atmosphere.away, frame.atmosphere.toward, sunward);
    let cosine = clamp(dot(direction, frame.sun), -1.0, 1.0);
    let from_air = mix(low, frame.atmosphere.upward, thin) * rayleigh_phase(cosine) + frame.atmosphere.multiple_scattering;
    let from_haze = (mix(low, frame.atmosphere.upward, 0.5 * thin) * haze_phase(cosine) + frame.atmosphere.multiple_scattering) * HAZE_ALBEDO;
    let added = from_air * by_air * (1.0 - exp(-air_depth / by_air)) + from_haze * by_haze * (1.0 - exp(-haze_depth / by_haze));
    return AerialPerspective(exp(-(air_depth + haze_depth)), added);
}

fn ambient(frame: Frame, normal: vec3f) -> vec3f {
    let air = frame.atmosphere;
    return max(air.sky_mean + air.sky_east * normal.x + air.sky_up * normal.y + air.sky_south * normal.z, vec3f(0.0));
}

fn amount(height_m: f32, rise: f32, distance_m: f32, scale_m: f32) -> Amount {
    let unit = inverseSqrt(2.0 * EARTH_RADIUS_M * scale_m);
    let turns = rise * EARTH_RADIUS_M * unit;
    let ends = turns + distance_m * unit;
    let thickness_m = sqrt(1.5707963 * EARTH_RADIUS_M * scale_m);
    let log_here = -height_m / scale_m;
    let log_there = min(log_here - (ends - turns) * (ends + turns), DEEPEST);
    let here = exp(log_here) * scaled_erfc(abs(turns));
    let there = exp(log_there) * scaled_erfc(abs(ends));
    let log_lowest = log_here + turns * turns;
    let lowest = exp(min(log_lowest, DEEPEST));
    var found = Amount(here - there, here);
    if turns < 0.0 {
        found.near = select(2.0 * lowest - here - there, there - here, ends < 0.0);
        found.whole = select(2.0 * lowest - here, scaled_erfc(sqrt(max(log_lowest, 0.0))) - here, log_lowest > 0.0);
    }
    return Amount(max(found.near, 0.0) * thickness_m, max(found.whole, 0.0) * thickness_m);
}

fn apply_aerial_perspective(frame: Frame, light: vec3f, offset_m: vec3f) -> vec3f {
    let distance_m = max(length(offset_m), 0.001);
    let aerial = aerial_perspective(frame, offset_m / distance_m, distance_m);
    return light * aerial.transmittance + aerial.inscattering;
}

fn bark_colour(species: u32) -> vec3f {
    return select(BARK, PINE_BARK, species == PINE);
}

fn burley_diffuse(nl: f32, nv: f32, lh: f32, roughness: f32) -> f32 {
    let rise = 2.0 * roughness * lh * lh - 0.5;
    let light = 1.0 + rise * fifth_power(1.0 - nl);
    let view = 1.0 + rise * fifth_power(1.0 - nv);
    return light * view * mix(1.0, BURLEY_ENERGY, roughness);
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

fn crown_way(crown: Crown, begin_m: vec3f, toward: vec3f) -> f32 {
    if !crown.is_cone {
        let axes = vec3f(crown.radius_m, crown.rise_m, crown.radius_m);
        return sphere_way((begin_m - vec3f(0.0, crown.wide_m, 0.0)) / axes, toward / axes, 1.0);
    }
    let k = crown.radius_m / crown.rise_m;
    let y = begin_m.y - (crown.wide_m + crown.rise_m);
    var a = dot(toward.xz, toward.xz) - k * k * toward.y * toward.y;
    a = select(a, 1e-5, abs(a) < 1e-5);
    let b = dot(begin_m.xz, toward.xz) - k * k * y * toward.y;
    let inside = b * b - a * (dot(begin_m.xz, begin_m.xz) - k * k * y * y);
    var way = NO_WAY;
    if inside > 0.0 {
        let root = sqrt(inside);
        for (var side = 0; side < 2; side++) {
            let t = (select(root, -root, side == 0) - b) / a;
            let down = -(y + t * toward.y);
            if down >= 0.0 && down <= crown.rise_m {
                way = min(way, t);
            }
        }
    }
    if toward.y > 1e-5 {
        let t = (-crown.rise_m - y) / toward.y;
        let at_m = begin_m.xz + t * toward.xz;
        if dot(at_m, at_m) <= crown.radius_m * crown.radius_m {
            way = min(way, t);
        }
    }
    return way;
}

fn fifth_power(x: f32) -> f32 {
    let squared = x * x;
    return squared * squared * x;
}

fn ggx_alpha(roughness: f32) -> f32 {
    let bounded = clamp(roughness, MIN_ROUGHNESS, 1.0);
    return bounded * bounded;
}

fn ggx_distribution(normal: vec3f, middle: vec3f, alpha: f32) -> f32 {
    let aside = cross(normal, middle);
    let along = dot(normal, middle) * alpha;
    let k = alpha / (dot(aside, aside) + along * along);
    return k * k * 0.31830989;
}

fn ggx_visibility_exact(nl: f32, nv: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let light = nv * sqrt(nl * nl * (1.0 - a2) + a2);
    let view = nl * sqrt(nv * nv * (1.0 - a2) + a2);
    return 0.5 / max(light + view, 1e-7);
}

fn ggx_visibility_fast(nl: f32, nv: f32, alpha: f32) -> f32 {
    return 0.5 / max(mix(2.0 * nl * nv, nl + nv, alpha), 1e-7);
}

fn haze_phase(cosine: f32) -> f32 {
    const G: f32 = 0.76;
    let base = max(1.0 + G * G - 2.0 * G * cosine, 0.001);
    return 1.5 * (1.0 - G * G) / (2.0 + G * G) * (1.0 + cosine * cosine) / (base * sqrt(base));
}

fn impostor_corner(tree: Caster, index: u32) -> vec3f {
    let middle_m = tree.root_m + vec3f(0.0, 0.5 * tree.height_m, 0.0);
    let away_m = max(length(middle_m), 0.001);
    let gaze = middle_m / away_m;
    let level = length(gaze.xz);
    let aside = select(vec2f(1.0, 0.0), vec2f(-gaze.z, gaze.x) / max(level, 1e-6), level > 0.0001);
    let right = vec3f(aside.x, 0.0, aside.y);
    let up = cross(right, gaze);
    let radius_m = 0.5 * length(vec2f(tree.width_m, tree.height_m));
    let nearer = away_m / max(away_m - radius_m, 0.25 * away_m);
    let half_m = 0.5 * nearer * vec2f(tree.width_m, tree.height_m * level + tree.width_m * abs(gaze.y));
    let is_right = index == 1u || index == 4u || index == 5u;
    let is_above = index == 2u || index == 3u || index == 5u;
    return middle_m + right * select(-half_m.x, half_m.x, is_right) + up * select(-half_m.y, half_m.y, is_above);
}

fn impostor_crown(tree: Caster) -> Crown {
    var crown = crown_of(tree);
    crown.radius_m *= select(1.0, BOUGHS_FILL, crown.is_cone);
    return crown;
}

fn impostor_light(frame: Frame, tree: Caster, crown: Crown, phase: f32, shares: vec4f, point: ImpostorPoint, number: f32) -> vec3f {
    let up = clamp(point.at_m.y / max(tree.height_m, 0.001), 0.0, 1.0);
    let low = clamp((up - LIGHT_AT.x) / (LIGHT_AT.y - LIGHT_AT.x), 0.0, 1.0);
    let high = clamp((up - LIGHT_AT.y) / (LIGHT_AT.z - LIGHT_AT.y), 0.0, 1.0);
    let past_trees = mix(mix(shares.x, shares.y, low), shares.z, high);
    let offset_m = tree.root_m + point.at_m;
    if point.is_trunk {
        let bark = LeafPoint(bark_colour(tree.species), point.outward, 0.5, 0.0, 0.0);
        return leaf_light(frame, bark, offset_m, shares.w * past_trees);
    }
    var normal: vec3f;
    var open: f32;
    if tree.species == SPRUCE {
        let angle = atan2(point.at_m.z, point.at_m.x);
        let whorl = fract(WHORLS * (point.at_m.y - crown.wide_m) / crown.rise_m + 0.3 * sin(5.0 * angle + 40.0 * phase) + phase);
        normal = normalize(vec3f(point.outward.x, 0.7, point.outward.z));
        open = mix(1.0, 0.45, whorl) * (0.55 + 0.45 * up);
    }
    else {
        let axes = vec3f(crown.radius_m, crown.rise_m, crown.radius_m);
        let at = (point.at_m - vec3f(0.0, crown.wide_m, 0.0)) / axes;
        let of_crown = at / axes * crown.radius_m;
        normal = normalize(point.outward * 0.8 + of_crown * 0.6 + vec3f(0.0, 0.2, 0.0));
        open = clamp(0.16 + 0.48 * mix(dot(at, at), 1.0, SPRAYS_OUT) + 0.2 * at.y + 0.26 * point.outward.y, 0.1, 1.0);
    }
    let leaves = leaf_colour(tree.species, phase) * (0.7 + 0.6 * number);
    let leaf = LeafPoint(leaves, normal, open, 0.5, 1.0);
    return leaf_light(frame, leaf, offset_m, shares.w * past_trees) * SPRAY_MEAN;
}

fn leaf_colour(species: u32, phase: f32) -> vec3f {
    let young = phase * phase;
    if species == SPRUCE {
        return mix(SPRUCE_LEAF, SPRUCE_YOUNG, young);
    }
    if species == PINE {
        return mix(PINE_LEAF, PINE_YOUNG, young);
    }
    return mix(BROAD_LEAF, BROAD_YOUNG, young);
}

fn leaf_light(frame: Frame, leaf: LeafPoint, offset_m: vec3f, sun_share: f32) -> vec3f {
    let direction = offset_m / max(length(offset_m), 0.001);
    let sun = sun_share * leaf.open;
    let surface = Surface(leaf.albedo, leaf.normal, 0.92, leaf.open, leaf.leaves);
    var light = lit(frame, surface, -direction, sun);
    let toward = max(dot(direction, frame.sun), 0.0);
    let glow = toward * toward * toward * smoothstep(-0.05, 0.1, frame.sun.y);
    light += frame.atmosphere.sun * leaf.albedo * LEAF_GLOW * (glow * leaf.thin * sun);
    return apply_aerial_perspective(frame, light, offset_m);
}

fn leaf_number(at_m: vec3f, phase: f32, pixel_m: f32) -> f32 {
    let cell = vec3i(floor(at_m / LEAF_CELL_M)) + vec3i(512);
    let key = vec2u(vec2i(cell.x + 1024 * cell.y, cell.z)) + vec2u(u32(phase * 4096.0) << 20u, 0u);
    let number = f32(pattern_hash(key.x, key.y) >> 8u) / 16777216.0;
    return mix(0.5, number, clamp(1.6 - 0.6 * pixel_m / LEAF_CELL_M, 0.0, 1.0));
}

fn leaf_sun(facing: f32) -> f32 {
    return 0.5 * exp(-CLUMP_DEPTH * max(-facing, 0.0));
}

fn leaves_cover(point: ImpostorPoint, toward: vec3f, number: f32) -> bool {
    return point.is_trunk || -dot(point.outward, toward) > 0.65 * number;
}

fn lit(frame: Frame, surface: Surface, to_eye: vec3f, sun_share: f32) -> vec3f {
    let normal = surface.normal;
    let nv = clamp(dot(normal, to_eye), MIN_NV, 1.0);
    let f0 = DIELECTRIC_F0 * (1.0 - surface.roughness * surface.roughness);
    let specular_share = specular_albedo(f0, surface.roughness, nv);
    let body = surface.albedo * (1.0 - specular_share);
    let mirrored = reflect(-to_eye, normal);
    var shine = ambient(frame, mirrored);
    if surface.roughness < SHARP_ROUGHNESS {
        shine = mix(sky_radiance(frame, mirrored), shine, surface.roughness / SHARP_ROUGHNESS);
    }
    var light = (body * ambient(frame, normal) + specular_share * shine) * surface.occlusion;
    let angles = shading_angles(normal, to_eye, frame.sun);
    if angles.nl * sun_share > 0.0 {
        let alpha = ggx_alpha(surface.roughness);
        var visibility = 0.0;
        if frame.visibility == VISIBILITY_FAST {
            visibility = ggx_visibility_fast(angles.nl, angles.nv, alpha);
        }
        else {
            visibility = ggx_visibility_exact(angles.nl, angles.nv, alpha);
        }
        var diffuse = 1.0;
        if frame.diffuse == DIFFUSE_BURLEY {
            diffuse = burley_diffuse(angles.nl, angles.nv, angles.lh, surface.roughness);
        }
        let gloss = ggx_distribution(normal, angles.middle, alpha) * visibility * schlick(f0, angles.lh) * 3.1415927;
        let facing = 1.0 - surface.leaves * LEAF_SHARE;
        light += frame.atmosphere.sun * ((body * diffuse * facing + min(gloss, MAX_GLOSS)) * (angles.nl * sun_share));
    }
    let leaf_share = surface.leaves * LEAF_SHARE * sun_share;
    return light + frame.atmosphere.sun * body * (leaf_share * leaf_sun(dot(normal, frame.sun)));
}

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = (x * 1664525u + y * 22695477u + 1013904223u) * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn ray_begin_m(tree: Caster, toward: vec3f) -> f32 {
    return dot(tree.root_m + vec3f(0.0, 0.5 * tree.height_m, 0.0), toward);
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 0.75 * (1.0 + cosine * cosine);
}

var<private> sample_places: array<vec2f, 4> = array(vec2f(-0.125, -0.375), vec2f(0.375, -0.125), vec2f(-0.375, 0.125), vec2f(0.125, 0.375));

fn scaled_erfc(x: f32) -> f32 {
    const A: f32 = 2.7519384;
    return A / ((A - 1.0) * 1.7724539 * x + sqrt(3.1415927 * x * x + A * A));
}

fn schlick(f0: f32, lh: f32) -> f32 {
    let f90 = clamp(50.0 * 0.33 * f0, 0.0, 1.0);
    return f0 + (f90 - f0) * fifth_power(1.0 - lh);
}

fn shading_angles(normal: vec3f, to_eye: vec3f, to_light: vec3f) -> ShadingAngles {
    let both = to_eye + to_light;
    let middle = both * inverseSqrt(max(dot(both, both), 1e-8));
    return ShadingAngles(clamp(dot(normal, to_light), 0.0, 1.0), clamp(dot(normal, to_eye), MIN_NV, 1.0), clamp(dot(to_light, middle), 0.0, 1.0), middle);
}

fn sky_radiance(frame: Frame, direction: vec3f) -> vec3f {
    return aerial_perspective(frame, direction, SPACE_M).inscattering;
}

fn specular_albedo(f0: f32, roughness: f32, nv: f32) -> f32 {
    let r = vec4f(-1.0, -0.0275, -0.572, 0.022) * roughness + vec4f(1.0, 0.0425, 1.04, -0.04);
    let narrow = min(r.x * r.x, exp2(-9.28 * nv)) * r.x + r.y;
    let scale = -1.04 * narrow + r.z;
    let bias = 1.04 * narrow + r.w;
    return clamp(f0 * scale + bias * clamp(50.0 * f0, 0.0, 1.0), 0.0, 1.0);
}

fn sphere_way(begin: vec3f, step: vec3f, radius: f32) -> f32 {
    let a = max(dot(step, step), 1e-12);
    let b = dot(begin, step);
    let inside = b * b - a * (dot(begin, begin) - radius * radius);
    if inside <= 0.0 {
        return NO_WAY;
    }
    return (-sqrt(inside) - b) / a;
}

fn trunk_radius_m(caster: Caster) -> f32 {
    return min(0.018 * caster.height_m, 0.1 * caster.width_m);
}

fn trunk_way(tree: Caster, begin_m: vec3f, toward: vec3f) -> f32 {
    let radius_m = trunk_radius_m(tree);
    let a = max(dot(toward.xz, toward.xz), 1e-6);
    let b = dot(begin_m.xz, toward.xz);
    let inside = b * b - a * (dot(begin_m.xz, begin_m.xz) - radius_m * radius_m);
    if inside <= 0.0 {
        return NO_WAY;
    }
    let t = (-sqrt(inside) - b) / a;
    let up_m = begin_m.y + t * toward.y;
    return select(NO_WAY, t, up_m >= -0.05 * tree.width_m && up_m <= 0.7 * tree.height_m);
}

fn unpacked_tree(words: vec4u) -> Caster {
    return Caster(bitcast<vec3f>(words.xyz), f32(words.w & 4095u) / SHAPE_STEPS, f32((words.w >> 12u) & 4095u) / SHAPE_STEPS, (words.w >> 24u) & 3u);
}
