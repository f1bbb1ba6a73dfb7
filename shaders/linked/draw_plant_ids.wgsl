struct Varying {
    @builtin(position)
    position: vec4f,
    @location(0) @interpolate(flat)
    id: vec2u
}

fn plant_id(words: vec4u, kind: u32) -> vec2u {
    return vec2u((words.x & 16777215u) | (kind << 24u), (words.y & 16777215u) | (1u << 24u));
}

@vertex
fn grass_vertex(@builtin(vertex_index) index: u32, instance: Instance) -> Varying {
    let position = grass_point(index, instance).position;
    return Varying(position, plant_id(instance.words, field.kind));
}

@vertex
fn tree_vertex(@builtin(vertex_index) index: u32, instance: Instance) -> Varying {
    let position = tree_point(index, instance).position;
    return Varying(position, plant_id(instance.words, field.kind));
}

@vertex
fn far_vertex(@builtin(vertex_index) index: u32, instance: Instance) -> ImpostorVarying {
    return impostor_vertex(index, instance);
}

@fragment
fn fragment(in: Varying) -> @location(0) vec2u {
    return in.id;
}

struct Deep {
    @location(0)
    id: vec2u,
    @builtin(frag_depth)
    depth: f32
}

@fragment
fn far_fragment(in: ImpostorVarying) -> Deep {
    let hit = impostor_hit(in, in.toward_m);
    if !hit.is_hit {
        discard;
    }
    let id = plant_id(vec4u(in.words, 0u, 0u), KIND_TREES);
    return Deep(id, depth_of(in.root_m + hit.point.at_m));
}

const ALL_BLADES_M: f32 = 5.0;

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

const BLADES: u32 = 128u;

const BOUGHS_FILL: f32 = 0.84;

const BROAD_LEAF = vec3f(0.044, 0.082, 0.02);

const BROAD_YOUNG = vec3f(0.08, 0.108, 0.026);

const BURLEY_ENERGY: f32 = 1.0 / 1.51;

struct BladeCurve {
    control: vec3f,
    tip: vec3f
}

const CLUMP_DEPTH: f32 = 3.0;

