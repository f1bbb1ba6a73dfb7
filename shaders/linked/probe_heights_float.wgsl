@group(0) @binding(0)
var<storage, read> world: World;

@group(0) @binding(1)
var<storage, read> probes: array<vec2i>;

@group(0) @binding(2)
var<storage, read_write> words: array<i32>;

const COARSE_OCTAVES: u32 = 5u;

fn smoothed(t: f32) -> f32 {
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
}

fn corner_float(seed: u32, cell: vec2i, way: vec2f) -> f32 {
    return dot(vec2f(gradient(seed, cell.x, cell.y)) / 32768.0, way);
}

fn fbm_float(x: i32, z: i32, octaves: u32) -> f32 {
    var sum = 0.0;
    for (var octave = 0u; octave < octaves; octave++) {
        let shift = OCTAVE_SHIFT[octave];
        let at_x = lattice_place(octave, x + shift.x);
        let at_z = lattice_place(octave, z + shift.y);
        let cell = vec2i(at_x.cell, at_z.cell);
        let t = vec2f(f32(at_x.fraction), f32(at_z.fraction)) / f32(1u << FRACTION_BITS);
        let seed = world.fine_seeds[octave];
        let north = mix(corner_float(seed, cell, t), corner_float(seed, cell + vec2i(1, 0), t - vec2f(1.0, 0.0)), smoothed(t.x));
        let south = mix(corner_float(seed, cell + vec2i(0, 1), t - vec2f(0.0, 1.0)), corner_float(seed, cell + vec2i(1, 1), t - vec2f(1.0, 1.0)), smoothed(t.x));
        sum -= mix(north, south, smoothed(t.y)) * f32(1u << FIRST_AMPLITUDE_BITS) / f32(1u << octave);
    }
    return sum;
}

fn weights_float(fraction: i32) -> vec3f {
    let t = f32(fraction) / f32(1u << SPLINE_CELL_BITS);
    return vec3f(0.5 * (1.0 - t) * (1.0 - t), 0.5 + t * (1.0 - t), 0.5 * t * t);
}

fn node_float(x: i32, z: i32, octaves: u32) -> vec3f {
    let between_nodes = splined(octaves);
    let count = select(1, 3, between_nodes);
    var east_weights = weights_float(spline_fraction(x));
    var south_weights = weights_float(spline_fraction(z));
    var sum = vec3f(0.0);
    for (var index = 0; index < count * count; index++) {
        let row = select(0, 1, index >= 3) + select(0, 1, index >= 6);
        let column = index - 3 * row;
        var place = vec2i(x, z);
        var weight = 1.0;
        if between_nodes {
            place.x = spline_node(spline_cell(x) + column - 1);
            place.y = spline_node(spline_cell(z) + row - 1);
            weight = east_weights[column] * south_weights[row];
        }
        let node = base_at(world.lattice_seeds, world.archipelago_seed, place.x, place.y, base_octaves(octaves));
        let parts = vec3f(vec3i(node.height, node.roughness, node.exposure));
        sum += weight * parts / vec3f(65536.0, 32768.0, 32768.0);
    }
    return sum;
}

fn height_float(x: i32, z: i32, octaves: u32) -> f32 {
    let node = node_float(x, z, octaves);
    let raw = node.x + node.y * fbm_float(x, z, fine_octaves(octaves));
    let r = raw / f32(BEACH_M);
    var beach = raw;
    if abs(r) < 1.0 {
        beach = raw * (0.2 + r * r * (1.6 - 0.8 * r * r));
    }
    let cliff = f32(CLIFF_M) * smoothstep(0.0, 1.0, (raw + f32(CLIFF_FOOT_M)) / f32(BEACH_M));
    return mix(beach, raw + cliff, node.z);
}

