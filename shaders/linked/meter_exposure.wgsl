@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(1)
var<uniform> post: Post;

@group(0) @binding(2)
var light: texture_2d<f32>;

@group(0) @binding(3)
var<storage, read_write> sums: array<vec2f, GROUPS>;

@group(0) @binding(4)
var<storage, read_write> exposure: Exposure;

const GROUPS: u32 = 64u;

const INVOCATIONS: u32 = 256u;

const DARKEST: f32 = -8.0;

const BRIGHTEST: f32 = 3.0;

const MIDDLE: f32 = -2.0;

const COMPENSATION: f32 = 0.5;

const LIMIT: f32 = 1.5;

const CORNER: f32 = 0.4;

var<workgroup> parts: array<vec2f, INVOCATIONS>;

fn summed(index: u32, count: u32) -> vec2f {
    for (var half = count / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if index < half {
            parts[index] += parts[index + half];
        }
    }
    workgroupBarrier();
    return parts[0];
}

@compute @workgroup_size(INVOCATIONS)
fn meter_light(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) index: u32) {
    let size = textureDimensions(light);
    let count = size.x * size.y;
    var sum = vec2f(0.0);
    for (var at = group.x * INVOCATIONS + index; at < count; at += GROUPS * INVOCATIONS) {
        let pixel = vec2u(at % size.x, at / size.x);
        let linear = textureLoad(light, pixel, 0).rgb * (frame.exposure * post.meter);
        if is_finite(linear) {
            let stops = log2(max(luminance(linear), 1e-6));
            let from_middle = (vec2f(pixel) + 0.5) / vec2f(size) * 2.0 - 1.0;
            let weight = mix(1.0, CORNER, 0.5 * dot(from_middle, from_middle));
            sum += weight * vec2f(clamp(stops, DARKEST, BRIGHTEST), 1.0);
        }
    }
    parts[index] = sum;
    let total = summed(index, INVOCATIONS);
    if index == 0u {
        sums[group.x] = total;
    }
}

@compute @workgroup_size(GROUPS)
fn adapt_exposure(@builtin(local_invocation_index) index: u32) {
    parts[index] = sums[index];
    let total = summed(index, GROUPS);
    if index != 0u {
        return;
    }
    let mean = select(MIDDLE, total.x / max(total.y, 1e-6), total.y > 0.0);
    let wanted = clamp(COMPENSATION * (MIDDLE - mean), -LIMIT, LIMIT);
    let share = select(1.0, post.adaptation, exposure.is_set == 1u);
    let ev = mix(exposure.ev, wanted, share);
    exposure = Exposure(ev, exp2(ev), 1u, 0u);
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

struct Exposure {
    ev: f32,
    factor: f32,
    is_set: u32,
    reserved: u32
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

struct Post {
    tone: u32,
    auto_exposure: u32,
    bloom: f32,
    sharpen: f32,
    meter: f32,
    adaptation: f32,
    scale: vec2f
}

fn is_finite(value: vec3f) -> bool {
    return all((bitcast<vec3u>(value) & vec3u(2139095040u)) != vec3u(2139095040u));
}

fn luminance(light: vec3f) -> f32 {
    return dot(light, vec3f(0.2126, 0.7152, 0.0722));
}
