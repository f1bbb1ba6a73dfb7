@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(1)
var wave_map: texture_2d<f32>;

@group(0) @binding(2)
var tiled: sampler;

const SEPARATOR_PX: f32 = 2.0;

const SEPARATOR = vec3f(0.9);

const FLOOR_FALL: f32 = 0.13;

const SHORE_Z_M: f32 = -19.0;

const DUNE_M: f32 = 1.9;

const BREEZE: f32 = 1.5;

const SAND: u32 = 0u;

const GRASS: u32 = 1u;

const STONE: u32 = 2u;

const NO_HIT: u32 = 3u;

const DRY_BEACH = vec3f(0.56, 0.44, 0.27);

const WET_BEACH = vec3f(0.25, 0.19, 0.11);

const FLOOR_SAND = vec3f(0.44, 0.39, 0.27);

const FLOOR_WEED = vec3f(0.07, 0.1, 0.06);

const MEADOW = vec3f(0.085, 0.135, 0.03);

const THICKET = vec3f(0.025, 0.052, 0.016);

const GRANITE = vec3f(0.26, 0.235, 0.205);

const DARK_GRANITE = vec3f(0.105, 0.095, 0.085);

const DOMES = array<vec4f, 5>(vec4f(-14.0, -14.5, -57.0, 21.0), vec4f(4.0, -19.5, -66.0, 25.0), vec4f(21.0, -12.5, -55.0, 21.0), vec4f(-34.0, -22.0, -70.0, 34.0), vec4f(48.0, -26.0, -80.0, 38.0));

const BOULDERS = array<vec4f, 7>(vec4f(-4.6, -0.7, -10.0, 1.9), vec4f(-2.2, -1.2, -11.4, 1.5), vec4f(5.4, -0.8, -14.5, 2.1), vec4f(2.6, -2.1, -4.2, 1.7), vec4f(-6.4, -1.5, -3.0, 1.35), vec4f(6.9, -0.9, -8.0, 1.25), vec4f(0.9, -0.2, -17.2, 0.8));

var<private> domes: array<vec4f, 5> = DOMES;

var<private> boulders: array<vec4f, 7> = BOULDERS;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((index << 1u) & 2u), f32(index & 2u));
    return vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
}

struct Hit {
    distance_m: f32,
    normal: vec3f,
    kind: u32
}

fn nearer(best: Hit, distance_m: f32, normal: vec3f, kind: u32) -> Hit {
    if distance_m > 0.001 && distance_m < best.distance_m {
        return Hit(distance_m, normal, kind);
    }
    return best;
}

fn into_beach(best: Hit, from_m: vec3f, direction: vec3f) -> Hit {
    let level = inverseSqrt(1.0 + FLOOR_FALL * FLOOR_FALL);
    let slope = vec3f(0.0, level, FLOOR_FALL * level);
    let sinks = dot(slope, direction);
    let above = dot(slope, from_m) - slope.z * SHORE_Z_M;
    let pass_slope = -above / select(sinks, -1e-6, abs(sinks) < 1e-6);
    let pass_top = (DUNE_M - from_m.y) / select(direction.y, -1e-6, abs(direction.y) < 1e-6);
    let enter_slope = select(select(1000000000.0, -1000000000.0, above <= 0.0), pass_slope, sinks < 0.0);
    let enter_top = select(select(1000000000.0, -1000000000.0, from_m.y <= DUNE_M), pass_top, direction.y < 0.0);
    let leave = min(select(1000000000.0, pass_slope, sinks > 0.0), select(1000000000.0, pass_top, direction.y > 0.0));
    let enter = max(enter_slope, enter_top);
    if enter >= leave {
        return best;
    }
    return nearer(best, enter, select(vec3f(0.0, 1.0, 0.0), slope, enter_slope >= enter_top), SAND);
}

fn sphere_chord(from_m: vec3f, direction: vec3f, sphere: vec4f) -> vec2f {
    let middle = sphere.xyz - from_m;
    let along = dot(middle, direction);
    return vec2f(sphere.w * sphere.w - dot(middle, middle) + along * along, along);
}

fn into_sphere(best: Hit, from_m: vec3f, direction: vec3f, sphere: vec4f, kind: u32) -> Hit {
    let chord = sphere_chord(from_m, direction, sphere);
    if chord.x <= 0.0 {
        return best;
    }
    let distance_m = chord.y - sqrt(chord.x);
    return nearer(best, distance_m, (from_m + direction * distance_m - sphere.xyz) / sphere.w, kind);
}

