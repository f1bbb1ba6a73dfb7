@group(0) @binding(0)
var<uniform> frame: Frame;

@group(0) @binding(1)
var<storage, read> heights: array<i32>;

@group(0) @binding(2)
var<storage, read> sun_clearances: array<u32>;

@group(1) @binding(0)
var material_colours: texture_2d_array<f32>;

@group(1) @binding(1)
var material_shapes: texture_2d_array<f32>;

@group(1) @binding(2)
var material_sampler: sampler;

@group(1) @binding(3)
var material_heights: texture_2d_array<f32>;

@group(1) @binding(4)
var material_max_mips: texture_2d_array<f32>;

@group(2) @binding(0)
var<uniform> clipmap: Clipmap;

@group(2) @binding(1)
var clipmap_slopes: texture_2d_array<f32>;

@group(2) @binding(2)
var clipmap_sky: texture_2d_array<f32>;

@group(2) @binding(3)
var clipmap_sampler: sampler;

@group(2) @binding(4)
var clipmap_heights: texture_2d_array<f32>;

const UNEVEN_SKY: f32 = 0.74;

const DARKEST_SKY: f32 = 0.3;

struct Instance {
    @location(0)
    origin_and_spacing: vec4f,
    @location(1)
    pattern_and_errors: vec4f,
    @location(2)
    slots_and_seams: vec4u,
    @location(3)
    inside_and_place: vec2u
}

struct Varying {
    @builtin(position)
    position: vec4f,
    @location(0)
    offset_m: vec3f,
    @location(1)
    height_m: f32,
    @location(2)
    normal: vec3f,
    @location(3)
    pattern_m: vec2f,
    @location(4)
    mesh: vec4f,
    @location(5) @interpolate(perspective, centroid)
    clearance: f32
}

fn height_m(slot: u32, column: u32, row: u32) -> f32 {
    return f32(heights[height_index(slot, column, row)]) * METRES_PER_UNIT;
}

fn difference(at: u32, low: f32, here: f32, high: f32) -> f32 {
    if at == 0u {
        return 0.5 * (4.0 * low - 3.0 * here - high);
    }
    if at == CELLS {
        return 0.5 * (3.0 * here - 4.0 * high + low);
    }
    return 0.5 * (high - low);
}

fn slope_at(slot: u32, column: u32, row: u32) -> vec2f {
    let here = height_m(slot, column, row);
    let west = select(select(column - 1u, CELLS - 2u, column == CELLS), 1u, column == 0u);
    let east = select(select(column + 1u, CELLS - 1u, column == CELLS), 2u, column == 0u);
    let north = select(select(row - 1u, CELLS - 2u, row == CELLS), 1u, row == 0u);
    let south = select(select(row + 1u, CELLS - 1u, row == CELLS), 2u, row == 0u);
    return vec2f(difference(column, height_m(slot, west, row), here, height_m(slot, east, row)), difference(row, height_m(slot, column, north), here, height_m(slot, column, south)));
}

@vertex
fn vertex(@builtin(vertex_index) index: u32, instance: Instance) -> Varying {
    let slot = instance.slots_and_seams.x;
    let parent_slot = instance.slots_and_seams.y;
    let seams = Seams(instance.slots_and_seams.z, instance.slots_and_seams.w, instance.inside_and_place.x);
    let place = instance.inside_and_place.y;
    let spacing_m = instance.origin_and_spacing.w;
    let corner = grid_vertex(index);
    let quarter = vec2u((place >> 10u) & 1u, (place >> 11u) & 1u) * (CELLS / 2u);
    let stride = select(1u, 2u, is_decimated(seams));
    let grid = snapped(seams, GridVertex(stride * corner.column + quarter.x, stride * corner.row + quarter.y));
    let morph = morph_at(seams, grid);
    var drawn = heights[height_index(slot, grid.column, grid.row)];
    var slope = slope_at(slot, grid.column, grid.row) / spacing_m;
    if morph > 0 {
        let low = vec2u(((place >> 8u) & 1u) * (CELLS / 2u) + (grid.column >> 1u), ((place >> 9u) & 1u) * (CELLS / 2u) + (grid.row >> 1u));
        let high = low + vec2u(grid.column & 1u, grid.row & 1u);
        let parent = (heights[height_index(parent_slot, low.x, low.y)] + heights[height_index(parent_slot, high.x, high.y)]) >> 1u;
        drawn = morphed(drawn, parent, morph);
        let parent_slope = (slope_at(parent_slot, low.x, low.y) + slope_at(parent_slot, high.x, high.y)) / (4.0 * spacing_m);
        slope = mix(slope, parent_slope, f32(morph) / 64.0);
    }
    let here_m = f32(drawn) * METRES_PER_UNIT;
    let local = vec2f(f32(grid.column), f32(grid.row)) * spacing_m;
    let exact = instance.origin_and_spacing.xyz + vec3f(local.x, here_m, local.y);
    let offset_m = exact - frame.eye_fraction_m;
    let share = f32(morph) / 64.0;
    var out: Varying;
    out.position = frame.clip_from_camera * vec4f(offset_m, 1.0);
    out.offset_m = offset_m;
    out.height_m = here_m;
    out.normal = vec3f(-slope.x, 1.0, -slope.y);
    out.pattern_m = instance.pattern_and_errors.xy + local;
    out.mesh = vec4f(f32(grid.column / stride), f32(grid.row / stride), mix(instance.pattern_and_errors.z, instance.pattern_and_errors.w, share), f32(place & 255u) + 0.001 + 0.998 * share);
    out.clearance = clearance_at(sun_clearances[clearance_word(slot, grid.column, grid.row)], grid.column);
    return out;
}

struct TerrainFragment {
    point: GroundPoint,
    sky: f32,
    direction: vec3f,
    distance_m: f32
}

fn terrain_fragment(in: Varying) -> TerrainFragment {
    let distance_m = length(in.offset_m);
    let direction = in.offset_m / max(distance_m, 1e-6);
    let mesh_normal = normalize(in.normal);
    let right_m = dpdx(in.offset_m);
    let down_m = dpdy(in.offset_m);
    let mesh_slope = -mesh_normal.xz / max(mesh_normal.y, 0.001);
    var point = GroundPoint(in.height_m, mesh_normal, mesh_slope, in.offset_m, right_m, down_m);
    let pixel_m = distance_m / frame.pixels_per_radian;
    let on_land_m = land_point(clipmap, clipmap_heights, frame.eye_height_m, in.offset_m, pixel_m);
    let shape = land_shape(clipmap, clipmap_slopes, clipmap_sky, clipmap_sampler, on_land_m.xz, direction, pixel_m);
    if shape.is_known {
        let normal = slope_normal(shape.slope);
        let footprint = footprint_on(frame, on_land_m, normal);
        point = GroundPoint(frame.eye_height_m + on_land_m.y, normal, shape.broad, on_land_m, footprint.right_m, footprint.down_m);
    }
    return TerrainFragment(point, shape.sky, direction, distance_m);
}

@fragment
fn fragment(in: Varying) -> @location(0) vec4f {
    let fragment = terrain_fragment(in);
    let point = fragment.point;
    let direction = fragment.direction;
    var here = ground(material_colours, material_shapes, material_heights, material_max_mips, material_sampler, frame, point);
    let trees = tree_shade(frame, in.offset_m, here.wood, 0.5 * length(point.offset_ddx_m));
    let open = fragment.sky * trees.sky;
    let bounce = ground_bounce(frame, here.surface, open);
    here.surface.occlusion = max(here.surface.occlusion * UNEVEN_SKY, DARKEST_SKY) * open;
    let open_sun = sun_share(frame, in.clearance) * cloud_shade(frame, in.pattern_m);
    let sun = open_sun * here.sun * trees.sun;
    var light = lit(frame, here.surface, -direction, sun) + bounce;
    if point.height_m < 0.4 || frame.eye_height_m <= 0.0 {
        let pattern_m = in.pattern_m + (point.offset_m.xz - in.offset_m.xz);
        let footprint_m = sqrt(length(point.offset_ddx_m) * length(point.offset_ddy_m));
        light = under_sea(frame, light, SeaFloor(point.height_m, pattern_m, point.offset_m, direction, footprint_m, open_sun, open_sea(clipmap, clipmap_heights, point.offset_m.xz)));
    }
    if frame.eye_height_m <= 0.0 {
        return vec4f(light, 1.0);
    }
    light = apply_aerial_perspective(frame, light, in.offset_m);
    let gone = dissolve(frame, in.offset_m);
    if gone > 0.0 {
        let behind = select(beyond(frame, direction), apply_aerial_perspective(frame, deep_water(frame, 1.0), in.offset_m), in.height_m < 0.0);
        light = mix(light, behind, gone);
    }
    return vec4f(light, 1.0);
}

