@group(0) @binding(0)
var<uniform> frame: Frame;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let direction = normalize(view_ray(frame, position.xy));
    let aerial = aerial_perspective(frame, direction, SPACE_M);
    var light = aerial.inscattering + sun_disc(frame, direction, aerial.transmittance);
    light = clouds(frame, direction, light);
    if direction.y < 0.0 && frame.eye_height_m > 0.0 {
        let offset_m = direction * (frame.eye_height_m / max(-direction.y, 1e-6));
        light = mix(light, apply_aerial_perspective(frame, deep_water(frame, 1.0), offset_m), sea_share(frame, direction));
    }
    return vec4f(light, 1.0);
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

const CLOUD_DRIFT_M = vec2f(9.0, 4.0);

const CLOUD_FADE_M: f32 = 300.0;

const CLOUD_HEIGHT_M: f32 = 1600.0;

const DEEPEST: f32 = 20.0;

const DEEP_WATER = vec3f(0.0028, 0.0195, 0.046);

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

const PATTERN_PERIOD_M: f32 = 8192.0;

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

const SUN_RADIANCE = vec3f(4.68, 4.52, 4.36);

const SUN_RADIUS: f32 = 0.004651;

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

fn cloud_cover(place_m: vec2f) -> f32 {
    return covered(pattern_fbm(place_m, 2048.0, 21u), pattern_fbm(place_m, 512.0, 22u));
}

fn clouds(frame: Frame, direction: vec3f, behind: vec3f) -> vec3f {
    if direction.y <= 0.03 || frame.eye_height_m >= CLOUD_HEIGHT_M {
        return behind;
    }
    let distance_m = (CLOUD_HEIGHT_M - frame.eye_height_m) / direction.y;
    let place_m = drifted(frame, frame.pattern_eye_m + direction.xz * distance_m);
    let cover = cloud_cover(place_m);
    if cover <= 0.0 {
        return behind;
    }
    let sunward = cloud_cover(place_m + frame.sun.xz * inverseSqrt(max(dot(frame.sun.xz, frame.sun.xz), 0.0001)) * 110.0);
    let toward = max(dot(direction, frame.sun), 0.0);
    let toward2 = toward * toward;
    let toward8 = toward2 * toward2 * toward2 * toward2;
    let sun = frame.atmosphere.sun_aloft * (0.3 * exp(-1.1 * sunward) * (1.0 + 0.9 * toward8));
    let lit = sun + 0.75 * ambient(frame, vec3f(0.0, 1.0, 0.0));
    let seen = apply_aerial_perspective(frame, lit, direction * distance_m);
    let below = smoothstep(0.0, CLOUD_FADE_M, CLOUD_HEIGHT_M - frame.eye_height_m);
    return mix(behind, seen, cover * 0.92 * below * smoothstep(0.035, 0.22, direction.y));
}

fn covered(broad: f32, puffs: f32) -> f32 {
    return smoothstep(0.5, 0.78, broad * 0.62 + puffs * 0.38);
}

fn deep_water(frame: Frame, sun: f32) -> vec3f {
    return DEEP_WATER * light_on_water(frame, sun);
}

fn drifted(frame: Frame, place_m: vec2f) -> vec2f {
    return place_m - CLOUD_DRIFT_M * frame.time_s;
}

fn haze_phase(cosine: f32) -> f32 {
    const G: f32 = 0.76;
    let base = max(1.0 + G * G - 2.0 * G * cosine, 0.001);
    return 1.5 * (1.0 - G * G) / (2.0 + G * G) * (1.0 + cosine * cosine) / (base * sqrt(base));
}

fn lattice_value(cell: vec2i, mask: i32, salt: u32) -> f32 {
    let wrapped = vec2u(cell & vec2i(mask));
    return f32(pattern_hash(wrapped.x + salt * 2654435769u, wrapped.y) >> 8u) * (1.0 / 16777216.0);
}

fn light_on_water(frame: Frame, sun: f32) -> vec3f {
    return frame.atmosphere.sun * (max(frame.sun.y, 0.0) * sun) + ambient(frame, vec3f(0.0, 1.0, 0.0));
}

fn pattern(position_m: vec2f, cell_m: f32, salt: u32) -> f32 {
    return pattern_gradient(position_m, cell_m, salt).x;
}

fn pattern_fbm(position_m: vec2f, cell_m: f32, salt: u32) -> f32 {
    var p = position_m;
    var sum = 0.0;
    var weight = 0.5333;
    for (var octave = 0u; octave < 4u; octave++) {
        sum += weight * pattern(p, cell_m, salt + octave);
        p = vec2f(2.0 * p.x + p.y, 2.0 * p.y - p.x);
        weight *= 0.5;
    }
    return sum;
}

fn pattern_gradient(position_m: vec2f, cell_m: f32, salt: u32) -> vec3f {
    let p = position_m / cell_m;
    let low = floor(p);
    let f = p - low;
    let cell = vec2i(low);
    let mask = i32(PATTERN_PERIOD_M / cell_m) - 1;
    let a = lattice_value(cell, mask, salt);
    let b = lattice_value(cell + vec2i(1, 0), mask, salt);
    let c = lattice_value(cell + vec2i(0, 1), mask, salt);
    let d = lattice_value(cell + vec2i(1, 1), mask, salt);
    let u = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let du = 30.0 * f * f * (f * (f - 2.0) + 1.0);
    let value = mix(mix(a, b, u.x), mix(c, d, u.x), u.y);
    let gradient = du * vec2f(mix(b - a, d - c, u.y), mix(c - a, d - b, u.x)) / cell_m;
    return vec3f(value, gradient);
}

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = (x * 1664525u + y * 22695477u + 1013904223u) * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 0.75 * (1.0 + cosine * cosine);
}

fn scaled_erfc(x: f32) -> f32 {
    const A: f32 = 2.7519384;
    return A / ((A - 1.0) * 1.7724539 * x + sqrt(3.1415927 * x * x + A * A));
}

fn sea_share(frame: Frame, direction: vec3f) -> f32 {
    let dip = sqrt(2.0 * max(frame.eye_height_m, 0.0) / EARTH_RADIUS_M);
    return smoothstep(0.96, 1.04, -direction.y / max(dip, 1e-5));
}

fn sun_disc(frame: Frame, direction: vec3f, left: vec3f) -> vec3f {
    let off = length(direction - frame.sun);
    let edge = smoothstep(0.9 * SUN_RADIUS, 1.1 * SUN_RADIUS, off);
    return SUN_RADIANCE * left * (56.0 * (1.0 - edge));
}

fn view_ray(frame: Frame, position: vec2f) -> vec3f {
    let ndc = position / frame.viewport * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0);
    return frame.ray_forward + ndc.x * frame.ray_right + ndc.y * frame.ray_up;
}
