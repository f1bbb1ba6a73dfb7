@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(1)
var<storage, read> probes: array<vec4f>;

@group(0) @binding(2)
var<storage, read_write> lights: array<vec4f>;

@compute @workgroup_size(64)
fn probe_atmosphere(@builtin(global_invocation_id) invocation: vec3u) {
    if invocation.x >= arrayLength(&probes) {
        return;
    }
    let probe = probes[invocation.x];
    let aerial = aerial_perspective(frame, probe.xyz, probe.w);
    let first = 3u * invocation.x;
    lights[first] = vec4f(aerial.transmittance, 0.0);
    lights[first + 1u] = vec4f(aerial.inscattering, 0.0);
    lights[first + 2u] = vec4f(sky_radiance(frame, probe.xyz), 0.0);
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

const DEEPEST: f32 = 20.0;

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

const SPACE_M: f32 = 10000000.0;

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

fn haze_phase(cosine: f32) -> f32 {
    const G: f32 = 0.76;
    let base = max(1.0 + G * G - 2.0 * G * cosine, 0.001);
    return 1.5 * (1.0 - G * G) / (2.0 + G * G) * (1.0 + cosine * cosine) / (base * sqrt(base));
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 0.75 * (1.0 + cosine * cosine);
}

fn scaled_erfc(x: f32) -> f32 {
    const A: f32 = 2.7519384;
    return A / ((A - 1.0) * 1.7724539 * x + sqrt(3.1415927 * x * x + A * A));
}

fn sky_radiance(frame: Frame, direction: vec3f) -> vec3f {
    return aerial_perspective(frame, direction, SPACE_M).inscattering;
}
