@group(0) @binding(0)
var colours: texture_2d<f32>;

@group(0) @binding(1)
var filtering: sampler;

const CONTRAST: f32 = 0.0312;

const CONTRAST_SHARE: f32 = 0.125;

const SUBPIXEL: f32 = 0.5;

const STEPS: u32 = 10u;

const STEP_PX = array<f32, STEPS>(1.0, 1.0, 1.0, 1.0, 1.5, 2.0, 2.0, 2.0, 4.0, 8.0);

fn luma(colour: vec3f) -> f32 {
    return dot(colour, vec3f(0.299, 0.587, 0.114));
}

fn luma_between(position: vec2f, pixel: vec2f) -> f32 {
    return luma(textureSampleLevel(colours, filtering, position * pixel, 0.0).rgb);
}

struct End {
    distance_px: f32,
    difference: f32
}

fn edge_end(start: vec2f, along: vec2f, pixel: vec2f, middle: f32, limit: f32) -> End {
    var end = End(0.0, 0.0);
    for (var index = 0u; index < STEPS; index++) {
        end.distance_px += STEP_PX[index];
        end.difference = luma_between(start + along * end.distance_px, pixel) - middle;
        if abs(end.difference) >= limit {
            break;
        }
    }
    return end;
}

fn antialiased(place: vec2u) -> vec4f {
    let size = textureDimensions(colours);
    let last = vec2i(size) - 1;
    let pixel = 1.0 / vec2f(size);
    var near: array<f32, 9>;
    var valid = 1.0;
    for (var index = 0; index < 9; index++) {
        let at = clamp(vec2i(place) + vec2i(index % 3 - 1, index / 3 - 1), vec2i(0), last);
        let colour = textureLoad(colours, at, 0);
        near[index] = luma(colour.rgb);
        valid = min(valid, colour.a);
    }
    let centre = textureLoad(colours, place, 0);
    let north = near[1];
    let west = near[3];
    let east = near[5];
    let south = near[7];
    let highest = max(max(max(north, south), max(west, east)), near[4]);
    let lowest = min(min(min(north, south), min(west, east)), near[4]);
    let contrast = highest - lowest;
    if valid < 1.0 || contrast < max(CONTRAST, highest * CONTRAST_SHARE) {
        return centre;
    }
    let horizontal = abs(near[0] - 2.0 * west + near[6]) + 2.0 * abs(north - 2.0 * near[4] + south) + abs(near[2] - 2.0 * east + near[8]);
    let vertical = abs(near[0] - 2.0 * north + near[2]) + 2.0 * abs(west - 2.0 * near[4] + east) + abs(near[6] - 2.0 * south + near[8]);
    let is_horizontal = horizontal >= vertical;
    let before = select(west, north, is_horizontal);
    let after = select(east, south, is_horizontal);
    let is_before = abs(before - near[4]) >= abs(after - near[4]);
    let side = select(1.0, -1.0, is_before);
    let across = side * select(vec2f(1.0, 0.0), vec2f(0.0, 1.0), is_horizontal);
    let along = abs(across.yx);
    let other = select(after, before, is_before);
    let position = vec2f(place) + 0.5;
    let middle = 0.5 * (near[4] + other);
    let limit = 0.25 * abs(other - near[4]);
    let start = position + 0.5 * across;
    let behind = edge_end(start, -along, pixel, middle, limit);
    let ahead = edge_end(start, along, pixel, middle, limit);
    let is_behind = behind.distance_px < ahead.distance_px;
    let nearest_px = min(behind.distance_px, ahead.distance_px);
    let difference = select(ahead.difference, behind.difference, is_behind);
    let is_stepping = (difference < 0.0) != (near[4] - middle < 0.0);
    let length_px = behind.distance_px + ahead.distance_px;
    let edge_shift = select(0.0, 0.5 - nearest_px / length_px, is_stepping);
    let mean = (2.0 * (north + south + west + east) + near[0] + near[2] + near[6] + near[8]) / 12.0;
    let lone = smoothstep(0.0, 1.0, clamp(abs(mean - near[4]) / contrast, 0.0, 1.0));
    let shift = max(edge_shift, lone * lone * SUBPIXEL);
    let moved = textureSampleLevel(colours, filtering, (position + shift * across) * pixel, 0.0);
    return vec4f(moved.rgb, centre.a);
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return covering_corner(index);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let pixel = vec2u(position.xy);
    return dithered(antialiased(pixel), pixel);
}

@fragment
fn fragment_graded(@builtin(position) position: vec4f) -> @location(0) vec4f {
    return antialiased(vec2u(position.xy));
}

const INVALID = vec4f(1.0, 0.0, 1.0, 0.0);

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