fn trace(from_m: vec3f, direction: vec3f) -> Hit {
    var best = Hit(1000000000.0, vec3f(0.0, 1.0, 0.0), NO_HIT);
    best = into_beach(best, from_m, direction);
    for (var dome = 0u; dome < 5u; dome++) {
        best = into_sphere(best, from_m, direction, domes[dome], GRASS);
    }
    for (var boulder = 0u; boulder < 7u; boulder++) {
        best = into_sphere(best, from_m, direction, boulders[boulder], STONE);
    }
    return best;
}

fn land_light(at_m: vec3f, hit: Hit, direction: vec3f, footprint_m: f32) -> vec3f {
    let place = at_m.xz;
    let long_m = footprint_m / max(dot(hit.normal, -direction), 0.02);
    let near = clamp(1.5 - long_m * 12.0, 0.0, 1.0);
    let broad = mix(0.5, pattern_fbm(place, 16.0, 61u), clamp(1.5 - long_m * 0.35, 0.0, 1.0));
    let fine = mix(0.5, pattern_fbm(place, 1.0, 62u), near);
    var normal = hit.normal;
    var albedo = mix(WET_BEACH, DRY_BEACH, smoothstep(0.15, 0.7, at_m.y + (broad - 0.5) * 0.3));
    albedo = mix(albedo, mix(FLOOR_SAND, FLOOR_WEED, smoothstep(0.54, 0.66, broad) * 0.85), 1.0 - smoothstep(-0.5, -0.05, at_m.y));
    albedo *= 0.86 + 0.28 * fine;
    if hit.kind == GRASS || (hit.kind == SAND && at_m.y > DUNE_M - 0.25 + (broad - 0.5) * 0.7) {
        let wood = smoothstep(0.42, 0.6, broad + (fine - 0.5) * 0.35);
        let lumps = pattern_gradient(place, 1.0, 63u).yz * mix(0.1, 0.42, wood) * near;
        normal = normalize(normal - vec3f(lumps.x, 0.0, lumps.y));
        albedo = mix(MEADOW, THICKET, wood) * (0.65 + 0.7 * fine);
    }
    else if hit.kind == STONE {
        let turned = vec2f(at_m.x + 0.6 * at_m.y, at_m.z - 0.8 * at_m.y);
        let lumps = pattern_gradient(turned, 0.5, 64u).yz * 0.11 * near + pattern_gradient(turned, 2.0, 65u).yz * 0.5;
        normal = normalize(normal - vec3f(lumps.x, 0.3 * (lumps.x - lumps.y), lumps.y));
        albedo = mix(DARK_GRANITE, GRANITE, clamp(pattern_fbm(turned, 2.0, 66u) * 1.6 - 0.3, 0.0, 1.0));
        albedo *= mix(0.5, 1.0, smoothstep(0.05, 0.45, at_m.y + (fine - 0.5) * 0.2));
    }
    let open = 0.65 + 0.35 * hit.normal.y;
    return lit(frame, Surface(albedo, normal, 0.9, open, 0.0), -direction, sun_share(at_m + hit.normal * 0.02));
}

fn lit_through_air(from_m: vec3f, direction: vec3f, footprint_m: f32) -> vec3f {
    let hit = trace(from_m, direction);
    if hit.kind == NO_HIT {
        return sky_radiance(frame, direction);
    }
    let at_m = from_m + direction * hit.distance_m;
    return apply_aerial_perspective(frame, land_light(at_m, hit, direction, footprint_m), direction * hit.distance_m);
}

struct Found {
    place_m: vec2f,
    at_m: f32,
    mirror_m: vec2f,
    shadow: f32
}

fn plain(ray: WaveRay, strength: f32) -> Found {
    let raw = wave_height(wave_map, tiled, ray.place_m, frame.time_s, ray.footprint_m).x;
    let height = 0.5 + 0.5 * raw / CREST_M;
    let offset = fixed_view_offset(height, frame.parallax_factor);
    let unit_m = FIXED_UNIT_M * strength;
    let ratio = 1.0 / max(length(ray.run), 0.001);
    return Found(ray.place_m - offset * unit_m, 0.0, ray.place_m - offset * vec2f(0.0, ratio) * unit_m, frame.parallax_factor - height);
}