@compute @workgroup_size(64)
fn probe_heights_float(@builtin(global_invocation_id) invocation: vec3u) {
    if invocation.x >= arrayLength(&probes) {
        return;
    }
    let probe = probes[invocation.x];
    let first = 5u * invocation.x;
    words[first] = mod_trunc(probe.x, probe.y);
    words[first + 1u] = mod_floor(probe.x, probe.y);
    words[first + 2u] = i32(round(fbm_float(probe.x, probe.y, FINE_OCTAVES) * 65536.0));
    let inside = all(probe <= vec2i(WORLD_HALF)) && all(probe >= vec2i(-WORLD_HALF));
    for (var coarse = 0u; coarse < 2u; coarse++) {
        var height = 0.0;
        if inside {
            height = height_float(probe.x, probe.y, select(OCTAVES, COARSE_OCTAVES, coarse == 1u));
        }
        words[first + 3u + coarse] = i32(round(height * 256.0));
    }
}

const ALMOST_ONE_Q30: i32 = (1 << 30u) - 1;

const BASE_CELL_BITS: u32 = 21u;

const BASE_OCTAVES: u32 = 4u;

const BASE_OF_SEA: BaseNode = BaseNode(-(SEA_FLOOR_M << FINE_BITS), 0, 0);

const BASE_STREAM: u32 = 16u;

const BEACH_M: i32 = 8;

struct BaseNode {
    height: i32,
    roughness: i32,
    exposure: i32
}

const CLIFF_FOOT_M: i32 = 2;

const CLIFF_M: i32 = 34;

const COMPLEMENT_OF_SEA: Complement = Complement(ALMOST_ONE_Q30, ALMOST_ONE_Q30);

const CRATER_Q26: i32 = 15 << 22u;

struct Complement {
    mass: i32,
    height: i32
}

struct Corner {
    value: i32,
    gradient: vec2i
}

const EXPOSURE_CELL_BITS: u32 = 21u;

const EXPOSURE_STREAM: u32 = 24u;

const FINE_BITS: u32 = 16u;

const FINE_OCTAVES: u32 = 5u;

const FIRST_AMPLITUDE_BITS: u32 = 4u;

const FIRST_CELL_BITS: u32 = 15u;

const FRACTION_BITS: u32 = 15u;

const GRADIENTS = array<vec2i, 32>(vec2i(32610, 3212), vec2i(31357, 9512), vec2i(28899, 15447), vec2i(25330, 20788), vec2i(20788, 25330), vec2i(15447, 28899), vec2i(9512, 31357), vec2i(3212, 32610), vec2i(-3212, 32610), vec2i(-9512, 31357), vec2i(-15447, 28899), vec2i(-20788, 25330), vec2i(-25330, 20788), vec2i(-28899, 15447), vec2i(-31357, 9512), vec2i(-32610, 3212), vec2i(-32610, -3212), vec2i(-31357, -9512), vec2i(-28899, -15447), vec2i(-25330, -20788), vec2i(-20788, -25330), vec2i(-15447, -28899), vec2i(-9512, -31357), vec2i(-3212, -32610), vec2i(3212, -32610), vec2i(9512, -31357), vec2i(15447, -28899), vec2i(20788, -25330), vec2i(25330, -20788), vec2i(28899, -15447), vec2i(31357, -9512), vec2i(32610, -3212));

const HOME_LOBE_M: i32 = 5000;

const INLAND_REACH: i32 = (1 << 23u) - 1;

const ISLAND_CELL_BITS: u32 = 21u;

const ISLAND_REACH: i32 = 346;

struct Island {
    kind: u32,
    home: bool,
    middle: vec2i,
    radius_m: i32,
    height: i32,
    draws: u32
}

const KIND_ATOLL: u32 = 6u;

const KIND_GROUP: u32 = 2u;

const KIND_NONE: u32 = 0u;

const KIND_PLATEAU: u32 = 4u;

const KIND_SINGLE: u32 = 1u;

const KIND_SKERRIES: u32 = 3u;

const KIND_VOLCANO: u32 = 5u;

const LATTICES: u32 = 9u;

struct Lattice {
    seed: u32,
    stream: u32,
    bits: u32
}

struct LatticePlace {
    cell: i32,
    fraction: i32
}

