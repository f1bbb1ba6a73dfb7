@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(1)
var wave_map: texture_2d<f32>;

@group(0) @binding(2)
var tiled: sampler;

const SECTORS: u32 = 8u;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let is_under = frame.eye_height_m <= 0.0;
    if index >= 3u * SECTORS {
        let corner = vec2f(f32(((index - 3u * SECTORS) << 1u) & 2u), f32((index - 3u * SECTORS) & 2u));
        return select(vec4f(0.0, 0.0, 0.0, 1.0), vec4f(corner * 2.0 - 1.0, 1e-12, 1.0), is_under);
    }
    let corner = index % 3u;
    let turn = select(-1.0, 1.0, is_under);
    let angle = turn * f32(index / 3u + corner - 1u) * (6.2831853 / f32(SECTORS));
    let rim = vec4f(cos(angle), 0.0, sin(angle), 0.0);
    let below = vec4f(0.0, -frame.eye_height_m, 0.0, 1.0);
    return frame.clip_from_camera * select(rim, below, corner == 0u);
}

struct Wind {
    strength: f32,
    shift_m: vec2f
}

fn wind(place_m: vec2f) -> Wind {
    let broad = pattern(place_m, 1024.0, 31u);
    let gusts = pattern(place_m, 256.0, 32u);
    return Wind(0.4 + 1.5 * broad * (0.4 + 0.7 * gusts), vec2f(210.0 * broad + 24.0 * gusts, 40.0 * gusts - 120.0 * broad));
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    return from_above(normalize(view_ray(frame, position.xy)));
}

@fragment
fn fragment_below(@builtin(position) position: vec4f) -> @location(0) vec4f {
    return vec4f(from_below(normalize(view_ray(frame, position.xy))), 1.0);
}

fn footprint(distance_m: f32, climb: f32) -> f32 {
    return distance_m * 2.0 * length(frame.ray_up) * frame.pixel * inverseSqrt(climb);
}

fn from_above(direction: vec3f) -> vec4f {
    let sinking = max(-direction.y, 1e-5);
    let distance_m = frame.eye_height_m / sinking;
    let offset_m = direction * distance_m;
    let plane_m = frame.pattern_eye_m + offset_m.xz;
    let footprint_m = footprint(distance_m, sinking);
    let wind = wind(plane_m);
    let strength = wind.strength * frame.wave_steepness;
    let ray = wave_ray(frame, plane_m + wind.shift_m, -direction, frame.eye_height_m, footprint_m, strength);
    let at_m = displaced(wave_map, tiled, frame, ray, frame.water_tier);
    let place_m = ray_place(ray, at_m);
    let waves = waves_at(wave_map, tiled, place_m, frame.time_s, footprint_m, strength);
    let normal = normalize(vec3f(-waves.slope.x, 1.0, -waves.slope.y));
    let deviation = sqrt(waves.variance);
    let cosine = clamp(dot(normal, -direction), 0.0, 1.0);
    let reflectance = rough_reflectance(cosine, deviation);
    var mirrored = reflect(direction, normal);
    mirrored.y = abs(mirrored.y) + deviation * 0.5;
    var light = reflectance * sky_radiance(frame, normalize(mirrored));
    let shade = cloud_shade(frame, plane_m);
    light += glitter(frame, direction, waves.slope, waves.variance, cosine) * shade;
    let height = clamp(waves.height_m / max(CREST_M * strength, 1e-6), -1.0, 1.0);
    light += (1.0 - reflectance) * shade * crest_glow(frame, direction, height);
    let shadow = shadow_share(parallax_of(frame, frame.water_tier), waves.height_m, strength);
    let kept = dot(TROUGH_SHADOW, vec3f(1.0 / 3.0));
    light += (1.0 - reflectance) * shadow * (TROUGH_SHADOW - kept) * deep_water(frame, shade);
    let coverage = 1.0 - (1.0 - reflectance) * (1.0 - shadow * (1.0 - kept));
    let aerial = aerial_perspective(frame, direction, distance_m);
    let hazed = light * aerial.transmittance + coverage * aerial.inscattering;
    return vec4f(hazed, coverage) * sea_share(frame, direction);
}

