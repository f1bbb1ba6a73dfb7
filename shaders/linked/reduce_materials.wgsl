@group(0) @binding(0)
var colours: texture_2d_array<f32>;

@group(0) @binding(1)
var shapes: texture_2d_array<f32>;

@group(0) @binding(2)
var heights: texture_2d_array<f32>;

@group(0) @binding(3)
var colours_below: texture_storage_2d_array<rgba16float, write>;

@group(0) @binding(4)
var shapes_below: texture_storage_2d_array<rgba8unorm, write>;

@group(0) @binding(5)
var heights_below: texture_storage_2d_array<r32float, write>;

@compute @workgroup_size(8, 8)
fn reduce(@builtin(global_invocation_id) id: vec3u) {
    let size = textureDimensions(colours_below);
    if id.x >= size.x || id.y >= size.y {
        return;
    }
    var colour = vec4f(0.0);
    var height = 0.0;
    var normal = vec3f(0.0);
    var alpha2 = 0.0;
    var occlusion = 0.0;
    for (var index = 0u; index < 4u; index++) {
        let at = 2u * id.xy + vec2u(index & 1u, index >> 1u);
        colour += textureLoad(colours, at, id.z, 0) * 0.25;
        height += textureLoad(heights, at, id.z, 0).x * 0.25;
        let shape = textureLoad(shapes, at, id.z, 0);
        let level = (shape.xy * 255.0 - 128.0) / 127.0;
        normal += vec3f(level, sqrt(max(1.0 - dot(level, level), 0.0))) * 0.25;
        alpha2 += shape.z * shape.z * shape.z * shape.z * 0.25;
        occlusion += shape.w * 0.25;
    }
    let kept = clamp(length(normal), 0.05, 1.0);
    let rough = min(alpha2 + 2.0 * (1.0 - kept) / kept, 1.0);
    textureStore(colours_below, id.xy, id.z, colour);
    textureStore(shapes_below, id.xy, id.z, vec4f((normal.xy / kept * 127.0 + 128.0) / 255.0, sqrt(sqrt(rough)), occlusion));
    textureStore(heights_below, id.xy, id.z, vec4f(height));
}