struct Lobe {
    centre: vec2i,
    long: vec2i,
    short: vec2i,
    mass: vec2i,
    height: i32,
    plateau: u32,
    crater: bool
}

struct LobeRange {
    distance: vec2i,
    long: vec2i,
    short: vec2i
}

const MAX_ROUGHNESS: i32 = (1 << 29u) - (1 << 14u);

const MAX_STEEPNESS: i32 = 13421772;

const MOUNTAIN_M: i32 = 704;

const OCTAVES: u32 = 9u;

const OCTAVE_SHIFT = array<vec2i, 5>(vec2i(9472, 23808), vec2i(12032, 7424), vec2i(2816, 4864), vec2i(1792, 1280), vec2i(768, 256));

const OFFSET_LIMIT: i32 = 1 << 29u;

const RIM_M: i32 = 80;

const SEA_FLOOR_M: i32 = 64;

const SHORE_M: vec4i = vec4i(64, 64, 80, 128);

const SHORE_REACH: i32 = (1 << 23u) - 1;

const SPLINE_CELL_BITS: u32 = 13u;

struct Sample {
    value: i32,
    gradient: vec2i
}

const TWO_Q24: i32 = 2 << 24u;

const UNIT_BITS: u32 = 8u;

const UPLIFT_M: i32 = 384;

const WARP_AMPLITUDE_M: vec2i = vec2i(1800, 600);

const WARP_CELL_BITS: vec2u = vec2u(22u, 20u);

const WARP_M: i32 = 1698;

const WARP_STREAM: u32 = 20u;

const WORLD_HALF: i32 = 1073741824;

struct World {
    fine_seeds: array<u32, FINE_OCTAVES>,
    lattice_seeds: array<u32, LATTICES>,
    archipelago_seed: u32
}

fn axis_squared(axis: vec2i, place: vec2i) -> i32 {
    let along_q24 = mul_hi(place.x, axis.x) + mul_hi(place.y, axis.y);
    let clamped_q29 = clamp(along_q24, -TWO_Q24, TWO_Q24) << 5u;
    return mul_hi(clamped_q29, clamped_q29);
}

fn base_at(lattice_seeds: array<u32, LATTICES>, archipelago_seed: u32, x: i32, z: i32, octaves: u32) -> BaseNode {
    if !is_near_land(archipelago_seed, x, z) {
        return BASE_OF_SEA;
    }
    let complement = complement_at(archipelago_seed, x, z, warp_at(lattice_seeds, x, z));
    let mass = ALMOST_ONE_Q30 - complement.mass;
    let height = ALMOST_ONE_Q30 - complement.height;
    if mass == 0 {
        return BASE_OF_SEA;
    }
    var seeds = lattice_seeds;
    let exposed = Lattice(seeds[EXPOSURE_STREAM - BASE_STREAM], EXPOSURE_STREAM, EXPOSURE_CELL_BITS);
    let exposure = clamp(3 * sample_at(exposed, x, z).value - (1 << 24u), 0, 1 << 29u);
    let ruggedness = (3 << 28u) + exposure;
    var shore = shore_of(mass);
    var wide_shore = shore;
    var relief = 0;
    var slope = vec2i(0);
    var flatness = ALMOST_ONE_Q30;
    for (var index = 0u; index < octaves; index++) {
        let octave = Lattice(seeds[index], BASE_STREAM + index, BASE_CELL_BITS - index);
        let sample = sample_at(octave, x, z);
        let back = turned_back(octave, sample.gradient) >> vec2u(2u);
        let value = sample.value;
        let is_folded = index > 0u;
        slope += back + select(vec2i(0), back >> vec2u(1u), is_folded);
        flatness = flatness_of(slope);
        let size = abs(value);
        let folded = select(value, (3 << 26u) - (size + (size >> 1u)), is_folded);
        relief += mul_hi(folded, damping(flatness)) >> index;
        if index <= 1u {
            shore += mul_hi(value, select(SHORE_M[1], SHORE_M[0], index == 0u) << 19u);
        }
        else if index == 2u {
            shore += mul_hi(value, mul_hi(SHORE_M[2] << 21u, ruggedness));
        }
        else {
            let amplitude = mul_hi(SHORE_M[3] << 21u, ruggedness);
            let near = window(clamp(shore, -SHORE_REACH, SHORE_REACH) << 7u);
            shore += mul_hi(mul_hi(value, near) << 2u, amplitude);
        }
        if index <= 2u {
            wide_shore = shore;
        }
    }
    let inland = smooth_step(clamp(wide_shore - (8 << FINE_BITS), 0, INLAND_REACH) << 7u);
    let share = mul_hi(height << 1u, inland << 1u);
    let raised_relief = max((13 << 20u) + ((relief * 11) >> 3u), 0) + (5 << 20u);
    let mountain = mul_hi(mul_hi(share << 1u, raised_relief) << 5u, MOUNTAIN_M << 19u);
    let sum = max(lowland(shore) + mountain + (SEA_FLOOR_M << FINE_BITS), 0);
    let rim = min(mass, (1 << 27u) - 1) << 3u;
    var raised = sum;
    if mass < (1 << 27u) {
        raised = mul_hi(sum << 2u, smooth_step(rim));
    }
    return BaseNode(raised - (SEA_FLOOR_M << FINE_BITS), roughness_of(shore, exposure, rim, height, inland, flatness), min(exposure >> 14u, (1 << 15u) - 1));
}