fn from_below(direction: vec3f) -> vec3f {
    let depth_m = -frame.eye_height_m;
    if direction.y <= 0.0001 {
        return water_fog(frame, depth_m, direction);
    }
    let distance_m = depth_m / direction.y;
    let place_m = frame.pattern_eye_m + direction.xz * distance_m;
    let wind = wind(place_m);
    let strength = wind.strength * frame.wave_steepness;
    let waves = waves_at(wave_map, tiled, place_m + wind.shift_m, frame.time_s, footprint(distance_m, direction.y), strength);
    let normal = normalize(vec3f(-waves.slope.x, 1.0, -waves.slope.y));
    return fogged(frame, surface_from_below(frame, direction, normal, depth_m), distance_m, depth_m, direction);
}

const ABSORPTION = vec3f(0.42, 0.085, 0.055);

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

const CAPILLARY_VARIANCE: f32 = 0.0012;

const CHOP = WaveBand(vec2f(151.0, -83.0), 0.24, 2.6);

const CLOUD_DRIFT_M = vec2f(9.0, 4.0);

const CLOUD_HEIGHT_M: f32 = 1600.0;

const CREST_M: f32 = SWELL.crest_m + CHOP.crest_m;

const DEEPEST: f32 = 20.0;

const DEEP_WATER = vec3f(0.0028, 0.0195, 0.046);

const EARTH_RADIUS_M: f32 = 6371000.0;

const EYE_SHARE: f32 = 0.5;

const FADE_SHIFT_PX = vec2f(0.4, 1.2);

const FADE_TRAVEL_M = vec2f(32.0, 64.0);

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

const LAST_WAVE_LEVEL: f32 = 8.0;

const LOWEST_CAST: f32 = 0.1;

const NEUTRAL_PARALLAX: f32 = 0.2;

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

const RIPPLE = WaveBand(vec2f(613.0, 419.0), 0.045, 1.1);

const SHADOW_EDGE_M: f32 = 250.0;

const SHALLOW_WATER = vec3f(0.0093, 0.103, 0.11);

const SPACE_M: f32 = 10000000.0;

const SUN_RADIANCE = vec3f(4.68, 4.52, 4.36);

const SUN_RADIUS: f32 = 0.004651;

const SWELL = WaveBand(vec2f(37.0, 13.0), 0.62, 5.2);

const TANGENT_FLOOR: f32 = 0.35;

const TROUGH_SHADOW = vec3f(0.1, 0.32, 0.5);

const WATER_F0: f32 = 0.02;

const WATER_FLAT: u32 = 0u;

const WATER_INDEX: f32 = 1.333;

const WATER_MARCH: u32 = 5u;

const WATER_OFFSET: u32 = 1u;

const WAVE_MAP_SIDE: u32 = 256u;

const WRINKLE = WaveBand(vec2f(2711.0, -2039.0), 0.0065, 0.45);

const WRINKLES_SEEN_M: f32 = 0.12;

struct WaveBand {
    turn: vec2f,
    crest_m: f32,
    speed_m: f32
}

struct WaveRay {
    place_m: vec2f,
    run: vec2f,
    gain: f32,
    bias_m: f32,
    crest_m: f32,
    footprint_m: f32
}

struct Waves {
    height_m: f32,
    slope: vec2f,
    variance: f32
}

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

fn band_sample(map: texture_2d<f32>, tiled: sampler, band: WaveBand, place_m: vec2f, time_s: f32, footprint_m: f32) -> vec4f {
    let scale = length(band.turn) / PATTERN_PERIOD_M;
    let level = clamp(log2(max(footprint_m * scale * f32(WAVE_MAP_SIDE), 1.0)), 0.0, LAST_WAVE_LEVEL);
    let texel = textureSampleLevel(map, tiled, band_uv(band, place_m, time_s), level);
    let slope = vec2f(band.turn.x * texel.y - band.turn.y * texel.z, band.turn.y * texel.y + band.turn.x * texel.z);
    let per_metre = band.crest_m / PATTERN_PERIOD_M;
    return vec4f(texel.x * band.crest_m, slope * per_metre, texel.w * pow(band.crest_m * scale, 2.0));
}

fn band_uv(band: WaveBand, place_m: vec2f, time_s: f32) -> vec2f {
    let turned = vec2f(band.turn.x * place_m.x + band.turn.y * place_m.y, band.turn.x * place_m.y - band.turn.y * place_m.x);
    let scrolled = fract(time_s * band.speed_m * length(band.turn) / PATTERN_PERIOD_M);
    return turned / PATTERN_PERIOD_M - vec2f(scrolled, 0.0);
}

