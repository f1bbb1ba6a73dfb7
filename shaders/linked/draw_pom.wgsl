@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(1)
var<storage, read> objects: array<PomObject>;

@group(0) @binding(2)
var heights: texture_2d_array<f32>;

@group(0) @binding(3)
var smooth_heights: texture_2d_array<f32>;

@group(0) @binding(4)
var max_mips: texture_2d_array<f32>;

@group(0) @binding(5)
var cones: texture_2d_array<f32>;

@group(0) @binding(6)
var tiled: sampler;

@group(1) @binding(0)
var colours: texture_2d_array<f32>;

@group(1) @binding(1)
var shapes: texture_2d_array<f32>;

@group(1) @binding(2)
var material_sampler: sampler;

struct Vertex {
    @location(0)
    place: vec4f,
    @location(1)
    normal: vec4f,
    @location(2)
    tangent: vec4f,
    @location(3)
    uv: vec2f
}

fn pom_params_of(object: PomObject) -> PomParams {
    var pom = frame.pom;
    if object.mode == MODE_FLAT || object.mode == MODE_PLAIN {
        pom.tier = POM_FLAT;
    }
    else if object.mode == MODE_OFFSET {
        pom.tier = POM_OFFSET;
    }
    else if pom.tier == POM_CONES && textureDimensions(cones).x == 1u {
        pom.tier = POM_MAX_MIP;
    }
    return pom;
}

@vertex
fn vertex(vertex: Vertex, @builtin(instance_index) index: u32) -> ObjectFragment {
    let object = objects[index];
    let pom = pom_params_of(object);
    let uv = vertex.uv * object.repeats;
    let is_wall = any(vec2f(vertex.normal.w, vertex.tangent.w) != vec2f(0.0));
    var height = pom.pivot;
    if object.mode == MODE_GEOMETRY {
        let side = textureDimensions(heights).x;
        let map = PomMap(object.layer, side, geometry_lod(object, side));
        height = select(pom_height(heights, smooth_heights, tiled, map, uv, true), 0.0, vertex.place.w < 0.0);
    }
    else if silhouette_of(object, pom) == SILHOUETTE_SHELL {
        height = select(1.0, 0.0, vertex.place.w < 0.0);
    }
    let lift_m = (height - pom.pivot) * object.relief_m * pom.amplitude;
    let outward = select(vertex.normal.xyz, sign(vertex.place.xyz), object.shape == SHAPE_CUBE);
    let local_m = vertex.place.xyz + outward * lift_m;
    let relative_m = object.origin_m + to_world(object, local_m);
    return ObjectFragment(frame.clip_from_camera * vec4f(relative_m, 1.0), relative_m, uv, height, select(vec2f(0.0), vec2f(vertex.normal.w, vertex.tangent.w), is_wall), local_m, vertex.normal.xyz, vertex.tangent.xyz, index);
}

fn objects_sun_share(at_m: vec3f, own: u32) -> f32 {
    var share = 1.0;
    for (var index = 0u; index < arrayLength(&objects); index++) {
        if index != own {
            share = min(share, object_sun_share(objects[index], at_m, frame.sun));
        }
    }
    return share;
}

struct Drawn {
    light: vec3f,
    relative_m: vec3f,
    is_hit: bool
}

const STRETCH: f32 = 8.0;

fn drawn(fragment: ObjectFragment, footprint: Footprint) -> Drawn {
    let object = objects[fragment.index];
    let pom = pom_params_of(object);
    let gaze = normalize(fragment.relative_m);
    let to_eye = to_eye_of(fragment, object);
    if object.mode == MODE_PLAIN {
        return plain(fragment, object, footprint);
    }
    let long = max(length(footprint.ddx), length(footprint.ddy));
    let short = min(length(footprint.ddx), length(footprint.ddy));
    let side = textureDimensions(heights).x;
    let map = PomMap(object.layer, side, pom_lod(side, max(short, long / STRETCH)));
    let silhouette = silhouette_of(object, pom);
    let stretch = stretch_of(object, normalize(fragment.normal));
    let amplitude = object.relief_m * pom.amplitude / object.tile_m.x;
    var ray = pom_ray(undisplaced(fragment, object, pom, to_eye), to_eye, amplitude);
    ray.travel *= stretch;
    var found: PomSurfaceHit;
    var exact_uv = vec2f(0.0);
    let is_geometry = object.mode == MODE_GEOMETRY;
    let rounds = select(1u, 2u, frame.show == SHOW_ERROR);
    for (var round = 0u; round < rounds; round++) {
        var how = pom;
        how.tier = select(pom.tier, POM_MAX_MIP, round == 1u);
        var here: PomSurfaceHit;
        if is_geometry && round == 0u {
            let is_cut = any(fragment.side != vec2f(0.0));
            let bitangent = cross(fragment.normal, fragment.tangent);
            let outward = fragment.tangent * fragment.side.x + bitangent * fragment.side.y;
            here = PomSurfaceHit(fragment.uv, fragment.height, fragment.relative_m, select(fragment.normal, outward, is_cut), fragment.tangent, true, is_cut, 0u);
        }
        else if silhouette == SILHOUETTE_SHELL && object.shape != SHAPE_PLANE {
            here = intersect_shell(heights, smooth_heights, tiled, object, how, map, fragment, gaze);
        }
        else if silhouette == SILHOUETTE_SHELL && to_eye.z <= 1e-5 {
            here = intersect_from_side(heights, smooth_heights, max_mips, tiled, object, how, map, fragment, to_eye, gaze);
        }
        else {
            here = intersect_plane(heights, smooth_heights, max_mips, cones, tiled, object, how, silhouette, map, fragment, ray, to_eye, gaze);
        }
        if round == 0u {
            found = here;
        }
        exact_uv = here.uv;
    }
    let horizon = select(pom.horizon, OWN_HORIZON, pom.silhouette == SILHOUETTE_NONE);
    if silhouette == SILHOUETTE_HORIZON && is_eroded(horizon, max(to_eye.z, 0.0), found.height) {
        found.is_hit = false;
    }
    if !found.is_hit {
        return Drawn(vec3f(0.0), found.relative_m, false);
    }
    let colour = textureSampleGrad(colours, material_sampler, found.uv, object.layer, footprint.ddx, footprint.ddy);
    let shape = textureSampleGrad(shapes, material_sampler, found.uv, object.layer, footprint.ddx, footprint.ddy);
    let normal = normalize(found.normal);
    let tangent = normalize(found.tangent);
    let bitangent = cross(normal, tangent);
    var bent = normal;
    if !found.is_cut {
        let level = (shape.xy * 255.0 - 128.0) / 127.0;
        let steepness = object.relief_m / object.tile_m * material_sets[object.layer].tile_m / material_sets[object.layer].relief_m;
        let slope = level * steepness;
        bent = tangent * slope.x + bitangent * slope.y + normal * sqrt(max(1.0 - dot(level, level), 0.03));
    }
    let world_normal = normalize(to_world(object, bent));
    if frame.show != SHOW_PICTURE {
        let travel = texel_travel(map, ray);
        let tier = pom_tier(pom, travel);
        let surface = pom_height(heights, smooth_heights, tiled, map, found.uv, true);
        let is_false = !is_geometry && !found.is_cut && tier >= POM_LINEAR && abs(surface - found.height) > 1.0 / 1024.0;
        let error = select(length(found.uv - exact_uv) * f32(map.side >> map.lod), 0.0, found.is_cut);
        let light = inspected_pom(frame.show, object, world_normal, error, is_false, tier, found.fetches, fragment, footprint.mesh);
        return Drawn(light, found.relative_m, true);
    }
    var sun = objects_sun_share(found.relative_m, fragment.index);
    if !found.is_cut && sun > 0.0 && pom.tier != POM_FLAT {
        let to_sun = to_object(object, frame.sun);
        let sun_on = vec3f(vec2f(dot(to_sun, tangent), dot(to_sun, bitangent)) * stretch_of(object, normal), dot(to_sun, normal));
        var height = found.height;
        if is_geometry || pom_tier(pom, texel_travel(map, ray)) == POM_OFFSET {
            height = pom_height(heights, smooth_heights, tiled, map, found.uv, true);
        }
        sun *= pom_sun(heights, smooth_heights, max_mips, tiled, pom, map, found.uv, height, sun_on, amplitude);
    }
    let surface = Surface(colour.rgb, world_normal, shape.z, shape.w, 0.0);
    let light = lit(frame, surface, -gaze, sun);
    return Drawn(apply_aerial_perspective(frame, light, found.relative_m), found.relative_m, true);
}