fn base_octaves(octaves: u32) -> u32 {
    return min(octaves, BASE_OCTAVES);
}

fn complement_after(before: Complement, lobe: Lobe, x: i32, z: i32, warp: vec2i) -> Complement {
    let u = falloff(lobe, vec2i(lobe_offset(x, lobe.centre.x, warp.x), lobe_offset(z, lobe.centre.y, warp.y)));
    if u == 0 {
        return before;
    }
    let s = square(u << 4u);
    let inner_q27 = (lobe.mass.x << 24u) + lobe.mass.y * (s >> 6u);
    let mass_q26 = clamp(mul_hi(s << 1u, inner_q27), 0, (1 << 26u) - 1);
    var top = min(s, ALMOST_ONE_Q30 >> lobe.plateau) << lobe.plateau;
    if lobe.crater {
        let w = max(u - CRATER_Q26, 0) << 8u;
        top -= (square(w) >> 4u) * 7;
    }
    let height_q30 = (top >> 8u) * lobe.height;
    return Complement(before.mass - (mul_hi(before.mass, mass_q26 << 5u) << 1u), before.height - (mul_hi(before.height, height_q30 << 1u) << 1u));
}

fn complement_at(archipelago_seed: u32, x: i32, z: i32, warp: vec2i) -> Complement {
    let middle = vec2i(island_cell(x), island_cell(z));
    var complement = COMPLEMENT_OF_SEA;
    for (var index = 0; index < 9; index++) {
        let island = island_of(archipelago_seed, middle + near_cell(index));
        if may_reach(island, x, z) {
            var draws = island.draws;
            for (var lobe = 0u; lobe < lobe_count(island.kind); lobe++) {
                let next = next_lobe(island, lobe == 0u, &draws);
                complement = complement_after(complement, next, x, z, warp);
            }
        }
    }
    return complement;
}

fn corner(seed: u32, cell: vec2u, x: i32, z: i32) -> Corner {
    let gradient = direction(hash2(seed, bitcast<i32>(cell.x), bitcast<i32>(cell.y))) << vec2u(14u);
    return Corner(mul_hi(gradient.x << 1u, x) + mul_hi(gradient.y << 1u, z), gradient);
}

fn damping(flatness: i32) -> i32 {
    let squared = mul_hi(flatness, flatness);
    return squared - (squared >> 3u) + (1 << 25u);
}

fn direction(word: u32) -> vec2i {
    return gradients[word >> 27u];
}