fn found(ray: WaveRay, tier: u32, strength: f32) -> Found {
    let at_m = displaced(wave_map, tiled, frame, ray, tier);
    let place_m = ray_place(ray, at_m);
    let raw = wave_height(wave_map, tiled, place_m, frame.time_s, ray.footprint_m).x;
    return Found(place_m, at_m, place_m, shadow_share(parallax_of(frame, tier), raw * strength, strength));
}

fn eye() -> vec3f {
    let wrapped = frame.pattern_eye_m;
    let east_south = select(wrapped, wrapped - PATTERN_PERIOD_M, wrapped > vec2f(0.5 * PATTERN_PERIOD_M));
    return vec3f(east_south.x, frame.eye_height_m, east_south.y);
}

fn floor_m(z_m: f32) -> f32 {
    return FLOOR_FALL * (SHORE_Z_M - z_m);
}

fn strength_at(z_m: f32) -> f32 {
    return frame.wave_steepness * BREEZE * smoothstep(0.0, 1.6, -floor_m(z_m));
}

fn water_light(panel: u32, direction: vec3f, distance_m: f32, pixel_rad: f32) -> vec3f {
    let eye_m = eye();
    let sinking = max(-direction.y, 1e-5);
    let offset_m = direction * distance_m;
    let plane_m = eye_m.xz + offset_m.xz;
    let footprint_m = distance_m * pixel_rad * inverseSqrt(sinking);
    let strength = strength_at(plane_m.y);
    let ray = wave_ray(frame, plane_m, -direction, eye_m.y, footprint_m, strength);
    var point: Found;
    if panel == 0u {
        point = plain(ray, strength);
    }
    else {
        point = found(ray, select(frame.water_tier, WATER_MARCH, panel == 2u), strength);
    }
    let waves = waves_at(wave_map, tiled, point.place_m, frame.time_s, footprint_m, strength);
    let normal = normalize(vec3f(-waves.slope.x, 1.0, -waves.slope.y));
    let at_m = vec3f(point.place_m.x, point.at_m, point.place_m.y);
    let cosine = clamp(dot(normal, -direction), 0.0, 1.0);
    let reflectance = rough_reflectance(cosine, sqrt(waves.variance));
    let bent = refract(direction, normal, 1.0 / WATER_INDEX);
    let below = trace(at_m, bent);
    let floor_at = at_m + bent * below.distance_m;
    let depth_m = max(-floor_at.y, 0.01);
    let floor_light = land_light(floor_at, below, bent, footprint_m) * caustics(floor_at.xz, depth_m, frame.time_s, footprint_m);
    var light = through_water(frame, floor_light, depth_m, clamp(below.distance_m / depth_m, 1.0, 4.0), 1.0);
    light = mix(light, light * TROUGH_SHADOW, point.shadow);
    light += crest_glow(frame, direction, waves.height_m / max(CREST_M * strength, 1e-6)) * smoothstep(0.3, 2.0, depth_m);
    var mirrored = reflect(direction, normal);
    mirrored.y = max(abs(mirrored.y), 0.001);
    let mirror_from = vec3f(point.mirror_m.x, max(point.at_m, floor_m(point.mirror_m.y)), point.mirror_m.y);
    light = mix(light, lit_through_air(mirror_from, normalize(mirrored), footprint_m), reflectance);
    light += glitter(frame, direction, waves.slope, waves.variance, cosine) * sun_share(at_m);
    light = mix(light, foam_light(frame, 1.0), foam(floor_m(point.place_m.y), point.place_m, frame.time_s, footprint_m));
    return apply_aerial_perspective(frame, light, offset_m);
}

