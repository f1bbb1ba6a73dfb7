struct BrdfProbe {
    normal: vec3f,
    roughness: f32,
    to_eye: vec3f,
    f0: f32,
    to_light: vec3f,
    gap: f32
}

@group(0) @binding(0)
var<storage, read> probes: array<BrdfProbe>;

@group(0) @binding(1)
var<storage, read_write> terms: array<f32>;

@compute @workgroup_size(64)
fn probe_brdf(@builtin(global_invocation_id) invocation: vec3u) {
    if invocation.x >= arrayLength(&probes) {
        return;
    }
    let probe = probes[invocation.x];
    let angles = shading_angles(probe.normal, probe.to_eye, probe.to_light);
    let alpha = probe.roughness * probe.roughness;
    let first = 8u * invocation.x;
    terms[first] = ggx_distribution(probe.normal, angles.middle, alpha);
    terms[first + 1u] = ggx_distribution_naive(probe.normal, angles.middle, alpha);
    terms[first + 2u] = ggx_visibility_exact(angles.nl, angles.nv, alpha);
    terms[first + 3u] = ggx_visibility_fast(angles.nl, angles.nv, alpha);
    terms[first + 4u] = schlick(probe.f0, angles.lh);
    terms[first + 5u] = burley_diffuse(angles.nl, angles.nv, angles.lh, probe.roughness);
    terms[first + 6u] = specular_albedo(probe.f0, probe.roughness, angles.nv);
    terms[first + 7u] = angles.nl;
}

const TURNS: u32 = 256u;

fn timed_probe(invocation: vec3u) -> BrdfProbe {
    return probes[invocation.x % arrayLength(&probes)];
}

fn turned_angles(probe: BrdfProbe, turn: u32) -> ShadingAngles {
    let moved = probe.to_light + vec3f(0.001, 0.002, -0.001) * f32(turn);
    return shading_angles(probe.normal, probe.to_eye, moved * inverseSqrt(dot(moved, moved)));
}

fn distribution(probe: BrdfProbe, angles: ShadingAngles) -> f32 {
    return ggx_distribution(probe.normal, angles.middle, probe.roughness * probe.roughness);
}

fn distribution_naive(probe: BrdfProbe, angles: ShadingAngles) -> f32 {
    return ggx_distribution_naive(probe.normal, angles.middle, probe.roughness * probe.roughness);
}

fn exact_rest(probe: BrdfProbe, angles: ShadingAngles) -> f32 {
    return ggx_visibility_exact(angles.nl, angles.nv, probe.roughness * probe.roughness) * schlick(probe.f0, angles.lh);
}

fn fast_rest(probe: BrdfProbe, angles: ShadingAngles) -> f32 {
    return ggx_visibility_fast(angles.nl, angles.nv, probe.roughness * probe.roughness) * schlick(probe.f0, angles.lh);
}

fn keep(invocation: vec3u, sum: f32) {
    terms[invocation.x % arrayLength(&terms)] = sum;
}

@compute @workgroup_size(64)
fn time_exact(@builtin(global_invocation_id) invocation: vec3u) {
    let probe = timed_probe(invocation);
    var sum = 0.0;
    for (var turn = 0u; turn < TURNS; turn++) {
        let angles = turned_angles(probe, turn);
        sum += distribution(probe, angles) * exact_rest(probe, angles);
    }
    keep(invocation, sum);
}

@compute @workgroup_size(64)
fn time_fast(@builtin(global_invocation_id) invocation: vec3u) {
    let probe = timed_probe(invocation);
    var sum = 0.0;
    for (var turn = 0u; turn < TURNS; turn++) {
        let angles = turned_angles(probe, turn);
        sum += distribution(probe, angles) * fast_rest(probe, angles);
    }
    keep(invocation, sum);
}

@compute @workgroup_size(64)
fn time_exact_naive(@builtin(global_invocation_id) invocation: vec3u) {
    let probe = timed_probe(invocation);
    var sum = 0.0;
    for (var turn = 0u; turn < TURNS; turn++) {
        let angles = turned_angles(probe, turn);
        sum += distribution_naive(probe, angles) * exact_rest(probe, angles);
    }
    keep(invocation, sum);
}

@compute @workgroup_size(64)
fn time_fast_naive(@builtin(global_invocation_id) invocation: vec3u) {
    let probe = timed_probe(invocation);
    var sum = 0.0;
    for (var turn = 0u; turn < TURNS; turn++) {
        let angles = turned_angles(probe, turn);
        sum += distribution_naive(probe, angles) * fast_rest(probe, angles);
    }
    keep(invocation, sum);
}

const BURLEY_ENERGY: f32 = 1.0 / 1.51;

const MIN_NV: f32 = 0.0001;

struct ShadingAngles {
    nl: f32,
    nv: f32,
    lh: f32,
    middle: vec3f
}

fn burley_diffuse(nl: f32, nv: f32, lh: f32, roughness: f32) -> f32 {
    let rise = 2.0 * roughness * lh * lh - 0.5;
    let light = 1.0 + rise * fifth_power(1.0 - nl);
    let view = 1.0 + rise * fifth_power(1.0 - nv);
    return light * view * mix(1.0, BURLEY_ENERGY, roughness);
}

fn fifth_power(x: f32) -> f32 {
    let squared = x * x;
    return squared * squared * x;
}

fn ggx_distribution(normal: vec3f, middle: vec3f, alpha: f32) -> f32 {
    let aside = cross(normal, middle);
    let along = dot(normal, middle) * alpha;
    let k = alpha / (dot(aside, aside) + along * along);
    return k * k * 0.31830989;
}

fn ggx_distribution_naive(normal: vec3f, middle: vec3f, alpha: f32) -> f32 {
    let nh = clamp(dot(normal, middle), 0.0, 1.0);
    let k = alpha / max((1.0 - nh * nh) + nh * nh * alpha * alpha, 1e-20);
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

fn schlick(f0: f32, lh: f32) -> f32 {
    let f90 = clamp(50.0 * 0.33 * f0, 0.0, 1.0);
    return f0 + (f90 - f0) * fifth_power(1.0 - lh);
}

fn shading_angles(normal: vec3f, to_eye: vec3f, to_light: vec3f) -> ShadingAngles {
    let both = to_eye + to_light;
    let middle = both * inverseSqrt(max(dot(both, both), 1e-8));
    return ShadingAngles(clamp(dot(normal, to_light), 0.0, 1.0), clamp(dot(normal, to_eye), MIN_NV, 1.0), clamp(dot(to_light, middle), 0.0, 1.0), middle);
}

fn specular_albedo(f0: f32, roughness: f32, nv: f32) -> f32 {
    let r = vec4f(-1.0, -0.0275, -0.572, 0.022) * roughness + vec4f(1.0, 0.0425, 1.04, -0.04);
    let narrow = min(r.x * r.x, exp2(-9.28 * nv)) * r.x + r.y;
    let scale = -1.04 * narrow + r.z;
    let bias = 1.04 * narrow + r.w;
    return clamp(f0 * scale + bias * clamp(50.0 * f0, 0.0, 1.0), 0.0, 1.0);
}