fn draw_between(draws: ptr<function, u32>, low: i32, high: i32) -> i32 {
    return low + bitcast<i32>(mul_hi_u(draw_word(draws), bitcast<u32>(high - low + 1)));
}

fn draw_word(draws: ptr<function, u32>) -> u32 {
    let word = mix_bits(*draws + 2654435769u);
    *draws = word;
    return word;
}

fn fade(t: i32) -> i32 {
    let t2 = mul_hi(t, t) << 1u;
    let t3 = mul_hi(t2, t) << 1u;
    let inner_q27 = (10 << 27u) - 15 * (t >> 4u) + 6 * (t2 >> 4u);
    return mul_hi(t3, inner_q27) << 5u;
}

fn fade_slope(t: i32) -> i32 {
    let product_q31 = mul_hi(t, 2147483647 - t) << 1u;
    let four_q31 = product_q31 << 2u;
    return 15 * (mul_hi(four_q31, four_q31) >> 4u);
}

fn falloff(lobe: Lobe, place: vec2i) -> i32 {
    return max((1 << 26u) - 1 - axis_squared(lobe.long, place) - axis_squared(lobe.short, place), 0);
}

fn fine_octaves(octaves: u32) -> u32 {
    return octaves - base_octaves(octaves);
}

fn flatness_of(slope: vec2i) -> i32 {
    let steepness = mul_hi(slope.x, slope.x) + mul_hi(slope.y, slope.y);
    return max(MAX_STEEPNESS - steepness, 0) * 80;
}

fn gradient(seed: u32, cell_x: i32, cell_z: i32) -> vec2i {
    return direction(hash2(seed, cell_x, cell_z));
}

var<private> gradients: array<vec2i, 32> = GRADIENTS;

fn hash2(seed: u32, x: i32, z: i32) -> u32 {
    return mix_bits(mix_bits(seed ^ (bitcast<u32>(x) * 2654435769u)) + bitcast<u32>(z) * 2246822507u);
}

fn is_low(lattice: Lattice) -> bool {
    return (lattice.stream & 1u) == 0u;
}

fn is_near_land(archipelago_seed: u32, x: i32, z: i32) -> bool {
    let middle = vec2i(island_cell(x), island_cell(z));
    for (var index = 0; index < 9; index++) {
        if may_reach(island_of(archipelago_seed, middle + near_cell(index)), x, z) {
            return true;
        }
    }
    return false;
}

fn island_cell(coordinate: i32) -> i32 {
    return (coordinate + (1 << (ISLAND_CELL_BITS - 1u))) >> ISLAND_CELL_BITS;
}

fn island_kind(hash: u32, cell: vec2i) -> u32 {
    if all(cell == vec2i(0)) {
        return KIND_SINGLE;
    }
    let beside_home = all(abs(cell) <= vec2i(1));
    if (hash & 15u) >= 7u || (beside_home && (hash & 1u) == 0u) {
        return KIND_NONE;
    }
    let drawn = (hash >> 4u) & 15u;
    if drawn <= 3u {
        return KIND_SINGLE;
    }
    if drawn <= 6u {
        return KIND_GROUP;
    }
    if drawn <= 8u {
        return KIND_SKERRIES;
    }
    if drawn <= 11u {
        return KIND_PLATEAU;
    }
    return select(KIND_ATOLL, KIND_VOLCANO, drawn <= 13u);
}

fn island_of(seed: u32, cell: vec2i) -> Island {
    let hash = hash2(seed, cell.x, cell.y);
    let home = all(cell == vec2i(0));
    var draws = hash;
    let size = draw_between(&draws, 0, 255);
    let jitter_x = draw_between(&draws, -1792, 1792);
    let jitter_z = draw_between(&draws, -1792, 1792);
    let drawn_height = draw_between(&draws, 90, 255);
    let part = select(108 + ((size * size * 148) >> 16u), 256, home);
    let jitter = select(vec2i(jitter_x, jitter_z) << vec2u(9u), vec2i(0), home);
    let middle = (cell << vec2u(ISLAND_CELL_BITS)) + jitter;
    let height = select(drawn_height, 192, home);
    return Island(island_kind(hash, cell), home, middle, (HOME_LOBE_M * part) >> 8u, height, draws);
}

