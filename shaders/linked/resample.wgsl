@group(0) @binding(0)
var<uniform> post: Post;

@group(0) @binding(1)
var colours: texture_2d<f32>;

@group(0) @binding(2)
var filtering: sampler;

const SHARPEST: f32 = 0.2;

fn at(place: vec2i) -> vec4f {
    let last = vec2i(textureDimensions(colours)) - 1;
    return textureLoad(colours, clamp(place, vec2i(0), last), 0);
}

fn sharpened(place: vec2i) -> vec4f {
    let centre = at(place);
    if post.sharpen <= 0.0 {
        return centre;
    }
    let north = at(place - vec2i(0, 1));
    let south = at(place + vec2i(0, 1));
    let west = at(place - vec2i(1, 0));
    let east = at(place + vec2i(1, 0));
    let valid = min(min(min(north.a, south.a), min(west.a, east.a)), centre.a);
    if valid < 1.0 {
        return centre;
    }
    let lowest = min(min(min(north, south), min(west, east)), centre).rgb;
    let highest = max(max(max(north, south), max(west, east)), centre).rgb;
    let room = min(lowest, 1.0 - highest) / max(highest, vec3f(0.0001));
    let weight = -SHARPEST * post.sharpen * sqrt(clamp(room, vec3f(0.0), vec3f(1.0)));
    let sum = (north + south + west + east).rgb;
    let result = (centre.rgb + weight * sum) / (1.0 + 4.0 * weight);
    return vec4f(clamp(result, vec3f(0.0), vec3f(1.0)), 1.0);
}

fn resampled(pixel: vec2u) -> vec4f {
    let middle = (vec2f(pixel) + 0.5) * post.scale;
    if all(post.scale == vec2f(1.0)) {
        return sharpened(vec2i(pixel));
    }
    let half_width = max(post.scale, vec2f(1.0));
    let first = vec2i(floor(middle - half_width + 0.5));
    let end = vec2i(ceil(middle + half_width - 0.5));
    var sum = vec3f(0.0);
    var weights = 0.0;
    for (var y = first.y; y < end.y; y++) {
        for (var x = first.x; x < end.x; x++) {
            let place = vec2i(x, y);
            let off = abs(vec2f(place) + 0.5 - middle) / half_width;
            let weight = max(1.0 - off.x, 0.0) * max(1.0 - off.y, 0.0);
            let colour = sharpened(place);
            if weight > 0.0 && colour.a < 1.0 {
                return INVALID;
            }
            sum += weight * colour.rgb;
            weights += weight;
        }
    }
    return vec4f(sum / weights, 1.0);
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_corner(index);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position.xy);
    return dithered(resampled(pixel), pixel);
}

@fragment
fn fragment_enlarged(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let place = position.xy * post.scale / vec2f(textureDimensions(colours));
    return dithered(textureSampleLevel(colours, filtering, place, 0.0), vec2u(position.xy));
}

const INVALID = vec4f(1.0, 0.0, 1.0, 0.0);

struct Post {
    tone: u32,
    auto_exposure: u32,
    bloom: f32,
    sharpen: f32,
    meter: f32,
    adaptation: f32,
    scale: vec2f
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

fn pattern_hash(x: u32, y: u32) -> u32 {
    let state = (x * 1664525u + y * 22695477u + 1013904223u) * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}
