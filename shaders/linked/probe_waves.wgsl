struct WaveProbe {
    place_m: vec2f,
    footprint_m: f32,
    strength: f32,
    to_eye: vec3f,
    eye_m: f32,
    method: u32,
    steps: u32,
    floor_cosine: f32,
    reserved: u32
}

const PROBE_STEPPED: u32 = 6u;

const PROBE_MARCHED: u32 = 7u;

const PROBE_FIXED: u32 = 8u;

@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(1)
var wave_map: texture_2d<f32>;

@group(0) @binding(2)
var tiled: sampler;

@group(0) @binding(3)
var<storage, read> probes: array<WaveProbe>;

@group(0) @binding(4)
var<storage, read_write> found: array<vec4f>;

@compute @workgroup_size(64)
fn probe_waves(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&probes) {
        return;
    }
    let probe = probes[id.x];
    let ray = wave_ray(frame, probe.place_m, probe.to_eye, probe.eye_m, probe.footprint_m, probe.strength);
    var at_m = 0.0;
    var place_m = ray.place_m;
    if probe.method == PROBE_FIXED {
        let raw_m = wave_height(wave_map, tiled, ray.place_m, frame.time_s, ray.footprint_m).x;
        place_m -= fixed_view_offset(0.5 + 0.5 * raw_m / CREST_M, frame.parallax_factor) * FIXED_UNIT_M * probe.strength;
    }
    else {
        if probe.method == PROBE_STEPPED {
            at_m = stepped(wave_map, tiled, frame, ray, probe.steps, probe.floor_cosine);
        }
        else if probe.method == PROBE_MARCHED {
            at_m = marched(wave_map, tiled, frame, ray, probe.steps);
        }
        else {
            at_m = displaced(wave_map, tiled, frame, ray, probe.method);
        }
        place_m = ray_place(ray, at_m);
    }
    let waves = waves_at(wave_map, tiled, place_m, frame.time_s, ray.footprint_m, probe.strength);
    let surface_m = select(waves.height_m / max(probe.strength, 1e-6) * ray.gain + ray.bias_m, at_m, ray.gain <= 0.0);
    found[id.x] = vec4f(place_m, at_m, surface_m - at_m + 1e-9 * (waves.slope.x + waves.slope.y + waves.variance));
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

const CREST_M: f32 = SWELL.crest_m + CHOP.crest_m;

const EYE_SHARE: f32 = 0.5;

const FADE_SHIFT_PX = vec2f(0.4, 1.2);

const FADE_TRAVEL_M = vec2f(32.0, 64.0);

const FIXED_RAISE: f32 = 0.2;

const FIXED_UNIT_M: f32 = 10.0 * CREST_M;

const FIXED_VIEW = vec3f(0.0, -0.707, 0.707);

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

const LAST_WAVE_LEVEL: f32 = 8.0;

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

const RIPPLE = WaveBand(vec2f(613.0, 419.0), 0.045, 1.1);

const SWELL = WaveBand(vec2f(37.0, 13.0), 0.62, 5.2);

const TANGENT_FLOOR: f32 = 0.35;

const WATER_FLAT: u32 = 0u;

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

fn fixed_view_offset(height: f32, parallax_factor: f32) -> vec2f {
    return FIXED_VIEW.xy / FIXED_VIEW.z * height * parallax_factor + FIXED_RAISE;
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

fn ray_place(ray: WaveRay, height_m: f32) -> vec2f {
    return ray.place_m + ray.run * height_m;
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

fn surface_on_ray(map: texture_2d<f32>, tiled: sampler, frame: Frame, ray: WaveRay, at_m: f32) -> vec3f {
    return ray.gain * wave_height(map, tiled, ray_place(ray, at_m + ray.bias_m), frame.time_s, ray.footprint_m);
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
