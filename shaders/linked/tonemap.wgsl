@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(1)
var<uniform> post: Post;

@group(0) @binding(2)
var<uniform> exposure: Exposure;

@group(0) @binding(3)
var light: texture_2d<f32>;

@group(0) @binding(4)
var bloom: texture_2d<f32>;

@group(0) @binding(5)
var filtering: sampler;

fn graded(pixel: vec2u) -> vec4f {
    var linear = textureLoad(light, pixel, 0).rgb;
    if !is_finite(linear * frame.exposure) {
        return INVALID;
    }
    if post.bloom > 0.0 {
        let uv = (vec2f(pixel) + 0.5) / vec2f(textureDimensions(light));
        let texel = 1.0 / vec2f(textureDimensions(bloom));
        linear = mix(linear, tent(bloom, filtering, uv, texel), post.bloom);
    }
    linear *= frame.exposure;
    if post.auto_exposure == 1u {
        linear *= exposure.factor;
    }
    return vec4f(srgb_encoded(tone_curve(linear, post.tone)), 1.0);
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_corner(index);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position.xy);
    return dithered(graded(pixel), pixel);
}

@fragment
fn fragment_graded(@builtin(position) position: vec4f) -> @location(0) vec4f {
    return graded(vec2u(position.xy));
}

const AGX_BRIGHTEST: f32 = 4.026069;

const AGX_DARKEST: f32 = -12.47393;

const AGX_GAIN: f32 = 2.5;

const AGX_INSET = mat3x3f(vec3f(0.842479062, 0.042328242, 0.042375655), vec3f(0.0784336, 0.878468637, 0.0784336), vec3f(0.079223745, 0.079166127, 0.879142974));

const AGX_OUTSET = mat3x3f(vec3f(1.196879005, -0.052896852, -0.052971636), vec3f(-0.098020881, 1.15190313, -0.09804345), vec3f(-0.099029744, -0.098961177, 1.151073673));

const AGX_POWER: f32 = 1.35;

const AGX_SATURATION: f32 = 1.4;

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

const BLEACHED: f32 = 12.0;

const BRIGHTEST: f32 = 10000.0;

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

const HUE_KEPT: f32 = 0.4;

const INVALID = vec4f(1.0, 0.0, 1.0, 0.0);

const NEUTRAL_BLEACH: f32 = 0.15;

const NEUTRAL_FRESNEL: f32 = 0.04;

const NEUTRAL_SHOULDER: f32 = 0.8 - NEUTRAL_FRESNEL;

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

const TONE_AGX: u32 = 2u;

const TONE_NEUTRAL: u32 = 1u;

fn agx_tone(light: vec3f) -> vec3f {
    let stops = log2(max(AGX_INSET * light * AGX_GAIN, vec3f(1e-10)));
    let x = clamp((stops - AGX_DARKEST) / (AGX_BRIGHTEST - AGX_DARKEST), vec3f(0.0), vec3f(1.0));
    let x2 = x * x;
    let x4 = x2 * x2;
    let sigmoid = 15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.00232;
    let looked = pow(max(sigmoid, vec3f(0.0)), vec3f(AGX_POWER));
    let saturated = mix(vec3f(luminance(looked)), looked, AGX_SATURATION);
    return pow(max(AGX_OUTSET * saturated, vec3f(0.0)), vec3f(2.2));
}

fn covering_corner(index: u32) -> vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

fn dithered(colour: vec4f, pixel: vec2u) -> vec4f {
    if colour.a < 1.0 {
        return vec4f(INVALID.rgb, 1.0);
    }
    let dither = (f32(pattern_hash(pixel.x, pixel.y) >> 8u) / 16777216.0 - 0.5) / 255.0;
    return vec4f(colour.rgb + dither, 1.0);
}

fn filmic(light: vec3f) -> vec3f {
    let x = light;
    return clamp((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14), vec3f(0.0), vec3f(1.0));
}

fn filmic_tone(x: vec3f) -> vec3f {
    let peak = max(max(x.x, x.y), max(x.z, 1e-6));
    let kept = x / peak * filmic(vec3f(peak));
    return mix(filmic(x), kept, HUE_KEPT / (1.0 + peak / BLEACHED));
}

fn is_finite(value: vec3f) -> bool {
    return all((bitcast<vec3u>(value) & vec3u(2139095040u)) != vec3u(2139095040u));
}

fn luminance(light: vec3f) -> f32 {
    return dot(light, vec3f(0.2126, 0.7152, 0.0722));
}

fn neutral_tone(light: vec3f) -> vec3f {
    let least = min(light.x, min(light.y, light.z));
    let toe = least - least * least / (4.0 * NEUTRAL_FRESNEL);
    let x = light - select(NEUTRAL_FRESNEL, toe, least < 2.0 * NEUTRAL_FRESNEL);
    let peak = max(x.x, max(x.y, x.z));
    if peak < NEUTRAL_SHOULDER {
        return x;
    }
    let rest = 1.0 - NEUTRAL_SHOULDER;
    let end = 1.0 - rest * rest / (peak + rest - NEUTRAL_SHOULDER);
    let kept = x * (end / peak);
    return mix(vec3f(end), kept, 1.0 / (NEUTRAL_BLEACH * (peak - end) + 1.0));
}

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = (x * 1664525u + y * 22695477u + 1013904223u) * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn srgb_encoded(linear: vec3f) -> vec3f {
    let low = linear * 12.92;
    let high = 1.055 * pow(max(linear, vec3f(0.0)), vec3f(1.0 / 2.4)) - 0.055;
    return select(high, low, linear <= vec3f(0.0031308));
}

fn tent(image: texture_2d<f32>, filtering: sampler, uv: vec2f, texel: vec2f) -> vec3f {
    var sum = vec3f(0.0);
    for (var index = 0; index < 9; index++) {
        let at = vec2f(f32(index % 3 - 1), f32(index / 3 - 1));
        let weight = (2.0 - abs(at.x)) * (2.0 - abs(at.y)) / 16.0;
        sum += weight * textureSampleLevel(image, filtering, uv + at * texel, 0.0).rgb;
    }
    return sum;
}

fn tone_curve(light: vec3f, tone: u32) -> vec3f {
    let x = clamp(light, vec3f(0.0), vec3f(BRIGHTEST));
    var mapped: vec3f;
    switch tone {
        case TONE_NEUTRAL {
            mapped = neutral_tone(x);
        }
        case TONE_AGX {
            mapped = agx_tone(x);
        }
        case default {
            mapped = filmic_tone(x);
        }
    }
    return clamp(mapped, vec3f(0.0), vec3f(1.0));
}
