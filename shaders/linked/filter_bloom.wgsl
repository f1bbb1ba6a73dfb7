@group(0) @binding(0)
var source: texture_2d<f32>;

@group(0) @binding(1)
var filtering: sampler;

struct Varying {
    @builtin(position)
    position: vec4f,
    @location(0)
    uv: vec2f
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Varying {
    let corner = covering_corner(index);
    return Varying(corner, vec2f(0.5 + 0.5 * corner.x, 0.5 - 0.5 * corner.y));
}

fn tap(uv: vec2f) -> vec4f {
    let value = textureSampleLevel(source, filtering, uv, 0.0).rgb;
    return select(vec4f(0.0), vec4f(value, 1.0), is_finite(value));
}

fn box(a: vec4f, b: vec4f, c: vec4f, d: vec4f, share: f32, is_first: bool) -> vec4f {
    let sum = a + b + c + d;
    let mean = sum.rgb / max(sum.a, 1.0);
    let bright = select(0.0, luminance(max(mean, vec3f(0.0))), is_first);
    let weight = share * sum.a * 0.25 / (1.0 + bright);
    return vec4f(mean * weight, weight);
}

fn downsampled(uv: vec2f, is_first: bool) -> vec3f {
    let texel = 1.0 / vec2f(textureDimensions(source));
    var outer: array<vec4f, 9>;
    for (var index = 0; index < 9; index++) {
        outer[index] = tap(uv + 2.0 * vec2f(f32(index % 3 - 1), f32(index / 3 - 1)) * texel);
    }
    var inner: array<vec4f, 4>;
    for (var index = 0; index < 4; index++) {
        inner[index] = tap(uv + vec2f(f32(2 * (index % 2) - 1), f32(2 * (index / 2) - 1)) * texel);
    }
    var sum = box(inner[0], inner[1], inner[2], inner[3], 0.5, is_first);
    sum += box(outer[0], outer[1], outer[3], outer[4], 0.125, is_first);
    sum += box(outer[1], outer[2], outer[4], outer[5], 0.125, is_first);
    sum += box(outer[3], outer[4], outer[6], outer[7], 0.125, is_first);
    sum += box(outer[4], outer[5], outer[7], outer[8], 0.125, is_first);
    return sum.rgb / max(sum.a, 1e-12);
}

@fragment
fn fragment_first(in: Varying) -> @location(0) vec4f {
    return vec4f(downsampled(in.uv, true), 1.0);
}

@fragment
fn fragment_down(in: Varying) -> @location(0) vec4f {
    return vec4f(downsampled(in.uv, false), 1.0);
}

@fragment
fn fragment_up(in: Varying) -> @location(0) vec4f {
    return vec4f(tent(source, filtering, in.uv, 1.0 / vec2f(textureDimensions(source))), 1.0);
}

fn covering_corner(index: u32) -> vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

fn is_finite(value: vec3f) -> bool {
    return all((bitcast<vec3u>(value) & vec3u(2139095040u)) != vec3u(2139095040u));
}

fn luminance(light: vec3f) -> f32 {
    return dot(light, vec3f(0.2126, 0.7152, 0.0722));
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