fn plain(fragment: ObjectFragment, object: PomObject, footprint: Footprint) -> Drawn {
    let normal = normalize(to_world(object, fragment.normal));
    var albedo = object.tint;
    var at_m = fragment.relative_m;
    if object.shape == SHAPE_PLANE {
        let ray = view_ray(frame, fragment.clip.xy);
        let along = dot(ray, normal);
        at_m = select(at_m, ray * (dot(object.origin_m, normal) / along), abs(along) > 1e-6);
        let local_m = to_object(object, at_m - object.origin_m);
        let blur = max(length(footprint.ddx), length(footprint.ddy)) * object.tile_m.x;
        let broad = pattern_fbm(local_m.xy, 8.0, 81u);
        let grain = mix(0.5, pattern_fbm(local_m.xy, 0.125, 82u), clamp(1.3 - blur * 16.0, 0.0, 1.0));
        albedo *= 0.6 + 0.5 * broad + 0.3 * grain;
    }
    var light = vec3f(0.0);
    if frame.show == SHOW_PICTURE {
        let sun = objects_sun_share(at_m, fragment.index);
        light = lit(frame, Surface(albedo, normal, 0.75, 1.0, 0.0), -normalize(at_m), sun);
        light = apply_aerial_perspective(frame, light, at_m);
    }
    else {
        light = vec3f(0.12) * (0.5 + 0.5 * normal.y);
        if frame.show == SHOW_NORMALS {
            light = pow(normal * 0.5 + 0.5, vec3f(2.2));
        }
    }
    return Drawn(light, at_m, true);
}

@fragment
fn fragment(fragment: ObjectFragment) -> @location(0) vec4f {
    let footprint = footprint_of(frame, objects[fragment.index], fragment);
    let found = drawn(fragment, footprint);
    if !found.is_hit {
        discard;
    }
    return vec4f(found.light, 1.0);
}

struct Deep {
    @location(0)
    light: vec4f,
    @builtin(frag_depth)
    depth: f32
}

@fragment
fn fragment_depth(fragment: ObjectFragment) -> Deep {
    let footprint = footprint_of(frame, objects[fragment.index], fragment);
    let found = drawn(fragment, footprint);
    if !found.is_hit {
        discard;
    }
    let clip = frame.clip_from_camera * vec4f(found.relative_m, 1.0);
    return Deep(vec4f(found.light, 1.0), clamp(clip.z / max(clip.w, 1e-6), 0.0, 1.0));
}

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

const BORDER: f32 = 0.0001;

const BURLEY_ENERGY: f32 = 1.0 / 1.51;

struct Bracket {
    near: f32,
    far: f32,
    near_clearance: f32,
    far_clearance: f32
}

const CLUMP_DEPTH: f32 = 3.0;

const CONE_BISECTIONS: u32 = 8u;

const CONE_STEPS: u32 = 16u;

const DEEPEST: f32 = 20.0;

const DIELECTRIC_F0: f32 = 0.04;

const DIFFUSE_BURLEY: u32 = 1u;

const EARTH_RADIUS_M: f32 = 6371000.0;

const ERROR_TEXELS: f32 = 4.0;