fn scene_light(panel: u32, direction: vec3f, pixel_rad: f32) -> vec3f {
    let eye_m = eye();
    let hit = trace(eye_m, direction);
    let at_m = eye_m + direction * hit.distance_m;
    let footprint_m = hit.distance_m * pixel_rad;
    if eye_m.y <= 0.0 {
        return scene_from_below(direction, hit, at_m, pixel_rad);
    }
    let to_plane_m = eye_m.y / max(-direction.y, 1e-5);
    if direction.y < 0.0 && to_plane_m < hit.distance_m {
        return water_light(panel, direction, to_plane_m, pixel_rad);
    }
    if hit.kind == NO_HIT {
        let aerial = aerial_perspective(frame, direction, SPACE_M);
        return aerial.inscattering + sun_disc(frame, direction, aerial.transmittance);
    }
    var light = land_light(at_m, hit, direction, footprint_m);
    if hit.kind == SAND {
        let cover = foam(at_m.y, at_m.xz, frame.time_s, footprint_m);
        light = mix(light, foam_light(frame, 1.0), cover);
    }
    return apply_aerial_perspective(frame, light, direction * hit.distance_m);
}

fn scene_from_below(direction: vec3f, hit: Hit, at_m: vec3f, pixel_rad: f32) -> vec3f {
    let eye_m = eye();
    let depth_m = -eye_m.y;
    let to_plane_m = depth_m / max(direction.y, 0.0001);
    if direction.y <= 0.0001 || hit.distance_m < to_plane_m {
        if hit.kind == NO_HIT {
            return water_fog(frame, depth_m, direction);
        }
        let sunk_m = max(-at_m.y, 0.0);
        let floor_light = land_light(at_m, hit, direction, hit.distance_m * pixel_rad) * caustics(at_m.xz, sunk_m, frame.time_s, hit.distance_m * pixel_rad);
        return fogged(frame, floor_light * exp(-0.06 * sunk_m), hit.distance_m, depth_m, direction);
    }
    let place_m = eye_m.xz + direction.xz * to_plane_m;
    let footprint_m = to_plane_m * pixel_rad * inverseSqrt(max(direction.y, 0.0001));
    let waves = waves_at(wave_map, tiled, place_m, frame.time_s, footprint_m, strength_at(place_m.y));
    let normal = normalize(vec3f(-waves.slope.x, 1.0, -waves.slope.y));
    return fogged(frame, surface_from_below(frame, direction, normal, depth_m), to_plane_m, depth_m, direction);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let width = max(floor(frame.viewport.x / 3.0), 1.0);
    let panel = clamp(floor(position.x / width), 0.0, 2.0);
    let inside = position.x - panel * width;
    if panel > 0.0 && inside < SEPARATOR_PX {
        return vec4f(SEPARATOR, 1.0);
    }
    let centred = vec2f(inside - 0.5 * width + 0.5 * frame.viewport.x, position.y);
    let direction = normalize(view_ray(frame, centred));
    return vec4f(scene_light(u32(panel), direction, 1.0 / frame.pixels_per_radian), 1.0);
}

const ABSORPTION = vec3f(0.42, 0.085, 0.055);

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

const BURLEY_ENERGY: f32 = 1.0 / 1.51;

const CAPILLARY_VARIANCE: f32 = 0.0012;

const CHOP = WaveBand(vec2f(151.0, -83.0), 0.24, 2.6);

const CLUMP_DEPTH: f32 = 3.0;

const CREST_M: f32 = SWELL.crest_m + CHOP.crest_m;

const DEEPEST: f32 = 20.0;

const DEEP_WATER = vec3f(0.0028, 0.0195, 0.046);

const DIELECTRIC_F0: f32 = 0.04;

const DIFFUSE_BURLEY: u32 = 1u;

const EARTH_RADIUS_M: f32 = 6371000.0;

const EYE_SHARE: f32 = 0.5;

const FADE_SHIFT_PX = vec2f(0.4, 1.2);

const FADE_TRAVEL_M = vec2f(32.0, 64.0);

const FIXED_RAISE: f32 = 0.2;

const FIXED_UNIT_M: f32 = 10.0 * CREST_M;

const FIXED_VIEW = vec3f(0.0, -0.707, 0.707);

const FOAM = vec3f(0.4, 0.41, 0.42);

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

const HAZE_ALBEDO: f32 = 0.94;

const HAZE_EXTINCTION = vec3f(8.8e-6, 9e-6, 9.2e-6);

const HAZE_SCALE_M: f32 = 1200.0;

const LAST_WAVE_LEVEL: f32 = 8.0;

const LEAF_SHARE: f32 = 0.25;

const MAX_GLOSS: f32 = 64.0;

const MIN_NV: f32 = 0.0001;

const MIN_ROUGHNESS: f32 = 0.045;

const MOST_FOAM: f32 = 0.85;

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

