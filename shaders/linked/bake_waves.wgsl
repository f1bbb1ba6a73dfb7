@group(0) @binding(0)
var baked: texture_storage_2d<rgba16float, write>;

@group(0) @binding(1)
var finer: texture_2d<f32>;

const TAU: f32 = 6.2831853;

const TRAINS: u32 = 56u;

const LONGEST: f32 = 4.0;

const RANGE: f32 = 10.0;

const SHARPNESS: f32 = 0.9;

const CUT: f32 = 3.3;

fn share(index: u32, salt: u32) -> f32 {
    return f32(pattern_hash(index, salt) >> 8u) / 16777216.0;
}

@compute @workgroup_size(8, 8)
fn bake_waves(@builtin(global_invocation_id) texel: vec3u) {
    if any(texel.xy >= vec2u(WAVE_MAP_SIDE)) {
        return;
    }
    let uv = (vec2f(texel.xy) + 0.5) / f32(WAVE_MAP_SIDE);
    var sum = vec3f(0.0);
    var power = 0.0;
    for (var train = 0u; train < TRAINS; train++) {
        let count = LONGEST * pow(RANGE, (f32(train) + share(train, 1u)) / f32(TRAINS));
        let aside = (share(train, 2u) + share(train, 3u) - 1.0) * mix(0.9, 1.9, f32(train) / f32(TRAINS));
        let waves = round(count * vec2f(cos(aside), sin(aside)));
        let amplitude = pow(count, -1.3);
        let phase = TAU * (dot(waves, uv) + share(train, 4u));
        let crest = exp(SHARPNESS * sin(phase));
        sum += amplitude * vec3f(crest - 1.213, TAU * waves * (SHARPNESS * cos(phase) * crest));
        power += amplitude * amplitude * 0.5183;
    }
    let wave = sum / (CUT * sqrt(power));
    let slope = select(vec2f(0.0), wave.yz, abs(wave.x) < 1.0);
    textureStore(baked, texel.xy, vec4f(clamp(wave.x, -1.0, 1.0), slope, dot(slope, slope)));
}

@compute @workgroup_size(8, 8)
fn reduce_waves(@builtin(global_invocation_id) texel: vec3u) {
    if any(texel.xy >= textureDimensions(baked)) {
        return;
    }
    let low = texel.xy * 2u;
    let sum = textureLoad(finer, low, 0) + textureLoad(finer, low + vec2u(1u, 0u), 0) + textureLoad(finer, low + vec2u(0u, 1u), 0) + textureLoad(finer, low + vec2u(1u, 1u), 0);
    textureStore(baked, texel.xy, 0.25 * sum);
}

const WAVE_MAP_SIDE: u32 = 256u;

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = (x * 1664525u + y * 22695477u + 1013904223u) * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}