@fragment
fn fragment_inspected(in: Varying) -> @location(0) vec4f {
    let fragment = terrain_fragment(in);
    let lines = mesh_lines(in.mesh.xy, fwidth(in.mesh.xy));
    let normal = fragment.point.normal;
    var colour = inspected(frame, normal, in.mesh.z, in.mesh.w, fragment.distance_m);
    if frame.show == SHOW_WIREFRAME {
        colour = mix(colour, vec3f(0.9, 0.95, 1.0), lines);
    }
    if frame.show == SHOW_CHUNKS {
        colour = chunk_colour(in.pattern_m, in.mesh.w);
    }
    else if frame.show == SHOW_LIGHT {
        let white = Surface(vec3f(0.5), normal, 1.0, fragment.sky, 0.0);
        colour = lit(frame, white, -fragment.direction, sun_share(frame, in.clearance)) + ground_bounce(frame, Surface(vec3f(0.5), normal, 1.0, 1.0, 0.0), fragment.sky);
    }
    return vec4f(colour, -fragment.distance_m);
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

const BLOCK_SCALE: f32 = 8.0;

const BLOCK_SHADE: f32 = 0.6;

const BOUNCE_ALBEDO = vec3f(0.115, 0.11, 0.07);

const BOUNCE_LIT: f32 = 0.6;

const BROAD_M: f32 = 64.0;

const BROWN_TINT = vec3f(1.1, 1.0, 0.9);

const BRUSH = vec3f(0.044, 0.076, 0.024);

const BURLEY_ENERGY: f32 = 1.0 / 1.51;

struct Bracket {
    near: f32,
    far: f32,
    near_clearance: f32,
    far_clearance: f32
}

const CANOPY_CELL_M: f32 = 8.0;

const CELLS: u32 = 64u;

const CLEARANCE_RANGE: f32 = 8.0;

const CLEARANCE_ROW_WORDS: u32 = (VERTICES + 3u) / 4u;

const CLEARANCE_WORDS: u32 = CLEARANCE_ROW_WORDS * VERTICES;

const CLIFF: u32 = 4u;

const CLIPMAP_BLEND_FROM: f32 = 0.7;

const CLIPMAP_LEVELS: u32 = 10u;

const CLOUD_DRIFT_M = vec2f(9.0, 4.0);

const CLOUD_FADE_M: f32 = 300.0;

const CLOUD_HEIGHT_M: f32 = 1600.0;

const CLUMP_DEPTH: f32 = 3.0;

const COBBLES: u32 = 6u;

const COLUMN_BITS: u32 = 7u;

const COLUMN_MASK: u32 = 127u;

const CREASE_SLOPE: f32 = 0.24;

const CROWN_MARGIN_M: f32 = 3.4;

struct Canopy {
    shade: f32,
    slope: vec2f
}

struct Caster {
    root_m: vec3f,
    width_m: f32,
    height_m: f32,
    species: u32
}

struct Clipmap {
    levels: array<vec4f, 10>,
    count: u32,
    vertical_scale: f32,
    reach_m: f32,
    spacing_m: f32,
    texels: f32,
    reserved_a: f32,
    reserved_b: f32,
    reserved_c: f32
}

struct ClipmapBlend {
    level: u32,
    share: f32
}

struct Cover {
    shares: array<f32, 7>,
    albedo: array<vec3f, 7>,
    slope: vec2f,
    wood: f32,
    open: f32
}

struct Crown {
    wide_m: f32,
    rise_m: f32,
    radius_m: f32,
    is_cone: bool,
    density: f32
}

const DARK_ROCK = vec3f(0.115, 0.098, 0.082);

const DEEPEST: f32 = 20.0;

const DEEP_WATER = vec3f(0.0028, 0.0195, 0.046);

const DIELECTRIC_F0: f32 = 0.04;

const DIFFUSE_BURLEY: u32 = 1u;

const DOME_M: f32 = 5.0;

const DRY_GRASS: u32 = 2u;

const DRY_SAND = vec3f(0.56, 0.43, 0.26);

const EARTH_RADIUS_M: f32 = 6371000.0;

const FAR_DEVIATION: f32 = 0.13;

const FETCH_M: f32 = 160.0;

const FOAM = vec3f(0.4, 0.41, 0.42);

const FOREST = vec3f(0.019, 0.044, 0.014);

struct Facing {
    axes: vec2u,
    shares: vec2f
}

struct Footprint {
    right_m: vec3f,
    down_m: vec3f
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

const GAP_SHADE: f32 = 0.363;

const GRASS = vec3f(0.07, 0.118, 0.028);

const GRASS_RANGE_M: f32 = 4096.0;

const GREY_TINT = vec3f(0.84, 0.93, 1.02);

const GULLY_CELL_M: f32 = 256.0;

const GULLY_DEPTH: f32 = 0.065;

const GULLY_EASE: f32 = 0.7;

const GULLY_OCTAVES: u32 = 3u;

const GULLY_STEEP = vec2f(0.12, 0.5);

const GULLY_STEP: f32 = 4.0;

const GULLY_WAVES: f32 = 2.2;

struct GridVertex {
    column: u32,
    row: u32
}

struct Ground {
    surface: Surface,
    sun: f32,
    wood: f32
}

struct GroundPoint {
    height_m: f32,
    normal: vec3f,
    broad_slope: vec2f,
    offset_m: vec3f,
    offset_ddx_m: vec3f,
    offset_ddy_m: vec3f
}

struct GroundPom {
    shift_m: vec3f,
    sun: f32
}

struct GroundTexel {
    texel: MaterialTexel,
    gradient: vec3f
}

const HAZE_ALBEDO: f32 = 0.94;

const HAZE_EXTINCTION = vec3f(8.8e-6, 9e-6, 9.2e-6);

const HAZE_SCALE_M: f32 = 1200.0;

const HEIGHTS_EXACT: u32 = 1u;

const HEX_CONTRAST: f32 = 0.6;

const HEX_PER_TILE: f32 = 2.0;

const HEX_SHEAR: f32 = 37.0 / 64.0;

const HEX_STRETCH: f32 = 37.0 / 32.0;

struct HexCorners {
    one: vec2i,
    two: vec2i,
    three: vec2i,
    weights: vec3f
}

const LAND_STEPS: u32 = 2u;

const LEAF_SHARE: f32 = 0.25;

const LEAST_FACING: f32 = 0.03;

const LEAST_FALL: f32 = 0.005;

const LEAST_SECOND: f32 = 0.01;

const LEDGE_PIXELS: f32 = 4.0;

const LEDGE_STEEP = vec2f(0.25, 0.7);

const LIGHT_ROCK = vec3f(0.4, 0.385, 0.36);

const LOOP_FLAG: u32 = 1u;

const LOWEST_CAST: f32 = 0.1;

const LOWEST_SUN: f32 = 0.02;

const LUMINANCE = vec3f(0.2126, 0.7152, 0.0722);

struct LandShape {
    slope: vec2f,
    broad: vec2f,
    sky: f32,
    is_known: bool
}

struct LeadingTap {
    tap: MaterialTap,
    lead: f32
}

const MATERIAL_ANCHOR_M: f32 = 256.0;

const MATERIAL_COUNT: u32 = 7u;

const MATERIAL_END_M: f32 = 0.9;

const MATERIAL_SETS = array<MaterialSet, 7>(MaterialSet(4.0, 0.05, 0.05, vec3f(0.4868, 0.374, 0.2264)), MaterialSet(4.0, 0.06, 1.0, vec3f(0.0526, 0.0806, 0.0235)), MaterialSet(4.0, 0.07, 1.0, vec3f(0.1447, 0.1192, 0.0579)), MaterialSet(8.0, 0.36, 1.0, vec3f(0.0541, 0.0908, 0.0236)), MaterialSet(8.0, 0.34, 0.0, vec3f(0.1788, 0.1562, 0.1271)), MaterialSet(4.0, 0.16, 1.0, vec3f(0.1267, 0.1131, 0.0966)), MaterialSet(4.0, 0.1, 1.0, vec3f(0.1895, 0.1699, 0.1328)));

const MATERIAL_SHARPENING: f32 = 2.0;

const MAX_GLOSS: f32 = 64.0;

const MAX_NODE_VISITS: u32 = 8192u;

const MEADOW: u32 = 1u;

const METRES_PER_UNIT: f32 = 0.00390625;

const MIN_NV: f32 = 0.0001;

const MIN_ROUGHNESS: f32 = 0.045;

const MORPH_BAND: u32 = 1u;

const MORPH_BAND_BITS: u32 = 0u;

const MOST_FOAM: f32 = 0.85;

const MOST_MOVE: f32 = 0.05;

struct MaterialPlace {
    near_m: vec2f,
    anchor_m: vec2f,
    ddx_m: vec2f,
    ddy_m: vec2f,
    scale: f32
}

struct MaterialSet {
    tile_m: f32,
    relief_m: f32,
    turn: f32,
    mean: vec3f
}

struct MaterialTap {
    at: MaterialUv,
    weight: f32,
    turn: vec2f
}

struct MaterialTexel {
    albedo: vec3f,
    height: f32,
    slope: vec2f,
    roughness: f32,
    occlusion: f32
}

struct MaterialUv {
    uv: vec2f,
    ddx: vec2f,
    ddy: vec2f
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

struct MeadowTint {
    dryness: f32,
    shade: f32
}

struct NodeExit {
    low: vec2i,
    high: vec2i,
    exits: vec2f,
    exit: f32
}

const PATTERN_PERIOD_M: f32 = 8192.0;

const PINE: u32 = 1u;

const POM_AUTO: u32 = 5u;

const POM_CONES: u32 = 3u;

const POM_FLAT: u32 = 0u;

const POM_GRAZING = vec2f(0.02, 0.1);

const POM_LEAD: f32 = 0.12;

const POM_LINEAR: u32 = 2u;

const POM_MAX_MIP: u32 = 4u;

const POM_MAX_STEPS: u32 = 256u;

const POM_OFFSET: u32 = 1u;

const POM_SHADOW_OFF: u32 = 0u;

const POM_SHADOW_SOFT: u32 = 2u;

struct Patterns {
    turned_m: vec2f,
    footprint_m: f32,
    broad: f32,
    medium: f32,
    fine: f32,
    clumps: f32,
    tufts: f32
}

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

struct PomTrace {
    pom: PomParams,
    map: PomMap,
    ray: PomRay
}

const RAYLEIGH_SCALE_M: f32 = 8000.0;

const RAYLEIGH_SCATTERING = vec3f(5.8e-6, 1.35e-5, 3.31e-5);

const REEF = vec3f(0.06, 0.085, 0.06);

const REFINE_BISECTION: u32 = 3u;

const REFINE_NONE: u32 = 0u;

const REFINE_SECANT: u32 = 2u;

const REFINE_SEGMENT: u32 = 1u;

const ROCK = vec3f(0.205, 0.182, 0.155);

struct Rock {
    albedo: vec3f,
    slope: vec2f,
    open: f32
}

struct RockPlace {
    pattern_m: vec2f,
    turned_m: vec2f,
    height_m: f32,
    broad_slope: vec2f,
    footprint_m: f32,
    broad: f32,
    medium: f32,
    summit: f32
}

const SAND: u32 = 0u;

const SCREE: u32 = 5u;

const SEA_SAND = vec3f(0.4, 0.36, 0.25);

const SHADOWS_HARD: u32 = 1u;

const SHADOWS_OFF: u32 = 0u;

const SHADOW_EDGE_M: f32 = 250.0;

const SHADOW_START: f32 = 0.5;

const SHALLOW_WATER = vec3f(0.0093, 0.103, 0.11);

const SHAPE_STEPS: f32 = 64.0;

const SHARP_ROUGHNESS: f32 = 0.35;

const SHOW_CHUNKS: u32 = 5u;

const SHOW_ERROR: u32 = 4u;

const SHOW_LEVELS: u32 = 2u;

const SHOW_LIGHT: u32 = 6u;

const SHOW_NORMALS: u32 = 3u;

const SHOW_WIREFRAME: u32 = 1u;

const SPACE_M: f32 = 10000000.0;

const SPRUCE: u32 = 0u;

const STRAW = vec3f(0.175, 0.152, 0.06);

const SUN_RADIUS: f32 = 0.004651;

struct SeaFloor {
    height_m: f32,
    pattern_m: vec2f,
    offset_m: vec3f,
    direction: vec3f,
    footprint_m: f32,
    sun: f32,
    open_sea: f32
}

struct Seams {
    edges: u32,
    corners: u32,
    inside: u32
}

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

const THICKET: u32 = 3u;

const TILING_HEX: u32 = 2u;

const TILING_TWO_SCALE: u32 = 1u;

const TOP_SHADE: f32 = 1.62;

const TRACK = vec3f(0.27, 0.235, 0.175);

const TREES_CAST: u32 = 2u;

const TREES_FADE: f32 = 0.2;

const TREES_PER_CELL: u32 = 4u;

const TREE_CELL_M: f32 = 8.0;

const TREE_HEAD: u32 = 2u;

struct TraversalState {
    cell: vec2i,
    level: u32,
    at: f32
}

struct TreeShade {
    sun: f32,
    sky: f32
}

const UNDERGROWTH = vec3f(0.16, 0.21, 0.12);

const VERTEX_COUNT: u32 = 4225u;

const VERTICES: u32 = 65u;

const VISIBILITY_FAST: u32 = 1u;

const WATER_F0: f32 = 0.02;

const WET_SAND = vec3f(0.22, 0.165, 0.095);

const WRACK = vec3f(0.07, 0.052, 0.03);

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

fn along_plane(v: vec3f, axis: u32) -> vec2f {
    return select(select(v.xy, v.xz, axis == 1u), v.zy, axis == 0u);
}

fn along_surface(shift: vec2f, normal: vec3f, axis: u32) -> vec3f {
    let across = along_plane(normal, axis);
    let up = select(select(normal.z, normal.y, axis == 1u), normal.x, axis == 0u);
    let rise = -dot(across, shift) / select(min(up, -0.1), max(up, 0.1), up >= 0.0);
    if axis == 0u {
        return vec3f(rise, shift.y, shift.x);
    }
    return select(vec3f(shift, rise), vec3f(shift.x, rise, shift.y), axis == 1u);
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

fn beach_at(at: Patterns, height_m: f32, slope: f32) -> f32 {
    let shore_m = height_m + (at.medium - 0.5) * 2.2 + at.fine * 1.7 + at.clumps * 1.2;
    return (1.0 - smoothstep(1.9, 3.0, shore_m)) * (1.0 - smoothstep(0.16, 0.26, slope));
}

fn beds_at(at: RockPlace) -> vec2f {
    return vec2f(pattern(vec2f(at.height_m * 0.9 + at.medium * 14.0, at.broad * 60.0), 16.0, 9u), pattern(vec2f(at.height_m * 3.0, at.broad * 40.0 + at.medium * 30.0), 16.0, 6u)) - 0.5;
}

fn beyond(frame: Frame, direction: vec3f) -> vec3f {
    if frame.eye_height_m <= 0.0 {
        return water_fog(frame, -frame.eye_height_m, direction);
    }
    let sky = clouds(frame, direction, sky_radiance(frame, direction));
    let share = sea_share(frame, direction);
    if share <= 0.0 {
        return sky;
    }
    let reflectance = rough_reflectance(clamp(-direction.y, 0.0, 1.0), FAR_DEVIATION);
    let mirrored = normalize(vec3f(direction.x, -direction.y + FAR_DEVIATION * 0.5, direction.z));
    let sea = mix(deep_water(frame, 1.0), sky_radiance(frame, mirrored), reflectance);
    let offset_m = direction * (frame.eye_height_m / max(-direction.y, 1e-6));
    return mix(sky, apply_aerial_perspective(frame, sea, offset_m), share);
}

fn broader(uv: vec2f) -> vec2f {
    return vec2f(2.0 * uv.x + uv.y, 2.0 * uv.y - uv.x) / 8.0;
}

fn burley_diffuse(nl: f32, nv: f32, lh: f32, roughness: f32) -> f32 {
    let rise = 2.0 * roughness * lh * lh - 0.5;
    let light = 1.0 + rise * fifth_power(1.0 - nl);
    let view = 1.0 + rise * fifth_power(1.0 - nv);
    return light * view * mix(1.0, BURLEY_ENERGY, roughness);
}

fn canopy_at(pattern_m: vec2f) -> Canopy {
    let place = pattern_m / CANOPY_CELL_M;
    let cell = floor(place);
    let mask = i32(PATTERN_PERIOD_M / CANOPY_CELL_M) - 1;
    var top = 0.0;
    var slope = vec2f(0.0);
    var tone = 1.0;
    for (var part = 0; part < 9; part++) {
        let beside = cell + vec2f(f32(part % 3 - 1), f32(part / 3 - 1));
        let wrapped = vec2u(vec2i(beside) & vec2i(mask));
        let hash = pattern_hash(wrapped.x + 2913u, wrapped.y);
        let jitter = vec2f(f32(hash & 255u), f32((hash >> 8u) & 255u)) / 256.0;
        let own = f32((hash >> 16u) & 255u) / 255.0;
        let away = (place - beside - 0.15 - 0.7 * jitter) * CANOPY_CELL_M;
        let radius = 3.2 + 1.9 * own;
        let high = (0.55 + 0.45 * own) * (1.0 - dot(away, away) / (radius * radius));
        if high > top {
            top = high;
            slope = -2.0 * DOME_M * (0.55 + 0.45 * own) / (radius * radius) * away;
            tone = 0.82 + 0.36 * f32(hash >> 24u) / 255.0;
        }
    }
    let lit = mix(GAP_SHADE, TOP_SHADE, sqrt(min(top * 1.2, 1.0)));
    return Canopy(lit * tone, slope);
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

fn chunk_colour(pattern_m: vec2f, level: f32) -> vec3f {
    let side_m = 2.0 * f32(CELLS) * exp2(floor(level));
    let chunk = floor(pattern_m / side_m);
    let quarter = step(vec2f(0.5), pattern_m / side_m - chunk);
    let bits = pattern_hash(u32(i32(chunk.x)) + 977u * u32(level), u32(i32(chunk.y)));
    let hues = vec2f(vec2u(bits, bits >> 8u) & vec2u(255u)) / 255.0;
    return vec3f(hues, 0.125 + 0.25 * quarter.x + 0.125 * quarter.y);
}

fn clearance(heights: texture_2d_array<f32>, smooth_heights: texture_2d_array<f32>, tiled: sampler, trace: PomTrace, entry: vec2f, share: f32) -> f32 {
    let exact = trace.pom.heights == HEIGHTS_EXACT;
    let uv = entry + share * trace.ray.travel;
    return (1.0 - share) - pom_height(heights, smooth_heights, tiled, trace.map, uv, exact);
}

fn clearance_at(word: u32, column: u32) -> f32 {
    let byte = (word >> (8u * (column & 3u))) & 255u;
    let part = (f32(byte) - 128.0) / 127.0;
    return CLEARANCE_RANGE * part * abs(part);
}

fn clearance_word(slot: u32, column: u32, row: u32) -> u32 {
    return slot * CLEARANCE_WORDS + row * CLEARANCE_ROW_WORDS + (column >> 2u);
}

fn clipmap_blend(map: Clipmap, wanted: f32) -> ClipmapBlend {
    var level = min(u32(wanted), map.count);
    var share = wanted - f32(level);
    while (level < map.count && !is_level_ready(map, level)) {
        level += 1u;
        share = 0.0;
    }
    let goes_on = level + 1u < map.count && is_level_ready(map, level + 1u);
    return ClipmapBlend(level, select(0.0, share, goes_on));
}

fn clipmap_height(map: Clipmap, heights: texture_2d_array<f32>, level: u32, offset_m: vec2f) -> vec3f {
    let words = map.levels[level];
    let at = (words.xy + offset_m * words.z) * map.texels;
    let low = floor(at);
    let part = at - low;
    let side = u32(map.texels);
    let near = vec2u(max(vec2i(low) + i32(side), vec2i(0))) % vec2u(side);
    let far = (near + 1u) % vec2u(side);
    let a = textureLoad(heights, near, level, 0).x;
    let b = textureLoad(heights, vec2u(far.x, near.y), level, 0).x;
    let c = textureLoad(heights, vec2u(near.x, far.y), level, 0).x;
    let d = textureLoad(heights, far, level, 0).x;
    let north = mix(a, b, part.x);
    let south = mix(c, d, part.x);
    let slope = vec2f(mix(b - a, d - c, part.y), south - north) * (map.texels * words.z);
    return vec3f(mix(north, south, part.y), slope) * map.vertical_scale;
}

fn clipmap_level(map: Clipmap, offset_m: vec2f, footprint_m: f32) -> f32 {
    let reaches = max(abs(offset_m.x), abs(offset_m.y)) / map.reach_m;
    let octave = log2(max(reaches, 0.5)) + 1.0;
    let start = 1.0 + log2(CLIPMAP_BLEND_FROM);
    let by_distance = floor(octave) + clamp((fract(octave) - start) / (1.0 - start), 0.0, 1.0);
    let by_footprint = log2(max(footprint_m / map.spacing_m, 1.0));
    return max(by_distance, min(by_footprint, f32(map.count - 1u)));
}

fn clipmap_texel(map: Clipmap, slopes: texture_2d_array<f32>, sky: texture_2d_array<f32>, filtering: sampler, level: u32, offset_m: vec2f) -> vec3f {
    let words = map.levels[level];
    let at = words.xy + offset_m * words.z;
    let slope = textureSampleLevel(slopes, filtering, at, level, 0.0).xy;
    let open = textureSampleLevel(sky, filtering, at + 1.0 / map.texels, level, 0.0).x;
    return vec3f(slope, open);
}

fn cloud_cover(place_m: vec2f) -> f32 {
    return covered(pattern_fbm(place_m, 2048.0, 21u), pattern_fbm(place_m, 512.0, 22u));
}

fn cloud_shade(frame: Frame, pattern_m: vec2f) -> f32 {
    let cast_m = frame.sun.xz * (CLOUD_HEIGHT_M / max(frame.sun.y, LOWEST_CAST));
    let place_m = drifted(frame, pattern_m + cast_m);
    let cover = covered(pattern_fbm_seen(place_m, 2048.0, 21u, SHADOW_EDGE_M), pattern_fbm_seen(place_m, 512.0, 22u, SHADOW_EDGE_M));
    let seen = 1.0 - smoothstep(0.8 * CLOUD_HEIGHT_M, CLOUD_HEIGHT_M, frame.eye_height_m);
    return 1.0 - 0.5 * cover * seen;
}

fn clouds(frame: Frame, direction: vec3f, behind: vec3f) -> vec3f {
    if direction.y <= 0.03 || frame.eye_height_m >= CLOUD_HEIGHT_M {
        return behind;
    }
    let distance_m = (CLOUD_HEIGHT_M - frame.eye_height_m) / direction.y;
    let place_m = drifted(frame, frame.pattern_eye_m + direction.xz * distance_m);
    let cover = cloud_cover(place_m);
    if cover <= 0.0 {
        return behind;
    }
    let sunward = cloud_cover(place_m + frame.sun.xz * inverseSqrt(max(dot(frame.sun.xz, frame.sun.xz), 0.0001)) * 110.0);
    let toward = max(dot(direction, frame.sun), 0.0);
    let toward2 = toward * toward;
    let toward8 = toward2 * toward2 * toward2 * toward2;
    let sun = frame.atmosphere.sun_aloft * (0.3 * exp(-1.1 * sunward) * (1.0 + 0.9 * toward8));
    let lit = sun + 0.75 * ambient(frame, vec3f(0.0, 1.0, 0.0));
    let seen = apply_aerial_perspective(frame, lit, direction * distance_m);
    let below = smoothstep(0.0, CLOUD_FADE_M, CLOUD_HEIGHT_M - frame.eye_height_m);
    return mix(behind, seen, cover * 0.92 * below * smoothstep(0.035, 0.22, direction.y));
}

fn cover_at(height_m: f32, normal: vec3f, broad_slope: vec2f, pattern_m: vec2f, footprint_m: f32, long_m: f32) -> Cover {
    let at = patterns_at(pattern_m, footprint_m);
    let broad = at.broad;
    let medium = at.medium;
    let near = clamp(1.5 - footprint_m * 0.75, 0.0, 1.0);
    let slope = slope_of(at, normal);
    var cover: Cover;
    let track = track_at(at, height_m, 1.0 - normal.y, long_m);
    let beach = beach_at(at, height_m, slope);
    let sunk = 1.0 - smoothstep(-1.0, -0.2, height_m);
    let growth = smoothstep(0.5, 0.62, pattern_fbm_seen(pattern_m, 128.0, 7u, footprint_m)) * (1.0 - smoothstep(-4.0, -1.2, height_m));
    let dry = smoothstep(0.12, 0.42, height_m + (medium - 0.5) * 0.2 + at.fine * 0.06);
    let dry_sand = mix(WET_SAND, DRY_SAND * (0.92 + 0.16 * medium), dry);
    let shore_sand = mix(dry_sand, WRACK, 0.6 * wrack_at(at, height_m, footprint_m));
    cover.albedo[SAND] = mix(shore_sand, mix(SEA_SAND, REEF, growth * 0.85), sunk);
    let summit = summit_at(at, height_m);
    let rock = rock_at(at, slope, summit, height_m);
    let bare = rock.x;
    let stones = rock.y;
    let creases = creases_at(at.turned_m, footprint_m);
    var look = Rock(ROCK, vec2f(0.0), 1.0);
    if bare + stones > 0.0 {
        look = rock_look(RockPlace(pattern_m, at.turned_m, height_m, broad_slope, footprint_m, broad, medium, summit), creases);
    }
    cover.albedo[CLIFF] = look.albedo;
    cover.albedo[SCREE] = mix(look.albedo, ROCK, 0.3) * (1.0 + 0.6 * at.tufts);
    let woods = woods_at(at, pattern_m, height_m, normal, slope);
    let wood = woods.x;
    let crowns_seen = clamp(1.3 - max(footprint_m * 0.2, long_m * 0.09), 0.0, 1.0) * (0.2 + 0.8 * smoothstep(0.05, 0.5, footprint_m));
    var crowns = Canopy(1.0, vec2f(0.0));
    if wood * crowns_seen > 0.0 {
        crowns = canopy_at(pattern_m);
    }
    let canopy = FOREST * mix(1.0, crowns.shade, crowns_seen) * (0.75 + 0.5 * medium);
    cover.albedo[THICKET] = mix(BRUSH * (0.7 + 0.6 * medium + 0.6 * at.tufts), canopy, wood);
    let meadow = meadow_tint_at(at, height_m);
    cover.albedo[MEADOW] = GRASS * meadow.shade;
    cover.albedo[DRY_GRASS] = STRAW * meadow.shade;
    cover.albedo[COBBLES] = TRACK * (0.85 + 0.3 * medium + 0.3 * at.clumps);
    var left = 1.0;
    let sand_share = max(beach, sunk);
    cover.shares[SAND] = sand_share;
    left -= sand_share;
    cover.shares[CLIFF] = left * bare;
    left -= left * bare;
    cover.shares[COBBLES] = left * track;
    left -= left * track;
    cover.shares[SCREE] = left * stones;
    left -= left * stones;
    cover.wood = left * wood;
    cover.shares[THICKET] = left * woods.y;
    left -= left * woods.y;
    cover.shares[DRY_GRASS] = left * meadow.dryness;
    cover.shares[MEADOW] = left * (1.0 - meadow.dryness);
    let lumps = pattern_gradient(pattern_m, 4.0, 8u).yz * near * (0.15 + 0.9 * bare);
    let creased = (1.0 - sand_share) * (0.1 + 0.9 * bare + 0.35 * stones * (1.0 - bare));
    cover.slope = crowns.slope * (wood * crowns_seen * 0.7) + lumps + creases.yz * creased + look.slope * ((1.0 - sand_share) * max(bare, 0.6 * stones));
    cover.open = mix(1.0, look.open, cover.shares[CLIFF] + 0.6 * cover.shares[SCREE]);
    return cover;
}

fn covered(broad: f32, puffs: f32) -> f32 {
    return smoothstep(0.5, 0.78, broad * 0.62 + puffs * 0.38);
}

fn creases_at(turned_m: vec2f, footprint_m: f32) -> vec3f {
    var turned = vec2f(0.0);
    var depth = 0.0;
    for (var octave = 0u; octave < 2u; octave++) {
        let cell_m = select(128.0, 32.0, octave == 1u);
        let seen = clamp(1.6 - 14.0 * footprint_m / cell_m, 0.0, 1.0);
        if seen > 0.0 {
            let noise = pattern_gradient(turned_m, cell_m, 21u + octave);
            let side = clamp((noise.x - 0.5) * 16.0, -1.0, 1.0);
            turned += noise.yz * (side * seen * cell_m);
            depth += (0.18 - abs(noise.x - 0.5)) * seen;
        }
    }
    let slope = vec2f(2.0 * turned.x - turned.y, 2.0 * turned.y + turned.x) * CREASE_SLOPE;
    return vec3f(depth, slope);
}

fn crown_chord(crown: Crown, at_m: vec3f, toward: vec3f) -> f32 {
    if !crown.is_cone {
        let axes = vec3f(crown.radius_m, crown.rise_m, crown.radius_m);
        let begin = (at_m - vec3f(0.0, crown.wide_m, 0.0)) / axes;
        let step = toward / axes;
        let a = dot(step, step);
        let b = dot(begin, step);
        let inside = b * b - a * (dot(begin, begin) - 1.0);
        if inside <= 0.0 {
            return 0.0;
        }
        let root = sqrt(inside);
        return max(0.0, (root - b) - max(-root - b, 0.0)) / a;
    }
    let k = crown.radius_m / crown.rise_m;
    let y = at_m.y - (crown.wide_m + crown.rise_m);
    let up = max(toward.y, 0.0001);
    var near = max(0.0, (-crown.rise_m - y) / up);
    var far = -y / up;
    var a = dot(toward.xz, toward.xz) - k * k * up * up;
    a = select(a, 1e-5, abs(a) < 1e-5);
    let b = dot(at_m.xz, toward.xz) - k * k * y * up;
    let c = dot(at_m.xz, at_m.xz) - k * k * y * y;
    let inside = b * b - a * c;
    if inside <= 0.0 {
        return 0.0;
    }
    let root = sqrt(inside);
    if a > 0.0 {
        near = max(near, (-b - root) / a);
        far = min(far, (root - b) / a);
    }
    else {
        far = min(far, (root - b) / a);
    }
    return max(0.0, far - near);
}

fn crown_of(caster: Caster) -> Crown {
    let high = caster.height_m;
    let half = 0.5 * caster.width_m;
    if caster.species == SPRUCE {
        return Crown(0.1 * high, 0.9 * high, 0.86 * half, true, 1.5);
    }
    if caster.species == PINE {
        return Crown(0.66 * high, 0.33 * high, 0.9 * half, false, 1.0);
    }
    return Crown(0.56 * high, 0.43 * high, 0.92 * half, false, 1.0);
}

fn deep_water(frame: Frame, sun: f32) -> vec3f {
    return DEEP_WATER * light_on_water(frame, sun);
}

fn disc_share(clearance: f32) -> f32 {
    let x = clamp(clearance, -1.0, 1.0);
    return clamp(0.5 + (x * sqrt(max(1.0 - x * x, 0.0)) + asin(x)) / 3.14159265, 0.0, 1.0);
}

fn dissolve(frame: Frame, offset_m: vec3f) -> f32 {
    return smoothstep(0.72, 0.98, length(offset_m.xz) / frame.view_distance_m);
}

fn drifted(frame: Frame, place_m: vec2f) -> vec2f {
    return place_m - CLOUD_DRIFT_M * frame.time_s;
}

fn error_colour(share: f32) -> vec3f {
    let low = mix(vec3f(0.02, 0.35, 0.05), vec3f(0.75, 0.6, 0.02), clamp(2.0 * share, 0.0, 1.0));
    let high = mix(low, vec3f(0.8, 0.03, 0.01), clamp(2.0 * share - 1.0, 0.0, 1.0));
    return select(high, vec3f(2.5), share > 1.001);
}

fn facing_of(normal: vec3f) -> Facing {
    let facing = abs(normal) * vec3f(1.5, 1.0, 1.5);
    let sideways = select(2u, 0u, facing.x > facing.z);
    let side = max(facing.x, facing.z);
    let least = min(facing.x, facing.z);
    let upward = facing.y > least;
    let third = select(facing.y, least, upward);
    let weights = max(vec2f(side, select(least, facing.y, upward)) - third, vec2f(0.0001));
    let sharp = weights * weights * weights;
    let seen = max(sharp / (sharp.x + sharp.y) - 0.02, vec2f(0.0));
    return Facing(vec2u(sideways, select(2u - sideways, 1u, upward)), seen / (seen.x + seen.y));
}

fn fifth_power(x: f32) -> f32 {
    let squared = x * x;
    return squared * squared * x;
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

fn footprint_on(frame: Frame, at_m: vec3f, normal: vec3f) -> Footprint {
    let depth_m = dot(at_m, frame.ray_forward);
    let right = frame.ray_right * (2.0 / frame.viewport.x);
    let down = frame.ray_up * (-2.0 / frame.viewport.y);
    let facing_m = min(dot(normal, at_m), -LEAST_FACING * length(at_m));
    let along = at_m / facing_m;
    return Footprint(depth_m * (right - along * dot(normal, right)), depth_m * (down - along * dot(normal, down)));
}

fn furrows(position_m: vec2f, cell_m: f32, across: vec2f, salt: u32) -> vec3f {
    let p = position_m / cell_m;
    let low = floor(p);
    let f = p - low;
    let u = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let mask = i32(PATTERN_PERIOD_M / cell_m) - 1;
    let turns = 6.2831853 * GULLY_WAVES;
    var sum = vec3f(0.0);
    for (var corner = 0; corner < 4; corner++) {
        let beside = vec2i(corner & 1, corner >> 1u);
        let cell = vec2u((vec2i(low) + beside) & vec2i(mask));
        let hash = pattern_hash(cell.x + salt * 2654435769u, cell.y);
        let shift = vec2f(f32(hash & 65535u), f32(hash >> 16u)) / 65536.0 - 0.5;
        let share = mix(vec2f(1.0) - u, u, vec2f(beside));
        let angle = turns * dot(f - vec2f(beside) - shift, across);
        sum += share.x * share.y * vec3f(cos(angle), -sin(angle) * turns * across);
    }
    return sum;
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

fn grid_vertex(index: u32) -> GridVertex {
    let column = index & COLUMN_MASK;
    let row = (index >> COLUMN_BITS) & COLUMN_MASK;
    return GridVertex(column, row);
}

fn ground(colours: texture_2d_array<f32>, shapes: texture_2d_array<f32>, heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, material_sampler: sampler, frame: Frame, seen_point: GroundPoint) -> Ground {
    let right_m = length(seen_point.offset_ddx_m);
    let down_m = length(seen_point.offset_ddy_m);
    let long_m = max(right_m, down_m);
    let short_m = min(right_m, down_m);
    var point = seen_point;
    point.offset_ddx_m *= min(1.0, max(short_m / max(right_m, 1e-6), 1.0 / MATERIAL_SHARPENING));
    point.offset_ddy_m *= min(1.0, max(short_m / max(down_m, 1e-6), 1.0 / MATERIAL_SHARPENING));
    let pattern_m = frame.pattern_eye_m + point.offset_m.xz;
    var cover = cover_at(point.height_m, point.normal, point.broad_slope, pattern_m, sqrt(long_m * short_m), long_m);
    let grass = undergrowth(frame, cover.shares[MEADOW] + cover.shares[DRY_GRASS], length(point.offset_m));
    cover.albedo[MEADOW] *= grass;
    cover.albedo[DRY_GRASS] *= grass;
    var mean = vec3f(0.0);
    var first = 0u;
    var second = 0u;
    var shares = vec3f(0.0);
    for (var material = 0u; material < MATERIAL_COUNT; material++) {
        let share = cover.shares[material];
        if share > shares.x {
            shares = vec3f(share, shares.xy);
            second = first;
            first = material;
        }
        else if share > shares.y {
            shares = vec3f(shares.x, share, shares.y);
            second = material;
        }
        else {
            shares.z = max(shares.z, share);
        }
        if share > 0.004 {
            cover.albedo[material] /= material_sets[material].mean;
            mean += share * cover.albedo[material] * material_mean(colours, material);
        }
    }
    let leaves = cover.shares[THICKET] + cover.shares[DRY_GRASS] + cover.shares[MEADOW];
    var surface = Surface(mean, point.normal, 0.92, 0.92 * cover.open, leaves);
    var gradient = vec3f(cover.slope.x, 0.0, cover.slope.y);
    let texel_m = max(short_m, long_m / (2.0 * MATERIAL_SHARPENING));
    let seen = 1.0 - smoothstep(0.5 * MATERIAL_END_M, MATERIAL_END_M, texel_m);
    let blocks_end_m = MATERIAL_END_M * BLOCK_SCALE;
    let blocky = cover.shares[CLIFF] * (1.0 - smoothstep(0.5 * blocks_end_m, blocks_end_m, texel_m));
    var sun = 1.0;
    if max(seen, blocky) > 0.02 {
        let rest = shares.xy - min(shares.z, shares.y);
        let facing = facing_of(point.normal);
        if seen > 0.0 {
            let lead = (rest.x - rest.y) / max(rest.x + rest.y, 1e-6);
            let faced = select(facing.axes.y, facing.axes.x, facing.shares.x >= facing.shares.y);
            let facing_lead = abs(facing.shares.x - facing.shares.y);
            let axis = select(1u, faced, first == CLIFF);
            let pom = ground_pom(colours, heights, max_mips, material_sampler, frame, projected(frame, point, axis, 1.0), axis, first, point.normal, -point.offset_m / max(length(point.offset_m), 1e-6), length(point.offset_m), seen * smoothstep(0.0, 0.35, lead) * select(1.0, smoothstep(0.0, 0.35, facing_lead), first == CLIFF));
            point.offset_m += pom.shift_m;
            sun = pom.sun;
        }
        let none = GroundTexel(MaterialTexel(vec3f(0.0), 0.0, vec2f(0.0), 0.0, 0.0), vec3f(0.0));
        var here = none;
        var there = none;
        var blocks = none;
        let samples = select(4u, 6u, blocky > 0.0);
        for (var index = select(4u, 0u, seen > 0.0); index < samples; index++) {
            let is_block = index >= 4u;
            let is_second = index >= 2u && !is_block;
            let material = select(select(first, second, is_second), CLIFF, is_block);
            let sideways = (index & 1u) == 0u;
            var share = select(0.0, 1.0, sideways);
            var axis = 1u;
            if material == CLIFF {
                share = select(facing.shares.y, facing.shares.x, sideways);
                axis = select(facing.axes.y, facing.axes.x, sideways);
            }
            if share <= 0.0 || (is_second && rest.y <= LEAST_SECOND) {
                continue;
            }
            let texel = material_sample(colours, shapes, material_sampler, projected(frame, point, axis, select(1.0, BLOCK_SCALE, is_block)), material, frame.tiling);
            let scaled = scaled_ground(GroundTexel(texel, in_world(texel.slope, axis)), share);
            if is_block {
                blocks = sum_of(blocks, scaled);
            }
            else if is_second {
                there = sum_of(there, scaled);
            }
            else {
                here = sum_of(here, scaled);
            }
        }
        if seen > 0.0 {
            here.texel.albedo *= cover.albedo[first];
            if rest.y > LEAST_SECOND {
                there.texel.albedo *= cover.albedo[second];
                let lifted = (rest.y - LEAST_SECOND) * exp2(9.0 * (there.texel.height - here.texel.height));
                let share = lifted / max(rest.x + lifted, 1e-6);
                here = sum_of(scaled_ground(here, 1.0 - share), scaled_ground(there, share));
            }
            surface.albedo = mix(mean, here.texel.albedo, seen);
            surface.roughness = mix(surface.roughness, here.texel.roughness, seen);
            surface.occlusion = mix(surface.occlusion, here.texel.occlusion * cover.open, seen);
            gradient += here.gradient * seen;
        }
        if blocky > 0.0 {
            let shade = blocks.texel.albedo / max(material_mean(colours, CLIFF), vec3f(0.001));
            surface.albedo *= mix(vec3f(1.0), shade, blocky * BLOCK_SHADE);
            let open = blocks.texel.occlusion * min(0.55 + 0.9 * blocks.texel.height, 1.0);
            surface.occlusion *= mix(1.0, open, blocky);
            gradient += blocks.gradient * blocky;
        }
    }
    let along = gradient - point.normal * dot(gradient, point.normal);
    surface.normal = normalize(point.normal - along);
    return Ground(surface, sun, cover.wood);
}

fn ground_bounce(frame: Frame, surface: Surface, sky: f32) -> vec3f {
    let sun = frame.atmosphere.sun * (BOUNCE_LIT * max(frame.sun.y, 0.0));
    let around = BOUNCE_ALBEDO * (sun + ambient(frame, vec3f(0.0, 1.0, 0.0)));
    return surface.albedo * around * ((1.0 - sky) * surface.occlusion);
}

fn ground_pom(colours: texture_2d_array<f32>, heights: texture_2d_array<f32>, max_mips: texture_2d_array<f32>, material_sampler: sampler, frame: Frame, place: MaterialPlace, axis: u32, material: u32, normal: vec3f, to_eye: vec3f, distance_m: f32, strength: f32) -> GroundPom {
    let tile_m = material_sets[material].tile_m;
    let leading = leading_tap(place, material, frame.tiling);
    let cosine = dot(normal, to_eye);
    let whole_m = material_sets[material].relief_m * frame.pom.amplitude;
    let amplitude_m = whole_m * strength * pom_fade(frame.pom, whole_m * frame.pixels_per_radian / max(distance_m, 0.01)) * smoothstep(0.0, POM_LEAD, leading.lead) * smoothstep(POM_GRAZING.x, POM_GRAZING.y, cosine);
    let at = leading.tap.at;
    let footprint = max(length(at.ddx), length(at.ddy));
    let side = textureDimensions(heights).x;
    let map = PomMap(material, side, pom_lod(side, footprint));
    let amplitude = amplitude_m / tile_m;
    let down = (normal - to_eye / max(cosine, POM_GRAZING.x)) * amplitude;
    let ray = PomRay(at.uv, turned_by(leading.tap.turn, along_plane(down, axis)), cosine, amplitude);
    if amplitude <= 0.0 || frame.pom.tier == POM_FLAT {
        return GroundPom(vec3f(0.0), 1.0);
    }
    var pom = frame.pom;
    pom.tier = select(pom.tier, POM_MAX_MIP, pom.tier == POM_CONES);
    let trace = PomTrace(pom, map, ray);
    let hit = pom_hit_no_cones(heights, colours, max_mips, material_sampler, trace);
    let back = vec2f(leading.tap.turn.x, -leading.tap.turn.y);
    let shift = turned_by(back, hit.uv - at.uv) * tile_m;
    var sun = 1.0;
    if pom.shadow != POM_SHADOW_OFF && amplitude * f32(side >> map.lod) > 0.5 {
        let sunward = dot(normal, frame.sun);
        let level = turned_by(leading.tap.turn, along_plane(frame.sun - normal * sunward, axis));
        sun = pom_sun(heights, colours, max_mips, material_sampler, pom, map, hit.uv, hit.height, vec3f(level, sunward), amplitude);
    }
    return GroundPom(along_surface(shift, normal, axis), sun);
}

fn gullies_at(pattern_m: vec2f, slope: vec2f, footprint_m: f32) -> vec3f {
    let steep = length(slope);
    let cut = smoothstep(GULLY_STEEP.x, GULLY_STEEP.y, steep);
    if cut <= 0.0 {
        return vec3f(0.0);
    }
    var run = slope;
    var height = 0.0;
    var cell_m = GULLY_CELL_M;
    var part = 1.0;
    var steepness = 1.0;
    for (var octave = 0u; octave < GULLY_OCTAVES; octave++) {
        let wave_m = cell_m / GULLY_WAVES;
        let seen = clamp(1.5 - 5.0 * footprint_m / wave_m, 0.0, 1.0);
        if seen <= 0.0 {
            break;
        }
        let across = vec2f(-run.y, run.x) / max(length(run), 0.001);
        let waves = furrows(pattern_m, cell_m, across, 51u + octave);
        height += waves.x * part * seen;
        run += waves.yz * (GULLY_DEPTH * wave_m / cell_m * cut * seen * steepness);
        steepness *= GULLY_EASE;
        cell_m /= GULLY_STEP;
        part *= 0.5;
    }
    return vec3f(height * cut, run - slope);
}

fn haze_phase(cosine: f32) -> f32 {
    const G: f32 = 0.76;
    let base = max(1.0 + G * G - 2.0 * G * cosine, 0.001);
    return 1.5 * (1.0 - G * G) / (2.0 + G * G) * (1.0 + cosine * cosine) / (base * sqrt(base));
}

fn height_index(slot: u32, column: u32, row: u32) -> u32 {
    return slot * VERTEX_COUNT + row * VERTICES + column;
}

fn hex_corners(uv: vec2f) -> HexCorners {
    let skewed = hex_skewed(uv);
    let low = floor(skewed);
    let f = skewed - low;
    let cell = vec2i(low);
    if f.x + f.y < 1.0 {
        return HexCorners(cell, cell + vec2i(0, 1), cell + vec2i(1, 0), vec3f(1.0 - f.x - f.y, f.y, f.x));
    }
    return HexCorners(cell + vec2i(1, 1), cell + vec2i(1, 0), cell + vec2i(0, 1), vec3f(f.x + f.y - 1.0, 1.0 - f.y, 1.0 - f.x));
}

fn hex_hash(from_anchor: vec2i, anchor_m: vec2f, tile_m: f32, material: u32) -> u32 {
    let vertex = from_anchor + vec2i(hex_skewed(anchor_m / tile_m));
    let period = PATTERN_PERIOD_M * HEX_PER_TILE / tile_m;
    let rows = period * HEX_STRETCH;
    let south = floor((f32(vertex.y) + 0.5) / rows);
    let y = vertex.y - i32(south * rows);
    let x = (vertex.x + i32(south * period * HEX_SHEAR)) & (i32(period) - 1);
    return pattern_hash(u32(x) + material * 2654435769u, u32(y));
}

fn hex_skewed(uv: vec2f) -> vec2f {
    return vec2f(uv.x - HEX_SHEAR * uv.y, HEX_STRETCH * uv.y) * HEX_PER_TILE;
}

fn hex_tap(at: MaterialUv, anchor_m: vec2f, tile_m: f32, material: u32, index: u32) -> MaterialTap {
    let corners = hex_corners(at.uv);
    let vertex = select(select(corners.three, corners.two, index == 1u), corners.one, index == 0u);
    let near = select(select(corners.weights.z, corners.weights.y, index == 1u), corners.weights.x, index == 0u);
    let nearest = max(corners.weights.x, max(corners.weights.y, corners.weights.z));
    let relative = near / nearest;
    let cubed = relative * relative * relative;
    let weight = cubed * cubed * relative;
    let hash = hex_hash(vertex, anchor_m, tile_m, material);
    let shift = vec2f(f32(hash & 65535u), f32(hash >> 16u)) * (1.0 / 65536.0);
    let share = f32((hash * 2891336453u) >> 8u) * (1.0 / 8388608.0) - 1.0;
    let angle = share * material_sets[material].turn * 3.1415927;
    let turn = vec2f(cos(angle), sin(angle));
    let st = vec2f(vertex);
    let row = st.y / (HEX_STRETCH * HEX_PER_TILE);
    let centre = vec2f(st.x / HEX_PER_TILE + HEX_SHEAR * row, row);
    let uv = turned_by(turn, at.uv - centre) + shift;
    return MaterialTap(MaterialUv(uv, turned_by(turn, at.ddx), turned_by(turn, at.ddy)), max(weight - 0.003, 0.0), turn);
}

fn in_world(slope: vec2f, axis: u32) -> vec3f {
    if axis == 0u {
        return vec3f(0.0, slope.y, slope.x);
    }
    return select(vec3f(slope.x, slope.y, 0.0), vec3f(slope.x, 0.0, slope.y), axis == 1u);
}

fn inspected(frame: Frame, normal: vec3f, error_m: f32, level: f32, distance_m: f32) -> vec3f {
    let shape = 0.35 + 0.65 * max(dot(normal, normalize(vec3f(0.5, 0.7, 0.5))), 0.0);
    if frame.show == SHOW_LEVELS {
        let own = level_colour(level);
        return mix(own, level_colour(level + 1.0), fract(level) * 0.85) * shape;
    }
    if frame.show == SHOW_NORMALS {
        return pow(normal * 0.5 + 0.5, vec3f(2.2));
    }
    if frame.show == SHOW_ERROR {
        let error_px = error_m * frame.pixels_per_radian / max(distance_m, 0.001);
        return error_colour(error_px / frame.tolerance_px) * shape;
    }
    return vec3f(0.16) * shape;
}

fn interpolated_crossing(bracket: Bracket) -> f32 {
    let fall = bracket.near_clearance - bracket.far_clearance;
    return mix(bracket.near, bracket.far, bracket.near_clearance / fall);
}

fn is_decimated(seams: Seams) -> bool {
    return (seams.inside & 4096u) != 0u;
}

fn is_in_tree_grid(side: u32, cell: vec2i) -> bool {
    return all(cell >= vec2i(0)) && all(cell < vec2i(i32(side)));
}

fn is_level_ready(map: Clipmap, level: u32) -> bool {
    return map.levels[min(level, CLIPMAP_LEVELS - 1u)].w != 0.0;
}

fn land_point(map: Clipmap, heights: texture_2d_array<f32>, eye_height_m: f32, drawn_m: vec3f, pixel_m: f32) -> vec3f {
    let wanted = clipmap_level(map, drawn_m.xz, pixel_m);
    let found = clipmap_blend(map, wanted);
    if found.level >= map.count || found.level > u32(wanted) {
        return drawn_m;
    }
    let distance_m = length(drawn_m);
    let ray = drawn_m / max(distance_m, 1e-6);
    let most_m = MOST_MOVE * distance_m;
    var moved_m = 0.0;
    for (var step = 0u; step < LAND_STEPS; step++) {
        let at_m = drawn_m + ray * moved_m;
        var land = clipmap_height(map, heights, found.level, at_m.xz);
        if found.share > 0.0 {
            land = mix(land, clipmap_height(map, heights, found.level + 1u, at_m.xz), found.share);
        }
        let rise_m = land.x - eye_height_m - at_m.y;
        let fall = dot(land.yz, ray.xz) - ray.y;
        if fall <= 0.0 {
            return drawn_m;
        }
        let step_m = rise_m * fall / (fall * fall + LEAST_FALL * LEAST_FALL);
        moved_m = clamp(moved_m - step_m, -most_m, most_m);
    }
    return drawn_m + ray * moved_m;
}

fn land_shape(map: Clipmap, slopes: texture_2d_array<f32>, sky: texture_2d_array<f32>, filtering: sampler, offset_m: vec2f, direction: vec3f, pixel_m: f32) -> LandShape {
    let near = clipmap_level(map, offset_m, pixel_m);
    let above = log2(max(BROAD_M / map.spacing_m, 1.0));
    let wide = clipmap_blend(map, floor(max(near, above)));
    if wide.level >= map.count && clipmap_blend(map, near).level >= map.count {
        return LandShape(vec2f(0.0), vec2f(0.0), 1.0, false);
    }
    var broad = vec2f(0.0);
    if wide.level < map.count {
        let words = map.levels[wide.level];
        let at = words.xy + offset_m * words.z;
        broad = textureSampleLevel(slopes, filtering, at, wide.level, 0.0).xy * map.vertical_scale;
    }
    let facing = max(-dot(slope_normal(broad), direction), LEAST_FACING);
    let footprint_m = pixel_m * inverseSqrt(facing);
    let found = clipmap_blend(map, clipmap_level(map, offset_m, footprint_m));
    if found.level >= map.count {
        return LandShape(vec2f(0.0), vec2f(0.0), 1.0, false);
    }
    var texel = clipmap_texel(map, slopes, sky, filtering, found.level, offset_m);
    if found.share > 0.0 {
        let next = clipmap_texel(map, slopes, sky, filtering, found.level + 1u, offset_m);
        texel = mix(texel, next, found.share);
    }
    return LandShape(texel.xy * map.vertical_scale, broad, texel.z, true);
}

fn lattice_value(cell: vec2i, mask: i32, salt: u32) -> f32 {
    let wrapped = vec2u(cell & vec2i(mask));
    return f32(pattern_hash(wrapped.x + salt * 2654435769u, wrapped.y) >> 8u) * (1.0 / 16777216.0);
}

fn leading_tap(place: MaterialPlace, material: u32, tiling: u32) -> LeadingTap {
    if tiling != TILING_HEX {
        return LeadingTap(material_tap(place, material, tiling, 0u), 1.0);
    }
    let weights = hex_corners(material_uv(place, material_sets[material].tile_m).uv).weights;
    let most = max(weights.x, max(weights.y, weights.z));
    let index = select(select(2u, 1u, weights.y == most), 0u, weights.x == most);
    let least = min(weights.x, min(weights.y, weights.z));
    let second = 1.0 - most - least;
    return LeadingTap(material_tap(place, material, tiling, index), clamp((most - second) / most, 0.0, 1.0));
}

fn leaf_sun(facing: f32) -> f32 {
    return 0.5 * exp(-CLUMP_DEPTH * max(-facing, 0.0));
}

fn ledges(at: RockPlace, beds: vec2f) -> f32 {
    let steep = length(at.broad_slope);
    let cut = smoothstep(LEDGE_STEEP.x, LEDGE_STEEP.y, steep);
    let along = sqrt(1.0 + steep * steep) / max(steep, 0.1);
    let pixels = vec2f(18.0, 5.0) * along / max(at.footprint_m, 0.001);
    let seen = clamp(pixels / LEDGE_PIXELS - 0.5, vec2f(0.0), vec2f(1.0));
    let hard = smoothstep(vec2f(-0.2), vec2f(0.2), beds) - 0.5;
    return cut * dot(hard * seen, vec2f(1.0, 0.6));
}

fn level_colour(level: f32) -> vec3f {
    let hue = fract(floor(level) * 0.382 + 0.58);
    let wheel = abs(fract(vec3f(hue, hue + 0.667, hue + 0.333)) * 6.0 - 3.0) - 1.0;
    return mix(vec3f(0.35), clamp(wheel, vec3f(0.0), vec3f(1.0)), 0.75);
}

fn light_on_water(frame: Frame, sun: f32) -> vec3f {
    return frame.atmosphere.sun * (max(frame.sun.y, 0.0) * sun) + ambient(frame, vec3f(0.0, 1.0, 0.0));
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

fn material_mean(colours: texture_2d_array<f32>, material: u32) -> vec3f {
    return textureLoad(colours, vec2u(0u), material, textureNumLevels(colours) - 1u).rgb;
}

fn material_sample(colours: texture_2d_array<f32>, shapes: texture_2d_array<f32>, material_sampler: sampler, place: MaterialPlace, material: u32, tiling: u32) -> MaterialTexel {
    var sum = MaterialTexel(vec3f(0.0), 0.0, vec2f(0.0), 0.0, 0.0);
    var total = 0.0;
    let taps = material_taps(tiling);
    for (var index = 0u; index < taps; index++) {
        let tap = material_tap(place, material, tiling, index);
        if tap.weight == 0.0 {
            continue;
        }
        let colour = textureSampleGrad(colours, material_sampler, tap.at.uv, material, tap.at.ddx, tap.at.ddy);
        let shape = textureSampleGrad(shapes, material_sampler, tap.at.uv, material, tap.at.ddx, tap.at.ddy);
        let normal = (shape.xy * 255.0 - 128.0) / 127.0;
        let slope = -normal * inverseSqrt(max(1.0 - dot(normal, normal), 0.03));
        var share = tap.weight;
        if tiling == TILING_HEX {
            let luminance = dot(colour.rgb, LUMINANCE);
            share *= mix(1.0, luminance / (luminance + dot(material_sets[material].mean, LUMINANCE)), HEX_CONTRAST);
        }
        sum.albedo += colour.rgb * share;
        sum.height += colour.a * share;
        sum.slope += turned_by(vec2f(tap.turn.x, -tap.turn.y), slope) * share;
        sum.roughness += shape.z * share;
        sum.occlusion += shape.w * share;
        total += share;
    }
    let scale = 1.0 / max(total, 1e-9);
    return MaterialTexel(sum.albedo * scale, sum.height * scale, sum.slope * scale, sum.roughness * scale, sum.occlusion * scale);
}

var<private> material_sets: array<MaterialSet, 7> = MATERIAL_SETS;

fn material_tap(place: MaterialPlace, material: u32, tiling: u32, index: u32) -> MaterialTap {
    let tile_m = material_sets[material].tile_m * place.scale;
    let at = material_uv(place, tile_m);
    if tiling == TILING_HEX {
        return hex_tap(at, place.anchor_m, tile_m, material, index);
    }
    if index == 1u {
        return MaterialTap(MaterialUv(broader(at.uv), broader(at.ddx), broader(at.ddy)), 1.0, vec2f(2.0, -1.0) * 0.4472136);
    }
    return MaterialTap(at, 1.0, vec2f(1.0, 0.0));
}

fn material_taps(tiling: u32) -> u32 {
    return select(select(1u, 2u, tiling == TILING_TWO_SCALE), 3u, tiling == TILING_HEX);
}

fn material_uv(place: MaterialPlace, tile_m: f32) -> MaterialUv {
    return MaterialUv(place.near_m / tile_m, place.ddx_m / tile_m, place.ddy_m / tile_m);
}

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

fn meadow_tint_at(at: Patterns, height_m: f32) -> MeadowTint {
    return MeadowTint(smoothstep(0.42, 0.68, at.broad + height_m * 0.0002 + (at.medium - 0.5) * 0.3 + at.clumps * 0.45), (0.82 + 0.36 * at.medium) * max(1.0 + 0.35 * at.fine + 0.9 * at.clumps + 0.9 * at.tufts, 0.2));
}

fn mean_tree_sun(head: vec4u, wood: f32, sun: vec3f) -> f32 {
    if (head.w & TREES_CAST) == 0u {
        return 1.0;
    }
    let lean = length(sun.xz) / max(sun.y, 0.05);
    let area = 3.14159265 * 2.0 * sqrt(4.0 + 12.25 * lean * lean) / (TREE_CELL_M * TREE_CELL_M);
    return exp(-0.8 * area * f32(head.z) * wood);
}

fn mesh_lines(cell: vec2f, change: vec2f) -> f32 {
    let along = vec3f(cell, cell.x - cell.y);
    let rate = max(vec3f(change, change.x + change.y), vec3f(1e-6));
    let beside = abs(along - round(along)) / rate;
    let line = 1.0 - smoothstep(0.4, 1.1, min(beside.x, min(beside.y, beside.z)));
    return mix(line, 0.3, smoothstep(0.3, 0.7, max(rate.x, rate.y)));
}

fn morph_at(seams: Seams, vertex: GridVertex) -> i32 {
    let east = vertex.column > CELLS / 2u;
    let south = vertex.row > CELLS / 2u;
    let from_x = select(vertex.column, CELLS - vertex.column, east);
    let from_z = select(vertex.row, CELLS - vertex.row, south);
    let near_x = i32(MORPH_BAND - min(from_x, MORPH_BAND));
    let near_z = i32(MORPH_BAND - min(from_z, MORPH_BAND));
    let far_x = i32(MORPH_BAND) - near_x;
    let far_z = i32(MORPH_BAND) - near_z;
    let corner = morph_byte(seams.corners, u32(east) + 2u * u32(south));
    let edge_x = morph_byte(seams.edges, select(3u, 1u, east));
    let edge_z = morph_byte(seams.edges, select(0u, 2u, south));
    let inside = morph_byte(seams.inside, 0u);
    let sum = near_z * (near_x * corner + far_x * edge_z) + far_z * (near_x * edge_x + far_x * inside);
    return sum >> (2u * MORPH_BAND_BITS);
}

fn morph_byte(word: u32, index: u32) -> i32 {
    return i32((word >> (8u * index)) & 255u);
}

fn morphed(own: i32, parent: i32, morph: i32) -> i32 {
    return own + (((parent - own) * morph) >> 6u);
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

fn open_sea(map: Clipmap, heights: texture_2d_array<f32>, offset_m: vec2f) -> f32 {
    let level = clipmap_level(map, abs(offset_m) + FETCH_M, FETCH_M / 8.0);
    let found = clipmap_blend(map, floor(level));
    if found.level >= map.count {
        return 1.0;
    }
    var open = 0.0;
    for (var corner = 0; corner < 4; corner++) {
        let way = vec2f(f32(corner & 1), f32(corner >> 1u)) - 0.5;
        let there_m = offset_m + way * (1.4142 * FETCH_M);
        let height_m = clipmap_height(map, heights, found.level, there_m).x;
        open += 0.25 * smoothstep(0.0, 1.5, -height_m);
    }
    return smoothstep(0.0, 0.5, open);
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

fn pattern_fbm_seen(position_m: vec2f, cell_m: f32, salt: u32, footprint_m: f32) -> f32 {
    var p = position_m;
    var size_m = cell_m;
    var sum = 0.5;
    var weight = 0.5333;
    for (var octave = 0u; octave < 4u; octave++) {
        let seen = clamp(1.5 - 1.5 * footprint_m / size_m, 0.0, 1.0);
        if seen <= 0.0 {
            break;
        }
        sum += weight * seen * (pattern(p, cell_m, salt + octave) - 0.5);
        p = vec2f(2.0 * p.x + p.y, 2.0 * p.y - p.x);
        size_m *= 0.4472136;
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

fn patterns_at(pattern_m: vec2f, footprint_m: f32) -> Patterns {
    let turned_m = vec2f(2.0 * pattern_m.x + pattern_m.y, 2.0 * pattern_m.y - pattern_m.x);
    let broad = pattern_fbm_seen(pattern_m, 512.0, 1u, footprint_m);
    let medium = pattern_fbm_seen(pattern_m, 64.0, 2u, footprint_m);
    let near = clamp(1.5 - footprint_m * 0.75, 0.0, 1.0);
    let fine = (pattern(turned_m, 4.0, 3u) - 0.5) * near;
    var clumps = 0.0;
    if footprint_m < 6.0 {
        clumps = (pattern_fbm(turned_m, 32.0, 15u) - 0.5) * clamp(1.5 - footprint_m * 0.25, 0.0, 1.0);
    }
    var tufts = 0.0;
    if footprint_m < 1.0 {
        tufts = (pattern(turned_m, 2.0, 33u) - 0.5) * clamp(2.0 - 2.0 * footprint_m, 0.0, 1.0);
    }
    if footprint_m < 0.5 {
        tufts += (pattern(turned_m, 1.0, 34u) - 0.5) * clamp(1.0 - 2.0 * footprint_m, 0.0, 0.5);
    }
    return Patterns(turned_m, footprint_m, broad, medium, fine, clumps, tufts);
}

fn pom_entry(ray: PomRay, pivot: f32) -> vec2f {
    return (ray.uv - floor(ray.uv)) - (1.0 - pivot) * ray.travel;
}

fn pom_fade(pom: PomParams, height_px: f32) -> f32 {
    return select(smoothstep(0.5, 1.0, height_px / max(pom.fade_px, 0.001)), 1.0, pom.fade_px <= 0.0);
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

fn projected(frame: Frame, point: GroundPoint, axis: u32, scale: f32) -> MaterialPlace {
    let step_m = MATERIAL_ANCHOR_M * scale;
    let anchor_m = floor(frame.pattern_eye_m / step_m) * step_m;
    let eye_m = frame.pattern_eye_m - anchor_m;
    let near_m = vec3f(eye_m.x, frame.eye_height_m, eye_m.y) + point.offset_m;
    let dx = point.offset_ddx_m;
    let dy = point.offset_ddy_m;
    if axis == 0u {
        return MaterialPlace(near_m.zy, vec2f(anchor_m.y, 0.0), dx.zy, dy.zy, scale);
    }
    if axis == 1u {
        return MaterialPlace(near_m.xz, anchor_m, dx.xz, dy.xz, scale);
    }
    return MaterialPlace(near_m.xy, vec2f(anchor_m.x, 0.0), dx.xy, dy.xy, scale);
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

fn rock_at(at: Patterns, slope: f32, summit: f32, height_m: f32) -> vec2f {
    let high = 0.07 * smoothstep(90.0, 300.0, height_m);
    return vec2f(smoothstep(0.165, 0.255, slope), max(smoothstep(0.125, 0.185, slope + high + (at.broad - 0.5) * 0.06 + at.fine * 0.04 + at.clumps * 0.05), summit * 0.8));
}

fn rock_look(at: RockPlace, creases: vec3f) -> Rock {
    let gullies = gullies_at(at.pattern_m, at.broad_slope, at.footprint_m);
    let beds = beds_at(at);
    let weathered = at.medium * 1.3 - 0.2 - 0.9 * creases.x + 0.35 * gullies.x + 1.1 * beds.x * clamp(1.5 - at.footprint_m * 0.1, 0.0, 1.0) + 0.5 * beds.y * clamp(1.5 - at.footprint_m * 0.5, 0.0, 1.0);
    var albedo = mix(DARK_ROCK, ROCK, clamp(weathered, 0.0, 1.0));
    let kind = smoothstep(0.42, 0.58, at.broad + (at.medium - 0.5) * 0.3 + 0.03 * gullies.x);
    albedo *= mix(BROWN_TINT, GREY_TINT, kind);
    albedo = mix(albedo, LIGHT_ROCK, at.summit * 0.75);
    let slope = gullies.yz + at.broad_slope * ledges(at, beds);
    let hidden = 0.3 * (1.0 - smoothstep(-1.2, 0.2, gullies.x)) + 0.15 * smoothstep(0.0, 0.18, creases.x);
    return Rock(albedo, slope, 1.0 - hidden);
}

fn rough_reflectance(cosine: f32, deviation: f32) -> f32 {
    let grazing = pow(1.0 - cosine, 5.0 * exp(-2.69 * deviation)) / (1.0 + 22.7 * pow(deviation, 1.5));
    return WATER_F0 + (1.0 - WATER_F0) * grazing;
}

fn scaled_erfc(x: f32) -> f32 {
    const A: f32 = 2.7519384;
    return A / ((A - 1.0) * 1.7724539 * x + sqrt(3.1415927 * x * x + A * A));
}

fn scaled_ground(a: GroundTexel, share: f32) -> GroundTexel {
    return GroundTexel(MaterialTexel(a.texel.albedo * share, a.texel.height * share, vec2f(0.0), a.texel.roughness * share, a.texel.occlusion * share), a.gradient * share);
}

fn schlick(f0: f32, lh: f32) -> f32 {
    let f90 = clamp(50.0 * 0.33 * f0, 0.0, 1.0);
    return f0 + (f90 - f0) * fifth_power(1.0 - lh);
}

fn sea_share(frame: Frame, direction: vec3f) -> f32 {
    let dip = sqrt(2.0 * max(frame.eye_height_m, 0.0) / EARTH_RADIUS_M);
    return smoothstep(0.96, 1.04, -direction.y / max(dip, 1e-5));
}

fn shading_angles(normal: vec3f, to_eye: vec3f, to_light: vec3f) -> ShadingAngles {
    let both = to_eye + to_light;
    let middle = both * inverseSqrt(max(dot(both, both), 1e-8));
    return ShadingAngles(clamp(dot(normal, to_light), 0.0, 1.0), clamp(dot(normal, to_eye), MIN_NV, 1.0), clamp(dot(to_light, middle), 0.0, 1.0), middle);
}

fn shelter_at(at: Patterns, height_m: f32, normal: vec3f) -> f32 {
    let plain = (1.0 - smoothstep(0.0015, 0.01, 1.0 - normal.y)) * (1.0 - smoothstep(20.0, 45.0, height_m));
    return (at.broad - 0.5) * 0.25 - normal.z * 0.25 - plain * 0.09 - smoothstep(120.0, 340.0, height_m) * 0.16;
}

fn single_shadows(sun: vec3f) -> f32 {
    return smoothstep(LOWEST_SUN, 3.0 * LOWEST_SUN, sun.y);
}

fn sky_past(caster: Caster, point_m: vec3f) -> f32 {
    let at_m = point_m.xz - caster.root_m.xz;
    let square = dot(at_m, at_m);
    let radius_m = max(crown_of(caster).radius_m, 0.1);
    let trunk_m = 3.0 * max(trunk_radius_m(caster), 0.01);
    return (1.0 - 0.42 * exp(-square / (1.7 * radius_m * radius_m))) * (1.0 - 0.35 * exp(-square / (trunk_m * trunk_m)));
}

fn sky_past_trees(point_m: vec3f, cell: vec2i) -> f32 {
    let grid = tree_cells[1].z;
    var left = 1.0;
    for (var part = 0; part < 9; part++) {
        let beside = cell + vec2i(part % 3 - 1, part / 3 - 1);
        if !is_in_tree_grid(grid, beside) {
            continue;
        }
        let base = TREE_HEAD + tree_index(grid, beside, 0u);
        for (var number = 0u; number < TREES_PER_CELL; number++) {
            let words = tree_cells[base + number];
            if words.w == 0u {
                break;
            }
            left *= sky_past(unpacked_tree(words), point_m);
        }
    }
    return left;
}

fn sky_radiance(frame: Frame, direction: vec3f) -> vec3f {
    return aerial_perspective(frame, direction, SPACE_M).inscattering;
}

fn slope_normal(slope: vec2f) -> vec3f {
    return normalize(vec3f(-slope.x, 1.0, -slope.y));
}

fn slope_of(at: Patterns, normal: vec3f) -> f32 {
    return 1.0 - normal.y + (at.medium - 0.5) * 0.07 + at.fine * 0.02;
}

fn snapped(seams: Seams, vertex: GridVertex) -> GridVertex {
    let coarser = seams.inside >> 8u;
    let along_x = is_decimated(seams) || ((coarser & 1u) != 0u && vertex.row == 0u) || ((coarser & 4u) != 0u && vertex.row == CELLS);
    let along_z = is_decimated(seams) || ((coarser & 8u) != 0u && vertex.column == 0u) || ((coarser & 2u) != 0u && vertex.column == CELLS);
    return GridVertex(vertex.column - select(0u, vertex.column & 1u, along_x), vertex.row - select(0u, vertex.row & 1u, along_z));
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

fn sum_of(a: GroundTexel, b: GroundTexel) -> GroundTexel {
    return GroundTexel(MaterialTexel(a.texel.albedo + b.texel.albedo, a.texel.height + b.texel.height, vec2f(0.0), a.texel.roughness + b.texel.roughness, a.texel.occlusion + b.texel.occlusion), a.gradient + b.gradient);
}

fn summit_at(at: Patterns, height_m: f32) -> f32 {
    return smoothstep(520.0, 700.0, height_m + (at.medium - 0.5) * 70.0);
}

fn sun_past(caster: Caster, point_m: vec3f, sun: vec3f, blur_m: f32) -> f32 {
    let at_m = point_m - caster.root_m;
    let crown = crown_of(caster);
    let passed = exp(-crown.density * crown_chord(crown, at_m, sun));
    return passed * (1.0 - trunk_shade(caster, at_m, sun, blur_m));
}

fn sun_past_trees(point_m: vec3f, sun: vec3f, columns: u32, blur_m: f32, own_m: vec2f) -> f32 {
    let level = length(sun.xz);
    if sun.y < LOWEST_SUN || level < 0.001 {
        return 1.0;
    }
    let along = sun.xz / level;
    let grid = tree_cells[1].z;
    let place = tree_place(point_m.xz);
    let is_east = abs(along.x) >= abs(along.y);
    let run = select(along.yx, along, is_east);
    let at = select(place.yx, place, is_east);
    let way = select(-1.0, 1.0, run.x > 0.0);
    let drift = run.y / abs(run.x);
    let margin = CROWN_MARGIN_M / TREE_CELL_M;
    let side = margin / abs(run.x);
    let first = floor(at.x - way * margin);
    var left = 1.0;
    for (var step = 0u; step <= columns + 1u; step++) {
        let column = first + way * f32(step);
        let begin = select(at.x - column - 1.0, column - at.x, way > 0.0);
        let near = max(begin, -margin);
        let far = max(begin + 1.0, near);
        let low = floor(at.y + min(drift * near, drift * far) - side);
        let high = floor(at.y + max(drift * near, drift * far) + side);
        for (var row = i32(low); row <= i32(high); row++) {
            let cell = select(vec2i(row, i32(column)), vec2i(i32(column), row), is_east);
            if !is_in_tree_grid(grid, cell) {
                continue;
            }
            let base = TREE_HEAD + tree_index(grid, cell, 0u);
            for (var number = 0u; number < TREES_PER_CELL; number++) {
                let words = tree_cells[base + number];
                if words.w == 0u {
                    break;
                }
                let tree = unpacked_tree(words);
                let to_m = tree.root_m.xz - point_m.xz;
                let beside_m = abs(to_m.x * along.y - to_m.y * along.x);
                let apart_m = tree.root_m.xz - own_m;
                if beside_m > 0.5 * tree.width_m + 0.2 || dot(apart_m, apart_m) < 0.001 {
                    continue;
                }
                left *= sun_past(tree, point_m, sun, blur_m);
            }
        }
        if left < 0.01 {
            break;
        }
    }
    return left;
}

fn sun_share(frame: Frame, clearance: f32) -> f32 {
    if frame.shadows == SHADOWS_OFF {
        return 1.0;
    }
    if frame.shadows == SHADOWS_HARD {
        return select(0.0, 1.0, clearance > 0.0);
    }
    return disc_share(clearance);
}

fn texel_travel(map: PomMap, ray: PomRay) -> f32 {
    return length(ray.travel) * f32(map.side >> map.lod);
}

fn through_water(frame: Frame, floor_colour: vec3f, depth_m: f32, slant: f32, sun: f32) -> vec3f {
    let left = exp(-ABSORPTION * depth_m * (1.0 + slant));
    let veil = 1.0 - exp(-0.16 * depth_m * slant);
    return mix(floor_colour * left, water_body(frame, depth_m, sun), veil);
}

fn track_at(at: Patterns, height_m: f32, steep: f32, long_m: f32) -> f32 {
    let wander = pattern_gradient(at.turned_m, 1024.0, 13u) + vec3f(0.06, vec2f(0.06)) * (pattern_gradient(at.turned_m, 128.0, 14u) - vec3f(0.5, 0.0, 0.0));
    let off_track_m = abs(wander.x - 0.5) / max(length(wander.yz) * 2.236, 0.0001);
    let ragged_m = 1.25 + at.fine * 1.1 + (at.medium - 0.5) * 0.8;
    let blur_m = max(0.35, long_m * 0.6);
    return (1.0 - smoothstep(ragged_m - blur_m, ragged_m + blur_m, off_track_m)) * min(2.6 / max(long_m, 0.1), 1.0) * (1.0 - smoothstep(0.035, 0.06, steep)) * smoothstep(3.0, 4.5, height_m) * (1.0 - smoothstep(140.0, 180.0, height_m)) * smoothstep(0.0002, 0.0005, length(wander.yz));
}

fn tree_cell_index(side: u32, cell: vec2i) -> u32 {
    return u32(cell.y) * side + u32(cell.x);
}

@group(0) @binding(8)
var<storage, read> tree_cells: array<vec4u>;

fn tree_index(side: u32, cell: vec2i, number: u32) -> u32 {
    return tree_cell_index(side, cell) * TREES_PER_CELL + number;
}

@group(0) @binding(9)
var<storage, read> tree_marks: array<u32>;

fn tree_place(offset_m: vec2f) -> vec2f {
    return (bitcast<vec2f>(tree_cells[0].xy) + offset_m) / TREE_CELL_M;
}

fn tree_shade(frame: Frame, point_m: vec3f, wood: f32, blur_m: f32) -> TreeShade {
    let head = tree_cells[0];
    if (head.w & TREES_CAST) == 0u {
        return TreeShade(1.0, 1.0);
    }
    let away_m = length(point_m.xz);
    let known_m = bitcast<f32>(tree_cells[1].y);
    let known = 1.0 - smoothstep((1.0 - TREES_FADE) * known_m, known_m, away_m);
    let single = known * single_shadows(frame.sun);
    var shade = TreeShade(1.0, 1.0);
    if single < 1.0 {
        let range_m = bitcast<f32>(tree_cells[1].x);
        let stand = wood * (1.0 - smoothstep(0.75 * range_m, range_m, away_m));
        let sun = mean_tree_sun(head, stand, frame.sun);
        shade = TreeShade(sun, 1.0 - 0.3 * min(f32(head.z) * stand, 1.5));
    }
    if known <= 0.0 {
        return shade;
    }
    var here = TreeShade(1.0, 1.0);
    let cell = vec2i(floor(tree_place(point_m.xz)));
    let grid = tree_cells[1].z;
    if is_in_tree_grid(grid, cell) {
        let mark = tree_marks[tree_cell_index(grid, cell)];
        if mark > 0u {
            here.sun = sun_past_trees(point_m, frame.sun, mark - 1u, blur_m, vec2f(1000000000.0));
            here.sky = sky_past_trees(point_m, cell);
        }
    }
    return TreeShade(mix(shade.sun, here.sun, single), mix(shade.sky, here.sky, known));
}

fn trunk_radius_m(caster: Caster) -> f32 {
    return min(0.018 * caster.height_m, 0.1 * caster.width_m);
}

fn trunk_shade(caster: Caster, at_m: vec3f, toward: vec3f, blur_m: f32) -> f32 {
    let level = max(length(toward.xz), 0.0001);
    let along = toward.xz / level;
    let way_m = -dot(at_m.xz, along);
    let beside_m = abs(at_m.x * along.y - at_m.z * along.x);
    let half_m = trunk_radius_m(caster);
    let up_m = at_m.y + way_m * toward.y / level;
    if way_m < 0.0 || up_m < -0.2 || up_m > 0.8 * caster.height_m {
        return 0.0;
    }
    let soft_m = SUN_RADIUS * way_m / level + blur_m + 0.001;
    return clamp(0.5 + (half_m - beside_m) / (2.0 * soft_m), 0.0, min(1.0, half_m / soft_m));
}

fn turned_by(turn: vec2f, v: vec2f) -> vec2f {
    return vec2f(turn.x * v.x - turn.y * v.y, turn.y * v.x + turn.x * v.y);
}

fn under_sea(frame: Frame, light: vec3f, floor: SeaFloor) -> vec3f {
    let depth_m = max(-floor.height_m, 0.0);
    let offset_m = floor.offset_m;
    let direction = floor.direction;
    let lit = light * caustics(floor.pattern_m, depth_m, frame.time_s, floor.footprint_m);
    if frame.eye_height_m <= 0.0 {
        let wet = min(1.0, -frame.eye_height_m / max(offset_m.y, 0.001));
        let path_m = length(offset_m) * select(1.0, wet, offset_m.y > 0.0);
        return fogged(frame, lit * exp(-0.06 * depth_m), path_m, -frame.eye_height_m, direction);
    }
    let slant = inverseSqrt(1.0 - (1.0 - direction.y * direction.y) / 1.777);
    let tinted = through_water(frame, lit, depth_m, slant, floor.sun);
    let white = floor.open_sea * foam(floor.height_m, floor.pattern_m, frame.time_s, floor.footprint_m);
    return mix(tinted, foam_light(frame, floor.sun), white);
}

fn undergrowth(frame: Frame, meadow: f32, distance_m: f32) -> vec3f {
    let grass = unpack2x16unorm(frame.grass);
    let end_m = max(min(0.5 * grass.x * GRASS_RANGE_M, 60.0), 1.0);
    let near = 1.0 - smoothstep(0.2 * end_m, end_m, distance_m);
    let cover = grass.y * smoothstep(0.2, 0.7, meadow) * near;
    return mix(UNDERGROWTH, vec3f(1.0), exp2(-2.5 * cover));
}

fn unpacked_tree(words: vec4u) -> Caster {
    return Caster(bitcast<vec3f>(words.xyz), f32(words.w & 4095u) / SHAPE_STEPS, f32((words.w >> 12u) & 4095u) / SHAPE_STEPS, (words.w >> 24u) & 3u);
}

fn water_body(frame: Frame, depth_m: f32, sun: f32) -> vec3f {
    return light_on_water(frame, sun) * mix(SHALLOW_WATER, DEEP_WATER, 1.0 - exp(-depth_m * 0.11));
}

fn water_fog(frame: Frame, depth_m: f32, direction: vec3f) -> vec3f {
    let lightness = exp(-0.07 * depth_m) * (0.3 + 0.55 * smoothstep(-0.6, 0.9, direction.y));
    return light_on_water(frame, 1.0) * mix(DEEP_WATER, SHALLOW_WATER, lightness);
}

fn woods_at(at: Patterns, pattern_m: vec2f, height_m: f32, normal: vec3f, slope: f32) -> vec2f {
    let wood_noise = pattern_fbm_seen(pattern_m, 256.0, 4u, at.footprint_m) + (at.medium - 0.5) * 0.25 + at.fine * 0.03 + at.clumps * 0.12 + shelter_at(at, height_m, normal);
    let wood_belt = smoothstep(5.0, 12.0, height_m) * (1.0 - smoothstep(340.0, 430.0, height_m + (at.broad - 0.5) * 90.0));
    let wood = smoothstep(0.47, 0.54, wood_noise) * wood_belt * (1.0 - smoothstep(0.16, 0.26, slope));
    let rim = smoothstep(0.4, 0.47, wood_noise) * wood_belt * (1.0 - smoothstep(0.2, 0.3, slope));
    return vec2f(wood, max(wood, rim * 0.8));
}

fn wrack_at(at: Patterns, height_m: f32, footprint_m: f32) -> f32 {
    let seen = clamp(1.5 - footprint_m * 0.75, 0.0, 1.0);
    if height_m < 0.6 || height_m > 2.4 || seen <= 0.0 {
        return 0.0;
    }
    let strand_m = height_m + (at.medium - 0.5) * 0.8 + at.fine * 0.35;
    let line = 1.0 - smoothstep(0.02, 0.08, abs(strand_m - 1.3));
    let broken = smoothstep(0.5, 0.64, pattern_fbm(at.turned_m, 8.0, 31u));
    return line * broken * smoothstep(0.42, 0.6, pattern_fbm(at.turned_m, 1.0, 32u)) * seen;
}