const RAYLEIGH_SCALE_M: f32 = 8000.0;

const RAYLEIGH_SCATTERING = vec3f(5.8e-6, 1.35e-5, 3.31e-5);

const RIPPLE = WaveBand(vec2f(613.0, 419.0), 0.045, 1.1);

const SHALLOW_WATER = vec3f(0.0093, 0.103, 0.11);

const SHARP_ROUGHNESS: f32 = 0.35;

const SPACE_M: f32 = 10000000.0;

const SUN_RADIANCE = vec3f(4.68, 4.52, 4.36);

const SUN_RADIUS: f32 = 0.004651;

const SWELL = WaveBand(vec2f(37.0, 13.0), 0.62, 5.2);

struct ShadingAngles {
    nl: f32,
    nv: f32,
    lh: f32,
    middle: vec3f
}

struct Surface {
    albedo: vec3f,
    normal: vec3f,
    roughness: f32,
    occlusion: f32,
    leaves: f32
}

const TANGENT_FLOOR: f32 = 0.35;

const TROUGH_SHADOW = vec3f(0.1, 0.32, 0.5);

const VISIBILITY_FAST: u32 = 1u;

const WATER_F0: f32 = 0.02;

const WATER_FLAT: u32 = 0u;

const WATER_INDEX: f32 = 1.333;

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

fn burley_diffuse(nl: f32, nv: f32, lh: f32, roughness: f32) -> f32 {
    let rise = 2.0 * roughness * lh * lh - 0.5;
    let light = 1.0 + rise * fifth_power(1.0 - nl);
    let view = 1.0 + rise * fifth_power(1.0 - nv);
    return light * view * mix(1.0, BURLEY_ENERGY, roughness);
}

fn caustics(pattern_m: vec2f, depth_m: f32, time_s: f32, footprint_m: f32) -> f32 {
    let seen = clamp(1.4 - 2.8 * footprint_m, 0.0, 1.0) * smoothstep(0.0, 0.5, depth_m) * exp(-0.22 * depth_m);
    if seen <= 0.0 {
        return 1.0;
    }
    let bend = pattern_gradient(pattern_m + vec2f(0.31, 0.17) * time_s, 2.0, 51u);
    let bent = pattern_m + 0.55 * bend.yz;
    let one = pattern(bent + vec2f(-0.23, 0.29) * time_s, 1.0, 52u);
    let two = pattern(vec2f(2.0 * bent.x + bent.y, 2.0 * bent.y - bent.x) + vec2f(0.6, -0.4) * time_s, 2.0, 53u);
    let lines = pow(1.0 - abs(2.0 * one - 1.0), 7.0) + pow(1.0 - abs(2.0 * two - 1.0), 7.0);
    return 1.0 + seen * (1.15 * lines - 0.5);
}