fn lattice_place(octave: u32, shifted: i32) -> LatticePlace {
    let cell_bits = FIRST_CELL_BITS - octave;
    let inside = shifted & ((1 << cell_bits) - 1);
    return LatticePlace(shifted >> cell_bits, inside << (FRACTION_BITS - cell_bits));
}

fn lerp(a: i32, b: i32, t_q31: i32) -> i32 {
    return a + (mul_hi(b - a, t_q31) << 1u);
}

fn lobe_axis(axis: vec2i, length_m: i32) -> vec2i {
    let inverse_q39 = bitcast<i32>((2147483648u / bitcast<u32>(length_m)) << 8u);
    return vec2i(mul_hi(axis.x << 16u, inverse_q39), mul_hi(axis.y << 16u, inverse_q39));
}

fn lobe_count(kind: u32) -> u32 {
    switch kind {
        case KIND_SINGLE, KIND_SKERRIES {
            return 3u;
        }
        case KIND_GROUP {
            return 4u;
        }
        case KIND_PLATEAU, KIND_VOLCANO {
            return 2u;
        }
        case KIND_ATOLL {
            return 1u;
        }
        case default {
            return 0u;
        }
    }
}

fn lobe_offset(coordinate: i32, centre: i32, warp_q16: i32) -> i32 {
    let units = clamp(coordinate - centre, -(OFFSET_LIMIT >> 8u), OFFSET_LIMIT >> 8u);
    return clamp((units << 8u) + warp_q16, -OFFSET_LIMIT, OFFSET_LIMIT - 1) << 2u;
}

fn lobe_range(kind: u32, first: bool) -> LobeRange {
    if kind == KIND_GROUP {
        return LobeRange(vec2i(115, 179), vec2i(77, 159), vec2i(56, 108));
    }
    if kind == KIND_VOLCANO && first {
        return LobeRange(vec2i(0), vec2i(179, 189), vec2i(166, 179));
    }
    if kind == KIND_ATOLL {
        return LobeRange(vec2i(0), vec2i(192, 230), vec2i(159, 192));
    }
    if first {
        return LobeRange(vec2i(13), vec2i(159, 243), vec2i(123, 174));
    }
    return LobeRange(vec2i(77, 141), vec2i(102, 205), vec2i(72, 128));
}

fn lowland(shore: i32) -> i32 {
    if shore < 0 {
        return (shore >> 5u) + (shore >> 1u);
    }
    let near = min(shore, (1 << 21u) - 1);
    return (shore >> 5u) + (near >> 1u) - (square(near << 9u) >> 11u);
}

fn may_reach(island: Island, x: i32, z: i32) -> bool {
    let reach = (((ISLAND_REACH * island.radius_m) >> 8u) + WARP_M) << UNIT_BITS;
    let away = abs(vec2i(x, z) - island.middle);
    return island.kind != KIND_NONE && max(away.x, away.y) <= reach;
}

fn mix_bits(seed: u32) -> u32 {
    var h = seed;
    h ^= h >> 16u;
    h *= 569420461u;
    h ^= h >> 15u;
    h *= 3545902487u;
    return h ^ (h >> 15u);
}

fn mod_floor(a: i32, m: i32) -> i32 {
    let remainder = mod_trunc(a, m);
    return select(remainder, bitcast<i32>(bitcast<u32>(remainder) + unsigned_abs(m)), remainder < 0);
}

fn mod_trunc(a: i32, m: i32) -> i32 {
    if m == 0 {
        return 0;
    }
    let magnitude = unsigned_abs(a) % unsigned_abs(m);
    return bitcast<i32>(select(magnitude, 0u - magnitude, a < 0));
}

fn mul_hi(a: i32, b: i32) -> i32 {
    let product = bitcast<i32>(mul_hi_u(bitcast<u32>(a), bitcast<u32>(b)));
    return product - ((a >> 31u) & b) - ((b >> 31u) & a);
}