fn cloud_shade(frame: Frame, pattern_m: vec2f) -> f32 {
    let cast_m = frame.sun.xz * (CLOUD_HEIGHT_M / max(frame.sun.y, LOWEST_CAST));
    let place_m = drifted(frame, pattern_m + cast_m);
    let cover = covered(pattern_fbm_seen(place_m, 2048.0, 21u, SHADOW_EDGE_M), pattern_fbm_seen(place_m, 512.0, 22u, SHADOW_EDGE_M));
    let seen = 1.0 - smoothstep(0.8 * CLOUD_HEIGHT_M, CLOUD_HEIGHT_M, frame.eye_height_m);
    return 1.0 - 0.5 * cover * seen;
}

fn covered(broad: f32, puffs: f32) -> f32 {
    return smoothstep(0.5, 0.78, broad * 0.62 + puffs * 0.38);
}

fn crest_glow(frame: Frame, direction: vec3f, height: f32) -> vec3f {
    let level = dot(direction.xz, frame.sun.xz);
    let lengths = dot(direction.xz, direction.xz) * dot(frame.sun.xz, frame.sun.xz);
    let toward = max(level * inverseSqrt(lengths + 0.0001), 0.0);
    let sunward = 0.35 + 0.65 * toward * toward;
    return SHALLOW_WATER * frame.atmosphere.sun * (0.5 * smoothstep(0.16, 0.85, height) * sunward * max(frame.sun.y, 0.0));
}

fn deep_water(frame: Frame, sun: f32) -> vec3f {
    return DEEP_WATER * light_on_water(frame, sun);
}

fn displaced(map: texture_2d<f32>, tiled: sampler, frame: Frame, ray: WaveRay, tier: u32) -> f32 {
    if tier == WATER_FLAT {
        return 0.0;
    }
    if ray.gain <= 0.0 {
        return ray.bias_m;
    }
    if tier == WATER_OFFSET {
        return offset_once(map, tiled, frame, ray);
    }
    if tier == WATER_MARCH {
        return marched(map, tiled, frame, ray, march_steps(ray));
    }
    return stepped(map, tiled, frame, ray, tier, TANGENT_FLOOR);
}

fn drifted(frame: Frame, place_m: vec2f) -> vec2f {
    return place_m - CLOUD_DRIFT_M * frame.time_s;
}

fn fogged(frame: Frame, light: vec3f, path_m: f32, depth_m: f32, direction: vec3f) -> vec3f {
    return mix(water_fog(frame, depth_m, direction), light, exp(-ABSORPTION * path_m));
}