struct Caster {
    root_m: vec3f,
    width_m: f32,
    height_m: f32,
    species: u32
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

const FEW_BLADES: u32 = 32u;

const FEW_HALF_WIDTH: f32 = 0.06;

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

const GREATEST_SHADE: f32 = 4.0;

const GUST_MEAN: f32 = 0.33;

struct GrassVarying {
    @builtin(position)
    position: vec4f,
    @location(0) @interpolate(perspective, centroid)
    light: vec3f,
    @location(1) @interpolate(perspective, centroid)
    across: f32
}

const HALF_WIDTH: f32 = 0.01157;

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

struct ImpostorVarying {
    @builtin(position)
    position: vec4f,
    @location(0)
    toward_m: vec3f,
    @location(1) @interpolate(flat)
    root_m: vec3f,
    @location(2) @interpolate(flat)
    shape: vec3f,
    @location(3) @interpolate(flat)
    species: u32,
    @location(4) @interpolate(flat)
    shares: vec4f,
    @location(5) @interpolate(flat)
    lobe_0: vec4f,
    @location(6) @interpolate(flat)
    lobe_1: vec4f,
    @location(7) @interpolate(flat)
    lobe_2: vec4f,
    @location(8) @interpolate(flat)
    lobe_3: vec4f,
    @location(9) @interpolate(flat)
    lobe_4: vec4f,
    @location(10) @interpolate(flat)
    lobe_5: vec4f,
    @location(11) @interpolate(flat)
    lobe_6: vec4f,
    @location(12) @interpolate(flat)
    lobe_7: vec4f,
    @location(13) @interpolate(flat)
    words: vec2u
}

struct Instance {
    @location(0)
    words: vec4u,
    @location(1)
    prepared: vec4u
}

const KIND_TREES: u32 = 1u;

const LEAF_CELL_M: f32 = 0.55;

const LEAF_GLOW = vec3f(1.15, 1.0, 0.4);

const LEAF_SHARE: f32 = 0.25;

const LEAVES: f32 = 14.0;

override LEVEL: u32 = 0u;

const LIGHT_AT = vec3f(0.15, 0.5, 0.85);

const LOBES: u32 = 8u;

struct LeafPoint {
    albedo: vec3f,
    normal: vec3f,
    open: f32,
    thin: f32,
    leaves: f32
}

struct Lobe {
    centre: vec3f,
    radius: f32,
    aspect: f32
}

struct Lobes {
    first: vec4f,
    second: vec4f
}

const MAX_FOOT_TILT: f32 = 0.70710678;

const MAX_GLOSS: f32 = 64.0;

const MAX_TILT: f32 = 0.75;

const METRES_PER_FINE: f32 = 1.0 / 4096.0;

const MIN_NV: f32 = 0.0001;

const MIN_ROUGHNESS: f32 = 0.045;

const NO_WAY: f32 = 1e30;

const PALETTES = array<Palette, 4>(Palette(vec3f(0.03, 0.056, 0.016), vec3f(0.068, 0.128, 0.032)), Palette(vec3f(0.038, 0.063, 0.017), vec3f(0.098, 0.15, 0.042)), Palette(vec3f(0.06, 0.068, 0.022), vec3f(0.172, 0.168, 0.062)), Palette(vec3f(0.088, 0.076, 0.032), vec3f(0.28, 0.24, 0.108)));

const PINE: u32 = 1u;

const PINE_BARK = vec3f(0.13, 0.078, 0.048);

const PINE_LEAF = vec3f(0.04, 0.066, 0.028);

const PINE_YOUNG = vec3f(0.056, 0.078, 0.03);

struct Palette {
    root: vec3f,
    tip: vec3f
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

const QUADS: u32 = 3u;

const QUAD_BLADES: u32 = 2u;

const QUAD_HALF_WIDTH: f32 = 0.32;

const RAYLEIGH_SCALE_M: f32 = 8000.0;

const RAYLEIGH_SCATTERING = vec3f(5.8e-6, 1.35e-5, 3.31e-5);

const SHARP_ROUGHNESS: f32 = 0.35;

const SINK_M: f32 = 0.03;

const SPACE_M: f32 = 10000000.0;

const SPRAYS = vec2u(168u, 40u);

const SPRUCE: u32 = 0u;

const SPRUCE_LEAF = vec3f(0.024, 0.05, 0.02);

const SPRUCE_YOUNG = vec3f(0.04, 0.07, 0.024);

const STEM_TILT: f32 = 0.45;

struct ShadingAngles {
    nl: f32,
    nv: f32,
    lh: f32,
    middle: vec3f
}

struct StemPose {
    foot: vec3f,
    root: vec2f,
    tip: vec2f
}

struct Surface {
    albedo: vec3f,
    normal: vec3f,
    roughness: f32,
    occlusion: f32,
    leaves: f32
}

const TREE_SWAY: f32 = 0.03;

const TRUNK: u32 = 3u;

const TRUNK_SIDES = vec2u(5u, 3u);

const TURN: f32 = 6.2831853;

struct TreeVarying {
    @builtin(position)
    position: vec4f,
    @location(0) @interpolate(perspective, centroid)
    light: vec3f,
    @location(1)
    place: vec2f,
    @location(2)
    number: f32,
    @location(3)
    sharp: f32,
    @location(4) @interpolate(flat)
    kind: u32
}

struct TreeVertex {
    offset_m: vec3f,
    normal: vec3f,
    sky_visibility: f32,
    trunk: f32,
    place: vec2f,
    random01: f32
}

struct TuftVertex {
    offset_m: vec3f,
    along: f32,
    across: f32,
    blade: f32,
    round: vec3f
}

const VISIBILITY_FAST: u32 = 1u;

const WHORL = vec2u(8u, 5u);

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

fn aligned(v: vec3f, up: vec3f) -> vec3f {
    let k = vec3f(up.z, 0.0, -up.x);
    return up.y * v + cross(k, v) + k * (dot(k, v) / (1.0 + up.y));
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

fn beside_stem(up: f32, aside_m: vec2f, height_m: f32, sway_m: vec2f) -> vec3f {
    return tree_stem(up, height_m, sway_m) + vec3f(aside_m.x, 0.0, aside_m.y);
}

fn blade_curve(root: vec2f, tip: vec2f) -> BladeCurve {
    let middle = 0.5 * (root + tip);
    let low = upright_direction(root).y;
    let high = upright_direction(tip).y;
    let rise = (low + 4.0 * upright_direction(middle).y + high) / 6.0;
    return BladeCurve(vec3f(0.5 * root.x, 0.5 * rise + 0.25 * (low - high), 0.5 * root.y), vec3f(middle.x, rise, middle.y));
}

fn blade_direction(curve: BladeCurve, along: f32) -> vec3f {
    return mix(curve.control, curve.tip - curve.control, along);
}

fn blade_numbers(phase: f32, blade: u32) -> vec4f {
    return fract(phase * vec4f(7.0, 11.0, 13.0, 17.0) + f32(blade) * vec4f(0.61803399, 0.75487767, 0.56984029, 0.41421356));
}

fn blade_point(curve: BladeCurve, along: f32) -> vec3f {
    return curve.control * (2.0 * along * (1.0 - along)) + curve.tip * (along * along);
}

fn blade_presence(share: f32, blade: u32, blades: u32) -> f32 {
    let band = min(max(0.25 * share, 1.0 / f32(blades)), 2.0 * (1.0 - share));
    let inside = share + 0.5 * band - (f32(blade) + 0.5) / f32(blades);
    return clamp(inside / max(band, 1e-6), 0.0, 1.0);
}

fn blade_share(distance_m: f32) -> f32 {
    let times = ALL_BLADES_M / max(distance_m, 0.001);
    return max(min(1.0, times * max(times, 0.5)), 0.07);
}

fn bough_vertex(tree: Caster, level: u32, spray: u32, corner: u32, phase: f32, sway_m: vec2f) -> TreeVertex {
    let random01 = part_random(phase, spray);
    let whorl = spray / WHORL[level];
    let whorls = SPRAYS[level] / WHORL[level];
    let crown = crown_of(tree);
    let up = (f32(whorl) + 0.4 * random01) / f32(whorls);
    let bough_length = pow(1.0 - 0.93 * up, 0.9) * (1.0 - 0.22 * random01);
    let turn = f32(spray % WHORL[level]) / f32(WHORL[level]) + 0.38196601 * f32(whorl);
    let angle = TURN * (phase + turn + 0.05 * random01);
    let outward = vec2f(cos(angle), sin(angle));
    let across = vec2f(-outward.y, outward.x);
    let is_end = corner == 1u || corner == 5u;
    let is_side = corner == 2u || corner == 4u;
    let sign = select(-1.0, 1.0, corner == 4u);
    let half = select(0.4, 0.56, level > 0u);
    let along = select(select(0.0, 1.0, is_end), 0.5, is_side);
    let length_m = crown.radius_m * bough_length;
    let aside_m = outward * (length_m * select(along, 0.56, is_side)) + across * select(0.0, sign * half * length_m, is_side);
    let foot = (crown.wide_m + crown.rise_m * (0.04 + 0.93 * up)) / tree.height_m;
    let span = 1.0 / f32(whorls);
    let fall = select(select(-0.05, 0.3, is_end), 0.34, is_side) * length_m / tree.height_m + select(0.0, 0.35 * span, level > 0u && !is_end && is_side);
    let high = select(foot, min(foot + 0.8 * span, 1.0), level > 0u && along == 0.0);
    let offset_m = beside_stem(clamp(high - fall, 0.01, 0.995), aside_m, tree.height_m, sway_m);
    let normal = normalize(vec3f(outward.x + 0.5 * sign * select(0.0, across.x, is_side), 0.7, outward.y + 0.5 * sign * select(0.0, across.y, is_side)));
    let sky_visibility = select(0.28, 0.62, is_side) + select(0.0, 0.72, is_end);
    return TreeVertex(offset_m, normal, min(sky_visibility, 1.0) * (0.55 + 0.45 * up), 0.0, vec2f(along, select(0.0, sign, is_side)), random01);
}

fn burley_diffuse(nl: f32, nv: f32, lh: f32, roughness: f32) -> f32 {
    let rise = 2.0 * roughness * lh * lh - 0.5;
    let light = 1.0 + rise * fifth_power(1.0 - nl);
    let view = 1.0 + rise * fifth_power(1.0 - nv);
    return light * view * mix(1.0, BURLEY_ENERGY, roughness);
}

fn clump_number(word: u32, shift: u32) -> f32 {
    return f32((word >> shift) & 63u) / 63.0;
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

fn depth_of(at_m: vec3f) -> f32 {
    let clip = frame.clip_from_camera * vec4f(at_m, 1.0);
    return clamp(clip.z / max(clip.w, 1e-6), 0.0, 1.0);
}

@group(0) @binding(1)
var<uniform> field: Field;

fn fifth_power(x: f32) -> f32 {
    let squared = x * x;
    return squared * squared * x;
}

@group(0) @binding(0)
var<uniform> frame: Frame;

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

fn grass_point(index: u32, instance: Instance) -> GrassVarying {
    let prepared = instance.prepared;
    if prepared.w == 0u {
        return GrassVarying(vec4f(0.0, 0.0, 0.0, -1.0), vec3f(0.0), 0.0);
    }
    let clump = unpacked_clump(instance.words);
    let root_m = root_offset_m(field, clump, frame.eye_fraction_m);
    let detail_m = length(root_m) * field.detail;
    let tint = unpack2x16unorm(prepared.z);
    let colours = palette_at(3.0 * tint.x, GREATEST_SHADE * tint.y);
    let shares = unpack4x8unorm(prepared.w);
    let pose = stem_pose(clump.normal, unpacked_push(prepared.y));
    let leaf = tuft_vertex(LEVEL, index, unpacked_size_m(field, prepared.x), clump.phase, pose, detail_m);
    let offset_m = root_m + leaf.offset_m;
    let sheen = 1.0 + 0.4 * sqrt(field.wind) * (shares.z - GUST_MEAN) * leaf.along;
    let albedo = mix(colours.root, colours.tip, leaf.along) * (sheen * (0.86 + 0.28 * leaf.blade));
    let near = 1.0 - smoothstep(8.0, 30.0, detail_m);
    let open = mix(mix(0.32, 0.2, near), 1.0, leaf.along * (2.0 - leaf.along)) * shares.y;
    let point = LeafPoint(albedo, normalize(clump.normal + leaf.round), open, leaf.along, 1.0);
    let light = leaf_light(frame, point, offset_m, shares.x);
    return GrassVarying(frame.clip_from_camera * vec4f(offset_m, 1.0), light, leaf.across);
}

fn greatest_size_m(field: Field) -> vec2f {
    return vec2f(field.width_high_m * field.widest, field.height_high_m);
}

fn haze_phase(cosine: f32) -> f32 {
    const G: f32 = 0.76;
    let base = max(1.0 + G * G - 2.0 * G * cosine, 0.001);
    return 1.5 * (1.0 - G * G) / (2.0 + G * G) * (1.0 + cosine * cosine) / (base * sqrt(base));
}

fn hit_at(in: ImpostorVarying, tree: Caster, crown: Crown, begin_m: vec3f, toward: vec3f, met: vec4f, trunk: f32, flat: f32) -> ImpostorHit {
    let is_trunk = trunk < met.w;
    let way = min(met.w, trunk);
    let at_m = begin_m + toward * way;
    var outward = vec3f(at_m.x, 0.0, at_m.z);
    if !is_trunk && tree.species == SPRUCE {
        outward.y = length(at_m.xz) * crown.radius_m / crown.rise_m;
    }
    else if !is_trunk {
        let axes = vec3f(crown.radius_m, crown.rise_m, crown.radius_m);
        let at = (at_m - vec3f(0.0, crown.wide_m, 0.0)) / axes;
        outward = (at - met.xyz) / vec3f(1.0, flat * flat, 1.0);
    }
    outward = normalize(outward + vec3f(0.0, 0.0001, 0.0));
    let point = ImpostorPoint(at_m, outward, is_trunk);
    let pixel_m = length(in.root_m) / frame.pixels_per_radian;
    let number = leaf_number(at_m, in.shape.z, pixel_m);
    return ImpostorHit(way < NO_WAY && leaves_cover(point, toward, number), point, number);
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

fn impostor_hit(in: ImpostorVarying, toward_m: vec3f) -> ImpostorHit {
    let tree = impostor_tree(in);
    let crown = impostor_crown(tree);
    let toward = normalize(toward_m);
    let begin_m = toward * ray_begin_m(tree, toward) - in.root_m;
    let trunk = trunk_way(tree, begin_m, toward);
    let flat = select(1.0, 0.62, tree.species == PINE);
    if tree.species == SPRUCE {
        let met = vec4f(0.0, 0.0, 0.0, crown_way(crown, begin_m, toward));
        return hit_at(in, tree, crown, begin_m, toward, met, trunk, flat);
    }
    let lobes = lobes_met(in, crown, flat, begin_m, toward);
    let hit = hit_at(in, tree, crown, begin_m, toward, lobes.first, trunk, flat);
    if hit.is_hit || min(lobes.second.w, trunk) >= NO_WAY {
        return hit;
    }
    return hit_at(in, tree, crown, begin_m, toward, lobes.second, trunk, flat);
}

fn impostor_tree(in: ImpostorVarying) -> Caster {
    return Caster(in.root_m, in.shape.x, in.shape.y, in.species);
}

fn impostor_vertex(index: u32, instance: Instance) -> ImpostorVarying {
    let prepared = instance.prepared;
    var out: ImpostorVarying;
    if prepared.w == 0u || unpacked_size_m(field, prepared.x).y <= 0.0 {
        out.position = vec4f(0.0, 0.0, 0.0, -1.0);
        return out;
    }
    let clump = unpacked_clump(instance.words);
    let size_m = unpacked_size_m(field, prepared.x);
    let species = prepared.w & 3u;
    let root_m = root_offset_m(field, clump, frame.eye_fraction_m);
    out.toward_m = impostor_corner(Caster(root_m, size_m.x, size_m.y, species), index);
    out.position = frame.clip_from_camera * vec4f(out.toward_m, 1.0);
    out.root_m = root_m;
    out.shape = vec3f(size_m, clump.phase);
    out.species = species;
    out.words = instance.words.xy;
    out.shares = unpack4x8unorm(prepared.z);
    if species != SPRUCE {
        out.lobe_0 = lobe_ball(species, clump.phase, 0u);
        out.lobe_1 = lobe_ball(species, clump.phase, 1u);
        out.lobe_2 = lobe_ball(species, clump.phase, 2u);
        out.lobe_3 = lobe_ball(species, clump.phase, 3u);
        out.lobe_4 = lobe_ball(species, clump.phase, 4u);
        out.lobe_5 = lobe_ball(species, clump.phase, 5u);
        out.lobe_6 = lobe_ball(species, clump.phase, 6u);
        out.lobe_7 = lobe_ball(species, clump.phase, 7u);
    }
    return out;
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

fn limb_vertex(tree: Caster, limb: u32, right: u32, top: u32, phase: f32, sway_m: vec2f) -> TreeVertex {
    let crown = crown_of(tree);
    let lobe = lobe_of(tree.species, phase, 1u + (2u * limb) % (LOBES - 1u));
    let limb_end = 0.9 * lobe.centre;
    let end_up = (crown.wide_m + crown.rise_m * limb_end.y) / tree.height_m;
    let lowest = select(0.26, 0.55, tree.species == PINE);
    let begin_up = min(lowest + 0.05 * f32(limb), max(end_up - 0.06, 0.1));
    let length = max(length(limb_end.xz), 0.001);
    let across = vec2f(-limb_end.z, limb_end.x) / length;
    let half_m = trunk_radius_m(tree) * select(0.42, 0.12, top == 1u) * (f32(right) * 2.0 - 1.0);
    let has_limb = select(1.0, 0.0, tree.species == SPRUCE);
    let aside_m = across * (half_m * has_limb) + select(vec2f(0.0), limb_end.xz * (crown.radius_m * has_limb), top == 1u);
    let up = select(begin_up, mix(begin_up, end_up, has_limb), top == 1u);
    return TreeVertex(beside_stem(up, aside_m, tree.height_m, sway_m), normalize(vec3f(limb_end.x, 0.6, limb_end.z)), select(0.5, 0.25, top == 1u), 1.0, vec2f(0.0), part_random(phase, limb));
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

fn lobe_ball(species: u32, phase: f32, index: u32) -> vec4f {
    let lobe = lobe_of(species, phase, index);
    return vec4f(lobe.centre, lobe.radius);
}

fn lobe_of(species: u32, phase: f32, lobe: u32) -> Lobe {
    let random01 = part_random(phase, lobe + 512u);
    let y = 0.92 - 1.5 * f32(lobe) / f32(LOBES - 1u);
    let angle = TURN * (0.38196601 * f32(lobe) + 3.0 * phase + 0.12 * random01);
    let sin_polar = sqrt(1.0 - y * y);
    let outward = vec3f(sin_polar * cos(angle), y, sin_polar * sin(angle));
    let away = 0.42 + 0.2 * fract(5.0 * random01);
    return Lobe(outward * away, 0.985 - away, select(1.0, 0.62, species == PINE));
}

fn lobe_way(crown: Crown, lobe: vec4f, flat: f32, begin_m: vec3f, toward: vec3f) -> f32 {
    let axes = vec3f(crown.radius_m, crown.rise_m, crown.radius_m);
    let squash = vec3f(1.0, 1.0 / flat, 1.0);
    let begin = (begin_m - vec3f(0.0, crown.wide_m, 0.0)) / axes - lobe.xyz;
    return sphere_way(begin * squash, toward / axes * squash, lobe.w);
}

fn lobes_met(in: ImpostorVarying, crown: Crown, flat: f32, begin_m: vec3f, toward: vec3f) -> Lobes {
    let none = vec4f(0.0, 0.0, 0.0, NO_WAY);
    var lobes = Lobes(none, none);
    lobes = with_lobe(lobes, crown, in.lobe_0, flat, begin_m, toward);
    lobes = with_lobe(lobes, crown, in.lobe_1, flat, begin_m, toward);
    lobes = with_lobe(lobes, crown, in.lobe_2, flat, begin_m, toward);
    lobes = with_lobe(lobes, crown, in.lobe_3, flat, begin_m, toward);
    lobes = with_lobe(lobes, crown, in.lobe_4, flat, begin_m, toward);
    lobes = with_lobe(lobes, crown, in.lobe_5, flat, begin_m, toward);
    lobes = with_lobe(lobes, crown, in.lobe_6, flat, begin_m, toward);
    lobes = with_lobe(lobes, crown, in.lobe_7, flat, begin_m, toward);
    return lobes;
}

fn palette_at(place: f32, shade: f32) -> Palette {
    let within = clamp(place, 0.0, 2.999);
    let low = palettes[u32(within)];
    let high = palettes[u32(within) + 1u];
    let share = fract(within);
    return Palette(mix(low.root, high.root, share) * shade, mix(low.tip, high.tip, share) * shade);
}

var<private> palettes: array<Palette, 4> = PALETTES;

fn part_random(phase: f32, part: u32) -> f32 {
    return fract(phase * 11.0 + f32(part) * 0.61803399);
}

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = (x * 1664525u + y * 22695477u + 1013904223u) * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn quad_vertex(index: u32, size_m: vec2f, phase: f32, pose: StemPose) -> TuftVertex {
    let blade = index / 3u;
    let corner = index % 3u;
    let along = select(0.0, 1.0, corner == 2u);
    let across = select(f32(corner & 1u) * 2.0 - 1.0, 0.0, corner == 2u);
    let quad = blade / QUAD_BLADES;
    let place = f32(blade % QUAD_BLADES) - 0.5;
    let number = tuft_number(phase, blade);
    let angle = TURN * (phase + f32(quad) / f32(2u * QUADS));
    let level_side = vec2f(cos(angle), sin(angle));
    let side = aligned(vec3f(level_side.x, 0.0, level_side.y), pose.foot);
    let fall = vec2f(-level_side.y, level_side.x) * (0.5 * number - 0.25);
    let blade_pose = StemPose(pose.foot, pose.root, within_tilt(pose.tip + fall, MAX_TILT));
    let centre = place * (0.36 + 0.24 * along * along);
    let length = 1.0 - 0.3 * tuft_number(phase, blade + 4u);
    let half_width = QUAD_HALF_WIDTH * (1.0 - along);
    var offset_m = stem_point(blade_pose, u32(along), 1u) * (size_m.y * length);
    offset_m += side * (size_m.x * (centre + across * half_width));
    offset_m.y -= min(0.04 * size_m.y + 0.01 * size_m.x, 0.14 * size_m.x);
    return TuftVertex(offset_m, along, across, number, vec3f(0.0));
}

fn ray_begin_m(tree: Caster, toward: vec3f) -> f32 {
    return dot(tree.root_m + vec3f(0.0, 0.5 * tree.height_m, 0.0), toward);
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 0.75 * (1.0 + cosine * cosine);
}

fn root_offset_m(field: Field, clump: Clump, eye_fraction_m: vec3f) -> vec3f {
    let whole = clump.place - vec3i(field.eye_x, field.eye_y, field.eye_z);
    let fraction = eye_fraction_m / METRES_PER_FINE;
    return (vec3f(whole) - (fraction - floor(fraction + 0.5))) * METRES_PER_FINE;
}

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

fn spray_vertex(tree: Caster, level: u32, spray: u32, corner: u32, phase: f32, sway_m: vec2f) -> TreeVertex {
    let random01 = part_random(phase, spray);
    let crown = crown_of(tree);
    let lobe = lobe_of(tree.species, phase, spray % LOBES);
    let place = f32(spray / LOBES);
    let y = 1.0 - (2.0 * place + 1.0) * f32(LOBES) / f32(SPRAYS[level]);
    let angle = TURN * (0.38196601 * place + 5.0 * phase + 0.03 * random01);
    let sin_polar = sqrt(max(1.0 - y * y, 0.0));
    let outward = vec3f(sin_polar * cos(angle), y, sin_polar * sin(angle));
    let half = lobe.radius * select(0.55, 0.95, level > 0u);
    let shell = lobe.radius * select(0.55 + 0.4 * fract(7.0 * random01), 0.6, level > 0u);
    let east = normalize(vec3f(outward.z + 0.0001, 0.0, -outward.x));
    let north = cross(outward, east);
    let spin = TURN * fract(13.0 * random01);
    let first = east * cos(spin) + north * sin(spin);
    let tilt = 1.8 * fract(29.0 * random01) - 0.9;
    let second = normalize(north * cos(spin) - east * sin(spin) + outward * tilt);
    let right = select(-1.0, 1.0, corner == 1u || corner == 3u || corner == 4u);
    let above = select(-1.0, 1.0, corner == 2u || corner == 4u || corner == 5u);
    let in_lobe = outward * shell + (first * right + second * above) * half;
    let unclamped = lobe.centre + in_lobe * vec3f(1.0, lobe.aspect, 1.0);
    let at = unclamped * min(1.0, 0.985 / max(length(unclamped), 0.001));
    let up = (crown.wide_m + crown.rise_m * at.y) / tree.height_m;
    let offset_m = beside_stem(up, at.xz * crown.radius_m, tree.height_m, sway_m);
    let crown_normal = at / vec3f(crown.radius_m, crown.rise_m, crown.radius_m) * crown.radius_m;
    let normal = normalize(outward * 0.8 + crown_normal * 0.6 + vec3f(0.0, 0.2, 0.0));
    let deep = dot(at, at);
    return TreeVertex(offset_m, normal, clamp(0.16 + 0.48 * deep + 0.2 * at.y + 0.26 * outward.y, 0.1, 1.0), 0.0, vec2f(right, above), random01);
}

fn stem_point(pose: StemPose, row: u32, segments: u32) -> vec3f {
    var point = vec3f(0.0);
    for (var piece = 0u; piece < row; piece++) {
        let along = (f32(piece) + 0.5) / f32(segments);
        point += upright_direction(mix(pose.root, pose.tip, along));
    }
    return point / f32(segments);
}

fn stem_pose(normal: vec3f, push: vec2f) -> StemPose {
    let foot = within_tilt(normal.xz, MAX_FOOT_TILT);
    let root = foot * STEM_TILT;
    return StemPose(upright_direction(foot), root, within_tilt(root + push, MAX_TILT));
}

fn tree_point(index: u32, instance: Instance) -> TreeVarying {
    let prepared = instance.prepared;
    if prepared.w == 0u {
        return TreeVarying(vec4f(0.0, 0.0, 0.0, -1.0), vec3f(0.0), vec2f(0.0), 0.0, 0.0, TRUNK);
    }
    let clump = unpacked_clump(instance.words);
    let root_m = root_offset_m(field, clump, frame.eye_fraction_m);
    let species = prepared.w & 3u;
    let size_m = unpacked_size_m(field, prepared.x);
    let shares = unpack4x8unorm(prepared.z);
    let part = vertex_of_tree(species, LEVEL, index, size_m, clump.phase, unpacked_push(prepared.y));
    let offset_m = root_m + part.offset_m;
    let up = clamp(part.offset_m.y / max(size_m.y, 0.001), 0.0, 1.0);
    let low = clamp((up - LIGHT_AT.x) / (LIGHT_AT.y - LIGHT_AT.x), 0.0, 1.0);
    let high = clamp((up - LIGHT_AT.y) / (LIGHT_AT.z - LIGHT_AT.y), 0.0, 1.0);
    let past_trees = mix(mix(shares.x, shares.y, low), shares.z, high);
    let bark = bark_colour(species);
    let leaves = leaf_colour(species, clump.phase) * (0.85 + 0.3 * part.random01);
    let leaf = LeafPoint(mix(leaves, bark, part.trunk), part.normal, part.sky_visibility, 0.5 * (1.0 - part.trunk), 1.0 - part.trunk);
    let light = leaf_light(frame, leaf, offset_m, shares.w * past_trees);
    let spray_m = select(0.3, 0.5, species == SPRUCE) * size_m.x;
    let leaf_px = spray_m / LEAVES * frame.pixels_per_radian / max(length(offset_m), 0.1);
    return TreeVarying(frame.clip_from_camera * vec4f(offset_m, 1.0), light, part.place, part.random01, clamp(0.5 * leaf_px - 0.5, 0.0, 1.0), select(species, TRUNK, part.trunk > 0.5));
}

fn tree_stem(along: f32, height_m: f32, sway_m: vec2f) -> vec3f {
    let aside = sway_m * (along * along);
    let tilt = 2.0 * sway_m / max(height_m, 0.001);
    let height_loss = dot(tilt, tilt) * along * along * along / 6.0;
    return vec3f(aside.x, height_m * (along - height_loss), aside.y);
}

fn trunk_radius_m(caster: Caster) -> f32 {
    return min(0.018 * caster.height_m, 0.1 * caster.width_m);
}

fn trunk_vertex(tree: Caster, level: u32, part: u32, corner: u32, phase: f32, sway_m: vec2f) -> TreeVertex {
    let right = select(0u, 1u, corner == 2u || corner == 3u || corner == 5u);
    let top = select(0u, 1u, corner == 1u || corner == 4u || corner == 5u);
    let sides = TRUNK_SIDES[level];
    if part >= sides {
        return limb_vertex(tree, part - sides, right, top, phase, sway_m);
    }
    let angle = TURN * (phase + f32(part + right) / f32(sides));
    let outward = vec2f(cos(angle), sin(angle));
    let is_spruce = tree.species == SPRUCE;
    let trunk_half_width_m = trunk_radius_m(tree) * select(select(1.35, 0.45, top == 1u), select(0.9, 0.2, top == 1u), is_spruce);
    var offset_m = beside_stem(select(0.0, 0.7, top == 1u), outward * trunk_half_width_m, tree.height_m, sway_m);
    offset_m.y -= select(0.1 * tree.width_m, 0.0, top == 1u);
    let normal = vec3f(outward.x, 0.0, outward.y);
    return TreeVertex(offset_m, normal, select(0.75, 0.3, top == 1u) * select(1.0, 0.5, is_spruce), 1.0, vec2f(0.0), part_random(phase, part));
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

fn tuft_number(phase: f32, blade: u32) -> f32 {
    return fract(phase * 7.0 + f32(blade) * 0.61803399);
}

fn tuft_vertex(level: u32, index: u32, size_m: vec2f, phase: f32, pose: StemPose, distance_m: f32) -> TuftVertex {
    if level == 2u {
        return quad_vertex(index, size_m, phase, pose);
    }
    let segments = select(1u, 3u, level == 0u);
    let corners = 2u * segments + 1u;
    let stride = select(corners, corners + 2u, level == 0u);
    let blade = index / stride;
    let corner = select(index % stride, clamp(index % stride, 1u, corners) - 1u, level == 0u);
    let row = corner >> 1u;
    let across = select(f32(corner & 1u) * 2.0 - 1.0, 0.0, row == segments);
    let along = f32(row) / f32(segments);
    let numbers = blade_numbers(phase, blade);
    let way = TURN * numbers.z;
    let out = vec2f(cos(way), sin(way));
    let root_m = out * (sqrt(numbers.y) * (0.25 * size_m.x + 0.1));
    let turn = TURN * numbers.w;
    let side = aligned(vec3f(cos(turn), 0.0, sin(turn)), pose.foot);
    let facing = vec2f(-sin(turn), cos(turn));
    let outward = select(-1.0, 1.0, dot(facing, out) >= 0.0);
    let most = min(0.7, (0.4 * size_m.x + 0.24) / max(size_m.y, 0.001));
    let fall = facing * (outward * most * (0.25 + 0.75 * tuft_number(phase, blade + 4u)));
    let curve = blade_curve(pose.root, within_tilt(pose.tip + fall, MAX_TILT));
    let length = 1.0 - 0.3 * numbers.x;
    let share = blade_share(distance_m);
    let few = min(1.0, share * f32(BLADES) / f32(FEW_BLADES));
    let presence = select(blade_presence(few, blade, FEW_BLADES) / few, blade_presence(share, blade, BLADES) / share, level == 0u);
    let profile = select(FEW_HALF_WIDTH * (1.0 - along), HALF_WIDTH * (1.0 - along * along), level == 0u);
    let half_width_m = size_m.x * profile * presence;
    var offset_m = aligned(vec3f(root_m.x, 0.0, root_m.y), pose.foot) + blade_point(curve, along) * (size_m.y * length) + side * (across * half_width_m);
    offset_m.y -= SINK_M;
    let upper = normalize(cross(blade_direction(curve, along), side));
    let round = (upper * upper.y + side * (0.45 * across)) * (1.0 - smoothstep(8.0, 30.0, distance_m));
    return TuftVertex(offset_m, along, across, numbers.x, round);
}

fn unpacked_clump(words: vec4u) -> Clump {
    let level = clamp(vec2f(vec2i(words.xy) >> vec2u(24u)) / 127.0, vec2f(-1.0), vec2f(1.0));
    let upright = sqrt(max(1.0 - dot(level, level), 0.05));
    return Clump(vec3i(i32(words.x & 16777215u), bitcast<i32>(words.z), i32(words.y & 16777215u)), normalize(vec3f(level.x, upright, level.y)), clump_number(words.w, 0u), clump_number(words.w, 6u), clump_number(words.w, 12u), clump_number(words.w, 18u), words.w >> 24u);
}

fn unpacked_push(word: u32) -> vec2f {
    return 2.0 * unpack2x16snorm(word);
}

fn unpacked_size_m(field: Field, word: u32) -> vec2f {
    return unpack2x16unorm(word) * greatest_size_m(field);
}

fn upright_direction(level: vec2f) -> vec3f {
    return vec3f(level.x, sqrt(max(1.0 - dot(level, level), 0.0)), level.y);
}

fn vertex_of_tree(species: u32, level: u32, index: u32, size_m: vec2f, phase: f32, push: vec2f) -> TreeVertex {
    let tree = Caster(vec3f(0.0), size_m.x, size_m.y, species);
    let sway_m = push * (TREE_SWAY * min(size_m.x, 0.5 * size_m.y));
    let spray = index / 6u;
    let corner = index % 6u;
    if spray >= SPRAYS[level] {
        return trunk_vertex(tree, level, spray - SPRAYS[level], corner, phase, sway_m);
    }
    if species == SPRUCE {
        return bough_vertex(tree, level, spray, corner, phase, sway_m);
    }
    return spray_vertex(tree, level, spray, corner, phase, sway_m);
}

fn with_lobe(lobes: Lobes, crown: Crown, lobe: vec4f, flat: f32, begin_m: vec3f, toward: vec3f) -> Lobes {
    let met = vec4f(lobe.xyz, lobe_way(crown, lobe, flat, begin_m, toward));
    if met.w < lobes.first.w {
        return Lobes(met, lobes.first);
    }
    return Lobes(lobes.first, select(lobes.second, met, met.w < lobes.second.w));
}

fn within_tilt(level: vec2f, most: f32) -> vec2f {
    return level * min(1.0, most * inverseSqrt(max(dot(level, level), 1e-12)));
}