struct Footprint {
    ddx: vec2f,
    ddy: vec2f,
    mesh: vec2f
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

const GEOMETRY_SEGMENTS: f32 = 256.0;

const HAZE_ALBEDO: f32 = 0.94;

const HAZE_EXTINCTION = vec3f(8.8e-6, 9e-6, 9.2e-6);

const HAZE_SCALE_M: f32 = 1200.0;

const HEIGHTS_EXACT: u32 = 1u;

const LEAF_SHARE: f32 = 0.25;

const LOOP_FLAG: u32 = 1u;

const MATERIAL_SETS = array<MaterialSet, 7>(MaterialSet(4.0, 0.05, 0.05, vec3f(0.4868, 0.374, 0.2264)), MaterialSet(4.0, 0.06, 1.0, vec3f(0.0526, 0.0806, 0.0235)), MaterialSet(4.0, 0.07, 1.0, vec3f(0.1447, 0.1192, 0.0579)), MaterialSet(8.0, 0.36, 1.0, vec3f(0.0541, 0.0908, 0.0236)), MaterialSet(8.0, 0.34, 0.0, vec3f(0.1788, 0.1562, 0.1271)), MaterialSet(4.0, 0.16, 1.0, vec3f(0.1267, 0.1131, 0.0966)), MaterialSet(4.0, 0.1, 1.0, vec3f(0.1895, 0.1699, 0.1328)));

const MAX_GLOSS: f32 = 64.0;

const MAX_NODE_VISITS: u32 = 8192u;

const MIN_NV: f32 = 0.0001;

const MIN_ROUGHNESS: f32 = 0.045;

const MODE_FLAT: u32 = 1u;

const MODE_GEOMETRY: u32 = 3u;

const MODE_OFFSET: u32 = 2u;

const MODE_PARAMS: u32 = 0u;

const MODE_PLAIN: u32 = 4u;

struct MaterialSet {
    tile_m: f32,
    relief_m: f32,
    turn: f32,
    mean: vec3f
}

struct MaxMipHit {
    at: f32,
    is_hit: bool,
    fetches: u32
}

struct MaxMipRay {
    start: vec2f,
    along: vec2f,
    height: f32,
    climb: f32,
    end: f32
}

struct NodeExit {
    low: vec2i,
    high: vec2i,
    exits: vec2f,
    exit: f32
}

const OWN_HORIZON = vec4f(2.0, 0.0, 0.6, 1.0);

struct ObjectFragment {
    @builtin(position)
    clip: vec4f,
    @location(0)
    relative_m: vec3f,
    @location(1)
    uv: vec2f,
    @location(2)
    height: f32,
    @location(3)
    side: vec2f,
    @location(4)
    local_m: vec3f,
    @location(5)
    normal: vec3f,
    @location(6)
    tangent: vec3f,
    @location(7) @interpolate(flat)
    index: u32
}

struct ObjectPlace {
    uv: vec2f,
    above_m: f32,
    normal: vec3f,
    tangent: vec3f
}

const PATTERN_PERIOD_M: f32 = 8192.0;

const POM_AUTO: u32 = 5u;

const POM_CONES: u32 = 3u;

const POM_FLAT: u32 = 0u;

const POM_LINEAR: u32 = 2u;

const POM_MAX_MIP: u32 = 4u;

const POM_MAX_STEPS: u32 = 256u;

const POM_OFFSET: u32 = 1u;

const POM_SHADOW_OFF: u32 = 0u;

const POM_SHADOW_SOFT: u32 = 2u;

struct PomHit {
    uv: vec2f,
    height: f32,
    fetches: u32
}

struct PomMap {
    layer: u32,
    side: u32,
    lod: u32
}

struct PomObject {
    origin_m: vec3f,
    mode: u32,
    tangent: vec3f,
    silhouette: u32,
    bitangent: vec3f,
    shape: u32,
    normal: vec3f,
    layer: u32,
    size_m: vec2f,
    tile_m: vec2f,
    tint: vec3f,
    relief_m: f32,
    repeats: vec2f,
    reserved: vec2f
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

struct PomRay {
    uv: vec2f,
    travel: vec2f,
    cosine: f32,
    amplitude: f32
}

struct PomSurfaceHit {
    uv: vec2f,
    height: f32,
    relative_m: vec3f,
    normal: vec3f,
    tangent: vec3f,
    is_hit: bool,
    is_cut: bool,
    fetches: u32
}

struct PomTrace {
    pom: PomParams,
    map: PomMap,
    ray: PomRay
}

const RAYLEIGH_SCALE_M: f32 = 8000.0;

const RAYLEIGH_SCATTERING = vec3f(5.8e-6, 1.35e-5, 3.31e-5);

const REFINE_BISECTION: u32 = 3u;

const REFINE_NONE: u32 = 0u;

const REFINE_SECANT: u32 = 2u;

const REFINE_SEGMENT: u32 = 1u;

const SHADOW_START: f32 = 0.5;

const SHAPE_CAPSULE: u32 = 1u;

const SHAPE_CUBE: u32 = 2u;

const SHAPE_PLANE: u32 = 0u;

const SHARP_ROUGHNESS: f32 = 0.35;

const SHELL_HALVINGS: u32 = 12u;

const SHELL_STEPS: u32 = 256u;

const SHOW_ERROR: u32 = 4u;

const SHOW_LEVELS: u32 = 2u;

const SHOW_NORMALS: u32 = 3u;

const SHOW_PICTURE: u32 = 0u;

const SILHOUETTE_HORIZON: u32 = 2u;

const SILHOUETTE_NONE: u32 = 0u;

const SILHOUETTE_RECTANGLE: u32 = 1u;

const SILHOUETTE_SHELL: u32 = 3u;

const SPACE_M: f32 = 10000000.0;

struct ShadingAngles {
    nl: f32,
    nv: f32,
    lh: f32,
    middle: vec3f
}

struct SlabEntry {
    enter: f32,
    uv: vec2f,
    side: vec2f,
    extent: vec2f
}

struct Surface {
    albedo: vec3f,
    normal: vec3f,
    roughness: f32,
    occlusion: f32,
    leaves: f32
}

struct TraversalState {
    cell: vec2i,
    level: u32,
    at: f32
}

const VISIBILITY_FAST: u32 = 1u;

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

fn apply_aerial_perspective(frame: Frame, light: vec3f, offset_m: vec3f) -> vec3f {
    let distance_m = max(length(offset_m), 0.001);
    let aerial = aerial_perspective(frame, offset_m / distance_m, distance_m);
    return light * aerial.transmittance + aerial.inscattering;
}

fn burley_diffuse(nl: f32, nv: f32, lh: f32, roughness: f32) -> f32 {
    let rise = 2.0 * roughness * lh * lh - 0.5;
    let light = 1.0 + rise * fifth_power(1.0 - nl);
    let view = 1.0 + rise * fifth_power(1.0 - nv);
    return light * view * mix(1.0, BURLEY_ENERGY, roughness);
}

fn capsule_place(object: PomObject, at_m: vec3f) -> ObjectPlace {
    let along = clamp(at_m.z, -object.size_m.y, object.size_m.y);
    let radial = vec3f(at_m.xy, at_m.z - along);
    let distance = max(length(radial), 1e-6);
    let normal = radial / distance;
    let ring = length(normal.xy);
    let east = select(vec2f(1.0, 0.0), normal.xy / max(ring, 1e-6), ring > 1e-5);
    let latitude = asin(clamp(normal.z, -1.0, 1.0));
    let meridian = (latitude + 1.5707964) * object.size_m.x + along + object.size_m.y;
    let uv = vec2f((atan2(east.y, east.x) * 0.15915494 + 0.5) * object.repeats.x, meridian / object.tile_m.y);
    return ObjectPlace(uv, distance - object.size_m.x, normal, vec3f(-east.y, east.x, 0.0));
}

fn capsule_sun_share(from_m: vec3f, sun: vec3f, size_m: vec2f) -> f32 {
    let across = max(1.0 - sun.z * sun.z, 0.0001);
    let reach = clamp((from_m.z - sun.z * dot(from_m, sun)) / across, -size_m.y, size_m.y);
    let to_axis = vec3f(0.0, 0.0, reach) - from_m;
    let along = dot(to_axis, sun);
    if along <= 0.0 {
        return 1.0;
    }
    let gap = length(to_axis - sun * along) - size_m.x;
    return smoothstep(-0.006, 0.006, gap / max(along, 0.1));
}

fn clearance(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f, share: f32) -> f32 {
    let exact = trace.pom.heights == HEIGHTS_EXACT;
    let uv = entry + share * trace.ray.travel;
    return (1.0 - share) - pom_height(heights, smooth_heights, tiled, trace.map, uv, exact);
}

fn cone_search(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, cones: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f) -> PomHit {
    let map = trace.map;
    let ray = trace.ray;
    let level = min(map.lod, textureNumLevels(cones) - 1u);
    let side = i32(textureDimensions(cones, level).x);
    let speed = max(length(ray.travel), 1e-9);
    var bracket = Bracket(0.0, 0.0, 0.0, clearance(heights, smooth_heights, tiled, trace, entry, 0.0));
    var fetches = 1u;
    for (var step = 0u; step < CONE_STEPS; step++) {
        if bracket.far_clearance <= 0.0 || bracket.far >= 1.0 {
            break;
        }
        let uv = entry + bracket.far * ray.travel;
        let texel = vec2i((uv - floor(uv)) * f32(side)) & vec2i(side - 1);
        let ratio = textureLoad(cones, texel, map.layer, level).x;
        let step_share = max(ratio * bracket.far_clearance / (speed + ratio), 0.0001);
        let share = min(bracket.far + step_share, 1.0);
        let sampled = clearance(heights, smooth_heights, tiled, trace, entry, share);
        bracket = Bracket(bracket.far, share, bracket.far_clearance, sampled);
        fetches += 2u;
    }
    var bisection = trace;
    bisection.pom.refine = REFINE_BISECTION;
    bisection.pom.refinements = CONE_BISECTIONS;
    if bracket.far_clearance > 0.0 {
        return PomHit(entry + bracket.far * ray.travel, 1.0 - bracket.far, fetches);
    }
    return refine_crossing(heights, smooth_heights, tiled, bisection, entry, bracket, fetches);
}

fn cube_place(object: PomObject, at_m: vec3f) -> ObjectPlace {
    let size = abs(at_m);
    var normal = vec3f(select(-1.0, 1.0, at_m.x >= 0.0), 0.0, 0.0);
    var tangent = vec3f(0.0, normal.x, 0.0);
    if size.z >= max(size.x, size.y) {
        normal = vec3f(0.0, 0.0, select(-1.0, 1.0, at_m.z >= 0.0));
        tangent = vec3f(normal.z, 0.0, 0.0);
    }
    else if size.y >= size.x {
        normal = vec3f(0.0, select(-1.0, 1.0, at_m.y >= 0.0), 0.0);
        tangent = vec3f(-normal.y, 0.0, 0.0);
    }
    let uv = (vec2f(dot(at_m, tangent), dot(at_m, cross(normal, tangent))) + object.size_m) / object.tile_m;
    return ObjectPlace(uv, dot(at_m, normal) - object.size_m.x, normal, tangent);
}

fn distance_along_ray_m(object: PomObject, pom: PomParams, fragment: ObjectFragment, to_eye: vec3f, height: f32) -> f32 {
    return (fragment.height - height) * object.relief_m * pom.amplitude / max(to_eye.z, 1e-5);
}

fn error_colour(share: f32) -> vec3f {
    let low = mix(vec3f(0.02, 0.35, 0.05), vec3f(0.75, 0.6, 0.02), clamp(2.0 * share, 0.0, 1.0));
    let high = mix(low, vec3f(0.8, 0.03, 0.01), clamp(2.0 * share - 1.0, 0.0, 1.0));
    return select(high, vec3f(2.5), share > 1.001);
}

fn fifth_power(x: f32) -> f32 {
    let squared = x * x;
    return squared * squared * x;
}

fn footprint_of(frame: Frame, object: PomObject, fragment: ObjectFragment) -> Footprint {
    let ddx = dpdx(fragment.uv);
    let ddy = dpdy(fragment.uv);
    let mesh = fwidth(fragment.uv);
    if object.shape != SHAPE_PLANE {
        return Footprint(ddx, ddy, mesh);
    }
    let ray = view_ray(frame, fragment.clip.xy);
    let sinks = dot(object.normal, ray);
    let least = 1e-5 * length(ray);
    let per_sink = 1.0 / select(sinks, select(-least, least, sinks >= 0.0), abs(sinks) < least);
    let way = dot(object.normal, object.origin_m) * per_sink;
    let right = frame.ray_right * (2.0 / frame.viewport.x);
    let down = frame.ray_up * (-2.0 / frame.viewport.y);
    let to_right = right - ray * (dot(object.normal, right) * per_sink);
    let to_below = down - ray * (dot(object.normal, down) * per_sink);
    let tiles = way / object.tile_m;
    return Footprint(vec2f(dot(object.tangent, to_right * tiles.x), dot(object.bitangent, to_right * tiles.y)), vec2f(dot(object.tangent, to_below * tiles.x), dot(object.bitangent, to_below * tiles.y)), mesh);
}

fn geometry_lod(object: PomObject, side: u32) -> u32 {
    let texels = object.size_m / object.tile_m * (f32(side) / GEOMETRY_SEGMENTS);
    let level = ceil(log2(max(max(texels.x, texels.y), 1.0)) - 1.0 - 0.001);
    return min(u32(max(level, 0.0)), firstLeadingBit(side));
}

fn ggx_alpha(roughness: f32) -> f32 {
    let bounded = clamp(roughness, MIN_ROUGHNESS, 1.0);
    return bounded * bounded;
}

fn ggx_distribution(normal: vec3f, middle: vec3f, alpha: f32) -> f32 {
    let aside = cross(normal, middle);
    let along = dot(normal, middle) * alpha;
    let k = alpha / (dot(aside, aside) + along * along);
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

fn haze_phase(cosine: f32) -> f32 {
    const G: f32 = 0.76;
    let base = max(1.0 + G * G - 2.0 * G * cosine, 0.001);
    return 1.5 * (1.0 - G * G) / (2.0 + G * G) * (1.0 + cosine * cosine) / (base * sqrt(base));
}

fn inspected_pom(show: u32, object: PomObject, normal: vec3f, error: f32, is_false: bool, tier: u32, fetches: u32, fragment: ObjectFragment, mesh: vec2f) -> vec3f {
    let shape = 0.35 + 0.65 * max(dot(normal, normalize(vec3f(0.5, 0.7, 0.5))), 0.0);
    if show == SHOW_NORMALS {
        return pow(normal * 0.5 + 0.5, vec3f(2.2));
    }
    if show == SHOW_ERROR {
        return select(error_colour(error / ERROR_TEXELS), vec3f(0.02, 0.08, 0.9), is_false) * shape;
    }
    if show == SHOW_LEVELS {
        return mix(vec3f(0.0), level_colour(f32(tier)), 0.15 + 0.85 * clamp(log2(f32(fetches) + 1.0) / 8.0, 0.0, 1.0)) * shape;
    }
    let cells = select(1.0, GEOMETRY_SEGMENTS, object.mode == MODE_GEOMETRY) * object.tile_m / object.size_m.x;
    return mix(vec3f(0.16) * shape, vec3f(1.0), mesh_lines(fragment.uv * cells, mesh * cells));
}

fn interpolated_crossing(bracket: Bracket) -> f32 {
    let fall = bracket.near_clearance - bracket.far_clearance;
    return mix(bracket.near, bracket.far, bracket.near_clearance / fall);
}

fn intersect_from_side(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, tiled: sampler, object: PomObject, pom: PomParams, map: PomMap, fragment: ObjectFragment, to_eye: vec3f, gaze: vec3f) -> PomSurfaceHit {
    let extent = object.size_m / object.tile_m;
    let along = -to_eye.xy / object.tile_m;
    let climb = -to_eye.z / (object.relief_m * pom.amplitude);
    let is_cut = pom_height(heights, smooth_heights, tiled, map, fragment.uv, true) >= fragment.height;
    if is_cut {
        let bitangent = cross(fragment.normal, fragment.tangent);
        return PomSurfaceHit(fragment.uv, fragment.height, fragment.relative_m, fragment.tangent * fragment.side.x + bitangent * fragment.side.y, fragment.tangent, true, true, 1u);
    }
    let moves = abs(along) > vec2f(1e-9);
    let ends = select(vec2f(1000000000.0), (select(vec2f(0.0), extent, along > vec2f(0.0)) - fragment.uv) / select(vec2f(1.0), along, moves), moves);
    let top = select(1000000000.0, (1.0 - fragment.height) / max(climb, 1e-9), climb > 1e-9);
    let end = clamp(min(min(ends.x, ends.y), top), 0.0, 10000.0);
    let side = f32(map.side >> map.lod);
    let found = max_mip_traversal(heights, max_mips, map, MaxMipRay(fragment.uv * side - 0.5, along * side, fragment.height, climb, end));
    return PomSurfaceHit(fragment.uv + found.at * along, fragment.height + found.at * climb, fragment.relative_m + gaze * found.at, fragment.normal, fragment.tangent, found.is_hit, false, found.fetches);
}

fn intersect_plane(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, cones: texture_2d_array<f32>, tiled: sampler, object: PomObject, pom: PomParams, silhouette: u32, map: PomMap, fragment: ObjectFragment, ray: PomRay, to_eye: vec3f, gaze: vec3f) -> PomSurfaceHit {
    let is_marched = pom_tier(pom, texel_travel(map, ray)) >= POM_LINEAR;
    let is_slab = silhouette == SILHOUETTE_RECTANGLE || silhouette == SILHOUETTE_SHELL;
    let slab = slab_entry(object, pom, ray);
    var hit = PomHit(slab.uv, 1.0 - slab.enter, 1u);
    var is_cut = false;
    if is_slab && slab.enter > 0.0 {
        is_cut = is_within(slab.uv, slab.extent) && slab.enter <= 1.0 && pom_height(heights, smooth_heights, tiled, map, slab.uv, true) >= hit.height;
    }
    if !is_cut {
        hit = pom_hit(heights, smooth_heights, max_mips, cones, tiled, PomTrace(pom, map, ray));
        if is_slab && (is_marched || silhouette == SILHOUETTE_SHELL) && slab.enter > 0.0 && 1.0 - hit.height < slab.enter {
            let side = f32(map.side >> map.lod);
            let left = max(1.0 - slab.enter, 0.0);
            let found = max_mip_traversal(heights, max_mips, map, MaxMipRay(slab.uv * side - 0.5, ray.travel * side, left, -1.0, left));
            hit = PomHit(slab.uv + found.at * ray.travel, left - found.at, hit.fetches + found.fetches);
        }
    }
    let is_hit = !is_slab || is_within(hit.uv, slab.extent);
    let relative_m = fragment.relative_m + gaze * distance_along_ray_m(object, pom, fragment, to_eye, hit.height);
    if is_cut {
        let bitangent = cross(fragment.normal, fragment.tangent);
        return PomSurfaceHit(hit.uv, hit.height, relative_m, fragment.tangent * slab.side.x + bitangent * slab.side.y, fragment.tangent, is_hit, true, 1u);
    }
    return PomSurfaceHit(hit.uv, hit.height, relative_m, fragment.normal, fragment.tangent, is_hit, false, hit.fetches);
}

fn intersect_shell(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, object: PomObject, pom: PomParams, map: PomMap, fragment: ObjectFragment, gaze: vec3f) -> PomSurfaceHit {
    let exact = true;
    let height_m = object.relief_m * pom.amplitude;
    let along = to_object(object, gaze);
    let outer = object.size_m.x + (1.0 - pom.pivot) * height_m;
    let inner = max(object.size_m.x - pom.pivot * height_m, 0.0);
    var longest_m = 2.0 * sqrt(max(outer * outer - inner * inner, 0.0));
    if object.shape == SHAPE_CUBE {
        longest_m = 2.0 * outer * 1.7320508;
    }
    else {
        longest_m += 2.0 * object.size_m.y * abs(along.z);
    }
    let pitch_m = max(min(object.tile_m.x, object.tile_m.y) / f32(map.side >> map.lod), longest_m / f32(SHELL_STEPS));
    var near_m = 0.0;
    var far_m = 0.0;
    var is_hit = false;
    var fetches = 0u;
    for (var step = 0u; step < SHELL_STEPS; step++) {
        let here = object_place(object, fragment.local_m + along * far_m);
        let height = here.above_m / height_m + pom.pivot;
        if step > 1u && height > 1.001 {
            break;
        }
        fetches += 1u;
        if height <= pom_height(heights, smooth_heights, tiled, map, here.uv, exact) {
            is_hit = true;
            break;
        }
        near_m = far_m;
        far_m += pitch_m;
    }
    for (var round = 0u; round < SHELL_HALVINGS && is_hit; round++) {
        let middle_m = 0.5 * (near_m + far_m);
        let here = object_place(object, fragment.local_m + along * middle_m);
        let height = here.above_m / height_m + pom.pivot;
        fetches += 1u;
        if height <= pom_height(heights, smooth_heights, tiled, map, here.uv, exact) {
            far_m = middle_m;
        }
        else {
            near_m = middle_m;
        }
    }
    let place = object_place(object, fragment.local_m + along * far_m);
    return PomSurfaceHit(place.uv, clamp(place.above_m / height_m + pom.pivot, 0.0, 1.0), fragment.relative_m + gaze * far_m, place.normal, place.tangent, is_hit, false, fetches);
}

fn is_eroded(horizon: vec4f, cosine: f32, height: f32) -> bool {
    let flat = clamp(1.0 - cosine / max(horizon.z, 0.001), 0.0, 1.0);
    let threshold = clamp(pow(flat, horizon.w) * horizon.x, 0.0, 1.0);
    return height - horizon.y < threshold;
}

fn is_inside_shell(object: PomObject, pom: PomParams) -> bool {
    let eye_m = to_object(object, -object.origin_m);
    let top_m = (1.0 - pom.pivot) * object.relief_m * pom.amplitude;
    if object.shape == SHAPE_PLANE {
        return all(abs(eye_m.xy) <= 0.5 * object.size_m) && eye_m.z <= top_m && eye_m.z >= 0.0;
    }
    return object_place(object, eye_m).above_m <= top_m;
}

fn is_within(uv: vec2f, extent: vec2f) -> bool {
    return all(uv >= vec2f(-BORDER)) && all(uv <= extent + BORDER);
}

fn lattice_value(cell: vec2i, mask: i32, salt: u32) -> f32 {
    let wrapped = vec2u(cell & vec2i(mask));
    return f32(pattern_hash(wrapped.x + salt * 2654435769u, wrapped.y) >> 8u) * (1.0 / 16777216.0);
}

fn leaf_sun(facing: f32) -> f32 {
    return 0.5 * exp(-CLUMP_DEPTH * max(-facing, 0.0));
}

fn level_colour(level: f32) -> vec3f {
    let hue = fract(floor(level) * 0.382 + 0.58);
    let wheel = abs(fract(vec3f(hue, hue + 0.667, hue + 0.333)) * 6.0 - 3.0) - 1.0;
    return mix(vec3f(0.35), clamp(wheel, vec3f(0.0), vec3f(1.0)), 0.75);
}

fn linear_search(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f, steps: u32) -> PomHit {
    var bracket = Bracket(0.0, 0.0, 0.0, clearance(heights, smooth_heights, tiled, trace, entry, 0.0));
    var fetches = 1u;
    if trace.pom.loop_form == LOOP_FLAG {
        var done = bracket.far_clearance <= 0.0;
        for (var step = 1u; step <= steps; step++) {
            let share = f32(step) / f32(steps);
            let sampled = clearance(heights, smooth_heights, tiled, trace, entry, share);
            bracket = Bracket(select(bracket.far, bracket.near, done), select(share, bracket.far, done), select(bracket.far_clearance, bracket.near_clearance, done), select(sampled, bracket.far_clearance, done));
            done = done || sampled <= 0.0;
        }
        fetches += steps;
    }
    else {
        for (var step = 1u; step <= steps && bracket.far_clearance > 0.0; step++) {
            let share = f32(step) / f32(steps);
            let sampled = clearance(heights, smooth_heights, tiled, trace, entry, share);
            bracket = Bracket(bracket.far, share, bracket.far_clearance, sampled);
            fetches += 1u;
        }
    }
    return refine_crossing(heights, smooth_heights, tiled, trace, entry, bracket, fetches);
}

fn lit(frame: Frame, surface: Surface, to_eye: vec3f, sun_share: f32) -> vec3f {
    let normal = surface.normal;
    let nv = clamp(dot(normal, to_eye), MIN_NV, 1.0);
    let f0 = DIELECTRIC_F0 * (1.0 - surface.roughness * surface.roughness);
    let specular_share = specular_albedo(f0, surface.roughness, nv);
    let body = surface.albedo * (1.0 - specular_share);
    let mirrored = reflect(-to_eye, normal);
    var shine = ambient(frame, mirrored);
    if surface.roughness < SHARP_ROUGHNESS {
        shine = mix(sky_radiance(frame, mirrored), shine, surface.roughness / SHARP_ROUGHNESS);
    }
    var light = (body * ambient(frame, normal) + specular_share * shine) * surface.occlusion;
    let angles = shading_angles(normal, to_eye, frame.sun);
    if angles.nl * sun_share > 0.0 {
        let alpha = ggx_alpha(surface.roughness);
        var visibility = 0.0;
        if frame.visibility == VISIBILITY_FAST {
            visibility = ggx_visibility_fast(angles.nl, angles.nv, alpha);
        }
        else {
            visibility = ggx_visibility_exact(angles.nl, angles.nv, alpha);
        }
        var diffuse = 1.0;
        if frame.diffuse == DIFFUSE_BURLEY {
            diffuse = burley_diffuse(angles.nl, angles.nv, angles.lh, surface.roughness);
        }
        let gloss = ggx_distribution(normal, angles.middle, alpha) * visibility * schlick(f0, angles.lh) * 3.1415927;
        let facing = 1.0 - surface.leaves * LEAF_SHARE;
        light += frame.atmosphere.sun * ((body * diffuse * facing + min(gloss, MAX_GLOSS)) * (angles.nl * sun_share));
    }
    let leaf_share = surface.leaves * LEAF_SHARE * sun_share;
    return light + frame.atmosphere.sun * body * (leaf_share * leaf_sun(dot(normal, frame.sun)));
}

var<private> material_sets: array<MaterialSet, 7> = MATERIAL_SETS;

fn max_mip_corner(map: PomMap, level: u32) -> vec2i {
    let side = map.side >> map.lod;
    let south = 2u * (map.side - side);
    if level == 0u {
        return vec2i(0, i32(south));
    }
    return vec2i(i32(side), i32(south + side - 2u * (side >> level)));
}

fn max_mip_height(max_mips: texture_2d_array<f32>, map: PomMap, node: vec2i, level: u32) -> f32 {
    let mask = i32(map.side >> (map.lod + level)) - 1;
    return textureLoad(max_mips, max_mip_corner(map, level) + (node & vec2i(mask)), map.layer, 0).x;
}

fn max_mip_traversal(heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, map: PomMap, walk: MaxMipRay) -> MaxMipHit {
    let highest = firstLeadingBit(map.side) - map.lod;
    let per_cell = 1.0 / select(vec2f(1.0), walk.along, abs(walk.along) > vec2f(1e-9));
    let travel = max(abs(walk.along.x), abs(walk.along.y)) * walk.end;
    var traversal = TraversalState(vec2i(floor(walk.start)), min(u32(log2(max(travel, 1.0))), highest), 0.0);
    var fetches = 0u;
    var visits = 0u;
    loop {
        var left: NodeExit;
        var may_touch = false;
        while (visits < MAX_NODE_VISITS) {
            visits += 1u;
            left = node_exit(walk, traversal, per_cell);
            let height = walk.height + walk.climb * traversal.at;
            let lowest = min(height, walk.height + walk.climb * left.exit);
            let top = max_mip_height(max_mips, map, traversal.cell >> vec2u(traversal.level), traversal.level);
            fetches += 1u;
            if lowest <= top {
                may_touch = traversal.level == 0u;
                if may_touch {
                    break;
                }
                if walk.climb < 0.0 && height > top {
                    traversal.at = clamp((top - walk.height) / walk.climb, traversal.at, left.exit);
                }
                traversal.level -= 1u;
                traversal.cell = clamp(vec2i(floor(walk.start + traversal.at * walk.along)), left.low, left.high - 1);
                continue;
            }
            if left.exit >= walk.end {
                traversal.at = walk.end;
                break;
            }
            traversal = next_node(walk, traversal, left, highest);
        }
        if !may_touch {
            break;
        }
        let share = patch_intersection(heights, map, traversal.cell, walk, traversal.at, left.exit);
        fetches += 4u;
        if share >= 0.0 {
            return MaxMipHit(mix(traversal.at, left.exit, share), true, fetches);
        }
        if left.exit >= walk.end {
            traversal.at = walk.end;
            break;
        }
        traversal = next_node(walk, traversal, left, highest);
    }
    return MaxMipHit(traversal.at, false, fetches);
}

fn mesh_lines(cell: vec2f, change: vec2f) -> f32 {
    let along = vec3f(cell, cell.x - cell.y);
    let rate = max(vec3f(change, change.x + change.y), vec3f(1e-6));
    let beside = abs(along - round(along)) / rate;
    let line = 1.0 - smoothstep(0.4, 1.1, min(beside.x, min(beside.y, beside.z)));
    return mix(line, 0.3, smoothstep(0.3, 0.7, max(rate.x, rate.y)));
}

fn next_node(walk: MaxMipRay, traversal: TraversalState, left: NodeExit, highest: u32) -> TraversalState {
    var next = clamp(vec2i(floor(walk.start + left.exit * walk.along)), left.low, left.high - 1);
    if left.exits.x <= left.exits.y {
        next.x = select(left.low.x - 1, left.high.x, walk.along.x >= 0.0);
    }
    else {
        next.y = select(left.low.y - 1, left.high.y, walk.along.y >= 0.0);
    }
    let above = vec2u(traversal.level + 1u);
    let rises = traversal.level < highest && any((next >> above) != (left.low >> above));
    return TraversalState(next, select(traversal.level, traversal.level + 1u, rises), left.exit);
}

fn node_exit(walk: MaxMipRay, traversal: TraversalState, per_cell: vec2f) -> NodeExit {
    let low = (traversal.cell >> vec2u(traversal.level)) << vec2u(traversal.level);
    let high = low + vec2i(i32(1u << traversal.level));
    let far = vec2f(select(low, high, walk.along >= vec2f(0.0)));
    let exits = select(vec2f(3e38), (far - walk.start) * per_cell, abs(walk.along) > vec2f(1e-9));
    return NodeExit(low, high, exits, clamp(min(exits.x, exits.y), traversal.at, walk.end));
}

fn object_place(object: PomObject, at_m: vec3f) -> ObjectPlace {
    if object.shape == SHAPE_CUBE {
        return cube_place(object, at_m);
    }
    return capsule_place(object, at_m);
}

fn object_sun_share(object: PomObject, at_m: vec3f, sun: vec3f) -> f32 {
    if object.mode == MODE_PLAIN && object.shape == SHAPE_PLANE {
        return 1.0;
    }
    let from_m = to_object(object, at_m - object.origin_m);
    let to_sun = to_object(object, sun);
    if object.shape == SHAPE_CAPSULE {
        return capsule_sun_share(from_m, to_sun, object.size_m);
    }
    let half = select(vec3f(0.5 * object.size_m, 0.02), object.size_m.xxx, object.shape == SHAPE_CUBE);
    let per_m = 1.0 / select(to_sun, vec3f(1e-6), abs(to_sun) < vec3f(1e-6));
    let ways = -from_m * per_m;
    let spans = abs(half * per_m);
    let enter = max(max(ways.x - spans.x, ways.y - spans.y), ways.z - spans.z);
    let leave = min(min(ways.x + spans.x, ways.y + spans.y), ways.z + spans.z);
    return select(1.0, 0.0, enter < leave && leave > 0.0 && enter > 0.001);
}

fn patch_intersection(heights: texture_2d_array<f32>, map: PomMap, cell: vec2i, walk: MaxMipRay, from_at: f32, to_at: f32) -> f32 {
    let a = pom_texel(heights, map, cell);
    let b = pom_texel(heights, map, cell + vec2i(1, 0)) - a;
    let c = pom_texel(heights, map, cell + vec2i(0, 1)) - a;
    let d = pom_texel(heights, map, cell + vec2i(1, 1)) - a - b - c;
    let near = clamp(walk.start + from_at * walk.along - vec2f(cell), vec2f(0.0), vec2f(1.0));
    let span = (to_at - from_at) * walk.along;
    let zero = walk.height + walk.climb * from_at - (a + b * near.x + c * near.y + d * near.x * near.y);
    if zero <= 0.0 {
        return 0.0;
    }
    let one = walk.climb * (to_at - from_at) - (b * span.x + c * span.y + d * (near.x * span.y + near.y * span.x));
    let two = -d * span.x * span.y;
    let discriminant = one * one - 4.0 * two * zero;
    if discriminant < 0.0 {
        return -1.0;
    }
    let half = -0.5 * (one + select(-1.0, 1.0, one >= 0.0) * sqrt(discriminant));
    var share = -1.0;
    if one < 0.0 {
        share = zero / max(half, 1e-30);
    }
    else if two < 0.0 {
        share = half / two;
    }
    return select(-1.0, share, share >= 0.0 && share <= 1.0);
}

fn pattern(position_m: vec2f, cell_m: f32, salt: u32) -> f32 {
    return pattern_gradient(position_m, cell_m, salt).x;
}

fn pattern_fbm(position_m: vec2f, cell_m: f32, salt: u32) -> f32 {
    var p = position_m;
    var sum = 0.0;
    var weight = 0.5333;
    for (var octave = 0u; octave < 4u; octave++) {
        sum += weight * pattern(p, cell_m, salt + octave);
        p = vec2f(2.0 * p.x + p.y, 2.0 * p.y - p.x);
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

fn pom_entry(ray: PomRay, pivot: f32) -> vec2f {
    return (ray.uv - floor(ray.uv)) - (1.0 - pivot) * ray.travel;
}

fn pom_height(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, map: PomMap, uv: vec2f, exact: bool) -> f32 {
    let within = uv - floor(uv);
    if !exact {
        return textureSampleLevel(smooth_heights, tiled, within, map.layer, f32(map.lod)).a;
    }
    let place = within * f32(map.side >> map.lod) - 0.5;
    let low = floor(place);
    let part = place - low;
    let cell = vec2i(low);
    let north = mix(pom_texel(heights, map, cell), pom_texel(heights, map, cell + vec2i(1, 0)), part.x);
    let south = mix(pom_texel(heights, map, cell + vec2i(0, 1)), pom_texel(heights, map, cell + vec2i(1, 1)), part.x);
    return mix(north, south, part.y);
}

fn pom_hit(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, cones: texture_2d_array<f32>, tiled: sampler, trace: PomTrace) -> PomHit {
    let ray = trace.ray;
    let travels = ray.amplitude > 0.0 && texel_travel(trace.map, ray) > 0.0;
    if trace.pom.tier == POM_CONES && travels {
        let entry = pom_entry(ray, trace.pom.pivot);
        return pom_return(ray, cone_search(heights, smooth_heights, cones, tiled, trace, entry));
    }
    return pom_hit_no_cones(heights, smooth_heights, max_mips, tiled, trace);
}

fn pom_hit_no_cones(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, tiled: sampler, trace: PomTrace) -> PomHit {
    let pom = trace.pom;
    let map = trace.map;
    let ray = trace.ray;
    let travel = texel_travel(map, ray);
    let tier = pom_tier(pom, travel);
    let exact = pom.heights == HEIGHTS_EXACT;
    if tier == POM_FLAT || ray.amplitude <= 0.0 {
        return PomHit(ray.uv, pom.pivot, 0u);
    }
    if tier == POM_OFFSET || tier == POM_CONES || travel == 0.0 {
        let height = pom_height(heights, smooth_heights, tiled, map, ray.uv, exact);
        let moves = pom.tier != POM_AUTO || travel >= pom.travel_flat;
        return PomHit(select(ray.uv, ray.uv + (pom.pivot - height) * ray.travel, moves), height, 1u);
    }
    let entry = pom_entry(ray, pom.pivot);
    if tier == POM_MAX_MIP {
        let side = f32(map.side >> map.lod);
        let base = floor(entry);
        let start = (entry - base) * side - 0.5;
        let found = max_mip_traversal(heights, max_mips, map, MaxMipRay(start, ray.travel * side, 1.0, -1.0, 1.0));
        return pom_return(ray, PomHit(entry + found.at * ray.travel, 1.0 - found.at, found.fetches));
    }
    var steps = pom_steps(pom, ray);
    var search = trace;
    if pom.tier == POM_AUTO {
        steps = clamp(u32(ceil(travel)) + 1u, 1u, POM_MAX_STEPS);
        search.pom.refine = REFINE_SECANT;
        search.pom.refinements = 3u;
    }
    return pom_return(ray, linear_search(heights, smooth_heights, tiled, search, entry, steps));
}

fn pom_lod(side: u32, footprint: f32) -> u32 {
    let level = round(log2(max(footprint * f32(side), 1.0)));
    return min(u32(level), firstLeadingBit(side));
}

fn pom_ray(uv: vec2f, to_eye: vec3f, amplitude: f32) -> PomRay {
    let is_from_above = to_eye.z > 1e-5;
    let travel = -to_eye.xy * (amplitude / select(1.0, to_eye.z, is_from_above));
    return PomRay(uv, select(vec2f(0.0), travel, is_from_above), max(to_eye.z, 0.0), amplitude);
}

fn pom_return(ray: PomRay, hit: PomHit) -> PomHit {
    return PomHit(floor(ray.uv) + hit.uv, hit.height, hit.fetches);
}

fn pom_steps(pom: PomParams, ray: PomRay) -> u32 {
    let flatness = acos(clamp(ray.cosine, 0.0, 1.0)) * 0.63661977;
    let steps = mix(f32(pom.steps_min), f32(pom.steps_max), flatness);
    return clamp(u32(ceil(steps - 0.001)), 1u, POM_MAX_STEPS);
}

fn pom_sun(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, tiled: sampler, pom: PomParams, map: PomMap, uv: vec2f, height: f32, to_sun: vec3f, amplitude: f32) -> f32 {
    if pom.shadow == POM_SHADOW_OFF || amplitude <= 0.0 {
        return 1.0;
    }
    if to_sun.z <= 0.0 {
        return 0.0;
    }
    let travel = to_sun.xy * (amplitude / max(to_sun.z, 0.0001));
    if pom.shadow == POM_SHADOW_SOFT {
        return soft_sun(heights, smooth_heights, tiled, pom, map, uv, height, travel);
    }
    let side = f32(map.side >> map.lod);
    let speed = length(travel) * side;
    if speed < SHADOW_START {
        return 1.0;
    }
    let within = uv - floor(uv);
    let lift = SHADOW_START / speed;
    let walk = MaxMipRay(within * side - 0.5 + travel * side * lift, travel * side, height + lift, 1.0, max(1.0 - height - lift, 0.0));
    return select(1.0, 0.0, max_mip_traversal(heights, max_mips, map, walk).is_hit);
}

fn pom_texel(heights: texture_2d_array<f32>, map: PomMap, at: vec2i) -> f32 {
    let mask = i32(map.side >> map.lod) - 1;
    return textureLoad(heights, at & vec2i(mask), map.layer, map.lod).x;
}

fn pom_tier(pom: PomParams, travel: f32) -> u32 {
    if pom.tier != POM_AUTO {
        return pom.tier;
    }
    if travel < pom.travel_offset {
        return POM_OFFSET;
    }
    return select(POM_MAX_MIP, POM_LINEAR, travel < pom.travel_linear);
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 0.75 * (1.0 + cosine * cosine);
}

fn refine_crossing(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f, found: Bracket, spent: u32) -> PomHit {
    let pom = trace.pom;
    var bracket = found;
    var fetches = spent;
    var share = bracket.far;
    if pom.refine != REFINE_NONE && bracket.near_clearance > 0.0 {
        let rounds = select(pom.refinements, 0u, pom.refine == REFINE_SEGMENT);
        for (var round = 0u; round < rounds; round++) {
            share = select(interpolated_crossing(bracket), 0.5 * (bracket.near + bracket.far), pom.refine == REFINE_BISECTION);
            let sampled = clearance(heights, smooth_heights, tiled, trace, entry, share);
            fetches += 1u;
            if sampled > 0.0 {
                bracket = Bracket(share, bracket.far, sampled, bracket.far_clearance);
            }
            else {
                bracket = Bracket(bracket.near, share, bracket.near_clearance, sampled);
            }
        }
        share = interpolated_crossing(bracket);
    }
    return PomHit(entry + share * trace.ray.travel, 1.0 - share, fetches);
}

fn scaled_erfc(x: f32) -> f32 {
    const A: f32 = 2.7519384;
    return A / ((A - 1.0) * 1.7724539 * x + sqrt(3.1415927 * x * x + A * A));
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

fn silhouette_of(object: PomObject, pom: PomParams) -> u32 {
    if object.mode != MODE_PARAMS || pom.tier == POM_FLAT || object.relief_m * pom.amplitude <= 0.0 {
        return SILHOUETTE_NONE;
    }
    let wished = select(pom.silhouette, object.silhouette, pom.silhouette == SILHOUETTE_NONE);
    let has_shell = pom.tier != POM_OFFSET && !is_inside_shell(object, pom);
    return select(wished, SILHOUETTE_NONE, wished == SILHOUETTE_SHELL && !has_shell);
}

fn sky_radiance(frame: Frame, direction: vec3f) -> vec3f {
    return aerial_perspective(frame, direction, SPACE_M).inscattering;
}

fn slab_entry(object: PomObject, pom: PomParams, ray: PomRay) -> SlabEntry {
    let extent = select(object.size_m, 2.0 * object.size_m, object.shape == SHAPE_CUBE) / object.tile_m;
    let entry = ray.uv - (1.0 - pom.pivot) * ray.travel;
    let moves = abs(ray.travel) > vec2f(1e-9);
    let per_tile = 1.0 / select(vec2f(1.0), ray.travel, moves);
    let to_low = select(vec2f(0.0), -entry * per_tile, moves & (entry < vec2f(0.0)));
    let to_high = select(vec2f(0.0), (extent - entry) * per_tile, moves & (entry > extent));
    let shares = max(to_low, to_high);
    let enter = max(max(shares.x, shares.y), 0.0);
    var side = vec2f(0.0);
    if enter > 0.0 {
        side = select(vec2f(0.0, -sign(ray.travel.y)), vec2f(-sign(ray.travel.x), 0.0), shares.x >= shares.y);
    }
    return SlabEntry(enter, entry + enter * ray.travel, side, extent);
}

fn soft_sun(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, pom: PomParams, map: PomMap, uv: vec2f, height: f32, travel: vec2f) -> f32 {
    var darkest = 0.0;
    for (var tap = 0u; tap < 7u; tap++) {
        let fraction = 0.88 - 0.11 * f32(tap);
        let weight = select(2.0 * f32(tap), 1.0, tap == 0u);
        let there = pom_height(heights, smooth_heights, tiled, map, uv + fraction * travel, pom.heights == HEIGHTS_EXACT);
        darkest = max(darkest, (there - height - fraction) * weight * 0.58);
    }
    return 1.0 - clamp(darkest, 0.0, 1.0);
}

fn specular_albedo(f0: f32, roughness: f32, nv: f32) -> f32 {
    let r = vec4f(-1.0, -0.0275, -0.572, 0.022) * roughness + vec4f(1.0, 0.0425, 1.04, -0.04);
    let narrow = min(r.x * r.x, exp2(-9.28 * nv)) * r.x + r.y;
    let scale = -1.04 * narrow + r.z;
    let bias = 1.04 * narrow + r.w;
    return clamp(f0 * scale + bias * clamp(50.0 * f0, 0.0, 1.0), 0.0, 1.0);
}

fn stretch_of(object: PomObject, normal: vec3f) -> vec2f {
    let across = object.tile_m.x / object.tile_m.y;
    if object.shape != SHAPE_CAPSULE {
        return vec2f(1.0, across);
    }
    return vec2f(object.repeats.x * object.tile_m.x / (6.2831855 * object.size_m.x * max(length(normal.xy), 0.15)), across);
}

fn texel_travel(map: PomMap, ray: PomRay) -> f32 {
    return length(ray.travel) * f32(map.side >> map.lod);
}

fn to_eye_of(fragment: ObjectFragment, object: PomObject) -> vec3f {
    let to_eye = to_object(object, -normalize(fragment.relative_m));
    let normal = normalize(fragment.normal);
    let tangent = normalize(fragment.tangent);
    return vec3f(dot(to_eye, tangent), dot(to_eye, cross(normal, tangent)), dot(to_eye, normal));
}

fn to_object(object: PomObject, direction: vec3f) -> vec3f {
    return vec3f(dot(object.tangent, direction), dot(object.bitangent, direction), dot(object.normal, direction));
}

fn to_world(object: PomObject, direction: vec3f) -> vec3f {
    return object.tangent * direction.x + object.bitangent * direction.y + object.normal * direction.z;
}

fn undisplaced(fragment: ObjectFragment, object: PomObject, pom: PomParams, to_eye: vec3f) -> vec2f {
    let rise = (fragment.height - pom.pivot) * (object.relief_m * pom.amplitude) / object.tile_m;
    let moves = object.shape == SHAPE_PLANE && to_eye.z > 1e-5;
    return fragment.uv - select(vec2f(0.0), to_eye.xy * (rise / max(to_eye.z, 1e-5)), moves);
}

fn view_ray(frame: Frame, position: vec2f) -> vec3f {
    let ndc = position / frame.viewport * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0);
    return frame.ray_forward + ndc.x * frame.ray_right + ndc.y * frame.ray_up;
}
