@vertex
fn vertex(@builtin(vertex_index) index: u32, instance: Instance) -> GrassVarying {
    return grass_point(index, instance);
}

@fragment
fn fragment(in: GrassVarying) -> @location(0) vec4f {
    return vec4f(in.light * (1.0 + 0.14 * in.across), 1.0);
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

const BLADES: u32 = 128u;

const BURLEY_ENERGY: f32 = 1.0 / 1.51;

struct BladeCurve {
    control: vec3f,
    tip: vec3f
}

const CLUMP_DEPTH: f32 = 3.0;

struct Clump {
    place: vec3i,
    normal: vec3f,
    width: f32,
    height: f32,
    hue: f32,
    phase: f32,
    rank: u32
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

struct Instance {
    @location(0)
    words: vec4u,
    @location(1)
    prepared: vec4u
}

const LEAF_GLOW = vec3f(1.15, 1.0, 0.4);

const LEAF_SHARE: f32 = 0.25;

override LEVEL: u32 = 0u;

struct LeafPoint {
    albedo: vec3f,
    normal: vec3f,
    open: f32,
    thin: f32,
    leaves: f32
}

const MAX_FOOT_TILT: f32 = 0.70710678;

const MAX_GLOSS: f32 = 64.0;

const MAX_TILT: f32 = 0.75;

const METRES_PER_FINE: f32 = 1.0 / 4096.0;

const MIN_NV: f32 = 0.0001;

const MIN_ROUGHNESS: f32 = 0.045;

const PALETTES = array<Palette, 4>(Palette(vec3f(0.03, 0.056, 0.016), vec3f(0.068, 0.128, 0.032)), Palette(vec3f(0.038, 0.063, 0.017), vec3f(0.098, 0.15, 0.042)), Palette(vec3f(0.06, 0.068, 0.022), vec3f(0.172, 0.168, 0.062)), Palette(vec3f(0.088, 0.076, 0.032), vec3f(0.28, 0.24, 0.108)));

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

const TURN: f32 = 6.2831853;

struct TuftVertex {
    offset_m: vec3f,
    along: f32,
    across: f32,
    blade: f32,
    round: vec3f
}

const VISIBILITY_FAST: u32 = 1u;

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

fn burley_diffuse(nl: f32, nv: f32, lh: f32, roughness: f32) -> f32 {
    let rise = 2.0 * roughness * lh * lh - 0.5;
    let light = 1.0 + rise * fifth_power(1.0 - nl);
    let view = 1.0 + rise * fifth_power(1.0 - nv);
    return light * view * mix(1.0, BURLEY_ENERGY, roughness);
}

fn clump_number(word: u32, shift: u32) -> f32 {
    return f32((word >> shift) & 63u) / 63.0;
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

fn leaf_sun(facing: f32) -> f32 {
    return 0.5 * exp(-CLUMP_DEPTH * max(-facing, 0.0));
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

fn palette_at(place: f32, shade: f32) -> Palette {
    let within = clamp(place, 0.0, 2.999);
    let low = palettes[u32(within)];
    let high = palettes[u32(within) + 1u];
    let share = fract(within);
    return Palette(mix(low.root, high.root, share) * shade, mix(low.tip, high.tip, share) * shade);
}

var<private> palettes: array<Palette, 4> = PALETTES;

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

fn within_tilt(level: vec2f, most: f32) -> vec2f {
    return level * min(1.0, most * inverseSqrt(max(dot(level, level), 1e-12)));
}