fn glitter(frame: Frame, direction: vec3f, slope: vec2f, variance: f32, cosine: f32) -> vec3f {
    let between = frame.sun - direction;
    if between.y < 0.001 || frame.sun.y <= 0.0 {
        return vec3f(0.0);
    }
    let middle = normalize(between);
    let off = middle.xz / middle.y + slope;
    let width = max(2.0 * variance, 0.0001);
    let facets = exp(-dot(off, off) / width) / (width * pow(middle.y, 4.0));
    let glint = smooth_reflectance(dot(middle, frame.sun)) * facets / (4.0 * max(cosine, 0.08));
    return frame.atmosphere.sun * (glint / (1.0 + 0.25 * glint));
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

fn march_steps(ray: WaveRay) -> u32 {
    let shortest_m = max(1.2, 2.0 * ray.footprint_m);
    return u32(clamp(8.0 * ray.crest_m * length(ray.run) / shortest_m, 8.0, 256.0));
}

fn marched(map: texture_2d<f32>, tiled: sampler, frame: Frame, ray: WaveRay, steps: u32) -> f32 {
    let step_m = 2.0 * ray.crest_m / f32(max(steps, 1u));
    var above_m = ray.crest_m;
    var under_m = -ray.crest_m;
    for (var step = 1u; step <= steps; step++) {
        let at_m = ray.crest_m - step_m * f32(step);
        if surface_on_ray(map, tiled, frame, ray, at_m).x >= at_m {
            under_m = at_m;
            break;
        }
        above_m = at_m;
    }
    for (var halving = 0u; halving < 10u; halving++) {
        let at_m = 0.5 * (above_m + under_m);
        let is_under = surface_on_ray(map, tiled, frame, ray, at_m).x >= at_m;
        above_m = select(at_m, above_m, is_under);
        under_m = select(under_m, at_m, is_under);
    }
    return 0.5 * (above_m + under_m) + ray.bias_m;
}

fn offset_once(map: texture_2d<f32>, tiled: sampler, frame: Frame, ray: WaveRay) -> f32 {
    return ray.gain * wave_height(map, tiled, ray.place_m, frame.time_s, ray.footprint_m).x + ray.bias_m;
}

fn parallax_of(frame: Frame, tier: u32) -> f32 {
    return select(frame.parallax_factor, 0.0, tier == WATER_FLAT);
}

fn pattern(position_m: vec2f, cell_m: f32, salt: u32) -> f32 {
    return pattern_gradient(position_m, cell_m, salt).x;
}

fn pattern_fbm_seen(position_m: vec2f, cell_m: f32, salt: u32, footprint_m: f32) -> f32 {
    var p = position_m;
    var size_m = cell_m;
    var sum = 0.5;
    var weight = 0.5333;
    for (var octave = 0u; octave < 4u; octave++) {
        let seen = clamp(1.5 - 1.5 * footprint_m / size_m, 0.0, 1.0);
        if seen <= 0.0 {
            break;
        }
        sum += weight * seen * (pattern(p, cell_m, salt + octave) - 0.5);
        p = vec2f(2.0 * p.x + p.y, 2.0 * p.y - p.x);
        size_m *= 0.4472136;
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

fn ray_place(ray: WaveRay, height_m: f32) -> vec2f {
    return ray.place_m + ray.run * height_m;
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 0.75 * (1.0 + cosine * cosine);
}

fn rough_reflectance(cosine: f32, deviation: f32) -> f32 {
    let grazing = pow(1.0 - cosine, 5.0 * exp(-2.69 * deviation)) / (1.0 + 22.7 * pow(deviation, 1.5));
    return WATER_F0 + (1.0 - WATER_F0) * grazing;
}

fn scaled_erfc(x: f32) -> f32 {
    const A: f32 = 2.7519384;
    return A / ((A - 1.0) * 1.7724539 * x + sqrt(3.1415927 * x * x + A * A));
}

fn sea_share(frame: Frame, direction: vec3f) -> f32 {
    let dip = sqrt(2.0 * max(frame.eye_height_m, 0.0) / EARTH_RADIUS_M);
    return smoothstep(0.96, 1.04, -direction.y / max(dip, 1e-5));
}

fn shadow_share(parallax_factor: f32, height_m: f32, strength: f32) -> f32 {
    let height = 0.5 + 0.5 * clamp(height_m / max(CREST_M * strength, 1e-6), -1.0, 1.0);
    return clamp(parallax_factor - height, 0.0, 1.0);
}

fn sky_radiance(frame: Frame, direction: vec3f) -> vec3f {
    return aerial_perspective(frame, direction, SPACE_M).inscattering;
}

fn smooth_reflectance(cosine: f32) -> f32 {
    return WATER_F0 + (1.0 - WATER_F0) * pow(1.0 - clamp(cosine, 0.0, 1.0), 5.0);
}

fn stepped(map: texture_2d<f32>, tiled: sampler, frame: Frame, ray: WaveRay, steps: u32, floor_cosine: f32) -> f32 {
    let to_eye = normalize(vec3f(ray.run.x, 1.0, ray.run.y));
    var at_m = 0.0;
    for (var step = 0u; step < steps; step++) {
        let wave = surface_on_ray(map, tiled, frame, ray, at_m);
        let normal = normalize(vec3f(-wave.y, 1.0, -wave.z));
        let along_m = (wave.x - at_m) * normal.y / max(dot(normal, to_eye), floor_cosine);
        at_m = clamp(at_m + along_m * to_eye.y, -ray.crest_m, ray.crest_m);
    }
    return at_m + ray.bias_m;
}

fn sun_disc(frame: Frame, direction: vec3f, left: vec3f) -> vec3f {
    let off = length(direction - frame.sun);
    let edge = smoothstep(0.9 * SUN_RADIUS, 1.1 * SUN_RADIUS, off);
    return SUN_RADIANCE * left * (56.0 * (1.0 - edge));
}

fn surface_from_below(frame: Frame, direction: vec3f, normal: vec3f, depth_m: f32) -> vec3f {
    let bent = refract(direction, -normal, WATER_INDEX);
    var mirrored = reflect(direction, -normal);
    mirrored.y = min(mirrored.y, 0.0);
    let inner = water_fog(frame, depth_m, mirrored);
    if dot(bent, bent) < 0.5 {
        return inner;
    }
    let above = normalize(vec3f(bent.x, max(bent.y, 0.0), bent.z) + vec3f(0.0, 0.0001, 0.0));
    let aerial = aerial_perspective(frame, above, SPACE_M);
    let sky = aerial.inscattering + sun_disc(frame, above, aerial.transmittance);
    return mix(sky, inner, smooth_reflectance(dot(bent, normal)));
}

fn surface_on_ray(map: texture_2d<f32>, tiled: sampler, frame: Frame, ray: WaveRay, at_m: f32) -> vec3f {
    return ray.gain * wave_height(map, tiled, ray_place(ray, at_m + ray.bias_m), frame.time_s, ray.footprint_m);
}

fn view_ray(frame: Frame, position: vec2f) -> vec3f {
    let ndc = position / frame.viewport * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0);
    return frame.ray_forward + ndc.x * frame.ray_right + ndc.y * frame.ray_up;
}

fn water_fog(frame: Frame, depth_m: f32, direction: vec3f) -> vec3f {
    let lightness = exp(-0.07 * depth_m) * (0.3 + 0.55 * smoothstep(-0.6, 0.9, direction.y));
    return light_on_water(frame, 1.0) * mix(DEEP_WATER, SHALLOW_WATER, lightness);
}

fn wave_height(map: texture_2d<f32>, tiled: sampler, place_m: vec2f, time_s: f32, footprint_m: f32) -> vec3f {
    let swell = band_sample(map, tiled, SWELL, place_m, time_s, footprint_m);
    return swell.xyz + band_sample(map, tiled, CHOP, place_m, time_s, footprint_m).xyz;
}

fn wave_ray(frame: Frame, place_m: vec2f, to_eye: vec3f, eye_m: f32, footprint_m: f32, strength: f32) -> WaveRay {
    let climb = max(to_eye.y, 1e-5);
    let run = to_eye.xz / climb;
    let wished = strength * frame.parallax_factor / NEUTRAL_PARALLAX;
    let bias_m = min(frame.parallax_bias_m, EYE_SHARE * eye_m);
    let low = min(1.0, EYE_SHARE * max(eye_m - bias_m, 0.0) / max(wished * CREST_M, 1e-6));
    let distance_m = eye_m / climb;
    let shift_px = wished * CREST_M * length(to_eye.xz) * frame.pixels_per_radian / max(distance_m, 0.001);
    let travel_m = 2.0 * wished * CREST_M * length(run);
    let fade = smoothstep(FADE_SHIFT_PX.x, FADE_SHIFT_PX.y, shift_px) * (1.0 - smoothstep(FADE_TRAVEL_M.x, FADE_TRAVEL_M.y, travel_m));
    let gain = wished * low * fade;
    return WaveRay(place_m, run, gain, bias_m, gain * CREST_M, footprint_m);
}

fn waves_at(map: texture_2d<f32>, tiled: sampler, place_m: vec2f, time_s: f32, footprint_m: f32, strength: f32) -> Waves {
    let swell = band_sample(map, tiled, SWELL, place_m, time_s, footprint_m);
    let chop = band_sample(map, tiled, CHOP, place_m, time_s, footprint_m);
    let ripple = band_sample(map, tiled, RIPPLE, place_m, time_s, footprint_m);
    var slope = swell.yz + chop.yz + ripple.yz;
    if footprint_m < WRINKLES_SEEN_M {
        let seen = 1.0 - footprint_m / WRINKLES_SEEN_M;
        slope += seen * band_sample(map, tiled, WRINKLE, place_m, time_s, footprint_m).yz;
    }
    let lost = swell.w - dot(swell.yz, swell.yz) + chop.w - dot(chop.yz, chop.yz) + ripple.w - dot(ripple.yz, ripple.yz);
    return Waves((swell.x + chop.x) * strength, slope * strength, CAPILLARY_VARIANCE + 0.5 * max(lost, 0.0) * strength * strength);
}