fn crest_glow(frame: Frame, direction: vec3f, height: f32) -> vec3f {
    let level = dot(direction.xz, frame.sun.xz);
    let lengths = dot(direction.xz, direction.xz) * dot(frame.sun.xz, frame.sun.xz);
    let toward = max(level * inverseSqrt(lengths + 0.0001), 0.0);
    let sunward = 0.35 + 0.65 * toward * toward;
    return SHALLOW_WATER * frame.atmosphere.sun * (0.5 * smoothstep(0.16, 0.85, height) * sunward * max(frame.sun.y, 0.0));
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

fn fifth_power(x: f32) -> f32 {
    let squared = x * x;
    return squared * squared * x;
}

fn fixed_view_offset(height: f32, parallax_factor: f32) -> vec2f {
    return FIXED_VIEW.xy / FIXED_VIEW.z * height * parallax_factor + FIXED_RAISE;
}

fn foam(height_m: f32, pattern_m: vec2f, time_s: f32, footprint_m: f32) -> f32 {
    let ragged = pattern(pattern_m + vec2f(0.11, -0.07) * time_s, 4.0, 9u) * 0.55 + pattern(pattern_m, 16.0, 10u) * 0.45;
    let phase = pattern(pattern_m, 128.0, 11u) * 18.0;
    let reach = -0.15 + 0.22 * sin(time_s * 0.7 + phase);
    let swash = 1.0 - smoothstep(0.0, 0.22, abs(height_m - reach - (ragged - 0.5) * 0.3));
    let depth_m = max(-height_m, 0.0);
    let travelled = depth_m / 0.9 + time_s * 0.11 + phase * 0.16 + (ragged - 0.5) * 0.5;
    let from_line = abs(fract(travelled) - 0.5) * 0.9;
    let line = 1.0 - smoothstep(0.0, 0.16, from_line);
    let breaking = (1.0 - smoothstep(0.7, 2.4, depth_m)) * smoothstep(0.02, 0.3, depth_m) * smoothstep(0.46, 0.72, ragged);
    let white = clamp(swash * smoothstep(0.22, 0.55, ragged) + 0.6 * line * breaking, 0.0, MOST_FOAM);
    let close = clamp(1.5 - footprint_m * 8.0, 0.0, 1.0);
    if white * close <= 0.0 {
        return white;
    }
    let drifting = pattern_m + vec2f(0.05, 0.08) * time_s;
    let across = vec2f(2.0 * drifting.x + drifting.y, 2.0 * drifting.y - drifting.x);
    let fine = clamp(1.5 - footprint_m * 24.0, 0.0, 1.0);
    let lace = pattern(drifting, 0.5, 13u) * 0.5 + pattern(across, 0.5, 14u) * 0.3 + mix(0.5, pattern(drifting, 0.125, 15u), fine) * 0.2;
    let torn = smoothstep(0.72 - 0.62 * white, 1.02 - 0.42 * white, lace) * (0.6 + 0.8 * lace);
    return mix(white, min(torn * white * 1.6, MOST_FOAM), close);
}

fn foam_light(frame: Frame, sun: f32) -> vec3f {
    return FOAM * light_on_water(frame, sun);
}

fn fogged(frame: Frame, light: vec3f, path_m: f32, depth_m: f32, direction: vec3f) -> vec3f {
    return mix(water_fog(frame, depth_m, direction), light, exp(-ABSORPTION * path_m));
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

fn glitter(frame: Frame, direction: vec3f, slope: vec2f, variance: f32, cosine: f32) -> vec3f {
    let between = frame.sun - direction;
    if between.y < 0.001 || frame.sun.y <= 0.0 {
        return vec3f(0.0);
    }
    let middle = normalize(between);
    let off = middle.xz / middle.y + slope;
    let width = max(2.0 * variance, 0.0001);
    let facets = exp(-dot(off, off) / width) / (width * pow(middle.y, 4.0));
    let glint = smooth_reflectance(dot(middle, frame.sun)) * facets / (4.0 * max(cosine, 0.08));
    return frame.atmosphere.sun * (glint / (1.0 + 0.25 * glint));
}

fn haze_phase(cosine: f32) -> f32 {
    const G: f32 = 0.76;
    let base = max(1.0 + G * G - 2.0 * G * cosine, 0.001);
    return 1.5 * (1.0 - G * G) / (2.0 + G * G) * (1.0 + cosine * cosine) / (base * sqrt(base));
}

fn lattice_value(cell: vec2i, mask: i32, salt: u32) -> f32 {
    let wrapped = vec2u(cell & vec2i(mask));
    return f32(pattern_hash(wrapped.x + salt * 2654435769u, wrapped.y) >> 8u) * (1.0 / 16777216.0);
}

fn leaf_sun(facing: f32) -> f32 {
    return 0.5 * exp(-CLUMP_DEPTH * max(-facing, 0.0));
}

fn light_on_water(frame: Frame, sun: f32) -> vec3f {
    return frame.atmosphere.sun * (max(frame.sun.y, 0.0) * sun) + ambient(frame, vec3f(0.0, 1.0, 0.0));
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

fn parallax_of(frame: Frame, tier: u32) -> f32 {
    return select(frame.parallax_factor, 0.0, tier == WATER_FLAT);
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

fn ray_place(ray: WaveRay, height_m: f32) -> vec2f {
    return ray.place_m + ray.run * height_m;
}

fn rayleigh_phase(cosine: f32) -> f32 {
    return 0.75 * (1.0 + cosine * cosine);
}

fn rough_reflectance(cosine: f32, deviation: f32) -> f32 {
    let grazing = pow(1.0 - cosine, 5.0 * exp(-2.69 * deviation)) / (1.0 + 22.7 * pow(deviation, 1.5));
    return WATER_F0 + (1.0 - WATER_F0) * grazing;
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

fn shadow_share(parallax_factor: f32, height_m: f32, strength: f32) -> f32 {
    let height = 0.5 + 0.5 * clamp(height_m / max(CREST_M * strength, 1e-6), -1.0, 1.0);
    return clamp(parallax_factor - height, 0.0, 1.0);
}

fn sky_radiance(frame: Frame, direction: vec3f) -> vec3f {
    return aerial_perspective(frame, direction, SPACE_M).inscattering;
}

fn smooth_reflectance(cosine: f32) -> f32 {
    return WATER_F0 + (1.0 - WATER_F0) * pow(1.0 - clamp(cosine, 0.0, 1.0), 5.0);
}

fn specular_albedo(f0: f32, roughness: f32, nv: f32) -> f32 {
    let r = vec4f(-1.0, -0.0275, -0.572, 0.022) * roughness + vec4f(1.0, 0.0425, 1.04, -0.04);
    let narrow = min(r.x * r.x, exp2(-9.28 * nv)) * r.x + r.y;
    let scale = -1.04 * narrow + r.z;
    let bias = 1.04 * narrow + r.w;
    return clamp(f0 * scale + bias * clamp(50.0 * f0, 0.0, 1.0), 0.0, 1.0);
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

fn sun_disc(frame: Frame, direction: vec3f, left: vec3f) -> vec3f {
    let off = length(direction - frame.sun);
    let edge = smoothstep(0.9 * SUN_RADIUS, 1.1 * SUN_RADIUS, off);
    return SUN_RADIANCE * left * (56.0 * (1.0 - edge));
}

fn sun_share(at_m: vec3f) -> f32 {
    var share = 1.0;
    for (var index = 0u; index < 7u; index++) {
        let sphere = boulders[index];
        let chord = sphere_chord(at_m, frame.sun, sphere);
        if chord.y > 0.0 {
            share = min(share, 1.0 - smoothstep(-0.02, 0.02, chord.x / (2.0 * sphere.w * max(chord.y, 0.1))));
        }
    }
    return share;
}

fn surface_from_below(frame: Frame, direction: vec3f, normal: vec3f, depth_m: f32) -> vec3f {
    let bent = refract(direction, -normal, WATER_INDEX);
    var mirrored = reflect(direction, -normal);
    mirrored.y = min(mirrored.y, 0.0);
    let inner = water_fog(frame, depth_m, mirrored);
    if dot(bent, bent) < 0.5 {
        return inner;
    }
    let above = normalize(vec3f(bent.x, max(bent.y, 0.0), bent.z) + vec3f(0.0, 0.0001, 0.0));
    let aerial = aerial_perspective(frame, above, SPACE_M);
    let sky = aerial.inscattering + sun_disc(frame, above, aerial.transmittance);
    return mix(sky, inner, smooth_reflectance(dot(bent, normal)));
}

fn surface_on_ray(map: texture_2d<f32>, tiled: sampler, frame: Frame, ray: WaveRay, at_m: f32) -> vec3f {
    return ray.gain * wave_height(map, tiled, ray_place(ray, at_m + ray.bias_m), frame.time_s, ray.footprint_m);
}

fn through_water(frame: Frame, floor_colour: vec3f, depth_m: f32, slant: f32, sun: f32) -> vec3f {
    let left = exp(-ABSORPTION * depth_m * (1.0 + slant));
    let veil = 1.0 - exp(-0.16 * depth_m * slant);
    return mix(floor_colour * left, water_body(frame, depth_m, sun), veil);
}

fn view_ray(frame: Frame, position: vec2f) -> vec3f {
    let ndc = position / frame.viewport * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0);
    return frame.ray_forward + ndc.x * frame.ray_right + ndc.y * frame.ray_up;
}

fn water_body(frame: Frame, depth_m: f32, sun: f32) -> vec3f {
    return light_on_water(frame, sun) * mix(SHALLOW_WATER, DEEP_WATER, 1.0 - exp(-depth_m * 0.11));
}

fn water_fog(frame: Frame, depth_m: f32, direction: vec3f) -> vec3f {
    let lightness = exp(-0.07 * depth_m) * (0.3 + 0.55 * smoothstep(-0.6, 0.9, direction.y));
    return light_on_water(frame, 1.0) * mix(DEEP_WATER, SHALLOW_WATER, lightness);
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