fn mul_hi_u(a: u32, b: u32) -> u32 {
    let a_low = a & 65535u;
    let a_high = a >> 16u;
    let b_low = b & 65535u;
    let b_high = b >> 16u;
    let first = a_high * b_low + ((a_low * b_low) >> 16u);
    let second = a_low * b_high + (first & 65535u);
    return a_high * b_high + (first >> 16u) + (second >> 16u);
}

fn near_cell(index: i32) -> vec2i {
    let row = select(select(1, 0, index < 6), -1, index < 3);
    return vec2i(index - 3 * row - 4, row);
}

fn next_lobe(island: Island, first: bool, draws: ptr<function, u32>) -> Lobe {
    let kind = island.kind;
    let away = direction(draw_word(draws));
    let axis = direction(draw_word(draws));
    let range = lobe_range(kind, first);
    var distance = range.distance.x;
    if range.distance.x < range.distance.y {
        distance = draw_between(draws, range.distance.x, range.distance.y);
    }
    let long = draw_between(draws, range.long.x, range.long.y);
    let short = draw_between(draws, range.short.x, range.short.y);
    let share = draw_between(draws, 77, 256);
    let lengths = (vec3i(distance, long, short) * island.radius_m) >> vec3u(8u);
    var height = island.height;
    var plateau = 0u;
    var mass = vec2i(8, 0);
    if kind == KIND_SKERRIES {
        height = 10;
        mass = vec2i(3, 0);
    }
    else if kind == KIND_ATOLL {
        height = 5;
        mass = vec2i(40, -48);
    }
    else if kind == KIND_PLATEAU {
        height = select((height * 179) >> 8u, 108, height < 154);
        plateau = 2u;
        mass = vec2i(16, -8);
    }
    else if kind == KIND_VOLCANO && first {
        height = max(height, 179);
        mass = vec2i(16, -8);
    }
    else if !first {
        height = (height * share) >> 8u;
    }
    else if kind == KIND_SINGLE && island.home {
        mass = vec2i(16, -8);
    }
    let offset = (away * lengths.x) >> vec2u(15u - UNIT_BITS);
    return Lobe(island.middle + offset, lobe_axis(axis, lengths.y), lobe_axis(vec2i(-axis.y, axis.x), lengths.z), mass, height, plateau, kind == KIND_VOLCANO && first);
}

fn roughness_of(shore: i32, exposure: i32, rim: i32, height: i32, inland: i32, flatness: i32) -> i32 {
    let near = window(clamp(shore, 1 - (1 << 21u), (1 << 21u) - 1) << 9u);
    let coast = mul_hi(near << 1u, (9 << 27u) + (exposure >> 2u) * 3);
    let foot = mul_hi(inland << 1u, (ALMOST_ONE_Q30 - inland) << 1u);
    let rocky = mul_hi(inland << 1u, flatness << 1u) + foot * 2 + (foot >> 1u);
    let sum = (coast >> 1u) + mul_hi(height << 1u, rocky) + (1 << 23u);
    return (mul_hi(min(sum, MAX_ROUGHNESS) << 2u, rim << 1u) + (1 << 14u)) >> 15u;
}

fn sample_at(lattice: Lattice, x: i32, z: i32) -> Sample {
    let place = turned(lattice, x, z);
    let bits = vec2u(lattice.bits);
    let cell = place >> bits;
    let next = (cell + 1u) & (vec2u(4294967295u) >> bits);
    let inside = place & vec2u((1u << lattice.bits) - 1u);
    let low = bitcast<vec2i>(inside << (31u - bits));
    let high = low ^ vec2i(-2147483647 - 1);
    let fade_x = fade(low.x);
    let fade_z = fade(low.y);
    let c00 = corner(lattice.seed, cell, low.x, low.y);
    let c10 = corner(lattice.seed, vec2u(next.x, cell.y), high.x, low.y);
    let c01 = corner(lattice.seed, vec2u(cell.x, next.y), low.x, high.y);
    let c11 = corner(lattice.seed, next, high.x, high.y);
    let west = lerp(c00.value, c01.value, fade_z);
    let east = lerp(c10.value, c11.value, fade_z);
    let north = lerp(c00.value, c10.value, fade_x);
    let south = lerp(c01.value, c11.value, fade_x);
    let mean_x = lerp(lerp(c00.gradient.x, c10.gradient.x, fade_x), lerp(c01.gradient.x, c11.gradient.x, fade_x), fade_z);
    let mean_z = lerp(lerp(c00.gradient.y, c10.gradient.y, fade_x), lerp(c01.gradient.y, c11.gradient.y, fade_x), fade_z);
    let gradient = vec2i((mean_x >> 3u) + mul_hi(east - west, fade_slope(low.x)), (mean_z >> 3u) + mul_hi(south - north, fade_slope(low.y)));
    return Sample(lerp(west, east, fade_x), gradient);
}

fn shore_of(mass: i32) -> i32 {
    let rim = ALMOST_ONE_Q30 - (min(mass, (1 << 27u) - 1) << 3u);
    let middle = max(mass - (5 << 27u), 0);
    return mul_hi(square(middle), UPLIFT_M << 18u) - mul_hi(square(rim), RIM_M << 18u);
}

fn smooth_step(x_q30: i32) -> i32 {
    return mul_hi(square(x_q30) << 1u, (3 << 29u) - x_q30) << 2u;
}

fn spline_cell(coordinate: i32) -> i32 {
    return coordinate >> SPLINE_CELL_BITS;
}

fn spline_fraction(coordinate: i32) -> i32 {
    return coordinate & ((1 << SPLINE_CELL_BITS) - 1);
}

fn spline_node(cell: i32) -> i32 {
    return (cell << SPLINE_CELL_BITS) + (1 << (SPLINE_CELL_BITS - 1u));
}

fn splined(octaves: u32) -> bool {
    return fine_octaves(octaves) + SPLINE_CELL_BITS > FIRST_CELL_BITS;
}

fn square(x_q30: i32) -> i32 {
    return mul_hi(x_q30 << 1u, x_q30 << 1u);
}

fn turned(lattice: Lattice, x: i32, z: i32) -> vec2u {
    let low = is_low(lattice);
    let along = select(vec2i(3 * x - 4 * z, 4 * x + 3 * z), vec2i(4 * x - 3 * z, 3 * x + 4 * z), low);
    return bitcast<vec2u>(along) + vec2u(lattice.stream * 2654435761u);
}

fn turned_back(lattice: Lattice, gradient: vec2i) -> vec2i {
    let x = gradient.x;
    let z = gradient.y;
    return select(vec2i(3 * x + 4 * z, 3 * z - 4 * x), vec2i(4 * x + 3 * z, 4 * z - 3 * x), is_low(lattice));
}

fn unsigned_abs(v: i32) -> u32 {
    let bits = bitcast<u32>(v);
    return select(bits, 0u - bits, v < 0);
}

fn warp_at(lattice_seeds: array<u32, LATTICES>, x: i32, z: i32) -> vec2i {
    var seeds = lattice_seeds;
    var warp = vec2i(0);
    for (var index = 0u; index < 4u; index++) {
        let wide = index < 2u;
        let stream = WARP_STREAM + index;
        let bits = select(WARP_CELL_BITS.y, WARP_CELL_BITS.x, wide);
        let amplitude = select(WARP_AMPLITUDE_M[1], WARP_AMPLITUDE_M[0], wide) << 19u;
        let lattice = Lattice(seeds[stream - BASE_STREAM], stream, bits);
        let part = mul_hi(sample_at(lattice, x, z).value, amplitude);
        warp += select(vec2i(0, part), vec2i(part, 0), (index & 1u) == 0u);
    }
    return warp;
}

fn window(x_q30: i32) -> i32 {
    return square(ALMOST_ONE_Q30 - square(x_q30));
}
